"""Low frequencies of a mosaic blended over seams, as a correction of each photo.

Seen from far, neighbouring photos differ by a little in brightness wherever they meet. A Laplacian
pyramid (Burt & Adelson 1983, ACM Trans. Graphics 2, 217) of the photos on the coarse grid blends
every frequency over its own width; what it changes in a photo is smooth, and is added to the
photo's pixels when a tile is made. So a tile needs no halo, and any tiling gives the same pixels.
The finest level stays as it is: detail changes from photo to photo at the seam itself.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import Mask, ProxySource, SparseRaster
from georef_gis.mosaic.low_levels import (
    ALIGNED,
    LEVELS,
    Level,
    aligned,
    doubled,
    first_level,
    levels_of,
    over,
    times,
)

# coarse px around the grid: photos are continued beyond it
PAD = 2 * ALIGNED
# what photos' own low frequencies may take in memory: some 80 photos
KEPT_BYTES = 64_000_000
Values = NDArray[np.float32]


class OwnLow:
    """Low frequencies of single photos (`low_of`); those used last are kept. Safe for threads."""

    def __init__(self, source: ProxySource) -> None:
        self._source = source
        self._kept: OrderedDict[int, tuple[Values, Window]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[OwnLow], tuple[ProxySource]]:
        """Another process starts with nothing kept."""
        return OwnLow, (self._source,)

    def of(self, index: int) -> tuple[Values, Window]:
        """A photo's low frequencies and the window of the half grid that they cover."""
        with self._lock:
            found = self._kept.get(index)
            if found is not None:
                self._kept.move_to_end(index)
                return found
        proxy = self._source.load(index)
        return self.keep(index, *low_of(proxy.data, proxy.valid, proxy.window))

    def keep(self, index: int, values: Values, window: Window) -> tuple[Values, Window]:
        """Take what was found on another way, as long as there is room."""
        with self._lock:
            if index not in self._kept:
                self._kept[index] = (values, window)
                self._bytes += values.nbytes
                while self._bytes > KEPT_BYTES and len(self._kept) > 1:
                    self._bytes -= self._kept.popitem(last=False)[1][0].nbytes
        return values, window


class LowBlend:
    """The blended low frequencies of a mosaic, at half the coarse resolution.

    Parameters
    ----------
    low : bands, float32
        Blend of the photos; sample (col, row) lies in the centre of coarse pixel (2 col, 2 row).
    bands
        Number of bands.
    own
        The photos' own low frequencies.
    """

    def __init__(self, low: SparseRaster, bands: int, own: OwnLow) -> None:
        self.low = low
        self.bands = bands
        self.own = own

    def correction(self, window: Window, base: Values, own: Window) -> Values:
        """What to add to a photo over a window of the half grid; (rows, cols, bands).

        Parameters
        ----------
        base : shape (rows, cols, bands)
            The photo's own low frequencies (`low_of`) over `own`; repeated beyond.
        """
        rows = np.clip(np.arange(window.row, window.row + window.height) - own.row,
                       0, own.height - 1)  # fmt: skip
        cols = np.clip(np.arange(window.col, window.col + window.width) - own.col,
                       0, own.width - 1)  # fmt: skip
        low = self.low.read(window)
        out = low - base[rows[:, None], cols[None, :]]
        return np.asarray(np.where(np.isfinite(out), out, 0.0), dtype=np.float32)


