"""Normal equations of blocks up to some hundred photos: one dense matrix."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpocon

from georef_gis.frames import Array


class DenseFactor:
    """Cholesky factor of a normal matrix scaled to a unit diagonal."""

    def __init__(self, H: Array, damping: float) -> None:
        """Factor it; `H` (N, N) is used up.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        self.scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
        H *= self.scale[:, None]
        H *= self.scale
        H[np.diag_indices_from(H)] = 1.0 + damping
        self._factor = cho_factor(H, lower=True, overwrite_a=True, check_finite=False)

    def solve(self, rhs: Array) -> Array:
        """Solution; (N,) or (N, k)."""
        scale = self.scale if rhs.ndim == 1 else self.scale[:, None]
        out = np.asarray(cho_solve(self._factor, rhs * scale, check_finite=False) * scale)
        if not np.all(np.isfinite(out)):
            raise np.linalg.LinAlgError("step is not finite")
        return out

    def condition(self) -> float:
        """Condition of the scaled matrix (LAPACK's estimate, 1-norm)."""
        lower = np.tril(self._factor[0])
        norm = float(np.abs(lower @ lower.T).sum(axis=0).max())
        reciprocal, _ = dpocon(self._factor[0], norm, uplo="L")
        return float(1.0 / max(reciprocal, 1e-300))
