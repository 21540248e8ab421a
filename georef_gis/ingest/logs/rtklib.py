"""Solutions of RTKLIB: `.pos` (fixes of the antenna) and `_events.pos` (its place at time marks).

Sources: RTKLIB 2.4.3 manual, section B.1; `solution.c` (columns, signs of the standard deviations).
`sdne`, `sdeu`, `sdun` are signed roots of covariances in east, north, up.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array, R_ecef_from_ned
from georef_gis.geodesy import HeightKind, geo_from_ecef
from georef_gis.ingest.logs.gnss_values import (
    DAY,
    clean_gnss,
    day_of,
    gps_from_utc_seconds,
    load,
    signed_square,
    symmetric,
)
from georef_gis.model.logs import (
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_PPP,
    FIX_SINGLE,
    EventLog,
    FlightLogs,
    GnssLog,
    IntArray,
    unknown,
)
from georef_gis.units import GPS_WEEK

# Q of the manual: fix, float, SBAS, DGPS, single, PPP; 0 and 7 (dead reckoning) are no fix.
_FIX_OF_Q = {
    1: FIX_FIXED, 2: FIX_FLOAT, 3: FIX_DGNSS, 4: FIX_DGNSS, 5: FIX_SINGLE, 6: FIX_PPP,
}  # fmt: skip
_TIMES = re.compile(r"^%\s*(GPST|UTC|JST)\b")
_HOURS_OF_JST = 9.0
# Every name is that of the header without its unit: "latitude(deg)" -> "latitude".
_ECEF = ("x-ecef", "y-ecef", "z-ecef")
_COLUMN = re.compile(r"[^\s,;()]+(?:\([^)]*\))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    scale: str
    columns: tuple[str, ...]
    is_dms: bool
    is_ecef: bool
    height_kind: HeightKind
    doubts: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    """Numbers of the lines that could be read, by column, and their time on the GPS scale."""

    time: Array
    columns: Mapping[str, Array]
    decimals: int
    header: _Header
    doubts: tuple[str, ...]

    def three(self, names: tuple[str, str, str]) -> Array:
        """Three columns, NaN where the file has none; shape (n, 3)."""
        nan = unknown(len(self.time))
        return np.column_stack([self.columns.get(name, nan) for name in names])


def looks_like_rtklib(head: bytes, path: Path) -> bool:
    """Whether the first bytes are those of a solution of RTKLIB, events or not."""
    del path
    lines = head.decode("ascii", "replace").splitlines()
    return any(
        _TIMES.match(line) and re.search(r"latitude|x-ecef|e-baseline", line) for line in lines
    )


def looks_like_rtklib_events(head: bytes, path: Path) -> bool:
    """Whether it is RTKLIB's file of time marks: the name only tells it from a track."""
    return looks_like_rtklib(head, path) and path.stem.lower().endswith("_events")


def looks_like_rtklib_pos(head: bytes, path: Path) -> bool:
    """Whether it is a track of RTKLIB."""
    return looks_like_rtklib(head, path) and not looks_like_rtklib_events(head, path)


def read_rtklib_pos(path: Path) -> FlightLogs:
    """Fixes of the antenna from a `.pos` file.

    Parameters
    ----------
    path
        Solution in lat/lon/height (degrees or d m s) or x/y/z-ecef; any of RTKLIB's time formats.

    Returns
    -------
    logs
        `gnss` with full covariances where the file has them; velocities where it has them.

    Raises
    ------
    InputError
        If it is no such file, has a baseline for a position, or no line with a fix.
    """
    table = _read(path)
    geo, covariance, v_ned, covariance_v = _in_ned(table)
    q = _codes(table)
    fix = np.array([_FIX_OF_Q.get(int(code), FIX_NONE) for code in q], dtype=np.int64)
    satellites = table.columns.get("ns", unknown(len(q)))
    log = GnssLog(
        time=table.time,
        source=str(path),
        doubts=table.doubts,
        lat=np.where(fix == FIX_NONE, np.nan, geo[:, 0]),
        lon=geo[:, 1],
        height=geo[:, 2],
        height_kind=table.header.height_kind,
        geoid_separation=unknown(len(q)),
        v_ned=v_ned,
        covariance_ned=covariance,
        covariance_v_ned=covariance_v,
        fix=fix,
        satellites=np.where(np.isfinite(satellites), satellites, -1).astype(np.int64),
    )
    gnss = clean_gnss(log)
    return FlightLogs(gnss=gnss, source=str(path), format="RTKLIB .pos", doubts=gnss.doubts)


