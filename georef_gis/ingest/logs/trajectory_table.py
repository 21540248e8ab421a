"""Trajectories as CSV: the project's own form, read and written.

Columns: gps_week, tow_s, lat_deg, lon_deg, height_ellipsoidal_m, v_north, v_east, v_down (m/s),
roll_deg, pitch_deg, yaw_deg, and one sigma of position (m) and of the angles (deg). The first five
are needed; an empty cell is a missing value. Lines that begin with # are comments; `# place: imu`
says whose position it is (imu, antenna, camera).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import (
    Array,
    covariance_theta_ned_from_rpy,
    sigma_rpy_from_covariance_theta_ned,
)
from georef_gis.model.logs import TrajectoryLog, unknown
from georef_gis.units import GPS_WEEK

TIME = ("gps_week", "tow_s")
PLACE = ("lat_deg", "lon_deg", "height_ellipsoidal_m")
VELOCITY = ("v_north", "v_east", "v_down")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
SIGMA_PLACE = ("sigma_north_m", "sigma_east_m", "sigma_down_m")
SIGMA_ATTITUDE = ("sigma_roll_deg", "sigma_pitch_deg", "sigma_yaw_deg")
COLUMNS = (*TIME, *PLACE, *VELOCITY, *ATTITUDE, *SIGMA_PLACE, *SIGMA_ATTITUDE)
REQUIRED = (*TIME, *PLACE)
# Digits after the point: 0.1 us of time, 0.1 mm of place, 0.1 mm/s, 0.1 mas.
_DIGITS = (0, 7, 10, 10, 4, 4, 4, 4, 8, 8, 8, 4, 4, 4, 8, 8, 8)
_PLACES = ("imu", "antenna", "camera", "unknown")


class _Head(NamedTuple):
    names: tuple[str, ...]
    place: str
    # lines up to and with the header
    lines: int


def is_trajectory_table(head: bytes) -> bool:
    """Whether the first bytes of a file are those of such a table, with attitude or sigmas.

    Positions alone are taken for fixes, which the same columns may hold.
    """
    text = head.decode("utf-8-sig", errors="replace")
    line = next((x for x in text.splitlines() if x.strip() and not x.startswith("#")), "")
    names = {name.strip().lower() for name in line.split(",")}
    return names.issuperset(REQUIRED) and names.issuperset(ATTITUDE)


def read_trajectory_table(path: Path) -> TrajectoryLog:
    """Trajectory of a CSV file.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a needed column or holds what is no number or no place.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            head = _read_head(stream, path)
            table = _numbers(stream, head, path)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not a text file in UTF-8 (byte {error.start}); save it as CSV, UTF-8",
            source=str(path),
        ) from error
    return _trajectory(table, head, path)


def write_trajectory_table(stream: IO[bytes], log: TrajectoryLog) -> None:
    """Write a trajectory as CSV into a binary stream.

    Sigmas only: what the covariance says between values is lost.

    Raises
    ------
    InputError
        If its times are not on the GPS scale: week and second would be invented.
    """
    if log.scale != "gps":
        raise InputError(
            f"times are on the {log.scale} scale; a table needs GPS time: give the log's clock",
            source=log.source,
        )
    week = np.floor(log.time / GPS_WEEK)
    # Rounding must not give a second 604800 of the week.
    tow = np.round(log.time - week * GPS_WEEK, _DIGITS[1])
    week, tow = np.where(tow >= GPS_WEEK, week + 1, week), np.where(tow >= GPS_WEEK, 0.0, tow)
    rpy = np.degrees(log.rpy)
    rpy[:, 2] = np.mod(rpy[:, 2], 360.0)
    variance = np.diagonal(log.covariance, axis1=1, axis2=2)
    sigma = sigma_rpy_from_covariance_theta_ned(log.rpy, log.covariance[:, 3:, 3:])
    table = np.column_stack(
        [week, tow, np.degrees(log.lat), np.degrees(log.lon), log.height, log.v_ned, rpy,
         np.sqrt(variance[:, :3]), np.degrees(sigma)]
    )  # fmt: skip
    stream.write(f"# place: {log.position_of}\n{','.join(COLUMNS)}\n".encode())
    form = ",".join(f"%.{digits}f" for digits in _DIGITS)
    for begin in range(0, len(table), 10000):
        text = "\n".join(form % tuple(row) for row in table[begin : begin + 10000].tolist())
        stream.write((text.replace("nan", "") + "\n").encode())


