"""Poses from which the adjustment of a resection starts: closed solutions, no weights."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np

from georef_gis.frames import Array, exp_so3
from georef_gis.model.camera import Camera
from georef_gis.orient.resection_marks import FEWEST, FEWEST_TO_TEST, ControlMarks

# relief over extent below which a second pose is looked for
PLANAR = 0.2
# subsets of four marks tried where there are blunders
_SUBSETS = 150

# origin (3,), m, and R_enu_from_cam (3, 3)
Start = tuple[Array, Array]


def solve_pnp(p: Array, d_cam: Array) -> Start | None:
    """Origin (3,) and R_from_cam (3, 3) by SQPnP from directions in camera axes; None if none.

    Parameters
    ----------
    p : shape (n, 3), m
    d_cam : shape (n, 3)
        Unit directions; those more than 84 deg off the axis are left out.
    """
    ahead = d_cam[:, 2] > 0.1
    if np.count_nonzero(ahead) < 3:
        return None
    middle = p[ahead].mean(axis=0)
    q, xy = p[ahead] - middle, d_cam[ahead, :2] / d_cam[ahead, 2:]
    try:
        found, rvec, t = cv2.solvePnP(q, xy, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        # It asserts on points without extent.
        return None
    if not found or not (np.all(np.isfinite(rvec)) and np.all(np.isfinite(t))):
        return None
    R = exp_so3(rvec.ravel()).T
    return np.asarray(middle - R @ t.ravel()), R


def _planar_poses(p: Array, d_cam: Array) -> list[Start]:
    """The two poses of marks near a plane, by IPPE; [] where they are not near one."""
    ahead = d_cam[:, 2] > 0.1
    middle = p[ahead].mean(axis=0)
    q = p[ahead] - middle
    _, size, axes = np.linalg.svd(q, full_matrices=False)
    if len(q) < FEWEST or size[2] > PLANAR * size[1]:
        return []
    axes[2] = np.cross(axes[0], axes[1])
    flat = q @ axes.T
    flat[:, 2] = 0.0
    xy = d_cam[ahead, :2] / d_cam[ahead, 2:]
    n, rvecs, ts, _ = cv2.solvePnPGeneric(flat, xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    out = []
    for rvec, t in zip(rvecs[:n], ts[:n], strict=True):
        R = axes.T @ exp_so3(rvec.ravel()).T
        if np.all(np.isfinite(R)) and np.all(np.isfinite(t)):
            out.append((middle - R @ t.ravel(), R))
    return out


def starts(camera: Camera, marks: ControlMarks) -> list[Start]:
    """Poses that all marks give."""
    d = camera.ray(marks.uv)
    seen = np.all(np.isfinite(d), axis=1)
    p, d = marks.p_enu[seen], d[seen]
    if len(p) < FEWEST:
        return []
    found = solve_pnp(p, d)
    return ([found] if found is not None else []) + _planar_poses(p, d)


def consensus(camera: Camera, marks: ControlMarks) -> list[Start]:
    """The two poses of four marks each that most others agree with, for marks with blunders."""
    d = camera.ray(marks.uv)
    seen = np.all(np.isfinite(d), axis=1)
    p, uv, d = marks.p_enu[seen], marks.uv[seen], d[seen]
    n = len(p)
    if n < FEWEST_TO_TEST:
        return []
    if math.comb(n, FEWEST) <= _SUBSETS:
        subsets = np.array(list(itertools.combinations(range(n), FEWEST)))
    else:
        rng = np.random.default_rng(0)
        subsets = np.array([rng.choice(n, FEWEST, replace=False) for _ in range(_SUBSETS)])
    sigma = np.broadcast_to(np.asarray(marks.sigma_px, float), (len(marks),))[seen]
    ranked: list[tuple[float, Start]] = []
    for k in subsets:
        found = solve_pnp(p[k], d[k])
        if found is not None:
            off = camera.project((p - found[0]) @ found[1]) - uv
            # Points behind the camera count as misses.
            miss = np.nan_to_num(np.hypot(*off.T) / sigma, nan=np.inf)
            ranked.append((float(np.minimum(miss, 20.0).sum()), found))
    ranked.sort(key=lambda one: one[0])
    return [found for _, found in ranked[:2]]
