"""Features of GeoJSON (RFC 7946) as text, many at once."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from exports.site.columns import Column, Layer
from exports.tables.coordinate_text import (
    DEGREE_DECIMALS,
    LENGTH_DECIMALS,
    Rows,
    check_places,
    rows_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from georef_gis.frames import Array

_quoted = json.encoder.encode_basestring
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)


def feature_lines(layer: Layer, *, named: bool) -> Iterator[list[str]]:
    """Features of a layer as JSON, some thousand at a time.

    Parameters
    ----------
    named
        Whether the properties begin with the name of the layer.
    """
    keys = [f"{_ENCODER.encode(field.name)}: %s" for field in layer.fields]
    if named:
        keys.insert(0, f'"layer": {_ENCODER.encode(layer.name)}')
    template = f'{{"type": "Feature", %s, "properties": {{{", ".join(keys)}}}}}'
    solid = layer.solid
    for start, stop in layer.batches():
        columns = [_texts(layer.columns[field.name], start, stop) for field in layer.fields]
        shapes = _geometries(layer, solid[start:stop], start, stop)
        yield [template % row for row in zip(shapes, *columns, strict=True)]


def _texts(column: Column, start: int, stop: int) -> list[str]:
    """Values as JSON."""
    values = column.tolist(start, stop)
    if column.values.dtype != object:
        return _ENCODER.encode(values)[1:-1].split(", ")
    return [_quoted(value) if isinstance(value, str) else "null" for value in values]


def bounds_of(lonlat: Sequence[Array]) -> list[float]:
    """West, south, east, north of vertices; west > east across the antimeridian (RFC 7946, 5.2).

    Empty where there are no vertices.
    """
    points = [part for part in lonlat if len(part)]
    if not points:
        return []
    lon = np.concatenate([part[:, 0] for part in points])
    check_places(lon)
    lat = np.concatenate([part[:, 1] for part in points])
    west, east = float(lon.min()), float(lon.max())
    if east - west > 180.0:
        west, east = float(lon[lon >= 0.0].min()), float(lon[lon < 0.0].max())
    box = (west, float(lat.min()), east, float(lat.max()))
    return [round(side, DEGREE_DECIMALS) for side in box]


# -- geometries --------------------------------------------------------------------------------


def _geometries(layer: Layer, solid: NDArray[np.bool_], start: int, stop: int) -> list[str]:
    """Members `bbox` and `geometry` of features."""
    if layer.geometry == "None":
        return ['"geometry": null'] * (stop - start)
    at = layer.places
    bounds = at.offsets[start : stop + 1]
    lonlat = np.round(at.lonlat[bounds[0] : bounds[-1]], DEGREE_DECIMALS)
    height = np.round(at.height[bounds[0] : bounds[-1]], LENGTH_DECIMALS)
    bounds = bounds - bounds[0]
    flat, high = _vertices(lonlat, height, solid)
    if layer.geometry == "Point":
        return [
            f'"geometry": {{"type": "Point", "coordinates": '
            f"[{(high if up else flat).between(i, i + 1)}]}}"
            for i, up in enumerate(solid.tolist())
        ]
    opening, closing = ("[[[", "]]]") if layer.geometry == "Polygon" else ("[[", "]]")
    firsts = bounds[:-1]
    boxes = _boxes(lonlat, height, firsts, solid)
    found = [
        f'"bbox": [{box}], "geometry": {{"type": "{layer.geometry}", '
        f'"coordinates": {opening}{(high if up else flat).between(a, b)}{closing}}}'
        for box, (a, b), up in zip(boxes, pairwise(bounds.tolist()), solid.tolist(), strict=True)
    ]
    span = np.maximum.reduceat(lonlat[:, 0], firsts) - np.minimum.reduceat(lonlat[:, 0], firsts)
    for i in np.flatnonzero(span > 180.0).tolist():
        rows = slice(bounds[i], bounds[i + 1])
        points = np.column_stack([lonlat[rows], height[rows]])[:, : 3 if solid[i] else 2]
        found[i] = _cut(points.tolist(), layer.geometry)
    return found


def _vertices(lonlat: Array, height: Array, solid: NDArray[np.bool_]) -> tuple[Rows, Rows]:
    """Positions without their brackets, two and three numbers each."""
    lon, lat = ((axis, DEGREE_DECIMALS) for axis in lonlat.T)
    flat = rows_of(lon, ", ", lat, "], [")
    if not solid.any():
        return flat, flat
    up = (np.nan_to_num(height), LENGTH_DECIMALS)
    return flat, rows_of(lon, ", ", lat, ", ", up, "], [")


def _boxes(
    lonlat: Array, height: Array, firsts: NDArray[np.int64], solid: NDArray[np.bool_]
) -> list[str]:
    """West, south[, lowest], east, north[, highest] of each feature, as JSON without brackets."""
    points = np.column_stack([lonlat, np.nan_to_num(height)])
    low, high = (f.reduceat(points, firsts) for f in (np.minimum, np.maximum))
    return [
        _ENCODER.encode(a[:n] + b[:n])[1:-1]
        for a, b, n in zip(low.tolist(), high.tolist(), (2 + solid).tolist(), strict=True)
    ]


def _cut(part: list[list[float]], kind: str) -> str:
    """Members of a geometry cut at the antimeridian (RFC 7946, 3.1.9)."""
    import shapely

    east = [[lon % 360.0, *rest] for lon, *rest in part]
    whole = shapely.LineString(east)
    if kind == "Polygon":
        # sides that cross each other can be drawn, but not be cut
        whole = shapely.make_valid(shapely.Polygon(east), method="structure")
        # an area without any ground is a line
        kind = kind if whole.area else "LineString"
    pieces: list[Any] = []
    for west, shift in ((0.0, 0.0), (180.0, 360.0)):
        side = whole.intersection(shapely.box(west, -90.0, west + 180.0, 90.0))
        for shape in getattr(side, "geoms", [side]):
            if shape.is_empty or shape.geom_type != kind:
                continue
            ring = shapely.geometry.polygon.orient(shape).exterior if kind == "Polygon" else shape
            pieces.append([
                [round(lon - shift, DEGREE_DECIMALS), *(round(x, DEGREE_DECIMALS) for x in rest)]
                for lon, *rest in ring.coords
            ])  # fmt: skip
    lows, highs = (list(map(f, zip(*east, strict=True))) for f in (min, max))
    lows[0], highs[0] = (
        round((x + 180.0) % 360.0 - 180.0, DEGREE_DECIMALS) for x in (lows[0], highs[0])
    )
    nested = [[piece] for piece in pieces] if kind == "Polygon" else pieces
    return (
        f'"bbox": {_ENCODER.encode(lows + highs)}, "geometry": '
        f'{{"type": "Multi{kind}", "coordinates": {_ENCODER.encode(nested)}}}'
    )
