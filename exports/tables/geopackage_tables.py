"""Tables of a GeoPackage beside its layers: metadata, meaning of fields, styles for QGIS."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from exports.site.columns import Layer


METADATA = """CREATE TABLE site_metadata (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, key TEXT NOT NULL UNIQUE, value TEXT)"""
# As QGIS makes it (QgsOgrProviderMetadata::saveStyle).
STYLES = """CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
  styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT,
  owner TEXT(30), ui TEXT(30),
  update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"""
# OGC 12-128r17, F.9 Schema
COLUMNS = """CREATE TABLE IF NOT EXISTS gpkg_data_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT, description TEXT,
  mime_type TEXT, constraint_name TEXT,
  CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name),
  CONSTRAINT gdc_tn UNIQUE (table_name, name))"""
CONSTRAINTS = """CREATE TABLE IF NOT EXISTS gpkg_data_column_constraints (
  constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL, value TEXT, min NUMERIC,
  min_is_inclusive BOOLEAN, max NUMERIC, max_is_inclusive BOOLEAN, description TEXT,
  CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value))"""
SCHEMA_URL = "http://www.geopackage.org/spec/#extension_schema"


def add_tables(
    path: Path, metadata: Mapping[str, str], layers: Sequence[Layer], *, styles: bool
) -> None:
    """Add the tables in one transaction.

    Raises
    ------
    sqlite3.Error
        If the file cannot be written.
    """
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(METADATA)
        connection.executemany(
            "INSERT INTO site_metadata (key, value) VALUES (?, ?)", metadata.items()
        )
        _enter(connection, "site_metadata", "What this file is and how it was made")
        _add_meanings(connection, layers)
        if styles:
            _add_styles(connection, layers)


def _enter(connection: sqlite3.Connection, table: str, description: str) -> None:
    """List a plain table among the contents, so that a GIS shows it."""
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description) "
        "VALUES (?, 'attributes', ?, ?)",
        (table, table, description),
    )


def _add_meanings(connection: sqlite3.Connection, layers: Sequence[Layer]) -> None:
    connection.execute(COLUMNS)
    connection.execute(CONSTRAINTS)
    connection.execute(
        "CREATE TABLE IF NOT EXISTS gpkg_extensions (table_name TEXT, column_name TEXT, "
        "extension_name TEXT NOT NULL, definition TEXT NOT NULL, scope TEXT NOT NULL, "
        "CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name))"
    )
    connection.executemany(
        "INSERT INTO gpkg_extensions VALUES (?, NULL, 'gpkg_schema', ?, 'read-write')",
        [("gpkg_data_columns", SCHEMA_URL), ("gpkg_data_column_constraints", SCHEMA_URL)],
    )
    connection.executemany(
        "INSERT INTO gpkg_data_columns (table_name, column_name, title, description) "
        "VALUES (?, ?, ?, ?)",
        [
            (layer.name, f.name, f"{f.name.replace('_', ' ')}", f.doc)
            for layer in layers
            for f in layer.fields
        ],
    )


def _add_styles(connection: sqlite3.Connection, layers: Sequence[Layer]) -> None:
    connection.execute(STYLES)
    _enter(connection, "layer_styles", "Styles for QGIS")
    for layer in layers:
        style = resources.files("exports").joinpath(f"styles/{layer.name}.qml")
        if style.is_file():
            connection.execute(
                "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
                "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, "
                "owner) VALUES ('', '', ?, 'geom', ?, ?, '', 1, ?, '')",
                (layer.name, layer.name, style.read_text("utf-8"), f"{layer.title} by georef_gis"),
            )
