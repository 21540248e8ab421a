"""Compiled loops over the observations: residuals, reduced normal equations.

Every ground point is eliminated on the spot (Schur complement), so that no Jacobian is kept.

Notes
-----
Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis" (2000),
section 6.1. All loops are plain: array expressions would multiply the compile time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

# f cx cy k1 k2 k3 p1 p2 b1 b2 readout_s
CAMERA_UNKNOWNS = 11
# longest track that is used
MAX_RAYS = 512
# shared heights, last of the unknowns: what the surface known beforehand lies above the points,
# and what control adds to all heights
SURFACE, LEVEL = 0, 1
# of a point's normal matrix, the least share of a diagonal element that the others leave: rays
# that are nearly parallel say nothing of depth but rounding
SINGULAR = 1e-8


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at first use and keep beside the source."""
    made: Callable[..., Any] = numba.njit(cache=True, nogil=True)(function)
    return made


@compiled
def observe(P, C, R, motion, cam, height, uv, r, Jx, Jp, Jc, with_jacobians):  # type: ignore[no-untyped-def]
    """Residual (observed minus projected, px) and derivatives of the projection; False behind.

    `motion` holds velocity and rate in enu; `cam` fx fy cx cy k1 k2 k3 p1 p2 b1 b2 readout_s.
    """
    a0, a1, a2 = P[0] - C[0], P[1] - C[1], P[2] - C[2]
    p0 = R[0, 0] * a0 + R[1, 0] * a1 + R[2, 0] * a2
    p1_ = R[0, 1] * a0 + R[1, 1] * a1 + R[2, 1] * a2
    p2_ = R[0, 2] * a0 + R[1, 2] * a1 + R[2, 2] * a2
    # a row is exposed at its own time: the scene moves against the camera
    fraction = uv[1] / max(height - 1.0, 1.0) - 0.5
    t = fraction * cam[11]
    v0 = R[0, 0] * motion[0] + R[1, 0] * motion[1] + R[2, 0] * motion[2]
    v1 = R[0, 1] * motion[0] + R[1, 1] * motion[1] + R[2, 1] * motion[2]
    v2 = R[0, 2] * motion[0] + R[1, 2] * motion[1] + R[2, 2] * motion[2]
    w0 = R[0, 0] * motion[3] + R[1, 0] * motion[4] + R[2, 0] * motion[5]
    w1 = R[0, 1] * motion[3] + R[1, 1] * motion[4] + R[2, 1] * motion[5]
    w2 = R[0, 2] * motion[3] + R[1, 2] * motion[4] + R[2, 2] * motion[5]
    m0 = v0 + w1 * p2_ - w2 * p1_
    m1 = v1 + w2 * p0 - w0 * p2_
    m2 = v2 + w0 * p1_ - w1 * p0
    q0, q1, q2 = p0 - t * m0, p1_ - t * m1, p2_ - t * m2
    if q2 <= 1e-3:
        return False
    x, y = q0 / q2, q1 / q2
    r2 = x * x + y * y
    radial = 1.0 + r2 * (cam[4] + r2 * (cam[5] + r2 * cam[6]))
    slope = 2.0 * (cam[4] + r2 * (2.0 * cam[5] + 3.0 * r2 * cam[6]))
    xd = x * radial + 2.0 * cam[7] * x * y + cam[8] * (r2 + 2.0 * x * x)
    yd = y * radial + cam[7] * (r2 + 2.0 * y * y) + 2.0 * cam[8] * x * y
    fu, fv = cam[0] + cam[9], cam[1]
    r[0] = uv[0] - (cam[2] + fu * xd + cam[10] * yd)
    r[1] = uv[1] - (cam[3] + fv * yd)
    if not with_jacobians:
        return True
    dxx = radial + x * x * slope + 2.0 * cam[7] * y + 6.0 * cam[8] * x
    dxy = x * y * slope + 2.0 * cam[7] * x + 2.0 * cam[8] * y
    dyy = radial + y * y * slope + 6.0 * cam[7] * y + 2.0 * cam[8] * x
    # (u, v) by (x, y)
    g00, g01 = fu * dxx + cam[10] * dxy, fu * dxy + cam[10] * dyy
    g10, g11 = fv * dxy, fv * dyy
    # (u, v) by q
    h00, h01 = g00 / q2, g01 / q2
    h02 = -(g00 * x + g01 * y) / q2
    h10, h11 = g10 / q2, g11 / q2
    h12 = -(g10 * x + g11 * y) / q2
    # q by p: I - t [w]x
    for k in range(2):
        ha = h00 if k == 0 else h10
        hb = h01 if k == 0 else h11
        hc = h02 if k == 0 else h12
        e0 = ha - t * (hb * w2 - hc * w1)
        e1 = hb - t * (hc * w0 - ha * w2)
        e2 = hc - t * (ha * w1 - hb * w0)
        for j in range(3):
            Jp[k, j] = e0 * R[j, 0] + e1 * R[j, 1] + e2 * R[j, 2]
            Jx[k, j] = -Jp[k, j]
        # p = R^T Exp(-dtheta) a, so dp/dtheta = R^T [a]x
        Jx[k, 3] = Jp[k, 1] * a2 - Jp[k, 2] * a1
        Jx[k, 4] = Jp[k, 2] * a0 - Jp[k, 0] * a2
        Jx[k, 5] = Jp[k, 0] * a1 - Jp[k, 1] * a0
        Jc[k, 10] = -fraction * (ha * m0 + hb * m1 + hc * m2)
    r4 = r2 * r2
    Jc[0, 0], Jc[1, 0] = xd, yd
    Jc[0, 1], Jc[1, 1] = 1.0, 0.0
    Jc[0, 2], Jc[1, 2] = 0.0, 1.0
    Jc[0, 3], Jc[1, 3] = (fu * x + cam[10] * y) * r2, fv * y * r2
    Jc[0, 4], Jc[1, 4] = (fu * x + cam[10] * y) * r4, fv * y * r4
    Jc[0, 5], Jc[1, 5] = (fu * x + cam[10] * y) * r4 * r2, fv * y * r4 * r2
    t1x, t1y = 2.0 * x * y, r2 + 2.0 * y * y
    t2x, t2y = r2 + 2.0 * x * x, 2.0 * x * y
    Jc[0, 6], Jc[1, 6] = fu * t1x + cam[10] * t1y, fv * t1y
    Jc[0, 7], Jc[1, 7] = fu * t2x + cam[10] * t2y, fv * t2y
    Jc[0, 8], Jc[1, 8] = xd, 0.0
    Jc[0, 9], Jc[1, 9] = yd, 0.0
    return True


