"""What the logs of a flight say, as arrays: IMU, GNSS, attitude, events, and small aids.

A reader turns a file into a `FlightLogs`; nothing here is estimated. Missing numbers are NaN.
Body axes are forward, right, down; local level axes are north, east, down.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind

# "gps": s on the GPS scale since 1980-01-06. "boot": s since an unknown instant of the logger.
TimeScale = Literal["gps", "boot"]
IntArray = NDArray[np.int64]

# Quality of a fix: higher is better. RTKLIB's and NMEA's codes are turned into these by readers.
FIX_NONE, FIX_2D, FIX_SINGLE, FIX_DGNSS, FIX_PPP, FIX_FLOAT, FIX_FIXED = 0, 2, 3, 4, 5, 6, 7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedLog:
    """What every log has: times, their scale, the file, and what is doubtful in words."""

    time: Array
    scale: TimeScale = "gps"
    source: str = ""
    doubts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that every array has one row per time."""
        if self.time.ndim != 1:
            raise ValueError(f"{type(self).__name__}: time must be one row of numbers")
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray) and len(value) != len(self.time):
                raise ValueError(
                    f"{type(self).__name__}.{item.name} has {len(value)} rows for "
                    f"{len(self.time)} times"
                )

    def __len__(self) -> int:
        """Rows."""
        return len(self.time)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuLog(TimedLog):
    """Inertial samples: `gyro` rad/s and `accel` m/s2 (specific force), (n, 3), body axes."""

    gyro: Array
    accel: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GnssLog(TimedLog):
    """Fixes of the antenna.

    Parameters
    ----------
    lat, lon : rad
    height : m, of `height_kind`
    geoid_separation : m; the receiver's own, NaN where it states none
    v_ned : shape (n, 3), m/s
    covariance_ned, covariance_v_ned : shape (n, 3, 3), m^2 and m^2/s^2
    fix : quality, `FIX_NONE` .. `FIX_FIXED`
    satellites : number used, -1 where unknown
    """

    lat: Array
    lon: Array
    height: Array
    height_kind: HeightKind
    geoid_separation: Array
    v_ned: Array
    covariance_ned: Array
    covariance_v_ned: Array
    fix: IntArray
    satellites: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeLog(TimedLog):
    """Attitude that another filter states: `rpy` (n, 3) rad of body in ned; sigmas alike."""

    rpy: Array
    sigma_rpy: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventLog(TimedLog):
    """Exposures as a device noted them, in the order noted.

    Parameters
    ----------
    kind
        "feedback" (the shutter answered: hot shoe, time mark), "trigger" (the command only) or
        "sync_board".
    sequence
        The device's own counter, -1 where it has none; it may wrap.
    sigma : s, of the time
    lat, lon, height : rad, rad, m
        Place that the device noted; NaN where none.
    height_kind
        Of `height`.
    position_of
        "antenna", "camera" or "unknown".
    covariance_ned : shape (n, 3, 3), m^2
    rpy : shape (n, 3), rad, as the device states them
    names
        File names that the device noted, "" where none.
    flags
        The device's own flag or quality, -1 where none.
    """

    kind: str
    sequence: IntArray
    sigma: Array
    lat: Array
    lon: Array
    height: Array
    height_kind: HeightKind = HeightKind.UNKNOWN
    position_of: str = "unknown"
    covariance_ned: Array
    rpy: Array
    names: tuple[str, ...]
    flags: IntArray


AidKind = Literal["baro_height", "airspeed", "magnetic_field", "heading"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AidLog(TimedLog):
    """A small aid: barometric height m, true airspeed m/s, heading rad, or field (n, 3), body.

    `value` has shape (n,) or, for "magnetic_field", (n, 3) in any unit; `sigma` (n,) or NaN.
    """

    kind: AidKind
    value: Array
    sigma: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryLog(TimedLog):
    """A finished trajectory: of another program, of a reference, or of our own smoother.

    `lat`, `lon` rad and ellipsoidal `height` m are of the place that `position_of` names; `v_ned`
    (n, 3) m/s; `rpy` (n, 3) rad; `covariance` (n, 6, 6) of the error (dp_ned m, dtheta_ned rad),
    NaN where unknown.
    """

    lat: Array
    lon: Array
    height: Array
    v_ned: Array
    rpy: Array
    covariance: Array
    position_of: str = "imu"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightLogs:
    """Everything one or several log files hold; all None or empty where a file has none."""

    imu: ImuLog | None = None
    gnss: GnssLog | None = None
    attitude: AttitudeLog | None = None
    events: tuple[EventLog, ...] = ()
    aids: tuple[AidLog, ...] = ()
    trajectory: TrajectoryLog | None = None
    source: str = ""
    # name of the format, for people
    format: str = ""
    doubts: tuple[str, ...] = field(default=())


def unknown(count: int, *shape: int) -> Array:
    """Array of `count` missing values of a shape."""
    return np.full((count, *shape), np.nan)


def covariance_of_sigmas(sigma: Array) -> Array:
    """Diagonal covariances of sigmas; shape (n, k) -> (n, k, k)."""
    return np.asarray(sigma[..., None] ** 2 * np.eye(sigma.shape[-1]))
