"""Layers of mapped assets and of their error ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from exports.site import schemas
from exports.site.columns import Column, Layer, Places
from exports.site.map_heights import map_heights
from exports.site.schemas import ASSETS, ELLIPSES, Field, GeometryKind
from exports.site.values import SiteValues
from georef_gis.geodesy import MapFrame, geoid_undulation
from georef_gis.project.asset_layers import AssetTable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from georef_gis.frames import Array

_KINDS: dict[str, tuple[str, GeometryKind]] = {
    "asset_points": ("Assets", "Point"),
    "asset_lines": ("Assets, lines", "LineString"),
    "asset_polygons": ("Assets, areas", "Polygon"),
    ELLIPSES: ("Error ellipses of assets", "Polygon"),
}
_UNITS = ("_deg", "_m")
# Of a name in a warning
_MOST_LETTERS = 60
# A column of 64 bits holds numbers between these
_SMALLEST, _LARGEST = -(2**63), 2**63 - 1
# Vertices that are transformed at once, which bounds the memory
_BATCH = 100_000


def asset_layers(site: SiteValues) -> dict[str, Layer]:
    """Layers by name; features whose geometry cannot be read are left out."""
    tables = {table.layer: table for table in site.assets}
    return {name: _layer(site.frame, name, tables.get(name)) for name in ASSETS}


def what_is_lost(tables: Sequence[AssetTable]) -> tuple[str, ...]:
    """What to say of assets that `asset_layers` leaves out, or takes in part."""
    unreadable: list[str] = []
    pierced: list[str] = []
    cells: list[str] = []
    added: list[str] = []
    for table in tables:
        if table.layer != ELLIPSES:
            unreadable += table.names(np.diff(table.offsets) == 0)
            pierced += table.names(table.holes > 0)
            cells += _no_numbers(table)
            added += [f"{table.layer}.{name}" for name in table.columns if name not in _KNOWN]
    told = (
        ("assets left out, as they have no geometry of their kind", unreadable),
        ("areas written without their holes, which assets cannot have", pierced),
        ("cells left empty, as they hold no number of 64 bits", cells),
        ("columns that a GIS added are left out; make them attributes in asset_classes.toml",
         added),
    )  # fmt: skip
    return tuple(f"{what}: {_listed(names)}" for what, names in told if names)


def _listed(names: Sequence[str]) -> str:
    """The first names in one line, whatever line ends they hold and however long they are."""
    first = ", ".join(" ".join(name.split())[:_MOST_LETTERS] for name in names[:5])
    return first + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _layer(frame: MapFrame, name: str, table: AssetTable | None) -> Layer:
    title, geometry = _KINDS[name]
    fields = schemas.ELLIPSE_FIELDS if name == ELLIPSES else schemas.ASSET_FIELDS
    if table is None:
        return Layer.of_rows(name, title, geometry, fields, ())
    kept = np.diff(table.offsets) > 0
    offsets = np.concatenate([table.offsets[:-1][kept], table.offsets[-1:]])
    own = _first_places(frame, table.xy[offsets[:-1]], table.height[offsets[:-1]])
    columns = {f.name: own[f.name] if f.name in own else _column(table, f, kept) for f in fields}
    places = Places(
        offsets, table.xy, table.height, lambda: _geographic(frame, table.xy, table.height)
    )
    return Layer(
        name=name, title=title, geometry=geometry, fields=fields, columns=columns, places=places
    )


def _geographic(frame: MapFrame, xy: Array, height: Array) -> tuple[Array, Array]:
    """Lon, lat in deg, shape (n, 2), and heights above EGM96, m, of places on the map."""
    lonlat, orthometric = np.empty((len(xy), 2)), np.full(len(xy), np.nan)
    for start in range(0, len(xy), _BATCH):
        part = slice(start, start + _BATCH)
        h = height[part]
        geo = frame.geo_from_map(np.column_stack([xy[part], np.nan_to_num(h)]))
        lonlat[part] = np.degrees(geo[:, 1::-1])
        known = np.isfinite(h) & np.isfinite(geo[:, 0])
        if known.any():
            undulation = geoid_undulation(geo[known, 0], geo[known, 1])
            orthometric[part][known] = h[known] - undulation
    return lonlat, orthometric


def _first_places(frame: MapFrame, xy: Array, height: Array) -> dict[str, Column]:
    lonlat, orthometric = _geographic(frame, xy, height)
    return {
        "lon_deg": Column.of("real", lonlat[:, 0]),
        "lat_deg": Column.of("real", lonlat[:, 1]),
        "height_ellipsoidal_m": Column.of("real", height),
        "height_orthometric_m": Column.of("real", orthometric),
        "height_map": Column.of("real", map_heights(frame, lonlat, height)),
    }


# -- columns -----------------------------------------------------------------------------------


def _source(field: Field) -> str:
    """Name of a field's column in ``assets.gpkg``, where units are not part of the names."""
    unit = next((unit for unit in _UNITS if field.name.endswith(unit)), "")
    return field.name.removesuffix(unit)


# Columns of ``assets.gpkg`` that are written, and the number of a row, which is GDAL's
_KNOWN = frozenset(map(_source, schemas.ASSET_FIELDS)) | {"fid"}


def _column(table: AssetTable, field: Field, kept: NDArray[np.bool_]) -> Column:
    """Values of a field, whatever a GIS user wrote into its column."""
    found = table.columns.get(_source(field))
    if found is None:
        return Column.of(field.kind, [None] * int(kept.sum()))
    values = found[kept]
    if field.kind == "text":
        return Column.of("text", _texts(values))
    if values.dtype != object:
        if field.kind == "real":
            return Column.of("real", values)
        values = values.astype(object)
    read = _whole if field.kind == "integer" else _number
    return Column.of(field.kind, [read(value) for value in values.tolist()])


def _no_numbers(table: AssetTable) -> list[str]:
    """Columns of numbers in which a GIS user wrote something else, with how often."""
    told = []
    for field in schemas.ASSET_FIELDS:
        values = table.columns.get(_source(field))
        if field.kind == "text" or values is None:
            continue
        if values.dtype == object:
            read = _whole if field.kind == "integer" else _number
            bad = sum(x is not None and x != "" and read(x) is None for x in values.tolist())
        else:
            bad = int(np.isinf(values).sum())
        if bad:
            told.append(f"{table.layer}.{field.name} ({bad})")
    return told


def _texts(values: NDArray[Any]) -> list[str | None]:
    if values.dtype != object:
        return [None if math.isnan(x) else str(x) for x in values.tolist()]
    return [None if value is None or value == "" else _text(value) for value in values.tolist()]


def _text(value: Any) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    # a NUL would end the text in most formats, and PostgreSQL refuses it
    return text.replace("\0", "\ufffd")


def _number(value: Any) -> float | None:
    try:
        measured = float(value)
    except (TypeError, ValueError):
        return None
    return measured if math.isfinite(measured) else None


def _whole(value: Any) -> int | None:
    if isinstance(value, int):
        # a float would round what is larger than 2**53
        return value if _SMALLEST <= value <= _LARGEST else None
    measured = _number(value)
    if measured is None or not _SMALLEST <= measured < float(_LARGEST):
        return None
    return int(measured)
