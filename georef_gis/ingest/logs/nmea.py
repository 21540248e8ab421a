"""NMEA 0183: GGA, RMC, VTG, ZDA and GST of any talker, joined by epoch.

Source: NMEA 0183 version 4.10 (fields, quality and mode indicators, checksum). Times are UTC and
become GPS seconds. Velocities are horizontal (speed and course); down is NaN. VTG has no time: it
belongs to the sentence before it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.ingest.logs.gnss_values import (
    DAY,
    clean_gnss,
    gps_from_utc_days,
    load,
    symmetric,
)
from georef_gis.ingest.logs.nmea_cells import (
    angle,
    date_of,
    integer,
    number,
    second_of_day,
    text_of,
)
from georef_gis.model.logs import (
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_PPP,
    FIX_SINGLE,
    FlightLogs,
    GnssLog,
    IntArray,
    TimeScale,
    unknown,
)

# m/s; exact: 1852 m per hour
_KNOT = 1852.0 / 3600.0
# Quality of GGA: 6 (dead reckoning) and 7 (typed in) are no fixes; 9 is SBAS on some receivers.
_FIX_OF_GGA = {
    "1": FIX_SINGLE, "2": FIX_DGNSS, "3": FIX_SINGLE, "4": FIX_FIXED, "5": FIX_FLOAT,
    "8": FIX_SINGLE, "9": FIX_DGNSS,
}  # fmt: skip
_FIX_OF_MODE = {
    "": FIX_SINGLE, "A": FIX_SINGLE, "D": FIX_DGNSS, "P": FIX_PPP, "R": FIX_FIXED, "F": FIX_FLOAT,
    "S": FIX_SINGLE,
}  # fmt: skip
_SENTENCE = re.compile(rb"\$([A-Za-z0-9]{3,}),([^\r\n$*]*)(?:\*([0-9A-Fa-f]{2}))?([^\r\n$]*)")
_READ = frozenset({"GGA", "RMC", "VTG", "ZDA", "GST"})
# s of an epoch; sentences of one epoch agree to this
_SAME = 1e-3
# epochs whose sentences may come mixed
_LAST = 2
# m; a separation of zero where the geoid is farther from the ellipsoid than this is doubtful
_ZERO_SEPARATION = 5.0
# relative; the ellipse of GST is used if it gives back the sigmas of north and east so well
_ELLIPSE_FITS = 0.1


@dataclass(slots=True)
class _Epoch:
    """What the sentences of one instant say; None or NaN where none does."""

    roll: int
    of_day: float
    gga: Sequence[str] | None = None
    rmc: Sequence[str] | None = None
    vtg: Sequence[str] | None = None
    gst: Sequence[str] | None = None


@dataclass(slots=True)
class _Stream:
    """State while sentences are read in the order of the file."""

    epochs: list[_Epoch] = field(default_factory=list)
    roll: int = 0
    last: float | None = None
    # days from 1980-01-06 to the day on which `roll` was zero; None before the first date
    day_zero: int | None = None
    sentences: int = 0
    damaged: int = 0
    damaged_line: int = 0
    without_checksum: int = 0
    unreadable: int = 0


def looks_like_nmea(head: bytes, path: Path) -> bool:
    """Whether the first bytes hold a sentence of a GNSS receiver with a right checksum."""
    del path
    return any(
        m[3] and m[1][-3:] in {b"GGA", b"RMC", b"VTG", b"ZDA", b"GST", b"GSA", b"GSV", b"GLL"}
        and _checksum(head[m.start() + 1 : m.end(2)]) == int(m[3], 16)
        for m in _SENTENCE.finditer(head)
    )  # fmt: skip


def read_nmea(path: Path) -> FlightLogs:
    """Fixes of a log of NMEA sentences; other text between them is skipped.

    Returns
    -------
    logs
        `gnss` with orthometric heights and the receiver's geoid separation. Where no sentence
        has a date, times are seconds since the first midnight (UTC) on scale "boot".

    Raises
    ------
    InputError
        If it has no undamaged sentence with a position, or none with a fix.
    """
    stream = _read(load(path), str(path))
    rows = [epoch for epoch in stream.epochs if epoch.gga or epoch.rmc]
    if not rows:
        raise InputError(
            f"holds no usable GGA or RMC sentence ({stream.damaged} damaged); "
            "log at least GGA and RMC",
            source=str(path),
        )
    doubts = _doubts(stream)
    fix = np.array([_fix(epoch) for epoch in rows], dtype=np.int64)
    if not np.any(fix):
        raise InputError(f"none of its {len(rows)} epochs has a fix", source=str(path))
    if not np.all(fix):
        doubts.append(f"{int(np.sum(fix == FIX_NONE))} of {len(rows)} epochs have no fix: left out")
    rows, fix = [e for e, f in zip(rows, fix, strict=True) if f], fix[fix != FIX_NONE]
    gnss = _gnss(rows, fix, stream.day_zero, str(path), doubts)
    return FlightLogs(gnss=gnss, source=str(path), format="NMEA 0183", doubts=gnss.doubts)


def _gnss(
    rows: list[_Epoch], fix: IntArray, day_zero: int | None, source: str, doubts: list[str]
) -> GnssLog:
    """Fixes of epochs that have one."""
    time, scale = _times(rows, day_zero)
    if scale == "boot":
        doubts.append(
            "no sentence has a date: times are seconds since midnight (UTC); log RMC or ZDA"
        )
    if any(text_of(e.gga, 5) == "8" or text_of(e.rmc, 11) == "S" for e in rows):
        doubts.append("its fixes are those of a simulator")
    places = np.array([_place(epoch) for epoch in rows])
    velocity = np.array([_velocity(epoch) for epoch in rows])
    log = GnssLog(
        time=time,
        scale=scale,
        source=source,
        doubts=(*doubts, *_separation_doubts(places)),
        lat=np.radians(places[:, 0]),
        lon=np.radians(places[:, 1]),
        height=places[:, 2],
        height_kind=HeightKind.ORTHOMETRIC,
        geoid_separation=places[:, 3],
        v_ned=np.column_stack([velocity, unknown(len(rows))]),
        covariance_ned=_covariances(rows),
        covariance_v_ned=unknown(len(rows), 3, 3),
        fix=fix,
        satellites=np.array([integer(e.gga, 6) for e in rows], dtype=np.int64),
    )
    return clean_gnss(log)


# ---------------------------------------------------------------------------------------------
# Sentences and epochs
# ---------------------------------------------------------------------------------------------


def _checksum(body: bytes) -> int:
    return int(np.bitwise_xor.reduce(np.frombuffer(body, dtype=np.uint8)))


def _read(data: bytes, source: str) -> _Stream:
    stream = _Stream()
    bare: list[re.Match[bytes]] = []
    whole: list[re.Match[bytes]] = []
    damaged: list[int] = []
    for match in _SENTENCE.finditer(data):
        if match[3] is None:
            if match[1][-3:].decode().upper() in _READ:
                bare.append(match)
        elif _checksum(data[match.start() + 1 : match.end(2)]) != int(match[3], 16):
            damaged.append(match.start())
        else:
            whole.append(match)
    if not whole and bare:
        # A logger that strips every checksum: nothing is verified, which is said.
        whole, stream.without_checksum = bare, len(bare)
    else:
        damaged.extend(match.start() for match in bare)
    for match in whole:
        name = match[1].decode("ascii").upper()
        if name[-3:] in _READ and len(name) == 5:
            stream.sentences += 1
            _add(stream, name[-3:], match[2].decode("ascii", "replace").split(","))
    if damaged:
        stream.damaged, stream.damaged_line = len(damaged), data.count(b"\n", 0, min(damaged)) + 1
    if not stream.sentences:
        raise InputError(
            f"holds no whole GGA, RMC, VTG, ZDA or GST sentence ({stream.damaged} damaged)",
            source=source,
        )
    return stream


def _add(stream: _Stream, name: str, cells: list[str]) -> None:
    """Put a sentence to its epoch."""
    if name == "VTG":
        if stream.epochs:
            stream.epochs[-1].vtg = cells
        return
    of_day = second_of_day(cells[0])
    if of_day is None:
        # Receivers leave the time empty before they know it.
        stream.unreadable += bool(cells[0])
        return
    if stream.last is not None and abs(of_day - stream.last) > DAY / 2:
        stream.roll += 1 if of_day < stream.last else -1
    stream.last = of_day
    day = date_of(name, cells)
    if day is not None:
        _set_date(stream, day, of_day)
    epoch = _epoch(stream, of_day)
    if name == "GGA":
        epoch.gga = cells
    elif name == "RMC":
        epoch.rmc = cells
    elif name == "GST":
        epoch.gst = cells


def _epoch(stream: _Stream, of_day: float) -> _Epoch:
    """The epoch of a sentence: one of the last few, for a log may come by the same time again."""
    for epoch in reversed(stream.epochs[-_LAST:]):
        if epoch.roll == stream.roll and abs(epoch.of_day - of_day) < _SAME:
            return epoch
    stream.epochs.append(_Epoch(stream.roll, of_day))
    return stream.epochs[-1]


def _set_date(stream: _Stream, day: int, of_day: float) -> None:
    """Tie the count of days to the calendar; a date that does not fit begins another log."""
    if stream.day_zero is None:
        # Epochs before the first date belong to the same run of days.
        stream.day_zero = day - stream.roll
        return
    roll = day - stream.day_zero
    if roll == stream.roll:
        return
    last = stream.epochs[-1] if stream.epochs else None
    if last is not None and last.rmc is None and abs(last.of_day - of_day) < _SAME:
        # This epoch's GGA came before its date.
        last.roll = roll
    stream.roll = roll


def _times(rows: list[_Epoch], day_zero: int | None) -> tuple[Array, TimeScale]:
    """Seconds on the GPS scale, or since the first midnight where no sentence has a date."""
    of_day = np.array([epoch.of_day for epoch in rows])
    roll = np.array([epoch.roll for epoch in rows], dtype=np.int64)
    if day_zero is None:
        return roll * DAY + of_day, "boot"
    return gps_from_utc_days(roll + day_zero, of_day), "gps"


def _doubts(stream: _Stream) -> list[str]:
    words = []
    if stream.damaged:
        words.append(
            f"{stream.damaged} sentences are damaged or cut (first: line {stream.damaged_line}): "
            "left out"
        )
    if stream.without_checksum:
        words.append("its sentences have no checksums: damage cannot be seen")
    if stream.unreadable:
        words.append(f"{stream.unreadable} sentences have no readable time: left out")
    return words


def _separation_doubts(places: Array) -> list[str]:
    """A receiver that writes ellipsoidal heights for heights above the geoid."""
    ok = np.flatnonzero(np.all(np.isfinite(places), axis=1) & (np.abs(places[:, 0]) <= 90.0))
    if not len(ok) or np.any(places[ok, 3] != 0.0):
        return []
    lat, lon = np.radians(places[ok[0], :2])
    geoid = float(geoid_undulation(lat, lon))
    if abs(geoid) < _ZERO_SEPARATION:
        return []
    return [
        f"its geoid separation is 0 m throughout, where EGM96 has {geoid:.1f} m: its heights may "
        "be ellipsoidal"
    ]


# ---------------------------------------------------------------------------------------------
# Values of an epoch
# ---------------------------------------------------------------------------------------------


def _fix(epoch: _Epoch) -> int:
    if epoch.gga is not None:
        return _FIX_OF_GGA.get(text_of(epoch.gga, 5), FIX_NONE)
    if text_of(epoch.rmc, 1) != "A":
        return FIX_NONE
    return _FIX_OF_MODE.get(text_of(epoch.rmc, 11), FIX_NONE)


def _place(epoch: _Epoch) -> tuple[float, float, float, float]:
    """Latitude, longitude (deg), height above the geoid, geoid separation (m)."""
    if epoch.gga is None:
        return angle(epoch.rmc, 2, "NS"), angle(epoch.rmc, 4, "EW"), math.nan, math.nan
    cells = epoch.gga
    height = number(cells, 8) if text_of(cells, 9) == "M" else math.nan
    separation = number(cells, 10) if text_of(cells, 11) == "M" else math.nan
    return angle(cells, 1, "NS"), angle(cells, 3, "EW"), height, separation


def _velocity(epoch: _Epoch) -> tuple[float, float]:
    """North and east, m/s, from RMC or else VTG; NaN without a course (receivers at rest)."""
    speed, course = math.nan, math.nan
    if epoch.rmc is not None and text_of(epoch.rmc, 1) == "A":
        speed, course = number(epoch.rmc, 6) * _KNOT, number(epoch.rmc, 7)
    if not math.isfinite(speed) and epoch.vtg is not None:
        speed, course = number(epoch.vtg, 4) * _KNOT, number(epoch.vtg, 0)
        if not math.isfinite(speed):
            speed = number(epoch.vtg, 6) / 3.6
    if speed == 0.0:
        return 0.0, 0.0
    towards = math.radians(course)
    return speed * math.cos(towards), speed * math.sin(towards)


def _covariances(rows: list[_Epoch]) -> Array:
    """Of GST: sigmas of north, east, up, and the ellipse's term north-east; shape (n, 3, 3)."""
    cells = np.array([[number(epoch.gst, i) for i in range(2, 8)] for epoch in rows])
    major, minor, axis, north, east, up = cells.T
    variances = np.column_stack([north, east, up]) ** 2
    s, c = np.sin(np.radians(axis)), np.cos(np.radians(axis))
    with np.errstate(invalid="ignore", divide="ignore"):
        fits = np.ones(len(rows), dtype=bool)
        for variance, sigma in (
            ((major * c) ** 2 + (minor * s) ** 2, north),
            ((major * s) ** 2 + (minor * c) ** 2, east),
        ):
            fits &= np.abs(np.sqrt(variance) - sigma) <= _ELLIPSE_FITS * sigma
        cross = np.where(fits, (major**2 - minor**2) * s * c, 0.0)
    zero = np.where(np.isfinite(north), 0.0, np.nan)
    return symmetric(variances, np.where(np.isfinite(north), cross, np.nan), zero, zero)
