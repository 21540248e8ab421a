"""Budget of a flight that was not flown: of a level photo, from the sigmas of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import InputError
from georef_gis.frames import R_BODY_FROM_CAM_NADIR, R_ENU_FROM_NED_SAME_PLACE, Array, exp_so3
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.budget.parts import FixedSplit, SourcedErrors
from georef_gis.measure.budget.shares import PointBudget, photo_budgets, point_budgets
from georef_gis.measure.locating import locate_points
from georef_gis.measure.scene import Scene
from georef_gis.model.camera import Camera
from georef_gis.model.control import Mark
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.ground_point import locate
from georef_gis.model.joint_errors import CameraErrors, JointErrors
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pixel_derivatives import CAMERA_UNKNOWNS
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

# Where a forecast is made does not matter: 50 deg north.
_PLACE = Origin(lat=np.radians(50.0), lon=0.0, height_ellipsoidal=0.0)
_ID = "forecast"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensors:
    """One sigma of all that places a point from one photo.

    Parameters
    ----------
    gnss, gnss_up : m
        Of the receiver, per axis.
    roll_pitch, yaw, boresight : rad
        Per axis.
    lever_arm : m
        Per axis.
    time : s
        Of the moment of exposure.
    focal, centre : px
        Of the focal length, and of the principal point per axis.
    ground : m
        Of the height of the ground.
    click : px
    """

    gnss: float = 0.0
    gnss_up: float = 0.0
    roll_pitch: float = 0.0
    yaw: float = 0.0
    boresight: float = 0.0
    lever_arm: float = 0.0
    time: float = 0.0
    focal: float = 0.0
    centre: float = 0.0
    ground: float = 0.0
    click: float = 0.0

    def __post_init__(self) -> None:
        """Check the range."""
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"sigma {value} must be a finite number >= 0", field=name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """How a vehicle moves: ground speed to the north, m/s; usual rates of roll and pitch, rad/s."""

    speed: float = 0.0
    rate: float = 0.0


def level_pose(height: float, *, tilt: float = 0.0) -> Pose:
    """Pose above the origin, m, the image top to the north; pitched up by `tilt`, rad."""
    R = R_ENU_FROM_NED_SAME_PLACE @ R_BODY_FROM_CAM_NADIR
    return Pose(
        origin_enu=np.array([0.0, 0.0, height]),
        R_enu_from_cam=exp_so3([tilt, 0.0, 0.0]) @ R,
        covariance=np.zeros((6, 6)),
    )


def _photo(camera: Camera, pose: Pose) -> OrientedPhoto:
    file = Photo(id=_ID, path=Path(_ID), width=camera.width, height=camera.height)
    return OrientedPhoto(photo=file, camera=camera, pose=pose)


def sensor_covariances(sensors: Sensors, motion: Motion) -> dict[str, Array]:
    """Covariance of the pose of a level photo flown to the north, by source; (6, 6) each."""
    s = sensors
    moved = [0.0, motion.speed, 0.0, motion.rate, motion.rate, 0.0]
    sigmas = {
        "gnss": [s.gnss, s.gnss, s.gnss_up, 0.0, 0.0, 0.0],
        "attitude": [0.0, 0.0, 0.0, s.roll_pitch, s.roll_pitch, s.yaw],
        "boresight": [0.0, 0.0, 0.0, s.boresight, s.boresight, s.boresight],
        "lever_arm": [s.lever_arm, s.lever_arm, s.lever_arm, 0.0, 0.0, 0.0],
        # rolling and pitching have nothing to do with each other, nor with the speed
        "time": [s.time * value for value in moved],
    }
    return {source: np.diag(np.square(values)) for source, values in sigmas.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast:
    """Budgets of places in a level photo, one sigma of a click in px."""

    scene: Scene
    errors: SourcedErrors
    click: float

    @classmethod
    def of(
        cls, camera: Camera, height: float, sensors: Sensors, motion: Motion | None = None
    ) -> Forecast:
        """Forecast of a camera that flies so many m over flat ground."""
        if height <= 0.0:
            raise InputError(f"height {height} m above the ground must be positive", field="height")
        parts = sensor_covariances(sensors, motion or Motion())
        covariance = np.asarray(sum(parts.values()))
        photo = _photo(camera, replace(level_pose(height), covariance=covariance))
        stack = PhotoStack.of([photo])
        sigma = np.zeros(CAMERA_UNKNOWNS)
        sigma[:3] = sensors.focal, sensors.centre, sensors.centre
        none = np.zeros(1, dtype=np.int64)
        cameras = CameraErrors(
            ids=(camera.id,), covariance=np.diag(sigma**2), sensor_of=none, turns=none
        )
        joint = JointErrors(stack, cameras=cameras)
        ground = FlatTerrain(origin=_PLACE, height_ellipsoidal=0.0, sigma=sensors.ground)
        frame = MapFrame(_PLACE, utm_crs(_PLACE.lat, _PLACE.lon))
        scene = Scene(
            frame=frame, terrain=ground, errors=joint, ground=GroundErrors.of(ground)
        )  # fmt: skip
        split = FixedSplit(by_source={source: part[None] for source, part in parts.items()})
        errors = SourcedErrors(errors=joint, kinds=none, splits=(split,))
        return cls(scene=scene, errors=errors, click=sensors.click)

    def at(self, uv: ArrayLike) -> PointBudget:
        """Budget of the place that a pixel (2,) shows."""
        u, v = (float(value) for value in np.asarray(uv))
        mark = Mark(name=_ID, photo=_ID, u=u, v=v, sigma_px=self.click)
        (budget,) = point_budgets(locate_points(self.scene, [mark]), self.errors)
        return budget

    def middle(self) -> PointBudget:
        """Budget of the place at the principal point."""
        camera = self.scene.photo(_ID).camera
        return self.at([camera.cx, camera.cy])

    def photo(self) -> PointBudget:
        """Mean over the photo."""
        (budget,), _ = photo_budgets(self.scene, [_ID], self.errors, click=self.click)
        return budget


def tilt_displacements(height: float, tilts: ArrayLike) -> Array:
    """How far the middle of a photo moves on flat ground when it is tilted; rad (n,) -> m (n,).

    Notes
    -----
    Figure 9 of Gu (2009): H tan(delta), here by the rays themselves.
    """
    ground = FlatTerrain(origin=_PLACE, height_ellipsoidal=0.0)
    camera = Camera(id="middle", width=3, height=3, fx=1.0, fy=1.0, cx=1.0, cy=1.0)
    out = []
    for tilt in np.asarray(tilts, dtype=np.float64):
        photo = _photo(camera, level_pose(height, tilt=float(tilt)))
        out.append(float(np.linalg.norm(locate(photo, [1.0, 1.0], ground)[:2])))
    return np.array(out)
