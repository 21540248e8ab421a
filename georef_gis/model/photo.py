"""Photo as it came from the file, and OrientedPhoto, which knows where it looks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array, skew
from georef_gis.geodesy import Height
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose

PositionOf = Literal["antenna", "camera", "unknown"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Geotag:
    """Position that a photo's tags or a pose file state; lat, lon in rad, sigmas in m."""

    lat: float
    lon: float
    height: Height | None = None
    sigma_h: float | None = None
    sigma_v: float | None = None
    of: PositionOf = "unknown"
    datum: str = "unknown"
    source: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeTag:
    """Angles of a dialect, rad, as the dialect means them (see `docs/frames.md`).

    `yaw` is None where the tags state none; sigmas are one standard deviation, rad.
    """

    dialect: str
    roll: float
    pitch: float
    yaw: float | None
    sigma_roll_pitch: float | None = None
    sigma_yaw: float | None = None
    # the vehicle's own yaw beside a gimbal's, rad
    vehicle_yaw: float | None = None
    # whether yaw is a course over ground, so off by the crab angle
    yaw_is_course: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Photo:
    """A photo and what its file says; nothing here is estimated.

    `camera_clock` is naive, with its resolution in s; `time_gps` is float seconds on the GPS
    scale since the project's epoch. Heights above ground or take-off are in m.
    """

    id: str
    path: Path
    width: int
    height: int
    camera_id: str = ""
    flight_id: str = "flight"
    mount_id: str = "mount"
    bands: int = 3
    camera_clock: datetime | None = None
    clock_resolution_s: float = 1.0
    time_gps: float | None = None
    time_sigma: float | None = None
    time_source: str = ""
    match_confidence: float | None = None
    geotag: Geotag | None = None
    attitude: AttitudeTag | None = None
    height_above_takeoff: float | None = None
    height_above_ground: float | None = None
    # course over ground, clockwise from true north, rad
    course: float | None = None
    ground_speed: float | None = None
    make: str = ""
    model: str = ""
    software: str = ""
    tags: Mapping[str, str | float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the size."""
        if self.width < 1 or self.height < 1:
            raise ValueError(f"photo {self.id}: size {self.width} x {self.height} px")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrientedPhoto:
    """A photo with its camera and its pose."""

    photo: Photo
    camera: Camera
    pose: Pose

    @property
    def id(self) -> str:
        """The photo's id."""
        return self.photo.id

    def project(self, p_enu: ArrayLike) -> Array:
        """Pixels of ground points; shape (..., 3) m in enu -> (..., 2) px, NaN where unseen."""
        pose = self.pose
        v = pose.velocity_enu @ pose.R_enu_from_cam if pose.velocity_enu is not None else None
        w = pose.rate_enu @ pose.R_enu_from_cam if pose.rate_enu is not None else None
        return self.camera.project(pose.cam_from_enu(p_enu), velocity_cam=v, rate_cam=w)

    def ray(self, uv: ArrayLike) -> Array:
        """Unit directions in enu of pixels; shape (..., 2) px -> (..., 3)."""
        return self.rays(uv)[1]

    def rays(self, uv: ArrayLike) -> tuple[Array, Array]:
        """Where the rays of pixels start, m, and their unit directions, both in enu.

        The inverse of `project`: with a rolling shutter each row has its own start.

        Parameters
        ----------
        uv : shape (..., 2), px

        Returns
        -------
        origins_enu, d_enu : shape (..., 3)
        """
        uv = np.asarray(uv, dtype=np.float64)
        pose, camera = self.pose, self.camera
        d_cam = camera.ray(uv)
        moves = pose.velocity_enu is not None or pose.rate_enu is not None
        if camera.readout_s == 0.0 or not moves:
            d_enu = pose.enu_directions(d_cam)
            return np.broadcast_to(pose.origin_enu, d_enu.shape), d_enu
        t = camera.row_time(uv[..., 1])[..., None]
        still = np.zeros(3)
        v = still if pose.velocity_enu is None else pose.velocity_enu @ pose.R_enu_from_cam
        w = still if pose.rate_enu is None else pose.rate_enu @ pose.R_enu_from_cam
        # `project` sees s d = p - t (v + w x p), so p = (1 - t [w])^-1 (t v + s d).
        turn = np.linalg.inv(np.eye(3) - t[..., None] * skew(w))
        start = np.einsum("...ij,...j->...i", turn, t * v)
        d = np.einsum("...ij,...j->...i", turn, d_cam)
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        return pose.origin_enu + pose.enu_directions(start), pose.enu_directions(d)

    def contains(self, uv: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether pixels lie in the image; shape (..., 2) -> (...)."""
        uv = np.asarray(uv, float)
        u, v = uv[..., 0], uv[..., 1]
        with np.errstate(invalid="ignore"):
            return np.asarray(
                (u >= -0.5) & (v >= -0.5) & (u < self.camera.width - 0.5)
                & (v < self.camera.height - 0.5)
            )  # fmt: skip
