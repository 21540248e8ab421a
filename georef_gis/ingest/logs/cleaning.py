"""From logs as read to logs that can be navigated by: what cannot be is left out and named.

Pure functions on values. Every change and every doubt is one line in the log's `doubts`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array
from georef_gis.ingest.logs import sensor_checks, stamps
from georef_gis.model.logs import (
    FIX_2D,
    FIX_NONE,
    AidLog,
    AttitudeLog,
    EventLog,
    FlightLogs,
    GnssLog,
    ImuLog,
    TimedLog,
)
from georef_gis.units import GPS_WEEK, gps_from_utc, utc_from_gps, week_from_gps

Log = TypeVar("Log", bound=TimedLog)
Mask = NDArray[np.bool_]

# s: gaps from which they are named
_IMU_GAP, _GNSS_GAP = 0.1, 3.0
# weeks after which the GPS week of old receivers starts anew
_ROLL_OVER = 1024
# No UAV log of interest is older: an earlier date has rolled over (19.6 years early).
_FIRST_DATE = (2007, 1, 1)
# m/s: faster, two fixes cannot agree in all digits
_MOVING = 1.0
# m: a first fix this far from the next is the receiver's default place
_PLACEHOLDER_JUMP = 1000.0
# m; no receiver of a flight is lower or higher
_LOWEST, _HIGHEST = -1000.0, 100_000.0
# m, mean Earth radius, for distances that need no accuracy
_EARTH = 6_371_000.0
# m/s2 and rad/s: lower values at the end of the scale are no saturation of any sensor
_FULL_ACCEL, _FULL_GYRO = 15.0, 1.2


def clean_logs(logs: FlightLogs) -> FlightLogs:
    """Sound rows of every log, in order, with all that was found in words.

    Raises
    ------
    InputError
        If the IMU cannot be used: units or axes that no flight explains.
    NavigationError
        If IMU and GNSS have no time in common.
    """
    logs = _on_one_calendar(logs)
    gnss = None if logs.gnss is None else _gnss(logs.gnss)
    imu = None if logs.imu is None else _imu(logs.imu)
    attitude = None if logs.attitude is None else _attitude(logs.attitude, gnss)
    cleaned = replace(
        logs,
        imu=imu,
        gnss=gnss,
        attitude=attitude,
        events=tuple(_events(log) for log in logs.events),
        aids=tuple(_aid(log) for log in logs.aids),
    )
    _check_not_empty(logs, cleaned)
    doubts = [*_overlap(cleaned)]
    for finding in sensor_checks.check_sensors(cleaned):
        if finding.severity == "error":
            source = "" if imu is None else imu.source or logs.source
            raise InputError(finding.message, source=source, field="imu")
        doubts.append(finding.message)
    return replace(cleaned, doubts=(*cleaned.doubts, *doubts))


def _check_not_empty(before: FlightLogs, after: FlightLogs) -> None:
    for name, old, new in (
        ("imu", before.imu, after.imu),
        ("gnss", before.gnss, after.gnss),
    ):
        if old is not None and new is not None and len(old) > 0 and len(new) == 0:
            raise InputError(
                f"none of the {len(old)} rows can be used ({'; '.join(new.doubts[-2:])}); check "
                "that the log is of a flight and its columns are read right",
                source=new.source or before.source,
                field=name,
            )


# --- calendar ---------------------------------------------------------------------------------


def _parts(logs: FlightLogs) -> list[TimedLog]:
    single = (logs.imu, logs.gnss, logs.attitude, logs.trajectory)
    return [log for log in (*single, *logs.events, *logs.aids) if log is not None]


def _on_one_calendar(logs: FlightLogs) -> FlightLogs:
    """Missing weeks taken from the other logs, rolled-over weeks set right."""
    middles = [
        _middle(log) for log in _parts(logs) if log.scale == "gps" and _middle(log) >= 2 * GPS_WEEK
    ]
    others = float(np.median(middles)) if middles else None

    def dated(log: Log) -> Log:
        return _dated(log, others)

    def maybe(log: Log | None) -> Log | None:
        return None if log is None else _dated(log, others)

    return replace(
        logs,
        imu=maybe(logs.imu),
        gnss=maybe(logs.gnss),
        attitude=maybe(logs.attitude),
        trajectory=maybe(logs.trajectory),
        events=tuple(dated(log) for log in logs.events),
        aids=tuple(dated(log) for log in logs.aids),
    )


def _middle(log: TimedLog) -> float:
    finite = log.time[np.isfinite(log.time)]
    return float(np.median(finite)) if len(finite) else math.nan


def _dated(log: Log, others: float | None) -> Log:
    from datetime import UTC, datetime

    middle = _middle(log)
    if log.scale != "gps" or not math.isfinite(middle):
        return log
    doubt = ""
    add = 0.0
    if -GPS_WEEK < middle < 2 * GPS_WEEK:
        if others is None:
            doubt = "the GPS week is missing (date of 1980): times are seconds of an unknown week"
            return replace(log, doubts=(*log.doubts, doubt))
        # the nearest, not the same: a flight may straddle the turn of the week
        add = round((others - middle) / GPS_WEEK) * GPS_WEEK
        week = week_from_gps(middle + add)[0]
        doubt = f"the GPS week is missing (date of 1980): week {week} by the other logs is taken"
    first = gps_from_utc(datetime(*_FIRST_DATE, tzinfo=UTC))
    if middle + add < first:
        rolls = math.ceil((first - middle - add) / (_ROLL_OVER * GPS_WEEK))
        add += rolls * _ROLL_OVER * GPS_WEEK
        doubt = "; ".join(
            filter(None, (doubt, f"date before {_FIRST_DATE[0]}: 1024-week roll-over set right"))
        )
    if add == 0.0:
        return log
    return replace(log, time=log.time + add, doubts=(*log.doubts, doubt))


# --- the logs one by one ----------------------------------------------------------------------


def _finite(values: Array) -> Mask:
    """Rows without NaN and infinity."""
    return np.asarray(np.isfinite(values if values.ndim > 1 else values[:, None]).all(axis=1))


def _imu(log: ImuLog) -> ImuLog:
    sound = _finite(log.gyro) & _finite(log.accel)
    log = stamps.keep(log, sound, "NaN or infinite IMU values")
    dead = ~(np.any(log.gyro, axis=1) | np.any(log.accel, axis=1))
    log = stamps.keep(log, ~dead, "all six IMU values are exactly zero")
    log = stamps.of_one_clock(log)
    log = stamps.without_repeats(log, log.gyro, log.accel)
    log = stamps.rising(stamps.steady_in_file_order(log))
    log = stamps.named_gaps(log, _IMU_GAP)
    return replace(log, doubts=(*log.doubts, *_saturation(log)))


def _saturation(log: ImuLog) -> list[str]:
    """Runs of three or more samples at the end of an axis' range while the other axes move."""
    out = []
    for name, values, least in (("accel", log.accel, _FULL_ACCEL), ("gyro", log.gyro, _FULL_GYRO)):
        for axis in range(3):
            rows = _flat_at_extreme(values[:, axis], least, np.hstack([log.gyro, log.accel]))
            if len(rows):
                out.append(
                    f"{name} {'xyz'[axis]} saturates at {abs(values[rows[0], axis]):.2f} "
                    f"{'m/s2' if name == 'accel' else 'rad/s'}: {len(rows)} samples, first "
                    f"{stamps.place(log.time, int(rows[0]))}, last "
                    f"{stamps.place(log.time, int(rows[-1]))}; attitude and position are doubtful "
                    "from there on"
                )
    return out


