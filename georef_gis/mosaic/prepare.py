"""What is decided about a whole mosaic before its first tile: colour, seams, low frequencies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.mosaic.coarse import SparseRaster, nearest_labels
from georef_gis.mosaic.colour import ColourModel, ColourSettings, solve_colour
from georef_gis.mosaic.colour_level import common_level, with_level
from georef_gis.mosaic.colour_normals import Layout
from georef_gis.mosaic.colour_response import response_bends
from georef_gis.mosaic.colour_steps import Steps, residual_steps
from georef_gis.mosaic.overlaps import Overlaps, OverlapSettings, gather_overlaps
from georef_gis.mosaic.proxies import CorrectedProxies, ProxyStore
from georef_gis.mosaic.seams import SeamSettings, optimise_seams
from georef_gis.rasters.warp import Image

ColourMode = Literal["full", "gain", "none"]
Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Balanced:
    """Colour of a mosaic's photos.

    Parameters
    ----------
    model
        Corrections.
    overlaps
        What they were found from.
    level
        Natural logarithm of a factor that all photos have in common, in `model` already: 0, or less
        where white would be lost.
    """

    model: ColourModel
    overlaps: Overlaps
    level: float

    def before(self) -> Steps:
        """Differences of the photos where they overlap."""
        return residual_steps(self.overlaps, None)

    def after(self) -> Steps:
        """Differences of the photos with their colours corrected."""
        return residual_steps(self.overlaps, self.model)


def make_proxies(
    store: ProxyStore,
    ground: Ground,
    read: Callable[[Path, int], Image],
    *,
    workers: int,
    progress: Progress,
) -> dict[int, str]:
    """Make the proxies that are not there yet; messages of photos that could not be read.

    Raises
    ------
    Cancelled
        If `progress` does; what is finished stays.
    """
    missing = [k for k in range(len(store.ids)) if not store.has(k)]
    broken: dict[int, str] = {}

    def one(index: int) -> None:
        try:
            store.make(index, read, ground)
        except InputError as error:
            broken[index] = str(error)

    with ThreadPoolExecutor(max_workers=workers) as pool:
        jobs = [pool.submit(one, index) for index in missing]
        try:
            for number, job in enumerate(jobs, start=1):
                job.result()
                progress(number / len(jobs))
        finally:
            for job in jobs:
                job.cancel()
    return broken


def balance(
    store: ProxyStore,
    ground: Ground,
    *,
    cameras: Sequence[str],
    flights: Sequence[str],
    mode: ColourMode,
    value_range: tuple[float, float] | None,
    check: Callable[[], None],
    bent: bool = False,
) -> Balanced:
    """Solve the colour of all photos from what they show in common.

    Parameters
    ----------
    cameras, flights
        Names of each photo's.
    value_range
        Least and largest grey value; None if there is no end.
    check
        May raise to stop.
    bent
        Whether the response of the cameras may bend towards white, see `tone.py`. Whether it does
        is found from the photos; then `model.knee` is not 0.
    """

    def place(index: int, cols: Array, rows: Array) -> tuple[Array, Array]:
        check()
        return store.places(index, cols, rows, ground)

    found = gather_overlaps(store, place, settings=OverlapSettings(value_range=value_range))
    top = 0.0 if value_range is None or value_range[0] != 0.0 else value_range[1]
    settings = ColourSettings(mode=mode)
    if bent and top and mode != "none":
        layout = Layout.of(cameras, flights)
        if response_bends(found.overlaps, layout, settings, 1.0 / top):
            settings = replace(settings, knee=1.0 / top)
    model = solve_colour(found.overlaps, len(store.ids), cameras, flights, settings, found.samples)
    level = 0.0
    if top and mode != "none":
        level = common_level(model, found.samples, top)
    model = with_level(model, level, found.overlaps.known_bands)
    return Balanced(model=model, overlaps=found.overlaps, level=level)


def choose_seams(
    source: CorrectedProxies,
    coarse: Grid,
    *,
    optimised: bool,
    workers: int = 1,
    cancelled: Callable[[], bool],
    progress: Progress,
) -> SparseRaster:
    """Which photo shows which ground, on the coarse grid; the same for any number of workers."""
    if not optimised:
        return nearest_labels(source, coarse)
    return optimise_seams(
        source, coarse, SeamSettings(), workers=workers, cancelled=cancelled, progress=progress
    )
