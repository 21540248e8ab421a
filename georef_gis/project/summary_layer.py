"""Outlines and figures of many sites as a GeoPackage, in longitude and latitude (WGS 84)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import ExportError
from georef_gis.project import geopackage
from georef_gis.project.geometry import polygon_wkb, to_blob
from georef_gis.project.schema import Table

if TYPE_CHECKING:
    from georef_gis.frames import Array

LAYER = "sites"
_COLUMNS = {
    "site": "TEXT", "state": "TEXT", "photos": "INTEGER", "posed": "INTEGER", "gsd_m": "REAL",
    "covered_m2": "REAL", "rmse_h_m": "REAL", "check_points_h": "INTEGER", "rmse_v_m": "REAL",
    "check_points_v": "INTEGER", "sigma_horizontal_m": "REAL", "accuracy": "TEXT",
    "duration_s": "REAL", "doubts": "INTEGER", "first_doubts": "TEXT", "message": "TEXT",
    "crs": "TEXT", "finished_utc": "TEXT", "folder": "TEXT",
}  # fmt: skip


def write_summary_layer(path: Path, rows: Iterable[tuple[Mapping[str, Any], Array | None]]) -> None:
    """Write a layer `sites`, a polygon each; a site without an outline has none.

    Parameters
    ----------
    rows
        Values by column, and the closed outline (n, 2) in degrees, longitude first.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    table = Table(
        name=LAYER,
        columns=_COLUMNS,
        geometry="POLYGON",
        description="Sites of a batch: outline of the footprints and figures of the last run",
    )
    path.unlink(missing_ok=True)
    names = ", ".join(f'"{name}"' for name in ("geom", *_COLUMNS))
    marks = ", ".join("?" * (len(_COLUMNS) + 1))
    connection = sqlite3.connect(path)
    try:
        with connection:
            geopackage.create(connection, [table])
            geopackage.set_layer_srs(connection, 4326)
            connection.executemany(
                f"INSERT INTO {LAYER} ({names}) VALUES ({marks})",
                [
                    (_blob(outline), *(values[name] for name in _COLUMNS))
                    for values, outline in rows
                ],
            )
            geopackage.touch(connection, table)
    except sqlite3.Error as error:
        raise ExportError(f"{path}: {error}") from error
    finally:
        connection.close()


def _blob(outline: Array | None) -> bytes | None:
    if outline is None:
        return None
    return to_blob(polygon_wkb([(float(x), float(y)) for x, y in outline]), 4326)[0]