def _flat_at_extreme(values: Array, least: float, all_axes: Array) -> NDArray[np.intp]:
    if len(values) < 10:
        return np.zeros(0, dtype=np.intp)
    found = []
    for end in (float(np.max(values)), float(np.min(values))):
        if abs(end) < least:
            continue
        rows = np.flatnonzero(np.abs(values - end) <= 1e-6 * abs(end))
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            # a logger that repeats whole samples makes flat runs without saturation
            if len(np.unique(all_axes[run], axis=0)) >= 3:
                found.append(run)
    return np.sort(np.concatenate(found)) if found else np.zeros(0, dtype=np.intp)


def _gnss(log: GnssLog) -> GnssLog:
    log = stamps.keep(log, log.fix > FIX_NONE, "no fix")
    place = np.isfinite(log.lat) & np.isfinite(log.lon)
    log = stamps.keep(log, place, "no position")
    somewhere = (np.abs(log.lat) > 1e-9) | (np.abs(log.lon) > 1e-9)
    log = stamps.keep(log, somewhere, "position 0, 0 (placeholder)")
    with np.errstate(invalid="ignore"):
        possible = (np.abs(log.lat) <= math.pi / 2) & (np.abs(log.lon) <= 2 * math.pi)
        possible &= ~((log.height < _LOWEST) | (log.height > _HIGHEST) | np.isinf(log.height))
    log = stamps.keep(log, possible, "impossible position")
    log = stamps.keep(log, ~_default_place(log), "constant position before the first fix")
    log = stamps.in_order(log)
    log = stamps.without_repeats(log, log.lat, log.lon, log.height)
    log = stamps.rising(log)
    log = stamps.keep(log, ~_held(log), "fix of the row before, repeated while moving")
    log = replace(
        log,
        lon=np.asarray((log.lon + math.pi) % (2 * math.pi) - math.pi),
        v_ned=np.where(np.isfinite(log.v_ned), log.v_ned, np.nan),
        covariance_ned=_sound(log.covariance_ned),
        covariance_v_ned=_sound(log.covariance_v_ned),
    )
    flat = int(np.sum(log.fix == FIX_2D))
    doubts = (f"{flat} fix(es) are 2D only: their height is not measured",) if flat else ()
    return stamps.named_gaps(replace(log, doubts=(*log.doubts, *doubts)), _GNSS_GAP)


