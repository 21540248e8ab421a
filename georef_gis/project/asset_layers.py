"""Layers of ``assets.gpkg`` as they stand, read by who shows them; `measure.assets` keeps them."""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError
from georef_gis.project import geopackage
from georef_gis.project.geometry import from_blob, geometry_type

ASSETS_FILE = "assets.gpkg"
ASSET_LAYERS = ("asset_points", "asset_lines", "asset_polygons")
ELLIPSE_LAYER = "asset_ellipses"
# s
_WAIT = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AssetRow:
    """A feature of a layer.

    Parameters
    ----------
    values
        Its columns but the geometry; those of its accuracy only while they hold.
    wkb
        None if it has no geometry.
    """

    layer: str
    values: Mapping[str, Any]
    wkb: bytes | None


def read_asset_rows(path: Path, crs_wkt: str) -> list[AssetRow]:
    """Features of the layers of assets, then their ellipses; none without a file.

    Accuracy of a feature that another program moved since is left out: it was that of another
    place.

    Parameters
    ----------
    crs_wkt
        Project CRS.

    Raises
    ------
    InputError
        If the file cannot be read, or is in another CRS.
    """
    if not path.is_file():
        return []
    with _reading(path) as connection:
        names = geopackage.table_names(connection)
        if ASSET_LAYERS[0] not in names or "gpkg_geometry_columns" not in names:
            return []
        _check_crs(connection, crs_wkt, path)
        known = _known_places(connection) if "asset_known" in names else {}
        layers = [layer for layer in (*ASSET_LAYERS, ELLIPSE_LAYER) if layer in names]
        rows = [_row(layer, row) for layer in layers
                for row in connection.execute(f"SELECT * FROM {layer}").fetchall()]  # fmt: skip
    moved = {
        row.values.get("asset_id")
        for row in rows
        if row.layer != ELLIPSE_LAYER
        and not same_place(row.wkb, known.get(row.values.get("asset_id")))
    }
    return [
        _without_accuracy(row) if row.values.get("asset_id") in moved else row
        for row in rows
        if row.layer != ELLIPSE_LAYER or row.values.get("asset_id") not in moved
    ]


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    uri = f"{path.absolute().as_uri()}?mode=ro"
    try:
        with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=_WAIT)) as connection:
            connection.row_factory = sqlite3.Row
            yield connection
    except sqlite3.Error as error:
        cure = "save or end the editing in the program that has it open, such as QGIS"
        raise InputError(f"cannot be read ({error}); {cure}", source=str(path)) from error


def _check_crs(connection: sqlite3.Connection, crs_wkt: str, path: Path) -> None:
    from georef_gis.geodesy.reference_systems import same_crs

    row = connection.execute(
        "SELECT s.* FROM gpkg_geometry_columns g JOIN gpkg_spatial_ref_sys s USING (srs_id) "
        "WHERE g.table_name = ?",
        (ASSET_LAYERS[0],),
    ).fetchone()
    if row is None:
        raise InputError("its layers have no CRS; state it in the GIS", source=str(path))
    names = ("definition", "definition_12_063")
    wkt = next((row[n] for n in names if row[n] not in (None, "", "undefined")), "")
    if not same_crs(str(wkt), crs_wkt):
        raise InputError(f"is in '{row['srs_name']}', which is not the project's CRS; give the "
                         "project that CRS again, or move the file away",
                         source=str(path))  # fmt: skip


def _row(layer: str, row: sqlite3.Row) -> AssetRow:
    values = dict(row)
    blob = values.pop("geom", None)
    is_blob = isinstance(blob, bytes) and len(blob) > 8 and blob[:2] == b"GP"
    return AssetRow(layer=layer, values=values, wkb=from_blob(blob) if is_blob else None)


def _known_places(connection: sqlite3.Connection) -> dict[Any, bytes | None]:
    """Geometry of each asset as it was when its accuracy was stated."""
    found = connection.execute("SELECT asset_id, content FROM asset_known").fetchall()
    out: dict[Any, bytes | None] = {}
    for asset_id, content in found:
        with contextlib.suppress(AttributeError, KeyError, TypeError, ValueError):
            out[asset_id] = bytes.fromhex(json.loads(content)["geom"]["hex"])
    return out


def same_place(first: bytes | None, second: bytes | None) -> bool:
    """Whether two geometries are one up to rounding; another program may write one anew."""
    import numpy as np
    import shapely

    if first == second or first is None or second is None:
        return first == second
    if geometry_type(first)[0] != geometry_type(second)[0]:
        return False
    try:
        a, b = (shapely.get_coordinates(shapely.from_wkb(wkb)) for wkb in (first, second))
    except shapely.errors.GEOSException:
        return False
    # CRS units: far below a click, far above the rounding of a double
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=0.0, atol=1e-6))


def _without_accuracy(row: AssetRow) -> AssetRow:
    measured = ("sigma_e", "sigma_n", "sigma_u", "corr_en", "semi_major", "semi_minor", "azimuth",
                "conf", "dof", "n_rays", "photo_ids", "pixels")  # fmt: skip
    values = {**row.values, **dict.fromkeys(measured), "method": "edited"}
    return AssetRow(layer=row.layer, values=values, wkb=row.wkb)
