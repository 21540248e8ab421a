"""Flights that no survey makes: waiting on the ground, hovering, sideways, straight ahead."""

from dataclasses import replace

import numpy as np
from navigation_flights import drawn
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d

from georef_gis.frames import Array
from georef_gis.simulate import SimulatedFlight
from georef_gis.simulate.sensors import simulate_gnss
from georef_gis.simulate.trajectory import TruePath

# s between the knots of a path
KNOT = 0.1


def flown(
    seed: int, time: Array, p_enu: Array, rpy: Array, **settings: object
) -> SimulatedFlight:  # fmt: skip
    """Flight through points (n, 3) m and angles (n, 3) rad, unwrapped, at times; errors drawn."""
    base = drawn(seed, 1, **settings)
    path = TruePath(
        p_enu=make_interp_spline(time, p_enu, k=5), rpy=make_interp_spline(time, rpy, k=5),
        duration=float(time[-1]), exposures=time[[1, -2]], wind_enu=np.zeros(3),
    )  # fmt: skip
    fixes = np.arange(1.0 / base.settings.gnss_rate, path.duration, 1.0 / base.settings.gnss_rate)
    rng = np.random.default_rng([seed, 2])
    gnss = simulate_gnss(path, fixes, base.lever_arm_antenna, base.settings, rng)
    return replace(base, path=path, gnss=gnss, start_gps=float(round(base.start_gps)))


def waiting_first(
    seed: int, wait: float, rows: int = 2, *, launch: float = 2.0, **settings: object
) -> SimulatedFlight:  # fmt: skip
    """A survey whose vehicle stands for `wait` s and is at full speed `launch` s later."""
    path = drawn(seed, rows, **settings).path
    time = np.arange(0.0, wait + path.duration, KNOT)
    # the survey's own clock: it stands, starts, and runs
    u = np.clip((time - wait) / launch, 0.0, 1.0)
    gained = launch * (u**6 - 3.0 * u**5 + 2.5 * u**4)
    clock = gained + np.maximum(time - wait - launch, 0.0)
    return flown(seed, time, path.p_enu(clock), path.rpy(clock), **settings)


def multirotor(
    seed: int, yaw_deg: float, *, yaw_rate_deg: float = 0.0, legs: int = 8, **settings: object
) -> SimulatedFlight:  # fmt: skip
    """Legs of 60 m at 5 m/s east, south, west, north, stopping between, whatever way it points."""
    leg, stop = 12.0, 4.0
    time = np.arange(0.0, legs * (leg + stop) + 4.0, KNOT)
    east = np.zeros_like(time)
    north = np.zeros_like(time)
    for i in range(legs):
        begin = 2.0 + i * (leg + stop)
        on = (time >= begin) & (time < begin + leg)
        east[on] += 5.0 * (1, 0, -1, 0)[i % 4]
        north[on] += 5.0 * (0, -1, 0, 1)[i % 4]
    v = gaussian_filter1d(np.stack([east, north, 0.0 * east], axis=-1), 0.8 / KNOT, axis=0)
    a = np.gradient(v, KNOT, axis=0)
    p = np.cumsum(v, axis=0) * KNOT + np.array([0.0, 0.0, 60.0])
    rng = np.random.default_rng([seed, 77])
    shake = gaussian_filter1d(rng.normal(size=(len(time), 3)), 0.5 / KNOT, axis=0)
    shake *= np.radians(1.0) / shake.std()
    yaw = np.radians(yaw_deg + yaw_rate_deg * time)
    # thrust leans into acceleration and drag
    lean = a + 0.3 * v
    ahead = lean[:, 0] * np.sin(yaw) + lean[:, 1] * np.cos(yaw)
    right = lean[:, 0] * np.cos(yaw) - lean[:, 1] * np.sin(yaw)
    rpy = np.stack([np.arctan2(right, 9.81), -np.arctan2(ahead, 9.81), yaw], axis=-1) + shake
    return flown(seed, time, p, rpy, **settings)


def straight(seed: int, duration: float = 200.0, *, shake: float = 1.0,
             **settings: object) -> SimulatedFlight:  # fmt: skip
    """One straight line at 20 m/s and constant speed, with a crab of 8 deg."""
    time = np.arange(0.0, duration, KNOT)
    p = np.stack([14.142 * time, 14.142 * time, 100.0 + 0.0 * time], axis=-1)
    rng = np.random.default_rng([seed, 78])
    turn = gaussian_filter1d(rng.normal(size=(len(time), 3)), 0.5 / KNOT, axis=0)
    turn *= shake * np.radians(1.5) / turn.std()
    rpy = np.radians([0.0, 2.5, 45.0 + 8.0]) + turn
    return flown(seed, time, p, rpy, **settings)


def standing(seed: int, duration: float = 200.0, **settings: object) -> SimulatedFlight:
    """A vehicle that never moves."""
    time = np.arange(0.0, duration, KNOT)
    p = np.broadcast_to([10.0, 20.0, 0.0], (len(time), 3))
    rpy = np.broadcast_to(np.radians([1.0, 5.0, 70.0]), (len(time), 3))
    return flown(seed, time, p, rpy, **settings)
