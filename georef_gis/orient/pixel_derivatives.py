"""Derivatives of a camera's pixels by the point that it sees and by its pose."""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array, skew
from georef_gis.model.camera import Camera


def projection_jacobian(camera: Camera, p_cam: Array) -> Array:
    """Derivatives of pixels by points in camera axes; shape (n, 3) m -> (n, 2, 3) px/m."""
    h = 1e-5 * np.linalg.norm(p_cam, axis=1)
    steps = h[:, None, None] * np.eye(3)
    ahead = camera.project(p_cam[:, None, :] + steps)
    behind = camera.project(p_cam[:, None, :] - steps)
    return np.asarray(np.swapaxes(ahead - behind, 1, 2) / (2.0 * h)[:, None, None])


def pose_jacobian(J_cam: Array, R_enu_from_cam: Array, offset_enu: Array) -> Array:
    """Derivatives of pixels by the pose error (dp_enu m, dtheta_enu rad); shape (n, 2, 6).

    Parameters
    ----------
    J_cam : shape (n, 2, 3)
        By the point in camera axes.
    offset_enu : shape (n, 3)
        From the projection centre to the points, m.

    Notes
    -----
    p_cam = R^T (P - C) with R_true = Exp(dtheta) R: dp_cam = -R^T dC + R^T [P - C] dtheta.
    """
    by_position = -(J_cam @ R_enu_from_cam.T)
    return np.concatenate([by_position, -by_position @ skew(offset_enu)], axis=-1)
