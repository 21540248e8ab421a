"""Seams: which photo shows which place, so that the changes between photos are least seen.

Notes
-----
Alpha-beta swaps (Boykov, Veksler, Zabih, "Fast approximate energy minimization via graph cuts",
2001) of photos that touch: the pixels that show either of two photos are decided anew by a minimum
cut, and the cost of the whole never rises. Seam costs after Kwatra et al., "Graphcut textures"
(2003). A pair is small whatever the size of the mosaic, so the work grows with the photos only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import Cancelled
from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import Mask, Proxy, ProxySource, SparseRaster, common, part_of
from georef_gis.mosaic.label_regions import dissolve_specks, touching
from georef_gis.mosaic.min_cut import STEPS, min_cut
from georef_gis.mosaic.seam_costs import ONE, Costs, PairCosts

Labels = NDArray[np.int32]
Indices = NDArray[np.intp]

# photos and pair costs in memory at once
PHOTOS, PAIRS = 8, 48
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


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
        Times that every pair is decided.
    speck_px
        Parts of a photo smaller than this, apart from its largest, go to a neighbour; px.
    """

    lean: float = 0.6
    leeway: float = 0.5
    distance_cost: float = 0.05
    length_cost: float = 0.05
    rounds: int = 2
    speck_px: int = 60


