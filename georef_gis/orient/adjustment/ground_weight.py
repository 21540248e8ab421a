"""A measured surface as an observation of the points' heights, with an offset of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.orient.adjustment.block import GroundPrior
from georef_gis.orient.alike_errors import mean_over_blocks, scatter

# points on the surface from which on it counts
FEWEST = 12
# robust standard deviations beyond which a point is no ground: trees, roofs, wrong matches
CUT = 3.0
# independent heights at most: a surface may itself be tilted by its sigma over the site
MOST_INDEPENDENT = 12.0
# m; surfaces are not better known, nor do points fit them better
LEAST_SPREAD = 0.02
# fits of the plane, each without what stands off the one before
FITS = 6


def weigh_ground(ground: GroundPrior, points: Array, level: float = 0.0) -> GroundPrior:
    """Heights of the surface at the points as they are now, weighted by how well they fit.

    What is no ground keeps its weak knowledge, or rays that are nearly parallel had no depth.

    Parameters
    ----------
    points : shape (n, 3), m
        Tie points of the block, in the order of `ground.z_enu`.
    level : m
        What control adds to their heights.

    Returns
    -------
    GroundPrior
        The same one where there is no surface, or too few points lie on it.

    Notes
    -----
    A plane is free between points and surface while the spread is measured: the tilt of the block
    is what the surface is asked about. How many independent heights the points stand for follows
    from means over blocks of growing size (`mean_over_blocks`).
    """
    if ground.surface is None or len(points) < FEWEST:
        return ground
    z = ground.surface(points[:, :2])
    off = z - points[:, 2] - level
    on = np.isfinite(off)
    if np.count_nonzero(on) < FEWEST:
        return ground
    fits, left, _ = about_a_plane(points[on, :2], off[on])
    if np.count_nonzero(fits) < FEWEST:
        return ground
    xy, left = points[on, :2][fits], left[fits]
    spread = max(scatter(left), LEAST_SPREAD)
    _, of_mean = mean_over_blocks(xy, left)
    used = np.zeros(len(points), dtype=np.bool_)
    used[np.flatnonzero(on)[fits]] = True
    return replace(
        ground,
        z_enu=np.where(np.isfinite(z), z - level, ground.z_enu),
        sigma=np.where(used, np.hypot(spread, ground.sigma_surface), ground.sigma_other),
        independent=float(np.clip((spread / of_mean) ** 2, 1.0, MOST_INDEPENDENT)),
        sigma_offset=ground.sigma_free,
    )


def about_a_plane(xy: Array, off: Array) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which of the heights are ground, residuals of all about its plane, m, and its slope (2,)."""
    X = np.column_stack([np.ones(len(xy)), xy - xy.mean(axis=0)])
    left = off - np.median(off)
    keep, beta = np.ones(len(off), dtype=np.bool_), np.zeros(3)
    for _ in range(FITS):
        keep = np.abs(left - np.median(left[keep])) <= CUT * max(
            scatter(left[keep] - np.median(left[keep])), LEAST_SPREAD
        )
        beta, *_ = np.linalg.lstsq(X[keep], off[keep], rcond=1e-9)
        left = off - X @ beta
    return keep, left, np.asarray(beta[1:])
