"""A raster as a pyramid of web-mercator tiles, for any container of tiles."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from exports.tiles.options import TileOptions
from exports.tiles.raster_source import raster_of
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport, Feedback, LayerSource, check_cancelled

if TYPE_CHECKING:
    from pathlib import Path

    from exports.tiles.web_picture import WebPicture
    from exports.tiles.web_plan import TileSet
    from exports.tiles.web_walk import TileSink
    from georef_gis.geodesy import MapFrame


SinkOf = Callable[["TileSet"], AbstractContextManager["TileSink"]]


def write_tiles(
    source: LayerSource, options: TileOptions, feedback: Feedback, sink_of: SinkOf
) -> ExportReport:
    """Tiles of a raster layer into a container.

    Parameters
    ----------
    sink_of
        Opens the container; its context ends when all tiles are in, or with an error.

    Raises
    ------
    ExportError
        If the layer is not one raster, has nothing to show, or would make too many tiles.
    """
    from rasterio.errors import RasterioError

    path = raster_of(source)
    check_cancelled(feedback)
    try:
        return _write(path, source, options, feedback, sink_of)
    except RasterioError as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise ExportError(
            f"{path}: cannot be read ({reason}); check that the file is whole"
        ) from error


def _write(
    path: Path, source: LayerSource, options: TileOptions, feedback: Feedback, sink_of: SinkOf
) -> ExportReport:
    from exports.tiles.web_encoding import encoder
    from exports.tiles.web_mercator import CRS
    from exports.tiles.web_picture import WebPicture
    from exports.tiles.web_plan import plan_tiles
    from exports.tiles.web_walk import TileWalk

    with WebPicture(path, _frame_of(source)) as picture:
        tiles = plan_tiles(picture, path.name, options, *_texts(source, path))
        warnings = _doubts(picture, path.name)
        for warning in warnings:
            feedback.warn(warning)

        def tick(fraction: float) -> None:
            check_cancelled(feedback)
            feedback.progress(fraction, f"tiles: {walk.count}")

        with sink_of(tiles) as sink:
            walk = TileWalk(
                picture=picture, tiles=tiles, sink=sink, tick=tick,
                encode=encoder(options.format, options.quality),
            )  # fmt: skip
            walk.write()
            if not walk.count:
                raise ExportError(f"{path.name}: has no valid pixel, so there is no tile to write")
            tick(1.0)
    return ExportReport(crs=CRS, height_kind="none", features=walk.count, warnings=warnings)


def _frame_of(source: LayerSource) -> MapFrame | None:
    """The project's frame, if it has one yet."""
    from georef_gis.project.records import load_frame

    if source.project.database.meta("origin") is None:
        return None
    return load_frame(source.project.database)


def _texts(source: LayerSource, path: Path) -> tuple[str, str]:
    """Name and description: the accuracy statement of the mosaic, if one was made."""
    from exports.site.reader import read_accuracy

    project = source.project
    name = project.settings.project.name or project.folder.name
    if source.layer != "mosaic":
        return path.stem, f"{path.name} of {name}"
    items, _ = read_accuracy(project)
    return name, " ".join((f"Mosaic of {name}.", items.get("ACCURACY_STATEMENT_H", ""))).strip()


def _doubts(picture: WebPicture, name: str) -> tuple[str, ...]:
    """What a user should know of the tiles' pixels."""
    from exports.tiles.raster_colour import BRIGHT, DARK

    found = []
    if picture.stretch is not None:
        ranges = ", ".join(f"{low:g} to {high:g}" for low, high in picture.stretch)
        found.append(
            f"{name}: is not 8-bit, so tiles show {DARK:g} to {BRIGHT:g} % of each band's values "
            f"as black to white ({ranges}); measure in the mosaic"
        )
    if picture.place.is_cut:
        found.append(f"{name}: the part beyond 85.05 deg of latitude is left out")
    return tuple(found)