def optimise_seams(
    source: ProxySource,
    coarse: Grid,
    start: SparseRaster,
    settings: SeamSettings,
    *,
    cancelled: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SparseRaster:
    """Labels with less visible seams.

    Parameters
    ----------
    source
        Photos with their colours made alike.
    start
        Index of the nearest photo, -1 where there is none (`nearest_labels`); left as it is.
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

    costs = PairCosts(source, photos=PHOTOS, pairs=PAIRS)
    labels = _copy(start)
    distances = _Distances(coarse)
    for index in range(len(source.windows)):
        step(0.2 * index / len(source.windows))
        distances.add(costs.photo(index), labels.read(source.windows[index]) == index)
    swaps = _Swaps(costs, labels, distances, settings)
    _decide_all(swaps, labels, settings.rounds, lambda done: step(0.2 + 0.7 * done))
    for index, window in enumerate(source.windows):
        step(0.9 + 0.1 * index / len(source.windows))
        dissolve_specks(labels, index, window, costs.photo, settings.speck_px)
    progress(1.0)
    return labels


def _decide_all(
    swaps: _Swaps, labels: SparseRaster, rounds: int, step: Callable[[float], None]
) -> None:
    """Decide all pairs that touch, in order, until nothing changes or the rounds are over."""
    for number in range(rounds):
        pairs = touching(labels)
        changes = 0
        for k, (a, b) in enumerate(pairs):
            step((number + k / len(pairs)) / rounds)
            changes += swaps.decide(a, b)
        if not changes:
            return


def edge_cost(at_p: Costs, at_q: Costs, length: int) -> Costs:
    """Cost of a seam between neighbouring pixels with these costs."""
    return (at_p + at_q) // 2 + length


def reach_of(photo: Proxy) -> float:
    """How much farther than its nearest pixel a photo's pixels usually are from its nadir, m."""
    distance = photo.distance[photo.valid]
    return float(np.median(distance) - distance.min()) if distance.size else 0.0


class _Distances:
    """Distance to the nearest nadir, and the usual reach of a photo, m."""

    def __init__(self, coarse: Grid) -> None:
        # A thousandth is enough for a bound, and this is as large as the mosaic.
        self._nearest = SparseRaster(
            width=coarse.width, height=coarse.height, dtype=np.float16, fill=np.inf
        )
        self._reaches: list[float] = []

    def add(self, photo: Proxy, nearest: Mask) -> None:
        """Take in a photo and the pixels of its window to which it is the nearest."""
        self._nearest.write(photo.window, photo.distance.astype(np.float16), nearest)
        self._reaches.append(reach_of(photo))

    def reach(self) -> float:
        """Usual reach of all photos."""
        used = [reach for reach in self._reaches if reach > 0.0]
        return float(np.median(used)) if used else 1.0

    def nearest(self, window: Window) -> NDArray[np.float32]:
        """Distance to the nearest nadir in a window."""
        return self._nearest.read(window).astype(np.float32)


class _Swaps:
    """Labels while pairs of photos are decided."""

    def __init__(
        self, costs: PairCosts, labels: SparseRaster, distances: _Distances, settings: SeamSettings
    ) -> None:
        self._costs, self._labels, self._distances = costs, labels, distances
        self._reach = distances.reach()
        self._lean, self._leeway = settings.lean, settings.leeway * self._reach
        self._per_m = settings.distance_cost * ONE / self._reach
        self._length = round(settings.length_cost * ONE)
        # when a photo last gained or lost ground, and a pair was last decided
        self._time = 0
        self._changed: dict[int, int] = {}
        self._decided: dict[tuple[int, int], int] = {}

    def decide(self, a: int, b: int) -> bool:
        """Decide anew what shows either of two photos; whether anything changed."""
        stamp = self._decided.get((a, b), -1)
        if stamp >= max(self._changed.get(a, 0), self._changed.get(b, 0)):
            return False
        self._time += 1
        self._decided[a, b] = self._time
        first, second = self._costs.photo(a), self._costs.photo(b)
        window = common(first.window, second.window)
        if window is None:
            return False
        field = self._field(a, b, first, second, window)
        if field is None:
            return False
        source, _ = min_cut(self._edges(field), self._terminals(field))
        new = np.where(source, a, b).astype(np.int32)
        if np.array_equal(new[field.free], field.labels[1:-1, 1:-1][field.free]):
            return False
        self._labels.write(field.window, new, field.free)
        self._changed[a] = self._changed[b] = self._decided[a, b] = self._time
        return True

    def _field(self, a: int, b: int, first: Proxy, second: Proxy, window: Window) -> _Field | None:
        """What is to be decided between two photos; None if nothing."""
        labels = self._labels.read(_grown(window))
        inner = labels[1:-1, 1:-1]
        own = (inner == a) | (inner == b)
        box = _box(own, window)
        if box is None:
            return None
        near = self._distances.nearest(box)
        far = near + np.maximum(self._lean * near, self._leeway)
        free = own[part_of(window, box)].copy()
        for photo in (first, second):
            part = part_of(photo.window, box)
            free &= photo.valid[part] & (photo.distance[part] <= far)
        if not free.any():
            return None
        gain = self._price(second, box, free) - self._price(first, box, free)
        cost = self._costs.between(a, b)
        return _Field(
            a=a, b=b, window=box, free=free, gain=gain,
            labels=labels[part_of(_grown(window), _grown(box))],
            cost=cost.cost[part_of(cost.window, box)].astype(np.int32),
        )  # fmt: skip

    def _price(self, photo: Proxy, box: Window, free: Mask) -> Costs:
        """Cost of a photo's distance at free pixels."""
        distance = np.where(free, photo.distance[part_of(photo.window, box)], np.float32(0.0))
        return np.rint(distance * np.float32(self._per_m)).astype(np.int32)

    def _edges(self, field: _Field) -> Costs:
        """Costs of parting free pixels from their free neighbours."""
        rows, cols = field.free.shape
        edges = np.zeros((len(STEPS), rows, cols), np.int32)
        for k, (dr, dc) in enumerate(STEPS):
            p, q = (slice(rows - dr), slice(cols - dc)), (slice(dr, rows), slice(dc, cols))
            cost = edge_cost(field.cost[p], field.cost[q], self._length)
            edges[k][p] = cost * (field.free[p] & field.free[q])
        return edges

    def _terminals(self, field: _Field) -> Costs:
        """What the second photo costs more than the first: distance, and neighbours that stay."""
        terminals = field.gain.copy()
        inner = cv2.erode(field.free.view(np.uint8), CROSS, borderValue=0)
        rows, cols = np.nonzero(field.free & (inner == 0))
        free = np.pad(field.free, 1)
        for dr, dc in [(s * dr, s * dc) for dr, dc in STEPS for s in (1, -1)]:
            r, c = rows + dr, cols + dc
            label = field.labels[r + 1, c + 1]
            stays = ~free[r + 1, c + 1] & (label >= 0)
            p, q = (rows[stays], cols[stays]), (r[stays], c[stays])
            more = self._beside(field, field.b, label[stays], p, q)
            more -= self._beside(field, field.a, label[stays], p, q)
            terminals[p] += more
        return terminals

    def _beside(
        self,
        field: _Field,
        own: int,
        others: Labels,
        p: tuple[Indices, Indices],
        q: tuple[Indices, Indices],
    ) -> Costs:
        """Cost of showing a photo at pixels p whose neighbours q show others."""
        row, col = field.window.row, field.window.col
        out = np.zeros(others.shape, np.int32)
        for other in np.unique(others):
            if other == own:
                continue
            here = others == other
            cost = self._costs.between(own, int(other))
            at_p = cost.at(p[0][here] + row, p[1][here] + col)
            at_q = cost.at(q[0][here] + row, q[1][here] + col)
            out[here] = edge_cost(at_p, at_q, self._length)
        return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Field:
    """Pixels to be decided between photos a and b; arrays over `window`.

    `labels` reach a pixel farther on all sides; `gain` is what b costs more for its distance.
    """

    a: int
    b: int
    window: Window
    free: Mask
    gain: Costs
    labels: Labels
    cost: Costs


def _grown(window: Window) -> Window:
    """A window with a ring of one pixel."""
    return Window(
        col=window.col - 1, row=window.row - 1, width=window.width + 2, height=window.height + 2
    )


def _box(mask: Mask, window: Window) -> Window | None:
    """Smallest window around the true pixels of a window; None if there are none."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    return Window(
        col=window.col + int(cols[0]), row=window.row + int(rows[0]),
        width=int(cols[-1] - cols[0]) + 1, height=int(rows[-1] - rows[0]) + 1,
    )  # fmt: skip


def _copy(raster: SparseRaster) -> SparseRaster:
    """Labels that may be changed."""
    out = SparseRaster(width=raster.width, height=raster.height, dtype=np.int32, fill=-1)
    for window in raster:
        out.write(window, raster.read(window))
    return out
