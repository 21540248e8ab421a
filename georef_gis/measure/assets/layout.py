"""Layout of ``assets.gpkg``: made where there is none, made whole where another program broke it.

A GIS may drop a layer or a column, or write a layer anew with fewer of them. As what was known of
every asset stands in tables of the store's own, nothing is lost by that: the layout is put right,
and what the rows lack is an edit that can be undone.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator

from georef_gis.errors import InputError
from georef_gis.measure.assets.tables import ELLIPSES, HISTORY, KNOWN, LAYERS, TABLES
from georef_gis.project import geopackage
from georef_gis.project.database import Srs
from georef_gis.project.schema import Table

_INDEX = f"{ELLIPSES.name}_by_asset"
_CONTENTS = ("gpkg_extensions", "gpkg_geometry_columns", "gpkg_contents")


@contextlib.contextmanager
def at_once(connection: sqlite3.Connection) -> Iterator[None]:
    """All writes inside happen, or none."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            connection.execute("ROLLBACK")
        raise


def lay_out(connection: sqlite3.Connection, srs: Srs) -> None:
    """Lay out an empty file, at once: another process may be about to do it too."""
    with at_once(connection):
        if not geopackage.table_names(connection):
            geopackage.create(connection, TABLES)
            srs_id = geopackage.add_srs(connection, srs.name, srs.wkt, srs.code, srs.description)
            geopackage.set_layer_srs(connection, srs_id)


def is_whole(connection: sqlite3.Connection) -> bool:
    """Whether nothing is missing that `make_whole` can put right."""
    names = geopackage.table_names(connection)
    if not _is_ours(names):
        return True
    if any(table.name not in names or _missing_columns(connection, table)
           for table in TABLES):  # fmt: skip
        return False
    found = connection.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (_INDEX,))
    return found.fetchone() is not None


def make_whole(connection: sqlite3.Connection, srs: Srs) -> None:
    """Add the layers and columns that are missing; the caller holds the transaction."""
    names = geopackage.table_names(connection)
    if not _is_ours(names):
        return
    srs_id = geopackage.add_srs(connection, srs.name, srs.wkt, srs.code, srs.description)
    for table in TABLES:
        if table.name not in names:
            for contents in _CONTENTS:
                connection.execute(f"DELETE FROM {contents} WHERE table_name = ?", (table.name,))
            geopackage.add_table(connection, table)
            for contents in _CONTENTS[1:]:
                connection.execute(
                    f"UPDATE {contents} SET srs_id = ? WHERE table_name = ? AND srs_id = -1",
                    (srs_id, table.name),
                )
        for column in _missing_columns(connection, table):
            kind = table.columns[column]
            connection.execute(f'ALTER TABLE {table.name} ADD COLUMN "{column}" {kind}')
    # without it, every edit would read all ellipses
    connection.execute(f"CREATE INDEX IF NOT EXISTS {_INDEX} ON {ELLIPSES.name} (asset_id)")


def checked_srs(connection: sqlite3.Connection, srs: Srs, source: str) -> int:
    """Number of the layers' CRS in the file.

    Raises
    ------
    InputError
        If the file lacks a layer, or is in another CRS than the project.
    """
    from georef_gis.geodesy.reference_systems import same_crs

    names = geopackage.table_names(connection)
    if "gpkg_geometry_columns" not in names:
        raise InputError("is no GeoPackage; move it away, then a new one is made", source=source)
    for table in TABLES:
        if table.name not in names:
            raise InputError(f"has no table {table.name}; move the file away, then a new one is "
                             "made", source=source)  # fmt: skip
        _check_layer(connection, table, source)
    found = connection.execute(
        "SELECT g.srs_id, s.definition, s.definition_12_063, s.srs_name "
        "FROM gpkg_geometry_columns g JOIN gpkg_spatial_ref_sys s ON s.srs_id = g.srs_id "
        "WHERE g.table_name = ?",
        (LAYERS["point"].name,),
    ).fetchone()
    if found is None:
        raise InputError("its layers have no CRS; state it in the GIS", source=source)
    srs_id = int(found[0])
    if srs_id == srs.code:
        return srs_id
    wkt = found[2] if found[1] in (None, "", "undefined") else found[1]
    if not same_crs(str(wkt), srs.wkt):
        raise InputError(f"is in '{found[3]}', the project in '{srs.name}'; give the project that "
                         "CRS again, or move the file away", source=source)  # fmt: skip
    return srs_id


def _check_layer(connection: sqlite3.Connection, table: Table, source: str) -> None:
    needed = ("fid", "geom") if table.geometry else ("fid",)
    lacks = [column for column in needed if column not in _columns(connection, table.name)]
    if lacks:
        raise InputError(
            f"layer {table.name} has no column {lacks[0]}: another program wrote it anew; call it "
            "so there, or put a copy of the file in its place",
            source=source,
        )


def _is_ours(names: set[str]) -> bool:
    return {KNOWN.name, HISTORY.name} <= names


def _missing_columns(connection: sqlite3.Connection, table: Table) -> list[str]:
    # SQLite takes names that differ in case for one
    there = {name.lower() for name in _columns(connection, table.name)}
    return [column for column in table.columns if column.lower() not in there]


def _columns(connection: sqlite3.Connection, table: str) -> list[str]:
    return [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
