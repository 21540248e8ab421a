"""u-blox UBX: fixes (NAV-PVT, NAV-COV) and time marks (TIM-TM2).

Source: u-blox F9 HPG 1.32 interface description (UBX-22008968): frames, payloads, flags.

NAV-PVT states one horizontal accuracy, which is that of the distance: hAcc^2 = sN^2 + sE^2. It is
split evenly: hAcc / sqrt(2) for north and for east. sAcc / sqrt(2) is taken for north, east and
down, on the safe side if it spans all three. NAV-COV is used instead where it has the epoch.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.gnss_values import (
    Mask,
    clean_gnss,
    day_of,
    gps_from_utc_days,
    gps_from_utc_seconds,
    load,
    symmetric,
    unroll,
)
from georef_gis.model.logs import (
    FIX_2D,
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_SINGLE,
    EventLog,
    FlightLogs,
    GnssLog,
    IntArray,
    TimeScale,
    covariance_of_sigmas,
    unknown,
)
from georef_gis.units import GPS_WEEK

Records = NDArray[np.void]

_SYNC = b"\xb5\x62"
_NAV_PVT, _NAV_COV, _TIM_TM2, _RXM_RAWX = (0x01, 0x07), (0x01, 0x36), (0x0D, 0x03), (0x02, 0x15)
_PVT = np.dtype([
    ("itow", "<u4"), ("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"),
    ("minute", "u1"), ("second", "u1"), ("valid", "u1"), ("t_acc", "<u4"), ("nano", "<i4"),
    ("fix_type", "u1"), ("flags", "u1"), ("flags2", "u1"), ("satellites", "u1"), ("lon", "<i4"),
    ("lat", "<i4"), ("height", "<i4"), ("height_msl", "<i4"), ("h_acc", "<u4"), ("v_acc", "<u4"),
    ("velocity", "<i4", (3,)), ("speed", "<i4"), ("heading", "<i4"), ("s_acc", "<u4"),
    ("heading_acc", "<u4"), ("pdop", "<u2"), ("flags3", "<u2"),
])  # fmt: skip
_COV = np.dtype([
    ("itow", "<u4"), ("version", "u1"), ("position_valid", "u1"), ("velocity_valid", "u1"),
    ("reserved", "V9"), ("position", "<f4", (6,)), ("velocity", "<f4", (6,)),
])  # fmt: skip
_TM2 = np.dtype([
    ("channel", "u1"), ("flags", "u1"), ("count", "<u2"), ("week_r", "<u2"), ("week_f", "<u2"),
    ("ms_r", "<u4"), ("ns_r", "<u4"), ("ms_f", "<u4"), ("ns_f", "<u4"), ("acc_ns", "<u4"),
])  # fmt: skip
_LAYOUTS = {_NAV_PVT: _PVT, _NAV_COV: _COV, _TIM_TM2: _TM2}
# Bits of TIM-TM2's flags.
_NEW_FALLING, _TIME_VALID, _NEW_RISING = 0x04, 0x40, 0x80
# GPS weeks that a 10-bit counter can tell apart
_ROLL = 1024
# s; UTC and time of week of one epoch agree to this, or the receiver's leap seconds are wrong
_ONE_EPOCH = 0.05
_NMEA = re.compile(rb"\$[A-Z]{2,}[^\r\n\xb5]*\r?\n")


@dataclass(slots=True, kw_only=True)
class _Frames:
    """Payloads by class and id, and what else lay in the file."""

    payloads: dict[tuple[int, int], list[bytes]] = field(default_factory=lambda: defaultdict(list))
    raw_epochs: int = 0
    good: int = 0
    damaged: list[int] = field(default_factory=list)
    cut_at: int | None = None
    outside: int = 0

    def records(self, kind: tuple[int, int]) -> Records:
        """Payloads of one kind as a structured array."""
        layout = _LAYOUTS[kind]
        size = layout.itemsize
        rows = b"".join(p[:size] for p in self.payloads[kind] if len(p) >= size)
        return np.frombuffer(rows, dtype=layout)


def looks_like_ubx(head: bytes, path: Path) -> bool:
    """Whether the first bytes hold a whole UBX frame with a right checksum."""
    del path
    return _split(head).good > 0


def read_ubx(path: Path) -> FlightLogs:
    """Fixes and time marks of a log of a u-blox receiver; other protocols in it are skipped.

    Returns
    -------
    logs
        `gnss` from NAV-PVT and NAV-COV; `events` from TIM-TM2, kind "feedback": one list per
        channel and edge, rising edges first. `sequence` is the receiver's counter of rising
        edges, which wraps at 65536; `flags` are TIM-TM2's. The epochs of raw measurements
        (RXM-RAWX) are counted in `format`.

    Raises
    ------
    InputError
        If it holds no UBX frame, or neither fixes nor marks nor raw measurements.
    """
    frames = _split(load(path))
    if not frames.good:
        raise InputError("holds no UBX frame with a right checksum", source=str(path))
    pvt, tm2 = frames.records(_NAV_PVT), frames.records(_TIM_TM2)
    if not len(pvt) and not len(tm2) and not frames.raw_epochs:
        raise InputError(
            "holds no NAV-PVT, TIM-TM2 or RXM-RAWX; switch these messages on in the receiver",
            source=str(path),
        )
    doubts = _frame_doubts(frames)
    if len(pvt) and not np.any(_fix(pvt)):
        doubts.append(f"none of its {len(pvt)} epochs has a fix")
        if not len(tm2) and not frames.raw_epochs:
            raise InputError(doubts[-1], source=str(path))
    gnss = _gnss(pvt, frames.records(_NAV_COV), str(path)) if len(pvt) else None
    week = None
    if gnss is not None and gnss.scale == "gps":
        week = int(np.median(gnss.time) // GPS_WEEK)
    events, words = _events(tm2, week, str(path))
    raw = f" with {frames.raw_epochs} epochs of raw measurements" if frames.raw_epochs else ""
    told = [d for log in (gnss, *events) if log is not None for d in log.doubts]
    return FlightLogs(
        gnss=gnss,
        events=events,
        source=str(path),
        format=f"UBX{raw}",
        doubts=tuple(dict.fromkeys([*doubts, *words, *told])),
    )


# ---------------------------------------------------------------------------------------------
# Frames
# ---------------------------------------------------------------------------------------------


def _split(data: bytes) -> _Frames:
    """Frames of a stream: sync, class, id, length, payload, checksum."""
    out = _Frames()
    at, end_of_last = 0, 0
    while (at := data.find(_SYNC, at)) >= 0:
        head = data[at + 2 : at + 6]
        size = int.from_bytes(head[2:4], "little")
        stop = at + 8 + size
        if len(head) < 4 or stop > len(data):
            # A damaged length looks like a frame that is cut: go on behind the sync.
            out.cut_at = at if out.cut_at is None else out.cut_at
            at += 2
            continue
        if _checksum(data[at + 2 : stop - 2]) != data[stop - 2 : stop]:
            out.damaged.append(at)
            at += 2
            continue
        kind = (head[0], head[1])
        if kind in _LAYOUTS:
            out.payloads[kind].append(data[at + 6 : stop - 2])
        out.raw_epochs += kind == _RXM_RAWX
        out.good += 1
        if out.cut_at is not None:
            # What looked like the cut end was a damaged length: the stream goes on.
            out.damaged.append(out.cut_at)
            out.cut_at = None
        out.outside += _unexplained(data[end_of_last:at])
        at = end_of_last = stop
    out.outside += _unexplained(data[end_of_last:])
    return out


def _checksum(body: bytes) -> bytes:
    """Fletcher's 8-bit checksum: the sum, and the sum of the running sums, modulo 256."""
    values = np.frombuffer(body, dtype=np.uint8).astype(np.int64)
    a = int(values.sum())
    b = int(np.dot(values, np.arange(len(values), 0, -1)))
    return bytes((a & 0xFF, b & 0xFF))


