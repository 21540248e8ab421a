"""Units that no header states, told from the numbers where only one unit fits them."""

from __future__ import annotations

import math

import numpy as np

from georef_gis.frames import Array
from georef_gis.ingest.logs.column_units import STANDARD_GRAVITY, Unit, unit_of

# m/s2; median of the specific force of a vehicle that flies or drives, turns included
_FORCE_LOW, _FORCE_HIGH = 0.75 * STANDARD_GRAVITY, 1.35 * STANDARD_GRAVITY
# rad/s; no gyro of the trade measures more (2000 deg/s), and deg/s beyond 2500 are no rates
_FASTEST_RATE, _HIGHEST_DEGREES = 40.0, 2500.0
# rad; beyond it an angle is no angle in radians, turns counted on apart
_FULL_TURN = 2.0 * math.pi + 0.01
# m/s of motion, and share by which a ratio may miss a unit (ft/s and km/h are 9 % apart)
_MOVING, _RATIO = 3.0, 0.04
_EARTH_RADIUS = 6371000.0
# rad; a course as logged lies this near to the way between fixes
_ALONG = math.radians(15.0)


def tell_force_unit(accel: Array) -> Unit | None:
    """Unit of an accelerometer by the median length of its readings, shape (n, 3)."""
    length = np.linalg.norm(accel, axis=1)
    length = length[np.isfinite(length)]
    if len(length) < 10:
        return None
    for name in ("m/s2", "g", "mg", "ft/s2"):
        unit = unit_of(name, "acceleration")
        if unit and _FORCE_LOW <= float(np.median(length)) * unit.factor <= _FORCE_HIGH:
            return unit
    return None


def tell_rate_unit(gyro: Array) -> Unit | None:
    """Unit of a gyro, shape (n, 3), where its readings are too large for rad/s."""
    known = np.abs(gyro[np.isfinite(gyro)])
    if len(known) < 10 or not _FASTEST_RATE < float(np.max(known)) < _HIGHEST_DEGREES:
        return None
    # One wild sample is no rate.
    if np.sum(known > _FASTEST_RATE) < 3:
        return None
    return unit_of("deg/s", "rate")


def tell_place_unit(lat: Array, lon: Array) -> Unit | None:
    """Unit of latitude and longitude by their size; shapes (n,)."""
    good = np.isfinite(lat) & np.isfinite(lon) & ((lat != 0.0) | (lon != 0.0))
    if not good.any():
        return unit_of("deg", "angle")
    north, east = float(np.median(np.abs(lat[good]))), float(np.median(np.abs(lon[good])))
    if north > 360.0 and east > 360.0:
        whole = bool(np.all(lat[good] == np.round(lat[good])))
        fits = north <= 90e7 and east <= 360e7
        return unit_of("deg*1e7", "angle") if whole and fits and max(north, east) > 1e6 else None
    if north > math.pi / 2.0 or east > math.pi:
        return unit_of("deg", "angle")
    return None


def tell_angle_unit(*angles: Array) -> Unit | None:
    """Degrees where angles of one filter are too large for radians; shapes (n,)."""
    known = np.concatenate([a[np.isfinite(a)] for a in angles])
    beyond = np.sum(np.abs(known) > _FULL_TURN)
    return unit_of("deg", "angle") if beyond >= 3 else None


def tell_speed_unit(time: Array, lat: Array, lon: Array, speed: Array) -> Unit | None:
    """Unit of a ground speed by the distance between fixes.

    Parameters
    ----------
    time : shape (n,), s
    lat, lon : shape (n,), rad
    speed : shape (n,)
        As logged.

    Returns
    -------
    unit
        None if the vehicle moved too little, or if no unit fits to 4 %.
    """
    way, logged = _ways(time, lat, lon, np.abs(speed))
    way = np.hypot(*way.T)
    moving = (way > _MOVING) & (logged > 0.0)
    if moving.sum() < 8:
        return None
    ratio = float(np.median(way[moving] / logged[moving]))
    for name in ("m/s", "km/h", "kn", "mph", "ft/s", "cm/s", "mm/s"):
        unit = unit_of(name, "speed")
        if unit and abs(ratio / unit.factor - 1.0) < _RATIO:
            return unit
    return None


def tell_course_unit(time: Array, lat: Array, lon: Array, course: Array) -> Unit | None:
    """Unit of a course by the direction from fix to fix; arguments as `tell_speed_unit`.

    Notes
    -----
    Where both units fit, as to the north, either gives the same velocity.
    """
    way, logged = _ways(time, lat, lon, course)
    moving = np.hypot(*way.T) > _MOVING
    if moving.sum() < 8:
        return None
    truth = np.arctan2(way[moving, 1], way[moving, 0])
    for name in ("deg", "rad"):
        unit = unit_of(name, "angle")
        if unit is None:
            continue
        off = logged[moving] * unit.factor - truth
        if float(np.median(np.abs(np.arctan2(np.sin(off), np.cos(off))))) < _ALONG:
            return unit
    return None


def _ways(time: Array, lat: Array, lon: Array, logged: Array) -> tuple[Array, Array]:
    """Velocity (north, east), m/s, over about two seconds between fixes, and a value amid them.

    Returns
    -------
    way : shape (m, 2)
    value : shape (m,)
    """
    good = np.isfinite(time) & np.isfinite(lat) & np.isfinite(lon) & np.isfinite(logged)
    t, north, east, v = time[good], lat[good], lon[good], logged[good]
    if len(t) < 10:
        return np.empty((0, 2)), np.empty(0)
    # Over a second or two the noise of a fix is small against the way.
    half = max(1, round(1.0 / max(float(np.median(np.diff(t))), 1e-3)))
    stride = 2 * half
    if len(t) <= stride:
        return np.empty((0, 2)), np.empty(0)
    dt = t[stride:] - t[:-stride]
    dn = (north[stride:] - north[:-stride]) * _EARTH_RADIUS
    de = (east[stride:] - east[:-stride]) * _EARTH_RADIUS * np.cos(north[stride:])
    usable = (dt > 0.0) & (dt < 10.0) & (np.hypot(dn, de) < 300.0 * np.abs(dt))
    way = np.stack([dn[usable] / dt[usable], de[usable] / dt[usable]], axis=1)
    return way, v[half:-half][usable]
