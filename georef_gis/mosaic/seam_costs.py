"""What a seam between two photos costs, by how much they differ where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.byte_cache import ByteCache
from georef_gis.mosaic.coarse import Proxy, ProxySource, common, part_of

Costs = NDArray[np.int32]
# cost of a seam through a place where two photos show different things; integers make sums exact
ONE = 10_000
# of the usual difference of a pair: that at which a place costs half of `ONE`. Noise and leaves
# stay below, vehicles and shadows lie above.
HALF_COST = 12.0
# part of the mean difference that the usual one is at least: it is the median, which is nothing
# where more than half of the pixels agree to the last digit
LEAST_SCALE = 0.25
# px; by so much what differs is widened: a seam keeps off the soft rim of a vehicle and closes the
# gaps where it is as grey as the road
WIDEN = 2
# px; so far do filters reach: gradient, mean, `WIDEN`, mean
REACH = WIDEN + 3
# rows of a pair that are worked on at once
PIECE = 128
# bytes of photos and of costs that are kept: those of a strip of a usual flight
PHOTO_BYTES, PAIR_BYTES = 96_000_000, 24_000_000
# about so many pixels are enough to find the scale of a difference
SAMPLE = 5000


@dataclass(frozen=True, slots=True, eq=False)
class PairCost:
    """Cost of a seam between two photos per pixel of what both cover; (rows, cols), uint16."""

    window: Window
    cost: NDArray[np.uint16]

    def at(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Costs:
        """Cost at pixels of the coarse grid; `ONE` where they do not show the ground both."""
        r, c = rows - self.window.row, cols - self.window.col
        inside = (r >= 0) & (c >= 0) & (r < self.window.height) & (c < self.window.width)
        out = np.full(rows.shape, ONE, np.int32)
        out[inside] = self.cost[r[inside], c[inside]]
        return out


NOWHERE = PairCost(Window(col=0, row=0, width=0, height=0), np.zeros((0, 0), np.uint16))


def pair_cost(a: Proxy, b: Proxy) -> PairCost:
    """Cost of a seam between two photos: bounded difference of their colours and gradients.

    Differences count in units of what is usual for the pair and band, so that neither the range
    of the values nor the contrast of a flight matters.
    """
    both = common(a.window, b.window)
    if both is None:
        return NOWHERE
    part_a, part_b = part_of(a.window, both), part_of(b.window, both)
    data_a, data_b = a.data[part_a], b.data[part_b]
    valid = a.valid[part_a] & b.valid[part_b]
    out = np.full(valid.shape, ONE, np.uint16)
    if not valid.any():
        return PairCost(both, out)
    weights = _weights(data_a, data_b, valid)
    # in pieces that stay in the processor's cache
    for top in range(0, both.height, PIECE):
        first, end = max(top - REACH, 0), min(top + PIECE, both.height)
        rows = slice(first, min(end + REACH, both.height))
        cost = _costs(data_a[rows], data_b[rows], valid[rows], weights)
        np.copyto(out[top:end], cost[top - first : end - first], where=valid[top:end])
    return PairCost(both, out)


def _weights(
    a: NDArray[np.float32], b: NDArray[np.float32], valid: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Weight of each band's squares: they then count in usual differences, all bands alike."""
    few = (slice(None, None, max(1, round((valid.size / SAMPLE) ** 0.5))),) * 2
    few = few if valid[few].any() else (slice(None),) * 2
    values = np.abs(a[few][valid[few]] - b[few][valid[few]])
    mean = values.mean(axis=0, dtype=np.float64)
    scale = np.maximum(np.median(values, axis=0), LEAST_SCALE * mean)
    used = scale > 0.0
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale, dtype=np.float64), where=used)
    return np.asarray(inverse**2 / max(int(used.sum()), 1), dtype=np.float32)


def _costs(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    valid: NDArray[np.bool_],
    weights: NDArray[np.float32],
) -> NDArray[np.uint16]:
    """Costs from the values of two photos; a pixel's depend on those within `REACH` of it."""
    all_of_it = cv2.subtract(a, b)
    # Elsewhere may be anything, NaN too.
    shown = cv2.copyTo(all_of_it, valid.view(np.uint8)).reshape(*valid.shape, -1)
    strength = _strength(np.asarray(shown, dtype=np.float32), weights)
    cost = strength / (strength + np.float32(HALF_COST**2)) * np.float32(ONE)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * WIDEN + 1, 2 * WIDEN + 1))
    wide = cv2.blur(cv2.dilate(cost, kernel), (3, 3))
    return np.rint(np.minimum(wide, ONE)).astype(np.uint16)


def _strength(difference: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Square of colour and gradient differences, weighted mean of the bands; (rows, cols)."""
    total = (difference * difference) @ weights
    for dx, dy in ((1, 0), (0, 1)):
        slope = cv2.Sobel(difference, cv2.CV_32F, dx, dy, ksize=1, scale=0.5)
        slope = slope.reshape(difference.shape)
        total += (slope * slope) @ weights
    return np.asarray(cv2.blur(total, (3, 3)), dtype=np.float32)


class PairCosts:
    """Pair costs of a mosaic; photos and costs last used are kept. Any thread may ask."""

    def __init__(self, source: ProxySource) -> None:
        self.photo: ByteCache[int, Proxy] = ByteCache(source.load, budget=PHOTO_BYTES)
        self._pair = ByteCache(partial(_made, self.photo), budget=PAIR_BYTES)

    def between(self, a: int, b: int) -> PairCost:
        """Cost of a seam between two photos, in either order."""
        return self._pair((a, b) if a < b else (b, a))


def _made(photo: Callable[[int], Proxy], pair: tuple[int, int]) -> PairCost:
    return pair_cost(photo(pair[0]), photo(pair[1]))
