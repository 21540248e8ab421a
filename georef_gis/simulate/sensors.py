"""Errors of the instruments: GNSS, IMU, attitude tag, sync board, camera clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import ellipsoid
from georef_gis.simulate.settings import FlightSettings
from georef_gis.simulate.trajectory import TruePath, TruthStates

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssLog:
    """Fixes of the antenna; `n` rows.

    Parameters
    ----------
    time
        s since the first sample of the flight.
    p_ecef_true
        The antenna itself, shape (n, 3), m.
    error_ned, velocity_error_ned
        Shape (n, 3), m and m/s.
    lat, lon, height_ellipsoidal
        As logged; rad, rad, m.
    v_ned
        As logged, shape (n, 3), m/s.
    """

    time: Array
    p_ecef_true: Array
    error_ned: Array
    velocity_error_ned: Array
    lat: Array
    lon: Array
    height_ellipsoidal: Array
    v_ned: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuLog:
    """Samples of the IMU; `n` rows, body axes.

    Parameters
    ----------
    time
        s since the first sample of the flight.
    gyro, accel
        rad/s and m/s2 (specific force), shape (n, 3).
    gyro_bias, accel_bias
        True constant biases, shape (3,).
    """

    time: Array
    gyro: Array
    accel: Array
    gyro_bias: Array
    accel_bias: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger:
    """One line of the sync board.

    Parameters
    ----------
    time
        As logged, s since the first sample of the flight.
    photo
        Index of the photo, or None for a spurious line.
    """

    time: float
    photo: int | None


def gauss_markov(rng: np.random.Generator, time: Array, tau: float, sigma: float) -> Array:
    """Three stationary Gauss-Markov rows at increasing times, shape (n, 3); `tau` 0 is white."""
    white = rng.normal(size=(len(time), 3))
    if tau <= 0.0:
        return np.asarray(sigma * white)
    out = np.empty_like(white)
    out[0] = white[0]
    for i, decay in enumerate(np.exp(-np.diff(time) / tau), start=1):
        out[i] = decay * out[i - 1] + math.sqrt(1.0 - decay**2) * white[i]
    return np.asarray(sigma * out)


def simulate_gnss(
    path: TruePath,
    time: Array,
    lever_arm_antenna: Array,
    settings: FlightSettings,
    rng: np.random.Generator,
) -> GnssLog:
    """Fixes of the antenna at times, with the velocity of the lever arm's turn."""
    states = path.states(time)
    arm = np.broadcast_to(lever_arm_antenna, (len(time), 3))
    p = states.p_ecef + np.einsum("nij,nj->ni", states.R_ecef_from_body, arm)
    swing = np.cross(states.omega_ecef_body, arm)
    v = states.v_ecef + np.einsum("nij,nj->ni", states.R_ecef_from_body, swing)
    markov = gauss_markov(rng, time, settings.gnss_tau, settings.gnss_markov)
    white = rng.normal(size=(len(time), 3))
    if settings.gnss == "white":
        error = settings.gnss_sigma * white
    else:
        error = settings.gnss_white * white + markov
    velocity_error = settings.gnss_velocity * rng.normal(size=(len(time), 3))
    lat, lon, _ = ellipsoid.geodetic_from_ecef(p)
    R_en = ellipsoid.rotation_ecef_from_ned(lat, lon)
    fix = ellipsoid.geodetic_from_ecef(p + np.einsum("nij,nj->ni", R_en, error))
    return GnssLog(
        time=time, p_ecef_true=p, error_ned=error, velocity_error_ned=velocity_error,
        lat=fix[0], lon=fix[1], height_ellipsoidal=fix[2],
        v_ned=np.einsum("nji,nj->ni", R_en, v) + velocity_error,
    )  # fmt: skip


def imu_of_states(
    states: TruthStates, settings: FlightSettings, rng: np.random.Generator | None
) -> ImuLog:
    """IMU samples of true states; error-free without a generator."""
    gyro_bias, accel_bias = np.zeros(3), np.zeros(3)
    gyro, accel = states.gyro, states.accel
    if rng is not None:
        gyro_bias = math.radians(settings.gyro_bias_deg_h) / 3600.0 * rng.normal(size=3)
        gyro = gyro + gyro @ _misalignment(settings, rng).T
        accel_bias = settings.accel_bias * rng.normal(size=3)
        density = math.sqrt(settings.imu_rate)
        gyro_white = math.radians(settings.gyro_walk_deg_rt_h) / 60.0 * density
        accel_white = settings.accel_walk_rt_h / 60.0 * density
        gyro = gyro + gyro_bias + gyro_white * rng.normal(size=gyro.shape)
        accel = accel + accel_bias + accel_white * rng.normal(size=accel.shape)
    return ImuLog(
        time=states.time, gyro=gyro, accel=accel, gyro_bias=gyro_bias, accel_bias=accel_bias
    )


def _misalignment(settings: FlightSettings, rng: np.random.Generator) -> Array:
    """Scale and misalignment of the gyros, (3, 3); draws nothing where both are zero."""
    scale, angle = settings.gyro_scale_percent / 100.0, math.radians(settings.gyro_misalignment_deg)
    if scale == 0.0 and angle == 0.0:
        return np.zeros((3, 3))
    return np.where(np.eye(3, dtype=bool), scale, angle) * rng.normal(size=(3, 3))


def simulate_triggers(
    exposures: Array, settings: FlightSettings, rng: np.random.Generator
) -> tuple[Trigger, ...]:
    """Sync-board times in order, some missed and some spurious.

    The first and the last photo are never missed, and a spurious line keeps 0.3 s from any photo:
    else the log would hold nothing to tell them by.
    """
    missed = rng.choice(
        np.arange(1, len(exposures) - 1), size=settings.missed_triggers, replace=False
    )
    logged = exposures + settings.trigger_sigma * rng.normal(size=len(exposures))
    lines = [Trigger(time=float(t), photo=i) for i, t in enumerate(logged) if i not in missed]
    while len(lines) < len(exposures) - len(missed) + settings.spurious_triggers:
        time = float(rng.uniform(exposures[0], exposures[-1]))
        if np.min(np.abs(exposures - time)) > 0.3:
            lines.append(Trigger(time=time, photo=None))
    return tuple(sorted(lines, key=lambda line: line.time))
