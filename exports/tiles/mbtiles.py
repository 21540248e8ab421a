"""Exporter of the mosaic as MBTiles 1.3: web tiles in one SQLite file."""

from __future__ import annotations

import errno
import json
import os
import sqlite3
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from exports.tiles.options import TileOptions
from exports.tiles.web_tiles import write_tiles
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource

if TYPE_CHECKING:
    from collections.abc import Iterator

    from exports.tiles.web_plan import TileSet

# "MPBX", by which `file` and GDAL know an MBTiles
_APPLICATION_ID = 0x4D504258
# The file is renamed when it is whole, so a journal would protect nothing.
_SCHEMA = f"""
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA journal_mode = OFF;
PRAGMA synchronous = OFF;
CREATE TABLE metadata (name TEXT NOT NULL, value TEXT);
CREATE TABLE tiles (
  zoom_level INTEGER NOT NULL, tile_column INTEGER NOT NULL, tile_row INTEGER NOT NULL,
  tile_data BLOB NOT NULL
);
CREATE UNIQUE INDEX name ON metadata (name);
CREATE UNIQUE INDEX tile_index ON tiles (zoom_level, tile_column, tile_row);
"""


class Mbtiles(Exporter[TileOptions]):
    """The mosaic, or another GeoTIFF, as MBTiles 1.3: web tiles in one file.

    For QGIS, tile servers and apps for maps without a network. Pictures are for the eye: their
    CRS is web mercator and their pixels are packed with loss. Measure in the mosaic itself.
    """

    id = "mbtiles"
    name = "MBTiles"
    suffix = ".mbtiles"
    accepts = ("raster",)
    target = "mosaic.mbtiles"
    needs = ("mosaic",)
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: TileOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the tiles to `target`."""
        return write_tiles(source, options, feedback, lambda tiles: _database(target, tiles))


class DatabaseSink:
    """Tiles as rows of a table."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def put(self, zoom: int, x: int, y: int, data: bytes) -> None:
        """Write one tile; MBTiles counts rows from the south (TMS)."""
        row = (zoom, x, 2**zoom - 1 - y, data)
        self._connection.execute("INSERT INTO tiles VALUES (?, ?, ?, ?)", row)


@contextmanager
def _database(target: Path, tiles: TileSet) -> Iterator[DatabaseSink]:
    try:
        connection = sqlite3.connect(target, isolation_level=None)
        try:
            connection.executescript(_SCHEMA)
            connection.execute("BEGIN")
            rows = _metadata(tiles).items()
            connection.executemany("INSERT INTO metadata VALUES (?, ?)", rows)
            yield DatabaseSink(connection)
            connection.execute("COMMIT")
        finally:
            connection.close()
    except sqlite3.OperationalError as error:
        # SQLite tells a full disk in words of its own.
        raise OSError(errno.EIO, str(error), os.fspath(target)) from error


def _metadata(tiles: TileSet) -> dict[str, str]:
    lon, lat, zoom = tiles.center
    return {
        "name": tiles.name,
        "format": tiles.format,
        "bounds": ",".join(f"{value:.9f}" for value in tiles.bounds),
        "center": f"{lon:.9f},{lat:.9f},{zoom}",
        "minzoom": str(tiles.min_zoom),
        "maxzoom": str(tiles.max_zoom),
        "attribution": tiles.attribution,
        "description": tiles.description,
        "type": "baselayer",
        "version": "1.0.0",
        "json": json.dumps({"tileSize": tiles.tile_size}),
    }
