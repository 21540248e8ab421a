"""Simulated surveys as logs of the model, and their truth, for tests of the navigation."""

from dataclasses import replace

import numpy as np

from georef_gis.frames import Array, log_so3
from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import GnssLog, ImuLog, covariance_of_sigmas, unknown
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.settings import ImuNoise, NavigationSettings
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.simulate import FlightLine, FlightSettings, SimulatedFlight, simulate_imu
from georef_gis.simulate import simulate_flight as draw
from georef_gis.simulate.ellipsoid import geodetic_from_ecef, rotation_ecef_from_ned


def survey(rows: int = 10, **settings: object) -> FlightSettings:
    """Rows of 300 m flown to and fro at 20 m/s with turns of 25 deg of bank."""
    lines = tuple(
        FlightLine(
            along=0.0, across=30.0 * (i - rows / 2), heading_deg=180.0 * (i % 2),
            height=100.0 + 2.0 * (i % 3), photos=6, base=20.0,
        )
        for i in range(rows)
    )  # fmt: skip
    return replace(FlightSettings(lines=lines, turn_radius=87.0), **settings)


def logs_of(flight: SimulatedFlight, *, errors: bool = True) -> tuple[ImuLog, GnssLog]:
    """Logs of a simulated flight, on the GPS scale."""
    imu, g, settings = simulate_imu(flight, errors=errors), flight.gnss, flight.settings
    n, start = len(g.time), flight.start_gps
    gnss = GnssLog(
        time=start + g.time, lat=g.lat, lon=g.lon, height=g.height_ellipsoidal,
        height_kind=HeightKind.ELLIPSOIDAL, geoid_separation=unknown(n), v_ned=g.v_ned,
        covariance_ned=covariance_of_sigmas(np.full((n, 3), settings.gnss_sigma)),
        covariance_v_ned=covariance_of_sigmas(np.full((n, 3), settings.gnss_velocity)),
        fix=np.full(n, 3), satellites=np.full(n, -1), source="gnss.csv",
    )  # fmt: skip
    return ImuLog(time=start + imu.time, gyro=imu.gyro, accel=imu.accel, source="imu.csv"), gnss


def truth_at(flight: SimulatedFlight, time: Array) -> tuple[Array, Array, Array]:
    """True (lat, lon, h), velocity NED and R_ned_from_body of the IMU at GPS times."""
    states = flight.path.states(time - flight.start_gps)
    lat, lon, h = geodetic_from_ecef(states.p_ecef)
    R_ecef_ned = rotation_ecef_from_ned(lat, lon)
    v = np.einsum("nji,nj->ni", R_ecef_ned, states.v_ecef)
    R = np.swapaxes(R_ecef_ned, -1, -2) @ states.R_ecef_from_body
    return np.stack([lat, lon, h], axis=-1), v, R


def settings_of(flight: SimulatedFlight, **imu: float) -> NavigationSettings:
    """What an honest user would state of this flight."""
    return NavigationSettings(
        lever_arm_body_antenna=np.array(flight.settings.lever_arm_antenna), imu=ImuNoise(**imu)
    )


def smoothed(flight: SimulatedFlight, **imu: float) -> InertialTrajectory:
    """Trajectory of a simulated flight."""
    log, gnss = logs_of(flight)
    return smooth_flight(log, prepare_fixes(gnss), settings_of(flight, **imu))


def errors_at(flight: SimulatedFlight, trajectory: InertialTrajectory, time: Array) -> Array:
    """(dp_ned m, dtheta_ned rad) = truth less estimate at times, shape (n, 6)."""
    states = trajectory.at(time)
    p, _, R = truth_at(flight, time)
    scale = np.array([6.3576e6, 6.3856e6 * np.cos(p[0, 0]), -1.0])
    theta = log_so3(R @ np.swapaxes(states.R_ned_from_body, -1, -2))
    return np.concatenate([(p - states.p_geo) * scale, theta], axis=-1)


def drawn(seed: int, rows: int = 10, **settings: object) -> SimulatedFlight:
    """A survey with its errors drawn anew."""
    return draw(survey(rows, **settings), seed)
