"""What of a GNSS log's error is white and what is slow, and its fixes as the filter takes them.

Receivers state one sigma. A filter that takes it as white believes in centimetres after an hour of
metres; one that takes it as slow throws away what averaging can give. The white part shows: over
one step the position moves by the velocity, so ``dp - v dt`` holds the white noise of two fixes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.ellipsoid import Origin
from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import FIX_FIXED, FIX_FLOAT, GnssLog
from georef_gis.navigate.resample import ellipsoidal_heights

# m, one sigma per horizontal axis of a fix whose log states none, and of its height in that unit
SIGMA_OF_FIX = {FIX_FIXED: 0.03, FIX_FLOAT: 0.5}
SIGMA_SINGLE = 2.2
HEIGHT_FACTOR = 1.5
# m/s, one sigma per axis of a velocity whose log states none
SIGMA_VELOCITY = 0.15
# of a stated sigma, taken as white where the log is too short or too sparse to tell
WHITE_SHARE = 1.0 / 3.0
# steps from which the scatter is measured
FEWEST_STEPS = 20
# s; over longer steps the vehicle's own turns hide the scatter
LONGEST_STEP = 1.05
# of a stated sigma; less scatter is the receiver's own smoothing, not its accuracy
LEAST_WHITE = 0.25
# a measured scatter of this share of the stated sigma is all of it
ALL_WHITE = 0.85


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fixes:
    """Fixes as the filter takes them: ellipsoidal, white covariance, the slow sigma apart.

    `p_geo` (n, 3) rad, rad, m; `R_p`, `R_v` (n, 3, 3); `v` (n, 3), NaN where none; `slow` (3,) m.
    """

    time: Array
    p_geo: Array
    R_p: Array
    v: Array
    R_v: Array
    slow: Array

    def __len__(self) -> int:
        """Number of fixes."""
        return len(self.time)


def stated_covariance(gnss: GnssLog) -> Array:
    """Covariance of every fix as stated, by its quality where not; shape (n, 3, 3), m^2."""
    out = gnss.covariance_ned.copy()
    bare = ~np.isfinite(out[:, 0, 0])
    for row in np.flatnonzero(bare):
        s = SIGMA_OF_FIX.get(int(gnss.fix[row]), SIGMA_SINGLE)
        out[row] = np.diag([s, s, HEIGHT_FACTOR * s]) ** 2
    flat = ~np.isfinite(out[:, 2, 2])
    out[flat, 2, :] = out[flat, :, 2] = 0.0
    out[flat, 2, 2] = HEIGHT_FACTOR**2 * out[flat, 0, 0]
    return np.where(np.isfinite(out), out, 0.0)


def measured_scatter(gnss: GnssLog) -> Array | None:
    """White sigma of a fix north, east and down, m, from the log itself; None if it cannot tell."""
    if len(gnss) <= FEWEST_STEPS:
        return None
    p = local_positions(gnss)
    dt = np.diff(gnss.time)
    sigma_v = (
        np.sqrt(np.nanmedian(np.einsum("nii->ni", gnss.covariance_v_ned), axis=0))
        if np.isfinite(gnss.covariance_v_ned[:, 0, 0]).any()
        else np.full(3, SIGMA_VELOCITY)
    )
    # fixes logged twice have no step between them
    real = dt > 1e-3
    if not real.any():
        return None
    usual = real & (dt < min(LONGEST_STEP, 1.5 * float(np.median(dt[real]))))
    if not np.isfinite(gnss.v_ned[:, 0]).any():
        return _scatter_of_positions(p, dt)
    step = np.diff(p, axis=0) - 0.5 * (gnss.v_ned[1:] + gnss.v_ned[:-1]) * dt[:, None]
    out = np.empty(3)
    for axis in range(3):
        good = step[usual & np.isfinite(step[:, axis]), axis]
        if len(good) < FEWEST_STEPS:
            return None
        spread = 1.4826 * float(np.median(np.abs(good - np.median(good))))
        moved = float(np.median(dt[usual])) * (sigma_v[axis] if np.isfinite(sigma_v[axis]) else 0.0)
        out[axis] = math.sqrt(max(spread**2 / 2.0 - moved**2 / 4.0, (0.1 * spread) ** 2))
    return out


def _scatter_of_positions(p: Array, dt: Array) -> Array | None:
    """White sigma by second differences, where there are no velocities; turns are the tails."""
    usual = (dt[1:] < LONGEST_STEP) & (np.abs(dt[1:] - dt[:-1]) < 0.1 * dt[1:])
    second = (p[2:] - 2.0 * p[1:-1] + p[:-2])[usual]
    second = second[np.isfinite(second).all(axis=1)]
    if len(second) < FEWEST_STEPS:
        return None
    spread = 1.4826 * np.median(np.abs(second - np.median(second, axis=0)), axis=0)
    return np.asarray(np.maximum(spread, 1e-3) / math.sqrt(6.0))


def local_positions(gnss: GnssLog) -> Array:
    """North, east, down from the middle of the log, m; shape (n, 3). Heights as logged."""
    middle = len(gnss) // 2
    o = Origin(lat=float(gnss.lat[middle]), lon=float(gnss.lon[middle]), height_ellipsoidal=0.0)
    enu = o.enu_from_geo(np.stack([gnss.lat, gnss.lon, np.zeros(len(gnss))], axis=-1))
    return np.stack([enu[:, 1], enu[:, 0], -gnss.height], axis=-1)


def prepare_fixes(
    gnss: GnssLog, *, slow_sigma: float | None = None, latency: float = 0.0, geoid: str = "egm96"
) -> Fixes:
    """Fixes for the filter.

    Parameters
    ----------
    slow_sigma : m
        See `NavigationSettings`; None = what the stated sigma leaves beside the scatter.
    latency : s
        By which the log's stamps are late.

    Raises
    ------
    NavigationError
        If there is no fix at all.
    CrsError
        If the heights are above ground.
    """
    whole = np.isfinite(gnss.lat) & np.isfinite(gnss.lon) & np.isfinite(gnss.height)
    if not whole.all():
        gnss = _rows(gnss, whole)
    if len(gnss) < 2:
        raise NavigationError(f"{gnss.source}: {len(gnss)} GNSS fixes; a trajectory needs two")
    stated = stated_covariance(gnss)
    R_p, slow = _split(stated, measured_scatter(gnss), slow_sigma)
    R_v = np.where(np.isfinite(gnss.covariance_v_ned), gnss.covariance_v_ned, 0.0)
    for axis in range(3):
        bare = R_v[:, axis, axis] <= 0.0
        R_v[bare, axis, axis] = SIGMA_VELOCITY**2
    v = gnss.v_ned.copy()
    # a log with course and speed only says nothing of climbing: let the position tell
    level = np.isfinite(v[:, 0]) & ~np.isfinite(v[:, 2])
    v[level, 2] = 0.0
    R_v[level, 2, 2] = 10.0**2
    # most receivers and programs that do not say mean the sea level
    height = ellipsoidal_heights(gnss, geoid=geoid, unstated=HeightKind.ORTHOMETRIC)
    p_geo = np.stack([gnss.lat, gnss.lon, height], axis=-1)
    return Fixes(time=gnss.time - latency, p_geo=p_geo, R_p=R_p, v=v, R_v=R_v, slow=slow)


def _rows(gnss: GnssLog, chosen: NDArray[np.bool_]) -> GnssLog:
    """Some of the fixes of a log."""
    columns: dict[str, Any] = {
        item.name: value[chosen]
        for item in fields(gnss)
        if isinstance(value := getattr(gnss, item.name), np.ndarray)
    }
    return replace(gnss, **columns)


def _split(stated: Array, white: Array | None, slow: float | None) -> tuple[Array, Array]:
    """White covariances and the slow sigmas (3,), m, of stated ones and the measured scatter."""
    usual = np.sqrt(np.median(np.einsum("nii->ni", stated), axis=0))
    if white is None:
        white = usual * (1.0 if slow == 0.0 else WHITE_SHARE)
    white = np.clip(white, LEAST_WHITE * usual, None if slow == 0.0 else 1.5 * usual)
    share = white / usual
    if slow is not None:
        return stated * np.outer(share, share), np.full(3, slow)
    rest = np.sqrt(np.maximum(usual**2 - white**2, 0.0))
    rest[white > ALL_WHITE * usual] = 0.0
    return stated * np.outer(share, share), rest