@compiled
def weight_of(chi2, scale2):  # type: ignore[no-untyped-def]
    """Cost and weight of a squared normalised residual.

    Cauchy's loss, or Huber's where `scale2` is negative, or none where it is 0.
    """
    if scale2 == 0.0:
        return chi2, 1.0
    if scale2 < 0.0:
        if chi2 <= -scale2:
            return chi2, 1.0
        bend = np.sqrt(-scale2 / chi2)
        return 2.0 * bend * chi2 + scale2, bend
    return scale2 * np.log1p(chi2 / scale2), 1.0 / (1.0 + chi2 / scale2)


@compiled
def residuals(obs, state, scale2, out, weight):  # type: ignore[no-untyped-def]
    """Residuals of all observations, px; their cost.

    `out` (m, 2) is NaN where the point lies behind the camera (its cost is that of a far
    outlier); `weight` (m,) the robust weight.
    """
    photo, point, uv, sigma, camera_of, height = obs
    origin, rotation, motion, cameras, points = state
    r = np.zeros(2)
    Jx, Jp, Jc = np.zeros((2, 6)), np.zeros((2, 3)), np.zeros((2, CAMERA_UNKNOWNS))
    cost = 0.0
    for k in range(len(photo)):
        i = photo[k]
        c = camera_of[i]
        seen = observe(
            points[point[k]], origin[i], rotation[i], motion[i], cameras[c], height[c], uv[k],
            r, Jx, Jp, Jc, False,
        )  # fmt: skip
        chi2 = (r[0] * r[0] + r[1] * r[1]) / (sigma[k] * sigma[k]) if seen else 1e8
        rho, w = weight_of(chi2, scale2)
        cost += 0.5 * rho
        weight[k] = w if seen else 0.0
        out[k, 0] = r[0] if seen else np.nan
        out[k, 1] = r[1] if seen else np.nan
    return cost


