"""Applanix SBET: a smoothed trajectory, and its accuracies (SMRMSG) where they lie beside it.

SBET: records of 17 doubles: time of week s, latitude and longitude rad, ellipsoidal height m, x y z
velocity m/s, roll, pitch, platform heading, wander angle rad, specific force and angular rates of
the body (POSPac Land Output Data Files, table 4, in PDAL/PDAL#2354). SMRMSG: 10 doubles: time, RMS
of north, east, down position m and velocity m/s, of roll, pitch, heading in minutes of arc
(PDAL readers.smrmsg for the order; IGN's libXMls for the unit).

Wander angle: POSPac's frame is level; with a wander angle of zero x points north, y west and z up,
and "true heading = platform heading - wander angle". A positive wander angle a turns x to the west:
v_north = vx cos a - vy sin a, v_east = -vx sin a - vy cos a, v_down = -vz. Other programs write
north, east, down or east, north, up into the same fields and true headings beside a wander angle
that counts for nothing. The positions tell: their rates are compared with each reading of the
velocities, and another reading than Applanix's is said.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.ellipsoid import meridian_radius, prime_vertical_radius
from georef_gis.errors import InputError
from georef_gis.frames import Array, covariance_theta_ned_from_rpy
from georef_gis.ingest.logs.gnss_values import in_order, load, unroll
from georef_gis.model.logs import FlightLogs, TimeScale, TrajectoryLog
from georef_gis.units import GPS_WEEK

_COLUMNS, _SMRMSG_COLUMNS = 17, 10
_RECORD = 8 * _COLUMNS
# rad; SMRMSG's angles are in minutes of arc
_ARC_MINUTE = np.pi / (180.0 * 60.0)
# m/s; below this the rates of positions do not tell readings of the velocities apart
_MOVING = 0.5
# Another reading must leave so small a part of the misfit of Applanix's to be taken.
_CLEARLY_BETTER = 0.3
# pairs of records whose rates are compared with the velocities, s between the two
_PAIRS, _PAIR_SPAN = 4000, 0.05
# m, m/s; outside of these it is no flight
_LOWEST, _HIGHEST, _FASTEST = -1000.0, 50_000.0, 1000.0
# share of records that must be plausible; the rest may be damage
_ENOUGH = 0.9
# attitudes turned at once: an hour at 200 Hz would take 0.5 GB of matrices in between
_BLOCK = 50_000


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """How x, y, z velocities and the wander angle are meant."""

    axes: str
    # +1: Applanix; 0: headings and velocities are true already; -1: the other sign
    wander: int

    def v_ned(self, record: Array) -> Array:
        """Velocities in ned; shape (n, 17) -> (n, 3), m/s."""
        x, y, z = record[:, 4], record[:, 5], record[:, 6]
        if self.axes == "north-west-up":
            level = np.column_stack([x, -y, -z])
        elif self.axes == "north-east-down":
            level = np.column_stack([x, y, z])
        else:
            level = np.column_stack([y, x, -z])
        a = -self.wander * record[:, 10]
        north = level[:, 0] * np.cos(a) - level[:, 1] * np.sin(a)
        east = level[:, 0] * np.sin(a) + level[:, 1] * np.cos(a)
        return np.column_stack([north, east, level[:, 2]])


_APPLANIX = _Reading(axes="north-west-up", wander=1)
_READINGS = tuple(
    _Reading(axes=axes, wander=wander)
    for wander in (1, 0, -1)
    for axes in ("north-west-up", "north-east-down", "east-north-up")
)


def looks_like_sbet(head: bytes, path: Path) -> bool:
    """Whether the first bytes are whole records of a trajectory, in either order of bytes."""
    del path
    count = len(head) // _RECORD
    return count >= 2 and any(
        _is_plausible(_records(head, order)) for order in ("<f8", ">f8")
    )  # fmt: skip


def read_sbet(path: Path, *, week: int | None = None) -> FlightLogs:
    """Smoothed trajectory of a POSPac project.

    Parameters
    ----------
    path
        SBET; `smrmsg_*.out` beside it is read for covariances.
    week
        GPS week of its first record; the file holds time of week only.

    Returns
    -------
    logs
        `trajectory` at the point that POSPac's project names (the IMU, unless it was moved to a
        sensor). Without a week its times are seconds of week on scale "boot".

    Raises
    ------
    InputError
        If it is no SBET: no plausible records, or angles in degrees.

    Notes
    -----
    The files' specific forces and rates are not read: they are what POSPac corrected, not what an
    IMU measured.
    """
    data = load(path)
    record, doubts = _plausible_records(data, path)
    finite = np.all(np.isfinite(record[:, :11]), axis=1)
    if not np.all(finite):
        doubts.append(f"{int(np.sum(~finite))} of {len(record)} records are not finite: left out")
        record = record[finite]
    time = unroll(record[:, 0], GPS_WEEK)
    scale: TimeScale = "boot" if week is None else "gps"
    if week is None:
        doubts.append("has no GPS week: times are seconds of week; give the week")
    else:
        time = time + week * GPS_WEEK
    reading, words = _best_reading(record, time)
    doubts += words
    yaw = np.remainder(record[:, 9] - reading.wander * record[:, 10] + np.pi, 2 * np.pi) - np.pi
    rpy = np.column_stack([record[:, 7], record[:, 8], yaw])
    covariance, words = _covariance(path, record[:, 0], rpy)
    log = TrajectoryLog(
        time=time,
        scale=scale,
        source=str(path),
        lat=record[:, 1],
        lon=np.remainder(record[:, 2] + np.pi, 2 * np.pi) - np.pi,
        height=record[:, 3],
        v_ned=reading.v_ned(record),
        rpy=rpy,
        covariance=covariance,
    )
    log, order = in_order(log)
    told = (*doubts, *words, *order)
    return FlightLogs(trajectory=log, source=str(path), format="SBET", doubts=told)


# ---------------------------------------------------------------------------------------------
# Records
# ---------------------------------------------------------------------------------------------


def _records(data: bytes, order: str) -> Array:
    count = len(data) // _RECORD
    values = np.frombuffer(data[: count * _RECORD], dtype=order)
    return values.reshape(count, _COLUMNS).astype(np.float64)


def _is_plausible(record: Array, *, lat: float = np.pi / 2, lon: float = 2 * np.pi) -> bool:
    """Whether records are those of a trajectory whose angles stay below limits."""
    with np.errstate(invalid="ignore", over="ignore"):
        ok = (record[:, 0] >= 0.0) & (record[:, 0] < 2 * GPS_WEEK)
        ok &= (np.abs(record[:, 1]) <= lat) & (np.abs(record[:, 2]) <= lon)
        ok &= (record[:, 3] > _LOWEST) & (record[:, 3] < _HIGHEST)
        ok &= np.all(np.abs(record[:, 4:7]) < _FASTEST, axis=1)
        if not len(record) or np.mean(ok) < _ENOUGH:
            return False
        # The wrong order of bytes gives numbers near zero, which would pass the limits.
        step = np.diff(record[ok, 0])
    return len(step) == 0 or bool(1e-4 <= np.median(step) <= 10.0)


def _plausible_records(data: bytes, path: Path) -> tuple[Array, list[str]]:
    doubts = []
    rest = len(data) % _RECORD
    if rest:
        doubts.append(f"its last record is cut ({rest} of {_RECORD} bytes)")
    for order in ("<f8", ">f8"):
        record = _records(data, order)
        if _is_plausible(record):
            if order == ">f8":
                doubts.append("its doubles are big-endian, unlike those of POSPac")
            return record, doubts
        if _is_plausible(record, lat=90.0, lon=360.0):
            raise InputError(
                f"latitudes up to {np.nanmax(np.abs(record[:, 1])):.3f} are degrees; an SBET has "
                "radians: export it again",
                source=str(path),
                field="latitude",
            )
    raise InputError(
        f"its {len(data)} bytes are no records of an SBET (17 doubles: time, place, velocity, "
        "attitude ...)",
        source=str(path),
    )


# ---------------------------------------------------------------------------------------------
# Velocities against positions
# ---------------------------------------------------------------------------------------------


def _best_reading(record: Array, time: Array) -> tuple[_Reading, list[str]]:
    """The reading of the velocities that the positions bear out, and doubts."""
    if len(record) < 3:
        return _APPLANIX, []
    step = float(np.median(np.diff(time)))
    ahead = min(max(1, int(np.ceil(_PAIR_SPAN / max(step, 1e-6)))), len(record) - 1)
    first = np.unique(np.linspace(0, len(record) - 1 - ahead, _PAIRS).astype(int))
    a, b = record[first], record[first + ahead]
    dt = time[first + ahead] - time[first]
    keep = (dt > 0.0) & (dt < 10 * (ahead * step + _PAIR_SPAN))
    a, b, dt = a[keep], b[keep], dt[keep]
    rate = _rate(a, b, dt)
    speed = _rms(rate)
    if not len(rate) or speed < _MOVING:
        return _APPLANIX, []
    misfit = np.array([_rms((r.v_ned(a) + r.v_ned(b)) / 2 - rate) for r in _READINGS])
    # Readings that fit alike differ by less than the noise: the first is the most usual.
    best = int(np.flatnonzero(misfit <= 1.2 * np.min(misfit) + 1e-9)[0])
    if misfit[best] < _CLEARLY_BETTER * misfit[0]:
        reading = _READINGS[best]
        sign = {1: "subtracted", 0: "not used", -1: "added"}[reading.wander]
        return reading, [
            f"its velocities fit its positions as {reading.axes}, wander angle {sign} (misfit "
            f"{misfit[best]:.2f} m/s; {misfit[0]:.2f} m/s by Applanix's rule): headings are read "
            "likewise"
        ]
    if misfit[0] > speed / 2:
        return _APPLANIX, [
            f"its velocities do not fit its positions (misfit {misfit[0]:.2f} m/s at {speed:.2f} "
            "m/s): velocities and headings are doubtful"
        ]
    return _APPLANIX, []


def _rate(a: Array, b: Array, dt: Array) -> Array:
    """Velocity in ned, m/s, of the way from records a to records b; shape (n, 3)."""
    lat, height = (a[:, 1] + b[:, 1]) / 2, (a[:, 3] + b[:, 3]) / 2
    east = np.remainder(b[:, 2] - a[:, 2] + np.pi, 2 * np.pi) - np.pi
    way = np.column_stack(
        [
            (b[:, 1] - a[:, 1]) * (meridian_radius(lat) + height),
            east * (prime_vertical_radius(lat) + height) * np.cos(lat),
            a[:, 3] - b[:, 3],
        ]
    )
    return np.asarray(way / dt[:, None])


def _rms(v: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(v**2, axis=1)))) if len(v) else 0.0


# ---------------------------------------------------------------------------------------------
# Accuracies
# ---------------------------------------------------------------------------------------------


def _covariance(path: Path, tow: Array, rpy: Array) -> tuple[Array, list[str]]:
    """Covariance (n, 6, 6) of (dp_ned, dtheta_ned) from SMRMSG, NaN without one, and doubts."""
    nothing = np.broadcast_to(np.float64(np.nan), (len(tow), 6, 6))
    beside = _smrmsg_beside(path)
    if beside is None:
        return nothing, ["has no smrmsg file beside it: its accuracy is not known"]
    rows = _smrmsg(beside)
    if rows is None:
        return nothing, [f"{beside.name} is no SMRMSG (10 doubles): accuracy is not known"]
    seconds, unrolled = unroll(rows[:, 0], GPS_WEEK), unroll(tow, GPS_WEEK)
    seconds += GPS_WEEK * np.round((np.median(unrolled) - np.median(seconds)) / GPS_WEEK)
    order = np.argsort(seconds, kind="stable")
    sigma = np.column_stack(
        [
            np.interp(unrolled, seconds[order], rows[order, i], left=np.nan, right=np.nan)
            for i in (1, 2, 3, 7, 8, 9)
        ]
    )
    outside = int(np.sum(np.isnan(sigma[:, 0])))
    words = (
        [f"{beside.name} does not span {outside} of {len(tow)} records: accuracy unknown there"]
        if outside
        else []
    )
    variances = sigma**2
    covariance = np.zeros((len(tow), 6, 6))
    covariance[:, :3, :3] = variances[:, :3, None] * np.eye(3)
    for at in range(0, len(tow), _BLOCK):
        rows_of = slice(at, at + _BLOCK)
        covariance[rows_of, 3:, 3:] = covariance_theta_ned_from_rpy(
            rpy[rows_of], sigma[rows_of, 3:] * _ARC_MINUTE
        )
    covariance[np.isnan(sigma[:, 0])] = np.nan
    return covariance, words


def _smrmsg_beside(path: Path) -> Path | None:
    """`smrmsg_x.out` of `sbet_x.out`, in any case of letters."""
    wanted = path.name.lower().replace("sbet", "smrmsg")
    if wanted == path.name.lower():
        return None
    return next((p for p in sorted(path.parent.iterdir()) if p.name.lower() == wanted), None)


def _smrmsg(path: Path) -> Array | None:
    """Records of an SMRMSG that can be: sigmas finite and above zero; None if there are none."""
    data = load(path)
    count = len(data) // (8 * _SMRMSG_COLUMNS)
    for order in ("<f8", ">f8"):
        values = np.frombuffer(data[: count * 8 * _SMRMSG_COLUMNS], dtype=order)
        rows = values.reshape(count, _SMRMSG_COLUMNS).astype(np.float64)
        with np.errstate(invalid="ignore"):
            ok = np.all(np.isfinite(rows), axis=1) & np.all(rows[:, 1:] > 1e-9, axis=1)
            ok &= np.all(rows[:, 1:] < 1e5, axis=1) & (rows[:, 0] >= 0.0)
        if count and np.mean(ok) >= _ENOUGH:
            return np.asarray(rows[ok])
    return None
