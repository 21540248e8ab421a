"""Parts of a raster of labels: which touch, and which are too small to be of use."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import BLOCK, Mask, Proxy, SparseRaster, common, part_of
from georef_gis.mosaic.min_cut import STEPS
from georef_gis.mosaic.windows import box_of, grown

Labels = NDArray[np.int32]
Indices = NDArray[np.intp]
# first row and column, last row and column
Box = tuple[int, int, int, int]


def touching(labels: SparseRaster) -> dict[tuple[int, int], Window]:
    """Pairs of labels (smaller first, in order) that share a side of a pixel, and where.

    The window has the pixels on both sides of all that they share.
    """
    found: dict[tuple[int, int], Box] = {}
    for window in labels:
        part = labels.read(
            Window(col=window.col, row=window.row, width=BLOCK + 1, height=BLOCK + 1)
        )
        for dr, dc in STEPS:
            p, q = part[: BLOCK + 1 - dr, : BLOCK + 1 - dc], part[dr:, dc:]
            rows, cols = np.nonzero(p != q)
            low, high = np.sort([p[rows, cols], q[rows, cols]], axis=0)
            shown = low >= 0
            rows, cols = rows[shown] + window.row, cols[shown] + window.col
            for pair, (top, left, bottom, right) in _boxes(low[shown], high[shown], rows, cols):
                box = top, left, bottom + dr, right + dc
                found[pair] = _union(found.get(pair, box), box)
    return {
        pair: Window(col=left, row=top, width=right - left + 1, height=bottom - top + 1)
        for pair, (top, left, bottom, right) in sorted(found.items())
    }


def _boxes(
    low: Labels, high: Labels, rows: Indices, cols: Indices
) -> Iterator[tuple[tuple[int, int], Box]]:
    """Pairs of labels and the boxes around their pixels."""
    order = np.lexsort([high, low])
    low, high, rows, cols = low[order], high[order], rows[order], cols[order]
    starts = np.flatnonzero(np.diff(low, prepend=-1) | np.diff(high, prepend=-1))
    if not starts.size:
        return
    ends = [f.reduceat(v, starts).tolist() for f in (np.minimum, np.maximum) for v in (rows, cols)]
    pairs = zip(low[starts].tolist(), high[starts].tolist(), strict=True)
    yield from zip(pairs, zip(*ends, strict=True), strict=True)


def _union(a: Box, b: Box) -> Box:
    """Box around two."""
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def dissolve_specks(
    labels: SparseRaster, index: int, window: Window, photo: Callable[[int], Proxy], smallest: int
) -> None:
    """Give parts of a label with fewer pixels than `smallest` to a neighbour that shows them.

    Its largest part stays whatever its size, and so does one that no neighbour shows whole.

    Parameters
    ----------
    window
        In which the label lies.
    photo
        Gives the photo of a label.
    """
    box = box_of(labels.read(window) == index, window)
    if box is None:
        return
    window = grown(box)
    values = labels.read(window)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(
        (values == index).view(np.uint8), connectivity=4
    )
    if count <= 2:
        return
    areas = stats[1:, cv2.CC_STAT_AREA]
    largest = int(np.argmax(areas)) + 1
    for k in np.flatnonzero(areas < smallest) + 1:
        if k == largest:
            continue
        left, top, width, height = (int(v) for v in stats[k, :4])
        part = slice(top - 1, top + height + 1), slice(left - 1, left + width + 1)
        speck = parts[part] == k
        at = Window(
            col=window.col + left - 1, row=window.row + top - 1,
            width=speck.shape[1], height=speck.shape[0],
        )  # fmt: skip
        for heir in _neighbours(values[part], speck, index):
            if _shows(photo(heir), at, speck):
                values[part][speck] = heir
                labels.write(at, np.full(speck.shape, heir, np.int32), speck)
                break


def _neighbours(values: Labels, speck: Mask, index: int) -> list[int]:
    """Labels around a part, the one with the longest common border first."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    ring = (cv2.dilate(speck.view(np.uint8), cross) > 0) & ~speck
    found, counts = np.unique(values[ring], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return [int(v) for v in found[order] if v >= 0 and v != index]


def _shows(photo: Proxy, window: Window, where: Mask) -> bool:
    """Whether a photo shows the ground at all pixels of a mask over a window."""
    both = common(photo.window, window)
    if both is None:
        return False
    valid = photo.valid[part_of(photo.window, both)]
    inside = where[part_of(window, both)]
    return int(inside.sum()) == int(where.sum()) and bool(valid[inside].all())
