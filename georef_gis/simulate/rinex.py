"""RINEX files of simulated measurements: observations (3.03 or 2.11) and GPS navigation (3.03)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate.gnss_orbits import Ephemeris
from georef_gis.simulate.gnss_raw import RawLog

Array = NDArray[np.float64]

# The GPS scale, written like a date.
ZERO = datetime(1980, 1, 6)
TYPES_3 = (("C1C", "L1C", "D1C", "S1C"), ("C2W", "L2W", "D2W", "S2W"))
TYPES_2 = (("C1", "L1", "D1", "S1"), ("P2", "L2", "D2", "S2"))


def write_observations(
    file: Path,
    log: RawLog,
    *,
    version: str = "3.03",
    approximate: Array | None = None,
    antenna_height: float = 0.0,
    events: Sequence[float] = (),
) -> None:
    """Write what a receiver measured.

    Parameters
    ----------
    approximate
        Place of the marker for the header, ECEF m; None writes zeros, as a rover does.
    antenna_height
        Delta H of the header, m: of the antenna above the marker.
    events
        Times of marks, s since the start; epochs of flag 5.
    """
    place = np.zeros(3) if approximate is None else np.asarray(approximate)
    lines = _header(log, version, place, antenna_height)
    epoch = _epoch_3 if version.startswith("3") else _epoch_2
    rest = sorted(events)
    for i in range(len(log.tag)):
        while rest and rest[0] <= log.tag[i]:
            lines.append(_stamp(log.start_gps, rest.pop(0), version) + "  5  0")
        lines += epoch(log, i, version)
    file.write_text("\n".join(lines) + "\n", encoding="ascii")


def _label(text: str, label: str) -> str:
    return f"{text:<60.60}{label:<20}".rstrip()


def _header(log: RawLog, version: str, place: Array, antenna_height: float) -> list[str]:
    bands = log.code.shape[2]
    first = ZERO + timedelta(seconds=log.start_gps + float(log.tag[0]))
    lines = [
        _label(f"{version:>9}           OBSERVATION DATA    G: GPS", "RINEX VERSION / TYPE"),
        _label("SIMULATED", "PGM / RUN BY / DATE"),
        _label("SIMULATED", "MARKER NAME"),
        _label("", "OBSERVER / AGENCY"),
        _label("", "REC # / TYPE / VERS"),
        _label("", "ANT # / TYPE"),
        _label("".join(f"{v:14.4f}" for v in place), "APPROX POSITION XYZ"),
        _label(f"{antenna_height:14.4f}{0:14.4f}{0:14.4f}", "ANTENNA: DELTA H/E/N"),
    ]
    types = [t for band in (TYPES_3 if version[0] == "3" else TYPES_2)[:bands] for t in band]
    if version[0] == "3":
        names = "".join(f" {t}" for t in types)
        lines.append(_label(f"G  {len(types):3d}{names}", "SYS / # / OBS TYPES"))
    else:
        lines.append(_label("     1     1", "WAVELENGTH FACT L1/2"))
        names = "".join(f"    {t}" for t in types)
        lines.append(_label(f"{len(types):6d}{names}", "# / TYPES OF OBSERV"))
    start = f"{first.year:6d}{first.month:6d}{first.day:6d}{first.hour:6d}{first.minute:6d}"
    seconds = first.second + first.microsecond * 1e-6
    lines.append(_label(f"{start}{seconds:13.7f}     GPS", "TIME OF FIRST OBS"))
    lines.append(_label("", "END OF HEADER"))
    return lines


def _stamp(start_gps: float, tag: float, version: str) -> str:
    """Date and time of an epoch line, to 0.1 us."""
    whole = math.floor(start_gps + tag)
    # The start has whole seconds or tenths: the fraction keeps its digits.
    fraction = round((start_gps - math.floor(start_gps)) + tag - (whole - math.floor(start_gps)), 7)
    day = ZERO + timedelta(seconds=whole)
    seconds = day.second + fraction
    if version[0] == "3":
        return (
            f"> {day.year:4d} {day.month:02d} {day.day:02d} {day.hour:02d} "
            f"{day.minute:02d}{seconds:11.7f}"
        )
    return (
        f" {day.year % 100:02d} {day.month:2d} {day.day:2d} {day.hour:2d} "
        f"{day.minute:2d}{seconds:11.7f}"
    )


def _seen(log: RawLog, i: int) -> list[int]:
    return [int(k) for k in np.flatnonzero(np.isfinite(log.code[i, :, 0]))]


def _fields(log: RawLog, i: int, k: int) -> list[str]:
    out = []
    for b in range(log.code.shape[2]):
        flag = "1" if log.lost[i, k, b] else " "
        strength = min(max(int(log.cn0[i, k, b] // 6), 1), 9)
        out.append(f"{log.code[i, k, b]:14.3f}  ")
        # The field holds ten digits before the point: a phase is reduced by whole 1e9 cycles.
        out.append(f"{math.fmod(log.phase[i, k, b], 1e9):14.3f}{flag}{strength}")
        out.append(f"{log.doppler[i, k, b]:14.3f}  ")
        out.append(f"{log.cn0[i, k, b]:14.3f}  ")
    return out


def _epoch_3(log: RawLog, i: int, version: str) -> list[str]:
    seen = _seen(log, i)
    lines = [f"{_stamp(log.start_gps, float(log.tag[i]), version)}  0{len(seen):3d}"]
    for k in seen:
        lines.append((f"G{log.prns[k]:02d}" + "".join(_fields(log, i, k))).rstrip())
    return lines


def _epoch_2(log: RawLog, i: int, version: str) -> list[str]:
    seen = _seen(log, i)
    names = [f"G{log.prns[k]:02d}" for k in seen]
    head = f"{_stamp(log.start_gps, float(log.tag[i]), version)}  0{len(seen):3d}"
    lines = [head + "".join(names[:12])]
    lines += [" " * 32 + "".join(names[n : n + 12]) for n in range(12, len(names), 12)]
    for k in seen:
        cells = _fields(log, i, k)
        lines += ["".join(cells[n : n + 5]).rstrip() for n in range(0, len(cells), 5)]
    return lines


def write_navigation(
    file: Path,
    ephemerides: Sequence[Ephemeris],
    *,
    klobuchar: tuple[Sequence[float], Sequence[float]] = (
        (1.1e-8, 1.5e-8, -6.0e-8, -6.0e-8),
        (9.0e4, 5.0e4, -1.3e5, -1.3e5),
    ),
) -> None:
    """Write broadcast elements of GPS satellites, with the ionosphere's eight coefficients."""
    lines = [
        _label("     3.03           NAVIGATION DATA     G: GPS", "RINEX VERSION / TYPE"),
        _label("SIMULATED", "PGM / RUN BY / DATE"),
    ]
    for name, values in zip(("GPSA", "GPSB"), klobuchar, strict=True):
        numbers = "".join(f"{v:12.4E}" for v in values)
        lines.append(_label(f"{name} {numbers}", "IONOSPHERIC CORR"))
    lines.append(_label("    15", "LEAP SECONDS"))
    lines.append(_label("", "END OF HEADER"))
    for eph in ephemerides:
        lines += _record(eph)
    file.write_text("\n".join(lines) + "\n", encoding="ascii")


def _record(eph: Ephemeris) -> list[str]:
    day = ZERO + timedelta(seconds=eph.toe)
    tow = eph.toe_tow
    rows = (
        (eph.iode, eph.crs, eph.delta_n, eph.m0),
        (eph.cuc, eph.e, eph.cus, eph.sqrt_a),
        (tow, eph.cic, eph.omega0, eph.cis),
        (eph.i0, eph.crc, eph.omega, eph.omega_dot),
        (eph.idot, 1.0, eph.week, 0.0),
        (2.0, 0.0, eph.tgd, eph.iode),
        (tow - 3600.0 if tow >= 3600.0 else tow, 4.0),
    )
    first = (
        f"G{eph.prn:02d} {day.year:4d} {day.month:02d} {day.day:02d} {day.hour:02d} "
        f"{day.minute:02d} {day.second:02d}"
    )
    lines = [first + "".join(_number(v) for v in (eph.af0, eph.af1, eph.af2))]
    return lines + ["    " + "".join(_number(v) for v in row) for row in rows]


def _number(value: float) -> str:
    return f"{value:19.12E}"
