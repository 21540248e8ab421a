"""Similarity from a frame of its own to the Earth's, by positions that may be wrong.

Heights of receivers and barometers can drift by 100 m over one flight, and a plain similarity
tilts a block by as much as they tell it to. Here the level comes from the photos' attitudes, the
rest from the horizontal positions by a search that wrong ones cannot sway; heights turn the block
only as far as the attitudes leave room for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, exp_so3, skew
from georef_gis.model.interchange.block import Similarity
from georef_gis.orient.level import Level
from georef_gis.orient.similarity_search import OUTLIER, Mask, extent, search_3d, search_level

# share of its length by which a block without positions bends
BENDING = 0.003
# relative, one sigma of the scale; more and the positions do not tell it
WORST_SCALE = 0.2
# rad, one sigma of the level; more and nothing tells how the block lies about its line
WORST_LEVEL = math.radians(15.0)
# tilts against the attitudes by more than this many sigmas are the heights' fault
TILT_TEST = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimilarityFit:
    """A similarity and what it rests on.

    Parameters
    ----------
    inliers : shape (n,)
        Positions that agree horizontally.
    heights_used
        Whether heights had a say in the tilt; if not, their median sets the height alone.
    rms_h, rms_v : m
        Root mean square of the residuals of the inliers per horizontal axis and in height.
    """

    similarity: Similarity
    inliers: Mask
    heights_used: bool
    rms_h: float
    rms_v: float
    doubts: tuple[str, ...] = ()


def estimate_similarity(
    p_from: Array,
    p_to: Array,
    *,
    sigma_h: Array,
    sigma_v: Array,
    level: Level | None = None,
    seed: int = 1,
) -> SimilarityFit:
    """Robust similarity of places in one frame to the same in enu.

    Parameters
    ----------
    p_from : shape (n, 3)
        In the frame that is to be placed.
    p_to : shape (n, 3), m
        In enu; a height that is not known is NaN.
    sigma_h, sigma_v : shape (n,), m
        One standard deviation per horizontal axis, and of the heights.
    level
        What is known of the vertical; None = heights alone must tell it.

    Raises
    ------
    GeometryError
        If there are fewer than three positions, if they lie on a line and nothing tells the
        level, if no scale fits half of them, or if they do not tell the scale.
    """
    known = np.all(np.isfinite(p_from), axis=1) & np.all(np.isfinite(p_to[:, :2]), axis=1)
    if np.count_nonzero(known) < 3:
        raise GeometryError(
            f"{np.count_nonzero(known)} positions are known and three are needed to place a block"
        )
    a, b = p_from[known], p_to[known]
    s_h, s_v = sigma_h[known], sigma_v[known]
    tolerance = OUTLIER * np.hypot(s_h, BENDING * extent(b[:, :2]))
    rng = np.random.default_rng(seed)
    if level is None:
        start, inliers = search_3d(a, b, tolerance, np.hypot(s_v, tolerance), rng)
        fit = _refined(a, b, start, inliers, (s_h, s_v), None)
    else:
        start, inliers = search_level(a, b, tolerance, level, rng)
        fit = _with_level(a, b, start, inliers, (s_h, s_v), level)
    _check(fit, b)
    out = np.zeros(len(p_from), dtype=np.bool_)
    out[np.flatnonzero(known)[fit.inliers]] = True
    return replace(fit, inliers=out)


# -- refinement --------------------------------------------------------------------------------


def _with_level(
    a: Array, b: Array, start: Similarity, inliers: Mask, sigmas: tuple[Array, Array], level: Level
) -> SimilarityFit:
    """Refined fit; heights that tilt the block against the attitudes are left out."""
    use = inliers & np.isfinite(b[:, 2])
    tilt, excess, spread = _slope_of_heights(a, b, start, use, sigmas[1], level)
    if np.count_nonzero(use) >= 3 and excess <= TILT_TEST:
        s_v = np.maximum(sigmas[1], spread)
        return _refined(a, b, start, inliers, (sigmas[0], s_v), level)
    # The level is held: by the squeeze of its plan alone a block would tilt as its bends want.
    held = replace(level, sigma=1e-6)
    flat = np.column_stack([b[:, :2], np.full(len(b), np.nan)])
    fit = _refined(a, flat, start, inliers, sigmas, held)
    covariance = fit.similarity.covariance.copy()
    covariance[[1, 2], [1, 2]] = level.sigma**2
    fit = replace(fit, similarity=replace(fit.similarity, covariance=covariance))
    off = (b - fit.similarity.apply(a))[use, 2]
    if not len(off):
        doubt = "no position has a height: the block's height is not known"
        return replace(fit, heights_used=False, doubts=(doubt,))
    middle = float(np.median(off))
    sigma = max(1.4826 * float(np.median(np.abs(off - middle))), float(np.median(sigmas[1][use])))
    similarity = fit.similarity
    # What makes heights slope is shared by all of them, so their number does not help.
    covariance[6, 6] += sigma**2
    fit = replace(
        fit,
        similarity=replace(
            similarity, shift=similarity.shift + np.array([0.0, 0.0, middle]), covariance=covariance
        ),
        rms_v=float(np.sqrt(np.mean((off - middle) ** 2))),
    )
    if excess <= TILT_TEST:
        return fit
    doubt = (
        f"the heights would tilt the block by {math.degrees(tilt):.1f} deg against the attitudes: "
        f"their median alone is used (they spread by {sigma:.1f} m)"
    )
    return replace(fit, doubts=(doubt,))


def _slope_of_heights(
    a: Array, b: Array, start: Similarity, use: Mask, sigma_v: Array, level: Level
) -> tuple[float, float, float]:
    """Tilt that heights ask for, rad; that in sigmas of it; and the heights' own spread, m.

    A plane through the differences in height from the level block, by a Cauchy loss.
    """
    if np.count_nonzero(use) < 3:
        return 0.0, 0.0, 0.0
    placed = start.apply(a[use])
    e = b[use, 2] - placed[:, 2]
    xy = placed[:, :2] - placed[:, :2].mean(axis=0)
    size = max(float(np.sqrt(np.mean(xy**2))), 1e-9)
    A = np.column_stack([np.ones(len(e)), xy / size])
    # So weak that it holds only what the positions leave open: the tilt about a single strip.
    ridge = np.diag([0.0, 1.0, 1.0]) * 1e-4
    x = np.array([np.median(e), 0.0, 0.0])
    spread = float(np.median(sigma_v[use]))
    for _ in range(50):
        r = e - A @ x
        spread = max(1.4826 * float(np.median(np.abs(r))), 1e-3)
        weight = 1.0 / (1.0 + (r / (2.0 * spread)) ** 2)
        N = (A * weight[:, None]).T @ A + ridge
        x = np.linalg.solve(N, A.T @ (weight * e))
    noise = max(spread, float(np.median(sigma_v[use])))
    slope = x[1:] / size
    own = np.linalg.inv(N)[1:, 1:] * (noise / size) ** 2
    S = own + np.eye(2) * level.sigma**2
    excess = math.sqrt(float(slope @ np.linalg.solve(S, slope)))
    return math.atan(float(np.hypot(*slope))), excess, spread


def _refined(
    a: Array,
    b: Array,
    start: Similarity,
    inliers: Mask,
    sigmas: tuple[Array, Array],
    level: Level | None,
) -> SimilarityFit:
    """Gauss-Newton with a Cauchy loss on positions, heights (where known) and the level."""
    p, q = a[inliers], b[inliers]
    s_h, s_v = sigmas[0][inliers], sigmas[1][inliers]
    sigma = np.column_stack([s_h, s_h, s_v])
    has_z = np.isfinite(q[:, 2])
    pivot = p.mean(axis=0)
    scale, R, at = start.scale, start.R_to_from, start.apply(pivot)
    for _ in range(60):
        arm = scale * (p - pivot) @ R.T
        r = q - (arm + at)
        r[~has_z, 2] = 0.0
        weight = _weights(r, sigma, has_z)
        N, g = _normal(arm, r, weight, R, level)
        if not np.any(has_z):
            N[6, 6] += 1.0
        step = np.linalg.lstsq(N, g, rcond=1e-14)[0]
        scale *= math.exp(float(np.clip(step[0], -0.5, 0.5)))
        R = exp_so3(step[1:4]) @ R
        at = at + step[4:]
        if np.max(np.abs(step[:4])) < 1e-12 and np.max(np.abs(step[4:])) < 1e-9:
            break
    u, _, vt = np.linalg.svd(R)
    R = u @ vt
    covariance = np.asarray(np.linalg.pinv(N, hermitian=True, rcond=1e-14), dtype=np.float64)
    if not np.any(has_z):
        covariance[6, :] = covariance[:, 6] = 0.0
    # sigma0 only makes worse: fewer than 10 degrees of freedom say little about it.
    freedom = 2 * len(p) + int(np.count_nonzero(has_z)) - 7
    if freedom >= 10:
        covariance = covariance * max(1.0, float(np.sum(weight * r**2)) / freedom)
    similarity = Similarity(
        scale=scale, R_to_from=R, shift=at - scale * R @ pivot, pivot=pivot, covariance=covariance
    )
    return SimilarityFit(
        similarity=similarity,
        inliers=inliers,
        heights_used=bool(np.any(has_z)),
        rms_h=float(np.sqrt(np.mean(r[:, :2] ** 2))),
        rms_v=float(np.sqrt(np.mean(r[has_z, 2] ** 2))) if np.any(has_z) else math.nan,
    )


def _weights(r: Array, sigma: Array, has_z: Mask) -> Array:
    """Weights of the residuals, 1/m^2; shape (n, 3). Noise of one sigma is hardly weighed down."""
    off_h = np.hypot(r[:, 0] / sigma[:, 0], r[:, 1] / sigma[:, 1])
    off_v = np.abs(r[:, 2]) / sigma[:, 2]
    loss = 1.0 / (1.0 + (np.column_stack([off_h, off_h, off_v]) / OUTLIER) ** 2)
    loss[~has_z, 2] = 0.0
    return np.asarray(loss / sigma**2)


def _normal(
    arm: Array, r: Array, weight: Array, R: Array, level: Level | None
) -> tuple[Array, Array]:
    """Normal equations of (ds / s, dtheta, dp); shapes (7, 7) and (7,)."""
    J = np.zeros((len(arm), 3, 7))
    J[:, :, 0] = arm
    J[:, :, 1:4] = -skew(arm)
    J[:, :, 4:] = np.eye(3)
    N = np.einsum("nki,nk,nkj->ij", J, weight, J)
    g = np.einsum("nki,nk,nk->i", J, weight, r)
    if level is not None:
        # Exp(dtheta) R up = vertical, so dtheta is about (R up) x vertical.
        off = np.cross(R @ level.up_from, [0.0, 0.0, 1.0])[:2]
        N[1:3, 1:3] += np.eye(2) / level.sigma**2
        g[1:3] += off / level.sigma**2
    return N, g


def _check(fit: SimilarityFit, b: Array) -> None:
    """Refuse a scale or a level that the positions do not tell."""
    sigma = np.sqrt(np.maximum(np.diag(fit.similarity.covariance), 0.0))
    if not sigma[0] <= WORST_SCALE:
        raise GeometryError(
            f"the positions lie within {extent(b[:, :2]):.1f} m, too close to each other for "
            f"their errors: the scale is known to {sigma[0]:.0%} only"
        )
    if not max(sigma[1], sigma[2]) <= WORST_LEVEL:
        raise GeometryError(
            "the positions lie on one line and no attitude tells how the block lies about it; "
            "give attitudes, or a position off the line"
        )
