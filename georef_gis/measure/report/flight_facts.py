"""The flight as the report page draws it: of a trajectory, else of the photos' own poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.ellipsoid import Origin
from georef_gis.frames import (
    R_BODY_FROM_CAM_NADIR,
    R_ENU_FROM_NED_SAME_PLACE,
    Array,
    exp_so3,
    rpy_from_R_ned_from_body,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.model.logs import TrajectoryLog, unknown
from georef_gis.model.pose import Pose

SINCE_START = "Time since start (s)"
# s without a row from which a trajectory at 10 Hz has a gap
GAP = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixDifferences:
    """Raw fixes less the smoothed trajectory at the antenna.

    Parameters
    ----------
    time : shape (n,), s
    apart, sigma : shape (n, 3), m
        North, east, down; sigma as the receiver states it, NaN where it does not.
    delay : s
        By which the fixes are late against the trajectory; taken out of `apart`. 0 = not sure.
    """

    time: Array
    apart: Array
    sigma: Array
    delay: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flown:
    """A flight over time.

    Parameters
    ----------
    log
        Rows of the IMU, or of the photos' cameras.
    of_photos
        Whether the rows are photos: between them nothing is known.
    exposures : s
        On the scale of `log.time`.
    outside
        Photos that have no place on it.
    axis
        What the rows are told apart by: `SINCE_START`, or the number of the photo.
    series
        What is drawn over time, by name, the raw fixes among them.
    notes
        What could not be shown, a line each.
    """

    log: TrajectoryLog
    of_photos: bool
    exposures: Array
    outside: tuple[str, ...] = ()
    axis: str = SINCE_START
    series: Mapping[str, TrajectoryLog] = field(default_factory=dict)
    fixes: FixDifferences | None = None
    notes: tuple[str, ...] = ()

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Begin and end of the parts without rows, s; none between photos."""
        if self.of_photos:
            return []
        at = np.flatnonzero(np.diff(self.log.time) > GAP)
        return [(float(self.log.time[i]), float(self.log.time[i + 1])) for i in at]


def flight_of_photos(facts: Facts, notes: Sequence[str] = ()) -> Flown | None:
    """Flight by the poses of the photos in the order of their times; None without any."""
    if not facts.direct:
        return None
    order, x, by_time = in_flight_order(facts, list(facts.direct))
    series = {"direct poses": _log(facts, facts.direct, order, x)}
    both = [key for key in order if key in facts.adjusted]
    if both:
        at = x[[key in facts.adjusted for key in order]]
        series["adjusted poses"] = _log(facts, facts.adjusted, both, at)
    outside = tuple(str(p["photo_id"]) for p in facts.photos if p["photo_id"] not in facts.direct)
    return Flown(
        log=series["direct poses"], of_photos=True, exposures=x, outside=outside, series=series,
        axis="Time since the first photo (s)" if by_time else "Photos after the first",
        notes=tuple(notes),
    )  # fmt: skip


def in_flight_order(facts: Facts, keys: Sequence[str]) -> tuple[list[str], Array, bool]:
    """Photos by time where all have one, else as they are; their place on an axis; if that is s."""
    times = {str(row["photo_id"]): row["time_gps"] for row in facts.photos}
    known = [times.get(key) for key in keys]
    numbers = np.arange(1.0, len(keys) + 1.0)
    if any(t is None for t in known) or len(set(known)) < len(keys):
        return list(keys), numbers, False
    order = sorted(keys, key=lambda key: float(times[key]))
    t = np.array([float(times[key]) for key in order])
    # several flights, or a long break: most of a true axis would be empty
    if np.ptp(t) > 3600.0 or (len(t) > 1 and np.max(np.diff(t)) > 0.5 * np.ptp(t) > 0):
        return order, numbers, False
    return order, t - t[0], True


def _log(facts: Facts, poses: Mapping[str, Pose], keys: Sequence[str], x: Array) -> TrajectoryLog:
    """Poses as rows; the attitude of an aircraft whose camera looks straight down."""
    turned = facts.turned["adjusted" if poses is facts.adjusted else "direct"]
    origin = facts.frame.origin
    own = [poses[key] for key in keys]
    geo = origin.geo_from_enu(np.array([pose.origin_enu for pose in own]))
    R = np.array(
        [_R_ned_from_body(pose, turned.get(key, 0)) for key, pose in zip(keys, own, strict=True)]
    )
    swap = np.kron(np.eye(2), R_ENU_FROM_NED_SAME_PLACE.T)
    covariance = np.array([swap @ pose.covariance @ swap.T for pose in own])
    return TrajectoryLog(
        time=x, source="poses of the photos", lat=geo[:, 0], lon=geo[:, 1], height=geo[:, 2],
        v_ned=unknown(len(x), 3), rpy=rpy_from_R_ned_from_body(R), covariance=covariance,
        position_of="camera",
    )  # fmt: skip


def _R_ned_from_body(pose: Pose, turned_deg: int) -> Array:
    """Attitude behind a pose; the quarter turns of its pixels say nothing of the aircraft."""
    quarters = exp_so3([0.0, 0.0, np.radians(turned_deg)])
    R_enu_from_body = pose.R_enu_from_cam @ quarters @ R_BODY_FROM_CAM_NADIR.T
    return np.asarray(R_ENU_FROM_NED_SAME_PLACE.T @ R_enu_from_body)


def enu_of(log: TrajectoryLog, origin: Origin) -> Array:
    """Places of the rows in enu, m; shape (n, 3)."""
    return np.asarray(origin.enu_from_geo(np.stack([log.lat, log.lon, log.height], axis=-1)))
