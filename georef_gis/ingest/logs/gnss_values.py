"""What the readers of GNSS files share: bytes, calendars, roll-overs, and rows that cannot be."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.logs import GnssLog, IntArray, TimedLog
from georef_gis.units import GPS_ZERO, gps_minus_utc

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]
Log = TypeVar("Log", bound=TimedLog)

# s
DAY = 86400.0
# m; no GNSS receiver of a flight is lower or higher
_LOWEST, _HIGHEST = -1000.0, 100_000.0
# s; two fixes nearer than this are one
_SAME = 1e-4
# A receiver with the week roll-over fault is 1024 weeks early: dates before this are suspect.
_SUSPECT_DATE = datetime(2007, 1, 1, tzinfo=UTC)


def load(path: Path) -> bytes:
    """Bytes of a file that holds something.

    Raises
    ------
    InputError
        If the file cannot be read or is empty.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    if not data.strip(b"\0\r\n\t "):
        raise InputError("is empty or holds zeros only; copy it again", source=str(path))
    return data


def day_of(year: int, month: int, day: int) -> int | None:
    """Days from 1980-01-06 to a date; None where the calendar has no such date."""
    try:
        return (datetime(year, month, day, tzinfo=UTC) - GPS_ZERO).days
    except ValueError:
        return None


def gps_from_utc_days(day: IntArray, second_of_day: Array) -> Array:
    """Seconds on the GPS scale of UTC days since 1980-01-06 and seconds of day; shapes (n,).

    Notes
    -----
    Leap seconds begin at the start of a UTC day, so `units` is asked once per day; an inserted
    second is 86400 .. 86401 of the day before.
    """
    days, where = np.unique(day, return_inverse=True)
    leap = [gps_minus_utc(GPS_ZERO + timedelta(days=int(d))) for d in days]
    return np.asarray(day * DAY + second_of_day + np.asarray(leap, dtype=np.float64)[where])


def gps_from_utc_seconds(utc: Array) -> Array:
    """Like `gps_from_utc_days`, from seconds of the UTC calendar since 1980-01-06; shape (n,)."""
    day = np.floor(utc / DAY).astype(np.int64)
    return gps_from_utc_days(day, utc - day * DAY)


def unroll(seconds: Array, period: float) -> Array:
    """Seconds that go on where a counter of a period (day, week) starts again; shape (n,)."""
    if len(seconds) < 2:
        return seconds.copy()
    step = np.diff(seconds)
    turns = np.cumsum((step < -period / 2).astype(float) - (step > period / 2).astype(float))
    return np.asarray(seconds + period * np.concatenate([[0.0], turns]))


def signed_square(value: Array) -> Array:
    """Covariance of a signed root: RTKLIB writes sign(c) sqrt(|c|)."""
    return np.asarray(value * np.abs(value))


def symmetric(diagonal: Array, xy: Array, yz: Array, xz: Array) -> Array:
    """Covariances (n, 3, 3) of diagonals (n, 3) and three off-diagonal terms (n,)."""
    out = np.empty((len(diagonal), 3, 3))
    for i in range(3):
        out[:, i, i] = diagonal[:, i]
    out[:, 0, 1] = out[:, 1, 0] = xy
    out[:, 1, 2] = out[:, 2, 1] = yz
    out[:, 0, 2] = out[:, 2, 0] = xz
    return out


def take(log: Log, rows: Rows) -> Log:
    """Rows of a log, in the order given."""
    changes: dict[str, Any] = {}
    for item in dataclasses.fields(log):
        value = getattr(log, item.name)
        if isinstance(value, np.ndarray):
            changes[item.name] = value[rows]
        elif item.name == "names":
            changes[item.name] = tuple(value[i] for i in rows)
    return dataclasses.replace(log, **changes)