def read_rtklib_events(path: Path) -> FlightLogs:
    """Time marks with the antenna's place from an `_events.pos` file.

    Returns
    -------
    logs
        One `EventLog` of kind "feedback"; `flags` holds Q; `sigma` is that of the rounding of the
        time in the file, because RTKLIB states none.

    Raises
    ------
    InputError
        If it is no such file or holds no event.

    Notes
    -----
    RTKLIB writes at most one mark per interval of epochs (tomojitakasu/RTKLIB#597): marks in
    quick succession are missing, not late.
    """
    table = _read(path)
    geo, covariance, _, _ = _in_ned(table)
    count = len(table.time)
    q = _codes(table)
    no_place = ~np.all(np.isfinite(geo), axis=1) | ~np.isin(q, list(_FIX_OF_Q))
    doubts = list(table.doubts)
    if np.any(no_place):
        doubts.append(f"{int(np.sum(no_place))} of {count} events have no place, their times count")
    if np.any(np.diff(table.time) < 0.0):
        doubts.append("its events are not in the order of time")
    lat, lon, height = np.where(no_place[:, None], np.nan, geo).T
    events = EventLog(
        time=table.time,
        source=str(path),
        doubts=tuple(doubts),
        kind="feedback",
        sequence=np.full(count, -1, dtype=np.int64),
        sigma=np.full(count, 10.0**-table.decimals / np.sqrt(12.0)),
        lat=lat,
        lon=lon,
        height=height,
        height_kind=table.header.height_kind,
        position_of="antenna",
        covariance_ned=np.where(no_place[:, None, None], np.nan, covariance),
        rpy=unknown(count, 3),
        names=("",) * count,
        flags=q,
    )
    return FlightLogs(
        events=(events,), source=str(path), format="RTKLIB events", doubts=events.doubts
    )


# ---------------------------------------------------------------------------------------------
# Header and lines
# ---------------------------------------------------------------------------------------------


def _read(path: Path) -> _Table:
    lines = load(path).decode("utf-8", "replace").splitlines()
    header = _header(lines, str(path))
    times: list[float] = []
    rows: list[list[float]] = []
    bad: list[int] = []
    decimals: Counter[int] = Counter()
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("%"):
            continue
        try:
            time, cells, digits = _line(line, header)
        except ValueError:
            bad.append(number)
            continue
        times.append(time)
        rows.append(cells)
        decimals[digits] += 1
    if not rows:
        raise InputError("has no line with a solution", source=str(path))
    doubts = list(header.doubts)
    if bad:
        doubts.append(
            f"{len(bad)} of {len(bad) + len(rows)} lines cannot be read (first: line {bad[0]}): "
            "left out"
        )
    values = np.array(rows)
    time_gps = np.array(times)
    if header.scale != "GPST":
        shift = _HOURS_OF_JST * 3600.0 if header.scale == "JST" else 0.0
        time_gps = gps_from_utc_seconds(time_gps - shift)
    return _Table(
        time=time_gps,
        columns={name: values[:, i] for i, name in enumerate(header.columns)},
        decimals=decimals.most_common(1)[0][0],
        header=header,
        doubts=tuple(doubts),
    )


def _header(lines: list[str], source: str) -> _Header:
    heading = next((line for line in lines if _TIMES.match(line)), None)
    if heading is None:
        raise InputError(
            "has no header line with the columns and the time scale; write it with "
            "out-outhead = on",
            source=source,
        )
    notes = " ".join(line for line in lines if line.startswith("%")).lower()
    cells = _COLUMN.findall(heading.lstrip("% "))
    names = tuple(re.sub(r"\(.*", "", cell).lower() for cell in cells[1:])
    if "e-baseline" in names:
        raise InputError(
            "holds baselines (e/n/u), which are no positions; write it with "
            "out-solformat = llh or xyz",
            source=source,
            field="e-baseline",
        )
    if "=tokyo" in notes:
        raise InputError(
            "is in the Tokyo datum; write it with out-solformat in WGS84", source=source
        )
    if "sdun" not in names:
        # RTKLIB heads this column "sdue" where angles are in d m s.
        names = tuple("sdun" if name == "sdue" else name for name in names)
    is_ecef = set(_ECEF) <= set(names)
    if not is_ecef and not {"latitude", "longitude", "height"} <= set(names):
        raise InputError(
            f"has no latitude, longitude, height or x, y, z among its columns: {' '.join(names)}",
            source=source,
        )
    kind, doubts = _height_kind(notes, is_ecef=is_ecef)
    if re.search(r"pos mode\s*:\s*moving-base", notes):
        doubts = (*doubts, "its base moved: the sigmas are those of the baseline, not of the place")
    return _Header(
        scale=cells[0].upper(),
        columns=names,
        is_dms="latitude(d'" in heading.lower(),
        is_ecef=is_ecef,
        height_kind=kind,
        doubts=doubts,
    )


def _height_kind(notes: str, *, is_ecef: bool) -> tuple[HeightKind, tuple[str, ...]]:
    if is_ecef or "/ellipsoidal" in notes:
        return HeightKind.ELLIPSOIDAL, ()
    if "/geodetic" in notes:
        return HeightKind.ORTHOMETRIC, (
            "its heights are above a geoid that the header does not name; "
            "write it with out-height = ellipsoidal",
        )
    return HeightKind.ELLIPSOIDAL, (
        "its header does not say what heights are measured from: taken as ellipsoidal, which is "
        "RTKLIB's default",
    )


