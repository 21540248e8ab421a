"""Derivatives of a camera's pixels by the point that it sees, by its pose and by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from georef_gis.frames import Array, skew
from georef_gis.model.camera import Camera

# Unknowns of a camera, in order; f moves fx and fy alike, b1 moves the scale of u alone.
CAMERA_NAMES = ("f", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2", "readout_s")
CAMERA_UNKNOWNS = len(CAMERA_NAMES)
# steps of the lens terms: 1e-5 of them moves a corner by some 0.01 px
_LENS_STEPS = {"k1": 1e-5, "k2": 1e-5, "k3": 1e-5, "p1": 1e-6, "p2": 1e-6}


def projection_jacobian(camera: Camera, p_cam: Array) -> Array:
    """Derivatives of pixels by points in camera axes; shape (n, 3) m -> (n, 2, 3) px/m."""
    h = 1e-5 * np.linalg.norm(p_cam, axis=1)
    steps = h[:, None, None] * np.eye(3)
    ahead = camera.project(p_cam[:, None, :] + steps)
    behind = camera.project(p_cam[:, None, :] - steps)
    return np.asarray(np.swapaxes(ahead - behind, 1, 2) / (2.0 * h)[:, None, None])


def pose_jacobian(J_point: Array, offset_enu: Array) -> Array:
    """Derivatives of pixels by the pose error (dp_enu m, dtheta_enu rad); shape (n, 2, 6).

    Parameters
    ----------
    J_point : shape (n, 2, 3)
        By the point in enu, px/m.
    offset_enu : shape (n, 3)
        From the projection centre to the points, m.

    Notes
    -----
    p_cam = R^T (P - C) with R_true = Exp(dtheta) R: dp_cam = -R^T dC + R^T [P - C] dtheta.
    """
    return np.concatenate([-J_point, J_point @ skew(offset_enu)], axis=-1)


def camera_jacobian(camera: Camera, p_cam: Array) -> Array:
    """Derivatives of pixels by the camera's unknowns but its readout; (n, 3) -> (n, 2, 11).

    The column of `readout_s` is zero: it takes the motion too, which a camera does not know.
    """
    out = np.zeros((len(p_cam), 2, CAMERA_UNKNOWNS))
    # in pixels of a camera of unit focal length: what f, b1 and b2 multiply
    uv = camera.project(p_cam)
    y = (uv[:, 1] - camera.cy) / camera.fy
    x = (uv[:, 0] - camera.cx - camera.b2 * y) / (camera.fx + camera.b1)
    out[:, 0, 0], out[:, 1, 0] = x, y
    out[:, 0, 1] = out[:, 1, 2] = 1.0
    for name, h in _LENS_STEPS.items():
        column = CAMERA_NAMES.index(name)
        ahead = replace(camera, **{name: getattr(camera, name) + h})
        out[:, :, column] = (ahead.project(p_cam) - uv) / h
    out[:, 0, 8], out[:, 0, 9] = x, y
    return out


def turned_camera_jacobian(quarters: int) -> Array:
    """Derivatives of a turned camera's unknowns by those of the sensor; shape (11, 11).

    Parameters
    ----------
    quarters
        Quarter turns clockwise by which an editor turned the picture, see `Camera.turned`.

    Notes
    -----
    u' = height - 1 - v, v' = u: cx' = height - 1 - cy, cy' = cx, p1' = p2, p2' = -p1, and the
    larger scale of u becomes that of v. Of the readout nothing is known in a lying picture.
    """
    if quarters % 4 == 0:
        return np.eye(CAMERA_UNKNOWNS)
    one = np.eye(CAMERA_UNKNOWNS)
    at = {name: i for i, name in enumerate(CAMERA_NAMES)}
    for name in ("cx", "cy", "p1", "p2", "b1", "b2", "readout_s"):
        one[at[name], at[name]] = 0.0
    one[at["cx"], at["cy"]], one[at["cy"], at["cx"]] = -1.0, 1.0
    one[at["p1"], at["p2"]], one[at["p2"], at["p1"]] = 1.0, -1.0
    one[at["f"], at["b1"]], one[at["b1"], at["b1"]] = 1.0, -1.0
    out = np.asarray(np.linalg.matrix_power(one, quarters % 4))
    if quarters % 4 == 2:
        out[at["readout_s"], at["readout_s"]] = -1.0
        out[at["b2"], at["b2"]] = 1.0
    return out
