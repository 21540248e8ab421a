"""The analytic flight: Dubins turns between rows, smoothed and shaken, as quintic splines.

Splines are differentiated exactly, so the error-free IMU belongs to the path to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from georef_gis.simulate import ellipsoid, site
from georef_gis.simulate.settings import FlightLine, FlightSettings

Array = NDArray[np.float64]

KNOT = 0.25  # s between the knots of the splines


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthStates:
    """States of the IMU at given times; `n` rows.

    Parameters
    ----------
    time
        s since the first sample of the flight.
    p_ecef, v_ecef
        Position and velocity relative to the Earth, shape (n, 3), m and m/s.
    rpy
        Roll, pitch, yaw of body against local NED, shape (n, 3), rad.
    R_ecef_from_body
        Shape (n, 3, 3).
    gyro, accel
        Angular rate against inertial space and specific force, body axes, shape (n, 3).
    omega_ecef_body
        Angular rate against the Earth, body axes, shape (n, 3), rad/s.
    """

    time: Array
    p_ecef: Array
    v_ecef: Array
    rpy: Array
    R_ecef_from_body: Array
    gyro: Array
    accel: Array
    omega_ecef_body: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class TruePath:
    """Analytic path and attitude, and the times of exposure, s."""

    p_enu: BSpline
    rpy: BSpline
    duration: float
    exposures: Array
    wind_enu: Array

    def states(self, time: Array) -> TruthStates:
        """Position, velocity, attitude and error-free IMU at times, s."""
        time = np.asarray(time, dtype=np.float64)
        turn = site.rotation_ecef_from_site_enu()
        p = site.ecef_from_enu(self.p_enu(time))
        v = self.p_enu(time, 1) @ turn.T
        a = self.p_enu(time, 2) @ turn.T
        lat, lon, h = ellipsoid.geodetic_from_ecef(p)
        R_en = ellipsoid.rotation_ecef_from_ned(lat, lon)
        rpy, rate = self.rpy(time), self.rpy(time, 1)
        R_eb = R_en @ rotation_ned_from_body(rpy)
        earth = np.array([0.0, 0.0, ellipsoid.EARTH_RATE])
        v_ned = np.einsum("nji,nj->ni", R_en, v)
        omega_en_e = np.einsum("nij,nj->ni", R_en, _transport_rate(lat, h, v_ned))
        omega_eb = np.einsum("nji,nj->ni", R_eb, omega_en_e) + _euler_to_body_rate(rpy, rate)
        gyro = omega_eb + np.einsum("nji,j->ni", R_eb, earth)
        g_e = R_en[..., 2] * ellipsoid.gravity(lat, h)[:, None]
        force = np.einsum("nji,nj->ni", R_eb, a + 2.0 * np.cross(earth, v) - g_e)
        return TruthStates(
            time=time, p_ecef=p, v_ecef=v, rpy=rpy, R_ecef_from_body=R_eb, gyro=gyro, accel=force,
            omega_ecef_body=omega_eb,
        )  # fmt: skip


def rotation_ned_from_body(rpy: Array) -> Array:
    """Matrices of roll, pitch, yaw (rad), written out, shape (..., 3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(rpy), -1, 0), np.moveaxis(np.cos(rpy), -1, 0)
    rows = (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _euler_to_body_rate(rpy: Array, rate: Array) -> Array:
    r, p = rpy[..., 0], rpy[..., 1]
    dr, dp, dy = rate[..., 0], rate[..., 1], rate[..., 2]
    return np.stack(
        [
            dr - dy * np.sin(p),
            dp * np.cos(r) + dy * np.sin(r) * np.cos(p),
            -dp * np.sin(r) + dy * np.cos(r) * np.cos(p),
        ],
        axis=-1,
    )


def _transport_rate(lat: Array, h: Array, v_ned: Array) -> Array:
    m, n = ellipsoid.radii(lat)
    east = v_ned[:, 1] / (n + h)
    return np.stack([east, -v_ned[:, 0] / (m + h), -east * np.tan(lat)], axis=-1)


def make_path(settings: FlightSettings, rng: np.random.Generator) -> TruePath:
    """Draw a flight over the rows of `settings` with wind and turbulence of `rng`."""
    xy, up, marks = _planned_points(settings)
    step = settings.speed * KNOT
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    time = np.arange(0.0, along[-1] / settings.speed, KNOT)
    travelled = time * settings.speed
    p = np.stack([np.interp(travelled, along, c) for c in (xy[:, 0], xy[:, 1], up)], axis=-1)
    p[:, :2] = _smooth(p[:, :2], 2.5 * step / settings.speed / KNOT)
    p[:, 2] = _smooth(p[:, 2:], 8.0)[:, 0]
    p += _correlated(rng, len(time), 3.0, settings.path_sigma, smooth=6.0)
    spline = make_interp_spline(time, p, k=5)
    wind = np.append(rng.normal(0.0, settings.wind_sigma, 2), 0.0)
    rpy = _attitude(spline, time, wind, settings, rng)
    exposures = marks / settings.speed + rng.uniform(-0.12, 0.12, len(marks))
    return TruePath(
        p_enu=spline, rpy=make_interp_spline(time, rpy, k=5), duration=float(time[-1]),
        exposures=exposures, wind_enu=wind,
    )  # fmt: skip


def _attitude(
    spline: BSpline,
    time: Array,
    wind: Array,
    settings: FlightSettings,
    rng: np.random.Generator,
) -> Array:
    """Coordinated turns in the wind plus turbulence; yaw unwrapped, shape (n, 3), rad."""
    v, a = spline(time, 1), spline(time, 2)
    speed = np.hypot(v[:, 0], v[:, 1])
    right = np.stack([v[:, 1], -v[:, 0]], axis=-1) / speed[:, None]
    bank = np.arctan2(np.sum(a[:, :2] * right, axis=-1), 9.80665)
    air = v - wind
    yaw = np.unwrap(np.arctan2(air[:, 0], air[:, 1]))
    pitch = np.arctan2(v[:, 2], speed) + math.radians(settings.pitch_trim_deg)
    sigma = np.radians([settings.roll_sigma_deg, settings.pitch_sigma_deg, settings.yaw_sigma_deg])
    shake = _correlated(rng, len(time), settings.turbulence_tau, 1.0, smooth=1.2) * sigma
    smooth = _smooth(np.stack([bank, pitch, yaw], axis=-1), 2.0)
    return smooth + shake


def _correlated(
    rng: np.random.Generator, count: int, tau: float, sigma: float, *, smooth: float
) -> Array:
    """Three Gauss-Markov rows smoothed over `smooth` knots and brought back to `sigma`."""
    white = rng.normal(size=(count + 400, 3))
    decay = math.exp(-KNOT / tau)
    out = np.zeros_like(white)
    for i in range(1, len(out)):
        out[i] = decay * out[i - 1] + math.sqrt(1.0 - decay**2) * white[i]
    out = _smooth(out, smooth)
    gain = _smoothing_gain(decay, smooth)
    return np.asarray(sigma * out[200 : 200 + count] / gain)


def _kernel(width: float) -> Array:
    half = math.ceil(4 * width)
    k = np.exp(-0.5 * (np.arange(-half, half + 1) / width) ** 2)
    return np.asarray(k / k.sum())


def _smoothing_gain(decay: float, width: float) -> float:
    """Standard deviation left of a unit Gauss-Markov row after the kernel."""
    k = _kernel(width)
    lag = np.abs(np.subtract.outer(np.arange(len(k)), np.arange(len(k))))
    return float(np.sqrt(k @ decay**lag @ k))


def _smooth(rows: Array, width: float) -> Array:
    """Columns under a Gaussian of `width` samples, ends continued with their slope."""
    k = _kernel(width)
    half = len(k) // 2
    index = np.arange(1, half + 1)[:, None]
    head = rows[0] - index[::-1] * (rows[1] - rows[0])
    tail = rows[-1] + index * (rows[-1] - rows[-2])
    padded = np.concatenate([head, rows, tail])
    columns = [np.convolve(c, k, mode="valid") for c in padded.T]
    return np.stack(columns, axis=-1)


def _planned_points(settings: FlightSettings) -> tuple[Array, Array, Array]:
    """Dense points of the planned path, their up, and the lengths at which photos are due, m."""
    xy: list[Array] = []
    up: list[Array] = []
    marks: list[Array] = []
    length, previous = 0.0, 0.0
    for line in settings.lines:
        start, end, heading = _row_ends(line, settings)
        if xy:
            turn = dubins(xy[-1][-1], previous, start, heading, settings.turn_radius)
            climb = np.linspace(up[-1][-1], line.height, len(turn))
            xy, up = [*xy, turn], [*up, climb]
            length += float(np.sum(np.hypot(*np.diff(np.vstack([xy[-2][-1], turn]), axis=0).T)))
        row = np.linspace(start, end, 200)
        if xy:
            length += float(np.hypot(*(row[0] - xy[-1][-1])))
        first = length + settings.lead_in * settings.speed
        marks.append(np.asarray(first + line.base * np.arange(line.photos), dtype=np.float64))
        xy, up = [*xy, row], [*up, np.full(200, line.height)]
        length += float(np.hypot(*(end - start)))
        previous = heading
    return np.concatenate(xy), np.concatenate(up), np.concatenate(marks)


def _row_ends(line: FlightLine, settings: FlightSettings) -> tuple[Array, Array, float]:
    """First and last point (with run-in and a short run-out) and heading from east, rad."""
    road = math.pi / 2 - site.ROAD_AZIMUTH
    heading = road + math.radians(line.heading_deg)
    middle = site.enu_from_road(np.asarray(line.along), np.asarray(line.across))[:2]
    d = np.array([math.cos(heading), math.sin(heading)])
    half = line.base * (line.photos - 1) / 2
    run_in, run_out = settings.lead_in * settings.speed, 2.0 * settings.speed
    return middle - (half + run_in) * d, middle + (half + run_out) * d, heading


def dubins(p: Array, heading_p: float, q: Array, heading_q: float, radius: float) -> Array:
    """Shortest turn-straight-turn path between two directed points, shape (n, 2), m.

    Dubins (1957), the four paths with a straight part.
    """
    best: Array | None = None
    best_length = math.inf
    for first in (1.0, -1.0):
        for last in (1.0, -1.0):
            path = _turn_straight_turn(p, heading_p, q, heading_q, radius * first, radius * last)
            if path is None:
                continue
            length = float(np.sum(np.hypot(*np.diff(path, axis=0).T)))
            if length < best_length:
                best, best_length = path, length
    if best is None:
        raise ValueError("no turn between two rows; set a smaller turn radius")
    return best


def _turn_straight_turn(
    p: Array, heading_p: float, q: Array, heading_q: float, r_p: float, r_q: float
) -> Array | None:
    """One path; a positive radius turns left."""
    c_p = p + r_p * np.array([-math.sin(heading_p), math.cos(heading_p)])
    c_q = q + r_q * np.array([-math.sin(heading_q), math.cos(heading_q)])
    gap = c_q - c_p
    distance = float(np.hypot(*gap))
    if distance < abs(r_p - r_q):
        return None
    # On the straight part each centre lies its signed radius to the left of the line.
    heading = math.atan2(gap[1], gap[0]) - math.asin((r_q - r_p) / distance)
    arcs = []
    for centre, r, start, end in ((c_p, r_p, heading_p, heading), (c_q, r_q, heading, heading_q)):
        sweep = (end - start) % (2 * math.pi) if r > 0 else -((start - end) % (2 * math.pi))
        angle = start + np.linspace(0.0, sweep, 120)
        arcs.append(centre + r * np.stack([np.sin(angle), -np.cos(angle)], axis=-1))
    return np.concatenate(arcs)
