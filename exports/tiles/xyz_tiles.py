"""Exporter of the mosaic as a folder of web tiles."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from exports.tiles.options import TileOptions
from exports.tiles.web_tiles import write_tiles
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource

if TYPE_CHECKING:
    from collections.abc import Iterator

    from exports.tiles.web_plan import TileSet

METADATA = "metadata.json"


class XyzTiles(Exporter[TileOptions]):
    """The mosaic, or another GeoTIFF, as a folder of web tiles: zoom/column/row (XYZ).

    For any web server and map library; QGIS shows it as an XYZ layer. `metadata.json` (TileJSON)
    tells the place, the zooms and the ending of the tiles. Pictures are for the eye: their CRS is
    web mercator and their pixels are packed with loss. Measure in the mosaic itself.
    """

    id = "xyz_tiles"
    name = "XYZ tiles (folder)"
    suffix = ""
    accepts = ("raster",)
    target = "mosaic_tiles"
    needs = ("mosaic",)
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: TileOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the tiles into the folder `target`."""
        return write_tiles(source, options, feedback, lambda tiles: _folder(target, tiles))


class FolderSink:
    """Tiles as files of a folder."""

    def __init__(self, folder: Path, suffix: str) -> None:
        self._folder, self._suffix = folder, suffix
        self._made: set[tuple[int, int]] = set()

    def put(self, zoom: int, x: int, y: int, data: bytes) -> None:
        """Write one tile."""
        column = self._folder / str(zoom) / str(x)
        if (zoom, x) not in self._made:
            column.mkdir(parents=True, exist_ok=True)
            self._made.add((zoom, x))
        (column / f"{y}.{self._suffix}").write_bytes(data)


@contextmanager
def _folder(target: Path, tiles: TileSet) -> Iterator[FolderSink]:
    target.mkdir(parents=True)
    yield FolderSink(target, tiles.format)
    document = {**tiles.tilejson(), "tiles": [f"{{z}}/{{x}}/{{y}}.{tiles.format}"]}
    text = json.dumps(document, ensure_ascii=False, indent=1)
    (target / METADATA).write_text(text, encoding="utf-8")
