"""What is decided about a whole mosaic before its first tile: colour, seams, low frequencies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.mosaic.coarse import SparseRaster, nearest_labels
from georef_gis.mosaic.colour import (
    ColourModel,
    ColourSettings,
    Steps,
    residual_steps,
    solve_colour,
)
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
    before, after
        Differences of photos where they overlap.
    """

    model: ColourModel
    overlaps: Overlaps
    before: Steps
    after: Steps


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
) -> Balanced:
    """Solve the colour of all photos from what they show in common; `check` may raise to stop."""

    def place(index: int, cols: Array, rows: Array) -> tuple[Array, Array]:
        check()
        return store.places(index, cols, rows, ground)

    overlaps = gather_overlaps(store, place, settings=OverlapSettings(value_range=value_range))
    n = len(store.ids)
    model = solve_colour(overlaps, n, cameras, flights, ColourSettings(mode=mode))
    nothing = solve_colour(overlaps, n, cameras, flights, ColourSettings(mode="none"))
    return Balanced(
        model=model,
        overlaps=overlaps,
        before=residual_steps(overlaps, nothing),
        after=residual_steps(overlaps, model),
    )


def choose_seams(
    source: CorrectedProxies,
    coarse: Grid,
    *,
    optimised: bool,
    cancelled: Callable[[], bool],
    progress: Progress,
) -> SparseRaster:
    """Which photo shows which ground, on the coarse grid."""
    nearest = nearest_labels(source, coarse)
    if not optimised:
        return nearest
    return optimise_seams(
        source, coarse, nearest, SeamSettings(), cancelled=cancelled, progress=progress
    )
