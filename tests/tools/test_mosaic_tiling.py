"""A pixel of the mosaic along seams depends on its place alone, not on the tile it is made in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mosaic_flights import ROW, Values, make, scene
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.job import MosaicJob
from georef_gis.project import Project
from georef_gis.rasters.warp import ImageCache
from georef_gis.toolbox import CollectingFeedback
from processing_algorithms.mosaic.inputs import Inputs, gather, mosaic_sources
from processing_algorithms.mosaic.seamlines import BlendChoice, SeamWishes, prepare
from processing_algorithms.site import load_footprints, load_site

pytestmark = pytest.mark.slow

GSD = 0.125
# turned against the grid of the mosaic, or rims of photos lie along rows of pixels
PLACES = tuple((x, 0.04 * x + 0.07) for x, _ in ROW)


def grainy(k: int, east: Values, north: Values) -> Values:
    """The scene at a varying exposure, with detail and a lens dark in its corners.

    Detail changes by 4 grey values a pixel: positions are rounded to 1/32 px.
    """
    r2 = ((east - PLACES[k][0]) ** 2 + (north - PLACES[k][1]) ** 2) / 72.1**2
    grain = 0.05 * np.sin(east / 0.8) * np.sin(north / 0.7)
    return np.asarray((scene(k, east, north) + grain[..., None])
                      * ((1.0 + 0.1 * (-1) ** k) * (1.0 - 0.2 * r2))[..., None])  # fmt: skip


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    folder = tmp_path_factory.mktemp("tiling") / "site"
    return Project.open(make(folder, grainy, PLACES).folder)


@pytest.fixture(scope="module")
def inputs(project: Project) -> Inputs:
    return gather(load_site(project), load_footprints(project), GSD, ImageCache())


def windows(inputs: Inputs, width: int, height: int) -> Iterator[Window]:
    """Windows of a size over the whole grid, those at its rim cut."""
    for row in range(0, inputs.grid.height, height):
        for col in range(0, inputs.grid.width, width):
            yield Window(
                col=col, row=row, width=min(width, inputs.grid.width - col),
                height=min(height, inputs.grid.height - row),
            )  # fmt: skip


def rendered(inputs: Inputs, mosaic: Any, width: int, height: int) -> tuple[Any, NDArray[np.bool_]]:
    """The whole mosaic in tiles of a size, and its mask."""
    shape = inputs.grid.height, inputs.grid.width
    out, mask = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_)
    for w in windows(inputs, width, height):
        task = TileTask(row=0, col=0, window=w, photo_ids=tuple(inputs.footprints))
        tile = mosaic.tile(task)
        if tile is not None:
            here = (slice(w.row, w.row + w.height), slice(w.col, w.col + w.width))
            out[here], mask[here] = tile[0], True if tile[1] is None else tile[1]
    return out, mask


@pytest.mark.parametrize("blend", ["multiband", "feather", "none"])
def test_any_tiling_gives_the_same_pixels(
    project: Project, inputs: Inputs, blend: BlendChoice
) -> None:
    sources = mosaic_sources(inputs)
    cache = ImageCache()
    found = prepare(
        project, inputs, sources, read=cache.get, workers=1, feedback=CollectingFeedback(),
        wishes=SeamWishes(optimised=True, colour="full", blend=blend),
    )  # fmt: skip
    broken: list[str] = []
    mosaic = MosaicJob(
        sources=found.sources, ground=found.ground, grid=found.grid, gsd=inputs.gsd,
        kind=inputs.kind, seams=found.seams, field=found.field,
    ).open(cache.get, broken)  # fmt: skip
    whole, mask = rendered(inputs, mosaic, 512, 512)
    assert mask.mean() > 0.9
    # multiples of the meshes' 32 px: the same nodes, the same numbers
    for side in (128, 256, 1024):
        np.testing.assert_array_equal(rendered(inputs, mosaic, side, side)[0], whole, str(side))
    for width, height in ((1000, 700), (333, 177), (97, 641)):
        other, other_mask = rendered(inputs, mosaic, width, height)
        np.testing.assert_array_equal(mask, other_mask, err_msg=f"{width} x {height}")
        off = np.abs(whole.astype(int) - other)
        # rounding alone: of a photo's grey value, of which gains to 1.5 may make two
        assert off.max() <= 2, f"{width} x {height}"
        assert (off > 1).mean() < 1e-5, f"{width} x {height}"
        assert (off > 0).mean() < 1e-3, f"{width} x {height}"
    assert broken == []


def test_the_tiling_of_the_file_is_that_of_any_tiles(
    project: Project, inputs: Inputs, tmp_path: Path
) -> None:
    """Tiles in another order, by a mosaic that has not seen the others, are the same to the bit."""
    sources, cache = mosaic_sources(inputs), ImageCache()
    found = prepare(
        project, inputs, sources, read=cache.get, workers=2, feedback=CollectingFeedback(),
        wishes=SeamWishes(optimised=True, colour="full", blend="multiband"),
    )  # fmt: skip
    job = MosaicJob(
        sources=found.sources, ground=found.ground, grid=found.grid, gsd=inputs.gsd,
        kind=inputs.kind, seams=found.seams, field=found.field,
    )  # fmt: skip
    one = job.open(cache.get, [])
    forwards = {task: one.tile(task) for task in inputs.plan.tiles}
    for task in reversed(inputs.plan.tiles):
        tile, other = forwards[task], job.open(cache.get, []).tile(task)
        assert (tile is None) == (other is None)
        if tile is not None and other is not None:
            np.testing.assert_array_equal(tile[0], other[0])
