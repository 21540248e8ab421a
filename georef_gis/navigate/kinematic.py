"""The trajectory of a flight without an IMU: smoothed fixes, and whatever attitude there is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.ellipsoid import Origin
from georef_gis.frames import R_ENU_FROM_NED_SAME_PLACE, Array, R_enu_from_ned, skew
from georef_gis.model.logs import IntArray
from georef_gis.model.trajectory import StateChain, TrajectoryStates
from georef_gis.navigate.attitude_track import (
    AttitudeParts,
    AttitudeSettings,
    AttitudeTrack,
    attitude_of_course,
    refuse,
)
from georef_gis.navigate.kinematic_smoother import STATES, insert
from georef_gis.project.columns_file import read_columns, write_columns

KIND = "kinematic"


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicSettings:
    """Settings of a trajectory without an IMU.

    Parameters
    ----------
    attitude
        See `attitude_track.AttitudeSettings`.
    lever_arm_body_antenna : shape (3,), m
        From the place that the trajectory is of to the antenna.
    slow_tau : s
        Correlation time of the slow GNSS error.
    gate
        Probability with which a good fix counts less.
    reacquire : s
        After so long without a believed fix the next is believed.
    notable_gap, longest_gap : s
        Gaps of the fixes that are named, and that are refused.
    """

    attitude: AttitudeSettings = field(default_factory=AttitudeSettings)
    lever_arm_body_antenna: Array = field(default_factory=lambda: np.zeros(3))
    slow_tau: float = 100.0
    gate: float = 0.001
    reacquire: float = 10.0
    notable_gap: float = 3.0
    longest_gap: float = 30.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KinematicTrajectory:
    """Smoothed fixes with an attitude of another log or of the course; a `model` Trajectory.

    Parameters
    ----------
    origin : shape (3,)
        Lat, lon rad, ellipsoidal height m where the axes of the states are north, east, down.
    time : shape (m,), s
    prior, post, filtered, jump
        What the filter left, see `kinematic_smoother.forward`.
    smoothed, covariance
        Of the smoother: (m, 12), packed (m, 78).
    chi : shape (m, 2)
        Normalised innovations squared of position and velocity, negative beyond the gate.
    motion : shape (3, 2)
        Sigma and correlation time of the acceleration per axis, m/s2 and s.
    slow : shape (4,)
        Sigmas of the slow GNSS error m, and its correlation time s.
    held : shape (m,), rad
        Course at or before each node.
    track
        Logged attitude; None = taken from the course.
    """

    origin: Array
    time: Array
    prior: Array
    post: Array
    filtered: Array
    jump: Array
    smoothed: Array
    covariance: Array
    chi: Array
    motion: Array
    slow: Array
    held: Array
    track: AttitudeTrack | None
    settings: KinematicSettings
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        first, last = float(self.time[0]), float(self.time[-1])
        if self.track is None:
            return first, last
        return max(first, self.track.span[0]), min(last, self.track.span[1])

    def why_not(self, time: float) -> str:
        """Reason, in words, why there is no state at a time; empty where there is one."""
        if not math.isfinite(time):
            return "its time is not known"
        if time < self.time[0]:
            return f"its time lies {self.time[0] - time:.1f} s before the first GNSS fix"
        if time > self.time[-1]:
            return f"its time lies {time - self.time[-1]:.1f} s after the last GNSS fix"
        i = int(self._index(np.array([time]))[0])
        gap = float(self.time[i + 1] - self.time[i])
        if gap > self.settings.longest_gap and self.time[i] < time < self.time[i + 1]:
            return f"its time lies in a gap of {gap:.1f} s of the GNSS log"
        return "" if self.track is None else self.track.why_not(time)

    def at(self, times: ArrayLike) -> TrajectoryStates:
        """States at times, in any order; see `model.trajectory.Trajectory`."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        x, cov, _ = self._insert(t, chained=False)
        p_geo, v, turned = self._local(x, cov)
        parts = self._attitude(t, x, cov, turned)
        arm = np.einsum("nij,j->ni", parts.R_ned_from_body, self._arm)
        swing = np.cross(parts.rate_body, self._arm)
        v = v - np.einsum("nij,nj->ni", parts.R_ned_from_body, swing)
        return TrajectoryStates(
            time=t,
            p_geo=self._moved(p_geo, turned, -arm),
            v_ned=v,
            R_ned_from_body=parts.R_ned_from_body,
            rate_body=parts.rate_body,
            covariance=_pose_covariance(_to_pose(parts, turned, arm), cov, parts, arm),
        )

    def chain(self, times: ArrayLike) -> StateChain:
        """Errors at increasing times with their correlation.

        Behind the pose error lie the twelve of the fixes' smoother and the units of the attitude.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        self._check(t)
        if np.any(np.diff(t) < 0):
            raise ValueError("the times of a chain must not decrease")
        x, cov, gains = self._insert(t, chained=True)
        _, _, turned = self._local(x, cov)
        parts = self._attitude(t, x, cov, turned)
        arm = np.einsum("nij,j->ni", parts.R_ned_from_body, self._arm)
        to_pose = _to_pose(parts, turned, arm)
        units = len(parts.tau)
        size = STATES + units
        inner = np.zeros((len(t), size, size))
        inner[:, :STATES, :STATES] = cov
        inner[:, STATES:, STATES:] = np.eye(units)
        G = np.zeros_like(inner)
        G[:, :STATES, :STATES] = gains
        decay = np.exp(-np.diff(t)[:, None] / parts.tau)
        G[:-1, STATES:, STATES:] = decay[:, :, None] * np.eye(units)
        whole = np.concatenate([to_pose, np.broadcast_to(np.eye(size), inner.shape)], axis=1)
        P = whole @ inner @ np.swapaxes(whole, -1, -2)
        P[:, :6, :6] = _pose_covariance(to_pose, cov, parts, arm)
        gain = np.zeros_like(P)
        gain[:, :, 6:] = whole @ G
        return StateChain(time=t, covariance=P, gain=gain)

    def joint_covariance(self, times: ArrayLike) -> Array:
        """Joint covariance of the pose errors (dp_ned m, dtheta_ned rad) at increasing times."""
        return self.chain(times).joint()

    @property
    def _arm(self) -> Array:
        return np.asarray(self.settings.lever_arm_body_antenna, dtype=np.float64)

    @property
    def _origin(self) -> Origin:
        lat, lon, height = (float(value) for value in self.origin)
        return Origin(lat=lat, lon=lon, height_ellipsoidal=height)

    def _insert(self, t: Array, *, chained: bool) -> tuple[Array, Array, Array]:
        passed = (self.prior, self.post, self.filtered, self.jump)
        x, cov, gains = insert(
            self.time, self.motion, self.slow, passed, (self.smoothed, self.covariance),
            t, self._index(t), chained,
        )  # fmt: skip
        return x, cov, gains

    def _local(self, x: Array, cov: Array) -> tuple[Array, Array, Array]:
        """Geodetic positions, velocities NED, and the turn from the states' axes to NED there."""
        p_geo = self._origin.geo_from_enu(x[:, :3] @ R_ENU_FROM_NED_SAME_PLACE)
        turned = np.swapaxes(states_from_ned(self._origin, p_geo), -1, -2)
        return p_geo, np.einsum("nij,nj->ni", turned, x[:, 3:6]), turned

    def _moved(self, p_geo: Array, turned: Array, d_ned: Array) -> Array:
        """Places at vectors NED from others."""
        d = np.einsum("nji,nj->ni", turned, d_ned) @ R_ENU_FROM_NED_SAME_PLACE
        return self._origin.geo_from_enu(self._origin.enu_from_geo(p_geo) + d)

    def _attitude(self, t: Array, x: Array, cov: Array, turned: Array) -> AttitudeParts:
        if self.track is not None:
            return self.track.parts(t)
        v, a = (np.einsum("nij,nj->ni", turned, x[:, k : k + 3]) for k in (3, 6))
        sigma_v = np.sqrt(0.5 * (cov[:, 3, 3] + cov[:, 4, 4]))
        held = self.held[self._index(t)]
        return attitude_of_course(v, a, sigma_v, held, self.settings.attitude)

    def _index(self, t: Array) -> IntArray:
        found = np.searchsorted(self.time, t, side="right") - 1
        return np.clip(found, 0, len(self.time) - 2).astype(np.int64)

    def _check(self, t: Array) -> None:
        refuse(t, [self.why_not(float(value)) for value in t])

    def save(self, path: Path) -> None:
        """Write everything into one ``.npz``, whole or not at all."""
        columns: dict[str, object] = {name: getattr(self, name) for name in _COLUMNS}
        for name in ("notes", "doubts"):
            columns[name] = np.array(getattr(self, name), str)
        if self.track is not None:
            columns |= {"track_" + name: getattr(self.track, name) for name in _TRACK}
        columns["settings"] = np.array(
            [getattr(self.settings, name) for name in _NUMBERS]
            + [getattr(self.settings.attitude, item.name) for item in fields(AttitudeSettings)]
        )
        columns["arm"] = self._arm
        write_columns(path, KIND, columns)

    @classmethod
    def load(cls, path: Path) -> KinematicTrajectory:
        """Read what `save` wrote.

        Raises
        ------
        InputError
            If the file is none, or of another kind or version.
        """
        return _from_columns(read_columns(path, KIND))