def _unexplained(between: bytes) -> int:
    """Bytes that are neither UBX nor NMEA."""
    return len(_NMEA.sub(b"", between).strip(b"\0\r\n")) if between else 0


def _frame_doubts(frames: _Frames) -> list[str]:
    words = []
    if frames.damaged:
        words.append(
            f"{len(frames.damaged)} UBX frames are damaged (first at byte "
            f"{min(frames.damaged)}): left out"
        )
    if frames.cut_at is not None:
        words.append(f"its last frame is cut (at byte {frames.cut_at})")
    if frames.outside:
        words.append(f"{frames.outside} bytes are neither UBX nor NMEA: skipped")
    return words


# ---------------------------------------------------------------------------------------------
# Fixes
# ---------------------------------------------------------------------------------------------


def _gnss(pvt: Records, cov: Records, source: str) -> GnssLog | None:
    """Fixes, or None where the receiver had none at all: its time marks may still be of use."""
    fix = _fix(pvt)
    if not np.any(fix != FIX_NONE):
        return None
    time, scale, doubts = _time(pvt)
    lost = int(np.sum(fix == FIX_NONE))
    if lost:
        doubts.append(f"{lost} of {len(pvt)} epochs have no fix: left out")
    keep = np.flatnonzero(fix != FIX_NONE)
    pvt, time, fix = pvt[keep], time[keep], fix[keep]
    position, velocity = _covariances(pvt, cov)
    height = pvt["height"] * 1e-3
    return clean_gnss(
        GnssLog(
            time=time,
            scale=scale,
            source=source,
            doubts=tuple(doubts),
            lat=np.radians(pvt["lat"] * 1e-7),
            lon=np.radians(pvt["lon"] * 1e-7),
            height=height,
            height_kind=HeightKind.ELLIPSOIDAL,
            geoid_separation=height - pvt["height_msl"] * 1e-3,
            v_ned=pvt["velocity"] * 1e-3,
            covariance_ned=position,
            covariance_v_ned=velocity,
            fix=fix,
            satellites=pvt["satellites"].astype(np.int64),
        )
    )