def blend_low(
    source: ProxySource,
    labels: SparseRaster,
    coarse: Grid,
    bands: int,
    check: Callable[[], None] = lambda: None,
    workers: int = 1,
) -> LowBlend:
    """Blend the low frequencies of corrected photos by their labels; `check` may raise to stop.

    Memory grows with the ground covered: a third of (bands + 1) floats a coarse pixel. The blend
    is the same with any number of `workers`, threads that make the photos' pyramids.
    """
    own = OwnLow(source)
    sums = [_Sums.over(coarse, k, bands) for k in range(1, LEVELS + 1)]
    made = partial(_levels, source, labels, own)
    for levels in _in_turn(made, len(source.ids), workers):
        check()
        for total, level in zip(sums, levels, strict=False):
            total.add(level)
    low = SparseRaster(
        width=coarse.width // 2 + 1, height=coarse.height // 2 + 1, dtype=np.float32, fill=np.nan,
        bands=bands,
    )  # fmt: skip
    for block in sums[0].weight:
        low.write(_shifted(block, -(PAD >> 1)), _collapsed(sums, block, bands))
    return LowBlend(low, bands, own)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Sums of all photos on one level, from `PAD` before the grid: bands by weight, weights."""

    number: int
    bands: SparseRaster
    weight: SparseRaster

    @classmethod
    def over(cls, coarse: Grid, number: int, bands: int) -> _Sums:
        """Nothing yet, on level `number`."""
        empty = partial(
            SparseRaster, width=(coarse.width + 3 * PAD) >> number,
            height=(coarse.height + 3 * PAD) >> number, dtype=np.float32, fill=0.0,
        )  # fmt: skip
        return cls(number, empty(bands=bands), empty())

    def add(self, level: Level) -> None:
        """Take in a photo."""
        window = _shifted(level.window, PAD >> self.number)
        bands = self.bands.read(window)
        bands += times(level.band, level.weight)
        self.bands.write(window, bands)
        self.weight.write(window, self.weight.read(window) + level.weight)


def _in_turn(make: Callable[[int], list[Level]], count: int, workers: int) -> Iterator[list[Level]]:
    """What is made of 0, 1, 2 and so on by threads, in this order; few are made ahead."""
    if workers < 2:
        yield from map(make, range(count))
        return
    with ThreadPoolExecutor(max_workers=workers) as pool:
        ahead = deque(pool.submit(make, index) for index in range(min(workers + 1, count)))
        for following in range(len(ahead), count + len(ahead)):
            found = ahead.popleft().result()
            if following < count:
                ahead.append(pool.submit(make, following))
            yield found


def _levels(source: ProxySource, labels: SparseRaster, own: OwnLow, index: int) -> list[Level]:
    """Levels of a photo about its cell; none if it has no cell."""
    cell = labels.read(aligned(source.windows[index])) == index
    if not cell.any():
        return []
    proxy = source.load(index)
    values, share, at = first_level(proxy.data, proxy.valid, proxy.window)
    own.keep(index, values, at)
    return levels_of(values, share, at, cell)


def _shifted(window: Window, by: int) -> Window:
    return Window(
        col=window.col + by, row=window.row + by, width=window.width, height=window.height
    )


def low_of(data: Values, valid: Mask, window: Window) -> tuple[Values, Window]:
    """A photo's low frequencies at half the coarse resolution, and the window they cover."""
    values, _, at = first_level(data, valid, window)
    return values, at


def _collapsed(sums: list[_Sums], block: Window, bands: int) -> Values:
    """Sum of the levels over a block of level 1; NaN where no photo has the ground."""
    # pixels that an interpolation at the rim of a window would get wrong
    margin = 4
    above: Values = np.zeros((0, 0, bands), np.float32)
    above_left = above_top = 0
    weight = np.zeros((0, 0), np.float32)
    for k in range(LEVELS - 1, -1, -1):
        window = Window(
            col=(block.col >> k) - margin, row=(block.row >> k) - margin,
            width=(block.width >> k) + 2 * margin + 1, height=(block.height >> k) + 2 * margin + 1,
        )  # fmt: skip
        weight = sums[k].weight.read(window)
        band = over(sums[k].bands.read(window), weight, 1e-9)
        if above.size:
            up = doubled(above, (2 * above.shape[0], 2 * above.shape[1]))
            rows, cols = window.row - 2 * above_top, window.col - 2 * above_left
            band += up[rows : rows + window.height, cols : cols + window.width]
        above, above_left, above_top = band, window.col, window.row
    inner = (slice(margin, margin + block.height), slice(margin, margin + block.width))
    out = above[inner]
    out[weight[inner] <= 1e-6] = np.nan
    return out
