"""Steps of brightness across the seams of a mosaic: between the photos, and in the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import BLOCK, ProxySource, SparseRaster
from georef_gis.mosaic.low_blend import LowBlend

Values = NDArray[np.float32]
Indices = NDArray[np.int64]
# coarse px: side of the squares whose means are compared, and places left out between two
SIDE, EVERY = 9, 4


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


def measure_steps(
    source: ProxySource,
    labels: SparseRaster,
    blend: LowBlend | None,
    bands: int,
    check: Callable[[], None] = lambda: None,
) -> SeamSteps:
    """Compare the photos on both sides of every seam; `check` may raise to stop."""
    places = seam_places(labels)
    photo = np.concatenate([places.a, places.b])
    means = np.full((2, photo.size, bands), np.nan, np.float32)
    # photo by photo: each is loaded once
    order = np.argsort(photo, kind="stable")
    for here in np.split(order, np.flatnonzero(np.diff(photo[order])) + 1):
        check()
        if here.size:
            at = here % len(places)
            label = int(photo[here[0]])
            means[:, here] = _means(source, blend, label, places.col[at], places.row[at])
    a, b = means[:, : len(places)], means[:, len(places) :]
    return SeamSteps(places=places, between=a[0] - b[0], left=a[1] - b[1])


def _means(
    source: ProxySource, blend: LowBlend | None, label: int, col: Indices, row: Indices
) -> Values:
    """Means about places of a photo and the same in the result; (2, k, bands), NaN if unknown.

    Unknown is what the photo shows less than half of.
    """
    proxy = source.load(label)
    window = proxy.window
    cols, inside = _around(col - window.col, window.width)
    rows, within = _around(row - window.row, window.height)
    rows, cols = rows[:, :, None], cols[:, None, :]
    valid = proxy.valid[rows, cols]
    data = np.where(valid[..., None], proxy.data[rows, cols], np.float32(0.0))
    count = np.count_nonzero(valid, axis=(1, 2))
    mean = data.sum(axis=(1, 2), dtype=np.float64) / np.maximum(count, 1)[:, None]
    mean[~(inside & within & (2 * count >= SIDE * SIDE))] = np.nan
    if blend is None:
        return np.stack([mean, mean])
    added = _added(blend, label, window.col + cols, window.row + rows)
    added = np.where(valid[..., None], added, np.float32(0.0)).sum(axis=(1, 2), dtype=np.float64)
    return np.stack([mean, mean + added / np.maximum(count, 1)[:, None]])


def _around(place: Indices, size: int) -> tuple[Indices, NDArray[np.bool_]]:
    """Places about each along one axis, mirrored at the ends, and which lie inside at all.

    Shapes (k, SIDE) and (k,).
    """
    near = np.abs(place[:, None] + np.arange(SIDE) - SIDE // 2)
    near = np.clip(np.minimum(near, 2 * (size - 1) - near), 0, size - 1)
    return near, (place >= 0) & (place < size)


def _added(blend: LowBlend, label: int, cols: Indices, rows: Indices) -> Values:
    """What the blend adds to a photo at places of the coarse grid; (..., bands)."""
    cols, rows = cols // 2, rows // 2
    left, top = int(cols.min()), int(rows.min())
    half = Window(
        col=left, row=top, width=int(cols.max()) + 1 - left, height=int(rows.max()) + 1 - top
    )
    added = blend.correction(half, *blend.own.of(label))
    return added[rows - top, cols - left]
