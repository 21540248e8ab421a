"""Similarity that most positions agree with: a search that wrong ones cannot sway.

Umeyama (1991), "Least-squares estimation of transformation parameters between two point patterns".
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, exp_so3
from georef_gis.model.interchange.block import Similarity
from georef_gis.orient.level import Level

Mask = NDArray[np.bool_]

# sigmas: further off is an outlier
OUTLIER = 3.5
# share of the positions that must agree
AGREEMENT = 0.5
_TRIALS = 2000
_LARGEST = 4_000_000


def extent(p: Array) -> float:
    """Size of a set of places, m, by its middle 90 %: a far one does not stretch it."""
    low, high = np.percentile(p, [5, 95], axis=0)
    return float(np.linalg.norm(high - low))


def _enough(count: int, n: int) -> None:
    if count < max(3, math.ceil(AGREEMENT * n)):
        raise GeometryError(
            f"no scale and heading bring more than {count} of {n} positions together: they are of "
            "other photos, or their errors are larger than they state; give positions in a file"
        )


def search_level(
    a: Array, b: Array, tolerance: Array, level: Level, rng: np.random.Generator
) -> tuple[Similarity, Mask]:
    """Scale, heading and shift that most positions agree with, the vertical being known.

    Pairs of positions make the hypotheses: all of them for few photos, drawn at random for many.
    """
    R_level = _level_rotation(level.up_from)
    q = a @ R_level.T
    # What stands high moves sideways with an error of the level.
    shape = np.percentile(q, 95, axis=0) - np.percentile(q, 5, axis=0)
    high = shape[2] / max(float(np.hypot(*shape[:2])), 1e-12) * extent(b[:, :2])
    tolerance = np.hypot(tolerance, OUTLIER * level.sigma * min(high, extent(b[:, :2])))
    z, w = q[:, 0] + 1j * q[:, 1], b[:, 0] + 1j * b[:, 1]
    pairs = _pairs(z, rng)
    if not len(pairs):
        raise GeometryError("all shots of the block are at one place: it has no scale")
    i, j = pairs.T
    turn = (w[j] - w[i]) / (z[j] - z[i])
    shift = w[i] - turn * z[i]
    off = np.abs(turn[:, None] * z + shift[:, None] - w) / tolerance
    cost = np.sum(np.minimum(off, 1.0) ** 2, axis=1)
    best = int(np.argmin(cost))
    inliers = off[best] < 1.0
    _enough(int(np.count_nonzero(inliers)), len(a))
    scale, heading = abs(turn[best]), np.angle(turn[best])
    if not scale > 0.0:
        raise GeometryError("all positions are one: the block has no scale")
    R = exp_so3([0.0, 0.0, float(heading)]) @ R_level
    at = np.array([shift[best].real, shift[best].imag, 0.0])
    up = b[:, 2] - scale * q[:, 2]
    at[2] = float(np.nanmedian(up[inliers])) if np.any(np.isfinite(up[inliers])) else 0.0
    return Similarity(scale=float(scale), R_to_from=R, shift=at), inliers


def _pairs(z: NDArray[np.complex128], rng: np.random.Generator) -> NDArray[np.int64]:
    """Pairs of places that lie far apart; shape (m, 2)."""
    n = len(z)
    trials = min(_TRIALS, max(200, _LARGEST // n))
    if n * (n - 1) // 2 <= trials:
        pairs = np.column_stack(np.triu_indices(n, 1))
    else:
        pairs = rng.integers(0, n, (4 * trials, 2))
    length = np.abs(z[pairs[:, 0]] - z[pairs[:, 1]])
    # Short ones magnify the error of a position; half of all pairs are longer than the median.
    far = length >= max(float(np.median(length)) * 0.99, 1e-12)
    return np.asarray(pairs[far][:trials], dtype=np.int64)


def _level_rotation(up: Array) -> Array:
    """A rotation that brings a direction to the third axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(helper, up)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(up, first), up])


def search_3d(
    a: Array, b: Array, tolerance: Array, tolerance_v: Array, rng: np.random.Generator
) -> tuple[Similarity, Mask]:
    """Similarity that most positions with heights agree with, by triples."""
    full = np.isfinite(b[:, 2])
    if np.count_nonzero(full) < 3:
        raise GeometryError(
            "nothing tells how the block lies: neither attitudes nor three heights are known"
        )
    places = np.flatnonzero(full)
    best: tuple[float, Similarity | None, Mask] = (math.inf, None, full)
    for _ in range(min(_TRIALS // 4, 20 * len(places) ** 2)):
        three = rng.choice(places, 3, replace=False)
        if _thinness(a[three]) < 0.1:
            continue
        found = umeyama(a[three], b[three])
        off = found.apply(a) - b
        far = np.hypot(off[:, 0], off[:, 1]) / tolerance
        high = np.where(full, np.abs(off[:, 2]) / (OUTLIER * tolerance_v), 1.0)
        cost = float(np.sum(np.minimum(np.maximum(far, high), 1.0) ** 2))
        if cost < best[0]:
            best = (cost, found, np.asarray((far < 1.0) & (high < 1.0)))
    if best[1] is None:
        raise GeometryError(
            "the positions lie on one line and no attitude tells how the block lies about it; "
            "give attitudes, or a position off the line"
        )
    _enough(int(np.count_nonzero(best[2])), len(a))
    return best[1], best[2]


def _thinness(p: Array) -> float:
    """Second over first singular value of places about their middle: 0 on a line."""
    values = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    return float(values[1] / max(values[0], 1e-300))


def umeyama(p_from: Array, p_to: Array) -> Similarity:
    """Least-squares similarity of places, all of one weight; shapes (n, 3), n >= 3.

    Raises
    ------
    GeometryError
        If the places lie on a line.
    """
    if _thinness(p_from) < 1e-9:
        raise GeometryError("the places lie on one line: the rotation about it is not told")
    mean_from, mean_to = p_from.mean(axis=0), p_to.mean(axis=0)
    x, y = p_from - mean_from, p_to - mean_to
    u, d, vt = np.linalg.svd(y.T @ x)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    R = (u * sign) @ vt
    scale = float(d @ sign / np.sum(x**2))
    return Similarity(scale=scale, R_to_from=R, shift=mean_to - scale * R @ mean_from)
