"""Headings of a magnetometer: levelled, freed of the vehicle's own field, turned to true north.

Levelling and hard iron: Gebre-Egziabher et al. (2006), J. Aerosp. Eng. 19(2); here the model field
adds what a level flight lacks, for its samples lie on a circle and not on a sphere: its dip says
how much of the field must be vertical.
"""

from __future__ import annotations

import calendar
import datetime
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, R_ned_from_body
from georef_gis.model.logs import AidLog, IntArray

# rad, one sigma of a calibrated compass: soft iron, currents of the motors
SIGMA_COMPASS = math.radians(10.0)
# rad, one sigma of a compass with an unknown field of the vehicle's own
SIGMA_UNCALIBRATED = math.radians(30.0)
# nT; where the level field is weaker a compass does worse in proportion
FULL_LEVEL_FIELD = 12000.0
# nT; the blackout zone of the World Magnetic Model
BLACKOUT = 2000.0
# of twelve sectors of heading, that must be seen to tell the vehicle's field from the Earth's
SECTORS = 12
FEWEST_SECTORS = 8
# of the samples, that make a sector seen
SECTOR_SHARE = 0.01
# of the level field; more scatter is no circle
MOST_SCATTER = 0.3
# of the level field; more is said
NOTABLE_SCATTER = 0.1
FEWEST_SAMPLES = 50
MOST_SAMPLES = 3000
# of the spread of the samples; one that differs less from the last tells nothing new
NEW_SAMPLE = 0.05
# samples among which those that differ are looked for
MOST_READ = 20000
# other axes must fit with this share of the scatter to be believed
OTHER_AXES = 0.5
# samples on which other axes are tried
TRIED_SAMPLES = 300
# rad, one sigma of no heading at all
SIGMA_ANY = math.pi / math.sqrt(3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class EarthField:
    """Declination and dip (down positive), rad, and level intensity, nT."""

    declination: float
    dip: float
    level: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HardIron:
    """Field of the vehicle itself, body axes (3,), and the Earth's total, in the log's unit.

    `scatter` is the rms of what does not fit, as a share of the Earth's level field; `why_not`
    says in words why the fit is not to be used, empty where it is.
    """

    offset: Array
    total: float
    scatter: float
    why_not: str = ""
    useless: bool = False


def earth_field(place: ArrayLike, date: datetime.date | float, source: str = "") -> EarthField:
    """Field of the World Magnetic Model.

    Parameters
    ----------
    place : shape (3,)
        Lat, lon rad, height m.
    date
        A date, or a decimal year.

    Raises
    ------
    InputError
        If pygeomag is missing or the date lies outside of its models.
    """
    try:
        from pygeomag import GeoMag
    except ImportError as error:
        raise InputError(
            "the declination of a compass needs pygeomag; pip install georef-gis[logs]",
            source=source,
        ) from error
    lat, lon, height = (float(value) for value in np.asarray(place, dtype=np.float64))
    year = _decimal_year(date)
    try:
        found = GeoMag(base_year=math.floor(year)).calculate(
            math.degrees(lat), math.degrees(lon), height / 1000.0, year
        )
    except (ValueError, OSError) as error:
        raise InputError(
            f"the year {year:.1f} lies outside of the World Magnetic Models at hand; update "
            "pygeomag or check the date of the log",
            source=source, field="date",
        ) from error  # fmt: skip
    return EarthField(
        declination=math.radians(found.d), dip=math.radians(found.i), level=float(found.h)
    )


def _decimal_year(date: datetime.date | float) -> float:
    if isinstance(date, (int, float)):
        return float(date)
    day = float(date.timetuple().tm_yday - 1)
    if isinstance(date, datetime.datetime):
        day += (date.hour * 3600 + date.minute * 60 + date.second) / 86400.0
    return date.year + day / (366 if calendar.isleap(date.year) else 365)


def fit_hard_iron(field: Array, roll_pitch: Array, earth: EarthField) -> HardIron:
    """Offset of a magnetometer from the turns of a flight.

    Parameters
    ----------
    field : shape (n, 3)
        Body axes, any unit, finite.
    roll_pitch : shape (n, 2), rad

    Notes
    -----
    Least squares of ``|m - b| = F`` and ``(R_level_from_body (m - b))_down = F sin(dip)`` over b
    and F, robust against passing disturbances.
    """
    if len(field) < FEWEST_SAMPLES:
        return _no_fit(field, f"{len(field)} samples")
    rows = _telling(field, MOST_SAMPLES)
    if len(rows) < FEWEST_SAMPLES:
        return _no_fit(field, f"{len(rows)} samples that differ")
    m, down = field[rows], _levelled_axes(roll_pitch[rows])[:, 2]
    unit = float(np.median(np.linalg.norm(m - np.median(m, axis=0), axis=1)))
    if not unit > 0.0:
        return _no_fit(field, "it never changes")
    sine = math.sin(earth.dip)

    def misfit(x: Array) -> Array:
        free = m / unit - x[:3]
        return np.concatenate([
            np.linalg.norm(free, axis=1) - x[3], np.einsum("ni,ni->n", down, free) - x[3] * sine
        ])  # fmt: skip

    # on a circle of samples their spread is the level field
    total = 1.0 / max(math.cos(earth.dip), 0.05)
    start = np.append(np.median(m, axis=0) / unit, total)
    start[2] -= total * sine
    fit = least_squares(misfit, start, loss="soft_l1", f_scale=0.1)
    offset, total = fit.x[:3] * unit, float(fit.x[3]) * unit
    level = total * math.cos(earth.dip)
    if not level > 0.0:
        return _no_fit(field, "its samples lie on no circle")
    left = misfit(fit.x) * unit
    scatter = float(np.sqrt(np.mean(left**2))) / level
    found = HardIron(offset=offset, total=total, scatter=scatter)
    if scatter > MOST_SCATTER:
        why = f"its samples scatter by {100 * scatter:.0f} % of the Earth's level field"
        return replace(found, why_not=why, useless=True)
    return replace(found, why_not=_why_no_circle(m - offset, roll_pitch[rows]))


def _telling(field: Array, most: int) -> IntArray:
    """Rows that differ from the one before: waiting on the ground must not outweigh the turns."""
    spread = np.linalg.norm(field - np.median(field, axis=0), axis=1)
    least = NEW_SAMPLE * float(np.quantile(spread, 0.9))
    kept, last = [0], field[0]
    for i in range(1, len(field), max(1, len(field) // MOST_READ)):
        d = field[i] - last
        if d @ d > least * least:
            kept.append(i)
            last = field[i]
    rows = np.array(kept, dtype=np.int64)
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(np.int64)]


def likelier_axes(field: Array, roll_pitch: Array, earth: EarthField, scatter: float) -> str:
    """Axes, in words, with which a magnetometer fits far better than with its own; else empty.

    A turn about the vertical shows in no circle; of axes that differ so the nearest are named.
    """
    rows = _telling(field, TRIED_SAMPLES)
    tried = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.eye(3)[list(order)] * np.array(signs)[:, None]
            fit = fit_hard_iron(field[rows] @ M.T, roll_pitch[rows], earth)
            if math.isfinite(fit.scatter) and not fit.why_not:
                tried.append((fit.scatter, M))
    good = [(s, M) for s, M in tried if s < OTHER_AXES * scatter]
    if not good:
        return ""
    best = min(s for s, _ in good)
    near = [M for s, M in good if s < 1.3 * best]
    # right-handed first, then most like what is logged
    M = max(near, key=lambda M: (round(float(np.linalg.det(M))), float(np.trace(M))))
    columns = [int(np.argmax(np.abs(row))) for row in M]
    names = [("-" if row[c] < 0 else "") + "xyz"[c] for row, c in zip(M, columns, strict=True)]
    return ", ".join(names)


def _no_fit(field: Array, why: str) -> HardIron:
    return HardIron(
        offset=np.zeros(3), total=math.nan, scatter=math.nan, why_not=why if len(field) else "empty"
    )


def _why_no_circle(free: Array, roll_pitch: Array) -> str:
    heading = _level_angle(free, roll_pitch)
    sector = np.floor((heading + math.pi) / (2.0 * math.pi) * SECTORS).astype(int) % SECTORS
    seen = np.bincount(sector, minlength=SECTORS) > SECTOR_SHARE * len(free)
    if np.count_nonzero(seen) < FEWEST_SECTORS:
        return f"the flight headed into {np.count_nonzero(seen)} of {SECTORS} sectors only"
    return ""


def _levelled_axes(roll_pitch: Array) -> Array:
    """R_level_from_body of roll and pitch, (n, 3, 3)."""
    return R_ned_from_body(roll_pitch[:, 0], roll_pitch[:, 1], np.zeros(len(roll_pitch)))


def _level_angle(field: Array, roll_pitch: Array) -> Array:
    """Heading from magnetic north of a free field, rad; (n,)."""
    level = np.einsum("nij,nj->ni", _levelled_axes(roll_pitch), field)
    return np.asarray(-np.arctan2(level[:, 1], level[:, 0]))


def headings_from_magnetometer(
    aid: AidLog,
    roll_pitch: Callable[[Array], ArrayLike] | ArrayLike,
    place: ArrayLike,
    date: datetime.date | float,
) -> AidLog:
    """True headings of a magnetometer.

    Parameters
    ----------
    aid
        Of kind "magnetic_field", body axes, any unit.
    roll_pitch
        Rad, (n, 2) at the times of the log, or a function of times that gives them; rows that are
        not finite are left out.
    place : shape (3,)
        Lat, lon rad, height m of the flight.
    date
        Date of the flight, or decimal year.

    Returns
    -------
    AidLog
        Of kind "heading": rad clockwise from true north within (-pi, pi], with sigmas that hold
        what a compass in a vehicle is worth, and doubts.

    Raises
    ------
    InputError
        If pygeomag is missing or the date lies outside of its models.
    NavigationError
        If the log holds no field, or the place is too near to a magnetic pole.
    """
    if aid.kind != "magnetic_field":
        raise ValueError(f"a log of {aid.kind} is no magnetic field")
    earth = earth_field(place, date, aid.source)
    if earth.level < BLACKOUT:
        raise NavigationError(
            f"{aid.source}: the Earth's level field is {earth.level:.0f} nT here, too near to a "
            "magnetic pole for a compass; leave the magnetometer out"
        )
    angles = np.asarray(roll_pitch(aid.time) if callable(roll_pitch) else roll_pitch, dtype=float)
    if angles.shape != (len(aid), 2):
        raise ValueError(f"roll and pitch have shape {angles.shape} for {len(aid)} samples")
    good = np.isfinite(aid.value).all(axis=-1) & np.isfinite(angles).all(axis=-1)
    good &= np.linalg.norm(np.where(good[:, None], aid.value, 0.0), axis=-1) > 0.0
    if not good.any():
        raise NavigationError(
            f"{aid.source}: no sample of the magnetometer has a field, a roll and a pitch"
        )
    field, angles = aid.value[good], angles[good]
    iron = fit_hard_iron(field, angles, earth)
    if iron.scatter > NOTABLE_SCATTER:
        axes = likelier_axes(field, angles, earth, iron.scatter)
        if axes:
            why = f"its axes look like ({axes}) of what is logged; give them in the column map"
            iron = replace(iron, why_not=why, useless=True)
    sigma, doubts = _worth(iron, earth)
    heading = _level_angle(field - iron.offset if not iron.why_not else field, angles)
    heading = heading + earth.declination
    return AidLog(
        time=aid.time[good],
        scale=aid.scale,
        source=aid.source,
        kind="heading",
        value=np.asarray(np.arctan2(np.sin(heading), np.cos(heading))),
        sigma=np.full(int(np.count_nonzero(good)), sigma),
        doubts=(*aid.doubts, *doubts),
    )


def _worth(iron: HardIron, earth: EarthField) -> tuple[float, list[str]]:
    """Sigma of a heading, rad, and what is doubtful."""
    doubts = []
    weak = max(1.0, FULL_LEVEL_FIELD / earth.level)
    if weak > 1.0:
        doubts.append(f"compass: the Earth's level field is weak here, {earth.level:.0f} nT")
    if iron.why_not:
        sigma = SIGMA_ANY if iron.useless else SIGMA_UNCALIBRATED
        doubts.append(
            f"compass: the vehicle's own field is not known, {iron.why_not}; headings are taken "
            f"to {math.degrees(min(sigma * weak, SIGMA_ANY)):.0f} deg"
        )
    else:
        sigma = math.hypot(SIGMA_COMPASS, iron.scatter)
        if iron.scatter > NOTABLE_SCATTER:
            doubts.append(
                f"compass: its samples scatter by {100 * iron.scatter:.0f} % of the Earth's level "
                "field; check its axes and what lies near it"
            )
    return min(sigma * weak, SIGMA_ANY), doubts
