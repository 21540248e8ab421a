"""Layers of georef.gpkg to which a GIS gave a spatial index."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from georef_gis.project.database import Database
from georef_gis.project.geometry import point_wkb
from georef_gis.project.spatial_index import add_functions

# As GDAL makes it for a column `geom`.
INDEX = """
CREATE VIRTUAL TABLE rtree_control_geom USING rtree(id, minx, maxx, miny, maxy);
CREATE TRIGGER rtree_control_geom_insert AFTER INSERT ON control
  WHEN (new.geom NOT NULL AND NOT ST_IsEmpty(NEW.geom)) BEGIN
  INSERT OR REPLACE INTO rtree_control_geom VALUES (NEW.fid, ST_MinX(NEW.geom),
  ST_MaxX(NEW.geom), ST_MinY(NEW.geom), ST_MaxY(NEW.geom)); END;
"""


def test_layer_with_an_index_takes_rows_and_keeps_the_index_true(tmp_path: Path) -> None:
    path = tmp_path / "georef.gpkg"
    Database(path).close()
    with closing(sqlite3.connect(path)) as other:
        other.executescript(INDEX)
    with Database(path) as database:
        database.add_rows("control", [{"name": "P1", "role": "check", "geom": point_wkb(3.0, 5.0)}])
    with closing(sqlite3.connect(path)) as other:
        found = other.execute("SELECT minx, maxx, miny, maxy FROM rtree_control_geom").fetchall()
    assert found == [(3.0, 3.0, 5.0, 5.0)]


def test_what_is_no_geometry_has_no_bounds() -> None:
    with closing(sqlite3.connect(":memory:")) as connection:
        add_functions(connection)
        odd: tuple[Any, ...] = (b"", b"GP", b"GP\x00\x01" + bytes(40), "text", 5, None)
        for value in odd:
            found = connection.execute("SELECT ST_MinX(?), ST_MaxY(?)", (value, value)).fetchone()
            assert found == (None, None)
        assert connection.execute("SELECT ST_IsEmpty(?)", (b"GP",)).fetchone() == (1,)
