"""Geometries of features as KML, many at a time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from exports.kml import elements as k
from exports.kml.digits import lonlat_texts
from exports.site.columns import Layer
from georef_gis.frames import Array

# m; no height that is measured, and no number that a viewer can place
FARTHEST = 1e7
# Layers whose heights are shown; all others lie on the viewer's ground, which may be above theirs
STANDING = ("photos", "track", "control")
# deg; what is wider crosses the 180th meridian
_HALF = 180.0


def shapes_of(layer: Layer, start: int, stop: int) -> list[k.Element]:
    """Geometry of some features; cut where they cross the 180th meridian."""
    at = layer.places
    first, last = int(at.offsets[start]), int(at.offsets[stop])
    offsets = at.offsets[start : stop + 1] - first
    lonlat = at.lonlat[first:last]
    heights = at.height_orthometric[first:last] if layer.name in STANDING else None
    out = _written(layer.geometry, lonlat, heights, offsets.tolist())
    if layer.geometry != "Point" and len(lonlat):
        lon = lonlat[:, 0]
        wide = np.maximum.reduceat(lon, offsets[:-1]) - np.minimum.reduceat(lon, offsets[:-1])
        for i in np.flatnonzero(wide > _HALF).tolist():
            part = slice(offsets[i], offsets[i + 1])
            out[i] = _cut(layer.geometry, lonlat[part], None if heights is None else heights[part])
    return out


def _written(
    geometry: str, lonlat: Array, heights: Array | None, bounds: list[int]
) -> list[k.Element]:
    """Points, lines or areas: at their heights, m, where all of them are known, else on the ground.

    Parameters
    ----------
    bounds
        Vertices of feature i are ``bounds[i]:bounds[i + 1]``.
    """
    texts = lonlat_texts(lonlat, bounds)
    ring = ("<outerBoundaryIs><LinearRing>", "</LinearRing></outerBoundaryIs>")
    before, after = ring if geometry == "Polygon" else ("", "")
    end = f"</coordinates>{after}</{geometry}>"
    lies = "" if geometry == "Point" else "<tessellate>1</tessellate>"
    mode = "<altitudeMode>{}</altitudeMode>" + before + "<coordinates>"
    clamped = f"<{geometry}>{lies}{mode.format('clampToGround')}"
    if heights is None:
        return [f"{clamped}{text}{end}" for text in texts]
    absolute = f"<{geometry}>{mode.format('absolute')}"
    known = np.isfinite(heights) & (np.abs(heights) < FARTHEST)
    return [
        f"{absolute}{_raised(text, heights[a:b])}{end}"
        if known[a:b].all()
        else f"{clamped}{text}{end}"
        for text, (a, b) in zip(texts, pairwise(bounds), strict=True)
    ]


def _raised(text: str, heights: Array) -> str:
    """Vertices with their heights, m."""
    rows = zip(text.split(), heights.tolist(), strict=True)
    return " ".join(f"{place},{height:.3f}" for place, height in rows)


def _cut(geometry: str, lonlat: Array, heights: Array | None) -> k.Element:
    """A line or area in parts that end at the 180th meridian: viewers go the other way around."""
    import shapely

    points = np.column_stack([np.mod(lonlat[:, 0], 360.0), lonlat[:, 1]])
    known = heights is not None and bool(np.isfinite(heights).all())
    if heights is not None and known:
        points = np.column_stack([points, heights])
    whole = shapely.LineString(points)
    if geometry == "Polygon":
        # sides that cross each other can be drawn, but not be cut
        whole = shapely.make_valid(shapely.Polygon(points), method="structure")
        # an area without any ground is a line
        geometry = geometry if whole.area else "LineString"
    parts: list[k.Element] = []
    for west in (0.0, _HALF):
        side = shapely.intersection(whole, shapely.box(west, -90.0, west + _HALF, 90.0))
        for shape in shapely.get_parts(side):
            if shape.geom_type != geometry:
                continue
            line = shape.exterior if geometry == "Polygon" else shape
            at = shapely.get_coordinates(line, include_z=True) - [2.0 * west, 0.0, 0.0]
            parts += _written(geometry, at[:, :2], at[:, 2] if known else None, [0, len(at)])
    return k.element("MultiGeometry", *parts)
