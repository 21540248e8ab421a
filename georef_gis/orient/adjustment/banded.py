"""Normal equations of large blocks: a band of photos in an order that keeps it narrow.

Photos that share points or a stretch of the flight lie near each other in the order of Cuthill
and McKee; what all photos share stands in a border. The factor of the band is small enough to
be kept: 26 MB for 1 000 photos where the whole inverse would take 300.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import bsr_matrix, csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from georef_gis.frames import Array
from georef_gis.orient.adjustment.covariance_kernels import band_inverse


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BandOrder:
    """Where each unknown of a pose lies in the band, and how wide the band is."""

    position: NDArray[np.int64]
    width: int


def band_order(pairs: csr_matrix) -> BandOrder:
    """Order of the photos that keeps the band narrow; `pairs` (n, n) tells who is connected."""
    n = pairs.shape[0]
    order = np.asarray(reverse_cuthill_mckee(pairs.tocsr(), symmetric_mode=True))
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    coo = pairs.tocoo()
    reach = int(np.abs(place[coo.row] - place[coo.col]).max(initial=0))
    position = (6 * place[:, None] + np.arange(6)).ravel()
    return BandOrder(position=position, width=6 * (reach + 1))


class BandedFactor:
    """Factor of a bordered normal matrix, poses first, scaled to a unit diagonal."""

    def __init__(
        self, poses: bsr_matrix, border: Array, corner: Array, order: BandOrder, damping: float
    ) -> None:
        """Factor it.

        Parameters
        ----------
        poses : shape (6 n, 6 n)
            Symmetric, both halves.
        border : shape (6 n, G)
        corner : shape (G, G)

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        self.order = order
        self.scale = 1.0 / np.sqrt(np.maximum(poses.diagonal(), 1e-300))
        self.scale_shared = 1.0 / np.sqrt(np.maximum(np.diag(corner), 1e-300))
        coo = poses.tocoo()
        row, column = order.position[coo.row], order.position[coo.col]
        lower = row >= column
        band = np.zeros((order.width, len(self.scale)))
        values = coo.data * self.scale[coo.row] * self.scale[coo.col]
        np.add.at(band, ((row - column)[lower], column[lower]), values[lower])
        band[0] = 1.0 + damping
        self._band = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
        E = border * self.scale[:, None] * self.scale_shared
        self._E = E
        self._Y = self._solve_poses(E)
        C = corner * self.scale_shared[:, None] * self.scale_shared
        C[np.diag_indices_from(C)] = 1.0 + damping
        self._corner = cho_factor(C - E.T @ self._Y, lower=True, check_finite=False)

    def _solve_poses(self, rhs: Array) -> Array:
        """Solution of the poses' part alone, in the photos' own order."""
        inside = np.empty_like(rhs)
        inside[self.order.position] = rhs
        out = cho_solve_banded((self._band, True), inside, check_finite=False)
        return np.asarray(out[self.order.position])

    @property
    def lower(self) -> Array:
        """Cholesky factor of the poses' part, a lower band (width, 6 n) in the band's order."""
        return np.asarray(self._band)

    def solve(self, rhs: Array) -> Array:
        """Solution for a right side of poses, then shared unknowns; (N,) or (N, k)."""
        n = len(self.scale)
        flat = rhs if rhs.ndim == 2 else rhs[:, None]
        r = flat[:n] * self.scale[:, None]
        q = flat[n:] * self.scale_shared[:, None]
        x = self._solve_poses(r)
        g = cho_solve(self._corner, q - self._E.T @ x, check_finite=False)
        x = x - self._Y @ g
        out = np.vstack([x * self.scale[:, None], g * self.scale_shared[:, None]])
        if not np.all(np.isfinite(out)):
            raise np.linalg.LinAlgError("step is not finite")
        return np.asarray(out if rhs.ndim == 2 else out[:, 0])

    def selected_inverse(self) -> tuple[Array, Array, Array]:
        """What of the inverse is needed for photos that see the same points.

        Returns
        -------
        band : shape (width, 6 n)
            Lower band of the inverse of the poses' part alone, in the order of the band.
        to_shared : shape (6 n, G)
            Y, so that the covariance of poses is the band plus Y Z^-1 Y^T, in the photos' order.
        shared : shape (G, G)
            Z^-1, the covariance of the shared unknowns.

        Notes
        -----
        Takahashi, Fagan, Chin (1973): the entries of the inverse within the band of the factor.
        """
        band = np.empty_like(self._band)
        band_inverse(self._band, band)
        place = self.order.position
        at = np.empty_like(self.scale)
        at[place] = self.scale
        width, n = band.shape
        for k in range(width):
            band[k, : n - k] *= at[: n - k] * at[k:]
        shared = cho_solve(self._corner, np.eye(len(self.scale_shared)))
        shared *= self.scale_shared[:, None] * self.scale_shared
        to_shared = self._Y * self.scale[:, None] / self.scale_shared
        return band, to_shared, shared
