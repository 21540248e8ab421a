"""Symmetric sparse matrices of one pattern, made again and again from new values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array

Indices = NDArray[np.int64]


class SparseSymmetric:
    """Where the entries of a matrix are; those named twice are added up.

    Parameters
    ----------
    size
        Rows, and columns.
    blocks
        Row and column numbers, (m,) each, of entries on the diagonal or on one side of it: the
        other side is made from them.
    """

    def __init__(self, size: int, blocks: Sequence[tuple[Indices, Indices]]) -> None:
        rows = np.concatenate([rows for rows, _ in blocks])
        cols = np.concatenate([cols for _, cols in blocks])
        self._beside = np.flatnonzero(rows != cols)
        first = cols * size + rows
        other = rows[self._beside] * size + cols[self._beside]
        places, self._place = np.unique(np.concatenate([first, other]), return_inverse=True)
        self._size = size
        self._rows = (places % size).astype(np.int32)
        starts = np.searchsorted(places, np.arange(size + 1, dtype=np.int64) * size)
        self._starts = starts.astype(np.int32)

    def filled(self, values: Sequence[Array]) -> Any:
        """Matrix (csc) with the values of each of the blocks."""
        from scipy.sparse import csc_matrix

        given = np.concatenate([part.ravel() for part in values])
        both = np.concatenate([given, given[self._beside]])
        data = np.bincount(self._place, both, minlength=self._rows.size)
        return csc_matrix((data, self._rows, self._starts), shape=(self._size, self._size))