_COLUMNS = ("origin", "time", "prior", "post", "filtered", "jump", "smoothed", "covariance", "chi",
            "motion", "slow", "held")  # fmt: skip
_TRACK = ("time", "rpy", "sigma_rpy", "bridge")
_NUMBERS = ("slow_tau", "gate", "reacquire", "notable_gap", "longest_gap")


def _from_columns(columns: dict[str, Array]) -> KinematicTrajectory:
    numbers = [float(value) for value in columns["settings"]]
    names = [item.name for item in fields(AttitudeSettings)]
    settings = KinematicSettings(
        attitude=AttitudeSettings(**dict(zip(names, numbers[len(_NUMBERS) :], strict=True))),
        lever_arm_body_antenna=columns["arm"],
        **dict(zip(_NUMBERS, numbers, strict=False)),
    )
    track = None
    if "track_time" in columns:
        time, rpy, sigma, bridge = (columns["track_" + name] for name in _TRACK)
        track = AttitudeTrack(
            time=time, rpy=rpy, sigma_rpy=sigma, bridge=bridge, settings=settings.attitude
        )
    notes, doubts = (tuple(str(w) for w in columns[name]) for name in ("notes", "doubts"))
    kept = {name: columns[name] for name in _COLUMNS}
    return KinematicTrajectory(track=track, settings=settings, notes=notes, doubts=doubts, **kept)