@compiled
def _slot(start, column, i, j):  # type: ignore[no-untyped-def]
    """Where the block (i, j), i <= j, lies: binary search in row i."""
    low, high = start[i], start[i + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if column[middle] < j:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def gather(k0, k1, obs, state, scale2, buffers):  # type: ignore[no-untyped-def]
    """Weighted derivatives of one point's observations into buffers; how many there are."""
    photo, point, uv, sigma, camera_of, height = obs
    origin, rotation, motion, cameras, points = state
    rs, Jxs, Jps, Jcs, who = buffers
    n = 0
    for k in range(k0, min(k1, k0 + MAX_RAYS)):
        i = photo[k]
        c = camera_of[i]
        seen = observe(
            points[point[k]], origin[i], rotation[i], motion[i], cameras[c], height[c], uv[k],
            rs[n], Jxs[n], Jps[n], Jcs[n], True,
        )  # fmt: skip
        if not seen:
            continue
        s2 = sigma[k] * sigma[k]
        chi2 = (rs[n, 0] * rs[n, 0] + rs[n, 1] * rs[n, 1]) / s2
        w = np.sqrt(weight_of(chi2, scale2)[1] / s2)
        for q in range(2):
            rs[n, q] *= w
            for j in range(6):
                Jxs[n, q, j] *= w
            for j in range(3):
                Jps[n, q, j] *= w
            for j in range(CAMERA_UNKNOWNS):
                Jcs[n, q, j] *= w
        who[n] = i
        n += 1
    return n


@compiled
def half_inverse3(V, M):  # type: ignore[no-untyped-def]
    """Inverse of the lower Cholesky factor of a 3 x 3; False where it is close to singular.

    Cofactors would err by the square of the condition, which makes the whole matrix indefinite.
    """
    a = V[0, 0]
    if not a > 0.0:
        return False
    l00 = np.sqrt(a)
    l10, l20 = V[1, 0] / l00, V[2, 0] / l00
    d = V[1, 1] - l10 * l10
    if not d > SINGULAR * V[1, 1]:
        return False
    l11 = np.sqrt(d)
    l21 = (V[2, 1] - l20 * l10) / l11
    f = V[2, 2] - l20 * l20 - l21 * l21
    if not f > SINGULAR * V[2, 2]:
        return False
    l22 = np.sqrt(f)
    M[0, 0], M[0, 1], M[0, 2] = 1.0 / l00, 0.0, 0.0
    M[1, 0], M[1, 1], M[1, 2] = -l10 / (l00 * l11), 1.0 / l11, 0.0
    M[2, 0] = (l10 * l21 / l11 - l20) / (l00 * l22)
    M[2, 1], M[2, 2] = -l21 / (l11 * l22), 1.0 / l22
    return True


@compiled
def invert3(V, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric 3 x 3; False where it is close to singular."""
    M = np.zeros((3, 3))
    if not half_inverse3(V, M):
        return False
    for p in range(3):
        for q in range(3):
            total = 0.0
            for k in range(3):
                total += M[k, p] * M[k, q]
            out[p, q] = total
    return True


@compiled
def point_normal(n, j, buffers, place, damping, shifts, V, b):  # type: ignore[no-untyped-def]
    """Normal matrix and right side of one point, its own knowledge included."""
    points, target, information, shift_of = place
    rs, _, Jps, _, _ = buffers
    for p in range(3):
        own = target[j, p] - points[j, p]
        if p == 2 and shift_of[j] >= 0:
            own -= shifts[shift_of[j]]
        b[p] = information[j, p] * own if information[j, p] > 0.0 else 0.0
        for q in range(3):
            V[p, q] = information[j, p] if p == q else 0.0
    for a in range(n):
        for q in range(2):
            for p in range(3):
                b[p] += Jps[a, q, p] * rs[a, q]
                for s in range(3):
                    V[p, s] += Jps[a, q, p] * Jps[a, q, s]
    for p in range(3):
        V[p, p] += damping * V[p, p] + 1e-12


@compiled
def reduce_points(obs, state, place, span, camera_of, settings, pattern, out):  # type: ignore[no-untyped-def]
    """Normal equations of poses and shared unknowns with the points eliminated.

    `out`: blocks (b, 6, 6) of pairs of photos after `pattern`, border (n, 6, G), corner (G, G),
    right sides of photos (n, 6) and of the shared unknowns (G,). Returns the number of points
    that could not be eliminated.
    """
    blocks, border, corner, rhs_pose, rhs_shared = out
    start, column = pattern
    scale2, damping, shifts, first_shift = settings
    rs, who = np.zeros((MAX_RAYS, 2)), np.zeros(MAX_RAYS, np.int64)
    Jxs, Jps = np.zeros((MAX_RAYS, 2, 6)), np.zeros((MAX_RAYS, 2, 3))
    Jcs = np.zeros((MAX_RAYS, 2, CAMERA_UNKNOWNS))
    buffers = (rs, Jxs, Jps, Jcs, who)
    W, T = np.zeros((MAX_RAYS, 6, 3)), np.zeros((MAX_RAYS, 6, 3))
    G = corner.shape[0]
    Wg, Tg = np.zeros((G, 3)), np.zeros((G, 3))
    used = np.zeros(G, np.int64)
    V, M, b, h3 = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    information, shift_of = place[2], place[3]
    lost = 0
    K = CAMERA_UNKNOWNS
    for j in range(len(span) - 1):
        n = gather(span[j], span[j + 1], obs, state, scale2, buffers)
        point_normal(n, j, buffers, place, damping, shifts, V, b)
        if not half_inverse3(V, M):
            lost += 1
            continue
        n_used = 0
        for a in range(n):
            base = K * camera_of[who[a]]
            known = False
            for s in range(n_used):
                known = known or used[s] == base
            if not known:
                for s in range(K):
                    used[n_used] = base + s
                    n_used += 1
                    for p in range(3):
                        Wg[base + s, p] = 0.0
        if shift_of[j] >= 0:
            at = first_shift + shift_of[j]
            used[n_used] = at
            n_used += 1
            Wg[at, 0], Wg[at, 1] = 0.0, 0.0
            Wg[at, 2] = information[j, 2]
            own = place[1][j, 2] - place[0][j, 2] - shifts[shift_of[j]]
            corner[at, at] += information[j, 2]
            rhs_shared[at] += information[j, 2] * own
        for a in range(n):
            i = who[a]
            base = K * camera_of[i]
            own_slot = _slot(start, column, i, i)
            for p in range(6):
                x0, x1 = Jxs[a, 0, p], Jxs[a, 1, p]
                rhs_pose[i, p] += x0 * rs[a, 0] + x1 * rs[a, 1]
                for q in range(6):
                    blocks[own_slot, p, q] += x0 * Jxs[a, 0, q] + x1 * Jxs[a, 1, q]
                for q in range(3):
                    W[a, p, q] = x0 * Jps[a, 0, q] + x1 * Jps[a, 1, q]
                for q in range(K):
                    border[i, p, base + q] += x0 * Jcs[a, 0, q] + x1 * Jcs[a, 1, q]
            for p in range(K):
                c0, c1 = Jcs[a, 0, p], Jcs[a, 1, p]
                rhs_shared[base + p] += c0 * rs[a, 0] + c1 * rs[a, 1]
                for q in range(p, K):
                    corner[base + p, base + q] += c0 * Jcs[a, 0, q] + c1 * Jcs[a, 1, q]
                for q in range(3):
                    Wg[base + p, q] += c0 * Jps[a, 0, q] + c1 * Jps[a, 1, q]
        for q in range(3):
            h3[q] = M[q, 0] * b[0] + M[q, 1] * b[1] + M[q, 2] * b[2]
        for a in range(n):
            for p in range(6):
                for q in range(3):
                    T[a, p, q] = W[a, p, 0] * M[q, 0] + W[a, p, 1] * M[q, 1] + W[a, p, 2] * M[q, 2]
        for s in range(n_used):
            g = used[s]
            for q in range(3):
                Tg[g, q] = Wg[g, 0] * M[q, 0] + Wg[g, 1] * M[q, 1] + Wg[g, 2] * M[q, 2]
            rhs_shared[g] -= Tg[g, 0] * h3[0] + Tg[g, 1] * h3[1] + Tg[g, 2] * h3[2]
        for a in range(n):
            i = who[a]
            for p in range(6):
                t0, t1, t2 = T[a, p, 0], T[a, p, 1], T[a, p, 2]
                rhs_pose[i, p] -= t0 * h3[0] + t1 * h3[1] + t2 * h3[2]
                for s in range(n_used):
                    g = used[s]
                    border[i, p, g] -= t0 * Tg[g, 0] + t1 * Tg[g, 1] + t2 * Tg[g, 2]
            for a2 in range(a, n):
                slot = _slot(start, column, i, who[a2])
                for p in range(6):
                    t0, t1, t2 = T[a, p, 0], T[a, p, 1], T[a, p, 2]
                    for q in range(6):
                        blocks[slot, p, q] -= t0 * T[a2, q, 0] + t1 * T[a2, q, 1] + t2 * T[a2, q, 2]
        for s in range(n_used):
            g = used[s]
            for s2 in range(n_used):
                h = used[s2]
                if h >= g:
                    corner[g, h] -= Tg[g, 0] * Tg[h, 0] + Tg[g, 1] * Tg[h, 1] + Tg[g, 2] * Tg[h, 2]
    return lost
