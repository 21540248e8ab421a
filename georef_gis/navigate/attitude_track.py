"""Attitude without an inertial solution: of another filter's log, or of the course over ground.

The error of an attitude is written as ``dtheta_ned = map u + white``: `u` are a few stationary
Gauss-Markov processes of unit variance, which makes the correlation of the errors at any two times
plain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import NavigationError
from georef_gis.frames import (
    Array,
    R_ned_from_body,
    exp_so3,
    jacobian_theta_ned_from_rpy,
    log_so3,
    rpy_from_R_ned_from_body,
)
from georef_gis.model.logs import AttitudeLog, IntArray

# rad, one sigma of a heading of which nothing is known
SIGMA_ANY = math.pi / math.sqrt(3.0)
# m/s2; the standard gravity
_G = 9.80665
# s; closer samples are one
_SAME = 1e-6
# s; correlation of what is not known of the heading of a slow vehicle
_TAU_SLOW = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSettings:
    """What is believed of an attitude; angles rad, sigmas one standard deviation.

    Parameters
    ----------
    sigma_roll_pitch, sigma_yaw
        Of a logged attitude whose log states none.
    tau : s
        Correlation time of a logged attitude's error.
    gap : s
        Longest step between two logged attitudes.
    sigma_crab, tau_wind
        Of a course taken for a heading, and the correlation time of the wind behind it, s.
    sigma_level, tau_level
        Of roll and pitch taken from the path, and their correlation time in gusts, s.
    sigma_gust
        Share of `sigma_crab` that comes and goes as they do.
    trim
        Pitch above the path in steady flight.
    slow, fast : m/s
        Below `slow` the course says nothing of the heading; from `fast` on, all that it can.
    """

    sigma_roll_pitch: float = math.radians(1.5)
    sigma_yaw: float = math.radians(5.0)
    tau: float = 15.0
    gap: float = 1.0
    sigma_crab: float = math.radians(15.0)
    tau_wind: float = 600.0
    sigma_level: float = math.radians(6.0)
    tau_level: float = 2.0
    sigma_gust: float = math.radians(2.0)
    trim: float = 0.0
    slow: float = 1.5
    fast: float = 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeParts:
    """Attitudes at `n` times and how their errors come about from `k` unit processes.

    `R_ned_from_body` (n, 3, 3); `rate_body` (n, 3) rad/s; `unit_map` (n, 3, k) rad; `white`
    (n, 3, 3) rad^2, not correlated in time; `tau` (k,) s.
    """

    R_ned_from_body: Array
    rate_body: Array
    unit_map: Array
    white: Array
    tau: Array

    @property
    def covariance(self) -> Array:
        """Of dtheta_ned, shape (n, 3, 3), rad^2."""
        return np.asarray(self.unit_map @ np.swapaxes(self.unit_map, -1, -2) + self.white)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeStates:
    """Attitudes at `n` times.

    `R_ned_from_body` (n, 3, 3); `rate_body` (n, 3) rad/s; `covariance` (n, 3, 3) of dtheta_ned
    rad, ``R_true = Exp(dtheta) R``.
    """

    time: Array
    R_ned_from_body: Array
    rate_body: Array
    covariance: Array

    def __len__(self) -> int:
        """Number of times."""
        return len(self.time)


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeTrack:
    """Attitude that another filter logged, between its samples; see `attitude_track`.

    Parameters
    ----------
    time : shape (n,), s
    rpy, sigma_rpy : shape (n, 3), rad
    bridge : shape (3,), rad^2/s
        Variance per s of what the vehicle does between two samples, body axes.
    """

    time: Array
    rpy: Array
    sigma_rpy: Array
    bridge: Array
    settings: AttitudeSettings = field(default_factory=AttitudeSettings)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.time[0]), float(self.time[-1])

    def why_not(self, time: float) -> str:
        """Reason, in words, why there is no attitude at a time; empty where there is one."""
        first, last = self.span
        if not math.isfinite(time):
            return "its time is not known"
        if time < first:
            return f"its time lies {first - time:.1f} s before the attitude log"
        if time > last:
            return f"its time lies {time - last:.1f} s after the attitude log"
        i = int(self._index(np.array([time]))[0])
        step = float(self.time[i + 1] - self.time[i])
        if step > self.settings.gap and self.time[i] < time < self.time[i + 1]:
            return f"its time lies in a gap of {step:.1f} s of the attitude log"
        return ""

    def at(self, times: ArrayLike) -> AttitudeStates:
        """Attitudes at times, in any order.

        Raises
        ------
        NavigationError
            If a time lies outside of the log or in a gap.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        refuse(t, [self.why_not(float(value)) for value in t])
        parts = self.parts(t)
        return AttitudeStates(
            time=t, R_ned_from_body=parts.R_ned_from_body, rate_body=parts.rate_body,
            covariance=parts.covariance,
        )  # fmt: skip

    def joint_covariance(self, times: ArrayLike) -> Array:
        """Joint covariance of dtheta_ned at times in any order, (3 k, 3 k), rad^2."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        refuse(t, [self.why_not(float(value)) for value in t])
        parts = self.parts(t)
        rho = np.exp(-np.abs(t[:, None] - t[None, :]) / self.settings.tau)
        out = np.einsum("iak,jbk,ij->iajb", parts.unit_map, parts.unit_map, rho)
        for i in range(len(t)):
            out[i, :, i, :] += parts.white[i]
        return np.asarray(out.reshape(3 * len(t), 3 * len(t)))

    def parts(self, t: Array) -> AttitudeParts:
        """Attitudes and the make-up of their errors at times within the log, unchecked."""
        i = self._index(t)
        R_0, R_1 = (R_ned_from_body(*self.rpy[k].T) for k in (i, i + 1))
        width = self.time[i + 1] - self.time[i]
        share = ((t - self.time[i]) / width)[:, None]
        turn = log_so3(np.swapaxes(R_0, -1, -2) @ R_1)
        R = np.asarray(R_0 @ exp_so3(share * turn))
        sigma = (1.0 - share) * self.sigma_rpy[i] + share * self.sigma_rpy[i + 1]
        between = (width[:, None] * share * (1.0 - share))[:, :, None] * np.diag(self.bridge)
        return AttitudeParts(
            R_ned_from_body=R,
            rate_body=turn / width[:, None],
            unit_map=jacobian_theta_ned_from_rpy(*rpy_from_R_ned_from_body(R).T)
            * sigma[:, None, :],
            white=np.asarray(R @ between @ np.swapaxes(R, -1, -2)),
            tau=np.full(3, self.settings.tau),
        )

    def _index(self, t: Array) -> IntArray:
        found = np.searchsorted(self.time, t, side="right") - 1
        return np.clip(found, 0, len(self.time) - 2).astype(np.int64)


def refuse(times: Array, reasons: list[str]) -> None:
    """Raise a NavigationError that names the first time with a reason and counts the others."""
    bad = [(float(t), why) for t, why in zip(times, reasons, strict=True) if why]
    if bad:
        more = f" ({len(bad)} such times)" if len(bad) > 1 else ""
        raise NavigationError(f"time {bad[0][0]:.3f} s: {bad[0][1]}{more}")


def attitude_track(log: AttitudeLog, settings: AttitudeSettings | None = None) -> AttitudeTrack:
    """Track of a logged attitude.

    Parameters
    ----------
    log
        In any order; rows with missing numbers are left out.

    Raises
    ------
    NavigationError
        If fewer than two rows are left.
    """
    settings = AttitudeSettings() if settings is None else settings
    good = np.flatnonzero(np.isfinite(log.time) & np.isfinite(log.rpy).all(axis=-1))
    good = good[np.argsort(log.time[good], kind="stable")]
    if len(good):
        good = good[np.concatenate([[True], np.diff(log.time[good]) > _SAME])]
    if len(good) < 2:
        raise NavigationError(f"{log.source}: {len(good)} usable attitudes; a track needs two")
    usual = np.array([settings.sigma_roll_pitch, settings.sigma_roll_pitch, settings.sigma_yaw])
    sigma = log.sigma_rpy[good]
    stated = np.isfinite(sigma) & (sigma > 0.0)
    time, rpy = log.time[good], log.rpy[good]
    source = "its log" if stated.all() else "the settings"
    return AttitudeTrack(
        time=time,
        rpy=rpy,
        sigma_rpy=np.where(stated, sigma, usual),
        bridge=_bridge(time, rpy, settings.gap),
        settings=settings,
        notes=(
            f"attitude: logged by another filter, sigmas of {source}; a delay of its clock against "
            "the GNSS is not estimated",
        ),
        doubts=_gap_doubts(time, settings.gap),
    )


def _gap_doubts(time: Array, gap: float) -> tuple[str, ...]:
    steps = np.diff(time)
    long = steps[steps > gap]
    if not len(long):
        return ()
    return (f"the attitude log has {len(long)} gaps of up to {long.max():.1f} s without attitude",)


def _bridge(time: Array, rpy: Array, gap: float) -> Array:
    """Variance per s between samples, (3,): how far each lies from between its neighbours.

    Taken as a random walk between them; a sample in the middle of ``2 dt`` then has ``q dt / 2``.
    """
    if len(time) < 3:
        return np.zeros(3)
    R = R_ned_from_body(*rpy.T)
    back = np.swapaxes(R[:-2], -1, -2)
    width = time[2:] - time[:-2]
    share = (time[1:-1] - time[:-2]) / width
    missed = log_so3(back @ R[1:-1]) - share[:, None] * log_so3(back @ R[2:])
    rate = missed**2 / (width * share * (1.0 - share))[:, None]
    close = width <= 2.0 * gap
    return np.asarray(rate[close].mean(axis=0) if close.any() else np.zeros(3))


def held_courses(v_ned: Array, slow: float) -> Array:
    """Course at nodes, rad: where slow, the one before, at the head the first; (m, 3) -> (m,).

    All zero where the vehicle is never fast enough.
    """
    moving = np.flatnonzero(np.hypot(v_ned[:, 0], v_ned[:, 1]) >= slow)
    if not len(moving):
        return np.zeros(len(v_ned))
    last = np.searchsorted(moving, np.arange(len(v_ned)), side="right") - 1
    row = moving[np.maximum(last, 0)]
    return np.asarray(np.arctan2(v_ned[row, 1], v_ned[row, 0]))


def attitude_of_course(
    v: Array, a: Array, sigma_v: Array, held: Array, settings: AttitudeSettings
) -> AttitudeParts:
    """Attitude of a vehicle that flies where it points, turns by banking and knows no wind.

    Parameters
    ----------
    v, a : shape (n, 3), m/s, m/s2
        Velocity and acceleration, NED.
    sigma_v : shape (n,), m/s
        Of the level velocity, per axis.
    held : shape (n,), rad
        Course where it is too slow to have one.

    Notes
    -----
    The wind is one for opposite rows, and turns the nose to opposite sides there: so the units of
    the crab are two of wind, north and east, and not one of yaw.
    """
    speed = np.hypot(v[:, 0], v[:, 1])
    has = speed >= settings.slow
    safe = np.where(has, speed, settings.slow)
    course = np.where(has, np.arctan2(v[:, 1], v[:, 0]), held)
    to_right = np.where(speed >= settings.fast, (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / safe, 0.0)
    pitch = np.where(has, np.arctan2(-v[:, 2], safe), 0.0) + settings.trim
    R = R_ned_from_body(np.arctan(to_right / _G), pitch, course)
    crab, unknown = _course_sigmas(speed, sigma_v / safe, settings)
    gust = np.minimum(settings.sigma_gust, crab)
    crab = np.sqrt(crab**2 - gust**2)
    unit = np.zeros((len(v), 3, 6))
    unit[:, 0, 0] = unit[:, 1, 1] = settings.sigma_level
    unit[:, 2, 2], unit[:, 2, 3] = -crab * np.sin(course), crab * np.cos(course)
    unit[:, 2, 4], unit[:, 2, 5] = unknown, gust
    turn = np.zeros((len(v), 3))
    turn[:, 2] = to_right / safe
    tau = [settings.tau_level] * 2 + [settings.tau_wind] * 2 + [_TAU_SLOW, settings.tau_level]
    return AttitudeParts(
        R_ned_from_body=R,
        rate_body=np.einsum("nji,nj->ni", R, turn),
        unit_map=jacobian_theta_ned_from_rpy(*rpy_from_R_ned_from_body(R).T) @ unit,
        white=np.zeros((len(v), 3, 3)),
        tau=np.array(tau),
    )


def _course_sigmas(speed: Array, noise: Array, settings: AttitudeSettings) -> tuple[Array, Array]:
    """Sigma of the crab and of what else is not known of a heading by course, rad; (n,) each."""
    span = max(settings.fast - settings.slow, 1e-9)
    w = np.clip((settings.fast - speed) / span, 0.0, 1.0)
    total = settings.sigma_crab ** (1.0 - w) * SIGMA_ANY**w
    total = np.minimum(np.hypot(total, noise), SIGMA_ANY)
    crab = np.minimum(settings.sigma_crab * (1.0 - w), total)
    return crab, np.sqrt(np.maximum(total**2 - crab**2, 0.0))
