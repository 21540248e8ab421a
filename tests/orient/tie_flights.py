"""Photos of a painted plane for the tests of tie points: quick to make, with known truth."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from georef_gis.frames import R_ENU_FROM_NED_SAME_PLACE, R_ned_from_body, exp_so3
from georef_gis.geodesy import Origin
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import R_BODY_FROM_CAM_NADIR, Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tie_points import TiePoints

ORIGIN = Origin(lat=0.7, lon=-1.4, height_ellipsoidal=200.0)
GROUND = FlatTerrain(origin=ORIGIN, height_ellipsoidal=200.0, sigma=0.5)
CAMERA = Camera(
    id="test", width=640, height=480, fx=500.0, fy=500.0, cx=322.0, cy=236.5, k1=-0.05, k2=0.01
)
CELL = 0.1  # m, of the painted ground
SIDE = 3000  # cells
SIGMA_P, SIGMA_TILT, SIGMA_YAW = 1.5, np.radians(1.5), np.radians(3.0)

Change = Callable[[np.ndarray, int], np.ndarray]


@functools.cache
def painted_ground(seed: int = 0) -> np.ndarray:
    """Blotches of all sizes, as fields and gravel have them; shape (SIDE, SIDE), uint8."""
    rng = np.random.default_rng([5, seed])
    out = np.zeros((SIDE, SIDE), dtype=np.float32)
    for blur in (1.2, 3.0, 8.0, 25.0):
        n = max(int(SIDE / blur), 8)
        noise = rng.normal(size=(n, n)).astype(np.float32)
        out += cv2.resize(noise, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    return np.clip(120.0 + 22.0 * out, 0, 255).astype(np.uint8)


@functools.cache
def camera_rays() -> np.ndarray:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    return CAMERA.ray(np.stack([u, v], axis=-1))


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A camera over the plane: m, and deg; yaw clockwise from north."""

    x: float
    y: float
    height: float = 50.0
    yaw: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0

    @property
    def pose(self) -> Pose:
        R = R_ENU_FROM_NED_SAME_PLACE @ R_ned_from_body(
            *np.radians([self.roll, self.pitch, self.yaw])
        )
        covariance = np.diag([SIGMA_P**2] * 3 + [SIGMA_TILT**2] * 2 + [SIGMA_YAW**2])
        return Pose(
            origin_enu=np.array([self.x, self.y, self.height]),
            R_enu_from_cam=R @ R_BODY_FROM_CAM_NADIR,
            covariance=covariance,
        )


def strip(n: int, *, overlap: float = 0.6, yaw: float = 0.0, seed: int = 1) -> list[Shot]:
    """Shots one after the other along the short side of the picture, in light turbulence."""
    rng = np.random.default_rng([6, seed])
    base = (1.0 - overlap) * 50.0 * CAMERA.height / CAMERA.fy
    along = (np.arange(n) - (n - 1) / 2) * base
    turn = np.radians(yaw)
    return [
        Shot(
            x=float(s * np.sin(turn) + rng.normal()),
            y=float(s * np.cos(turn) + rng.normal()),
            height=50.0 + float(rng.normal()),
            yaw=yaw + float(2.0 * rng.normal()),
            roll=float(2.0 * rng.normal()),
            pitch=float(2.0 * rng.normal()),
        )
        for s in along
    ]


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Photos with their tags' poses, and the true ones."""

    photos: list[OrientedPhoto]
    truth: list[OrientedPhoto]

    def misses(self, ties: TiePoints) -> tuple[np.ndarray, np.ndarray]:
        """Distances, px, of observations from where the first photo's ray sees them, and sigmas."""
        first = np.r_[True, ties.point[1:] != ties.point[:-1]]
        others = np.flatnonzero(~first)
        start = np.flatnonzero(first)
        p = np.zeros((ties.n_points, 3))
        for i, photo in enumerate(self.truth):
            mine = start[ties.photo[start] == i]
            if len(mine):
                p[ties.point[mine]] = GROUND.intersect(*photo.rays(ties.uv[mine]))
        uv = np.zeros((len(others), 2))
        for i, photo in enumerate(self.truth):
            mine = ties.photo[others] == i
            uv[mine] = photo.project(p[ties.point[others[mine]]])
        start = start[ties.point[others]]
        sigma = np.hypot(ties.sigma[others], ties.sigma[start])
        return uv - ties.uv[others], sigma


def fly(
    folder: Path,
    shots: Sequence[Shot],
    *,
    seed: int = 2,
    change: Change | None = None,
    suffix: str = ".png",
    errors: float = 1.0,
) -> Flown:
    """Photos of the painted ground on disk, with poses that err by their sigmas.

    `change(picture, index)` may alter a picture, shape (rows, cols) float32.
    """
    rng = np.random.default_rng([7, seed])
    truth, photos = [], []
    for i, shot in enumerate(shots):
        path = folder / f"photo_{i:02d}{suffix}"
        photo = Photo(id=path.stem, path=path, width=CAMERA.width, height=CAMERA.height)
        true = OrientedPhoto(photo=photo, camera=CAMERA, pose=shot.pose)
        picture = picture_of(true) + rng.normal(0.0, 2.0, (CAMERA.height, CAMERA.width))
        if change is not None:
            picture = change(picture.astype(np.float32), i)
        save(path, picture)
        truth.append(true)
        photos.append(replace(true, pose=_tagged(shot.pose, errors * rng.normal(size=6))))
    return Flown(photos=photos, truth=truth)


def save(path: Path, picture: np.ndarray) -> None:
    kind = picture.dtype if picture.dtype == np.uint16 else np.uint8
    assert cv2.imwrite(str(path), np.clip(picture, 0, np.iinfo(kind).max).astype(kind))


def picture_of(photo: OrientedPhoto) -> np.ndarray:
    """What a photo sees of the painted ground; shape (rows, cols), float32."""
    o, d = photo.pose.origin_enu, photo.pose.enu_directions(camera_rays())
    p = o + d * (-o[2] / d[..., 2:])
    col = (p[..., 0] / CELL + SIDE / 2).astype(np.float32)
    row = (SIDE / 2 - p[..., 1] / CELL).astype(np.float32)
    ground = painted_ground()
    return cv2.remap(ground, col, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP).astype(
        np.float32
    )


def _tagged(pose: Pose, normal: np.ndarray) -> Pose:
    error = normal * np.sqrt(np.diag(pose.covariance))
    return replace(
        pose,
        origin_enu=pose.origin_enu - error[:3],
        R_enu_from_cam=exp_so3(-error[3:]) @ pose.R_enu_from_cam,
    )


def yaw_error(tagged: OrientedPhoto, true: OrientedPhoto) -> float:
    """Clockwise turn that takes the tagged heading to the true one, rad."""
    R = true.pose.R_enu_from_cam @ tagged.pose.R_enu_from_cam.T
    return float(-np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))
