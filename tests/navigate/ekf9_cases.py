"""A simulated survey as logs of the model, with its truth, for the 9-state filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import (
    FIX_SINGLE,
    GnssLog,
    ImuLog,
    TrajectoryLog,
    covariance_of_sigmas,
    unknown,
)
from georef_gis.simulate import FlightLine, FlightSettings, simulate_flight, simulate_imu
from georef_gis.simulate import ellipsoid as sim


def survey(seed: int, rows: int = 20) -> tuple[ImuLog, GnssLog, TrajectoryLog]:
    """Rows of 300 m, turns of 87 m radius (25 deg of bank), white GNSS, no lever arm."""
    lines = tuple(
        FlightLine(along=0.0, across=174.0 * i, heading_deg=180.0 * (i % 2), height=100.0,
                   photos=16, base=20.0)
        for i in range(rows)
    )  # fmt: skip
    settings = FlightSettings(
        lines=lines, turn_radius=87.0, lead_in=1.0, gnss="white",
        lever_arm_antenna=(0.0, 0.0, 0.0), lever_arm_sigma=0.0,
    )  # fmt: skip
    flight = simulate_flight(settings, seed)
    samples, fixes = simulate_imu(flight), flight.gnss
    start, n = flight.start_gps, len(flight.gnss.time)
    imu = ImuLog(time=start + samples.time, gyro=samples.gyro, accel=samples.accel, source="imu")
    gnss = GnssLog(
        time=start + fixes.time, source="gnss", lat=fixes.lat, lon=fixes.lon,
        height=fixes.height_ellipsoidal, height_kind=HeightKind.ELLIPSOIDAL,
        geoid_separation=unknown(n), v_ned=fixes.v_ned,
        covariance_ned=covariance_of_sigmas(np.full((n, 3), settings.gnss_sigma)),
        covariance_v_ned=covariance_of_sigmas(np.full((n, 3), settings.gnss_velocity)),
        fix=np.full(n, FIX_SINGLE), satellites=np.full(n, -1),
    )  # fmt: skip
    states = flight.path.states(samples.time)
    lat, lon, height = sim.geodetic_from_ecef(states.p_ecef)
    R_ecef_from_ned = sim.rotation_ecef_from_ned(lat, lon)
    truth = TrajectoryLog(
        time=imu.time, source="truth", lat=lat, lon=lon, height=height,
        v_ned=np.einsum("nji,nj->ni", R_ecef_from_ned, states.v_ecef), rpy=states.rpy,
        covariance=unknown(len(lat), 6, 6),
    )  # fmt: skip
    return imu, gnss, truth


def cut_imu(imu: ImuLog, keep: np.ndarray) -> ImuLog:  # type: ignore[type-arg]
    return replace(imu, time=imu.time[keep], gyro=imu.gyro[keep], accel=imu.accel[keep])
