"""Flights with truth and observations, without pictures: what an adjustment is judged by.

The model and the words are in `flight_truth`; `oriented_photos` and `ties` at the end put the
measured values into the package's classes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from flight_making import fly
from flight_truth import (
    GPS_TAGS,
    R_BODY_FROM_CAM,
    RTK,
    TIGHT,
    TIGHT_SLOW,
    Array,
    Conditions,
    Line,
    NavigationModel,
    Relief,
    Shared,
    SimCamera,
    SimFlight,
    Surveyed,
    Truth,
    navigation_model,
    rotvec,
    shared_sigmas,
    turn,
)

from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import TiePoints

__all__ = [
    "GPS_TAGS", "RTK", "R_BODY_FROM_CAM", "TIGHT", "TIGHT_SLOW", "Conditions", "Line",
    "NavigationModel", "Relief", "Shared", "SimCamera", "SimFlight", "Surveyed", "Truth",
    "calibration_flight", "camera_of", "cross", "fly", "gps_only", "many", "marginal_covariance",
    "navigation_model", "one_height", "oriented_photos", "photo_ids", "pose_jacobian", "rotvec",
    "rtk", "serpentine", "shared_sigmas", "strip", "survey", "ties", "turn", "two_photos",
]  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Flights
# ---------------------------------------------------------------------------------------------


def serpentine(
    lines: int,
    photos_per_line: int,
    *,
    height: float = 90.0,
    speeds: tuple[float, float] = (15.0, 15.0),
    forward: float = 0.75,
    side: float = 0.6,
    course: float = math.radians(90.0),
    conditions: Conditions | None = None,
) -> list[Line]:
    """Parallel lines about (0, 0), there and back; speeds of odd and even lines, m/s.

    `forward` and `side` are the overlaps of neighbouring photos and lines over z = 0.
    """
    c = conditions or Conditions()
    spacing = (1 - forward) * height * c.height / c.focal
    apart = (1 - side) * height * c.width / c.focal
    way = np.array([math.sin(course), math.cos(course)])
    right = np.array([math.cos(course), -math.sin(course)])
    out = []
    for i in range(lines):
        back = i % 2 == 1
        half = (photos_per_line - 1) / 2 * spacing
        start = (i - (lines - 1) / 2) * apart * right + (half if back else -half) * way
        out.append(
            Line(
                start=(float(start[0]), float(start[1])),
                course=course + (math.pi if back else 0.0),
                height=height,
                speed=speeds[i % 2],
                spacing=spacing,
                n=photos_per_line,
            )
        )
    return out


# A narrow view over nearly flat ground and a smooth flight: what the reference does not state,
# chosen so that its standard deviations come out. Fast turns alone would tell the clock.
REFERENCE = {
    "width": 2700,
    "height": 1800,
    "relief": 1.5,
    "rate_deg_s": 0.5,
    "obs_per_photo": 382.0,
}


def calibration_flight(seed: int, *, slow: bool = False, **changes: object) -> SimFlight:
    """96 photos, crossed lines at 70 and 110 m, with and against a wind (15 and 22 m/s).

    The flight of the reference "One-step adjustment with Ceres": some 3 200 points, 37 000
    observations; navigation 0.05 m and 0.1/0.1/0.2 deg, independent from photo to photo, or with
    `slow` mostly slow with a correlation time of 30 s.
    """
    base = Conditions(
        navigation=TIGHT_SLOW if slow else TIGHT,
        sigmas=shared_sigmas(2.0, 0.5, 0.1, 0.05),
        **REFERENCE,  # type: ignore[arg-type]
    )
    c = replace(base, **changes)  # type: ignore[arg-type]
    lines: list[Line] = []
    for height in (70.0, 110.0):
        for course in (90.0, 0.0):
            # Both heights cover one square: spacings in m are those of 90 m.
            block = serpentine(4, 6, height=90.0, speeds=(15.0, 22.0), forward=0.57, side=0.57,
                               course=math.radians(course), conditions=c)  # fmt: skip
            lines += [replace(line, height=height) for line in block]
    return fly(seed, lines, c)


def one_height(seed: int, **changes: object) -> SimFlight:
    """The lower half of the calibration flight: 48 photos, one height."""
    base = Conditions(
        sigmas=shared_sigmas(2.0, 0.5, 0.1, 0.05),
        **REFERENCE,  # type: ignore[arg-type]
    )
    c = replace(base, **changes)  # type: ignore[arg-type]
    lines: list[Line] = []
    for course in (90.0, 0.0):
        lines += serpentine(4, 6, height=70.0, speeds=(15.0, 22.0), forward=0.64, side=0.64,
                            course=math.radians(course), conditions=c)  # fmt: skip
    return fly(seed, lines, c)


def survey(
    seed: int,
    lines: int = 4,
    photos_per_line: int = 8,
    *,
    height: float = 90.0,
    speeds: tuple[float, float] = (15.0, 15.0),
    forward: float = 0.75,
    side: float = 0.6,
    **changes: object,
) -> SimFlight:
    """Parallel lines at one height; `changes` are fields of `Conditions`."""
    c = Conditions(**changes)  # type: ignore[arg-type]
    plan = serpentine(
        lines, photos_per_line, height=height, speeds=speeds, forward=forward, side=side,
        conditions=c,
    )  # fmt: skip
    return fly(seed, plan, c)


def strip(seed: int, n: int = 8, *, forward: float = 0.75, **changes: object) -> SimFlight:
    """One straight line."""
    return survey(seed, 1, n, forward=forward, **changes)  # type: ignore[arg-type]


def two_photos(seed: int, **changes: object) -> SimFlight:
    """Two overlapping photos."""
    return strip(seed, 2, **changes)


def gps_only(seed: int, lines: int = 4, photos_per_line: int = 8, **changes: object) -> SimFlight:
    """Navigation as tags give it: 0.7 m white and 2 m slow, 1 deg white and 3 deg slow."""
    base: dict[str, object] = {
        "navigation": GPS_TAGS,
        "sigmas": shared_sigmas(2.0, 0.1, 0.5, 0.05),
    }
    return survey(seed, lines, photos_per_line, **(base | changes))  # type: ignore[arg-type]


def rtk(seed: int, lines: int = 4, photos_per_line: int = 8, **changes: object) -> SimFlight:
    """RTK positions of 2 cm (3 cm in height) with an autopilot's attitude."""
    base: dict[str, object] = {
        "navigation": RTK,
        "sigmas": shared_sigmas(2.0, 0.02, 0.005, 0.005),
    }
    return survey(seed, lines, photos_per_line, **(base | changes))  # type: ignore[arg-type]


