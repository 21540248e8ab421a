"""Where a pixel's ray meets the ground, and how far to trust that place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, skew
from georef_gis.model.joint_errors import camera_sigmas
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.photo_stack import Ints, PhotoStack
from georef_gis.model.terrain import Terrain

# least sine of the angle between a ray and the ground of which a place can be told
GRAZING = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundSensitivities:
    """How located ground points depend on what is unknown; "true minus stated" on both sides.

    Parameters
    ----------
    by_pose : shape (m, 3, 6)
        By the pose error (dp_enu m, dtheta_enu rad).
    by_camera : shape (m, 3, 11)
        By the unknowns of the camera, in the axes of the picture as it is stored.
    by_height : shape (m, 3), m/m
        By the height of the ground.
    by_uv : shape (m, 3, 2), m/px
        By the pixel.
    grazing : shape (m,)
        Sine of the angle between ray and ground; negative from above.
    """

    by_pose: Array
    by_camera: Array
    by_height: Array
    by_uv: Array
    grazing: Array


def locate(photo: OrientedPhoto, uv: ArrayLike, terrain: Terrain) -> Array:
    """Ground points, m in enu, that pixels show; shape (..., 2) -> (..., 3), NaN on a miss."""
    return terrain.intersect(*photo.rays(uv))


def ground_normal(terrain: Terrain, p_enu: Array, *, base: ArrayLike = 1.0) -> Array:
    """Normals of the ground, scaled to up = 1, over a base in m; shape (..., 3) -> (..., 3)."""
    p = np.asarray(p_enu, dtype=np.float64)
    b = np.broadcast_to(np.asarray(base, float), p.shape[:-1])[..., None, None]
    around = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    z = terrain.z_at(p[..., None, :2] + b * around)
    slope = np.stack([z[..., 0] - z[..., 1], z[..., 2] - z[..., 3]], axis=-1) / (2 * b[..., 0])
    slope = np.where(np.isfinite(slope), slope, 0.0)
    return np.concatenate([-slope, np.ones((*p.shape[:-1], 1))], axis=-1)


def ground_sensitivities(
    stack: PhotoStack, k: Ints, uv: Array, p_enu: Array, normal: Array
) -> GroundSensitivities:
    """Derivatives of located ground points.

    Parameters
    ----------
    k : shape (m,)
        Photo of each.
    uv : shape (m, 2), px
    p_enu : shape (m, 3), m
        Where the rays of `uv` meet the ground.
    normal : shape (m, 3)
        Of the ground there, scaled to up = 1.

    Notes
    -----
    P = C + t d with n . P = n . P0 + n_up dh on the tangent plane of the ground, so that each
    error e of P across the ray is moved back along the ray: P = (I - d n^T / (n . d)) e + ...
    """
    ray = p_enu - stack.rays(k, uv)[0]
    distance = np.linalg.norm(ray, axis=1)
    d = ray / distance[:, None]
    grazing = np.einsum("mi,mi->m", normal, d)
    safe = np.where(np.abs(grazing) < GRAZING, GRAZING, grazing)
    by_height = d / safe[:, None]
    onto_ground = np.eye(3) - by_height[:, :, None] * normal[:, None, :]
    by_ray = np.empty((len(k), 3, 2))
    for i, h in enumerate(0.5 * np.eye(2)):
        ends = [start + way * distance[:, None]
                for start, way in (stack.rays(k, uv + h), stack.rays(k, uv - h))]  # fmt: skip
        by_ray[:, :, i] = ends[0] - ends[1]
    by_uv = onto_ground @ by_ray
    # under another camera the same pixel shows what the stated one shows beside it
    by_camera = -by_uv @ stack.views(k, p_enu).by_camera
    by_pose = onto_ground @ np.concatenate(
        [np.broadcast_to(np.eye(3), (len(k), 3, 3)), -skew(ray)], axis=-1
    )
    return GroundSensitivities(
        by_pose=by_pose, by_camera=by_camera, by_height=by_height, by_uv=by_uv, grazing=grazing
    )


def ground_point_jacobians(
    photo: OrientedPhoto, p_enu: Array, terrain: Terrain
) -> tuple[Array, Array, Array]:
    """Derivatives of a located ground point.

    Returns
    -------
    J_pose : shape (3, 6)
        By the pose error (dp_enu m, dtheta_enu rad).
    J_height : shape (3,)
        By the height of the ground, m.
    J_uv : shape (3, 2)
        By the pixel, px.

    Raises
    ------
    GeometryError
        If the ray runs along the ground.
    """
    found = _of_one(photo, p_enu, terrain)
    return found.by_pose[0], found.by_height[0], found.by_uv[0]


def _of_one(photo: OrientedPhoto, p_enu: Array, terrain: Terrain) -> GroundSensitivities:
    stack = PhotoStack.of([photo])
    uv = photo.project(p_enu)[None]
    normal = ground_normal(terrain, p_enu)[None]
    found = ground_sensitivities(stack, np.zeros(1, dtype=np.int64), uv, p_enu[None], normal)
    if abs(found.grazing[0]) < GRAZING:
        raise GeometryError("the ray runs along the ground: no place can be told")
    return found


def ground_point_covariance(
    photo: OrientedPhoto, p_enu: Array, terrain: Terrain, *, sigma_uv: float = 1.0
) -> Array:
    """Covariance of a ground point located from one photo, m^2 in enu; shape (3, 3).

    Pose (6 x 6), camera (`camera_sigmas`), ground height and the click count. The height is that
    over the level that photo and ground share: see `Pose.sigma_height_shared`.
    """
    found = _of_one(photo, p_enu, terrain)
    J_pose, J_height, J_uv = found.by_pose[0], found.by_height[0], found.by_uv[0]
    out = J_pose @ photo.pose.covariance @ J_pose.T
    out += np.outer(J_height, J_height) * terrain.sigma**2
    out += J_uv @ J_uv.T * sigma_uv**2
    by_camera = found.by_camera[0] * camera_sigmas(photo.camera)
    out += by_camera @ by_camera.T
    return np.asarray((out + out.T) / 2)
