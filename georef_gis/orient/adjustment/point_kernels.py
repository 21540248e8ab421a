"""Compiled loops over the points: their steps with the poses, their places by the rays."""

from __future__ import annotations

import numpy as np

from georef_gis.orient.adjustment.kernels import (
    CAMERA_UNKNOWNS,
    MAX_RAYS,
    compiled,
    gather,
    invert3,
    observe,
    point_normal,
    weight_of,
)


@compiled
def move_points(obs, state, place, span, camera_of, settings, step, out):  # type: ignore[no-untyped-def]
    """Steps of the points that follow from the steps of poses (n, 6) and shared unknowns (G,)."""
    scale2, damping, shifts, first_shift = settings
    step_pose, step_shared = step
    rs, who = np.zeros((MAX_RAYS, 2)), np.zeros(MAX_RAYS, np.int64)
    Jxs, Jps = np.zeros((MAX_RAYS, 2, 6)), np.zeros((MAX_RAYS, 2, 3))
    Jcs = np.zeros((MAX_RAYS, 2, CAMERA_UNKNOWNS))
    buffers = (rs, Jxs, Jps, Jcs, who)
    V, Vi, b = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for j in range(len(span) - 1):
        n = gather(span[j], span[j + 1], obs, state, scale2, buffers)
        point_normal(n, j, buffers, place, damping, shifts, V, b)
        for p in range(3):
            out[j, p] = 0.0
        if not invert3(V, Vi):
            continue
        if place[3][j] >= 0:
            b[2] -= place[2][j, 2] * step_shared[first_shift + place[3][j]]
        for a in range(n):
            i = who[a]
            base = CAMERA_UNKNOWNS * camera_of[i]
            for q in range(2):
                moved = 0.0
                for p in range(6):
                    moved += Jxs[a, q, p] * step_pose[i, p]
                for p in range(CAMERA_UNKNOWNS):
                    moved += Jcs[a, q, p] * step_shared[base + p]
                for p in range(3):
                    b[p] -= Jps[a, q, p] * moved
        for p in range(3):
            out[j, p] = Vi[p, 0] * b[0] + Vi[p, 1] * b[1] + Vi[p, 2] * b[2]


@compiled
def _point_cost(j, k0, k1, p, obs, state, place, settings, buffers):  # type: ignore[no-untyped-def]
    """Cost of one point at a place."""
    photo, _, uv, sigma, camera_of, height = obs
    origin, rotation, motion, cameras, _ = state
    rs, Jxs, Jps, Jcs, _ = buffers
    scale2, _, shifts, _ = settings
    cost = 0.0
    for k in range(k0, k1):
        i = photo[k]
        c = camera_of[i]
        seen = observe(
            p, origin[i], rotation[i], motion[i], cameras[c], height[c], uv[k],
            rs[0], Jxs[0], Jps[0], Jcs[0], False,
        )  # fmt: skip
        s2 = sigma[k] * sigma[k]
        chi2 = (rs[0, 0] * rs[0, 0] + rs[0, 1] * rs[0, 1]) / s2 if seen else 1e8
        cost += weight_of(chi2, scale2)[0]
    for q in range(3):
        off = place[1][j, q] - p[q]
        if q == 2 and place[3][j] >= 0:
            off -= shifts[place[3][j]]
        cost += place[2][j, q] * off * off
    return cost


@compiled
def place_points(obs, state, place, span, settings, out):  # type: ignore[no-untyped-def]
    """Better places of the points, (k, 3), for cameras that stay; each one's cost falls."""
    scale2, _, shifts, _ = settings
    rs, who = np.zeros((MAX_RAYS, 2)), np.zeros(MAX_RAYS, np.int64)
    Jxs, Jps = np.zeros((MAX_RAYS, 2, 6)), np.zeros((MAX_RAYS, 2, 3))
    Jcs = np.zeros((MAX_RAYS, 2, CAMERA_UNKNOWNS))
    buffers = (rs, Jxs, Jps, Jcs, who)
    V, Vi, b, trial = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for j in range(len(span) - 1):
        for p in range(3):
            out[j, p] = state[4][j, p]
        before = _point_cost(j, span[j], span[j + 1], out[j], obs, state, place, settings, buffers)
        own = 1e-6
        for _attempt in range(4):
            n = gather(span[j], span[j + 1], obs, state, scale2, buffers)
            point_normal(n, j, buffers, place, own, shifts, V, b)
            if not invert3(V, Vi):
                break
            for p in range(3):
                step = Vi[p, 0] * b[0] + Vi[p, 1] * b[1] + Vi[p, 2] * b[2]
                trial[p] = state[4][j, p] + step
            after = _point_cost(
                j, span[j], span[j + 1], trial, obs, state, place, settings, buffers
            )
            if after <= before:
                for p in range(3):
                    out[j, p] = trial[p]
                break
            own = own * 1000.0
