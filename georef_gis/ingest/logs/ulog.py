"""PX4 ULog files, by pyulog: IMU, fixes, attitude, aids and exposures of one flight.

Topics and fields are those of PX4's message definitions (docs.px4.io, uORB message reference), old
names beside new ones. All times of the file are microseconds since boot.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array, R_from_quaternion, rpy_from_R_ned_from_body
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.ingest.logs.autopilot_values import (
    FIX_OF_TYPE,
    GEOID_TOLERANCE,
    SIGMA_FEEDBACK,
    SIGMA_TRIGGER,
)
from georef_gis.ingest.logs.boot_clock import BoolArray, gps_of_unix, on_gps_scale
from georef_gis.ingest.logs.ulog_topics import Topic, UlogFile, open_ulog
from georef_gis.model.logs import (
    FIX_NONE,
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

_MAGIC = b"ULog\x01\x12\x35"
# fix_type of sensor_gps -> our quality; 8 is "extrapolated", which no satellite backs
_FIX = {**FIX_OF_TYPE, 8: FIX_NONE}
# Hz: sampled more slowly, the topic was thinned for the log
_LEAST_IMU_RATE = 10.0


def looks_like_ulog(head: bytes, path: Path) -> bool:
    """Whether the first bytes of a file are those of a ULog."""
    del path
    return head.startswith(_MAGIC)


def read_ulog(path: Path) -> FlightLogs:
    """Everything of a PX4 log that serves navigation, on the GPS scale where fixes state time.

    Raises
    ------
    InputError
        If pyulog is missing, or the file cannot be read or holds no usable topic.
    """
    file = open_ulog(path)
    gnss, gps = _gnss(file)
    attitude = file.longest("vehicle_attitude")
    logs = FlightLogs(
        imu=_imu(file),
        gnss=gnss,
        attitude=None if attitude is None else _attitude(attitude, str(path)),
        events=_events(file),
        aids=_aids(file),
        source=str(path),
        format="PX4 ULog",
    )
    if logs.imu is None and logs.gnss is None and logs.attitude is None and not logs.events:
        raise InputError(
            "holds no IMU, GNSS, attitude or camera topic; check that the log is of a flight and "
            "that SDLOG_PROFILE has its default topics",
            source=str(path),
        )
    logs = replace(logs, doubts=tuple(file.doubts))
    return on_gps_scale(logs, gps)


def _imu(file: UlogFile) -> ImuLog | None:
    """Calibrated samples of sensor_combined; else of vehicle_imu; both forward, right, down."""
    combined = file.longest("sensor_combined")
    deltas = file.longest("vehicle_imu")
    if combined is not None and (combined.rate >= _LEAST_IMU_RATE or deltas is None):
        topic, gyro, accel = combined, *_combined(combined)
    elif deltas is not None:
        topic, gyro, accel = deltas, *_integrals(deltas)
    else:
        return None
    file.used(topic)
    if gyro is None or accel is None:
        file.doubts.append(f"{topic.name}: fields of gyro or accelerometer are missing")
        return None
    doubts = []
    if topic.rate < _LEAST_IMU_RATE:
        doubts.append(f"{topic.name}: IMU at {topic.rate:.1f} Hz only: the logger thinned it")
    late = topic.column("accelerometer_timestamp_relative")
    # 0x7fffffff marks an accelerometer without data
    if late is not None and np.median(np.abs(late[late < 2e9])) > 1000.0:
        ms = float(np.median(late[late < 2e9])) * 1e-3
        doubts.append(f"{topic.name}: accelerometer is stamped {ms:+.1f} ms off the gyro")
    return ImuLog(
        time=topic.time,
        scale="boot",
        source=f"{file.path}: {topic.name}",
        doubts=tuple(doubts),
        gyro=gyro,
        accel=accel,
    )


def _combined(topic: Topic) -> tuple[Array | None, Array | None]:
    return topic.columns("gyro_rad"), topic.columns("accelerometer_m_s2")


def _integrals(topic: Topic) -> tuple[Array | None, Array | None]:
    """Mean rates of the increments of vehicle_imu, whose intervals are in microseconds."""
    out = []
    for name, step in (
        ("delta_angle", topic.column("delta_angle_dt", "dt")),
        ("delta_velocity", topic.column("delta_velocity_dt", "dt")),
    ):
        increments = topic.columns(name)
        if increments is None or step is None:
            return None, None
        out.append(increments / np.where(step > 0.0, step * 1e-6, np.nan)[:, None])
    return out[0], out[1]


def _gps_topic(file: UlogFile) -> Topic | None:
    """Selected or blended fix; the raw one where the other was thinned for the log."""
    chosen, raw = file.longest("vehicle_gps_position"), file.longest("sensor_gps")
    if chosen is None or (raw is not None and len(raw) > 2 * len(chosen)):
        return raw
    return chosen


def _gnss(file: UlogFile) -> tuple[GnssLog | None, Array]:
    """Fixes, stamped at their arrival, and the epochs they state (s of GPS, NaN where none)."""
    topic = _gps_topic(file)
    if topic is None:
        return None, unknown(0)
    file.used(topic)
    lat = topic.scaled("latitude_deg", "lat", 1e-7)
    lon = topic.scaled("longitude_deg", "lon", 1e-7)
    if lat is None or lon is None:
        file.doubts.append(f"{topic.name}: fields of the position are missing")
        return None, unknown(0)
    fix = topic.or_nan("fix_type")
    quality = np.array([_FIX.get(int(f), FIX_NONE) for f in np.nan_to_num(fix)], dtype=np.int64)
    height, kind, separation, doubts = _height(topic, np.radians(lat), np.radians(lon), quality)
    velocity, speed_sigma = _velocity(topic)
    # eph is the accuracy of the distance: split evenly between north and east
    north = topic.or_nan("eph") / math.sqrt(2.0)
    sigma = np.column_stack([north, north, topic.or_nan("epv")])
    satellites = topic.column("satellites_used", "satellites_visible")
    utc = topic.or_nan("time_utc_usec", "time_gps_usec")
    behind = np.nan_to_num(topic.or_nan("timestamp_time_relative"))
    gps = gps_of_unix(np.where(utc > 0.0, utc, np.nan) * 1e-6)
    log = GnssLog(
        # PX4: timestamp + timestamp_time_relative is the instant of time_utc_usec
        time=topic.time + np.where(np.abs(behind) < 1e6, behind, 0.0) * 1e-6,
        scale="boot",
        source=f"{file.path}: {topic.name}",
        doubts=tuple(doubts),
        lat=np.radians(lat),
        lon=np.radians(lon),
        height=height,
        height_kind=kind,
        geoid_separation=separation,
        v_ned=velocity,
        covariance_ned=covariance_of_sigmas(np.where(sigma > 0.0, sigma, np.nan)),
        covariance_v_ned=covariance_of_sigmas(speed_sigma),
        fix=quality,
        satellites=np.nan_to_num(
            unknown(len(topic)) if satellites is None else satellites, nan=-1.0
        ).astype(np.int64),
    )
    return log, gps


def _velocity(topic: Topic) -> tuple[Array, Array]:
    """Velocity (n, 3) and its sigmas (n, 3), m/s; NaN where the receiver marks it invalid."""
    parts = [topic.or_nan(f"vel_{axis}_m_s") for axis in "ned"]
    valid = np.nan_to_num(topic.or_nan("vel_ned_valid"), nan=1.0) > 0.0
    # like eph; the name says variance, the unit is m/s
    sigma = topic.or_nan("s_variance_m_s") / math.sqrt(2.0)
    spread = np.where(valid & (sigma > 0.0), sigma, np.nan)
    return (
        np.where(valid[:, None], np.column_stack(parts), np.nan),
        np.column_stack([spread] * 3),
    )


def _height(
    topic: Topic, lat: Array, lon: Array, quality: IntArray
) -> tuple[Array, HeightKind, Array, list[str]]:
    """Ellipsoidal height where it is one, else height above the geoid; its kind and N."""
    above_geoid = topic.scaled("altitude_msl_m", "alt", 1e-3)
    ellipsoidal = topic.scaled("altitude_ellipsoid_m", "alt_ellipsoid", 1e-3)
    none = unknown(len(topic))
    if ellipsoidal is None or not np.any(ellipsoidal):
        if above_geoid is None:
            return none, HeightKind.UNKNOWN, none, [f"{topic.name}: no height"]
        return above_geoid, HeightKind.ORTHOMETRIC, none, []
    if above_geoid is None:
        return ellipsoidal, HeightKind.ELLIPSOIDAL, none, []
    good = (quality >= FIX_SINGLE) & (np.abs(lat) <= math.pi / 2)
    if not np.any(good):
        return ellipsoidal, HeightKind.ELLIPSOIDAL, ellipsoidal - above_geoid, []
    stated = float(np.median((ellipsoidal - above_geoid)[good]))
    model = float(geoid_undulation(np.median(lat[good]), np.median(lon[good])))
    if abs(stated - model) <= GEOID_TOLERANCE:
        return ellipsoidal, HeightKind.ELLIPSOIDAL, ellipsoidal - above_geoid, []
    doubt = (
        f"{topic.name}: ellipsoidal height less height above the geoid is {stated:.1f} m, EGM96 "
        f"has {model:.1f} m: the height above the geoid is believed"
    )
    return above_geoid, HeightKind.ORTHOMETRIC, none, [doubt]


def _attitude(topic: Topic, source: str) -> AttitudeLog | None:
    q = topic.columns("q", 4)
    if q is None:
        return None
    fit = np.isfinite(q).all(axis=1) & (np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05)
    rpy = unknown(len(q), 3)
    rpy[fit] = rpy_from_R_ned_from_body(R_from_quaternion(q[fit]))
    doubts = () if fit.all() else (f"{topic.name}: {np.sum(~fit)} quaternions are no rotation",)
    return AttitudeLog(
        time=topic.time,
        scale="boot",
        source=f"{source}: {topic.name}",
        doubts=doubts,
        rpy=rpy,
        sigma_rpy=unknown(len(q), 3),
    )


def _aids(file: UlogFile) -> tuple[AidLog, ...]:
    kinds: tuple[tuple[AidKind, str, tuple[str, ...]], ...] = (
        ("baro_height", "vehicle_air_data", ("baro_alt_meter",)),
        ("baro_height", "sensor_baro", ("altitude",)),
        ("airspeed", "airspeed_validated", ("true_airspeed_m_s",)),
        ("airspeed", "airspeed", ("true_airspeed_m_s",)),
    )
    chosen: dict[AidKind, tuple[Topic, Array]] = {}
    for kind, name, fields in kinds:
        topic = file.longest(name)
        values = None if topic is None else topic.column(*fields)
        if topic is None or values is None or not np.isfinite(values).any():
            continue
        # the validated speed is preferred unless the log holds hardly any of it
        if kind not in chosen or len(values) > 10 * len(chosen[kind][1]):
            chosen[kind] = topic, values
    magnetic = file.longest("vehicle_magnetometer") or file.longest("sensor_combined")
    field_ga = None if magnetic is None else magnetic.columns("magnetometer_ga")
    if magnetic is not None and field_ga is not None:
        chosen["magnetic_field"] = magnetic, field_ga
    return tuple(_aid(file, topic, kind, values) for kind, (topic, values) in chosen.items())


def _aid(file: UlogFile, topic: Topic, kind: AidKind, values: Array) -> AidLog:
    file.used(topic)
    return AidLog(
        time=topic.time,
        scale="boot",
        source=f"{file.path}: {topic.name}",
        kind=kind,
        value=values,
        sigma=unknown(len(values)),
    )


def _events(file: UlogFile) -> tuple[EventLog, ...]:
    """Captures that the camera confirmed, and commands; each frame of a log stands once."""
    out = []
    capture, trigger = file.longest("camera_capture"), file.longest("camera_trigger")
    answered = False
    if capture is not None:
        result = np.nan_to_num(capture.or_nan("result"), nan=-1.0)
        if np.any(result == 0):
            file.doubts.append(f"{capture.name}: {np.sum(result == 0)} captures failed (result 0)")
        if capture.columns("q", 4) is not None:
            file.doubts.append(
                f"{capture.name}: its attitude is not used, the meaning of q differs between "
                "versions of PX4; the attitude of the vehicle is in vehicle_attitude"
            )
        for kind, rows in (("feedback", result == 1), ("trigger", result < 0)):
            if rows.any():
                out.append(_event(file, capture, kind, rows))
        answered = True
    if trigger is not None:
        feedback = np.nan_to_num(trigger.or_nan("feedback")) > 0
        if feedback.any() and not answered:
            out.append(_event(file, trigger, "feedback", feedback))
        # a capture without answer repeats the command
        if not feedback.all() and not any(log.kind == "trigger" for log in out):
            out.append(_event(file, trigger, "trigger", ~feedback))
    return tuple(out)


def _event(file: UlogFile, topic: Topic, kind: str, rows: BoolArray) -> EventLog:
    count = int(np.sum(rows))
    lat, lon = np.radians(topic.or_nan("lat")[rows]), np.radians(topic.or_nan("lon")[rows])
    file.used(topic)
    sigma = SIGMA_FEEDBACK if kind == "feedback" else SIGMA_TRIGGER
    return EventLog(
        time=topic.time[rows],
        scale="boot",
        source=f"{file.path}: {topic.name}",
        kind=kind,
        sequence=np.nan_to_num(topic.or_nan("seq"), nan=-1.0)[rows].astype(np.int64),
        sigma=np.full(count, sigma),
        lat=lat,
        lon=lon,
        height=topic.or_nan("alt")[rows],
        height_kind=HeightKind.ORTHOMETRIC,
        covariance_ned=unknown(count, 3, 3),
        rpy=unknown(count, 3),
        names=("",) * count,
        flags=np.nan_to_num(topic.or_nan("result"), nan=-1.0)[rows].astype(np.int64),
    )
