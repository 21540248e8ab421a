"""Photos of a painted plane from four sides, to match clicks in; each pixel's truth is known."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from georef_gis.frames import Array, exp_so3
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.measure.points import Mark
from georef_gis.measure.scene import Scene
from georef_gis.model.camera import Camera
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import JointErrors, PoseSource
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose import Pose
from georef_gis.model.pose_errors import DenseErrors
from georef_gis.model.terrain import FlatTerrain

ORIGIN = Origin(lat=math.radians(39.1), lon=math.radians(-80.5), height_ellipsoidal=250.0)
FRAME = MapFrame(ORIGIN, parse_crs("EPSG:32617"))
GROUND = FlatTerrain(origin=ORIGIN, height_ellipsoidal=250.0, sigma=0.3)
CAMERA = Camera(id="cam", width=480, height=360, fx=500.0, fy=500.0, cx=243.0, cy=176.0, k1=-0.04)
NADIR = np.diag([1.0, -1.0, -1.0])
# m; of the painted plane, whose middle is the origin
CELL, SIDE = 0.02, 3000
# m and rad; one sigma of each pose
POSE_SIGMA = np.array([0.03, 0.03, 0.03, 0.0008, 0.0008, 0.0008])
CLICK = 0.5
# m; places of the plane: east and north of the middle of each part
BLANK, EDGE, DASHES = (-8.0, -4.0), (8.0, -4.0), (0.0, 7.0)
# m; from one dash to the next, which lie along east
PERIOD = 1.0


@functools.cache
def painted_plane() -> np.ndarray:
    """Gravel, and on it a blank slab, an edge, and a row of dashes; (SIDE, SIDE, 3), float32."""
    rng = np.random.default_rng(31)
    grey = np.zeros((SIDE, SIDE), dtype=np.float32)
    for cell in (0.06, 0.15, 0.5, 2.0):
        n = round(SIDE * CELL / cell)
        noise = rng.normal(size=(n, n)).astype(np.float32)
        grey += cv2.resize(noise, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    out = 115.0 + 14.0 * grey[..., None] * np.array([1.0, 0.95, 0.8], dtype=np.float32)
    half = SIDE * CELL / 2
    e = (np.arange(SIDE) + 0.5) * CELL - half
    east, north = np.meshgrid(e, -e)
    for (x, y), size in ((BLANK, 3.0), (EDGE, 3.0), (DASHES, 12.0)):
        inside = (np.abs(east - x) < size) & (np.abs(north - y) < 3.0)
        out[inside] = 90.0
    out[(np.abs(east - EDGE[0]) < 3.0) & (north > EDGE[1]) & (north < EDGE[1] + 3.0)] = 190.0
    dash = (np.abs(east - DASHES[0]) < 12.0) & (np.abs(north - DASHES[1]) < 0.15)
    out[dash & (np.mod(east, PERIOD) < PERIOD / 2)] = 210.0
    return np.asarray(out, dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """A camera over the plane: m; turned by `yaw` and leaning, deg."""

    east: float
    north: float
    height: float = 25.0
    yaw: float = 0.0
    lean: tuple[float, float] = (0.0, 0.0)

    @property
    def R_enu_from_cam(self) -> Array:
        """Rotation of the camera's axes."""
        turn = exp_so3(np.array([0.0, 0.0, math.radians(self.yaw)]))
        return np.asarray(turn @ exp_so3(np.radians([*self.lean, 0.0])) @ NADIR)


# from four sides, two of them upside down against each other, at different heights
SHOTS = (
    Shot(east=0.0, north=0.0, lean=(2.0, -3.0)),
    Shot(east=6.0, north=1.0, height=26.0, yaw=4.0, lean=(-3.0, 2.0)),
    Shot(east=-5.0, north=2.0, height=24.0, yaw=92.0, lean=(3.0, 3.0)),
    Shot(east=1.0, north=-6.0, height=27.0, yaw=181.0, lean=(4.0, -2.0)),
    Shot(east=-3.0, north=5.0, height=23.0, yaw=268.0, lean=(-2.0, -4.0)),
)
IDS = tuple(f"P{i}" for i in range(len(SHOTS)))


