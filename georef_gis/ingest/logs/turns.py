"""How a vehicle moves in windows of time: its turns by GNSS beside what the IMU measured then."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.logs import GnssLog, ImuLog

# s: blocks that take vibration out of the specific force, and windows of the turns
_BLOCK, _WINDOW = 1.0, 2.0
# m/s: slower, the course is noise
MOVING = 3.0
# rad/s: rms of the rate of course below which no turn shows
TURNING = 0.03
FEWEST_WINDOWS = 15


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """Means over windows: rate of course, rad/s, speed, m/s, gyro and accel (n, 3)."""

    rate: Array
    speed: Array
    gyro: Array
    accel: Array


def block_means(time: Array, values: Array) -> Array:
    """Means over blocks of 1 s; shape (blocks, 3)."""
    block = np.floor((time - time[0]) / _BLOCK).astype(np.int64)
    _, which, count = np.unique(block, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(which, values[:, k]) for k in range(values.shape[1])])
    return np.asarray(sums / count[:, None])


def turns_of(imu: ImuLog, gnss: GnssLog) -> Turns | None:
    """Windows of 2 s in which the vehicle moves, or None if there are few or no turns."""
    time, velocity = horizontal_velocity(gnss)
    if len(time) < 5:
        return None
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    start = np.arange(max(time[0], imu.time[0]), min(time[-1], imu.time[-1]) - _WINDOW, _WINDOW)
    if len(start) < FEWEST_WINDOWS:
        return None
    slow = np.concatenate([[0.0], np.cumsum((speed[1:] < MOVING) | (speed[:-1] < MOVING))])
    gap = np.concatenate([[0.0], np.cumsum(np.diff(time) > 1.5 * _WINDOW)])
    sharp = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(course)) > 2.0)])
    hole = np.concatenate([[0.0], np.cumsum(np.diff(imu.time) > 0.25)])
    end = start + _WINDOW

    def within(at: Array, count: Array) -> Array:
        first = np.clip(np.searchsorted(at, start, side="right") - 1, 0, len(at) - 1)
        last = np.clip(np.searchsorted(at, end, side="left"), 0, len(at) - 1)
        return np.asarray(count[last] - count[first])

    good = (within(time, slow + gap + sharp) == 0) & (within(imu.time, hole) == 0)
    if np.count_nonzero(good) < FEWEST_WINDOWS:
        return None
    rate = (np.interp(end, time, course) - np.interp(start, time, course)) / _WINDOW
    out = Turns(
        rate=rate[good],
        speed=np.interp(start + _WINDOW / 2, time, speed)[good],
        gyro=window_means(imu.time, imu.gyro, start[good]),
        accel=window_means(imu.time, imu.accel, start[good]),
    )
    return out if float(np.sqrt(np.mean(out.rate**2))) > TURNING else None


def horizontal_velocity(gnss: GnssLog) -> tuple[Array, Array]:
    """Times and horizontal velocity, (n, 2) m/s: as stated, else from places 2 s apart."""
    stated = np.isfinite(gnss.v_ned[:, :2]).all(axis=1)
    if np.count_nonzero(stated) > len(gnss) / 2:
        return gnss.time[stated], gnss.v_ned[stated, :2]
    if len(gnss) < 5 or float(np.ptp(gnss.time)) < 2 * _WINDOW:
        return np.zeros(0), np.zeros((0, 2))
    place = 6_371_000.0 * np.column_stack(
        [gnss.lat, np.unwrap(gnss.lon) * np.cos(np.median(gnss.lat))]
    )
    step = max(1, round(_WINDOW / max(1e-3, float(np.median(np.diff(gnss.time))))) // 2)
    ahead, behind = place[2 * step :], place[: -2 * step]
    span = gnss.time[2 * step :] - gnss.time[: -2 * step]
    return gnss.time[step:-step], np.asarray((ahead - behind) / span[:, None])


def window_means(time: Array, values: Array, start: Array) -> Array:
    """Means over windows, by the integral of straight lines between samples; shape (n, 3)."""
    steps = np.diff(time)[:, None] * (values[1:] + values[:-1]) / 2.0
    total = np.vstack([np.zeros(values.shape[1]), np.cumsum(steps, axis=0)])
    parts = [
        np.interp(start + _WINDOW, time, total[:, k]) - np.interp(start, time, total[:, k])
        for k in range(values.shape[1])
    ]
    return np.column_stack(parts) / _WINDOW


def correlation(a: Array, b: Array) -> float:
    """Correlation of rows, 0 where one is constant."""
    a, b = a - np.mean(a), b - np.mean(b)
    power = float(np.sum(a**2) * np.sum(b**2))
    return float(np.sum(a * b)) / math.sqrt(power) if power > 0.0 else 0.0