def _sound(covariance: Array) -> Array:
    """Covariances with NaN in place of those that are no covariance: zero, negative, infinite."""
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        good = _finite(diagonal) & np.asarray((diagonal > 0.0).all(axis=1))
    return np.where(good[:, None, None], covariance, np.nan)


def _default_place(log: GnssLog) -> Mask:
    """Rows before the first fix at one exact place, far from where the log then goes on."""
    out = np.zeros(len(log), dtype=bool)
    if len(log) < 2:
        return out
    moved = np.flatnonzero((log.lat != log.lat[0]) | (log.lon != log.lon[0]))
    if not len(moved):
        return out
    first = int(moved[0])
    if _distance(log, 0, first) > _PLACEHOLDER_JUMP and first < len(log) / 2 + 1:
        out[:first] = True
    return out


def _distance(log: GnssLog, a: int, b: int) -> float:
    east = (log.lon[b] - log.lon[a] + math.pi) % (2 * math.pi) - math.pi
    return _EARTH * math.hypot(log.lat[b] - log.lat[a], east * math.cos(log.lat[a]))


def _held(log: GnssLog) -> Mask:
    """Rows that repeat place and velocity of the row before although the receiver moves.

    At rest equal rows are rightful; in motion a logger faster than its receiver wrote them.
    """
    out = np.zeros(len(log), dtype=bool)
    if len(log) < 3:
        return out
    values = np.column_stack([log.lat, log.lon, log.height, log.v_ned])
    equal = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    out[1:] = equal.all(axis=1)
    fresh = np.flatnonzero(~out)
    ends = np.append(fresh[1:], fresh[-1])
    for row, end in zip(fresh, ends, strict=True):
        if end - row < 2:
            continue
        way = _distance(log, int(row), int(end))
        if way < _MOVING * (log.time[end] - log.time[row]):
            out[row:end] = False
    # nothing comes after the last run: only its own velocity says whether it moves
    last = log.v_ned[fresh[-1]]
    if not float(np.hypot(last[0], last[1])) > _MOVING:
        out[fresh[-1] :] = False
    return out


