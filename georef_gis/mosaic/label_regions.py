"""Parts of a raster of labels: which touch, and which are too small to be of use."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import BLOCK, Mask, Proxy, SparseRaster, common, part_of

Labels = NDArray[np.int32]


def touching(labels: SparseRaster) -> list[tuple[int, int]]:
    """Pairs of labels (smaller first, in order) that share a side of a pixel somewhere."""
    found: set[tuple[int, int]] = set()
    for window in labels:
        part = labels.read(
            Window(col=window.col, row=window.row, width=BLOCK + 1, height=BLOCK + 1)
        )
        for p, q in ((part[:, :-1], part[:, 1:]), (part[:-1], part[1:])):
            here = (p != q) & (p >= 0) & (q >= 0)
            pairs = np.stack([p[here], q[here]], axis=1)
            pairs.sort(axis=1)
            found.update((int(a), int(b)) for a, b in np.unique(pairs, axis=0))
    return sorted(found)


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
        box = slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)
        speck = parts[box] == k
        at = Window(
            col=window.col + box[1].start, row=window.row + box[0].start,
            width=speck.shape[1], height=speck.shape[0],
        )  # fmt: skip
        for heir in _neighbours(values[box], speck, index):
            if _shows(photo(heir), at, speck):
                values[box][speck] = heir
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
