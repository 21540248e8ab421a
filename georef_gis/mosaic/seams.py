"""Seams: which photo shows which place, so that the changes between photos are least seen.

Notes
-----
Alpha-beta swaps (Boykov, Veksler, Zabih, "Fast approximate energy minimization via graph cuts",
2001) of photos that touch: the pixels that show either of two photos are decided anew by a minimum
cut, and the cost of the whole never rises. Seam costs after Kwatra et al., "Graphcut textures"
(2003). Pairs are decided on larger pixels first, then in a band around the seams found there
(Lombaert et al., "A multilevel banded graph cuts method for fast image segmentation", 2005). A
pair is small whatever the size of the mosaic, so the work grows with the photos only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from georef_gis.errors import Cancelled
from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.ahead import made_ahead
from georef_gis.mosaic.coarse import Mask, ProxySource, SparseRaster
from georef_gis.mosaic.label_regions import dissolve_specks, touching
from georef_gis.mosaic.nearest import Nearest
from georef_gis.mosaic.seam_costs import ONE, PairCosts
from georef_gis.mosaic.seam_scales import FullScale, Scale, SmallScale, repeated, sampled
from georef_gis.mosaic.seam_swaps import Border, Labels, Pair, Prices, Swaps
from georef_gis.mosaic.windows import finer

# first, seams are chosen on pixels so many times as large, of which a photo's shorter side has
# at least so many
FACTOR, LEAST_SIDE = 4, 64
# of a photo's shorter side: pairs are decided in strips so high, so that the photos of a column
# are still in memory when the next one needs them
STRIP = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamSettings:
    """How seams are chosen.

    Parameters
    ----------
    lean
        Part of the nearest photo's distance by which another's may exceed it: what stands up
        leans in proportion.
    leeway
        The same as part of a photo's reach, whichever allows more: near a nadir nothing leans
        much, and the nearest's distance is nothing.
    distance_cost
        Cost per pixel that is farther than the nearest by a reach, in units of a pixel of seam
        through a place that differs.
    length_cost
        Cost per pixel of seam where photos agree, in the same units.
    rounds
        Times that every pair is decided on larger pixels.
    refinements
        Times that every pair is decided at full resolution then.
    band_px
        How far a seam may move in a refinement; px.
    speck_px
        Parts of a photo smaller than this, apart from its largest, go to a neighbour; px.
    """

    lean: float = 0.6
    leeway: float = 0.5
    distance_cost: float = 0.05
    length_cost: float = 0.05
    rounds: int = 1
    refinements: int = 1
    band_px: int = 10
    speck_px: int = 60


def optimise_seams(
    source: ProxySource,
    coarse: Grid,
    settings: SeamSettings,
    *,
    workers: int = 1,
    cancelled: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SparseRaster:
    """Labels with less visible seams than those of the nearest photos.

    Parameters
    ----------
    source
        Photos with their colours made alike; several threads ask for them.
    workers
        Threads; they change nothing but the time.
    progress
        Told the part that is done, 0 to 1.

    Returns
    -------
    labels : int32
        Index of the photo to show, -1 none, on the coarse grid.

    Raises
    ------
    Cancelled
        If `cancelled` says so.
    """

    def step(fraction: float) -> None:
        if cancelled():
            raise Cancelled("stopped by the user")
        progress(fraction)

    windows = source.windows
    costs = PairCosts(source)
    nearest = Nearest(coarse, lean=settings.lean, leeway=settings.leeway)
    _take_in(costs, nearest, len(windows), workers, lambda done: step(0.2 * done))
    side = float(np.median([min(window.width, window.height) for window in windows] or [0]))
    work = _Work(FullScale(costs, nearest, windows), nearest, side, settings, workers)
    work.choose(lambda done: step(0.2 + 0.4 * done))
    work.refine(lambda done: step(0.6 + 0.3 * done))
    for index, window in enumerate(windows):
        step(0.9 + 0.1 * index / len(windows))
        dissolve_specks(nearest.labels, index, window, costs.photo, settings.speck_px)
    progress(1.0)
    return nearest.labels


def _take_in(
    costs: PairCosts, nearest: Nearest, count: int, workers: int, step: Callable[[float], None]
) -> None:
    """Find the nearest of all photos."""
    for index, photo in enumerate(made_ahead(costs.photo, range(count), workers)):
        step(index / count)
        nearest.add(index, photo)


class _Work:
    """Labels that are the nearest photos' at first."""

    def __init__(
        self, full: Scale, nearest: Nearest, side: float, settings: SeamSettings, workers: int
    ) -> None:
        self._full, self._nearest, self._side = full, nearest, side
        self._settings, self._workers = settings, workers

    def choose(self, step: Callable[[float], None]) -> None:
        """Decide where seams run, on larger pixels if photos have enough of them."""
        labels, scale = self._nearest.labels, self._full
        factor = max(1, min(FACTOR, int(self._side) // LEAST_SIDE))
        if factor > 1:
            scale = SmallScale(scale, factor)
        small = labels if factor == 1 else sampled(labels, factor)
        for window, new, free in self._decided(scale, small, None, self._settings.rounds, step):
            if factor > 1:
                labels.write(finer(window, factor), repeated(new, factor), repeated(free, factor))

    def refine(self, step: Callable[[float], None]) -> None:
        """Move seams at full resolution."""
        band, rounds = self._settings.band_px, self._settings.refinements
        for _ in self._decided(self._full, self._nearest.labels, band, rounds, step):
            pass

    def _decided(
        self,
        scale: Scale,
        labels: SparseRaster,
        band: int | None,
        rounds: int,
        step: Callable[[float], None],
    ) -> Iterator[tuple[Window, Labels, Mask]]:
        """Decide all pairs that touch so many times; what came out, pair by pair."""
        settings = self._settings
        # Of larger pixels, sides count in proportion and areas by the square: the same, divided.
        prices = Prices(
            per_m=settings.distance_cost * ONE / self._nearest.reach * scale.factor,
            length=round(settings.length_cost * ONE),
        )
        swaps = Swaps(scale, labels, prices, band)
        for number in range(rounds):
            borders = _in_strips(touching(labels), STRIP * self._side / scale.factor)
            for k, border in enumerate(made_ahead(swaps.prepare, borders, self._workers)):
                step((number + k / len(borders)) / rounds)
                answer = swaps.decide(border)
                if answer is not None:
                    yield answer


def _in_strips(borders: Mapping[Pair, Window], height: float) -> list[Border]:
    """Pairs that touch in the order that loads photos least: from left to right in strips."""

    def place(border: Border) -> tuple[int, int, Pair]:
        pair, window = border
        row, col = window.row + window.height // 2, window.col + window.width // 2
        return int(row / max(height, 1.0)), col, pair

    return sorted(borders.items(), key=place)
