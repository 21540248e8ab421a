"""What may be shown where and what seams cost, at full resolution and on larger pixels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.byte_cache import ByteCache
from georef_gis.mosaic.coarse import Mask, SparseRaster, part_of
from georef_gis.mosaic.nearest import Nearest
from georef_gis.mosaic.seam_costs import PairCost, PairCosts
from georef_gis.mosaic.windows import finer, whole_in

# bytes of photos on larger pixels, and of their costs, that are kept: these are small
SHOWN_BYTES, COST_BYTES = 16_000_000, 8_000_000
Distances = NDArray[np.float32]
Number = TypeVar("Number", np.uint8, np.uint16, np.float32)
Value = TypeVar("Value", bound=np.generic)


class Shown(NamedTuple):
    """A photo on a window: where it may be shown, and how far from its nadir that is, m."""

    allowed: Mask
    distance: Distances


class Scale(Protocol):
    """Photos at a resolution; any thread may ask."""

    @property
    def factor(self) -> int:
        """Size of its pixels, px of full resolution."""
        ...

    def window(self, index: int) -> Window:
        """Part of the grid that a photo covers."""
        ...

    def load(self, index: int) -> None:
        """Have a photo ready."""
        ...

    def shown(self, index: int, window: Window) -> Shown:
        """A photo on a part of its window."""
        ...

    def between(self, a: int, b: int) -> PairCost:
        """Cost of a seam between two photos, in either order."""
        ...


class FullScale:
    """Photos as they are."""

    factor = 1

    def __init__(self, costs: PairCosts, nearest: Nearest, windows: Sequence[Window]) -> None:
        self._costs, self._nearest, self._windows = costs, nearest, windows

    def window(self, index: int) -> Window:
        """Part of the grid that a photo covers."""
        return self._windows[index]

    def load(self, index: int) -> None:
        """Have a photo ready."""
        self._costs.photo(index)

    def shown(self, index: int, window: Window) -> Shown:
        """A photo on a part of its window."""
        photo = self._costs.photo(index)
        part = part_of(photo.window, window)
        distance = photo.distance[part]
        return Shown(photo.valid[part] & (distance <= self._nearest.farthest(window)), distance)

    def between(self, a: int, b: int) -> PairCost:
        """Cost of a seam between two photos, in either order."""
        return self._costs.between(a, b)


class SmallScale:
    """Photos on pixels `factor` times as large.

    They may be shown where they may be all over such a pixel. Costs are means, not those of
    smaller photos: what differs is no wider, and keeps its weight.
    """

    def __init__(self, full: Scale, factor: int) -> None:
        self._full, self.factor = full, factor
        self._shown = ByteCache(partial(_shown, full, factor), budget=SHOWN_BYTES)
        self._costs = ByteCache(partial(_cost, full, factor), budget=COST_BYTES)

    def window(self, index: int) -> Window:
        """Part of the grid that a photo covers."""
        return whole_in(self._full.window(index), self.factor)

    def load(self, index: int) -> None:
        """Have a photo ready."""
        self._shown(index)

    def shown(self, index: int, window: Window) -> Shown:
        """A photo on a part of its window."""
        part = part_of(self.window(index), window)
        whole = self._shown(index)
        return Shown(whole.allowed[part], whole.distance[part])

    def between(self, a: int, b: int) -> PairCost:
        """Cost of a seam between two photos, in either order."""
        return self._costs((a, b) if a < b else (b, a))


def _shown(full: Scale, factor: int, index: int) -> Shown:
    window = whole_in(full.window(index), factor)
    allowed, distance = full.shown(index, finer(window, factor))
    # 255 is the mean of nothing but 255s
    every = _mean(allowed.astype(np.uint8) * np.uint8(255), window) == 255
    return Shown(every, _mean(distance, window))


def _cost(full: Scale, factor: int, pair: tuple[int, int]) -> PairCost:
    cost = full.between(*pair)
    window = whole_in(cost.window, factor)
    part = part_of(cost.window, finer(window, factor))
    return PairCost(window, _mean(cost.cost[part], window))


def _mean(values: NDArray[Number], window: Window) -> NDArray[Number]:
    """Means over the larger pixels of a window."""
    if not window.width * window.height:
        return np.zeros((window.height, window.width), values.dtype)
    size = (window.width, window.height)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), dtype=values.dtype)


def sampled(labels: SparseRaster, factor: int) -> SparseRaster:
    """Labels on pixels `factor` times as large: that of the pixel in their middle."""
    middle = factor // 2
    out = SparseRaster(
        width=-(-labels.width // factor), height=-(-labels.height // factor),
        dtype=np.int32, fill=-1,
    )  # fmt: skip
    for window in labels:
        top, left = (middle - window.row) % factor, (middle - window.col) % factor
        part = labels.read(window)[top::factor, left::factor]
        out.write(
            Window(
                col=(window.col + left) // factor, row=(window.row + top) // factor,
                width=part.shape[1], height=part.shape[0],
            ),
            part,
        )  # fmt: skip
    return out


def repeated(values: NDArray[Value], factor: int) -> NDArray[Value]:
    """Values on pixels `factor` times as small; (rows, cols)."""
    return values.repeat(factor, axis=0).repeat(factor, axis=1)
