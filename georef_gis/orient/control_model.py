"""Where control points show in photos, and how marks, poses, camera and points hang together.

Unknowns are the errors of poses (6 each, joint where given), of cameras (focal length, principal
point, lens distortion), of the points, and of one shift of all points together, so that what a
photo's or the whole flight's marks have in common is not held against any one of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array, exp_so3, skew
from georef_gis.model.camera import Camera
from georef_gis.model.control import ControlObservations
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain
from georef_gis.model.tie_points import Indices

# One sigma of k1, k2, p1 and p2 where no calibration states them (consumer lenses have k1, k2 of
# some 0.1), and where one does.
_SIGMA_LENS = (0.1, 0.1, 0.001, 0.001)
_SIGMA_CALIBRATED = (0.01, 0.01, 0.0002, 0.0002)
# m; relief that a flat ground does not know, for points without height
_RELIEF = 10.0
# a step beyond this is one of a search that fails
_MOST_LENS = 0.5
_CAMERA_STEPS = {"f": 0.1, "cx": 0.1, "cy": 0.1, "k1": 1e-5, "k2": 1e-5, "p1": 1e-6, "p2": 1e-6}
_CAMERA_TERMS = len(_CAMERA_STEPS)

JointCovariance = tuple[Sequence[str], Array]
Numbers = NDArray[np.integer[Any]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedPixels:
    """Where points show, for every pair of a point and a photo that shows it.

    Parameters
    ----------
    photo_ids, point : shape (k,)
        Photo and index of the point of each pair.
    uv : shape (k, 2), px
    covariance : shape (k, 2, 2), px^2
        Of pose, camera, point and datum; a click's own error is not in it.
    """

    photo_ids: tuple[str, ...]
    point: Indices
    uv: Array
    covariance: Array

    @property
    def axes(self) -> Array:
        """Standard ellipses: one sigma along the longer and the shorter axis; shape (k, 2), px."""
        values = np.linalg.eigvalsh(self.covariance) if len(self.uv) else np.zeros((0, 2))
        return np.asarray(np.sqrt(np.maximum(values[:, ::-1], 0.0)))


def prior_sigmas(control: ControlObservations, terrain: Terrain) -> Array:
    """One sigma of every point, m; that of the ground where there is no height; shape (n, 3)."""
    bare = float(np.hypot(terrain.sigma, _RELIEF if np.isinf(terrain.detail) else 0.0)) or _RELIEF
    return np.where(np.isfinite(control.sigma), control.sigma, bare)


def predict_pixels(
    photos: Mapping[str, OrientedPhoto], control: ControlObservations, terrain: Terrain
) -> PredictedPixels:
    """Pixels of all points in all photos whose image they fall into, by the poses alone."""
    sigma = prior_sigmas(control, terrain)
    keys: list[str] = []
    points, uvs, covariances = [], [], []
    for key, photo in photos.items():
        uv = photo.project(control.p_enu)
        seen = np.flatnonzero(photo.contains(uv))
        if not len(seen):
            continue
        J_pose, J_point, J_camera = jacobians(photo, control.p_enu[seen])
        P = np.array([np.diag(s**2) for s in sigma[seen]])
        P = P + np.diag(shift_sigmas(control, [photo]) ** 2)
        C = J_pose @ photo.pose.covariance @ np.swapaxes(J_pose, 1, 2)
        C = C + J_point @ P @ np.swapaxes(J_point, 1, 2)
        C = C + J_camera @ np.diag(camera_sigmas(photo.camera) ** 2) @ np.swapaxes(J_camera, 1, 2)
        keys += [key] * len(seen)
        points.append(seen)
        uvs.append(uv[seen])
        covariances.append(C)
    if not keys:
        empty = np.zeros((0, 2))
        none = np.zeros(0, dtype=np.int32)
        return PredictedPixels(
            photo_ids=(), point=none, uv=empty, covariance=np.zeros((0, 2, 2))
        )  # fmt: skip
    return PredictedPixels(
        photo_ids=tuple(keys),
        point=np.concatenate(points).astype(np.int32),
        uv=np.concatenate(uvs),
        covariance=np.concatenate(covariances),
    )


def shift_sigmas(control: ControlObservations, photos: Sequence[OrientedPhoto]) -> Array:
    """One sigma of a shift of all points against all photos, m; shape (3,).

    Upwards that of the level which cameras and ground share, as control has heights of its own.
    """
    level = max(photo.pose.sigma_height_shared for photo in photos)
    return np.asarray(np.hypot(control.sigma_shared, [0.0, 0.0, level]))


def camera_sigmas(camera: Camera) -> Array:
    """One sigma of focal length, principal point u and v (px), k1, k2, p1 and p2; shape (7,)."""
    lens = _SIGMA_CALIBRATED if any((camera.k1, camera.k2, camera.k3)) else _SIGMA_LENS
    if camera.model == "fisheye_pix4d":
        # It has a polynomial of its own.
        lens = (0.0, 0.0, 0.0, 0.0)
    elif camera.model == "fisheye":
        lens = (*lens[:2], 0.0, 0.0)
    return np.array([camera.sigma_f, camera.sigma_c, camera.sigma_c, *lens])


def jacobians(photo: OrientedPhoto, p_enu: Array) -> tuple[Array, Array, Array]:
    """Derivatives of pixels by pose (k, 2, 6), point (k, 2, 3) and camera (k, 2, 7).

    The motion during a rolling readout is left out of them.
    """
    camera, R = photo.camera, photo.pose.R_enu_from_cam
    p_cam = photo.pose.cam_from_enu(p_enu)
    _, J_cam, J_camera = _camera_jacobians(camera, p_cam)
    J_point = J_cam @ R.T
    # p_cam = R^T Exp(-dtheta) (p - o - dp)
    J_pose = np.concatenate([-J_point, J_point @ skew(p_enu - photo.pose.origin_enu)], axis=-1)
    return J_pose, J_point, J_camera


def _camera_jacobians(camera: Camera, p_cam: Array) -> tuple[Array, Array, Array]:
    """Pixels (k, 2), and their derivatives by the point in camera axes and by the camera."""
    uv = camera.project(p_cam)
    # One-sided: off by 1e-6 of themselves, of no weight in a test.
    step = 1e-6 * np.maximum(np.abs(p_cam[:, 2:3]), 1e-3)
    ends = camera.project(p_cam + step * np.eye(3)[:, None, :])
    J_cam = np.moveaxis((ends - uv) / step, 0, -1)
    columns = [
        (moved(camera, {name: h}).project(p_cam) - uv) / h for name, h in _CAMERA_STEPS.items()
    ]
    return uv, J_cam, np.stack(columns, axis=-1)


def moved(camera: Camera, errors: Mapping[str, float]) -> Camera:
    """Camera with another focal length (at most twice or half), principal point or lens."""
    f = float(np.clip(errors.get("f", 0.0), -0.5 * camera.fx, camera.fx))
    return replace(
        camera,
        fx=camera.fx + f,
        fy=camera.fy * (1.0 + f / camera.fx),
        cx=camera.cx + errors.get("cx", 0.0),
        cy=camera.cy + errors.get("cy", 0.0),
        **{
            name: getattr(camera, name)
            + float(np.clip(errors.get(name, 0.0), -_MOST_LENS, _MOST_LENS))
            for name in ("k1", "k2", "p1", "p2")
        },
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """Photos with marks, their control and the covariance of all unknowns before any mark.

    The order of the unknowns: poses, cameras, points, shift.
    """

    control: ControlObservations
    photos: tuple[OrientedPhoto, ...]
    cameras: tuple[Camera, ...]
    # of each photo, and of each mark
    camera_of: Indices
    photo_of: Indices
    prior: Array

    @classmethod
    def of(
        cls,
        photos: Mapping[str, OrientedPhoto],
        control: ControlObservations,
        terrain: Terrain,
        joint: JointCovariance | None = None,
    ) -> Network:
        """Network of those photos that have marks."""
        used = list(dict.fromkeys(control.photo_ids))
        chosen = [photos[key] for key in used]
        number = {key: i for i, key in enumerate(used)}
        cameras: list[Camera] = []
        camera_of = []
        for photo in chosen:
            if photo.camera not in cameras:
                cameras.append(photo.camera)
            camera_of.append(cameras.index(photo.camera))
        n, c, k = len(chosen), len(cameras), len(control.names)
        size = 6 * n + _CAMERA_TERMS * c + 3 * k + 3
        prior = np.zeros((size, size))
        for i, photo in enumerate(chosen):
            prior[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = photo.pose.covariance
        if joint is not None:
            _put_joint(prior, number, joint)
        rest = [camera_sigmas(camera) for camera in cameras]
        rest += [prior_sigmas(control, terrain).reshape(-1), shift_sigmas(control, chosen)]
        at = np.arange(6 * n, size)
        prior[at, at] = np.concatenate(rest) ** 2
        return cls(
            control=control, photos=tuple(chosen), cameras=tuple(cameras),
            camera_of=np.array(camera_of, dtype=np.int32),
            photo_of=np.array([number[key] for key in control.photo_ids], dtype=np.int32),
            prior=prior,
        )  # fmt: skip

    def at(self, x: Array, photo: int) -> OrientedPhoto:
        """Photo with the errors x taken off its pose and its camera."""
        one = self.photos[photo]
        d = x[6 * photo : 6 * photo + 6]
        pose = replace(
            one.pose,
            origin_enu=one.pose.origin_enu + d[:3],
            R_enu_from_cam=exp_so3(d[3:]) @ one.pose.R_enu_from_cam,
        )
        base = self._camera_at(photo)
        terms = x[base : base + _CAMERA_TERMS]
        camera = moved(one.camera, dict(zip(_CAMERA_STEPS, terms, strict=True)))
        return replace(one, pose=pose, camera=camera)

    def points_at(self, x: Array) -> Array:
        """Points with their own errors and the shift taken off; shape (n, 3), m."""
        base = self._point_at(0)
        return np.asarray(self.control.p_enu + x[base:-3].reshape(-1, 3) + x[-3:])

    def _camera_at(self, photo: int) -> int:
        return 6 * len(self.photos) + _CAMERA_TERMS * int(self.camera_of[photo])

    def _point_at(self, point: int) -> int:
        return 6 * len(self.photos) + _CAMERA_TERMS * len(self.cameras) + 3 * point

    def look(self, x: Array, photo: Numbers, point: Numbers) -> tuple[Array, Array]:
        """Pixels of pairs of photos and points at x, and their derivatives by all unknowns.

        Returns
        -------
        uv : shape (k, 2), px
            NaN where a point cannot be seen.
        J : shape (k, 2, size)
        """
        p = self.points_at(x)[point]
        d = x[: 6 * len(self.photos)].reshape(-1, 6)
        start = np.array([one.pose.origin_enu for one in self.photos]) + d[:, :3]
        R = exp_so3(d[:, 3:]) @ np.array([one.pose.R_enu_from_cam for one in self.photos])
        arms = p - start[photo]
        p_cam = np.einsum("kij,ki->kj", R[photo], arms)
        uv = np.full((len(photo), 2), np.nan)
        J = np.zeros((len(photo), 2, len(self.prior)))
        for c in np.unique(self.camera_of[photo]):
            rows = np.flatnonzero(self.camera_of[photo] == c)
            base = 6 * len(self.photos) + _CAMERA_TERMS * int(c)
            terms = dict(zip(_CAMERA_STEPS, x[base : base + _CAMERA_TERMS], strict=True))
            uv[rows], J_cam, J_camera = _camera_jacobians(
                moved(self.cameras[c], terms), p_cam[rows]
            )
            J[rows, :, base : base + _CAMERA_TERMS] = J_camera
            J[rows, :, -3:] = J_cam @ np.swapaxes(R[photo[rows]], 1, 2)
        J_point = J[:, :, -3:]
        turn = J_point @ skew(arms)
        at = self._point_at(0) + 3 * np.asarray(point)
        rows = np.arange(len(photo))
        for k in range(3):
            J[rows, :, 6 * photo + k] = -J_point[:, :, k]
            J[rows, :, 6 * photo + 3 + k] = turn[:, :, k]
            J[rows, :, at + k] = J_point[:, :, k]
        for i in np.unique(photo):
            if self.photos[i].camera.readout_s and self.photos[i].pose.velocity_enu is not None:
                rows = np.flatnonzero(photo == i)
                uv[rows] = self.at(x, int(i)).project(p[rows])
        return uv, J

    def freed(self, point: int, sigma: float) -> Network:
        """Network in which a point has no more than a rough place, m."""
        prior = self.prior.copy()
        at = self._point_at(point)
        prior[at : at + 3, at : at + 3] = np.eye(3) * sigma**2
        return replace(self, prior=prior)

    def place_of(self, point: int) -> slice:
        """Where a point's unknowns stand."""
        at = self._point_at(point)
        return slice(at, at + 3)


def _put_joint(prior: Array, number: Mapping[str, int], joint: JointCovariance) -> None:
    """Blocks of the joint covariance of poses for the photos that are used."""
    keys, covariance = joint
    there = {key: i for i, key in enumerate(keys) if key in number}
    for a, i in there.items():
        for b, j in there.items():
            m, n = 6 * number[a], 6 * number[b]
            prior[m : m + 6, n : n + 6] = covariance[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
