"""Low frequencies of a mosaic blended over seams, as a correction of each photo.

Seen from far, neighbouring photos differ by a little in brightness wherever they meet. A Laplacian
pyramid (Burt & Adelson 1983, ACM Trans. Graphics 2, 217) of the photos on the coarse grid blends
every frequency over its own width; what it changes in a photo is smooth, and is added to the
photo's pixels when a tile is made. So a tile needs no halo, and any tiling gives the same pixels.
The finest level stays as it is: detail changes from photo to photo at the seam itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import ProxySource, SparseRaster

# levels of the pyramid: the widest change takes some 2 ** LEVELS coarse px
LEVELS = 5
ALIGNED = 1 << LEVELS
# coarse px around the grid: photos are continued beyond it
PAD = 2 * ALIGNED
Values = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Levels:
    """One photo's pyramid: window at every level, band-pass values, weights."""

    windows: tuple[Window, ...]
    bands: tuple[Values, ...]
    weights: tuple[Values, ...]


class LowBlend:
    """The blended low frequencies of a mosaic, at half the coarse resolution.

    Parameters
    ----------
    low : bands, float32
        Blend of the photos; sample (col, row) lies in the centre of coarse pixel (2 col, 2 row).
    bands
        Number of bands.
    """

    def __init__(self, low: SparseRaster, bands: int) -> None:
        self.low = low
        self.bands = bands

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
) -> LowBlend:
    """Blend the low frequencies of corrected photos by their labels; `check` may raise to stop.

    Memory grows with the ground covered: a third of (bands + 1) floats a coarse pixel.
    """
    sums = [
        SparseRaster(
            width=(coarse.width + 3 * PAD) >> k, height=(coarse.height + 3 * PAD) >> k,
            dtype=np.float32, fill=0.0, bands=bands + 1,
        )
        for k in range(LEVELS + 1)
    ]  # fmt: skip
    for index in range(len(source.ids)):
        check()
        levels = _pyramid(source, index, labels)
        if levels is None:
            continue
        for k in range(1, LEVELS + 1):
            window, weight = _shifted(levels.windows[k], PAD >> k), levels.weights[k]
            gained = np.concatenate([levels.bands[k] * weight[..., None], weight[..., None]], -1)
            sums[k].write(window, sums[k].read(window) + gained)
    low = SparseRaster(
        width=coarse.width // 2 + 1, height=coarse.height // 2 + 1, dtype=np.float32, fill=np.nan,
        bands=bands,
    )  # fmt: skip
    for block in sums[1]:
        low.write(_shifted(block, -(PAD >> 1)), _collapsed(sums, block, bands))
    return LowBlend(low, bands)


def _shifted(window: Window, by: int) -> Window:
    return Window(
        col=window.col + by, row=window.row + by, width=window.width, height=window.height
    )


def low_of(data: Values, valid: NDArray[np.bool_], window: Window) -> tuple[Values, Window]:
    """A photo's low frequencies at half the coarse resolution, and the window they cover."""
    grown, inside, at = _aligned(data, valid, window)
    values, share = _halved(grown, inside)
    values = _filled(values, share)
    return values, Window(
        col=at.col // 2, row=at.row // 2, width=values.shape[1], height=values.shape[0]
    )


