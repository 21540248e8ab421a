"""Trajectories of logs, and their values at other times."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import CrsError
from georef_gis.frames import (
    Array,
    R_ned_from_body,
    covariance_theta_ned_from_rpy,
    exp_so3,
    log_so3,
    rpy_from_R_ned_from_body,
)
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.model.logs import (
    FIX_2D,
    AttitudeLog,
    GnssLog,
    TrajectoryLog,
    unknown,
)
from georef_gis.model.trajectory_values import metres_per_radian

# s without rows beyond which nothing is interpolated, where rows are usually denser than that
LONGEST_GAP = 1.0


def ellipsoidal_heights(
    gnss: GnssLog, *, geoid: str = "egm96", unstated: HeightKind = HeightKind.UNKNOWN
) -> Array:
    """Heights of fixes above the ellipsoid, m; by the receiver's own geoid where it states one.

    Parameters
    ----------
    geoid
        For a receiver that states no separation of its own.
    unstated
        What heights of unknown kind are taken for.

    Raises
    ------
    CrsError
        If the kind of the heights cannot be turned into ellipsoidal ones.
    """
    kind = unstated if gnss.height_kind is HeightKind.UNKNOWN else gnss.height_kind
    if kind is HeightKind.ELLIPSOIDAL:
        return gnss.height
    if kind is not HeightKind.ORTHOMETRIC:
        raise CrsError(
            f"{gnss.source or 'gnss'}: heights of kind '{kind}' have no ellipsoidal value; state "
            "their kind (ellipsoidal or orthometric)",
            field="height",
        )
    known = np.isfinite(gnss.lat) & np.isfinite(gnss.lon)
    lat, lon = (np.where(known, angle, 0.0) for angle in (gnss.lat, gnss.lon))
    # the receiver's own separation takes back exactly what it subtracted
    own = np.isfinite(gnss.geoid_separation)
    modelled = geoid_undulation(lat, lon, geoid=geoid)
    return np.asarray(gnss.height + np.where(own, gnss.geoid_separation, modelled))


def trajectory_of_gnss(gnss: GnssLog) -> TrajectoryLog:
    """Fixes with a height as a trajectory of the antenna, without attitude."""
    covariance = unknown(len(gnss), 6, 6)
    covariance[:, :3, :3] = gnss.covariance_ned
    log = TrajectoryLog(
        time=gnss.time, scale=gnss.scale, source=gnss.source, doubts=gnss.doubts,
        lat=gnss.lat, lon=gnss.lon, height=ellipsoidal_heights(gnss), v_ned=gnss.v_ned,
        rpy=unknown(len(gnss), 3), covariance=covariance, position_of="antenna",
    )  # fmt: skip
    return rows(log, (gnss.fix > FIX_2D) & np.isfinite(gnss.lat))


def trajectory_of_attitude(attitude: AttitudeLog) -> TrajectoryLog:
    """Attitudes as a trajectory without positions."""
    n = len(attitude)
    covariance = unknown(n, 6, 6)
    covariance[:, 3:, 3:] = covariance_theta_ned_from_rpy(attitude.rpy, attitude.sigma_rpy)
    return TrajectoryLog(
        time=attitude.time, scale=attitude.scale, source=attitude.source, doubts=attitude.doubts,
        lat=unknown(n), lon=unknown(n), height=unknown(n), v_ned=unknown(n, 3),
        rpy=attitude.rpy, covariance=covariance, position_of="unknown",
    )  # fmt: skip


def with_attitude(log: TrajectoryLog, attitude: TrajectoryLog) -> TrajectoryLog:
    """A trajectory whose attitude is that of another, interpolated."""
    other = at_times(attitude, log.time)
    covariance = log.covariance.copy()
    covariance[:, 3:, 3:] = other.covariance[:, 3:, 3:]
    return replace(log, rpy=other.rpy, covariance=covariance)


def rows(log: TrajectoryLog, keep: NDArray[np.bool_]) -> TrajectoryLog:
    """The rows that are to be kept."""
    if np.all(keep):
        return log
    arrays: dict[str, Any] = {
        item.name: value[keep]
        for item in fields(log)
        if isinstance(value := getattr(log, item.name), np.ndarray)
    }
    return replace(log, **arrays)


def in_order(log: TrajectoryLog) -> TrajectoryLog:
    """Rows whose time is finite and later than all before."""
    time = np.where(np.isfinite(log.time), log.time, -np.inf)
    keep = np.isfinite(log.time)
    if len(time):
        keep[1:] &= time[1:] > np.maximum.accumulate(time)[:-1]
    return rows(log, keep)


def at_times(log: TrajectoryLog, time: Array) -> TrajectoryLog:
    """Values at other times: NaN outside, and within gaps.

    Positions follow cubic Hermite polynomials with the log's velocities (slopes of the positions
    where it has none), attitudes the shortest turn, the rest straight lines.
    """
    if len(time) == len(log) and np.array_equal(time, log.time):
        return log
    at = np.clip(np.searchsorted(log.time, time, side="right") - 1, 0, len(log) - 2)
    step = np.diff(log.time)
    h = step[at]
    part = (time - log.time[at]) / h
    allowed = max(LONGEST_GAP, 2.5 * float(np.median(step)))
    # A row that is met exactly needs no neighbour, so a gap behind it does not hide it.
    exact = np.isin(time, log.time)
    lost = ~exact & ((h > allowed) | (part < 0.0) | (part > 1.0))
    lost |= exact & ((time < log.time[0]) | (time > log.time[-1]))
    lat, lon, height = _hermite(log, at, part).T
    return TrajectoryLog(
        time=time, scale=log.scale, source=log.source, doubts=log.doubts,
        lat=_hide(lat, lost), lon=_hide(lon, lost), height=_hide(height, lost),
        v_ned=_hide(_straight(log.v_ned, at, part), lost),
        rpy=_hide(_turned(log.rpy, at, part), lost),
        covariance=_hide(_straight(log.covariance, at, part), lost),
        position_of=log.position_of,
    )  # fmt: skip


def _hide(values: Array, lost: NDArray[np.bool_]) -> Array:
    out = np.array(values)
    out[lost] = np.nan
    return out


def _straight(values: Array, at: NDArray[np.int64], part: Array) -> Array:
    w = part.reshape(-1, *[1] * (values.ndim - 1))
    # Where a weight is zero its row must not count: it may be NaN.
    left = np.where(w < 1.0, values[at], 0.0) * (1.0 - w)
    return np.asarray(left + np.where(w > 0.0, values[at + 1], 0.0) * w)


def _hermite(log: TrajectoryLog, at: NDArray[np.int64], part: Array) -> Array:
    """Lat, lon rad and height m; shape (n, 3)."""
    geo = np.stack([log.lat, _unwrapped(log.lon), log.height], axis=-1)
    slope = _geo_rates(log, geo)
    h, s = np.diff(log.time)[at][:, None], part[:, None]
    a, b = geo[at], geo[at + 1]
    # Around `a`, so that the small differences keep their digits.
    bend = (
        s * (1.0 - s) ** 2 * h * slope[at]
        + s**2 * (s - 1.0) * h * slope[at + 1]
        + s**2 * (3.0 - 2.0 * s) * (b - a)
    )
    out = np.where(s >= 1.0, b, np.where(s <= 0.0, a, a + bend))
    out[:, 1] = np.mod(out[:, 1] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(out)


def _unwrapped(angle: Array) -> Array:
    """Angles without steps of a turn; NaN stays NaN."""
    out = angle.copy()
    known = np.isfinite(angle)
    out[known] = np.unwrap(angle[known])
    return out


def _geo_rates(log: TrajectoryLog, geo: Array) -> Array:
    """Rates of lat, lon rad/s and height m/s; shape (n, 3)."""
    north, east = metres_per_radian(log.lat, log.height)
    stated = np.stack([log.v_ned[:, 0] / north, log.v_ned[:, 1] / east, -log.v_ned[:, 2]], axis=-1)
    if np.all(np.isfinite(stated)):
        return stated
    return np.where(np.isfinite(stated), stated, np.gradient(geo, log.time, axis=0))


def _turned(rpy: Array, at: NDArray[np.int64], part: Array) -> Array:
    R = R_ned_from_body(*rpy.T)
    if not np.any(np.isfinite(R)):
        return np.full((len(at), 3), np.nan)
    a, b = R[at], R[at + 1]
    s = part[:, None]
    turn = log_so3(np.swapaxes(a, -1, -2) @ b)
    out = rpy_from_R_ned_from_body(a @ exp_so3(s * turn))
    return np.asarray(np.where(s <= 0.0, rpy[at], np.where(s >= 1.0, rpy[at + 1], out)))


def transposed(R: Array) -> Array:
    """Matrices with their last two axes swapped."""
    return np.swapaxes(R, -1, -2)