def _attitude(log: AttitudeLog, gnss: GnssLog | None) -> AttitudeLog:
    log = stamps.keep(log, _finite(log.rpy), "NaN or infinite angles")
    log = stamps.in_order(log)
    log = stamps.rising(stamps.without_repeats(log, log.rpy))
    if not len(log):
        return log
    factor, doubt = sensor_checks.unit_of_angles(log, gnss)
    doubts = (doubt,) if doubt else ()
    rpy = log.rpy * factor
    beyond = np.abs(rpy[:, 1]) > math.pi / 2 + 0.02
    # unwrapped yaw is rightful, and one direction is one number from here on
    rpy = np.asarray((rpy + math.pi) % (2 * math.pi) - math.pi)
    log = replace(log, rpy=rpy, doubts=(*log.doubts, *doubts))
    return stamps.keep(log, ~beyond, "pitch beyond 90 deg")


def _events(log: EventLog) -> EventLog:
    """Exposures keep the order noted, which is what photos are matched by."""
    log = stamps.with_time(log)
    step = np.diff(log.time)
    doubts = []
    if np.any(step < 0.0):
        first = int(np.argmax(step < 0.0))
        doubts.append(
            f"{np.sum(step < 0.0)} exposure(s) are noted after later ones, first at row {first + 2}"
        )
    if np.any(step == 0.0):
        first = int(np.argmax(step == 0.0))
        doubts.append(
            f"{np.sum(step == 0.0)} exposure(s) repeat the time before, first at row {first + 2}"
        )
    return replace(log, doubts=(*log.doubts, *doubts))


def _aid(log: AidLog) -> AidLog:
    log = stamps.keep(log, _finite(log.value), "NaN or infinite values")
    return stamps.rising(stamps.without_repeats(stamps.in_order(log), log.value))


# --- together ---------------------------------------------------------------------------------


def _overlap(logs: FlightLogs) -> list[str]:
    """IMU and GNSS must share time; a small share is named."""
    imu, gnss = logs.imu, logs.gnss
    if imu is None or gnss is None or not len(imu) or not len(gnss):
        return []
    if imu.scale != gnss.scale:
        return [
            f"IMU is on {_scale(imu)}, GNSS on {_scale(gnss)}: they need a common clock before "
            "they can be used together"
        ]
    start, end = max(imu.time[0], gnss.time[0]), min(imu.time[-1], gnss.time[-1])
    if end < start:
        raise NavigationError(
            f"{logs.source or imu.source or 'logs'}: IMU ({_span(imu)}) and GNSS "
            f"({_span(gnss)}) have no time in common; give logs of one flight, or correct the "
            "week or leap seconds of one"
        )
    common = float(end - start)
    least = float(min(np.ptp(imu.time), np.ptp(gnss.time)))
    if common < 0.5 * least:
        return [f"IMU ({_span(imu)}) and GNSS ({_span(gnss)}) have only {common:.1f} s in common"]
    return []


def _scale(log: TimedLog) -> str:
    return "GPS time" if log.scale == "gps" else "seconds since boot"


def _span(log: TimedLog) -> str:
    first, last = float(log.time[0]), float(log.time[-1])
    if log.scale == "gps" and first > 2 * GPS_WEEK:
        words = [f"{utc_from_gps(t):%Y-%m-%d %H:%M:%S}" for t in (first, last)]
        return f"{words[0]} to {words[1]} UTC"
    return f"{first:.1f} to {last:.1f} s"
