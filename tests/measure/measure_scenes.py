"""A small scene to measure in: three photos over a slope, and the law of all their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array, exp_so3
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.measure.points import Mark
from georef_gis.measure.scene import Scene
from georef_gis.model.camera import Camera
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import CameraErrors, JointErrors, PoseSource
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose import Pose
from georef_gis.model.pose_errors import DenseErrors
from georef_gis.model.terrain import Terrain

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
# a State Plane CRS in US survey feet, whose north is 0.6 deg off
FRAME = MapFrame(ORIGIN, parse_crs("EPSG:6601"))
CAMERA = Camera(
    id="cam", width=4000, height=3000, fx=3000.0, fy=3000.0, cx=2010.0, cy=1490.0, k1=-0.05,
    k2=0.01, p1=4e-4, readout_s=0.03,
)  # fmt: skip
NADIR = np.diag([1.0, -1.0, -1.0])
IDS = ("A", "B", "C")
CENTRES = np.array([[-12.0, -5.0, 62.0], [11.0, -8.0, 60.0], [2.0, 15.0, 65.0]])
TURNS = np.array([[0.05, -0.03, 0.4], [-0.04, 0.06, 0.5], [0.08, 0.02, -2.6]])
VELOCITY, RATE = np.array([12.0, 3.0, 0.0]), np.array([0.02, -0.03, 0.05])
POSE_SIGMA = np.array([0.2, 0.2, 0.15, 0.003, 0.003, 0.006])
# f cx cy k1 k2 k3 p1 p2 b1 b2 readout
CAMERA_SIGMA = np.array([6.0, 3.0, 3.0, 0.004, 0.002, 0.0, 1e-4, 1e-4, 0.5, 0.3, 0.002])
GROUND_SHARED, GROUND_LOCAL, GROUND_LENGTH = 0.25, 0.2, 6.0
CLICK = 0.7


def pose_covariance() -> Array:
    """Of three poses: half of the variance is shared by all, and places hang on angles."""
    one = np.diag(POSE_SIGMA**2)
    one[0, 4] = one[4, 0] = 0.5 * POSE_SIGMA[0] * POSE_SIGMA[4]
    return np.kron(np.full((3, 3), 0.5) + 0.5 * np.eye(3), one)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slope:
    """Ground that falls by 10 % to the east and rises by 6 % to the north.

    Stated too low by `low` (k,) m about each of `places` (k, 3).
    """

    places: Array = field(default_factory=lambda: np.zeros((1, 3)))
    low: Array = field(default_factory=lambda: np.zeros(1))
    sigma: float = math.hypot(GROUND_SHARED, GROUND_LOCAL)
    detail: float = 2.0

    def _near(self, xy: Array) -> Array:
        apart = np.linalg.norm(xy[..., None, :] - self.places[:, :2], axis=-1)
        return np.asarray(self.low[np.argmin(apart, axis=-1)])

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate, m; (..., 2) -> (...)."""
        xy = np.asarray(xy_enu, float)
        return np.asarray(xy @ [-0.1, 0.06] - self._near(xy))

    def intersect(self, origin_enu: ArrayLike, d_enu: ArrayLike) -> Array:
        """Where rays meet it; (..., 3) m, NaN where they do not come down."""
        o, d = np.broadcast_arrays(np.asarray(origin_enu, float), np.asarray(d_enu, float))
        normal = np.array([0.1, -0.06, 1.0])
        low = np.zeros(o.shape[:-1])
        for _ in range(3):
            t = -(o @ normal + low) / (d @ normal)
            p = o + t[..., None] * d
            low = self._near(p[..., :2])
        return np.asarray(np.where((t > 0.0)[..., None], p, np.nan))

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Ellipsoidal height, m, at places of a map; (..., 2) -> (...)."""
        xy = np.asarray(xy_map, float)
        level = np.concatenate([xy, np.full((*xy.shape[:-1], 1), 277.6)], axis=-1)
        return np.asarray(277.6 + self.z_at(frame.enu_from_map(level)[..., :2]))


def oriented(
    errors: Array | None = None, camera_errors: Array | None = None
) -> list[OrientedPhoto]:
    """Photos whose poses (18,) and camera (11,) are off by errors: "true minus these"."""
    e = np.zeros((3, 6)) if errors is None else np.asarray(errors).reshape(3, 6)
    d = np.zeros(11) if camera_errors is None else camera_errors
    lens = dict(zip(("k1", "k2", "k3", "p1", "p2", "b1", "b2"), d[3:10], strict=True))
    camera = replace(
        CAMERA, fx=CAMERA.fx - d[0], fy=CAMERA.fy - d[0], cx=CAMERA.cx - d[1],
        cy=CAMERA.cy - d[2], readout_s=CAMERA.readout_s - d[10],
        **{name: getattr(CAMERA, name) - value for name, value in lens.items()},
    )  # fmt: skip
    sigma = np.zeros((18, 18)) if errors is None else pose_covariance()
    out = []
    for i, key in enumerate(IDS):
        pose = Pose(
            origin_enu=CENTRES[i] - e[i, :3],
            R_enu_from_cam=exp_so3(-e[i, 3:]) @ exp_so3(TURNS[i]) @ NADIR,
            covariance=sigma[6 * i : 6 * i + 6, 6 * i : 6 * i + 6],
            velocity_enu=VELOCITY,
            rate_enu=RATE,
        )
        photo = Photo(id=key, path=Path(f"{key}.jpg"), width=CAMERA.width, height=CAMERA.height)
        out.append(OrientedPhoto(photo=photo, camera=camera, pose=pose))
    return out


def scene(
    errors: Array | None = None, camera_errors: Array | None = None, terrain: Terrain | None = None
) -> Scene:
    """Scene that states the law of the errors; see `oriented`."""
    stack = PhotoStack.of(oriented(np.zeros(18) if errors is None else errors, camera_errors))
    cameras = CameraErrors(
        ids=("cam",), covariance=np.diag(CAMERA_SIGMA**2), sensor_of=np.zeros(3, dtype=np.int64),
        turns=np.zeros(3, dtype=np.int64),
    )  # fmt: skip
    source = PoseSource(photos=np.arange(3), errors=DenseErrors(matrix=pose_covariance()))
    ground = terrain or Slope()
    return Scene(
        frame=FRAME, terrain=ground, errors=JointErrors(stack, [source], cameras),
        ground=GroundErrors(terrain=ground, shared=GROUND_SHARED, length=GROUND_LENGTH),
    )  # fmt: skip


def marks_of(photos: Sequence[OrientedPhoto], places: dict[str, tuple[Array, str]]) -> list[Mark]:
    """Exact clicks of places, (3,) m, in the photos that a word names: "AB" is A and B."""
    by_id = {one.id: one for one in photos}
    out = []
    for name, (p, keys) in places.items():
        for key in keys:
            u, v = by_id[key].project(p)
            out.append(Mark(name=name, photo=key, u=float(u), v=float(v), sigma_px=CLICK))
    return out


def on_slope(e: float, n: float) -> Array:
    """Place on the ground, (3,) m."""
    return np.array([e, n, float(Slope().z_at(np.array([e, n])))])
