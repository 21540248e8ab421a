"""GNSS fixes of a text table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.column_names import TARGETS
from georef_gis.ingest.logs.column_units import Unit
from georef_gis.ingest.logs.quantities import Quantities
from georef_gis.ingest.logs.unit_telling import (
    tell_angle_unit,
    tell_course_unit,
    tell_speed_unit,
)
from georef_gis.model.logs import (
    FIX_2D,
    FIX_DGNSS,
    FIX_FIXED,
    FIX_FLOAT,
    FIX_NONE,
    FIX_PPP,
    FIX_SINGLE,
    GnssLog,
    IntArray,
    TimeScale,
    covariance_of_sigmas,
)

# What heights are called, the best first.
_HEIGHTS = (
    ("height_ellipsoidal", HeightKind.ELLIPSOIDAL),
    ("height_orthometric", HeightKind.ORTHOMETRIC),
    ("height", HeightKind.UNKNOWN),
    ("height_above_ground", HeightKind.ABOVE_GROUND),
)
# Quality of GGA, NMEA 0183; 3 (PPS) and 7, 8 (manual, simulated) are no better than single.
_NMEA = {0: FIX_NONE, 1: FIX_SINGLE, 2: FIX_DGNSS, 3: FIX_SINGLE, 4: FIX_FIXED, 5: FIX_FLOAT,
         6: FIX_NONE}  # fmt: skip
# Q of RTKLIB: 1 fix, 2 float, 3 sbas, 4 dgps, 5 single, 6 ppp
_RTKLIB = {0: FIX_NONE, 1: FIX_FIXED, 2: FIX_FLOAT, 3: FIX_DGNSS, 4: FIX_DGNSS, 5: FIX_SINGLE,
           6: FIX_PPP}  # fmt: skip
_OWN = {0: FIX_NONE, 1: FIX_NONE, 2: FIX_2D, 3: FIX_SINGLE, 4: FIX_DGNSS, 5: FIX_PPP,
        6: FIX_FLOAT, 7: FIX_FIXED}  # fmt: skip
_WORDS = (
    ("no", FIX_NONE), ("float", FIX_FLOAT), ("fixed", FIX_FIXED), ("rtk", FIX_FIXED),
    ("ppp", FIX_PPP), ("dgps", FIX_DGNSS), ("dgnss", FIX_DGNSS), ("diff", FIX_DGNSS),
    ("sbas", FIX_DGNSS), ("3d", FIX_SINGLE), ("2d", FIX_2D), ("single", FIX_SINGLE),
    ("gps", FIX_SINGLE), ("fix", FIX_FIXED),
)  # fmt: skip
_SIGMAS = ("sigma_north", "sigma_east", "sigma_down")
_SIGMAS_V = ("sigma_v_north", "sigma_v_east", "sigma_v_down")


def gnss_of(q: Quantities, time: Array, scale: TimeScale, rows: IntArray) -> GnssLog:
    """GNSS log of the rows of a table that hold a fix.

    Parameters
    ----------
    q
        Quantities of the table; `lat` and `lon` are there.
    time : shape (rows of the table,), s
    scale
        Of `time`.
    rows
        Rows to take.
    """
    place = q.place()
    height, kind = _height(q)
    v_ned = _velocity(q, time, place)
    fix = _fix(q, place)
    sigma, sigma_v = _sigmas(q)
    return GnssLog(
        time=time[rows],
        scale=scale,
        source=q.table.source,
        lat=place[0][rows],
        lon=place[1][rows],
        height=height[rows],
        height_kind=kind,
        geoid_separation=_separation(q)[rows],
        v_ned=v_ned[rows],
        covariance_ned=covariance_of_sigmas(sigma[rows]),
        covariance_v_ned=covariance_of_sigmas(sigma_v[rows]),
        fix=fix[rows],
        satellites=q.whole("satellites", -1)[rows],
    )


def fix_rows(q: Quantities, time: Array, *, mixed: bool) -> IntArray:
    """Rows that hold a fix of their own.

    In a table that repeats the last fix beside faster samples (`mixed`) these are the rows where
    a GNSS column changes; a fix that repeats a place exactly is lost, which a receiver's noise
    makes rare.
    """
    usable = np.isfinite(time)
    if not mixed:
        return np.flatnonzero(usable).astype(np.int64)
    names = [t for t in _GNSS_TARGETS if q.has(t)]
    values = np.stack([q.raw(t) for t in names if t != "fix"], axis=1)
    usable &= np.isfinite(q.raw("lat")) & np.isfinite(q.raw("lon"))
    at = np.flatnonzero(usable)
    if not len(at):
        return np.asarray(at, dtype=np.int64)
    seen = np.nan_to_num(values[at], nan=-1e30)
    new = np.concatenate([[True], np.any(np.diff(seen, axis=0) != 0.0, axis=1)])
    return np.asarray(at[new], dtype=np.int64)


_GNSS_TARGETS = tuple(
    t for t in TARGETS
    if t in {"lat", "lon", "course", "satellites", "gps_week"}
    or (TARGETS[t] in {"length", "speed"} and t not in {"baro_height", "airspeed"})
)  # fmt: skip


def _height(q: Quantities) -> tuple[Array, HeightKind]:
    for target, kind in _HEIGHTS:
        if q.has(target):
            if kind is HeightKind.UNKNOWN:
                q.table.doubts.append(
                    f"column {q.columns[target].header} does not say above what: map "
                    "height_ellipsoidal or height_orthometric, or state [gnss] height_kind"
                )
            return q.si(target), kind
    q.table.doubts.append("the fixes have no height")
    return np.full(q.table.rows, np.nan), HeightKind.UNKNOWN


def _separation(q: Quantities) -> Array:
    if q.has("geoid_separation"):
        return q.si("geoid_separation")
    return np.asarray(q.si("height_ellipsoidal") - q.si("height_orthometric"))


def _velocity(q: Quantities, time: Array, place: tuple[Array, Array]) -> Array:
    """North, east, down, m/s; by components, or by ground speed and course; shape (rows, 3)."""
    v = np.full((q.table.rows, 3), np.nan)
    if q.has("v_north", "v_east"):
        unit = None
        if not all(q.columns[t].unit or q.columns[t].documented for t in ("v_north", "v_east")):
            unit = _component_unit(q, time, place)
        v[:, 0], v[:, 1] = q.si("v_north", unit), q.si("v_east", unit)
    elif q.has("ground_speed", "course"):
        unit = q.speed_unit("ground_speed", time, place)
        speed = q.si("ground_speed", unit)
        course = q.si("course", q.columns["course"].unit or _course_unit(q, time, place))
        v[:, 0], v[:, 1] = speed * np.cos(course), speed * np.sin(course)
    else:
        return v
    down, up = q.has("v_down"), q.has("v_up")
    if down or up:
        v[:, 2] = q.si("v_down", unit) if down else -q.si("v_up", unit)
    return v


def _component_unit(q: Quantities, time: Array, place: tuple[Array, Array]) -> Unit | None:
    """Unit of a velocity that states none, by the distance between fixes."""
    unit = tell_speed_unit(time, *place, np.hypot(q.raw("v_north"), q.raw("v_east")))
    if unit is not None:
        q.table.doubts.append(
            f"column {q.columns['v_north'].header} states no unit; {unit.name} by the distance "
            "between fixes"
        )
    return unit


def _course_unit(q: Quantities, time: Array, place: tuple[Array, Array]) -> Unit:
    """Unit of a course that states none: by its size, else by the way between fixes."""
    raw = q.raw("course")
    unit = tell_angle_unit(raw) or tell_course_unit(time, *place, raw)
    return unit or q.angle_unit(["course"])


def _sigmas(q: Quantities) -> tuple[Array, Array]:
    """Sigmas of position, m, and velocity, m/s, in north, east, down; NaN where none is stated."""
    sigma = np.stack([q.si(t) for t in _SIGMAS], axis=1)
    sigma_v = np.stack([q.si(t) for t in _SIGMAS_V], axis=1)
    if q.has("sigma_h") and not q.has("sigma_north"):
        sigma[:, :2] = q.si("sigma_h")[:, None]
    if q.has("sigma_speed") and not q.has("sigma_v_north"):
        sigma_v[:] = q.si("sigma_speed")[:, None]
    void = (sigma <= 0.0).any() or (sigma_v <= 0.0).any()
    if void:
        q.table.doubts.append("sigmas of zero or less are taken as unknown")
    return np.where(sigma > 0.0, sigma, np.nan), np.where(sigma_v > 0.0, sigma_v, np.nan)


def _fix(q: Quantities, place: tuple[Array, Array]) -> IntArray:
    """Quality of the fixes; single where the table states none."""
    there = np.isfinite(place[0]) & np.isfinite(place[1])
    for target, codes in (("fix", _OWN), ("rtklib_quality", _RTKLIB), ("nmea_quality", _NMEA)):
        if q.has(target):
            stated = _codes(q, target, codes)
            return np.where(there, stated, FIX_NONE).astype(np.int64)
    return np.where(there, FIX_SINGLE, FIX_NONE).astype(np.int64)


def _codes(q: Quantities, target: str, codes: Mapping[int, int]) -> IntArray:
    column = q.columns[target]
    if q.table.frame.iloc[:, column.index].dtype.kind not in "fiub":
        words = [_word(t) for t in q.table.texts(column.index)]
        return np.array(words, dtype=np.int64)
    values = q.whole(target, 0)
    known = set(np.unique(values).tolist())
    if target == "fix" and known <= {0, 1} and 1 in known:
        q.table.doubts.append(f"column {column.header} holds 0 and 1 only; 1 is taken as a fix")
        return np.where(values == 1, FIX_SINGLE, FIX_NONE).astype(np.int64)
    strange = sorted(known - codes.keys())
    if strange:
        q.table.doubts.append(
            f"column {column.header}: codes {', '.join(map(str, strange[:5]))} are not known; "
            "taken as single"
        )
    table = {**dict.fromkeys(strange, FIX_SINGLE), **codes}
    return np.array([table[v] for v in values.tolist()], dtype=np.int64)


def _word(text: str) -> int:
    """Quality that a word such as "RTK fixed" or a digit says."""
    low = text.lower().strip()
    if low.isdigit():
        return _OWN.get(int(low), FIX_SINGLE)
    return next((code for word, code in _WORDS if word in low), FIX_NONE)