def _fix(pvt: Records) -> IntArray:
    """Quality: dead reckoning alone, time only and fixes that the receiver rejects are none."""
    flags, kind = pvt["flags"], pvt["fix_type"]
    carrier = flags >> 6
    out = np.where((flags & 2) > 0, FIX_DGNSS, FIX_SINGLE)
    out = np.where(carrier == 1, FIX_FLOAT, np.where(carrier == 2, FIX_FIXED, out))
    out = np.where(kind == 2, FIX_2D, out)
    # Bit 0 of flags: within the receiver's limits. Bit 0 of flags3: place invalid.
    good = np.isin(kind, (2, 3, 4)) & ((flags & 1) > 0) & ((pvt["flags3"] & 1) == 0)
    return np.where(good, out, FIX_NONE).astype(np.int64)


def _time(pvt: Records) -> tuple[Array, TimeScale, list[str]]:
    """Times of the epochs, their scale, and doubts.

    Notes
    -----
    Date and time of day are rounded to the hundredth; `nano`, which may be negative, completes
    them to the instant of the fix. Time of week is whole milliseconds on the GPS scale, so it
    finds the week and holds where the receiver does not know the leap seconds yet.
    """
    tow = unroll(pvt["itow"] * 1e-3, GPS_WEEK)
    days = [day_of(int(r["year"]), int(r["month"]), int(r["day"])) for r in pvt]
    dated = ((pvt["valid"] & 3) == 3) & np.array([d is not None and d >= 0 for d in days])
    if not np.any(dated):
        return (
            tow,
            "boot",
            ["no epoch has a valid date: times are seconds of a GPS week that is not known"],
        )
    day = np.array([d if d is not None else 0 for d in days], dtype=np.int64)
    of_day = pvt["hour"] * 3600.0 + pvt["minute"] * 60.0 + pvt["second"] + pvt["nano"] * 1e-9
    utc = gps_from_utc_days(np.where(dated, day, 0), of_day)
    start = _week_start(utc, tow, dated)
    coarse = start + tow
    same = dated & (np.abs(utc - coarse) < _ONE_EPOCH)
    words = []
    if np.any(dated & ~same):
        words.append(
            f"{int(np.sum(dated & ~same))} epochs have a UTC that does not fit their time of week "
            "(leap seconds not known yet): time of week is used"
        )
    return np.where(same, utc, coarse), "gps", words


def _week_start(utc: Array, tow: Array, dated: Mask) -> Array:
    """Start of the unrolled time of week of every epoch, s on the GPS scale; undated: the next."""
    known = np.flatnonzero(dated)
    start = np.round((utc[known] - tow[known]) / GPS_WEEK) * GPS_WEEK
    following = np.clip(np.searchsorted(known, np.arange(len(utc))), 0, len(known) - 1)
    return np.asarray(start[following])


