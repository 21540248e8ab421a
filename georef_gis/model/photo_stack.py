"""Oriented photos as arrays: many points looked at by many photos at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from georef_gis.frames import Array, skew
from georef_gis.model.camera import ROWS_SETTLED, Camera
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pixel_derivatives import (
    CAMERA_NAMES,
    camera_jacobian,
    pose_jacobian,
    projection_jacobian,
)

Ints = NDArray[np.int64]
# rounds in which the row of a rolling shutter settles: each takes its error down by some 100
_ROUNDS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Views:
    """How pixels of m pairs of a photo and a point depend on what is unknown.

    Parameters
    ----------
    uv : shape (m, 2), px
        NaN where a photo does not see the point.
    by_point : shape (m, 2, 3), px/m
        In enu.
    by_pose : shape (m, 2, 6), px/m and px/rad
        By (dp_enu, dtheta_enu).
    by_camera : shape (m, 2, 11)
        By the unknowns of `CAMERA_NAMES`, in the axes of the picture as it is stored.
    """

    uv: Array
    by_point: Array
    by_pose: Array
    by_camera: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotoStack:
    """Oriented photos and, photo by photo, their poses as arrays.

    Parameters
    ----------
    photos
        K of them.
    number
        Photo id -> index.
    origin_enu, R_enu_from_cam : shapes (K, 3) m, (K, 3, 3)
    covariance : shape (K, 6, 6)
        Of each pose error alone.
    motion_cam : shape (K, 6)
        Velocity, m/s, and rate, rad/s, in camera axes; zero where not known or of no effect.
    cameras, camera_of : camera of each photo, shape (K,)
        Each camera once, as it stands in the photos.
    """

    photos: tuple[OrientedPhoto, ...]
    number: Mapping[str, int]
    origin_enu: Array
    R_enu_from_cam: Array
    covariance: Array
    motion_cam: Array
    cameras: tuple[Camera, ...]
    camera_of: Ints

    @classmethod
    def of(cls, photos: Iterable[OrientedPhoto]) -> PhotoStack:
        """Stack of photos, each id once."""
        chosen = tuple(photos)
        number = {photo.id: k for k, photo in enumerate(chosen)}
        if len(number) != len(chosen):
            raise ValueError("each photo once")
        cameras: dict[Camera, int] = {}
        camera_of = [cameras.setdefault(photo.camera, len(cameras)) for photo in chosen]
        motion = np.zeros((len(chosen), 6))
        for k, photo in enumerate(chosen):
            pose = photo.pose
            if photo.camera.readout_s == 0.0:
                continue
            for at, value in ((0, pose.velocity_enu), (3, pose.rate_enu)):
                if value is not None:
                    motion[k, at : at + 3] = value @ pose.R_enu_from_cam
        return cls(
            photos=chosen,
            number=number,
            origin_enu=np.array([p.pose.origin_enu for p in chosen]).reshape(-1, 3),
            R_enu_from_cam=np.array([p.pose.R_enu_from_cam for p in chosen]).reshape(-1, 3, 3),
            covariance=np.array([p.pose.covariance for p in chosen]).reshape(-1, 6, 6),
            motion_cam=motion,
            cameras=tuple(cameras),
            camera_of=np.array(camera_of, dtype=np.int64),
        )

    def __len__(self) -> int:
        """Number of photos."""
        return len(self.photos)

    def cam_from_enu(self, k: ArrayLike, p_enu: ArrayLike) -> Array:
        """Points in the axes of photos; (m,) and (m, 3) m -> (m, 3) m."""
        k, p = np.asarray(k), np.asarray(p_enu, float)
        return np.asarray(np.einsum("mij,mi->mj", self.R_enu_from_cam[k], p - self.origin_enu[k]))

    def project(self, k: ArrayLike, p_enu: ArrayLike) -> Array:
        """Pixels of points in photos; (m,) and (m, 3) m -> (m, 2) px, NaN where unseen."""
        k = np.asarray(k)
        p = self.cam_from_enu(k, p_enu)
        return self._by_camera(k, lambda camera, at: self._seen(camera, k[at], p[at]), (2,))

    def _seen(self, camera: Camera, k: Ints, p_cam: Array) -> Array:
        uv = camera.project(p_cam)
        if camera.readout_s == 0.0 or not np.any(self.motion_cam[k]):
            return uv
        # As `Camera.project` does for one photo: the scene moves against the camera.
        move = self._move(k, p_cam)
        for _ in range(_ROUNDS):
            before, t = uv, camera.row_time(uv[:, 1])
            uv = camera.project(p_cam - t[:, None] * move)
            if not np.any(np.abs(uv - before) > ROWS_SETTLED):
                break
        return uv

    def rays(self, k: ArrayLike, uv: ArrayLike) -> tuple[Array, Array]:
        """Where rays of pixels start, m, and their unit directions, in enu; (m, 3) each."""
        k, uv = np.asarray(k), np.asarray(uv, float)
        d = self._by_camera(k, lambda camera, at: camera.ray(uv[at]), (3,))
        start = np.zeros_like(d)
        moving = np.any(self.motion_cam[k], axis=1)
        if np.any(moving):
            t = self._row_time(k, uv)[moving]
            motion = self.motion_cam[k[moving]]
            # see `OrientedPhoto.rays`
            turn = np.linalg.inv(np.eye(3) - t[:, None, None] * skew(motion[:, 3:]))
            start[moving] = np.einsum("mij,mj->mi", turn, t[:, None] * motion[:, :3])
            turned = np.einsum("mij,mj->mi", turn, d[moving])
            d[moving] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        R = self.R_enu_from_cam[k]
        origin = self.origin_enu[k] + np.einsum("mij,mj->mi", R, start)
        return origin, np.asarray(np.einsum("mij,mj->mi", R, d))

    def contains(self, k: ArrayLike, uv: ArrayLike) -> NDArray[np.bool_]:
        """Whether pixels lie in their photos; (m,) and (m, 2) -> (m,)."""
        uv = np.asarray(uv, float)
        size = np.array([[c.width, c.height] for c in self.cameras])[self.camera_of[np.asarray(k)]]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.all((uv >= -0.5) & (uv < size - 0.5), axis=1))

    def views(self, k: ArrayLike, p_enu: ArrayLike) -> Views:
        """Pixels of points in photos, and their derivatives; (m,) and (m, 3) m.

        The derivatives by point and pose leave out that the readout goes on while a row moves: a
        share of some 1e-2 of them at most.
        """
        k, p = np.asarray(k), np.asarray(p_enu, float)
        uv = self.project(k, p)
        move = self._move(k, self.cam_from_enu(k, p))
        # where the camera sees the point when the row is read
        p_cam = self.cam_from_enu(k, p) - self._row_time(k, uv)[:, None] * move
        J_cam = self._by_camera(k, lambda c, at: projection_jacobian(c, p_cam[at]), (2, 3))
        by_point = J_cam @ np.swapaxes(self.R_enu_from_cam[k], 1, 2)
        by_camera = self._by_camera(
            k, lambda c, at: camera_jacobian(c, p_cam[at]), (2, len(CAMERA_NAMES))
        )
        share = self._row_share(k, uv)
        by_camera[:, :, -1] = -share[:, None] * np.einsum("mij,mj->mi", J_cam, move)
        return Views(
            uv=uv,
            by_point=by_point,
            by_pose=pose_jacobian(by_point, p - self.origin_enu[k]),
            by_camera=by_camera,
        )

    def _move(self, k: Ints, p_cam: Array) -> Array:
        """How points move in camera axes while a photo is read, backwards, m/s; (m, 3)."""
        motion = self.motion_cam[k]
        return np.asarray(motion[:, :3] + np.cross(motion[:, 3:], p_cam))

    def _row_share(self, k: Ints, uv: Array) -> Array:
        """When rows are read, from -1/2 for the first one to 1/2; (m,)."""
        rows = np.array([max(c.height - 1, 1) for c in self.cameras])[self.camera_of[k]]
        return np.asarray(uv[:, 1] / rows - 0.5)

    def _row_time(self, k: Ints, uv: Array) -> Array:
        """When rows are read, s from the middle of the readout; (m,)."""
        readout = np.array([c.readout_s for c in self.cameras])[self.camera_of[k]]
        return np.asarray(self._row_share(k, uv) * readout)

    def _by_camera(
        self, k: Ints, what: Callable[[Camera, Ints], Array], shape: tuple[int, ...]
    ) -> Array:
        """Values of pairs, (m, *shape), camera by camera."""
        out = np.full((len(k), *shape), np.nan)
        if len(self.cameras) == 1:
            return what(self.cameras[0], np.arange(len(k))) if len(k) else out
        for c in np.unique(self.camera_of[k]):
            at = np.flatnonzero(self.camera_of[k] == c)
            out[at] = what(self.cameras[c], at)
        return out