def _line(line: str, header: _Header) -> tuple[float, list[float], int]:
    """Seconds of the file's scale since 1980-01-06, one number per column, decimals of the time.

    Raises
    ------
    ValueError
        If the line is cut or damaged.
    """
    cells = re.split(r"[\s,;]+", line.strip(" \t,;\r"))
    if len(cells) < 3:
        raise ValueError("cut")
    seconds, digits = _time(cells)
    values = [float(cell) for cell in cells[2:]]
    if header.is_dms:
        values = [_degrees(values[:3]), _degrees(values[3:6]), *values[6:]]
    if len(values) < len(header.columns):
        raise ValueError("cut")
    return seconds, values[: len(header.columns)], digits


def _time(cells: list[str]) -> tuple[float, int]:
    first, second = cells[0], cells[1]
    digits = len(second.partition(".")[2])
    if "/" not in first:
        week, tow = int(first), float(second)
        if not (0 <= week < 10_000 and 0.0 <= tow < GPS_WEEK + 1.0):
            raise ValueError("no week and time of week")
        return week * GPS_WEEK + tow, digits
    year, month, day = (int(part) for part in first.split("/"))
    hour, minute, rest = second.split(":")
    days = day_of(year if year > 99 else 1900 + year + 100 * (year < 80), month, day)
    of_day = int(hour) * 3600.0 + int(minute) * 60.0 + float(rest)
    if days is None or not 0.0 <= of_day <= DAY + 1.0:
        raise ValueError("no date and time")
    return days * DAY + of_day, digits


def _degrees(parts: list[float]) -> float:
    degrees, minutes, seconds = parts
    if not (0.0 <= minutes < 60.0 and 0.0 <= seconds <= 60.0):
        raise ValueError("no degrees, minutes, seconds")
    # copysign: -0 degrees 30 minutes is south.
    return float(np.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees))


def _codes(table: _Table) -> IntArray:
    q = table.columns.get("q", unknown(len(table.time)))
    return np.where(np.isfinite(q), q, 0).astype(np.int64)


# ---------------------------------------------------------------------------------------------
# To north, east, down
# ---------------------------------------------------------------------------------------------


def _in_ned(table: _Table) -> tuple[Array, Array, Array, Array]:
    """Geo (n, 3) rad and m, position covariance, velocity, velocity covariance, all in ned."""
    if table.header.is_ecef:
        return _ned_from_ecef(table)
    geo = table.three(("latitude", "longitude", "height"))
    geo[:, :2] = np.radians(geo[:, :2])
    v_ned = table.three(("vn", "ve", "vu")) * [1.0, 1.0, -1.0]
    position = _neu(table, "sd{}")
    velocity = _neu(table, "sdv{}")
    return geo, position, v_ned, velocity


def _neu(table: _Table, pattern: str) -> Array:
    """Covariance in ned of RTKLIB's standard deviations in n, e, u; shape (n, 3, 3).

    The down axis is minus up: terms with one u change their sign.
    """
    n, e, u = (pattern.format(axis) for axis in "neu")
    ne, eu, un = (pattern.format(pair) for pair in ("ne", "eu", "un"))
    variances = table.three((n, e, u)) ** 2
    ne_c, eu_c, un_c = _off_diagonal(table, (ne, eu, un), variances).T
    return symmetric(variances, ne_c, -eu_c, -un_c)


def _off_diagonal(table: _Table, names: tuple[str, str, str], variances: Array) -> Array:
    """Signed covariances, zero where the file gives sigmas only; shape (n, 3)."""
    if not set(names) <= set(table.columns):
        return np.where(np.isfinite(variances), 0.0, np.nan)
    return signed_square(table.three(names))


def _ned_from_ecef(table: _Table) -> tuple[Array, Array, Array, Array]:
    geo = geo_from_ecef(table.three(_ECEF))
    ok = np.all(np.isfinite(geo), axis=1)
    R_ned_from_ecef = np.swapaxes(
        R_ecef_from_ned(np.where(ok, geo[:, 0], 0.0), np.where(ok, geo[:, 1], 0.0)), 1, 2
    )
    R_ecef_ned = np.swapaxes(R_ned_from_ecef, 1, 2)

    def turned(prefix: str) -> Array:
        variances = table.three((f"{prefix}x", f"{prefix}y", f"{prefix}z")) ** 2
        names = (f"{prefix}xy", f"{prefix}yz", f"{prefix}zx")
        xy, yz, zx = _off_diagonal(table, names, variances).T
        return np.asarray(R_ned_from_ecef @ symmetric(variances, xy, yz, zx) @ R_ecef_ned)

    v_ned = (R_ned_from_ecef @ table.three(("vx", "vy", "vz"))[:, :, None])[:, :, 0]
    return geo, turned("sd"), v_ned, turned("sdv")