def _read_head(stream: IO[str], path: Path) -> _Head:
    place = "unknown"
    for number, raw in enumerate(stream, start=1):
        line = raw.strip()
        key, _, value = line.lstrip("# ").partition(":")
        if line.startswith("#") and key.strip().lower() == "place":
            place = value.strip().lower()
            if place not in _PLACES:
                raise InputError(f"'{place}' is not one of {', '.join(_PLACES)}",
                                 source=f"{path}, line {number}", field="place")  # fmt: skip
        if not line or line.startswith("#"):
            continue
        names = tuple(name.strip().lower() for name in line.split(","))
        missing = [name for name in REQUIRED if name not in names]
        if missing:
            raise InputError(
                f"lacks the column {missing[0]}; the header needs {','.join(REQUIRED)}",
                source=f"{path}, line {number}", field="header",
            )  # fmt: skip
        repeated = [name for name in names if name in COLUMNS and names.count(name) > 1]
        if repeated:
            raise InputError(f"column {repeated[0]} stands there twice; remove one",
                             source=f"{path}, line {number}", field="header")  # fmt: skip
        return _Head(names, place, number)
    raise InputError("holds no header; give a CSV table of a trajectory", source=str(path))


def _numbers(stream: IO[str], head: _Head, path: Path) -> Array:
    """Cells of the known columns, in the order of `COLUMNS`, NaN where missing; (n, 17)."""
    at = {name: i for i, name in enumerate(head.names) if name in COLUMNS}
    lines = stream.readlines()
    if not any(line.strip() and not line.startswith("#") for line in lines):
        raise InputError("holds no rows below its header", source=str(path))
    try:
        found = np.loadtxt(lines, delimiter=",", usecols=tuple(at.values()), ndmin=2)
    except (ValueError, IndexError):
        # Empty cells, or a fault: cell by cell, so that it can be named.
        found = np.array(list(_rows(lines, at, (path, head.lines + 1))), dtype=np.float64)
    out = unknown(len(found), len(COLUMNS))
    out[:, [COLUMNS.index(name) for name in at]] = found
    return out


def _rows(lines: list[str], at: dict[str, int], place: tuple[Path, int]) -> Iterable[list[float]]:
    for number, line in enumerate(lines, start=place[1]):
        if not line.strip() or line.startswith("#"):
            continue
        cells = line.split(",")
        if len(cells) <= max(at.values()):
            raise InputError(
                f"holds {len(cells)} cells, the header more; remove the line or mend it",
                source=f"{place[0]}, line {number}",
            )
        row = []
        for name, i in at.items():
            cell = cells[i].strip()
            try:
                row.append(float(cell) if cell else math.nan)
            except ValueError as error:
                raise InputError(
                    f"'{cell[:40]}' is not a number; write decimals with a point",
                    source=f"{place[0]}, line {number}", field=name,
                ) from error  # fmt: skip
        yield row


def _trajectory(table: Array, head: _Head, path: Path) -> TrajectoryLog:
    doubts = []
    infinite = np.isinf(table)
    if np.any(infinite):
        doubts.append(f"{np.sum(infinite)} infinite values are taken as missing")
        table = np.where(infinite, np.nan, table)
    keep = np.all(np.isfinite(table[:, :2]), axis=1)
    if not np.all(keep):
        doubts.append(f"{np.sum(~keep)} of {len(table)} rows have no time and are left out")
        table = table[keep]
    if not len(table):
        raise InputError("no row has a time", source=str(path), field="tow_s")
    _check_range(table, path)
    time = table[:, 0] * GPS_WEEK + table[:, 1]
    order = np.argsort(time, kind="stable")
    unique = np.concatenate([[True], np.diff(time[order]) > 0.0])
    if not (np.all(unique) and np.all(order == np.arange(len(order)))):
        doubts.append(
            f"rows were out of order or repeated: sorted, {np.sum(~unique)} repeated left out"
        )
        table, time = table[order][unique], time[order][unique]
    rpy, sigma = np.radians(table[:, 8:11]), np.radians(table[:, 14:17])
    covariance = unknown(len(table), 6, 6)
    covariance[:, :3, :3] = table[:, 11:14, None] ** 2 * np.eye(3)
    covariance[:, 3:, 3:] = covariance_theta_ned_from_rpy(rpy, sigma)
    if np.any(np.isfinite(covariance[:, :3, :3])) and np.any(np.isfinite(covariance[:, 3:, 3:])):
        # Sigmas in a table are stated for themselves: nothing couples place and angles.
        covariance[:, :3, 3:] = 0.0
        covariance[:, 3:, :3] = 0.0
    return TrajectoryLog(
        time=time, source=str(path), doubts=tuple(doubts), lat=np.radians(table[:, 2]),
        lon=np.radians(table[:, 3]), height=table[:, 4], v_ned=table[:, 5:8], rpy=rpy,
        covariance=covariance, position_of=head.place,
    )  # fmt: skip


def _check_range(table: Array, path: Path) -> None:
    for name, low, high in (
        ("tow_s", 0.0, GPS_WEEK), ("lat_deg", -90.0, 90.0), ("lon_deg", -180.0, 360.0),
        ("height_ellipsoidal_m", -1000.0, 100000.0), ("pitch_deg", -90.0, 90.0),
    ):  # fmt: skip
        values = table[:, COLUMNS.index(name)]
        wrong = (values < low) | (values > high)
        if np.any(wrong):
            raise InputError(
                f"{values[wrong][0]:g} lies outside {low:g} to {high:g}; check column and unit",
                source=str(path), field=name,
            )  # fmt: skip
