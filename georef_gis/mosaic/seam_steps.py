"""Steps of brightness across the seams of a mosaic: between the photos, and in the result."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import BLOCK, ProxySource, SparseRaster
from georef_gis.mosaic.low_blend import LowBlend, low_of

Values = NDArray[np.float32]
Indices = NDArray[np.int64]
# coarse px: side of the squares whose means are compared, and places left out between two
SIDE, EVERY = 9, 4
# photos in memory at once
KEPT = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeamPlaces:
    """Places on seams: the photos on both sides, column and row of the coarse grid; all (k,)."""

    a: Indices
    b: Indices
    col: Indices
    row: Indices

    def __len__(self) -> int:
        """Return the number of places."""
        return int(self.a.size)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeamSteps:
    """Differences of two photos at their seam, grey values; NaN where one does not show it.

    `between` (k, bands) of the photos with their colours corrected; `left` (k, bands) with the
    low frequencies blended, as in the result.
    """

    places: SeamPlaces
    between: Values
    left: Values

    def as_json(self, scale: float) -> dict[str, Any]:
        """Medians and 90th percentiles over all places and bands, in 255ths of `scale`."""
        out: dict[str, Any] = {"places": len(self.places)}
        for name, values in (("between_photos", self.between), ("in_the_result", self.left)):
            size = np.abs(values[np.all(np.isfinite(values), axis=1)]) * (255.0 / scale)
            known = size.size > 0
            out[name] = {
                "median": float(np.median(size)) if known else None,
                "p90": float(np.percentile(size, 90)) if known else None,
            }
        return out


def seam_places(labels: SparseRaster) -> SeamPlaces:
    """Every `EVERY`-th place at which two photos meet, block by block."""
    found: list[NDArray[np.int64]] = []
    for block in labels:
        grown = Window(col=block.col, row=block.row, width=BLOCK + 1, height=BLOCK + 1)
        own = labels.read(grown)
        for other in (own[:-1, 1:], own[1:, :-1]):
            here = own[:-1, :-1]
            rows, cols = np.nonzero((here != other) & (here >= 0) & (other >= 0))
            chosen = (rows + block.row + cols + block.col) % EVERY == 0
            rows, cols = rows[chosen], cols[chosen]
            a, b = here[rows, cols], other[rows, cols]
            pair = np.minimum(a, b), np.maximum(a, b)
            found.append(np.stack([*pair, cols + block.col, rows + block.row]).astype(np.int64))
    table = np.concatenate(found, axis=1) if found else np.zeros((4, 0), np.int64)
    order = np.lexsort((table[3], table[2], table[1], table[0]))
    a, b, col, row = table[:, order]
    return SeamPlaces(a=a, b=b, col=col, row=row)


class _Means:
    """Means of photos about every coarse pixel, those used last kept."""

    def __init__(self, source: ProxySource, blend: LowBlend | None) -> None:
        self._source, self._blend = source, blend
        self._kept: OrderedDict[int, tuple[Window, Values, Values]] = OrderedDict()

    def at(self, index: int, col: Indices, row: Indices) -> tuple[Values, Values]:
        """Mean of a photo at places, and the same in the result; (k, bands) each."""
        if index not in self._kept:
            self._kept[index] = self._made(index)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        window, mean, result = self._kept[index]
        c, r = col - window.col, row - window.row
        inside = (c >= 0) & (r >= 0) & (c < window.width) & (r < window.height)
        c, r = np.where(inside, c, 0), np.where(inside, r, 0)
        gone = np.float32(np.nan)
        return (
            np.where(inside[:, None], mean[r, c], gone),
            np.where(inside[:, None], result[r, c], gone),
        )

    def _made(self, index: int) -> tuple[Window, Values, Values]:
        proxy = self._source.load(index)
        w, valid = proxy.window, proxy.valid.astype(np.float32)
        mean = _means(proxy.data, valid)
        if self._blend is None:
            return w, mean, mean
        base, own = low_of(proxy.data, proxy.valid, w)
        half = Window(
            col=w.col // 2, row=w.row // 2, width=w.width // 2 + 1, height=w.height // 2 + 1
        )
        added = self._blend.correction(half, base, own)
        rows = np.arange(w.row, w.row + w.height) // 2 - half.row
        cols = np.arange(w.col, w.col + w.width) // 2 - half.col
        return w, mean, mean + _means(added[rows[:, None], cols[None, :]], valid)


def _means(data: Values, valid: Values) -> Values:
    """Means over squares of valid pixels; NaN where less than half of a square is."""
    total = cv2.blur(data * valid[..., None], (SIDE, SIDE)).reshape(data.shape)
    share = cv2.blur(valid, (SIDE, SIDE))
    out: Values = np.asarray(total / np.maximum(share, 1e-6)[..., None], dtype=np.float32)
    out[share < 0.5] = np.nan
    return out


def measure_steps(
    source: ProxySource,
    labels: SparseRaster,
    blend: LowBlend | None,
    bands: int,
    check: Callable[[], None] = lambda: None,
) -> SeamSteps:
    """Compare the photos on both sides of every seam; `check` may raise to stop."""
    places = seam_places(labels)
    means = _Means(source, blend)
    between = np.full((len(places), bands), np.nan, np.float32)
    left = between.copy()
    pair = places.a * (1 << 32) + places.b
    starts = np.flatnonzero(np.diff(pair, prepend=-1))
    for first, last in pairwise([*starts, len(places)]):
        check()
        here = slice(int(first), int(last))
        col, row = places.col[here], places.row[here]
        a = means.at(int(places.a[first]), col, row)
        b = means.at(int(places.b[first]), col, row)
        between[here], left[here] = a[0] - b[0], a[1] - b[1]
    return SeamSteps(places=places, between=between, left=left)
