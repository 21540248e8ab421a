"""Places whose score is high, joined to regions; of a large site only those cells are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.reading import Window

# cells that may lie between two of a region
_GAP = 2
# part of the compared cells that may be looked at
MOST_PART = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """Cells that belong together.

    Parameters
    ----------
    window
        That holds them.
    rows, cols, scores : shape (n,)
        Of the cells, in the grid.
    """

    window: Window
    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    scores: NDArray[np.float32]

    @property
    def peak(self) -> float:
        """Largest score."""
        return float(self.scores.max())


def join(
    rows: NDArray[np.int64], cols: NDArray[np.int64], scores: NDArray[np.float32], width: int
) -> list[Region]:
    """Regions of cells of a grid so many cells wide."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(rows):
        return []
    # the gap beside the grid keeps the ends of two rows apart
    stride = width + 2 * _GAP
    keys = rows * stride + cols
    order = np.argsort(keys)
    keys, rows, cols, scores = keys[order], rows[order], cols[order], scores[order]
    first, second = [], []
    for offset in _offsets(stride):
        place = np.searchsorted(keys, keys + offset)
        place[place == len(keys)] = 0
        hit = keys[place] == keys + offset
        first.append(np.flatnonzero(hit))
        second.append(place[hit])
    one, two = np.concatenate(first), np.concatenate(second)
    graph = coo_array((np.ones(len(one), np.bool_), (one, two)), shape=(len(keys), len(keys)))
    labels = connected_components(graph, directed=False)[1]
    order = np.argsort(labels, kind="stable")
    bounds = np.flatnonzero(np.diff(labels[order])) + 1
    return [_region(part, rows, cols, scores) for part in np.split(order, bounds)]


def _offsets(stride: int) -> Sequence[int]:
    return [
        down * stride + across
        for down in range(_GAP + 1)
        for across in range(-_GAP, _GAP + 1)
        if (down, across) > (0, 0)
    ]


def _region(
    part: NDArray[np.intp],
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    scores: NDArray[np.float32],
) -> Region:
    r, c = rows[part], cols[part]
    window = (
        int(c.min()), int(r.min()), int(c.max() - c.min() + 1), int(r.max() - r.min() + 1),
    )  # fmt: skip
    return Region(window=window, rows=r, cols=c, scores=scores[part])
