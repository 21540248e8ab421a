"""The smoothed inertial trajectory: pose, covariance and correlation at any time of the flight."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.model.trajectory import StateChain, TrajectoryStates
from georef_gis.navigate.smoother import chain_at, states_at
from georef_gis.project.columns_file import read_columns, write_columns

# order of the errors in a chain: position, attitude, then velocity and the rest
_POSE_FIRST = (0, 1, 2, 6, 7, 8, 3, 4, 5)
KIND = "inertial"


@dataclass(frozen=True, kw_only=True, eq=False)
class InertialTrajectory:
    """Nodes of the smoother and the inertial samples between them.

    Parameters
    ----------
    imu : shape (n, 7)
        Time s, rate rad/s, force m/s2.
    nodes : shape (m,), s
    nav, x
        Smoothed states (m, 15) and (m, k), see `inertial` and `kalman`.
    post_nav, post_x
        Those of the filter.
    filtered, smoothed
        Packed covariances of both.
    transitions : shape (m, 9, d)
    jump : shape (m, 3)
    model : shape (2, 9 + k)
    chi : shape (m, 4)
        See `kalman.run_filter`.
    gaps : shape (g, 2), s
        Where the IMU log has none to offer.
    sigma_constant : shape (3,), rad
        Of a constant attitude error of the whole flight, NED, that nothing in the log could tell.
    notes
        How it was found, in words.
    """

    imu: Array
    nodes: Array
    nav: Array
    x: Array
    post_nav: Array
    post_x: Array
    filtered: Array
    smoothed: Array
    transitions: Array
    jump: Array
    model: Array
    chi: Array
    gaps: Array
    sigma_constant: Array = field(default_factory=lambda: np.zeros(3))
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.nodes[0]), float(self.nodes[-1])

    @property
    def gyro_bias(self) -> Array:
        """Bias of the gyro in the middle of the flight, rad/s; shape (3,)."""
        return np.asarray(self.x[len(self.x) // 2, :3])

    @property
    def accel_bias(self) -> Array:
        """Bias of the accelerometer in the middle of the flight, m/s2; shape (3,)."""
        return np.asarray(self.x[len(self.x) // 2, 3:6])

    def why_not(self, time: float) -> str:
        """Reason, in words, why there is no state at a time; empty where there is one."""
        first, last = self.span
        if not np.isfinite(time):
            return "its time is not known"
        if time < first:
            return f"its time lies {first - time:.1f} s before the navigated part of the log"
        if time > last:
            return f"its time lies {time - last:.1f} s after the navigated part of the log"
        for start, end in self.gaps:
            if start < time < end:
                return f"its time lies in a gap of {end - start:.1f} s of the IMU log"
        return ""

    def at(self, times: ArrayLike) -> TrajectoryStates:
        """States at times, in any order; see `model.trajectory.Trajectory`."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        order = np.argsort(t, kind="stable")
        back = np.argsort(order, kind="stable")
        chain = self.chain(t[order])
        nav, x = self._states(t)
        return TrajectoryStates(
            time=t,
            p_geo=nav[:, :3],
            v_ned=nav[:, 3:6],
            R_ned_from_body=nav[:, 6:].reshape(-1, 3, 3),
            rate_body=self._rates(t, x),
            covariance=chain.covariance[back][:, :6, :6],
        )

    def chain(self, times: ArrayLike) -> StateChain:
        """Errors at increasing times with their correlation."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        if np.any(np.diff(t) < 0):
            raise ValueError("the times of a chain must not decrease")
        P, G = chain_at(
            self.imu, self.nodes, self.jump, self.model, (self.post_nav, self.post_x),
            (self.filtered, self.smoothed), self.transitions, t, self._index(t),
        )  # fmt: skip
        order = np.array([*_POSE_FIRST, *range(9, P.shape[1])])
        P, G = P[:, order[:, None], order], G[:, order[:, None], order]
        if np.any(self.sigma_constant > 0.0):
            P, G = _with_constant_attitude(P, G, self.sigma_constant)
        return StateChain(time=t, covariance=P, gain=G)

    def joint_covariance(self, times: ArrayLike) -> Array:
        """Joint covariance of the pose errors (dp_ned m, dtheta_ned rad) at increasing times."""
        return self.chain(times).joint()

    def states(self, times: ArrayLike) -> tuple[Array, Array]:
        """Position, velocity, attitude (n, 15) and the rest at times, without covariance: fast."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        return self._states(t)

    def _states(self, t: Array) -> tuple[Array, Array]:
        dynamic = self.transitions.shape[2]
        nav, x = states_at(self.imu, self.nodes, self.nav, self.x, t, self._index(t), dynamic)
        return nav, x

    def _rates(self, t: Array, x: Array) -> Array:
        rate = np.stack([np.interp(t, self.imu[:, 0], self.imu[:, k]) for k in (1, 2, 3)], axis=-1)
        rate = rate - x[:, :3]
        if self.transitions.shape[2] > 9:
            m = x[:, 6:15].reshape(-1, 3, 3)
            rate = rate - np.einsum("nij,nj->ni", m, rate)
        return np.asarray(rate)

    def _index(self, t: Array) -> Any:
        found = np.searchsorted(self.nodes, t, side="right") - 1
        return np.clip(found, 0, len(self.nodes) - 2).astype(np.int64)

    def _check(self, t: Array) -> None:
        bad = [(float(value), why) for value in t if (why := self.why_not(float(value)))]
        if bad:
            more = f" ({len(bad)} such times)" if len(bad) > 1 else ""
            raise NavigationError(f"time {bad[0][0]:.3f} s: {bad[0][1]}{more}")

    @cached_property
    def nis(self) -> Array:
        """Normalised innovations squared of position and velocity, accepted ones; NaN else."""
        return np.where(self.chi[:, :2] >= 0.0, self.chi[:, :2], np.nan)

    def save(self, path: Path) -> None:
        """Write all columns into one ``.npz``, whole or not at all."""
        write_columns(path, KIND, {item.name: getattr(self, item.name) for item in fields(self)})

    @classmethod
    def load(cls, path: Path) -> InertialTrajectory:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is none, cut off, or of another version.
        """
        columns = read_columns(path, KIND)
        for name in ("notes", "doubts"):
            columns[name] = tuple(str(word) for word in columns[name])
        return cls(**columns)


def _with_constant_attitude(P: Array, G: Array, sigma: Array) -> tuple[Array, Array]:
    """Chain with three more states: constants that are added to the attitude of every time."""
    k, n = P.shape[:2]
    E = np.zeros((n, 3))
    E[3:6] = np.eye(3)
    S = np.diag(sigma**2)
    P_out, G_out = np.zeros((k, n + 3, n + 3)), np.zeros((k, n + 3, n + 3))
    P_out[:, :n, :n] = P + E @ S @ E.T
    P_out[:, :n, n:] = E @ S
    P_out[:, n:, :n] = S @ E.T
    P_out[:, n:, n:] = S
    # x_i = G (x_j - E c) + E c
    G_out[:, :n, :n] = G
    G_out[:, :n, n:] = E - G @ E
    G_out[:, n:, n:] = np.eye(3)
    return P_out, G_out
