"""Equations (24) to (36) of the 2009 WVU report, compiled: model, Jacobian, filter, smoother.

State: north, east, down (m) in a local level plane, v_ned (m/s), roll, pitch, yaw (rad). Input:
a_x, a_y, a_z (specific force, m/s2), p, q, r (rad/s); body forward, right, down. What differs from
the print is listed in `ekf9`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from georef_gis.frames import Array
from georef_gis.model.logs import IntArray

F = TypeVar("F", bound=Callable[..., Any])

# m/s2; standard gravity (CGPM 1901)
STANDARD_GRAVITY = 9.80665
# Below this cosine of pitch (89 deg) the Euler angles of the report have no rates.
_SINGULAR = 0.0175


def _compiled(function: F) -> F:
    return cast(F, njit(cache=True)(function))


@_compiled
def transition(x: Array, u: Array, dt: float, gravity: float = STANDARD_GRAVITY) -> Array:
    """Equation (24) in north, east, down: state (9,) after `dt` s of input u.

    Parameters
    ----------
    x : north, east, down m; v_ned m/s; roll, pitch, yaw rad
    u : a_x, a_y, a_z m/s2 (specific force), p, q, r rad/s; body forward, right, down
    """
    sr, cr = math.sin(x[6]), math.cos(x[6])
    sp, cp = math.sin(x[7]), math.cos(x[7])
    sy, cy = math.sin(x[8]), math.cos(x[8])
    a, b, c = u[0], u[1], u[2]
    turn = u[4] * sr + u[5] * cr
    out = x.copy()
    for i in range(3):
        out[i] += dt * x[3 + i]
    out[3] += dt * (cy * cp * a + (cy * sp * sr - sy * cr) * b + (cy * sp * cr + sy * sr) * c)
    out[4] += dt * (sy * cp * a + (sy * sp * sr + cy * cr) * b + (sy * sp * cr - cy * sr) * c)
    out[5] += dt * (-sp * a + cp * sr * b + cp * cr * c + gravity)
    out[6] += dt * (u[3] + turn * sp / cp)
    out[7] += dt * (u[4] * cr - u[5] * sr)
    out[8] += dt * turn / cp
    return out


@_compiled
def jacobian(x: Array, u: Array, dt: float) -> Array:
    """Equation (28), d transition / d x, with entry (9, 7) mended; shape (9, 9)."""
    sr, cr = math.sin(x[6]), math.cos(x[6])
    sp, cp = math.sin(x[7]), math.cos(x[7])
    sy, cy = math.sin(x[8]), math.cos(x[8])
    a, b, c = u[0], u[1], u[2]
    turn, slip = u[4] * sr + u[5] * cr, u[4] * cr - u[5] * sr
    A = np.eye(9)
    for i in range(3):
        A[i, 3 + i] = dt
    A[3, 6] = dt * ((sy * sr + cy * sp * cr) * b + (sy * cr - cy * sp * sr) * c)
    A[3, 7] = dt * (-cy * sp * a + cy * cp * sr * b + cy * cp * cr * c)
    A[3, 8] = dt * (-sy * cp * a - (cy * cr + sy * sp * sr) * b + (cy * sr - sy * sp * cr) * c)
    A[4, 6] = dt * ((sy * sp * cr - cy * sr) * b - (cy * cr + sy * sp * sr) * c)
    A[4, 7] = dt * (-sy * sp * a + sy * cp * sr * b + sy * cp * cr * c)
    A[4, 8] = dt * (cy * cp * a + (cy * sp * sr - sy * cr) * b + (sy * sr + cy * sp * cr) * c)
    A[5, 6] = dt * (cp * cr * b - cp * sr * c)
    A[5, 7] = -dt * (cp * a + sp * sr * b + sp * cr * c)
    A[6, 6] += dt * slip * sp / cp
    A[6, 7] = dt * turn / cp**2
    A[7, 6] = -dt * turn
    A[8, 6] = dt * slip / cp
    A[8, 7] = dt * turn * sp / cp**2
    return A


@_compiled
def _times(A: Array, B: Array) -> Array:
    """A @ B for an A of the shape of (28): only its entries are visited."""
    out = B.copy()
    for j in range(9):
        for i in range(3):
            out[i, j] += A[i, 3 + i] * B[3 + i, j]
            out[3 + i, j] += A[3 + i, 6] * B[6, j] + A[3 + i, 7] * B[7, j] + A[3 + i, 8] * B[8, j]
            out[6 + i, j] = A[6 + i, 6] * B[6, j] + A[6 + i, 7] * B[7, j]
        out[8, j] += B[8, j]
    return out


@_compiled
def _add_noise(P: Array, x: Array, dt: float, q: Array) -> None:
    """Add Q dt to P in place; q: position, velocity, attitude densities squared, 1 to map gyros."""
    for i in range(3):
        P[i, i] += q[0] * dt
        P[3 + i, 3 + i] += q[1] * dt
    if q[3] == 0.0:
        for i in range(6, 9):
            P[i, i] += q[2] * dt
        return
    t, s = math.tan(x[7]), 1.0 / math.cos(x[7])
    # E E^T of the map from body rates to Euler rates in (22); roll drops out of it.
    P[6, 6] += q[2] * dt * (1.0 + t * t)
    P[7, 7] += q[2] * dt
    P[8, 8] += q[2] * dt * s * s
    P[6, 8] += q[2] * dt * t * s
    P[8, 6] += q[2] * dt * t * s


@_compiled
def _update(x: Array, P: Array, z: Array, R: Array, n: int) -> tuple[Array, Array, Array, float]:
    """Equations (34) to (36) with the first n of six measured values; also innovation sigmas."""
    S = P[:n, :n] + R[:n, :n]
    v = z[:n] - x[:n]
    K = np.linalg.solve(S, np.ascontiguousarray(P[:n, :])).T
    out = x + np.ascontiguousarray(K) @ v
    P_out = P - np.ascontiguousarray(K) @ np.ascontiguousarray(P[:n, :])
    nis = float(np.dot(v, np.linalg.solve(S, v)))
    return out, 0.5 * (P_out + P_out.T), np.sqrt(np.diag(S)), nis


@_compiled
def filter_grid(
    steps: tuple[Array, IntArray, IntArray, IntArray],
    u: Array,
    fixes: tuple[Array, Array, IntArray],
    start: tuple[Array, Array],
    noise: tuple[Array, float],
    nodes: int,
) -> tuple[int, Array, Array, Array, Array, Array, Array, Array, Array]:
    """Filter over a grid of times; nodes keep what the smoother needs.

    `steps`: times, input held until each, fix at each or -1, node at each or -1. Returns the row
    at which pitch got singular or -1; states and variances of all rows; states (k, 2, 9),
    covariances (k, 2, 9, 9) before and after the update and transitions (k, 9, 9) since the
    node before; innovations, their sigmas and NIS.
    """
    time, held, fix_at, node_at = steps
    z, R, dof = fixes
    q, gravity = noise
    x, P = start[0].copy(), start[1].copy()
    xs, var = np.empty((len(time), 9)), np.empty((len(time), 9))
    node_x, node_P = np.empty((nodes, 2, 9)), np.empty((nodes, 2, 9, 9))
    node_A = np.empty((nodes, 9, 9))
    innovation, sigma = np.full((len(z), 6), np.nan), np.full((len(z), 6), np.nan)
    nis = np.full(len(z), np.nan)
    A = np.eye(9)
    for k in range(len(time)):
        if k > 0:
            dt = time[k] - time[k - 1]
            step = jacobian(x, u[held[k]], dt)
            P = _times(step, np.ascontiguousarray(_times(step, P).T))
            _add_noise(P, x, dt, q)
            x = transition(x, u[held[k]], dt, gravity)
            A = _times(step, A)
            if not abs(math.cos(x[7])) > _SINGULAR:
                return k, xs, var, node_x, node_P, node_A, innovation, sigma, nis
        node, fix = node_at[k], fix_at[k]
        if node >= 0:
            node_x[node, 0], node_P[node, 0], node_A[node] = x, P, A
            A = np.eye(9)
        if fix >= 0:
            n = dof[fix]
            innovation[fix, :n] = z[fix, :n] - x[:n]
            x, P, sigma[fix, :n], nis[fix] = _update(x, P, z[fix], R[fix], n)
        if node >= 0:
            node_x[node, 1], node_P[node, 1] = x, P
        xs[k] = x
        for i in range(9):
            var[k, i] = P[i, i]
    return -1, xs, var, node_x, node_P, node_A, innovation, sigma, nis


@_compiled
def smooth_nodes(node_x: Array, node_P: Array, node_A: Array) -> tuple[Array, Array]:
    """Rauch-Tung-Striebel at the nodes: states (k, 9) and variances (k, 9)."""
    x, P = node_x[-1, 1].copy(), node_P[-1, 1].copy()
    xs, var = np.empty((len(node_x), 9)), np.empty((len(node_x), 9))
    xs[-1], var[-1] = x, np.diag(P)
    for k in range(len(node_x) - 2, -1, -1):
        C = np.linalg.solve(node_P[k + 1, 0], node_A[k + 1] @ node_P[k, 1]).T
        C = np.ascontiguousarray(C)
        x = node_x[k, 1] + C @ (x - node_x[k + 1, 0])
        P = node_P[k, 1] + C @ (P - node_P[k + 1, 0]) @ np.ascontiguousarray(C.T)
        P = 0.5 * (P + P.T)
        xs[k], var[k] = x, np.diag(P)
    return xs, var