def _to_pose(parts: AttitudeParts, turned: Array, arm: Array) -> Array:
    """Pose error (6) by the smoother's states and the units; (n, 6, 12 + k)."""
    out = np.zeros((len(arm), 6, STATES + len(parts.tau)))
    out[:, :3, :3] = turned
    # what turns the vehicle about its antenna moves it: dp = -dtheta x arm
    out[:, :3, STATES:] = skew(arm) @ parts.unit_map
    out[:, 3:, STATES:] = parts.unit_map
    return out


def _pose_covariance(to_pose: Array, cov: Array, parts: AttitudeParts, arm: Array) -> Array:
    J = to_pose[:, :, :STATES]
    U = to_pose[:, :, STATES:]
    W = np.concatenate([skew(arm), np.broadcast_to(np.eye(3), (len(arm), 3, 3))], axis=1)
    out = J @ cov @ np.swapaxes(J, -1, -2) + U @ np.swapaxes(U, -1, -2)
    return np.asarray(out + W @ parts.white @ np.swapaxes(W, -1, -2))


def states_from_ned(origin: Origin, p_geo: Array) -> Array:
    """From north, east, down at places to those at the origin; (n, 3, 3)."""
    turn = R_enu_from_ned(origin.lat, origin.lon, p_geo[:, 0], p_geo[:, 1])
    return np.asarray(R_ENU_FROM_NED_SAME_PLACE.T @ turn)
