"""Files of sheets: their index, and which of those that are there are ours."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import ExportError
from georef_gis.project import geopackage
from georef_gis.project.geometry import to_blob
from georef_gis.project.schema import Table

if TYPE_CHECKING:
    from georef_gis.geodesy import CRS
    from georef_gis.mosaic.sheet_cut import Sheet

INDEX_FILE = "sheets.gpkg"
SOFTWARE = "georef_gis"
LAYER = Table(
    name="sheets",
    description="Sheets that a raster was cut into, by chainage along the layer centre_line",
    geometry="MULTIPOLYGON",
    columns={"name": "TEXT", "from_m": "REAL", "to_m": "REAL", "file": "TEXT"},
)
LINE_LAYER = Table(
    name="centre_line",
    description="Line that the sheets follow",
    geometry="LINESTRING",
    columns={"length_m": "REAL"},
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SheetFile:
    """A sheet that was written."""

    sheet: Sheet
    path: Path


def own_sheets(folder: Path) -> set[Path]:
    """Sheets in a folder that an earlier run wrote: they say so themselves."""
    return {path for path in folder.glob("*_sheet_*.tif") if _is_own(path)}


def _is_own(path: Path) -> bool:
    from georef_gis.rasters.parts import items_or_none

    items = items_or_none(path) or {}
    return items.get("SOFTWARE") == SOFTWARE and items.get("SHEET") == path.stem


def check_free(paths: Sequence[Path], own: set[Path], index: Path) -> None:
    """Refuse to write over files that are not ours.

    Raises
    ------
    ExportError
        On the first one.
    """
    for path in paths:
        if path.exists() and path not in own:
            raise ExportError(f"{path}: is there and is no sheet of ours; move it elsewhere")
    if index.exists() and not _is_own_index(index):
        raise ExportError(f"{index}: is there and is no index of our sheets; move it elsewhere")


def _is_own_index(path: Path) -> bool:
    uri = f"{path.absolute().as_uri()}?mode=ro"
    try:
        with contextlib.closing(sqlite3.connect(uri, uri=True)) as connection:
            found = connection.execute(
                "SELECT description FROM gpkg_contents WHERE table_name = ?", (LAYER.name,)
            ).fetchone()
    except sqlite3.Error:
        return False
    return found is not None and found[0] == LAYER.description


@contextlib.contextmanager
def refusals(path: Path) -> Iterator[None]:
    """Errors of SQLite and of the system as one line with a cure."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        told = error.strerror if isinstance(error, OSError) else str(error)
        raise ExportError(
            f"{path}: cannot be written ({told}); check the permission and the free space"
        ) from error


def write_index(
    path: Path, files: Sequence[SheetFile], line: Any, crs: CRS, *, metres: float
) -> None:
    """Write the index of sheets and their line, whole or not at all.

    Parameters
    ----------
    metres
        In a unit of the map.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    with refusals(path):
        part.unlink(missing_ok=True)
        try:
            with contextlib.closing(sqlite3.connect(part, isolation_level=None)) as connection:
                connection.execute("BEGIN")
                _fill(connection, files, line, crs, metres)
                connection.execute("COMMIT")
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def _fill(
    connection: sqlite3.Connection, files: Sequence[SheetFile], line: Any, crs: CRS, metres: float
) -> None:
    import shapely

    geopackage.create(connection, (LAYER, LINE_LAYER))
    srs = geopackage.add_srs(connection, crs.name, crs.to_wkt("WKT1_GDAL"), crs.to_epsg(), "")
    geopackage.set_layer_srs(connection, srs)

    def blob(shape: Any) -> bytes:
        return to_blob(shapely.to_wkb(shape, byte_order=1), srs)[0]

    for file in files:
        sheet = file.sheet
        area = shapely.multipolygons(shapely.get_parts(sheet.area))
        connection.execute(
            "INSERT INTO sheets (geom, name, from_m, to_m, file) VALUES (?, ?, ?, ?, ?)",
            (blob(area), file.path.stem, sheet.start * metres, sheet.end * metres, file.path.name),
        )
    connection.execute(
        "INSERT INTO centre_line (geom, length_m) VALUES (?, ?)", (blob(line), line.length * metres)
    )
    for layer in (LAYER, LINE_LAYER):
        geopackage.touch(connection, layer)
