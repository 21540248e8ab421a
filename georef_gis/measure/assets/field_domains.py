"""Classes of assets as field domains of a GeoPackage, which a GIS offers to choose from."""

from __future__ import annotations

import sqlite3

from georef_gis.measure.assets.domain import SHAPES, Domain
from georef_gis.measure.assets.layout import at_once
from georef_gis.measure.assets.tables import LAYERS

# OGC 12-128r17, annex F.9
_EXTENSION = "http://www.geopackage.org/spec/#extension_schema"
_TABLES = """
CREATE TABLE IF NOT EXISTS gpkg_data_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT, description TEXT,
  mime_type TEXT, constraint_name TEXT,
  CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name),
  CONSTRAINT gdc_tn UNIQUE (table_name, name));
CREATE TABLE IF NOT EXISTS gpkg_data_column_constraints (
  constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL, value TEXT, min NUMERIC,
  min_is_inclusive BOOLEAN, max NUMERIC, max_is_inclusive BOOLEAN, description TEXT,
  CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value))
"""
_CONSTRAINTS = {shape: f"{LAYERS[shape].name}_class" for shape in SHAPES}


def enter_classes(connection: sqlite3.Connection, domain: Domain) -> None:
    """State which classes each layer may hold, if the file does not say so yet."""
    wanted = {
        (_CONSTRAINTS[shape], one.name, one.title)
        for shape in SHAPES
        for one in domain.of_shape(shape)
    }
    if _stated(connection) == wanted:
        return
    with at_once(connection):
        _enter(connection, wanted)


def _stated(connection: sqlite3.Connection) -> set[tuple[str, str, str]]:
    there = connection.execute(
        "SELECT 1 FROM sqlite_master WHERE name = 'gpkg_data_column_constraints'"
    ).fetchone()
    if there is None:
        return set()
    found = connection.execute(
        "SELECT constraint_name, value, description FROM gpkg_data_column_constraints"
    ).fetchall()
    ours = set(_CONSTRAINTS.values())
    return {row for row in found if row[0] in ours}


def _enter(connection: sqlite3.Connection, wanted: set[tuple[str, str, str]]) -> None:
    for statement in _TABLES.split(";"):
        connection.execute(statement)
    connection.executemany(
        "DELETE FROM gpkg_data_column_constraints WHERE constraint_name = ?",
        [(name,) for name in _CONSTRAINTS.values()],
    )
    connection.executemany(
        "INSERT INTO gpkg_data_column_constraints (constraint_name, constraint_type, value, "
        "description) VALUES (?, 'enum', ?, ?)",
        sorted(wanted),
    )
    connection.executemany(
        "INSERT OR REPLACE INTO gpkg_data_columns (table_name, column_name, name, "
        "constraint_name) VALUES (?, 'class', 'class', ?)",
        [(LAYERS[shape].name, name) for shape, name in _CONSTRAINTS.items()],
    )
    for table in ("gpkg_data_columns", "gpkg_data_column_constraints"):
        connection.execute("DELETE FROM gpkg_extensions WHERE table_name = ?", (table,))
        connection.execute(
            "INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_schema', ?, 'read-write')",
            (table, _EXTENSION),
        )
