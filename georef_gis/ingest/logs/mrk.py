"""Time marks of DJI's RTK drones: `*_Timestamp.MRK`.

One line per exposure: counter, GPS time of week, [week], offset N, E, V (mm), latitude, longitude,
height, three sigmas (m), status. The letters behind a value say what it is: manuals list longitude
first, files have latitude first.

Place: DJI calls it "longitude / latitude after compensation" (Zenmuse P1 manual p. 24, Mavic 3M
p. 89, Matrice 4 p. 92), so it is the camera's, and the offset (antenna's phase centre to sensor:
north, east, down; Phantom 4 RTK white paper) must not be added again. The offset serves positions
of the antenna, that is PPK: `read_mrk_offsets`. `position_of="antenna"` reads a file whose
places were not compensated. Yuneec's PPKTimestamp has the offsets with the opposite sign
(community.emlid.com/t/42135).
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.gnss_values import load
from georef_gis.model.logs import (
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_SINGLE,
    EventLog,
    FlightLogs,
    IntArray,
    TimeScale,
    covariance_of_sigmas,
    unknown,
)
from georef_gis.units import GPS_WEEK

_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_LABELLED = re.compile(rf"(?<![\w.])({_NUMBER}|nan|[-+]?inf)\s*,\s*([A-Za-z]+)\b", re.IGNORECASE)
_WEEK = r"(?:\[\s*(\d+)\s*\]|(\d{3,4})(?=\s+[-+\d]))"
_START = re.compile(rf"^\s*(\d+)[\s,]+({_NUMBER})(?:[\s,]+{_WEEK})?")
# Three numbers without letters, at the end or before the status.
_SIGMAS = re.compile(
    rf"({_NUMBER})\s*,\s*({_NUMBER})\s*,\s*({_NUMBER})(?=[\s,]*(?:{_NUMBER}\s*,\s*Q)?\s*$)",
    re.IGNORECASE,
)
_LETTERS = ("n", "e", "v", "lat", "lon")
_FIXED = 50


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MrkOffsets:
    """Where the sensor was from the antenna's phase centre at each exposure.

    Parameters
    ----------
    sequence, time
        As in the `EventLog` of the same file.
    offset_ned : shape (n, 3), m
        Add it to a position of the antenna to get the camera's.
    """

    sequence: IntArray
    time: Array
    offset_ned: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class _Mark:
    sequence: int
    tow: float
    week: int | None
    # deg, deg, m
    place: tuple[float, float, float]
    height_letters: str
    # mm: north, east, down
    offset: tuple[float, float, float]
    # m: north, east, up
    sigmas: tuple[float, float, float]
    status: int


def looks_like_mrk(head: bytes, path: Path) -> bool:
    """Whether the first line is one of a file of time marks with letters behind its values."""
    del path
    line = next((x for x in head.decode("ascii", "replace").splitlines() if x.strip()), "")
    found = {m[2].lower() for m in _LABELLED.finditer(line)}
    return _START.match(line) is not None and set(_LETTERS) <= found


def fix_of_status(status: int) -> int:
    """Quality of a status: 16 single, 17 and 18 differential, 32 to 49 float, from 50 fixed.

    Notes
    -----
    DJI's SDK calls 48 and 49 integer solutions too; the manuals count them as float, which is
    on the safe side. Later firmware writes codes above 50 for fixed solutions.
    """
    if status < 16:
        return FIX_NONE
    if status < 32:
        return FIX_DGNSS if status in (17, 18) else FIX_SINGLE
    return FIX_FLOAT if status < _FIXED else FIX_FIXED


def read_mrk(
    path: Path,
    *,
    week: int | None = None,
    position_of: Literal["camera", "antenna"] = "camera",
) -> FlightLogs:
    """Exposures of a `.MRK` file, in its order; gaps in the counter stay.

    Parameters
    ----------
    path
        File with letters behind its values.
    week
        GPS week where the file has none.
    position_of
        What the places are of: the camera, as DJI documents, or the antenna.

    Returns
    -------
    logs
        One `EventLog` of kind "feedback"; `flags` holds the status (see `fix_of_status`). Without
        any week its times are seconds of week on scale "boot".

    Raises
    ------
    InputError
        If it is no such file or no line can be read.
    """
    marks, doubts = _read(path)
    time, scale, words = _times(marks, week)
    doubts += words
    places = np.array([mark.place for mark in marks])
    placeholder = np.all(places[:, :2] == 0.0, axis=1) | ~np.all(np.isfinite(places), axis=1)
    placeholder |= (np.abs(places[:, 0]) > 90.0) | (np.abs(places[:, 1]) > 360.0)
    if np.any(placeholder):
        doubts.append(f"{int(np.sum(placeholder))} of {len(marks)} exposures have no place")
    places[placeholder] = np.nan
    sigmas = np.array([mark.sigmas for mark in marks])
    sigmas[placeholder | ~np.all(np.isfinite(sigmas) & (sigmas > 0.0), axis=1)] = np.nan
    flags = np.array([mark.status for mark in marks], dtype=np.int64)
    events = EventLog(
        time=time,
        scale=scale,
        source=str(path),
        doubts=(*doubts, *_status_doubts(flags)),
        kind="feedback",
        sequence=np.array([mark.sequence for mark in marks], dtype=np.int64),
        sigma=unknown(len(marks)),
        lat=np.radians(places[:, 0]),
        lon=np.radians(places[:, 1]),
        height=places[:, 2],
        height_kind=_height_kind(marks),
        position_of=position_of,
        covariance_ned=covariance_of_sigmas(sigmas),
        rpy=unknown(len(marks), 3),
        names=("",) * len(marks),
        flags=flags,
    )
    return FlightLogs(events=(events,), source=str(path), format="DJI MRK", doubts=events.doubts)


def read_mrk_offsets(path: Path, *, week: int | None = None) -> MrkOffsets:
    """Offsets from the antenna to the sensor, for positions of the antenna (PPK).

    Raises
    ------
    InputError
        As `read_mrk`.
    """
    marks, _ = _read(path)
    time, _, _ = _times(marks, week)
    sign = -1.0 if _is_yuneec(path) else 1.0
    return MrkOffsets(
        sequence=np.array([mark.sequence for mark in marks], dtype=np.int64),
        time=time,
        offset_ned=sign * 1e-3 * np.array([mark.offset for mark in marks]),
    )


def _is_yuneec(path: Path) -> bool:
    return "ppktimestamp" in path.name.lower()


# ---------------------------------------------------------------------------------------------
# Lines
# ---------------------------------------------------------------------------------------------


def _read(path: Path) -> tuple[list[_Mark], list[str]]:
    lines = load(path).decode("utf-8", "replace").splitlines()
    marks: list[_Mark] = []
    bad: list[int] = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        mark = _mark(line)
        if mark is None:
            bad.append(number)
        else:
            marks.append(mark)
    if not marks:
        raise InputError(
            f"line {bad[0]} is no time mark of the form 'counter, time of week, [week], "
            "offset,N offset,E offset,V latitude,Lat longitude,Lon height,Ellh ...': without the "
            "letters latitude and longitude cannot be told apart",
            source=str(path),
        )
    doubts = []
    if bad:
        doubts.append(
            f"{len(bad)} of {len(bad) + len(marks)} lines cannot be read (first: line {bad[0]}): "
            "left out"
        )
    if _is_yuneec(path):
        doubts.append("offsets of a Yuneec file run from the sensor to the antenna: turned round")
    return marks, doubts


def _mark(line: str) -> _Mark | None:
    """Values of a line, or None where it is damaged."""
    start = _START.match(line)
    values = {m[2].lower(): float(m[1]) for m in _LABELLED.finditer(line)}
    tow = float(start[2]) if start else 0.0
    # A time of exactly zero is a line that the drone never filled.
    if start is None or not set(_LETTERS) <= set(values) or not 0.0 < tow < GPS_WEEK:
        return None
    sigmas = _SIGMAS.search(line)
    height = next((x for x in values if x not in {*_LETTERS, "q"}), "")
    week = start[3] or start[4]
    status = values.get("q", -1.0)
    return _Mark(
        sequence=int(start[1]),
        tow=tow,
        week=int(week) if week else None,
        place=(values["lat"], values["lon"], values.get(height, np.nan)),
        height_letters=height,
        offset=(values["n"], values["e"], values["v"]),
        sigmas=_three(sigmas) if sigmas else (np.nan, np.nan, np.nan),
        status=int(status) if np.isfinite(status) else -1,
    )


def _three(match: re.Match[str]) -> tuple[float, float, float]:
    return float(match[1]), float(match[2]), float(match[3])


def _times(marks: list[_Mark], week: int | None) -> tuple[Array, TimeScale, list[str]]:
    """Times of the marks, their scale, and doubts; an exposure without a week takes the others'."""
    tow = np.array([mark.tow for mark in marks])
    stated = [mark.week for mark in marks if mark.week]
    words = []
    scale: TimeScale = "gps"
    if stated:
        usual = Counter(stated).most_common(1)[0][0]
        weeks = np.array([mark.week or usual for mark in marks], dtype=np.float64)
        time = weeks * GPS_WEEK + tow
    elif week is not None:
        time = week * GPS_WEEK + _past_week_end(tow)
    else:
        time, scale = _past_week_end(tow), "boot"
        words.append("has no GPS week: times are seconds of week; give the week")
    back = int(np.sum(np.diff(time) <= 0.0))
    if back:
        words.append(f"time does not go on at {back} of its marks: two flights in one file?")
    return time, scale, words


def _past_week_end(tow: Array) -> Array:
    turns = np.cumsum(np.diff(tow, prepend=tow[:1]) < -GPS_WEEK / 2)
    return np.asarray(tow + GPS_WEEK * turns)


def _height_kind(marks: list[_Mark]) -> HeightKind:
    letters = {mark.height_letters for mark in marks}
    return HeightKind.ELLIPSOIDAL if letters == {"ellh"} else HeightKind.UNKNOWN


def _status_doubts(flags: IntArray) -> list[str]:
    loose = Counter(int(flag) for flag in flags if fix_of_status(int(flag)) < FIX_FIXED)
    if not loose:
        return []
    listed = ", ".join(f"status {flag}: {count}" for flag, count in sorted(loose.items()))
    return [f"{sum(loose.values())} of {len(flags)} exposures have no fixed solution ({listed})"]
