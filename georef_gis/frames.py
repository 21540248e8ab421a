"""Reference frames, rotations between them, and the pose error that every covariance speaks of.

Frames
------
========  ==============================================  =======================================
code      meaning                                         axes, origin
========  ==============================================  =======================================
`geo`     geodetic WGS 84 (EPSG:4979)                     lat, lon (rad), ellipsoidal height (m)
`ecef`    earth-centred earth-fixed                       X, Y, Z
`enu`     the project's topocentric frame                 east, north, up
`ned`     local level at the vehicle                      north, east, down
`body`    IMU / vehicle                                   forward, right, down
`cam`     camera, computer-vision axes                    x image right, y image down, z forward
`photo`   camera, photogrammetric axes (opk)              x image right, y image up, z backwards
`image`   pixels `uv`                                     right, down; (0, 0) = first pixel's centre
`map`     projected CRS                                   easting, northing, height
`grid`    raster col, row                                 (0, 0) = outer corner of first pixel
========  ==============================================  =======================================

Notation
--------
`R_to_from` acts on columns, so neighbouring names match:
`R_enu_from_cam = R_enu_from_ned @ R_ned_from_body @ R_body_from_cam`. The inverse is `.T`.
Yaw is clockwise from true north, pitch is nose up, roll is right wing down (rad).

Pose error: `(dp_enu, dtheta_enu)`, position first, `p_true = p_est + dp_enu` and
`R_true = Exp(dtheta_enu) @ R_est`, covariance 6x6 in m and rad. Only this module converts.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Swaps the axes of local level frames at ONE place; between places use `R_enu_from_ned`.
R_ENU_FROM_NED_SAME_PLACE: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
R_PHOTO_FROM_CAM: Array = np.diag([1.0, -1.0, -1.0])
# Camera looking down, top of the image forward: the angles of the dialect are zero at nadir.
R_BODY_FROM_CAM_NADIR: Array = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# Camera looking forward, level: gimbal angles that are zero at the horizon (-90 deg at nadir).
R_BODY_FROM_CAM_HORIZON: Array = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def skew(v: ArrayLike) -> Array:
    """Matrix of the cross product, `skew(a) @ b = a x b`; shape (..., 3) -> (..., 3, 3)."""
    a = np.asarray(v, dtype=np.float64)
    out = np.zeros((*a.shape[:-1], 3, 3))
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    out[..., 0, 1], out[..., 0, 2] = -z, y
    out[..., 1, 0], out[..., 1, 2] = z, -x
    out[..., 2, 0], out[..., 2, 1] = -y, x
    return out


def exp_so3(rotvec: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector, rad; shape (..., 3) -> (..., 3, 3).

    Notes
    -----
    Rodrigues' formula with series of sin(a)/a and (1 - cos(a))/a^2 near zero.
    """
    v = np.asarray(rotvec, dtype=np.float64)
    a2 = np.sum(v**2, axis=-1)[..., None, None]
    a = np.sqrt(a2)
    small = a < 1e-6
    safe = np.where(small, 1.0, a)
    s = np.where(small, 1.0 - a2 / 6.0, np.sin(safe) / safe)
    c = np.where(small, 0.5 - a2 / 24.0, 2.0 * (np.sin(safe / 2.0) / safe) ** 2)
    k = skew(v)
    return np.asarray(np.eye(3) + s * k + c * (k @ k))


def log_so3(R: ArrayLike) -> Array:
    """Rotation vector, rad, of rotation matrices; shape (..., 3, 3) -> (..., 3).

    Notes
    -----
    By way of the quaternion, which is well conditioned from zero to half a turn.
    """
    q = quaternion_from_R(R)
    w, v = q[..., 0:1], q[..., 1:]
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    small = n < 1e-9
    factor = np.where(small, 2.0, 2.0 * np.arctan2(n, w) / np.where(small, 1.0, n))
    return np.asarray(factor * v)


