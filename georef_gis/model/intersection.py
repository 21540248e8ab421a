"""Space intersection: one ground point from its pixels in several photos, with its covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, skew
from georef_gis.model.photo import OrientedPhoto

# ids of n photos -> covariance (6 n, 6 n) of their pose errors (dp_enu m, dtheta_enu rad)
JointCovariance = Callable[[Sequence[str]], Array]

# Smallest eigenvalue of the mean of I - d d^T: two rays 0.01 deg apart have 7.6e-9.
_PARALLEL = 7.6e-9
_STEPS = 30
# m; the iteration stops here
_STEP_TOLERANCE = 1e-7
# m; base of the derivative by the place
_BASE = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intersection:
    """A ground point from several photos.

    Parameters
    ----------
    p_enu : shape (3,), m
    covariance : shape (3, 3), m^2
        Poses, focal length, principal point and marks count; the level that camera and ground
        share (`Pose.sigma_height_shared`) is in the height.
    residuals_uv : shape (n, 2), px
        Marked minus projected.
    normalised : shape (n,)
        Largest normalised residual of each mark (Baarda's w): above about 4, a blunder.
    sigma0
        Square root of chi^2 per degree of freedom; near 1 where the sigmas hold.
    independent
        Whether the errors of the poses were taken as independent of each other. Those of one
        flight are not: then the covariance is too small.
    """

    p_enu: Array
    covariance: Array
    residuals_uv: Array
    normalised: Array
    sigma0: float
    independent: bool

    @property
    def rays(self) -> int:
        """Number of photos."""
        return len(self.residuals_uv)


def nearest_point(origins_enu: ArrayLike, d_enu: ArrayLike) -> Array:
    """Point nearest to all rays by the sum of squared distances; (n, 3) each -> (3,) m.

    Raises
    ------
    GeometryError
        If there are fewer than two rays, or they run parallel.
    """
    o, d = np.asarray(origins_enu, float), np.asarray(d_enu, float)
    if len(o) < 2:
        raise GeometryError(f"{len(o)} ray gives no point; mark it in two photos or more")
    if not (np.all(np.isfinite(o)) and np.all(np.isfinite(d))):
        raise GeometryError("a mark has no ray; check that it lies in its photo")
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < _PARALLEL:
        raise GeometryError(
            "the rays run parallel: no point can be told; mark it in photos from other places"
        )
    return np.asarray(np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, o)))


def intersect(
    photos: Sequence[OrientedPhoto],
    uv: ArrayLike,
    sigma_px: ArrayLike,
    *,
    joint: JointCovariance | None = None,
) -> Intersection:
    """Ground point that pixels of several photos show.

    Parameters
    ----------
    photos
        Each once.
    uv : shape (n, 2), px
        The point's pixel in each.
    sigma_px : shape (n,) or scalar, px
        One sigma of u and of v.
    joint
        Covariance of the poses together; without it they are taken as independent.

    Raises
    ------
    GeometryError
        If the rays run parallel, do not meet in front of the cameras, or the iteration fails.

    Notes
    -----
    Gauss-Newton on the collinearity equations with the full covariance of the pixels that marks,
    poses and cameras give (generalised least squares): Foerstner and Wrobel, Photogrammetric
    Computer Vision (2016), sections 4.4 and 13.4. Photos of one camera share its errors.
    """
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    if len({photo.id for photo in photos}) != len(photos) or len(uv) != len(photos):
        raise ValueError("one pixel of each photo, and each photo once")
    sigma = np.broadcast_to(np.asarray(sigma_px, float), (len(photos),))
    rays = [photo.rays(one) for photo, one in zip(photos, uv, strict=True)]
    p = nearest_point([ray[0] for ray in rays], [ray[1] for ray in rays])
    poses = _pose_covariance(photos, joint)
    for _ in range(_STEPS):
        residuals, J = _linearised(photos, uv, p)
        weight = _inverse(_pixel_covariance(photos, uv, p, J, sigma, poses))
        covariance = _inverse(J.T @ weight @ J)
        step = covariance @ (J.T @ weight @ residuals)
        p = p + step
        if np.linalg.norm(step) < _STEP_TOLERANCE:
            break
    else:
        raise GeometryError(
            f"the intersection of {len(photos)} rays does not converge; check the marks"
        )
    residuals, J = _linearised(photos, uv, p)
    chi2 = float(residuals @ weight @ residuals)
    lifted = covariance.copy()
    # One shift of all cameras with the ground: it moves no ray and is in no residual.
    lifted[2, 2] += max(photo.pose.sigma_height_shared for photo in photos) ** 2
    return Intersection(
        p_enu=p,
        covariance=lifted,
        residuals_uv=residuals.reshape(-1, 2),
        normalised=_normalised(residuals, J, weight, covariance),
        sigma0=float(np.sqrt(chi2 / (residuals.size - 3))),
        independent=joint is None,
    )


def _linearised(photos: Sequence[OrientedPhoto], uv: Array, p: Array) -> tuple[Array, Array]:
    """Residuals (2 n,) px, and the derivative (2 n, 3) of the pixels by the place, px/m."""
    h = _BASE * np.eye(3)
    seen = np.stack([photo.project(np.vstack([p, p + h, p - h])) for photo in photos])
    if not np.all(np.isfinite(seen)):
        raise GeometryError("the rays do not meet in front of the cameras; check the marks")
    J = (seen[:, 1:4] - seen[:, 4:7]) / (2 * _BASE)
    return (uv - seen[:, 0]).ravel(), np.swapaxes(J, 1, 2).reshape(-1, 3)


def _pose_covariance(photos: Sequence[OrientedPhoto], joint: JointCovariance | None) -> Array:
    n = len(photos)
    if joint is not None:
        together = np.asarray(joint([photo.id for photo in photos]), float)
        if together.shape != (6 * n, 6 * n):
            raise ValueError(f"joint covariance of {n} poses has shape {together.shape}")
        return together
    out = np.zeros((6 * n, 6 * n))
    for i, photo in enumerate(photos):
        out[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = photo.pose.covariance
    return out


def _pixel_covariance(
    photos: Sequence[OrientedPhoto], uv: Array, p: Array, J: Array, sigma: Array, poses: Array
) -> Array:
    """Covariance of the pixels by marks, poses and cameras, px^2; shape (2 n, 2 n)."""
    n = len(photos)
    by_pose = np.zeros((2 * n, 6 * n))
    cameras = sorted({photo.camera.id for photo in photos})
    by_camera = np.zeros((2 * n, 3 * len(cameras)))
    for i, photo in enumerate(photos):
        rows, camera = slice(2 * i, 2 * i + 2), photo.camera
        by_place = J[rows]
        # Moving the camera is moving the point back; turning it by dtheta moves the point by
        # -dtheta x (p - origin).
        by_pose[rows, 6 * i : 6 * i + 3] = -by_place
        by_pose[rows, 6 * i + 3 : 6 * i + 6] = by_place @ skew(p - photo.pose.origin_enu)
        at = 3 * cameras.index(camera.id)
        by_camera[rows, at] = (uv[i] - [camera.cx, camera.cy]) / camera.fx * camera.sigma_f
        by_camera[rows, at + 1 : at + 3] = np.eye(2) * camera.sigma_c
    return np.asarray(
        by_pose @ poses @ by_pose.T + by_camera @ by_camera.T + np.diag(np.repeat(sigma**2, 2))
    )


def _inverse(matrix: Array) -> Array:
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError as error:
        raise GeometryError("the intersection has no solution; check marks and sigmas") from error


def _normalised(residuals: Array, J: Array, weight: Array, covariance: Array) -> Array:
    """Baarda's test value of each mark, the larger of u and v; shape (n,)."""
    of_weighted = weight - weight @ J @ covariance @ J.T @ weight
    spread = np.sqrt(np.maximum(np.diag(of_weighted), 0.0))
    # A residual that nothing controls tells nothing.
    controlled = spread > 1e-6 * np.sqrt(np.diag(weight))
    w = np.where(controlled, np.abs(weight @ residuals) / np.where(controlled, spread, 1.0), 0.0)
    return np.asarray(w.reshape(-1, 2).max(axis=1))
