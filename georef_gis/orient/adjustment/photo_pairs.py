"""Pairs of photos that see a point together, and matrices of a block for each pair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix

from georef_gis.frames import Array
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.adjustment.kernels import MAX_RAYS


def pairs_of(observations: TiePoints, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Photos that see a point together, as rows: where row i begins, and its columns j >= i."""
    keys = [np.arange(n, dtype=np.int64) * (n + 1)]
    photo, point = observations.photo.astype(np.int64), observations.point
    for shift in range(1, MAX_RAYS):
        together = point[shift:] == point[:-shift]
        if not np.any(together):
            break
        a, b = photo[:-shift][together], photo[shift:][together]
        keys.append(np.unique(np.minimum(a, b) * n + np.maximum(a, b)))
    pairs = np.unique(np.concatenate(keys))
    start = np.searchsorted(pairs // n, np.arange(n + 1)).astype(np.int64)
    return start, pairs % n


def rows_and_columns(
    pattern: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of every pair that `pairs_of` found."""
    start, column = pattern
    return np.repeat(np.arange(len(start) - 1), np.diff(start)), column


def symmetric(
    row: NDArray[np.int64], column: NDArray[np.int64], blocks: Array, n: int
) -> bsr_matrix:
    """Sparse symmetric matrix of one half of its blocks; (6 n, 6 n)."""
    off = row != column
    rows = np.concatenate([row, column[off]])
    columns = np.concatenate([column, row[off]])
    data = np.concatenate([blocks, np.swapaxes(blocks[off], 1, 2)])
    order = np.lexsort((columns, rows))
    start = np.searchsorted(rows[order], np.arange(n + 1))
    return bsr_matrix((data[order], columns[order], start), shape=(6 * n, 6 * n))
