"""Layers of mapped assets and of their error ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from exports import schemas
from exports.schemas import ASSETS, ELLIPSES, Feature, Field, GeometryKind, Layer, Value
from exports.site_layers import feature, number, place
from exports.site_values import SiteValues
from georef_gis.frames import Array
from georef_gis.project.asset_layers import AssetRow

_KINDS: dict[str, tuple[str, GeometryKind]] = {
    "asset_points": ("Assets", "Point"),
    "asset_lines": ("Assets, lines", "LineString"),
    "asset_polygons": ("Assets, areas", "Polygon"),
    ELLIPSES: ("Error ellipses of assets", "Polygon"),
}
_UNITS = ("_deg", "_m")


def asset_layers(site: SiteValues) -> dict[str, Layer]:
    """Layers by name; features whose geometry cannot be read are left out."""
    return {name: _layer(site, name) for name in ASSETS}


def unreadable(rows: Sequence[AssetRow]) -> str:
    """Names of the assets that `asset_layers` leaves out, the first five; empty if none."""
    names = [
        str(row.values.get("name") or row.values.get("asset_id"))
        for row in rows
        if row.layer != ELLIPSES and _vertices(row) is None
    ]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _layer(site: SiteValues, name: str) -> Layer:
    title, geometry = _KINDS[name]
    fields = schemas.ELLIPSE_FIELDS if name == ELLIPSES else schemas.ASSET_FIELDS
    rows = [row for row in site.assets if row.layer == name]
    features = tuple(
        _feature(site, row, fields, p_map) for row in rows if (p_map := _vertices(row)) is not None
    )
    return Layer(name=name, title=title, geometry=geometry, fields=fields, features=features)


def _vertices(row: AssetRow) -> Array | None:
    """Vertices (n, 3): CRS units, height above the ellipsoid or NaN; a ring is closed."""
    import shapely

    if row.wkb is None:
        return None
    try:
        shape = shapely.from_wkb(row.wkb)
    except (shapely.errors.GEOSException, TypeError):
        return None
    if shape.geom_type.startswith("Multi") and len(shape.geoms) == 1:
        shape = shape.geoms[0]
    if shape.is_empty or shape.geom_type != _KINDS[row.layer][1]:
        return None
    ring = shape.exterior if shape.geom_type == "Polygon" else shape
    out: Array = shapely.get_coordinates(ring, include_z=True)
    return out if np.isfinite(out[:, :2]).all() else None


def _feature(site: SiteValues, row: AssetRow, fields: Sequence[Field], p_map: Array) -> Feature:
    known = np.nan_to_num(p_map)
    geo = site.frame.geo_from_map(known)
    points = place(site.frame, np.column_stack([geo[:, :2], p_map[:, 2]]))
    points[:, 4:] = p_map[:, :2]
    lon, lat, h, big_h = (float(x) for x in points[0, :4])
    own: dict[str, Value] = {
        "lon_deg": lon,
        "lat_deg": lat,
        "height_ellipsoidal_m": number(h),
        "height_orthometric_m": number(big_h),
    }
    values = {f.name: own.get(f.name, _value(row, f)) for f in fields}
    return feature(values, points)


def _value(row: AssetRow, field: Field) -> Value:
    """Value of a column, whatever a GIS user wrote into it."""
    column = next((field.name.removesuffix(u) for u in _UNITS if field.name.endswith(u)),
                  field.name)  # fmt: skip
    value: Any = row.values.get(column)
    if value is None or value == "":
        return None
    if field.kind == "text":
        return str(value)
    try:
        measured = float(value)
    except (TypeError, ValueError):
        return None
    if not math.isfinite(measured):
        return None
    return int(measured) if field.kind == "integer" else measured