def _covariances(pvt: Records, cov: Records) -> tuple[Array, Array]:
    horizontal = pvt["h_acc"] * 1e-3 / np.sqrt(2.0)
    speed = pvt["s_acc"] * 1e-3 / np.sqrt(2.0)
    position = covariance_of_sigmas(np.column_stack([horizontal, horizontal, pvt["v_acc"] * 1e-3]))
    velocity = covariance_of_sigmas(np.column_stack([speed, speed, speed]))
    for valid, terms, out in (
        ("position_valid", "position", position),
        ("velocity_valid", "velocity", velocity),
    ):
        rows = cov[cov[valid] == 1]
        _, ours, theirs = np.intersect1d(pvt["itow"], rows["itow"], return_indices=True)
        nn, ne, nd, ee, ed, dd = rows[terms][theirs].astype(np.float64).T
        out[ours] = symmetric(np.column_stack([nn, ee, dd]), ne, ed, nd)
    return position, velocity


# ---------------------------------------------------------------------------------------------
# Time marks
# ---------------------------------------------------------------------------------------------


def _events(tm2: Records, week: int | None, source: str) -> tuple[tuple[EventLog, ...], list[str]]:
    """Marks by edge and channel, rising edges first, and doubts on the whole."""
    found: list[EventLog] = []
    for edge, bit, suffix in (("rising", _NEW_RISING, "r"), ("falling", _NEW_FALLING, "f")):
        for channel in np.unique(tm2["channel"]):
            rows = tm2[(tm2["channel"] == channel) & ((tm2["flags"] & bit) > 0)]
            log = _edge(rows, suffix, week, f"{source}, EXTINT{int(channel)}, {edge} edges")
            if log is not None:
                found.append(log)
    words = []
    if sum("rising" in log.source for log in found) and len(found) > 1:
        words.append(
            f"its time marks come in {len(found)} lists by input and edge; the first is that of "
            "rising edges: use falling ones if the camera pulls the line low"
        )
    lost = int(np.sum((tm2["flags"] & _TIME_VALID) == 0))
    if lost:
        words.append(f"{lost} of {len(tm2)} time marks have no valid time: left out")
    return tuple(found), words


def _edge(rows: Records, suffix: str, week: int | None, source: str) -> EventLog | None:
    marks = rows[(rows["flags"] & _TIME_VALID) > 0]
    if not len(marks):
        return None
    count = len(marks)
    time, doubts = _mark_times(marks, suffix, week)
    sequence = marks["count"].astype(np.int64)
    jumps = np.mod(np.diff(sequence), 1 << 16)
    missed = int(np.sum(jumps[jumps > 1] - 1))
    if missed:
        doubts.append(f"its counter jumps over {missed} time marks that the file does not hold")
    return EventLog(
        time=time,
        source=source,
        doubts=tuple(doubts),
        kind="feedback",
        sequence=sequence,
        sigma=marks["acc_ns"] * 1e-9,
        lat=unknown(count),
        lon=unknown(count),
        height=unknown(count),
        covariance_ned=unknown(count, 3, 3),
        rpy=unknown(count, 3),
        names=("",) * count,
        flags=marks["flags"].astype(np.int64),
    )


def _mark_times(marks: Records, suffix: str, week: int | None) -> tuple[Array, list[str]]:
    """Times of marks on the GPS scale and doubts; `week` is that of the fixes."""
    doubts: list[str] = []
    weeks = marks[f"week_{suffix}"].astype(np.int64)
    if week is not None:
        turns = np.round((week - weeks) / _ROLL).astype(np.int64)
        if np.any(turns):
            doubts.append(
                f"{int(np.sum(turns != 0))} time marks count weeks modulo {_ROLL}: completed from "
                "the fixes"
            )
        weeks = weeks + turns * _ROLL
    elif np.any(weeks < _ROLL):
        doubts.append(f"its weeks are below {_ROLL}, which ended in 1999: check the date")
    time = weeks * GPS_WEEK + marks[f"ms_{suffix}"] * 1e-3 + marks[f"ns_{suffix}"] * 1e-9
    base = (marks["flags"] >> 3) & 3
    if np.any(base == 0):
        doubts.append(
            f"{int(np.sum(base == 0))} time marks are on the receiver's own clock, which may be "
            "off by its bias (below 1 ms with a fix)"
        )
    if np.any(np.diff(time) < 0.0):
        doubts.append("its time marks are not in the order of time")
    # UTC as week and time of week: the calendar without leap seconds.
    return np.where(base == 2, gps_from_utc_seconds(time), time), doubts
