"""The log of the time-synchronisation board: `$TSB` lines, whatever stands between them."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.ingest.logs.text_table import read_bytes
from georef_gis.ingest.logs.text_times import resolve_week, unwrap_week
from georef_gis.ingest.tsb_line import TsbRecord, parse_tsb_line
from georef_gis.model.logs import EventLog, FlightLogs, TimeScale, unknown
from georef_gis.units import GPS_WEEK

# s; latency of the interrupt that stamps the shutter pulse on a microcontroller, assumed
_SIGMA = 1e-3
_NAMED = 5


def looks_like_tsb(head: bytes, path: Path) -> bool:
    """Whether the head of a file holds lines of the sync board."""
    del path
    return b"$TSB," in head


def read_tsb(path: Path, *, date: datetime | None = None) -> FlightLogs:
    """Events of a sync-board log, in the order of the file.

    Parameters
    ----------
    path
        File of `$TSB,seq,gps_week,tow_s,pulse_us,flags*CS` lines; garbage between them is passed.
    date
        An instant near the flight, for a week of ten bits.

    Raises
    ------
    InputError
        If the file is empty or holds no whole line.
    """
    records, damaged = _records(read_bytes(path))
    if not records:
        raise InputError(
            f"holds no whole $TSB line ({len(damaged)} damaged); check the baud rate and the "
            "wiring of the recorder",
            source=str(path),
        )
    doubts: list[str] = []
    if damaged:
        named = ", ".join(str(n) for n in damaged[:_NAMED]) + (", ..." if damaged[_NAMED:] else "")
        doubts.append(
            f"{len(damaged)} of {len(damaged) + len(records)} $TSB lines are damaged (line "
            f"{named}); left out: each is an exposure without a time"
        )
    timed = [r for r in records if r.has_gps_time]
    scale: TimeScale = "gps" if timed else "boot"
    if timed and len(timed) < len(records):
        lost = [str(r.seq) for r in records if not r.has_gps_time]
        doubts.append(
            f"{len(lost)} exposures came before the board had GPS time (sequence "
            f"{', '.join(lost[:_NAMED])}{', ...' if lost[_NAMED:] else ''}); left out"
        )
    if not timed:
        doubts.append("the board had no GPS time (flag 1 is not set): times count from power-up")
    log = _event_log(timed or records, scale, str(path), date, doubts)
    return FlightLogs(
        events=(log,), source=str(path), format="sync board ($TSB)", doubts=tuple(doubts)
    )


def _records(raw: bytes) -> tuple[list[TsbRecord], list[int]]:
    """Whole records, and the numbers of the lines that are damaged."""
    records: list[TsbRecord] = []
    damaged: list[int] = []
    for number, line in enumerate(raw.splitlines(), 1):
        if b"TSB" not in line:
            continue
        # A line that lost its end is followed by the next on the same line.
        for piece in re.split(rb"(?=\$TSB)", line):
            if b"TSB" not in piece:
                continue
            record = parse_tsb_line(piece)
            if record is None:
                damaged.append(number)
            else:
                records.append(record)
    return records, damaged


def _event_log(
    records: list[TsbRecord],
    scale: TimeScale,
    source: str,
    date: datetime | None,
    doubts: list[str],
) -> EventLog:
    week = np.array([float(r.gps_week) for r in records])
    tow = np.array([r.tow_s for r in records])
    if scale == "gps":
        week, turns = resolve_week(week, date)
        if turns:
            doubts.append(f"gps_week rolled over: {turns * 1024:+d} weeks; state date if wrong")
        time = unwrap_week(week * GPS_WEEK + tow)
    else:
        time = tow
    count = len(records)
    return EventLog(
        time=time,
        scale=scale,
        source=source,
        doubts=tuple(doubts),
        kind="sync_board",
        sequence=np.array([r.seq for r in records], dtype=np.int64),
        sigma=np.full(count, _SIGMA),
        lat=unknown(count),
        lon=unknown(count),
        height=unknown(count),
        position_of="unknown",
        covariance_ned=unknown(count, 3, 3),
        rpy=unknown(count, 3),
        names=("",) * count,
        flags=np.array([r.flags for r in records], dtype=np.int64),
    )
