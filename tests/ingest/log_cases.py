"""Logs for tests: simulated flights, and the real ones where GEOREF_DATA says."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import (
    AttitudeLog,
    FlightLogs,
    GnssLog,
    ImuLog,
    covariance_of_sigmas,
    unknown,
)
from georef_gis.units import gps_from_week

# s of GPS; day of thor75's flight, 2012-10-10, whose log holds no week: its start of the week
THOR_WEEK = gps_from_week(1709, 0.0)


def gnss_log(time, lat, lon, height, v_ned, sigma=(2.0, 2.0, 3.0), sigma_v=0.1, **more) -> GnssLog:
    """Fixes of plain columns; angles rad."""
    n = len(time)
    values = {
        "height_kind": HeightKind.ELLIPSOIDAL,
        "geoid_separation": unknown(n),
        "covariance_ned": covariance_of_sigmas(np.tile(sigma, (n, 1)).astype(float)),
        "covariance_v_ned": covariance_of_sigmas(np.full((n, 3), sigma_v)),
        "fix": np.full(n, 3),
        "satellites": np.full(n, 9),
    } | more
    return GnssLog(time=time, lat=lat, lon=lon, height=height, v_ned=v_ned, **values)


def simulated(seed: int = 5, **settings: object) -> FlightLogs:
    """IMU and GNSS of a simulated survey flight."""
    from georef_gis.simulate import FlightSettings, simulate_flight
    from georef_gis.simulate.flight import simulate_imu

    flight = simulate_flight(FlightSettings(**settings), seed=seed)
    imu, gnss = simulate_imu(flight), flight.gnss
    start = flight.start_gps
    return FlightLogs(
        imu=ImuLog(time=start + imu.time, gyro=imu.gyro, accel=imu.accel),
        gnss=gnss_log(start + gnss.time, gnss.lat, gnss.lon, gnss.height_ellipsoidal, gnss.v_ned),
        source="simulated",
    )


def thor75(data: Path) -> FlightLogs:
    """Real fixed wing: rows as the log holds them, placeholders of the start included."""
    from scipy.io import loadmat

    path = data / "flight_logs" / "thor75" / "thor_flight75.mat"
    d = loadmat(path, squeeze_me=True, struct_as_record=False)["flight_data"]
    fresh = np.concatenate([[True], np.diff(d.GPS_TOW) != 0.0])
    # the log ties boot time to the week by the fixes themselves
    offset = float(np.max(d.GPS_TOW - d.time)) + THOR_WEEK
    return FlightLogs(
        imu=ImuLog(
            time=d.time + offset,
            gyro=np.column_stack([d.p, d.q, d.r]),
            accel=np.column_stack([d.ax, d.ay, d.az]),
        ),
        gnss=gnss_log(
            d.time[fresh] + offset,
            np.radians(d.lat[fresh]),
            np.radians(d.lon[fresh]),
            d.alt[fresh].astype(float),
            np.column_stack([d.vn, d.ve, d.vd])[fresh],
        ),
        attitude=AttitudeLog(
            time=d.time + offset,
            rpy=np.column_stack([d.phi, d.theta, d.psi]),
            sigma_rpy=unknown(len(d.time), 3),
        ),
        source="thor75",
    )


def drive_0708(data: Path, *, mounted: bool = True) -> FlightLogs:
    """Real car; `mounted` turns the IMU by the roll and yaw of its mount, 180 and 185 deg."""
    folder = data / "flight_logs" / "drive_0708"
    table = np.loadtxt(folder / "imu_1934.csv", delimiter=",")
    turn = np.diag([-1.0, 1.0, -1.0]) if mounted else np.eye(3)
    lines = (folder / "gnss_1934_sf.pos").read_text().splitlines()
    rows = [line.split() for line in lines if not line.startswith("%")]
    values = np.array([[float(v) for v in row[2:18]] for row in rows])
    clock = [[float(v) for v in row[1].split(":")] for row in rows]
    day = gps_from_week(2374, 2 * 86400.0)  # Tuesday 2025-07-08, GPST
    time = day + np.array([h * 3600 + m * 60 + s for h, m, s in clock])
    # by the header of imu_1934.csv.tag, first line: good to some 0.1 s
    first = day + 19 * 3600 + 34 * 60 + 21.985
    boot = (table[:, 6] - table[0, 6]) * 1e-3
    velocity = values[:, 13:16] * np.array([1.0, 1.0, -1.0])
    return FlightLogs(
        imu=ImuLog(
            time=first + boot,
            gyro=np.radians(table[:, 3:6]) @ turn,
            accel=table[:, 0:3] * 9.80665 @ turn,
        ),
        gnss=gnss_log(
            time, np.radians(values[:, 0]), np.radians(values[:, 1]), values[:, 2], velocity,
            sigma=(0.01, 0.01, 0.01), sigma_v=0.06, fix=np.full(len(time), 7),
        ),
        source="drive_0708",
    )  # fmt: skip