def _aligned(
    data: Values, valid: NDArray[np.bool_], window: Window
) -> tuple[Values, Values, Window]:
    """Values and validity (0 or 1) on a window whose corner lies on all levels' pixels.

    Pixels of the coarsest level lie around it: interpolation from there must not meet nothing.
    """
    left, top = (window.col // ALIGNED - 1) * ALIGNED, (window.row // ALIGNED - 1) * ALIGNED
    right = (-(-(window.col + window.width) // ALIGNED) + 2) * ALIGNED
    bottom = (-(-(window.row + window.height) // ALIGNED) + 2) * ALIGNED
    out = np.zeros((bottom - top, right - left, data.shape[2]), np.float32)
    inside = np.zeros(out.shape[:2], np.float32)
    rows = slice(window.row - top, window.row - top + window.height)
    cols = slice(window.col - left, window.col - left + window.width)
    out[rows, cols] = np.where(valid[..., None], data, np.float32(0.0))
    inside[rows, cols] = valid
    return out, inside, Window(col=left, row=top, width=right - left, height=bottom - top)


def _halved(values: Values, weight: Values) -> tuple[Values, Values]:
    """Next level of values where there are any, and how much of it there was."""
    total = cv2.pyrDown(values * weight[..., None])
    share = cv2.pyrDown(weight)
    total = total.reshape((*share.shape, values.shape[2]))
    out = total / np.maximum(share, np.float32(1e-6))[..., None]
    return np.asarray(out, dtype=np.float32), np.asarray(share, dtype=np.float32)


def _doubled(values: Values, shape: tuple[int, int]) -> Values:
    """Level above, by interpolation."""
    up = cv2.pyrUp(values, dstsize=(shape[1], shape[0]))
    return np.asarray(up.reshape((*shape, values.shape[2])), dtype=np.float32)


def _pyramid(source: ProxySource, index: int, labels: SparseRaster) -> _Levels | None:
    proxy = source.load(index)
    data, valid, window = _aligned(proxy.data, proxy.valid, proxy.window)
    own = (labels.read(window) == index).astype(np.float32)
    if not own.any():
        return None
    values, shares, weights, windows = [data], [valid], [own], [window]
    for _ in range(LEVELS):
        smaller, share = _halved(values[-1], shares[-1])
        values.append(_filled(smaller, share))
        shares.append(np.minimum(share, np.float32(1.0)))
        weights.append(np.asarray(cv2.pyrDown(weights[-1]), dtype=np.float32))
        last = windows[-1]
        rows, cols = share.shape
        windows.append(Window(col=last.col // 2, row=last.row // 2, width=cols, height=rows))
    bands = [values[k] - _doubled(values[k + 1], values[k].shape[:2]) for k in range(LEVELS)]
    bands.append(values[LEVELS])
    # a photo has a say where it is, and hardly any beyond its rim
    weights = [w * (s + np.float32(1e-3)) for w, s in zip(weights, shares, strict=True)]
    return _Levels(tuple(windows), tuple(bands), tuple(weights))


def _filled(values: Values, share: Values) -> Values:
    """Values continued where a photo has none, so that its rim makes no band of its own."""
    bare = share <= 1e-3
    if not bare.any() or bare.all():
        return values
    known = (~bare).astype(np.float32)
    out, have = values * known[..., None], known
    for size in (3, 5, 9, 17, 33):
        total = cv2.blur(out, (size, size)).reshape(values.shape)
        count = cv2.blur(have, (size, size))
        fill = total / np.maximum(count, np.float32(1e-6))[..., None]
        reached = (have <= 0) & (count > 0)
        out = np.where(reached[..., None], fill, out)
        have = np.maximum(have, reached.astype(np.float32))
    return np.asarray(out, dtype=np.float32)


def _collapsed(sums: list[SparseRaster], block: Window, bands: int) -> Values:
    """Sum of the levels over a block of level 1; NaN where no photo has the ground."""
    # pixels that an interpolation at the rim of a window would get wrong
    margin = 4
    above: Values = np.zeros((0, 0, bands), np.float32)
    above_left = above_top = 0
    weight = np.zeros((0, 0), np.float32)
    for k in range(LEVELS, 0, -1):
        left, top = (block.col >> (k - 1)) - margin, (block.row >> (k - 1)) - margin
        width = (block.width >> (k - 1)) + 2 * margin + 1
        height = (block.height >> (k - 1)) + 2 * margin + 1
        total = sums[k].read(Window(col=left, row=top, width=width, height=height))
        weight = total[..., bands]
        band: Values = np.asarray(
            total[..., :bands] / np.maximum(weight, np.float32(1e-9))[..., None], dtype=np.float32
        )
        if above.size:
            up = _doubled(above, (2 * above.shape[0], 2 * above.shape[1]))
            rows, cols = top - 2 * above_top, left - 2 * above_left
            band = band + up[rows : rows + height, cols : cols + width]
        above, above_left, above_top = band, left, top
    inner = (slice(margin, margin + block.height), slice(margin, margin + block.width))
    return np.where((weight[inner] > 1e-6)[..., None], above[inner], np.float32(np.nan))
