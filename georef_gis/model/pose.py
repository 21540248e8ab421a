"""Pose: the exterior orientation with its covariance; Mount: lever arms and boresight."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, Array, exp_so3

PoseKind = Literal["tags", "navigation", "adjusted"]


def _check_rotation(R: Array, name: str) -> None:
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9):
        raise ValueError(f"{name} is not a rotation matrix")
    if np.linalg.det(R) < 0:
        raise ValueError(f"{name} is a reflection: det = -1")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """Exterior orientation in the project's enu.

    `covariance` (6, 6), m and rad, is that of `(dp_enu, dtheta_enu)` with
    `p_true = origin_enu + dp_enu` and `R_true = Exp(dtheta_enu) @ R_enu_from_cam`. Its height is
    that above the ground, which scales distances; `sigma_height_shared`, m, one sigma, is that of
    a shift of camera and ground together, which moves no ray: see `sigma_height`.
    `height_kind` says in words what the height above the ellipsoid rests on.
    """

    origin_enu: Array
    R_enu_from_cam: Array
    covariance: Array
    kind: PoseKind = "tags"
    # m/s and rad/s, in enu; for a rolling shutter and a time offset
    velocity_enu: Array | None = None
    rate_enu: Array | None = None
    sigma_height_shared: float = 0.0
    height_kind: str = ""

    def __post_init__(self) -> None:
        """Check shapes, finiteness, det = +1 and the covariance."""
        if self.origin_enu.shape != (3,) or not np.all(np.isfinite(self.origin_enu)):
            raise ValueError("origin_enu must be three finite numbers, m")
        _check_rotation(self.R_enu_from_cam, "R_enu_from_cam")
        c = self.covariance
        if c.shape != (6, 6) or not np.all(np.isfinite(c)) or np.any(np.diag(c) < 0):
            raise ValueError("covariance must be a finite 6 x 6 matrix with a diagonal >= 0")
        if not (np.isfinite(self.sigma_height_shared) and self.sigma_height_shared >= 0):
            raise ValueError("sigma_height_shared must be a finite number >= 0, m")

    def cam_from_enu(self, p_enu: ArrayLike) -> Array:
        """Points in camera axes, m; shape (..., 3)."""
        return np.asarray((np.asarray(p_enu, float) - self.origin_enu) @ self.R_enu_from_cam)

    def enu_directions(self, d_cam: ArrayLike) -> Array:
        """Directions in enu of directions in camera axes; shape (..., 3)."""
        return np.asarray(np.asarray(d_cam, float) @ self.R_enu_from_cam.T)

    @property
    def sigma_height(self) -> float:
        """One sigma of the height above the ellipsoid, m: over the ground, and of the ground."""
        return float(np.hypot(np.sqrt(self.covariance[2, 2]), self.sigma_height_shared))

    @property
    def tilt(self) -> float:
        """Angle between the view axis and the vertical, rad; 0 = nadir."""
        return float(np.arccos(np.clip(-self.R_enu_from_cam[2, 2], -1.0, 1.0)))

    @property
    def image_up_azimuth(self) -> float:
        """Direction in which the top of the image lies, clockwise from enu north, rad."""
        up = -self.R_enu_from_cam[:, 1]
        if self.tilt > np.pi / 4:
            up = self.R_enu_from_cam[:, 2]
        return float(np.arctan2(up[0], up[1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mount:
    """How the camera and the antenna sit on the vehicle; body is forward, right, down.

    Lever arms run from the IMU, m. `R_body_from_cam = Exp(boresight_body) @ nominal`, rad.
    """

    id: str = "mount"
    lever_arm_body_camera: Array = field(default_factory=lambda: np.zeros(3))
    lever_arm_body_antenna: Array = field(default_factory=lambda: np.zeros(3))
    boresight_body: Array = field(default_factory=lambda: np.zeros(3))
    R_body_from_cam_nominal: Array = field(default_factory=lambda: R_BODY_FROM_CAM_NADIR.copy())
    # one sigma: m per axis, rad per axis
    sigma_lever_arm: float = 0.0
    sigma_boresight: float = 0.0

    def __post_init__(self) -> None:
        """Check shapes and det = +1."""
        for name in ("lever_arm_body_camera", "lever_arm_body_antenna", "boresight_body"):
            value = getattr(self, name)
            if value.shape != (3,) or not np.all(np.isfinite(value)):
                raise ValueError(f"mount {self.id}: {name} must be three finite numbers")
        _check_rotation(self.R_body_from_cam_nominal, "R_body_from_cam_nominal")

    @property
    def R_body_from_cam(self) -> Array:
        """Rotation from camera to body axes; shape (3, 3)."""
        return np.asarray(exp_so3(self.boresight_body) @ self.R_body_from_cam_nominal)

    @property
    def antenna_to_camera_body(self) -> Array:
        """From the antenna to the projection centre in body axes, m; shape (3,)."""
        return np.asarray(self.lever_arm_body_camera - self.lever_arm_body_antenna)
