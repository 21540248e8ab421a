"""The simulator's own camera: Brown-Conrady lines, projection and rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate.settings import CameraTruth

Array = NDArray[np.float64]


def distort(xy: Array, camera: CameraTruth) -> Array:
    """Distorted from ideal normalised image coordinates, shape (..., 2); Brown (1971)."""
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    xd = x * radial + 2.0 * camera.p1 * x * y + camera.p2 * (r2 + 2.0 * x * x)
    yd = y * radial + camera.p1 * (r2 + 2.0 * y * y) + 2.0 * camera.p2 * x * y
    return np.stack([xd, yd], axis=-1)


def undistort(xy_distorted: Array, camera: CameraTruth) -> Array:
    """Ideal from distorted normalised image coordinates, shape (..., 2), by fixed point."""
    xy = xy_distorted.copy()
    for _ in range(25):
        xy = xy + (xy_distorted - distort(xy, camera))
    return xy


def pixels_from_cam(p_cam: Array, camera: CameraTruth) -> Array:
    """Pixels of points in camera axes (x right, y down, z into the scene), shape (..., 2).

    NaN where a point is behind the camera or beyond 60 deg off the axis, where the distortion
    polynomial means nothing.
    """
    z = p_cam[..., 2]
    ahead = z > 0.5 * np.linalg.norm(p_cam, axis=-1)
    safe = np.where(ahead, z, 1.0)
    xy = distort(p_cam[..., :2] / safe[..., None], camera)
    uv = xy * np.array([camera.fx, camera.fy]) + np.array([camera.cx, camera.cy])
    return np.where(ahead[..., None], uv, np.nan)


def rays_of_pixels(uv: Array, camera: CameraTruth) -> Array:
    """Directions in camera axes with z = 1 of pixels, shape (..., 3)."""
    xy = (uv - np.array([camera.cx, camera.cy])) / np.array([camera.fx, camera.fy])
    ideal = undistort(xy, camera)
    return np.concatenate([ideal, np.ones((*ideal.shape[:-1], 1))], axis=-1)
