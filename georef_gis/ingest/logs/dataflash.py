"""ArduPilot DataFlash logs (.BIN, and .log as text), by pymavlink's DFReader.

Message and field names are those of ArduPilot's log documentation (ardupilot.org, "Onboard Message
Log Messages"), with the older ones of files without TimeUS.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.ingest.logs.autopilot_values import (
    FIX_OF_TYPE,
    GEOID_TOLERANCE,
    SIGMA_FEEDBACK,
    SIGMA_TRIGGER,
)
from georef_gis.ingest.logs.boot_clock import BootClock, fit_boot_clock, on_gps_scale
from georef_gis.ingest.logs.dataflash_tables import MAGIC, Table, Tables, one_boot, read_tables
from georef_gis.model.logs import (
    FIX_NONE,
    FIX_PPP,
    FIX_SINGLE,
    AidKind,
    AidLog,
    AttitudeLog,
    EventLog,
    FlightLogs,
    GnssLog,
    ImuLog,
    IntArray,
    covariance_of_sigmas,
    unknown,
)
from georef_gis.units import GPS_WEEK

_FIX = {**FIX_OF_TYPE, 7: FIX_SINGLE, 8: FIX_PPP}
# s: counter of microseconds in 32 bits, in which the feedback of a camera is stamped
_WRAP = 2.0**32 * 1e-6


def looks_like_dataflash(head: bytes, path: Path) -> bool:
    """Whether the first bytes of a file are those of a DataFlash log, binary or text."""
    del path
    if head.startswith(MAGIC):
        return True
    lines = [line.strip().replace(b" ", b"") for line in head.splitlines()[:20]]
    return any(line.startswith(b"FMT,128,89,FMT,") for line in lines)


def read_dataflash(path: Path) -> FlightLogs:
    """Everything of an ArduPilot log that serves navigation, on the GPS scale where GPS has time.

    Raises
    ------
    InputError
        If pymavlink is missing, or the file cannot be read or holds no usable message.
    """
    tables, doubts = one_boot(read_tables(path))
    gnss, gps = _gnss(tables, path, doubts)
    clock = None if gnss is None else fit_boot_clock(gnss.time, gps)
    events = tuple(
        _events(tables[name], path, _kind(tables, name, doubts), clock, doubts)
        for name in ("CAM", "TRIG")
        if name in tables
    )
    logs = FlightLogs(
        imu=_imu(tables, path, doubts),
        gnss=gnss,
        attitude=_attitude(tables, path),
        events=events,
        aids=_aids(tables, path),
        source=str(path),
        format="ArduPilot DataFlash",
    )
    if logs.imu is None and logs.gnss is None and logs.attitude is None and not events:
        raise InputError(
            "holds no IMU, GPS, ATT or CAM message; check LOG_BITMASK and that the log is of a "
            "flight",
            source=str(path),
        )
    if "DSF" in tables and np.nanmax(tables["DSF"].number("Dp"), initial=0.0) > 0:
        doubts.append(f"the logger dropped {np.nanmax(tables['DSF'].number('Dp')):.0f} messages")
    return on_gps_scale(replace(logs, doubts=tuple(doubts)), gps)


def _instance(tables: Tables, name: str, doubts: list[str]) -> Table | None:
    """First instance of a sensor that holds most of the rows: I = 0, 1 .. or NAME, NAME2 .."""
    found: list[Table] = []
    for suffix in ("", "2", "3"):
        table = tables.get(name + suffix)
        if table is None:
            continue
        if "I" in table:
            numbers = table.number("I")
            found += [table.rows(numbers == n) for n in np.unique(numbers)]
        else:
            found.append(table)
    if not found:
        return None
    most = max(len(table) for table in found)
    chosen = next(k for k, table in enumerate(found) if len(table) >= 0.9 * most)
    if len(found) > 1:
        doubts.append(f"{name}: instance {chosen} of {len(found)} is used")
    return found[chosen]


def _imu(tables: Tables, path: Path, doubts: list[str]) -> ImuLog | None:
    """Samples of IMU; else means of the increments of IMT."""
    table = _instance(tables, "IMU", doubts)
    if table is not None and "GyrX" in table:
        gyro = table.numbers("GyrX", "GyrY", "GyrZ")
        accel = table.numbers("AccX", "AccY", "AccZ")
    else:
        table = _instance(tables, "IMT", doubts)
        if table is None:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            gyro = table.numbers("DelAX", "DelAY", "DelAZ") / table.number("DelaT")[:, None]
            accel = table.numbers("DelVX", "DelVY", "DelVZ") / table.number("DelvT")[:, None]
    return ImuLog(
        time=table.boot, scale="boot", source=f"{path}: {table.name}", gyro=gyro, accel=accel
    )


def _gnss(tables: Tables, path: Path, doubts: list[str]) -> tuple[GnssLog | None, Array]:
    """Fixes, stamped when they were logged, and the epochs they state (s of GPS)."""
    table = _instance(tables, "GPS", doubts)
    if table is None:
        return None, unknown(0)
    quality = np.array([_FIX.get(int(s), FIX_NONE) for s in table.number("Status")], dtype=np.int64)
    ms = table.number("GMS") if "GMS" in table else table.number("TimeMS")
    week = table.number("GWk", "Week")
    gps = np.where((week > 0) & (ms < GPS_WEEK * 1e3), week * GPS_WEEK + ms * 1e-3, np.nan)
    accuracy, sampled, undulation = _accuracy(tables, table)
    lat, lon = np.radians(table.number("Lat")), np.radians(table.number("Lng"))
    speed, course = table.number("Spd"), np.radians(table.number("GCrs"))
    velocity = [speed * np.cos(course), speed * np.sin(course), table.number("VZ")]
    log = GnssLog(
        time=sampled,
        scale="boot",
        source=f"{path}: {table.name}",
        lat=lat,
        lon=lon,
        height=table.number("Alt"),
        height_kind=HeightKind.ORTHOMETRIC,
        geoid_separation=_separation(undulation, lat, lon, quality),
        v_ned=np.column_stack(velocity),
        covariance_ned=covariance_of_sigmas(accuracy[:, [0, 0, 1]]),
        covariance_v_ned=covariance_of_sigmas(accuracy[:, [2, 2, 2]]),
        fix=quality,
        satellites=np.nan_to_num(table.number("NSats"), nan=-1.0).astype(np.int64),
    )
    return log, gps


def _accuracy(tables: Tables, fixes: Table) -> tuple[Array, Array, Array]:
    """Of GPA, for each fix: sigmas (n, 3) of place, height, speed; boot time; undulation.

    GPA is written with the same stamp as its fix. Its SMS is when the receiver's message came,
    without the delay of the logger.
    """
    boot = fixes.boot
    none = unknown(len(fixes))
    table = tables.get("GPA")
    if table is not None and "I" in table and "I" in fixes:
        table = table.rows(table.number("I") == fixes.number("I")[0])
    if table is None or not len(table):
        return unknown(len(fixes), 3), boot, none
    order = np.argsort(table.boot, kind="stable")
    at = order[np.clip(np.searchsorted(table.boot[order], boot), 0, len(order) - 1)]
    same = np.abs(table.boot[at] - boot) < 1e-3
    sigmas = np.where(same[:, None], table.numbers("HAcc", "VAcc", "SAcc")[at], np.nan)
    # HAcc and SAcc are of the distance: split evenly between north and east
    sigmas = sigmas * np.array([math.sqrt(0.5), 1.0, math.sqrt(0.5)])
    came = table.number("SMS")[at] * 1e-3
    with np.errstate(invalid="ignore"):
        sound = same & (came > 0.0) & (came <= boot + 1e-3) & (boot - came < 1.0)
        sigmas = np.where(sigmas > 0.0, sigmas, np.nan)
    time = np.where(sound, came, boot)
    return sigmas, time, np.where(same, table.number("Und")[at], np.nan)


def _separation(undulation: Array, lat: Array, lon: Array, quality: IntArray) -> Array:
    """Height of the geoid over the ellipsoid, m, of GPA.Und.

    ArduPilot's drivers store height above the geoid less ellipsoidal height, the other way round
    from geodesy; which sign a log has is told by EGM96.
    """
    good = np.isfinite(undulation) & (undulation != 0.0) & (quality >= FIX_SINGLE)
    good &= np.abs(lat) <= math.pi / 2
    if not np.any(good):
        return unknown(len(undulation))
    model = float(geoid_undulation(np.median(lat[good]), np.median(lon[good])))
    stated = float(np.median(undulation[good]))
    sign = min((-1.0, 1.0), key=lambda s: abs(s * stated - model))
    fits = abs(sign * stated - model) <= GEOID_TOLERANCE
    return np.where(good & fits, sign * undulation, np.nan)


def _attitude(tables: Tables, path: Path) -> AttitudeLog | None:
    table = tables.get("ATT")
    if table is None:
        return None
    return AttitudeLog(
        time=table.boot,
        scale="boot",
        source=f"{path}: ATT",
        rpy=np.radians(table.numbers("Roll", "Pitch", "Yaw")),
        sigma_rpy=unknown(len(table), 3),
    )


def _aids(tables: Tables, path: Path) -> tuple[AidLog, ...]:
    out = []
    kinds: tuple[tuple[AidKind, str, tuple[str, ...], str], ...] = (
        ("baro_height", "BARO", ("Alt",), ""),
        ("airspeed", "ARSP", ("Airspeed",), "equivalent airspeed, without the density of the air"),
        ("magnetic_field", "MAG", ("MagX", "MagY", "MagZ"), ""),
    )
    for kind, name, columns, doubt in kinds:
        table = _instance(tables, name, [])
        if table is None or columns[0] not in table:
            continue
        out.append(
            AidLog(
                time=table.boot,
                scale="boot",
                source=f"{path}: {name}",
                doubts=(f"{name}: {doubt}",) if doubt else (),
                kind=kind,
                value=table.numbers(*columns) if len(columns) > 1 else table.number(*columns),
                sigma=unknown(len(table)),
            )
        )
    return tuple(out)


def _kind(tables: Tables, name: str, doubts: list[str]) -> str:
    """CAM is the answer of the shutter only where the camera has a feedback pin."""
    if name == "TRIG":
        return "trigger"
    pins = tables.get("PARM")
    if "TRIG" not in tables and pins is not None:
        names = [n.decode("ascii", "replace") if isinstance(n, bytes) else str(n) for n in
                 pins.columns.get("Name", ())]  # fmt: skip
        values = [v for n, v in zip(names, pins.number("Value"), strict=False)
                  if n.startswith("CAM") and "FEEDBA" in n and n.endswith("PIN")]  # fmt: skip
        if values and max(values) <= 0:
            doubts.append("CAM: no feedback pin is set, so these are times of commands")
            return "trigger"
    if "TRIG" not in tables:
        doubts.append("CAM without TRIG: without a feedback pin these would be times of commands")
    return "feedback"


def _events(
    table: Table, path: Path, kind: str, clock: BootClock | None, doubts: list[str]
) -> EventLog:
    count = len(table)
    sequence = table.number("Img")
    sigma = SIGMA_FEEDBACK if kind == "feedback" else SIGMA_TRIGGER
    return EventLog(
        time=_unwrapped(table, clock, doubts),
        scale="boot",
        source=f"{path}: {table.name}",
        kind=kind,
        sequence=np.nan_to_num(sequence, nan=-1.0).astype(np.int64),
        sigma=np.full(count, sigma),
        lat=np.radians(table.number("Lat")),
        lon=np.radians(table.number("Lng")),
        height=table.number("Alt"),
        height_kind=HeightKind.ORTHOMETRIC,
        covariance_ned=unknown(count, 3, 3),
        rpy=np.radians(table.numbers(*_angles(table))),
        names=("",) * count,
        flags=np.full(count, -1, dtype=np.int64),
    )


def _angles(table: Table) -> tuple[str, str, str]:
    return ("R", "P", "Y") if "R" in table else ("Roll", "Pitch", "Yaw")


def _unwrapped(table: Table, clock: BootClock | None, doubts: list[str]) -> Array:
    """Boot time, s, of exposures.

    The interrupt of the feedback pin is stamped with 32 bits of microseconds: after 71.6 min the
    stamp starts anew, while the GPS time of the same message goes on.
    """
    boot = table.boot
    week, ms = table.number("GPSWeek"), table.number("GPSTime")
    if clock is None:
        return boot
    stated = np.where(week > 0, week * GPS_WEEK + ms * 1e-3, np.nan)
    behind = stated - clock.gps_of(boot)
    turns = np.round(np.nan_to_num(behind) / _WRAP)
    wrapped = (turns > 0) & (np.abs(behind - turns * _WRAP) < 2.0)
    if np.any(wrapped):
        doubts.append(
            f"{table.name}: {np.sum(wrapped)} stamps had wrapped (32 bits of microseconds), first "
            f"at row {int(np.argmax(wrapped)) + 1}: set right by their GPS time"
        )
    off = np.abs(np.where(wrapped, 0.0, behind))
    if np.any(off > 2.0):
        doubts.append(
            f"{table.name}: {np.sum(off > 2.0)} stamps differ from their own GPS time by up to "
            f"{np.nanmax(off):.1f} s; the stamp since boot is used"
        )
    return np.asarray(boot + np.where(wrapped, turns, 0.0) * _WRAP)