def in_order(log: Log) -> tuple[Log, list[str]]:
    """Rows in the order of time, one per time, and what had to be done for it, in words."""
    if len(log) < 2 or np.all(np.diff(log.time) > _SAME):
        return log, []
    words = []
    back = int(np.sum(np.diff(log.time) < 0.0))
    if back:
        words.append(f"time goes back {back} times: rows are sorted by time")
    order = np.argsort(log.time, kind="stable")
    keep = np.concatenate([[True], np.diff(log.time[order]) > _SAME])
    if not np.all(keep):
        words.append(f"{int(np.sum(~keep))} rows repeat the time of another: left out")
    return take(log, order[keep]), words


def clean_gnss(log: GnssLog) -> GnssLog:
    """Fixes that can be: finite, on the Earth, in order of time; what was left out is in `doubts`.

    Raises
    ------
    InputError
        If no fix is left.
    """
    doubts = list(log.doubts)
    reasons = (
        ("have no finite time or place", _not_finite(log)),
        ("are placeholders at 0, 0 or outside of the Earth", _not_on_earth(log)),
    )
    bad = np.zeros(len(log), dtype=bool)
    for words, mask in reasons:
        new = mask & ~bad
        if np.any(new):
            doubts.append(f"{int(np.sum(new))} of {len(log)} fixes {words}: left out")
        bad |= new
    if np.all(bad):
        raise InputError(
            f"none of its {len(log)} epochs has a usable position; use a log with GNSS fixes",
            source=log.source,
        )
    kept, words_of_order = in_order(take(log, np.flatnonzero(~bad)))
    position, first = _sound(kept.covariance_ned, "positions")
    velocity, second = _sound(kept.covariance_v_ned, "velocities")
    return dataclasses.replace(
        kept,
        covariance_ned=position,
        covariance_v_ned=velocity,
        v_ned=np.where(np.isinf(kept.v_ned), np.nan, kept.v_ned),
        doubts=(*doubts, *words_of_order, *first, *second, *_date_doubts(kept)),
    )


def _not_finite(log: GnssLog) -> Mask:
    bad = ~(np.isfinite(log.time) & np.isfinite(log.lat) & np.isfinite(log.lon))
    no_height = ~np.isfinite(log.height)
    # A log without any height (RMC sentences only) is still a track.
    return np.asarray(bad | (no_height if not np.all(np.isnan(log.height)) else False))


def _not_on_earth(log: GnssLog) -> Mask:
    with np.errstate(invalid="ignore"):
        bad = (np.abs(log.lat) > np.pi / 2) | (np.abs(log.lon) > 2 * np.pi)
        bad |= (log.height < _LOWEST) | (log.height > _HIGHEST)
    # Receivers write exact zeros before their first fix.
    return np.asarray(bad | ((log.lat == 0.0) & (log.lon == 0.0)))


def _sound(covariance: Array, of: str) -> tuple[Array, list[str]]:
    """Covariances that a filter can use, NaN where none is, and what was wrong, in words."""
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        void = np.any((diagonal <= 0.0) | np.isinf(diagonal), axis=1)
    out, words = covariance, []
    if np.any(void):
        out = np.where(void[:, None, None], np.nan, out)
        words.append(f"{int(np.sum(void))} sigmas of {of} are zero or infinite: taken as unknown")
    full = np.all(np.isfinite(out), axis=(1, 2))
    loose = np.zeros(len(out), dtype=bool)
    if np.any(full):
        scale = np.sqrt(diagonal[full])
        correlation = out[full] / (scale[:, :, None] * scale[:, None, :])
        loose[full] = np.linalg.eigvalsh(correlation)[:, 0] < 0.0
    if np.any(loose):
        out = np.where(loose[:, None, None], out * np.eye(3), out)
        words.append(
            f"{int(np.sum(loose))} covariances of {of} are not positive (rounded in the file): "
            "their off-diagonal terms are left out"
        )
    return out, words


def _date_doubts(log: GnssLog) -> list[str]:
    if log.scale != "gps":
        return []
    limit = (_SUSPECT_DATE - GPS_ZERO).total_seconds()
    if log.time[0] >= limit:
        return []
    date = GPS_ZERO + timedelta(seconds=float(log.time[0]))
    return [
        f"its date is {date:%Y-%m-%d}: a receiver with the week roll-over fault is 1024 weeks "
        "(19.6 years) early; check the date of the flight"
    ]
