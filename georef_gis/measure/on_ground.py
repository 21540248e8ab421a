"""Intersected points that stand on the ground: its height is one more observation of them.

Rays that meet at a small angle tell the place along their base, and the height, worse than one ray
and the ground do. A spot on the ground has both.

With `e` the error of the place by its rays, "true minus stated", `g` that of the ground's height
and `n` the ground's normal, scaled to up = 1, the true place lies on the true ground: the ground
stands over the place by `y = n.e - g`. The best linear estimate moves the place by `K y`, with
`K = cov(e, y) / var(y)`, and errs by `(I - K n^T) e + K g`: Foerstner and Wrobel, Photogrammetric
Computer Vision (2016), 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array

from georef_gis.frames import Array
from georef_gis.measure.measured import MeasuredPoints, Method, photos_in
from georef_gis.measure.tied_ground import tied_heights, untied_variance
from georef_gis.model.ground_point import ground_normal
from georef_gis.model.photo_stack import Ints

METHOD: Method = "intersect_ground"
# sigmas between rays and ground from which on a spot does not lie on the ground
CONTRADICTS = 3.0
# share of its sigma in the plan down to which the ground must bring a place to be worth a word
_WORTH = 0.8
# m; the ground's slope is taken over the place's sigma, between these
_LEAST_BASE, _MOST_BASE = 1.0, 50.0
# rays up to which a word on the ground may be worth its time
_FEW_RAYS = 3
# points whose covariance is laid out together
_PART = 64
# the ground is looked up anew where the place has moved to
_ROUNDS = 2
SURER = "surer with the ground"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Heights:
    """The ground under n points.

    Parameters
    ----------
    off : shape (n,), m
        Its height over the point's, NaN where it is not known.
    normal : shape (n, 3)
        Scaled to up = 1.
    shared : shape (n, U)
        Derivatives of the height's error by the unknowns of the scene.
    alone, variance : shape (n,), m^2
        What no unknown and no neighbour tells; the whole.
    across : shape (n, 3), m^2
        Covariance of the point with the height.
    """

    off: Array
    normal: Array
    shared: csr_array
    alone: Array
    variance: Array
    across: Array


def with_ground(points: MeasuredPoints, wanted: NDArray[np.bool_]) -> MeasuredPoints:
    """Places of rays, and of the ground where it is `wanted`, (n,), and does not contradict them.

    What was done otherwise than it was wanted, and where the ground would help much, is told in
    the doubts.
    """
    used = np.bincount(points.marks.point[points.marks.used], minlength=len(points))
    asked = np.flatnonzero(wanted | (used <= _FEW_RAYS))
    if len(asked) == len(points) > 0:
        return _with_ground(points, wanted)
    if not len(asked):
        return points
    rest = np.setdiff1d(np.arange(len(points)), asked)
    both = MeasuredPoints.joined(
        _with_ground(points.subset(asked), wanted[asked]), points.subset(rest)
    )
    order = np.argsort(np.concatenate([asked, rest]))
    return both.subset(order).with_refused(points.refused)


def _with_ground(points: MeasuredPoints, wanted: NDArray[np.bool_]) -> MeasuredPoints:
    ground = _under(points)
    unsure, gain = _fused(points, ground)
    with np.errstate(invalid="ignore"):
        fits = np.abs(ground.off) <= CONTRADICTS * unsure
    chosen = wanted & fits
    moved = _moved(points, ground, gain)
    lines = _told(points, ground, unsure, moved.each, wanted)
    kept = np.where(chosen[:, None], gain, 0.0)
    out = _moved(points, ground, kept) if chosen.any() else points
    methods = tuple(METHOD if c else m for c, m in zip(chosen, points.methods, strict=True))
    chi2 = points.chi2 + np.where(chosen, (ground.off / unsure) ** 2, 0.0)
    doubts = tuple(a + b for a, b in zip(points.doubts, lines, strict=True))
    return replace(out, methods=methods, chi2=chi2, doubts=doubts)


def _under(points: MeasuredPoints) -> _Heights:
    """The ground, and how its error hangs together with that of the points."""
    scene, n = points.scene, len(points)
    base = np.sqrt(np.trace(points.each[:, :2, :2], axis1=1, axis2=2) / 2.0)
    base = np.clip(base, _LEAST_BASE, _MOST_BASE)
    normal = ground_normal(scene.terrain, points.p_enu, base=base)
    # the level shifts photos and ground together
    level = points.shared[2::3, [scene.errors.size - 1]].toarray()
    parts = [(np.arange(n), np.full(n, scene.errors.size - 1), level)]
    alone = np.zeros(n)
    if scene.tied:
        tied = tied_heights(scene, points.p_enu, normal)
        cameras = scene.errors.camera_columns(tied.photo)
        parts += [
            (tied.place, 6 * tied.photo, tied.by_pose),
            (tied.place, cameras, tied.by_camera),
        ]
        alone = untied_variance(scene, tied)
    shared = _rows((n, scene.errors.size), parts)
    variance, across = _together(points, shared)
    return _Heights(
        off=scene.terrain.z_at(points.p_enu[:, :2]) - points.p_enu[:, 2],
        normal=normal,
        shared=shared,
        alone=alone,
        variance=variance + scene.ground.variance(points.p_enu[:, :2]) + alone,
        across=across,
    )


def _rows(shape: tuple[int, int], parts: Sequence[tuple[Ints, Ints, Array]]) -> csr_array:
    """Matrix with a row for each point, of its number (m,), first column (m,), values (m, k)."""
    rows = [np.repeat(point, values.shape[1]) for point, _, values in parts]
    columns = [(at[:, None] + np.arange(values.shape[1])).ravel() for _, at, values in parts]
    ij = np.concatenate(rows), np.concatenate(columns)
    return csr_array((np.concatenate([values.ravel() for *_, values in parts]), ij), shape=shape)


def _together(points: MeasuredPoints, shared: csr_array) -> tuple[Array, Array]:
    """Variances (n,) of heights by the unknowns, and covariances (n, 3) with their points."""
    errors, n = points.scene.errors, len(points)
    variance, across = np.zeros(n), np.zeros((n, 3))
    first = np.zeros(n, dtype=np.int64)
    first[points.marks.point[::-1]] = points.marks.photo[::-1]
    order = np.argsort(first, kind="stable")
    for at in (order[i : i + _PART] for i in range(0, n, _PART)):
        rows = (3 * at[:, None] + np.arange(3)).ravel()
        mine, heights = points.shared[rows], shared[at]
        n_photos = len(points.scene.photos)
        photos = np.union1d(photos_in(mine, n_photos), photos_in(heights, n_photos))
        columns = errors.columns(photos)
        T = heights[:, columns].toarray()
        by_unknown = errors.joint(photos) @ T.T
        variance[at] = np.einsum("ku,uk->k", T, by_unknown)
        S = mine[:, columns].toarray().reshape(len(at), 3, -1)
        across[at] = np.einsum("kiu,uk->ki", S, by_unknown)
    return variance, across


def _fused(points: MeasuredPoints, ground: _Heights) -> tuple[Array, Array]:
    """One sigma of point over ground, (n,) m, and gain of the place by the ground, (n, 3)."""
    by_normal = np.einsum("nij,nj->ni", points.each, ground.normal)
    variance = np.einsum("ni,ni->n", by_normal, ground.normal) + ground.variance
    variance -= 2.0 * np.einsum("ni,ni->n", ground.normal, ground.across)
    # rounding may leave nothing of a height that the rays know as exactly as the ground does
    variance = np.maximum(variance, 1e-12)
    return np.sqrt(variance), (by_normal - ground.across) / variance[:, None]


def _moved(points: MeasuredPoints, ground: _Heights, gain: Array) -> MeasuredPoints:
    """Points by rays and ground: true minus stated is `(I - K n) e + K g` of both errors."""
    n, scene = len(points), points.scene
    keep = np.eye(3) - gain[:, :, None] * ground.normal[:, None, :]
    both = keep @ ground.across[:, :, None] * gain[:, None, :]
    outer = gain[:, :, None] * gain[:, None, :]
    each = keep @ points.each @ np.swapaxes(keep, 1, 2) + both + np.swapaxes(both, 1, 2)
    blocks = bsr_array((keep, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
    rows = np.arange(3 * n)
    by_height = csr_array((gain.ravel(), (rows, rows // 3)), shape=(3 * n, n))
    own = keep @ points.own @ np.swapaxes(keep, 1, 2) + outer * ground.alone[:, None, None]
    p = _places(points, ground, gain)
    marks = points.marks
    seen = scene.photos.project(marks.photo, p[marks.point])
    return replace(
        points,
        p_enu=p,
        each=each + outer * ground.variance[:, None, None],
        own=own,
        by_height=gain,
        shared=csr_array(blocks @ points.shared + by_height @ ground.shared),
        marks=replace(marks, residuals=marks.uv - seen),
    )


def _places(points: MeasuredPoints, ground: _Heights, gain: Array) -> Array:
    """Places on the tangent plane of the ground below them; (n, 3) m."""
    p, off = points.p_enu, ground.off
    for _ in range(_ROUNDS):
        p = points.p_enu + gain * np.nan_to_num(off)[:, None]
        away = np.einsum("ni,ni->n", ground.normal[:, :2], p[:, :2] - points.p_enu[:, :2])
        there = points.scene.terrain.z_at(p[:, :2]) + away - points.p_enu[:, 2]
        off = np.where(np.isfinite(there), there, off)
    return np.asarray(p)


def _told(
    points: MeasuredPoints,
    ground: _Heights,
    unsure: Array,
    each: Array,
    wanted: NDArray[np.bool_],
) -> list[tuple[str, ...]]:
    """What a person should know of each point and the ground, in words."""
    before, after = (_largest(C) for C in (points.each, each))
    out: list[tuple[str, ...]] = []
    for i, is_wanted in enumerate(wanted):
        off, sigma = float(ground.off[i]), float(unsure[i])
        line = ""
        if is_wanted and not math.isfinite(off):
            line = "the ground is not known there: it is not used"
        elif is_wanted and abs(off) > CONTRADICTS * sigma:
            side = "above" if off < 0.0 else "below"
            line = (
                f"its rays meet {abs(off):.2f} +- {sigma:.2f} m {side} the ground: the ground is "
                "not used; a mark is wrong, or it does not stand on the ground"
            )
        elif not is_wanted and abs(off) <= CONTRADICTS * sigma and after[i] < _WORTH * before[i]:
            line = (
                f"{SURER}: one sigma {after[i]:.2g} m instead of {before[i]:.2g} m in the plan; "
                "if the spot lies on the ground, say so (ground = on)"
            )
        out.append((line,) if line else ())
    return out


def _largest(covariances: Array) -> Array:
    """Largest sigma in the plan of covariances (n, 3, 3); (n,) m."""
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(covariances[:, :2, :2])[:, 1], 0.0)))
