"""Compiled loops for covariances: inverse within a band, points from poses and cameras."""

from __future__ import annotations

import numpy as np

from georef_gis.orient.adjustment.kernels import (
    CAMERA_UNKNOWNS,
    LEVEL,
    MAX_RAYS,
    compiled,
    gather,
    invert3,
    point_normal,
)


@compiled
def band_inverse(factor, out):  # type: ignore[no-untyped-def]
    """Entries of the inverse within the band of a lower Cholesky factor, (width, n) both.

    Entry (k, j) stands for row j + k of column j.
    """
    width, n = factor.shape
    for j in range(n - 1, -1, -1):
        most = min(width - 1, n - 1 - j)
        pivot = factor[0, j]
        for k in range(most, 0, -1):
            i = j + k
            total = 0.0
            for m in range(1, most + 1):
                c = j + m
                if i >= c:
                    total += factor[m, j] * out[i - c, c]
                else:
                    total += factor[m, j] * out[c - i, i]
            out[k, j] = -total / pivot
        total = 0.0
        for m in range(1, most + 1):
            total += factor[m, j] * out[m, j]
        out[0, j] = (1.0 / pivot - total) / pivot
        for k in range(most + 1, width):
            out[k, j] = 0.0


@compiled
def _gather_inverse(inverse, index, size, n_pose, out):  # type: ignore[no-untyped-def]
    """Covariance of some unknowns into a corner of a square array."""
    dense, band, place, to_shared, spread, shared = inverse
    whole = len(place) == 0
    for s in range(size):
        a = index[s]
        for t in range(s + 1):
            b = index[t]
            if whole:
                value = dense[a, b]
            elif a >= n_pose and b >= n_pose:
                value = shared[a - n_pose, b - n_pose]
            elif a >= n_pose:
                value = -spread[b, a - n_pose]
            elif b >= n_pose:
                value = -spread[a, b - n_pose]
            else:
                i, k = place[a], place[b]
                if i < k:
                    i, k = k, i
                value = band[i - k, k] if i - k < band.shape[0] else 0.0
                for g in range(to_shared.shape[1]):
                    value += spread[a, g] * to_shared[b, g]
            out[s, t] = value
            out[t, s] = value


@compiled
def point_rows(j, obs, state, place, span, camera_of, settings, at_shared, rows, own):  # type: ignore[no-untyped-def]
    """How point j follows the other unknowns, (3, N), and its covariance when they are known.

    False where the point cannot be placed.
    """
    scale2, damping, shifts, first_shift = settings
    rs, who = np.zeros((MAX_RAYS, 2)), np.zeros(MAX_RAYS, np.int64)
    Jxs, Jps = np.zeros((MAX_RAYS, 2, 6)), np.zeros((MAX_RAYS, 2, 3))
    Jcs = np.zeros((MAX_RAYS, 2, CAMERA_UNKNOWNS))
    buffers = (rs, Jxs, Jps, Jcs, who)
    V, b = np.zeros((3, 3)), np.zeros(3)
    n = gather(span[j], span[j + 1], obs, state, scale2, buffers)
    point_normal(n, j, buffers, place, damping, shifts, V, b)
    if not invert3(V, own):
        return False
    for a in range(n):
        i = who[a]
        base = at_shared + CAMERA_UNKNOWNS * camera_of[i]
        for p in range(3):
            for q in range(2):
                lead = (
                    own[p, 0] * Jps[a, q, 0] + own[p, 1] * Jps[a, q, 1] + own[p, 2] * Jps[a, q, 2]
                )
                for s in range(6):
                    rows[p, 6 * i + s] -= lead * Jxs[a, q, s]
                for s in range(CAMERA_UNKNOWNS):
                    rows[p, base + s] -= lead * Jcs[a, q, s]
    if place[3][j] >= 0:
        at = at_shared + first_shift + place[3][j]
        for p in range(3):
            rows[p, at] -= own[p, 2] * place[2][j, 2]
    return True


@compiled
def point_covariances(obs, state, place, span, camera_of, settings, inverse, with_level, out):  # type: ignore[no-untyped-def]
    """Covariance of every point, (k, 3, 3), from the inverse of the reduced normal matrix."""
    scale2, damping, shifts, first_shift = settings
    rs, who = np.zeros((MAX_RAYS, 2)), np.zeros(MAX_RAYS, np.int64)
    Jxs, Jps = np.zeros((MAX_RAYS, 2, 6)), np.zeros((MAX_RAYS, 2, 3))
    Jcs = np.zeros((MAX_RAYS, 2, CAMERA_UNKNOWNS))
    buffers = (rs, Jxs, Jps, Jcs, who)
    V, Vi, b = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    n_pose = 6 * len(state[0])
    most = 6 * MAX_RAYS + 64 * CAMERA_UNKNOWNS
    index = np.zeros(most, np.int64)
    A, AM = np.zeros((3, most)), np.zeros((3, most))
    widest = 0
    for j in range(len(span) - 1):
        widest = max(widest, min(span[j + 1] - span[j], MAX_RAYS))
    # every camera of the point brings its own unknowns
    side = (6 + CAMERA_UNKNOWNS) * widest + 2
    M = np.zeros((side, side))
    K = CAMERA_UNKNOWNS
    for j in range(len(span) - 1):
        n = gather(span[j], span[j + 1], obs, state, scale2, buffers)
        point_normal(n, j, buffers, place, damping, shifts, V, b)
        if not invert3(V, Vi):
            for p in range(3):
                for q in range(3):
                    out[j, p, q] = np.nan
            continue
        size = 0
        for a in range(n):
            for s in range(6):
                index[size + s] = 6 * who[a] + s
                for p in range(3):
                    A[p, size + s] = 0.0
                    for q in range(2):
                        lead = Vi[p, 0] * Jps[a, q, 0] + Vi[p, 1] * Jps[a, q, 1]
                        lead += Vi[p, 2] * Jps[a, q, 2]
                        A[p, size + s] -= lead * Jxs[a, q, s]
            size += 6
        first_shared = size
        for a in range(n):
            base = n_pose + K * camera_of[who[a]]
            at = -1
            for s in range(first_shared, size, K):
                if index[s] == base:
                    at = s
            if at < 0:
                at = size
                size += K
                for s in range(K):
                    index[at + s] = base + s
                    for p in range(3):
                        A[p, at + s] = 0.0
            for s in range(K):
                for p in range(3):
                    for q in range(2):
                        lead = Vi[p, 0] * Jps[a, q, 0] + Vi[p, 1] * Jps[a, q, 1]
                        lead += Vi[p, 2] * Jps[a, q, 2]
                        A[p, at + s] -= lead * Jcs[a, q, s]
        for shift in range(2):
            shared_by_all = with_level and shift == LEVEL
            if not shared_by_all and place[3][j] != shift:
                continue
            index[size] = n_pose + first_shift + shift
            for p in range(3):
                A[p, size] = 1.0 if p == 2 and shared_by_all else 0.0
                if place[3][j] == shift:
                    A[p, size] -= Vi[p, 2] * place[2][j, 2]
            size += 1
        _gather_inverse(inverse, index, size, n_pose, M)
        for p in range(3):
            for t in range(size):
                total = 0.0
                for s in range(size):
                    total += A[p, s] * M[s, t]
                AM[p, t] = total
        for p in range(3):
            for q in range(p, 3):
                total = Vi[p, q]
                for t in range(size):
                    total += AM[p, t] * A[q, t]
                out[j, p, q] = total
                out[j, q, p] = total
