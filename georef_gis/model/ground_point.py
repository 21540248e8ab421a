"""Where a pixel's ray meets the ground, and how far to trust that place."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, skew
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain


def locate(photo: OrientedPhoto, uv: ArrayLike, terrain: Terrain) -> Array:
    """Ground points, m in enu, that pixels show; shape (..., 2) -> (..., 3), NaN on a miss."""
    return terrain.intersect(*photo.rays(uv))


def ground_normal(terrain: Terrain, p_enu: Array, *, base: float = 1.0) -> Array:
    """Normal of the ground, scaled to up = 1, over a base in m; shape (3,)."""
    d = base * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    z = terrain.z_at(p_enu[:2] + d)
    slope = np.array([z[0] - z[1], z[2] - z[3]]) / (2 * base)
    slope = np.where(np.isfinite(slope), slope, 0.0)
    return np.array([-slope[0], -slope[1], 1.0])


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

    Notes
    -----
    P = C + t d with n . P = n . P0 + n_up dh on the tangent plane of the ground, so that each
    error e of P across the ray is moved back along the ray: P = (I - d n^T / (n . d)) e + ...
    """
    n = ground_normal(terrain, p_enu)
    uv = photo.project(p_enu)
    ray = p_enu - photo.rays(uv)[0]
    distance = float(np.linalg.norm(ray))
    d = ray / distance
    grazing = float(n @ d)
    if abs(grazing) < 1e-6:
        raise GeometryError("the ray runs along the ground: no place can be told")
    onto_ground = np.eye(3) - np.outer(d, n) / grazing
    J_pose = onto_ground @ np.hstack([np.eye(3), -skew(ray)])
    J_height = d / grazing
    h = 0.5
    origins, directions = photo.rays(uv + np.array([[h, 0], [-h, 0], [0, h], [0, -h]]))
    ends = origins + directions * distance
    J_ray = np.stack([(ends[0] - ends[1]) / (2 * h), (ends[2] - ends[3]) / (2 * h)], axis=1)
    return J_pose, J_height, onto_ground @ J_ray


def ground_point_covariance(
    photo: OrientedPhoto, p_enu: Array, terrain: Terrain, *, sigma_uv: float = 1.0
) -> Array:
    """Covariance of a ground point located from one photo, m^2 in enu; shape (3, 3).

    Pose (6 x 6), focal length and principal point, ground height and the click count. The height
    is that over the level that photo and ground share: see `Pose.sigma_height_shared`.
    """
    J_pose, J_height, J_uv = ground_point_jacobians(photo, p_enu, terrain)
    out = J_pose @ photo.pose.covariance @ J_pose.T
    out += np.outer(J_height, J_height) * terrain.sigma**2
    out += J_uv @ J_uv.T * (sigma_uv**2 + photo.camera.sigma_c**2)
    # A longer focal length shrinks the pattern towards the principal point.
    camera = photo.camera
    uv = photo.project(p_enu)
    radial = J_uv @ ((uv - [camera.cx, camera.cy]) / camera.fx)
    out += np.outer(radial, radial) * camera.sigma_f**2
    return np.asarray((out + out.T) / 2)