def quaternion_from_R(R: ArrayLike) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, of rotation matrices; (..., 3, 3) -> (..., 4).

    Notes
    -----
    The largest of the four components is found first (Shepperd 1978).
    """
    m = np.asarray(R, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # Four times the outer product of the quaternion with itself.
    k = np.empty((*m.shape[:-2], 4, 4))
    k[..., 0, 0], k[..., 1, 1] = 1 + xx + yy + zz, 1 + xx - yy - zz
    k[..., 2, 2], k[..., 3, 3] = 1 - xx + yy - zz, 1 - xx - yy + zz
    k[..., 0, 1] = k[..., 1, 0] = m[..., 2, 1] - m[..., 1, 2]
    k[..., 0, 2] = k[..., 2, 0] = m[..., 0, 2] - m[..., 2, 0]
    k[..., 0, 3] = k[..., 3, 0] = m[..., 1, 0] - m[..., 0, 1]
    k[..., 1, 2] = k[..., 2, 1] = m[..., 1, 0] + m[..., 0, 1]
    k[..., 1, 3] = k[..., 3, 1] = m[..., 0, 2] + m[..., 2, 0]
    k[..., 2, 3] = k[..., 3, 2] = m[..., 2, 1] + m[..., 1, 2]
    best = np.argmax(np.diagonal(k, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(k, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def R_from_quaternion(q: ArrayLike) -> Array:
    """Rotation matrices of quaternions (w, x, y, z), normalised first; (..., 4) -> (..., 3, 3)."""
    given = np.asarray(q, dtype=np.float64)
    unit = given / np.linalg.norm(given, axis=-1, keepdims=True)
    k = skew(unit[..., 1:])
    return np.asarray(np.eye(3) + 2.0 * unit[..., :1, None] * k + 2.0 * (k @ k))


def _turn(axis: int, angle: ArrayLike) -> Array:
    v = np.zeros((*np.shape(angle), 3))
    v[..., axis] = angle
    return exp_so3(v)


def R_ned_from_body(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), rad; shapes (...) -> (..., 3, 3)."""
    return np.asarray(_turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll))


def rpy_from_R_ned_from_body(R: ArrayLike) -> Array:
    """Roll, pitch, yaw, rad, of R_ned_from_body; (..., 3, 3) -> (..., 3).

    Notes
    -----
    At pitch = +-90 deg roll and yaw are one angle: it is given as yaw, with roll = 0.
    """
    m = np.asarray(R, dtype=np.float64)
    pitch = np.arctan2(-m[..., 2, 0], np.hypot(m[..., 0, 0], m[..., 1, 0]))
    locked = np.hypot(m[..., 0, 0], m[..., 1, 0]) < 1e-9
    roll = np.where(locked, 0.0, np.arctan2(m[..., 2, 1], m[..., 2, 2]))
    yaw = np.where(
        locked, np.arctan2(-m[..., 0, 1], m[..., 1, 1]), np.arctan2(m[..., 1, 0], m[..., 0, 0])
    )
    return np.stack([roll, pitch, yaw], axis=-1)


def R_map_from_photo(omega: ArrayLike, phi: ArrayLike, kappa: ArrayLike) -> Array:
    """Rx(omega) Ry(phi) Rz(kappa), rad; shapes (...) -> (..., 3, 3)."""
    return np.asarray(_turn(0, omega) @ _turn(1, phi) @ _turn(2, kappa))


def opk_from_R_map_from_photo(R: ArrayLike) -> Array:
    """Omega, phi, kappa, rad, of R_map_from_photo; (..., 3, 3) -> (..., 3).

    Notes
    -----
    At phi = +-90 deg omega and kappa are one angle: it is given as kappa, with omega = 0.
    """
    m = np.asarray(R, dtype=np.float64)
    cos_phi = np.hypot(m[..., 0, 0], m[..., 0, 1])
    locked = cos_phi < 1e-9
    phi = np.arctan2(m[..., 0, 2], cos_phi)
    omega = np.where(locked, 0.0, np.arctan2(-m[..., 1, 2], m[..., 2, 2]))
    kappa = np.where(
        locked, np.arctan2(m[..., 1, 0], m[..., 1, 1]), np.arctan2(-m[..., 0, 1], m[..., 0, 0])
    )
    return np.stack([omega, phi, kappa], axis=-1)


def R_map_from_enu(convergence: float) -> Array:
    """Rz(+convergence): from true to grid axes, rad, where the meridian convergence is known."""
    return _turn(2, convergence)


