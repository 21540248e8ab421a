"""Logs of a flight: IMU, GNSS and sync board, as the contracts have their columns."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate.flight import SimulatedFlight, simulate_imu
from georef_gis.units import GPS_WEEK, week_from_gps

Array = NDArray[np.float64]

IMU_HEADER = (
    "gps_week,tow_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
)
GNSS_HEADER = (
    "gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m,v_north,v_east,v_down,"
    "sigma_north_m,sigma_east_m,sigma_down_m,sigma_v_north,sigma_v_east,sigma_v_down,fix"
)


def write_logs(flight: SimulatedFlight, folder: Path, *, truth_imu: bool) -> list[Path]:
    """Write the logs, and GNSS (and if asked the IMU) without error under ``truth``."""
    paths = [
        _write_imu(flight, folder / "logs" / "imu.csv", errors=True),
        _write_gnss(flight, folder / "logs" / "gnss.csv", errors=True),
        _write_sync_board(flight, folder / "logs" / "sync_board.log"),
        _write_gnss(flight, folder / "truth" / "gnss.csv", errors=False),
    ]
    if truth_imu:
        paths.append(_write_imu(flight, folder / "truth" / "imu.csv", errors=False))
    return paths


def _week_and_tow(flight: SimulatedFlight, time: Array, step: float) -> tuple[Array, Array]:
    """Week and time of week, on a grid of `step` so that no tow reads 604800.00."""
    ticks = np.round((flight.start_gps + time) / step)
    per_week = round(GPS_WEEK / step)
    return ticks // per_week, (ticks % per_week) * step


def _write_imu(flight: SimulatedFlight, path: Path, *, errors: bool) -> Path:
    log = simulate_imu(flight, errors=errors)
    week, tow = _week_and_tow(flight, log.time, 1.0 / flight.settings.imu_rate)
    table = np.column_stack([week, tow, log.gyro, log.accel])
    rate = ["%.6f" if errors else "%.10f"] * 3
    force = ["%.4f" if errors else "%.8f"] * 3
    form = ["%d", "%.3f", *rate, *force]
    np.savetxt(path, table, fmt=form, delimiter=",", header=IMU_HEADER, comments="")
    return path


def _write_gnss(flight: SimulatedFlight, path: Path, *, errors: bool) -> Path:
    from georef_gis.simulate import ellipsoid

    log, settings = flight.gnss, flight.settings
    week, tow = _week_and_tow(flight, log.time, 1.0 / settings.gnss_rate)
    lat, lon, h = log.lat, log.lon, log.height_ellipsoidal
    velocity = log.v_ned
    sigmas = [settings.gnss_sigma] * 3 + [settings.gnss_velocity] * 3
    if not errors:
        lat, lon, h = ellipsoid.geodetic_from_ecef(log.p_ecef_true)
        velocity = log.v_ned - log.velocity_error_ned
        sigmas = [0.0] * 6
    fix = np.full(len(tow), 3)
    spread = np.broadcast_to(np.array(sigmas), (len(tow), 6))
    place = [np.degrees(lat), np.degrees(lon), h]
    table = np.column_stack([week, tow, *place, velocity, spread, fix])
    form = ["%d", "%.2f", "%.9f", "%.9f", "%.3f", *["%.3f"] * 3, *["%.3f"] * 6, "%d"]
    np.savetxt(path, table, fmt=form, delimiter=",", header=GNSS_HEADER, comments="")
    return path


def nmea_checksum(body: str) -> str:
    """Two hexadecimal digits: exclusive or of the characters between ``$`` and ``*``."""
    return f"{reduce(lambda a, b: a ^ b, body.encode('ascii'), 0):02X}"


def _write_sync_board(flight: SimulatedFlight, path: Path) -> Path:
    """One line per trigger the board saw; `seq` counts lines, so a missed one leaves no gap.

    `pulse_us` is the width of the shutter pulse; `flags` is 1: the time was disciplined by GPS.
    """
    rng = np.random.default_rng([flight.seed, 10])
    lines = []
    for seq, trigger in enumerate(flight.triggers, start=1):
        week, tow = week_from_gps(flight.start_gps + trigger.time)
        pulse = 1500 + int(rng.integers(-4, 5))
        body = f"TSB,{seq},{week},{tow:.6f},{pulse},1"
        lines.append(f"${body}*{nmea_checksum(body)}\r\n")
    path.write_bytes("".join(lines).encode("ascii"))
    return path
