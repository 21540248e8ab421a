"""Cameras, poses and photos, and what the tests of an adjustment ask of its answer."""

from __future__ import annotations

from pathlib import Path

import adjustment_flights as sim
import numpy as np
from adjustment_blocks import block_of, first_points
from numpy.typing import NDArray

from georef_gis.frames import exp_so3, log_so3
from georef_gis.geodesy import Origin
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import Block

Array = NDArray[np.float64]
ORIGIN = Origin(lat=0.68, lon=-1.4, height_ellipsoidal=0.0)
BROWN = Camera(
    id="c", width=1200, height=800, fx=900.0, fy=905.0, cx=611.0, cy=395.0, k1=-0.1, k2=0.03,
    k3=-0.004, p1=1e-3, p2=-7e-4,
)  # fmt: skip


def pose_at(*place: float, yaw: float = 0.3, tilt: float = 0.1, sigma: float = 0.05) -> Pose:
    """Pose over the ground, image top about north, turned by `yaw`."""
    R = exp_so3([tilt, 0.05, yaw]) @ np.diag([1.0, -1.0, -1.0])
    c = np.diag([sigma**2] * 3 + [(0.02 + sigma / 10) ** 2] * 3)
    return Pose(origin_enu=np.array(place), R_enu_from_cam=R, covariance=c)


def oriented(name: str, camera: Camera, pose: Pose, **tags: object) -> OrientedPhoto:
    photo = Photo(
        id=name, path=Path(name), width=camera.width, height=camera.height, camera_id=camera.id,
        **tags,  # type: ignore[arg-type]
    )  # fmt: skip
    return OrientedPhoto(photo=photo, camera=camera, pose=pose)


def adjusted(flight: sim.SimFlight, block: Block | None = None) -> Adjusted:
    block = block or block_of(flight)
    return adjust(block, first_points(flight, block))


def errors(flight: sim.SimFlight, answer: Adjusted) -> Array:
    """True less adjusted poses, (n, 6), m and rad in enu."""
    p = np.array([pose.origin_enu for pose in answer.poses])
    R = np.array([pose.R_enu_from_cam for pose in answer.poses])
    turned = log_so3(flight.truth.R_enu_from_cam @ np.swapaxes(R, 1, 2))
    return np.hstack([flight.truth.p_cam - p, turned])


def sigmas(answer: Adjusted) -> Array:
    return np.sqrt([np.diag(pose.covariance) for pose in answer.poses])
