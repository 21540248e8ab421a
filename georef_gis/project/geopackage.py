"""What makes an SQLite file a GeoPackage 1.3 (OGC 12-128r17): its tables of contents."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from georef_gis.project.geometry import from_blob, to_blob
from georef_gis.project.schema import Table

# Kinds of columns that are text in the file
CODED = ("JSON", "PATH")
# "GPKG" and version 1.3.0
APPLICATION_ID = 0x47504B47
USER_VERSION = 10300
# Numbers for CRSs that EPSG does not know
FIRST_OWN_SRS = 300_000
# What SQLite adds to the name of a database
_JOURNALS = ("-wal", "-shm", "-journal")

CONTENTS = """
CREATE TABLE gpkg_spatial_ref_sys (
  srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT,
  definition_12_063 TEXT NOT NULL DEFAULT 'undefined', epoch DOUBLE);
CREATE TABLE gpkg_contents (
  table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '',
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id));
CREATE TABLE gpkg_extensions (
  table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL,
  scope TEXT NOT NULL,
  CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name))
"""
EXTENSION = (
    "gpkg_spatial_ref_sys", "definition_12_063", "gpkg_crs_wkt_1_1",
    "http://www.geopackage.org/spec/#extension_crs_wkt", "read-write",
)  # fmt: skip
WGS84 = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
    'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,'
    'AUTHORITY["EPSG","8901"]],UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],'
    'AXIS["Latitude",NORTH],AXIS["Longitude",EAST],AUTHORITY["EPSG","4326"]]'
)
REQUIRED_SRS = (
    ("Undefined cartesian SRS", -1, "NONE", -1, "undefined", "undefined Cartesian"),
    ("Undefined geographic SRS", 0, "NONE", 0, "undefined", "undefined geographic"),
    ("WGS 84 geodetic", 4326, "EPSG", 4326, WGS84, "longitude/latitude on WGS 84"),
)


@contextmanager
def journals_aside(path: Path) -> Iterator[None]:
    """Keep the journals of a database from the file that takes its place within the block.

    SQLite knows them by their names alone: what a GIS that has the old file open, or was killed,
    left in them would be played into the new one. If the block fails, the old file has them again,
    for they may hold what it lacks.

    Raises
    ------
    OSError
        If one cannot be moved, as on Windows while another program has it open.
    """
    aside: dict[Path, Path] = {}
    try:
        for ending in _JOURNALS:
            journal = path.with_name(f"{path.name}{ending}")
            with suppress(FileNotFoundError):
                other = path.with_name(f".{journal.name}.{os.getpid()}.aside")
                os.replace(journal, other)
                aside[journal] = other
        yield
    except BaseException:
        for journal, other in aside.items():
            with suppress(OSError):
                os.replace(other, journal)
        raise
    for other in aside.values():
        # the new file is in its place: what is left has a name that SQLite does not know
        with suppress(OSError):
            other.unlink()


def table_names(connection: sqlite3.Connection) -> set[str]:
    """Names of the tables in a file."""
    found = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
    return {row[0] for row in found.fetchall() if not row[0].startswith("sqlite_")}


def create(connection: sqlite3.Connection, tables: Iterable[Table]) -> None:
    """Lay out an empty file; the caller holds the transaction."""
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {USER_VERSION}")
    for statement in CONTENTS.split(";"):
        connection.execute(statement)
    connection.execute("INSERT INTO gpkg_extensions VALUES (?, ?, ?, ?, ?)", EXTENSION)
    connection.executemany(
        "INSERT INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization, "
        "organization_coordsys_id, definition, description) VALUES (?, ?, ?, ?, ?, ?)",
        REQUIRED_SRS,
    )
    for table in tables:
        add_table(connection, table)


def add_table(connection: sqlite3.Connection, table: Table) -> None:
    """Add an empty table, a layer without a CRS yet; the caller holds the transaction."""
    columns = ["fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL"]
    if table.geometry:
        columns.append(f"geom {table.geometry}")
    # Keys are NOT NULL: SQLite takes two NULLs for different.
    columns += [
        f'"{name}" {"TEXT" if kind in CODED else kind}{" NOT NULL" if name in table.key else ""}'
        for name, kind in table.columns.items()
    ]
    if table.key:
        columns.append(f"UNIQUE ({', '.join(table.key)})")
    connection.execute(f"CREATE TABLE {table.name} ({', '.join(columns)})")
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
        "VALUES (?, ?, ?, ?, ?)",
        (
            table.name,
            "features" if table.geometry else "attributes",
            table.name,
            table.description,
            -1 if table.geometry else None,
        ),
    )
    if table.geometry:
        # z: 0 = prohibited, 2 = optional
        connection.execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, -1, ?, 0)",
            (table.name, table.geometry, 2 if table.has_z else 0),
        )


def add_srs(
    connection: sqlite3.Connection, name: str, wkt: str, code: int | None, description: str
) -> int:
    """Number of a CRS in the file, which is entered if it is not there yet."""
    if code is not None:
        srs_id, organization, organization_id = code, "EPSG", code
    else:
        found = connection.execute(
            "SELECT srs_id FROM gpkg_spatial_ref_sys WHERE definition_12_063 = ? AND srs_id >= ?",
            (wkt, FIRST_OWN_SRS),
        ).fetchone()
        if found:
            return int(found[0])
        largest = connection.execute("SELECT max(srs_id) FROM gpkg_spatial_ref_sys").fetchone()[0]
        srs_id = organization_id = max(int(largest) + 1, FIRST_OWN_SRS)
        organization = "NONE"
    wkt1, wkt2 = (wkt, "undefined") if is_wkt1(wkt) else ("undefined", wkt)
    connection.execute(
        "INSERT OR IGNORE INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization, "
        "organization_coordsys_id, definition, description, definition_12_063) "
        "VALUES (?, ?, ?, ?, ?, ?, ?)",
        (name, srs_id, organization, organization_id, wkt1, description, wkt2),
    )
    return srs_id


def is_wkt1(wkt: str) -> bool:
    """Whether a text is WKT of the first kind, with GEOGCS and PROJCS."""
    return wkt.lstrip().startswith(("GEOGCS", "PROJCS", "COMPD_CS", "GEOCCS", "LOCAL_CS"))


def set_layer_srs(connection: sqlite3.Connection, srs_id: int) -> None:
    """Enter a CRS as that of every feature layer."""
    connection.execute("UPDATE gpkg_geometry_columns SET srs_id = ?", (srs_id,))
    connection.execute(
        "UPDATE gpkg_contents SET srs_id = ?, min_x = NULL, min_y = NULL, max_x = NULL, "
        "max_y = NULL WHERE data_type = 'features'",
        (srs_id,),
    )


def touch(connection: sqlite3.Connection, table: Table) -> None:
    """Note that a table changed, and the bounds of its features."""
    connection.execute(
        "UPDATE gpkg_contents SET last_change = strftime('%Y-%m-%dT%H:%M:%fZ','now') "
        "WHERE table_name = ?",
        (table.name,),
    )
    if not table.geometry:
        return
    found = connection.execute(f"SELECT geom FROM {table.name} WHERE geom IS NOT NULL")
    boxes = [to_blob(from_blob(row[0]), 0)[1] for row in found]
    known = [box for box in boxes if box is not None]
    bounds: tuple[float | None, ...] = (None, None, None, None)
    if known:
        west, south, east, north = zip(*known, strict=True)
        bounds = (min(west), min(south), max(east), max(north))
    connection.execute(
        "UPDATE gpkg_contents SET min_x = ?, min_y = ?, max_x = ?, max_y = ? WHERE table_name = ?",
        (*bounds, table.name),
    )