def R_ecef_from_enu(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Axes east, north, up at a place, as columns in ecef; shapes (...) rad -> (..., 3, 3)."""
    phi, lam = np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float))
    sp, cp, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    zero = np.zeros_like(phi)
    rows = [[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [zero, cp, sp]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def R_ecef_from_ned(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Axes north, east, down at a place, as columns in ecef; shapes (...) rad -> (..., 3, 3)."""
    return np.asarray(R_ecef_from_enu(lat, lon) @ R_ENU_FROM_NED_SAME_PLACE)


def R_enu_from_ned(
    origin_lat: float, origin_lon: float, vehicle_lat: ArrayLike, vehicle_lon: ArrayLike
) -> Array:
    """From the vehicle's local level to the project's enu, which is level at its origin only.

    The plumb lines of two places differ by 0.009 deg per km: never a constant swap of axes.
    """
    R_enu_from_ecef = R_ecef_from_enu(origin_lat, origin_lon).T
    return np.asarray(R_enu_from_ecef @ R_ecef_from_ned(vehicle_lat, vehicle_lon))


# ---------------------------------------------------------------------------------------------
# Covariances of the pose error (dp_enu, dtheta_enu)
# ---------------------------------------------------------------------------------------------


def jacobian_theta_ned_from_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Left rotation error in ned, rad, per error of (roll, pitch, yaw), rad; (...) -> (..., 3, 3).

    Columns are the axes about which each angle turns: yaw about ned z, pitch about the y axis
    after yaw, roll about the body x axis.
    """
    _, q, y = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (roll, pitch, yaw)))
    J = np.zeros((*q.shape, 3, 3))
    J[..., 0, 0], J[..., 1, 0] = np.cos(y) * np.cos(q), np.sin(y) * np.cos(q)
    J[..., 2, 0] = -np.sin(q)
    J[..., 0, 1], J[..., 1, 1] = -np.sin(y), np.cos(y)
    J[..., 2, 2] = 1.0
    return J


def covariance_theta_ned_from_rpy(rpy: ArrayLike, sigma_rpy: ArrayLike) -> Array:
    """Covariance of the left rotation error in ned of independent sigmas; (..., 3) -> (..., 3, 3).

    Angles and sigmas in rad; NaN where a sigma is unknown.
    """
    angles, sigma = np.asarray(rpy, dtype=np.float64), np.asarray(sigma_rpy, dtype=np.float64)
    J = jacobian_theta_ned_from_rpy(*np.moveaxis(angles, -1, 0)) * sigma[..., None, :]
    return np.asarray(J @ np.swapaxes(J, -1, -2))


def sigma_rpy_from_covariance_theta_ned(rpy: ArrayLike, covariance: ArrayLike) -> Array:
    """Sigmas of roll, pitch, yaw, rad, of covariances of the left rotation error in ned.

    Parameters
    ----------
    rpy : shape (n, 3), rad
    covariance : shape (n, 3, 3), rad^2

    Returns
    -------
    Array
        Shape (n, 3); NaN where the covariance is unknown or pitch is vertical.
    """
    angles, C = np.asarray(rpy, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    out = np.full(angles.shape, np.nan)
    known = np.all(np.isfinite(C), axis=(1, 2)) & (np.abs(np.cos(angles[:, 1])) > 1e-6)
    if np.any(known):
        back = np.linalg.inv(jacobian_theta_ned_from_rpy(*angles[known].T))
        own = back @ C[known] @ np.swapaxes(back, -1, -2)
        out[known] = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
    return out


def jacobian_theta_map_from_opk(omega: float, phi: float, kappa: float) -> Array:
    """Left rotation error in map axes, rad, per error of (omega, phi, kappa), rad; shape (3, 3)."""
    del kappa
    R_omega = _turn(0, omega)
    R_omega_phi = R_omega @ _turn(1, phi)
    return np.column_stack([[1.0, 0.0, 0.0], R_omega[:, 1], R_omega_phi[:, 2]])


def covariance_from_ned(cov_ned: ArrayLike, R_enu_ned: Array) -> Array:
    """Pose covariance from a filter's (dp_ned, phi_ned) with C_true = Exp(phi) C_est; (6, 6)."""
    J = np.kron(np.eye(2), R_enu_ned)
    return np.asarray(J @ np.asarray(cov_ned, float) @ J.T)


def covariance_from_colmap(cov_cam: ArrayLike, R_enu_from_cam: Array, origin_enu: Array) -> Array:
    """Pose covariance from COLMAP's: rotation first, cam_from_world, camera axes; (6, 6).

    Notes
    -----
    COLMAP's error is (dr, dt) with R_cw = Exp(dr) R_cw_est and t = t_est + dt. With
    origin = -R_wc t it follows that dtheta = -R_wc dr, and
    dp = -R_wc dt - dtheta x (R_wc t) = -R_wc dt + dtheta x origin.
    """
    J = np.zeros((6, 6))
    J[3:, :3] = -R_enu_from_cam
    J[:3, 3:] = -R_enu_from_cam
    J[:3, :3] = -skew(origin_enu) @ J[3:, :3]
    return np.asarray(J @ np.asarray(cov_cam, float) @ J.T)


def covariance_from_ceres_half_angle(cov_half: ArrayLike) -> Array:
    """Rotation covariance of the full angle from Ceres' quaternion tangent; (3, 3), rad^2.

    Ceres' tangent is half the angle: 0.01 rad comes back as 0.005.
    """
    return np.asarray(4.0 * np.asarray(cov_half, float))


def rotation_angle(R: ArrayLike) -> float:
    """Angle of one rotation matrix, rad."""
    return float(math.acos(min(1.0, max(-1.0, (float(np.trace(np.asarray(R))) - 1.0) / 2.0))))
