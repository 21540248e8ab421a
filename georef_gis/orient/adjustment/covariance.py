"""Covariances of anything that was adjusted, on demand from the kept factor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.band_errors import BandErrors
from georef_gis.orient.adjustment.banded import BandedFactor
from georef_gis.orient.adjustment.covariance_kernels import point_covariances, point_rows
from georef_gis.orient.adjustment.dense import DenseFactor
from georef_gis.orient.adjustment.problem import Problem, State


class Covariances:
    """Joint covariances at the solution.

    The unknowns are the poses, 6 each, and what is shared; a ground point follows from them plus
    what its own pixels leave open. Where control gives the level, heights include it.
    """

    def __init__(self, problem: Problem, state: State, loss: float, factor: float = 1.0) -> None:
        """Factor the normal matrix at a state.

        Parameters
        ----------
        loss
            As the solution has it (`Loss.signed`).
        factor
            What all covariances are multiplied by (sigma0 squared, if it applies).
        """
        self._problem, self._state, self._factor_scale = problem, state, factor
        self._scale2 = loss
        reduced = problem.reduced(state, self._scale2, 0.0)
        self._factor, _ = problem.factor(state, reduced, 0.0)
        self._n = 6 * len(state.origin)
        self.with_level = problem.block.sigma_level > 0
        self._inverse: Array | None = None
        self._band: tuple[Array, Array, Array] | None = None

    @property
    def size(self) -> int:
        """Number of unknowns without the points."""
        return self._n + self._problem.block.n_shared

    def of_rows(self, rows: Array) -> Array:
        """Covariance of linear functions of the unknowns; (k, N) -> (k, k)."""
        return np.asarray(self._factor_scale * rows @ self._factor.solve(rows.T))

    def inverse(self) -> Array:
        """Covariance of all poses and shared unknowns, (N, N); kept once asked for.

        Of a large block it does not fit: ask for what is needed.
        """
        if self._inverse is None:
            full = self._factor.solve(np.eye(self.size)) * self._factor_scale
            held = self._n + np.flatnonzero(~self._problem.free)
            full[held], full[:, held] = 0.0, 0.0
            self._inverse = full
        return self._inverse

    def condition(self) -> float:
        """Condition of the normal matrix with unit diagonal; NaN for large blocks."""
        return self._factor.condition() if isinstance(self._factor, DenseFactor) else float("nan")

    def _selected(self) -> tuple[Array, Array, Array]:
        """Band of the inverse, border and corner of a large block; kept once asked for."""
        if self._band is None:
            if not isinstance(self._factor, BandedFactor):
                raise ValueError("only large blocks keep a band")
            band, to_shared, shared = self._factor.selected_inverse()
            held = np.flatnonzero(~self._problem.free)
            shared[held], shared[:, held] = 0.0, 0.0
            self._band = band, to_shared, shared
        return self._band

    def _lookup(self) -> tuple[Array, Array, NDArray[np.int64], Array, Array, Array]:
        """Inverse as the kernels take it: whole, or band, places, border, corner."""
        none, nobody = np.zeros((1, 1)), np.zeros(0, dtype=np.int64)
        if isinstance(self._factor, DenseFactor):
            return self.inverse() / self._factor_scale, none, nobody, none, none, none
        band, to_shared, shared = self._selected()
        spread = np.ascontiguousarray(to_shared @ shared)
        place = self._factor.order.position
        return none, band, place, np.ascontiguousarray(to_shared), spread, shared

    def band_errors(self) -> BandErrors | None:
        """What a large block keeps to be asked later; None of one that has no band."""
        if not isinstance(self._factor, BandedFactor):
            return None
        band, to_shared, shared = self._selected()
        to_shared = to_shared.copy()
        if self.with_level:
            # the level lifts every photo
            to_shared[2::6, -1] -= 1.0
        return BandErrors(
            factor=self._factor.lower,
            inverse=band * self._factor_scale,
            position=self._factor.order.position,
            scale=self._factor.scale * np.sqrt(self._factor_scale),
            to_shared=to_shared,
            shared=shared * self._factor_scale,
        )

    # -- rows of what is asked for -------------------------------------------------------------

    def pose_rows(self, photos: Sequence[int]) -> Array:
        """Rows of the pose errors (dp_enu, dtheta_enu) of photos; (6 k, N)."""
        rows = np.zeros((6 * len(photos), self.size))
        for k, i in enumerate(photos):
            rows[6 * k + np.arange(6), 6 * i + np.arange(6)] = 1.0
            if self.with_level:
                rows[6 * k + 2, -1] = 1.0
        return rows

    def shared_rows(self, indices: Sequence[int]) -> Array:
        """Rows of shared unknowns, counted as in `Block.shared_names`; (k, N)."""
        rows = np.zeros((len(indices), self.size))
        for k, i in enumerate(indices):
            rows[k, self._n + i] = 1.0 if self._problem.free[i] else 0.0
        return rows

    def point_rows(self, points: Sequence[int]) -> tuple[Array, Array]:
        """Rows of ground points (3 k, N), and what their own pixels leave open (3 k, 3 k)."""
        k = len(points)
        rows, own = np.zeros((3 * k, self.size)), np.zeros((3 * k, 3 * k))
        for a, j in enumerate(points):
            here, alone = np.zeros((3, self.size)), np.zeros((3, 3))
            seen = point_rows(int(j), *self._arguments(), self._n, here, alone)
            here[:, self._n + np.flatnonzero(~self._problem.free)] = 0.0
            if self.with_level:
                here[2, -1] += 1.0
            block = slice(3 * a, 3 * a + 3)
            rows[block] = here if seen else np.nan
            own[block, block] = alone * self._factor_scale
        return rows, own

    def _arguments(self) -> tuple[object, ...]:
        problem, state = self._problem, self._state
        settings = (self._scale2, 0.0, state.shifts, problem.block.n_shared - 2)
        return (
            problem.observations(), problem.values(state), problem.place(state), problem.span,
            problem.block.camera_of, settings,
        )  # fmt: skip

    # -- what is mostly asked for --------------------------------------------------------------

    def joint(
        self,
        *,
        photos: Sequence[int] = (),
        shared: Sequence[int] = (),
        points: Sequence[int] = (),
    ) -> Array:
        """Joint covariance of poses, shared unknowns and points, in this order.

        Returns
        -------
        shape (6 a + b + 3 c, 6 a + b + 3 c)
            m, rad, px and s as they are.
        """
        rows, own = self.point_rows(points)
        all_rows = np.vstack([self.pose_rows(photos), self.shared_rows(shared), rows])
        out = self.of_rows(all_rows)
        start = len(all_rows) - len(rows)
        out[start:, start:] += own
        return np.asarray((out + out.T) / 2)

    def poses(self) -> Array:
        """Covariance of every pose alone; (n, 6, 6)."""
        n = self._n // 6
        if isinstance(self._factor, DenseFactor):
            inverse = self.inverse()
            blocks = inverse[: self._n, : self._n].reshape(n, 6, n, 6)
            out = blocks[np.arange(n), :, np.arange(n), :].copy()
            with_shared = inverse[: self._n, -1].reshape(n, 6)
        else:
            band, to_shared, shared = self._selected()
            place = self._factor.order.position.reshape(n, 6)
            i, j = place[:, :, None], place[:, None, :]
            out = band[np.abs(i - j), np.minimum(i, j)]
            Y = to_shared.reshape(n, 6, -1)
            out = (out + np.einsum("nig,gh,njh->nij", Y, shared, Y)) * self._factor_scale
            with_shared = -(to_shared @ shared)[:, -1].reshape(n, 6) * self._factor_scale
        if self.with_level:
            out[:, :, 2] += with_shared
            out[:, 2, :] += with_shared
            out[:, 2, 2] += self.shared()[-1, -1]
        return np.asarray((out + np.swapaxes(out, 1, 2)) / 2)

    def shared(self) -> Array:
        """Covariance of all shared unknowns, (G, G); zero where one is held."""
        if isinstance(self._factor, DenseFactor):
            return self.inverse()[self._n :, self._n :]
        return self._selected()[2] * self._factor_scale

    def points(self) -> Array:
        """Covariance of every point alone, (k, 3, 3); NaN where one cannot be placed."""
        out = np.zeros((len(self._problem.span) - 1, 3, 3))
        point_covariances(*self._arguments(), self._lookup(), self.with_level, out)
        return out * self._factor_scale