def many(
    seed: int, n_photos: int = 167, obs_per_photo: float = 3000.0, **changes: object
) -> SimFlight:
    """A large flight by tags, for timing; lines of some 17 photos."""
    per_line = min(n_photos, 17)
    c = Conditions(
        **({"navigation": GPS_TAGS, "obs_per_photo": obs_per_photo} | changes)  # type: ignore[arg-type]
    )
    plan = serpentine(-(-n_photos // per_line), per_line, conditions=c)
    plan[-1] = replace(plan[-1], n=n_photos - per_line * (len(plan) - 1))
    return fly(seed, plan, c)


# ---------------------------------------------------------------------------------------------
# Into the package's classes
# ---------------------------------------------------------------------------------------------


def cross(v: Array) -> Array:
    """Matrix of v x; shape (3,) -> (3, 3)."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def pose_jacobian(flight: SimFlight, i: int) -> Array:
    """Camera pose error (dp, dtheta) by (e_p, e_theta, boresight, lever, bias, clock); (6, 16).

    To first order, for errors of lever arm, boresight, bias and clock about `flight.shared`.
    """
    R, t = flight.R_nav[i], flight.truth
    arm = R @ flight.shared.lever
    J = np.zeros((6, 16))
    J[:3, 0:3], J[3:, 3:6], J[3:, 6:9] = np.eye(3), np.eye(3), R
    J[:3, 9:12], J[:3, 12:15] = R, -np.eye(3)
    J[3:, 15] = -t.rate[i]
    J[:3, 15] = -t.velocity[i]
    # The arm turns with the body, not with the boresight.
    for col in (3, 4, 5, 15):
        J[:3, col] += cross(J[3:, col]) @ arm
    return J


def marginal_covariance(flight: SimFlight, i: int) -> Array:
    """Covariance of the direct pose of photo i, mount, bias and clock included; (6, 6)."""
    m, s = flight.navigation, flight.sigmas
    variances = np.concatenate(
        [m.white**2 + m.slow**2, s.boresight**2, s.lever**2, s.bias**2, [s.clock**2]]
    )
    J = pose_jacobian(flight, i)
    out = J @ np.diag(variances) @ J.T
    return np.asarray((out + out.T) / 2)


def camera_of(flight: SimFlight, *, true: bool = False) -> Camera:
    """Nominal (or true) camera, with the sigmas of focal length and principal point."""
    c = flight.camera_true if true else flight.camera
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
    return Camera(
        id="sim",
        width=c.width,
        height=c.height,
        **{name: float(v) for name, v in zip(names, c.values, strict=True)},
        readout_s=c.readout_s,
        sigma_f=0.0 if true else float(flight.camera_sigma[0]),
        sigma_c=0.0 if true else float(flight.camera_sigma[2]),
    )


def photo_ids(flight: SimFlight) -> tuple[str, ...]:
    """Names of the photos in order of time."""
    return tuple(f"sim_{i:04d}" for i in range(flight.n_photos))


def oriented_photos(flight: SimFlight, *, true: bool = False) -> list[OrientedPhoto]:
    """Photos with nominal camera and navigation pose; with `true`, the truth."""
    camera, t = camera_of(flight, true=true), flight.truth
    shared = flight.shared_true if true else flight.shared
    R_body = t.R_enu_from_body if true else flight.R_nav
    p_imu = t.p_imu if true else flight.p_nav
    R_cam = R_body @ turn(shared.boresight) @ R_BODY_FROM_CAM
    arm = R_body @ shared.lever
    out = []
    for i, name in enumerate(photo_ids(flight)):
        pose = Pose(
            origin_enu=p_imu[i] + arm[i],
            R_enu_from_cam=R_cam[i],
            covariance=np.zeros((6, 6)) if true else marginal_covariance(flight, i),
            kind="navigation",
            velocity_enu=t.velocity[i] + np.cross(t.rate[i], arm[i]),
            rate_enu=t.rate[i],
        )
        photo = Photo(
            id=name,
            path=Path(name),
            width=camera.width,
            height=camera.height,
            camera_id=camera.id,
            time_gps=float(t.times[i]),
        )
        out.append(OrientedPhoto(photo=photo, camera=camera, pose=pose))
    return out


def ties(flight: SimFlight) -> TiePoints:
    """The observations, outliers among them."""
    return TiePoints(
        photo_ids=photo_ids(flight),
        photo=flight.photo.astype(np.int32),
        point=flight.point.astype(np.int32),
        uv=flight.uv,
        sigma=np.full(len(flight.uv), flight.noise_px),
    )
