"""Pose errors of a large adjusted block: solved for the photos that are asked for.

The whole covariance of thousands of photos fills gigabytes; the factor of the normal matrix, a band
of photos that see each other and a border of what all share, is small. Within the band the inverse
is kept too, beyond it columns are solved.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve_banded

from georef_gis.frames import Array
from georef_gis.model.photo_stack import Ints

# photos whose columns are solved at once
_BATCH = 16
# numbers of columns that are kept: 64 MB
_MOST_NUMBERS = 8_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandErrors:
    """Joint covariance of n poses and of G unknowns that they share.

    Poses err by `a - to_shared g`: `a` has the inverse of the band as its covariance, `g` that of
    `shared`, and neither knows of the other.

    Parameters
    ----------
    factor : shape (width, 6 n)
        Cholesky factor, a lower band, of the poses' normal matrix with unit diagonal, in the order
        of the band.
    inverse : shape (width, 6 n), m and rad
        Lower band of the inverse of the poses' normal matrix, in the same order.
    position : shape (6 n,)
        Where each unknown of a pose lies in the band; the six of a pose lie together.
    scale : shape (6 n,), m and rad
        Of the unknowns of `factor`, in the photos' order.
    to_shared : shape (6 n, G)
    shared : shape (G, G)
    """

    factor: Array
    inverse: Array
    position: Ints
    scale: Array
    to_shared: Array
    shared: Array
    _columns: dict[int, Array] = field(default_factory=dict, init=False)

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        place = self.position.reshape(-1, 6)
        apart = np.abs(place[a, 0] - place[b, 0])
        near = np.flatnonzero(apart < len(self.factor) - 5)
        far = np.flatnonzero(apart >= len(self.factor) - 5)
        T = self.to_shared.reshape(len(place), 6, -1)
        out = T[a] @ self.shared @ np.swapaxes(T[b], 1, 2)
        i, j = place[a[near], :, None], place[b[near], None, :]
        out[near] += self.inverse[np.abs(i - j), np.minimum(i, j)]
        if len(far):
            self._add_far(out, far, a, b)
        return np.asarray(out)

    def _add_far(self, out: Array, far: Ints, a: Ints, b: Ints) -> None:
        """Add the inverse beyond the band, by columns of whichever photos are fewer."""
        turned = len(np.unique(a[far])) < len(np.unique(b[far]))
        row, column = (b, a) if turned else (a, b)
        order = far[np.argsort(column[far], kind="stable")]
        photos, first = np.unique(column[order], return_index=True)
        groups = np.split(order, first[1:])
        for start in range(0, len(photos), _BATCH):
            part = photos[start : start + _BATCH]
            solved = self._solved(part)
            for k, at in zip(part, groups[start : start + _BATCH], strict=True):
                block = solved[int(k)].reshape(-1, 6, 6)[row[at]]
                out[at] += np.swapaxes(block, 1, 2) if turned else block

    def _solved(self, photos: Ints) -> dict[int, Array]:
        """Columns (6 n, 6) of the inverse of the poses' normal matrix, by photo."""
        out = {int(k): self._columns[int(k)] for k in photos if int(k) in self._columns}
        new = [int(k) for k in photos if int(k) not in out]
        if not new:
            return out
        at = (6 * np.array(new, dtype=np.int64)[:, None] + np.arange(6)).ravel()
        right = np.zeros((len(self.scale), len(at)))
        right[self.position[at], np.arange(len(at))] = self.scale[at]
        found = cho_solve_banded((self.factor, True), right, overwrite_b=True, check_finite=False)
        found = found[self.position] * self.scale[:, None]
        solved = {k: found[:, 6 * i : 6 * i + 6].copy() for i, k in enumerate(new)}
        self._columns.update(solved)
        most = max(_MOST_NUMBERS // (6 * len(self.scale)), _BATCH)
        for k in list(self._columns)[:-most]:
            del self._columns[k]
        return out | solved

    def with_shared(self, photos: Ints, rows: Ints) -> Array:
        """Covariance of the poses of k photos with r shared unknowns; (k, 6, r)."""
        T = self.to_shared.reshape(len(self.scale) // 6, 6, -1)
        return np.asarray(-T[photos] @ self.shared[:, rows])