def oriented(errors: Array | None = None) -> list[OrientedPhoto]:
    """Photos whose stated poses are off by errors (5, 6): "true minus these"."""
    e = np.zeros((len(SHOTS), 6)) if errors is None else errors
    out = []
    for i, shot in enumerate(SHOTS):
        pose = Pose(
            origin_enu=np.array([shot.east, shot.north, shot.height]) - e[i, :3],
            R_enu_from_cam=exp_so3(-e[i, 3:]) @ shot.R_enu_from_cam,
            covariance=np.diag(POSE_SIGMA**2),
        )
        photo = Photo(id=IDS[i], path=Path(f"{IDS[i]}.png"), width=CAMERA.width,
                      height=CAMERA.height)  # fmt: skip
        out.append(OrientedPhoto(photo=photo, camera=CAMERA, pose=pose))
    return out


TRUE = oriented()


def scene(errors: Array | None = None) -> Scene:
    """Scene that states the law of the errors of its poses."""
    stack = PhotoStack.of(oriented(errors))
    law = DenseErrors(matrix=np.kron(np.eye(len(SHOTS)), np.diag(POSE_SIGMA**2)))
    source = PoseSource(photos=np.arange(len(SHOTS)), errors=law)
    return Scene(frame=FRAME, terrain=GROUND, errors=JointErrors(stack, [source]),
                 ground=GroundErrors.of(GROUND))  # fmt: skip


@functools.cache
def picture(photo_id: str) -> np.ndarray:
    """Photo of the plane, each with its own light, blur and noise; (rows, cols, 3), uint8."""
    i = IDS.index(photo_id)
    # exact rays every 8 px: linear between them is good to 0.001 px
    step, fine = 8, 3
    v, u = np.mgrid[-1 : CAMERA.height // step + 2, -1 : CAMERA.width // step + 2] * float(step)
    p = GROUND.intersect(*TRUE[i].rays(np.stack([u, v], axis=-1).reshape(-1, 2)))
    y, x = np.mgrid[: CAMERA.height * fine, : CAMERA.width * fine].astype(np.float32)
    nodes = [((c + 0.5) / fine - 0.5) / step + 1.0 for c in (x, y)]
    half = SIDE * CELL / 2
    col, row = (
        cv2.remap(node.reshape(u.shape).astype(np.float32), *nodes, cv2.INTER_LINEAR)
        for node in ((p[:, 0] + half) / CELL - 0.5, (half - p[:, 1]) / CELL - 0.5)
    )
    seen = cv2.remap(painted_plane(), col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    small = cv2.resize(seen, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.5 + 0.1 * i)
    gain, level = 1.0 - 0.08 * i, 6.0 * i
    rng = np.random.default_rng([32, i])
    noisy = gain * small + level + rng.normal(0.0, 2.0, small.shape)
    return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)


def true_pixel(photo_id: str, east: float, north: float) -> Array:
    """Pixel of a place of the plane; (2,)."""
    z = float(GROUND.z_at(np.array([east, north])))
    return np.asarray(TRUE[IDS.index(photo_id)].project(np.array([east, north, z])))


def place_of(photo_id: str, uv: Array) -> Array:
    """Place of the plane, (3,) m, that a pixel shows."""
    return np.asarray(GROUND.intersect(*TRUE[IDS.index(photo_id)].rays(uv)))


def click(photo_id: str, uv: Sequence[float] | Array, sigma_px: float = CLICK) -> Mark:
    """Mark of a pixel."""
    return Mark(name="x", photo=photo_id, u=float(uv[0]), v=float(uv[1]), sigma_px=sigma_px)


@dataclass(slots=True)
class Places:
    """Random pixels of the first photo on gravel, away from what was painted on it."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(33))

    def __next__(self) -> tuple[Array, Array]:
        """Pixel and place."""
        while True:
            uv = self.rng.uniform([60.0, 50.0], [420.0, 310.0])
            p = place_of(IDS[0], uv)
            painted = ((BLANK, 3.0), (EDGE, 3.0), (DASHES, 12.0))
            if all(abs(p[0] - x) > s + 1.0 or abs(p[1] - y) > 4.0 for (x, y), s in painted):
                return uv, p
