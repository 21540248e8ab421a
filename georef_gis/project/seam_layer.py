"""Seams of the mosaic as a layer that is edited in a GIS: ``seams.gpkg`` in the project folder.

Layer `seams` holds a polygon per photo: the ground that the mosaic takes from it. Table
`seams_computed` keeps the polygons as they were written. A user who moves a border, redraws a
polygon, enters another `photo` or raises a `priority` makes the two differ, and that is how an
edited layer is told from one that may be computed anew; other columns do not count. What an
editor cannot know is mended in reading, and told: `seam_repair`.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import CrsError, InputError
from georef_gis.project import geopackage
from georef_gis.project.database import CURES, Srs
from georef_gis.project.geometry import from_blob, to_blob
from georef_gis.project.schema import Table
from georef_gis.project.seam_repair import Cell, Seam, mend

if TYPE_CHECKING:
    from georef_gis.geodesy import CRS

SEAMS_FILE = "seams.gpkg"
LAYER = Table(
    name="seams",
    description="Ground that the mosaic takes from each photo; edit it, then run the mosaic again",
    geometry="MULTIPOLYGON",
    columns={"photo": "TEXT", "priority": "INTEGER"},
)
COMPUTED = Table(
    name="seams_computed",
    description="The seams as computed, to find what was edited; leave it as it is",
    columns={"photo": "TEXT", "priority": "INTEGER", "area": "BLOB"},
)
# s; reading waits so long for another program's commit
BUSY_TIMEOUT = 5.0
START_ANEW = "delete the file to have the seams computed anew"


@dataclass(frozen=True, slots=True, kw_only=True)
class Seams:
    """Seams as read.

    Parameters
    ----------
    cells
        Photo and its area in the project CRS, one each: a coverage without overlaps.
    edited
        Whether the layer differs from what was written.
    notes
        What was mended, a line each.
    """

    cells: tuple[Seam, ...]
    edited: bool
    notes: tuple[str, ...]


def write_seams(path: Path, seams: Sequence[Seam], srs: Srs) -> None:
    """Write the layer, whole or not at all, in place of the one that is there.

    Parameters
    ----------
    seams
        Photo and its area in the CRS.

    Raises
    ------
    InputError
        If the file cannot be written, or another program has it open.
    """
    part = path.with_name(f".{path.name}.part")
    with _refusals(path):
        if path.exists():
            _check_unused(path)
        part.unlink(missing_ok=True)
        try:
            with contextlib.closing(sqlite3.connect(part, isolation_level=None)) as connection:
                connection.execute("BEGIN")
                _fill(connection, seams, srs)
                connection.execute("COMMIT")
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


def _check_unused(path: Path) -> None:
    """Refuse a file that others have open; leave no journal beside it, nor lose what is in one."""
    with contextlib.closing(sqlite3.connect(path, timeout=0.0, isolation_level=None)) as connection:
        # A GIS that has it open in WAL mode keeps anyone from leaving that mode.
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("BEGIN EXCLUSIVE")
        connection.execute("ROLLBACK")


def _fill(connection: sqlite3.Connection, seams: Sequence[Seam], srs: Srs) -> None:
    import shapely

    geopackage.create(connection, (LAYER, COMPUTED))
    srs_id = geopackage.add_srs(connection, srs.name, srs.wkt, srs.code, srs.description)
    geopackage.set_layer_srs(connection, srs_id)
    for photo, area in seams:
        wkb = shapely.to_wkb(area, byte_order=1)
        connection.execute(
            "INSERT INTO seams (geom, photo, priority) VALUES (?, ?, 0)",
            (to_blob(wkb, srs_id)[0], photo),
        )
        connection.execute(
            "INSERT INTO seams_computed (photo, priority, area) VALUES (?, 0, ?)", (photo, wkb)
        )
    geopackage.touch(connection, LAYER)


def read_seams(path: Path, *, photos: Collection[str], crs_wkt: str) -> Seams:
    """Seams that a user may have edited, as a coverage in the project CRS.

    Parameters
    ----------
    photos
        Names that the layer may hold.
    crs_wkt
        Project CRS, projected.

    Raises
    ------
    InputError
        If there is no such layer, it is empty, cannot be read, or names a photo that is none.
    CrsError
        If its CRS is unknown or cannot be transformed into that of the project.
    """
    from georef_gis.geodesy import CRS, metres_per_unit

    if not path.is_file():
        raise InputError("there is no such file; run the mosaic to have it written",
                         source=str(path))  # fmt: skip
    with _refusals(path), _open(path) as connection:
        column, srs_row = _layer(connection, path)
        cells, notes = _cells(connection, column, path)
        computed = _computed(connection)
    edited = _differ(cells, computed)
    cells = _known(cells, photos, {cell.photo for cell in computed}, notes, path)
    target = CRS.from_wkt(crs_wkt)
    source = _source_crs(srs_row, path)
    if not _is_same(source, target):
        cells, computed = (
            _moved(cells, source, target, path),
            _moved(computed, source, target, path),
        )
        notes.append(f"layer seams was transformed from '{source.name}' to '{target.name}'")
    if not edited and not notes:
        return Seams(cells=tuple((c.photo, c.area) for c in cells), edited=False, notes=())
    known = [cell for cell in computed if cell.photo in photos]
    seams, told = mend(cells, known, metres=metres_per_unit(target))
    notes = [f"{path.name}: {note}" for note in (*notes, *told)]
    return Seams(cells=tuple(seams), edited=edited, notes=tuple(notes))


def is_edited(path: Path) -> bool:
    """Whether the layer differs from what was written, or cannot be compared; False if none."""
    if not path.is_file():
        return False
    try:
        with _refusals(path), _open(path) as connection:
            column, _ = _layer(connection, path)
            cells, _ = _cells(connection, column, path)
            return _differ(cells, _computed(connection))
    except InputError:
        # who uses it says what is wrong
        return True


def _differ(cells: Sequence[Cell], computed: Sequence[Cell]) -> bool:
    return sorted(map(_content, cells)) != sorted(map(_content, computed))


@contextlib.contextmanager
def _refusals(path: Path) -> Iterator[None]:
    """Errors of SQLite and of the system as one line with a cure."""
    try:
        yield
    except sqlite3.Error as error:
        words = str(error)
        cure = next((cure for word, cure in CURES.items() if word in words), "")
        if "locked" in words:
            cure = "it is open in another program, such as QGIS: save or close it there"
        raise InputError(f"cannot be used ({words}); {cure}", source=str(path)) from error
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror}); check the permission and the free space",
            source=str(path),
        ) from error


@contextlib.contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    uri = f"{path.absolute().as_uri()}?mode=ro"
    with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=BUSY_TIMEOUT)) as connection:
        connection.row_factory = sqlite3.Row
        yield connection


def _layer(connection: sqlite3.Connection, path: Path) -> tuple[str, sqlite3.Row | None]:
    """Geometry column of the layer, and the row of its CRS."""
    names = geopackage.table_names(connection)
    if "gpkg_geometry_columns" not in names:
        raise InputError(f"is no GeoPackage; {START_ANEW}", source=str(path))
    layers = {
        row["table_name"]: row
        for row in connection.execute("SELECT * FROM gpkg_geometry_columns").fetchall()
    }
    if "seams" not in layers:
        found = ", ".join(sorted(layers)) or "none"
        raise InputError(
            f"has no layer 'seams' (layers: {found}); name the layer so, or {START_ANEW}",
            source=str(path),
        )
    row = layers["seams"]
    srs = connection.execute(
        "SELECT * FROM gpkg_spatial_ref_sys WHERE srs_id = ?", (row["srs_id"],)
    ).fetchone()
    return str(row["column_name"]), srs


def _cells(connection: sqlite3.Connection, column: str, path: Path) -> tuple[list[Cell], list[str]]:
    """Features in the order they were drawn, and what was left out."""
    found = connection.execute("SELECT rowid AS place, * FROM seams ORDER BY rowid").fetchall()
    if found and "photo" not in {key.lower() for key in found[0].keys()}:
        raise InputError(f"has no column 'photo'; add it, or {START_ANEW}", source=str(path),
                         field="seams")  # fmt: skip
    cells, notes = [], []
    for row in found:
        values = {key.lower(): row[key] for key in row.keys()}
        place, blob = int(values["place"]), row[column]
        area = None if blob is None else _area(blob, place, path)
        if area is None or area.is_empty:
            notes.append(f"feature {place} has no polygon and was left out")
            continue
        cells.append(
            Cell(
                fid=place,
                photo=str(values["photo"] or ""),
                priority=_priority(values.get("priority"), place, path),
                area=area,
            )
        )
    if not cells:
        raise InputError(f"has no polygon; draw some, or {START_ANEW}", source=str(path),
                         field="seams")  # fmt: skip
    return cells, notes


def _area(blob: bytes, place: int, path: Path) -> Any:
    import shapely

    try:
        area = shapely.force_2d(shapely.from_wkb(from_blob(blob)))
    except (shapely.errors.GEOSException, IndexError, TypeError) as error:
        raise InputError(
            f"its geometry cannot be read ({str(error).splitlines()[0]}); draw it anew",
            source=str(path), field=f"feature {place}",
        ) from error  # fmt: skip
    if not area.is_empty and area.geom_type not in ("Polygon", "MultiPolygon"):
        raise InputError(f"is a {area.geom_type}, not a polygon; draw a polygon",
                         source=str(path), field=f"feature {place}")  # fmt: skip
    return area


def _priority(value: Any, place: int, path: Path) -> float:
    try:
        return float(value or 0)
    except (TypeError, ValueError) as error:
        raise InputError(f"priority {str(value)[:20]!r} is no number; enter one or leave it empty",
                         source=str(path), field=f"feature {place}") from error  # fmt: skip


def _computed(connection: sqlite3.Connection) -> list[Cell]:
    """Seams as they were written; none in a file that is not of our writing."""
    import shapely

    if COMPUTED.name not in geopackage.table_names(connection):
        return []
    found = connection.execute("SELECT fid, photo, area FROM seams_computed ORDER BY fid")
    return [
        Cell(fid=int(fid), photo=photo, priority=0.0, area=shapely.from_wkb(area))
        for fid, photo, area in found
    ]


def _content(cell: Cell) -> tuple[str, float, bytes]:
    """What a user edits."""
    import shapely

    return cell.photo, cell.priority, shapely.to_wkb(cell.area, byte_order=1)


def _known(
    cells: Sequence[Cell],
    photos: Collection[str],
    before: Collection[str],
    notes: list[str],
    path: Path,
) -> list[Cell]:
    """Cells of photos; those of photos that the mosaic had `before` are left out."""
    from difflib import get_close_matches

    known, gone = set(photos), set(before) - set(photos)
    left_out = sorted({cell.photo for cell in cells} & gone)
    if left_out:
        few = ", ".join(f"'{name}'" for name in left_out[:3])
        few += " ..." if len(left_out) > 3 else ""
        notes.append(f"photos no longer in the mosaic ({few}): their ground "
                     "is left to no photo")  # fmt: skip
    for cell in cells:
        if cell.photo in known or cell.photo in gone:
            continue
        where = f"feature {cell.fid}"
        if not cell.photo:
            raise InputError("names no photo; enter one in the column photo",
                             source=str(path), field=where)  # fmt: skip
        close = get_close_matches(cell.photo, sorted(known), n=3, cutoff=0.6)
        cure = f"did you mean {' or '.join(close)}?" if close else START_ANEW
        raise InputError(f"'{cell.photo}' is no photo of the mosaic; {cure}", source=str(path),
                         field=where)  # fmt: skip
    return [cell for cell in cells if cell.photo in known]


def _source_crs(row: sqlite3.Row | None, path: Path) -> CRS:
    """CRS that the file states for the layer."""
    from georef_gis.geodesy import parse_crs

    values = {} if row is None else dict(row)
    # WKT of the first kind, which GeoPackages hold, does not tell all of some CRSs.
    if str(values.get("organization")).upper() == "EPSG":
        return parse_crs(f"EPSG:{values['organization_coordsys_id']}")
    wkt = next(
        (
            values[key]
            for key in ("definition_12_063", "definition")
            if values.get(key) not in (None, "", "undefined")
        ),
        "",
    )
    if not wkt:
        raise CrsError("layer seams has no CRS; state it in the GIS (Set Layer CRS, then save the "
                       f"layer), or {START_ANEW}", source=str(path))  # fmt: skip
    return parse_crs(str(wkt))


def _is_same(first: CRS, second: CRS) -> bool:
    code = first.to_epsg()
    return (code is not None and code == second.to_epsg()) or bool(
        first.equals(second, ignore_axis_order=True)
    )


def _moved(cells: list[Cell], source: CRS, target: CRS, path: Path) -> list[Cell]:
    """Cells in another CRS."""
    import numpy as np
    import shapely

    from georef_gis.geodesy.reference_systems import horizontal_crs, transformer_between

    step = transformer_between(horizontal_crs(source), horizontal_crs(target))
    if not cells:
        return []

    def move(xy: Any) -> Any:
        out = np.column_stack(step.transform(xy[:, 0], xy[:, 1]))
        if not np.isfinite(out).all():
            raise CrsError(
                f"layer seams does not lie where '{target.name}' holds; {START_ANEW}",
                source=str(path),
            )
        return out

    areas = shapely.transform([cell.area for cell in cells], move)
    return [
        Cell(fid=cell.fid, photo=cell.photo, priority=cell.priority, area=area)
        for cell, area in zip(cells, areas, strict=True)
    ]
