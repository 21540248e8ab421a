"""Sparse symmetric matrices filled again and again."""

from __future__ import annotations

import numpy as np

from georef_gis.mosaic.symmetric import SparseSymmetric


def test_entries_named_twice_are_added_and_both_sides_are_there(rng: np.random.Generator) -> None:
    size = 7
    blocks = [np.sort(rng.integers(0, size, (2, m)), axis=0) for m in (20, 1, 9)]
    pattern = SparseSymmetric(size, [(rows, cols) for rows, cols in blocks])
    for _ in range(2):
        values = [rng.normal(size=part.shape[1]) for part in blocks]
        want = np.zeros((size, size))
        for (rows, cols), given in zip(blocks, values, strict=True):
            for r, c, value in zip(rows, cols, given, strict=True):
                want[r, c] += value
                if r != c:
                    want[c, r] += value
        np.testing.assert_allclose(pattern.filled(values).toarray(), want, atol=1e-12)
