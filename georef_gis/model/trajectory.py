"""A trajectory as the later stages see it: states at times, and how their errors hang together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryStates:
    """States of the IMU at `n` times.

    Parameters
    ----------
    time : s on the GPS scale since 1980-01-06
    p_geo : shape (n, 3)
        lat, lon rad, ellipsoidal height m.
    v_ned : shape (n, 3), m/s
    R_ned_from_body : shape (n, 3, 3)
    rate_body : shape (n, 3), rad/s
        Angular rate in body axes.
    covariance : shape (n, 6, 6)
        Of (dp_ned m, dtheta_ned rad), position first, ``R_true = Exp(dtheta) R``.
    """

    time: Array
    p_geo: Array
    v_ned: Array
    R_ned_from_body: Array
    rate_body: Array
    covariance: Array

    def __len__(self) -> int:
        """Number of times."""
        return len(self.time)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateChain:
    """Covariances of the errors at increasing times, as the Markov chain that they are.

    The first six states are the pose error (dp_ned m, dtheta_ned rad); others follow.

    Parameters
    ----------
    time : shape (m,), s
    covariance : shape (m, n, n)
    gain : shape (m, n, n)
        ``Cov(x_i, x_j) = gain_i gain_(i+1) .. gain_(j-1) covariance_j`` for i < j; the last is
        not used.
    """

    time: Array
    covariance: Array
    gain: Array

    def cross(self, first: int, second: int) -> Array:
        """Covariance between the pose errors at two of the times, (6, 6)."""
        if first > second:
            return self.cross(second, first).T
        product = np.eye(self.covariance.shape[1])[:6]
        for i in range(first, second):
            product = product @ self.gain[i]
        return np.asarray((product @ self.covariance[second])[:, :6])

    def joint(self, indices: ArrayLike | None = None) -> Array:
        """Joint covariance of the pose errors at the times, or at some of them.

        Returns
        -------
        shape (6 k, 6 k)
        """
        chosen = np.arange(len(self.time)) if indices is None else np.asarray(indices, dtype=int)
        order = np.argsort(chosen, kind="stable")
        k = len(chosen)
        out = np.empty((k, 6, k, 6))
        for a in range(k):
            i = int(chosen[order[a]])
            product = np.eye(self.covariance.shape[1])[:6]
            for b in range(a, k):
                j = int(chosen[order[b]])
                while i < j:
                    product = product @ self.gain[i]
                    i += 1
                block = (product @ self.covariance[j])[:, :6]
                out[order[a], :, order[b], :] = block
                out[order[b], :, order[a], :] = block.T
        return out.reshape(6 * k, 6 * k)


class Trajectory(Protocol):
    """What every kind of trajectory can tell."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""

    def why_not(self, time: float) -> str:
        """Reason, in words, why there is no state at a time; empty where there is one."""

    def at(self, times: ArrayLike) -> TrajectoryStates:
        """States at times, in any order.

        Raises
        ------
        NavigationError
            If a time lies outside of the log or in a gap.
        """

    def chain(self, times: ArrayLike) -> StateChain:
        """Errors at increasing times with their correlation; raises as `at`."""
