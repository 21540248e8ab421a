"""Which adjusted points may carry a ground: those seen by two photos only are easily false.

A wrong match along the epipolar line leaves no residual, and water moves between two exposures;
a third ray shows both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from georef_gis.model.tie_points import GroundPoints

NEIGHBOURS = 8
# sigmas that a point of two rays may stand off its surroundings
OFF = 3.0
# of the usual distance to the eighth neighbour; further off nobody vouches for a point
FAR = 4.0
# fewer points of three rays, or a smaller share, and all are taken as they are
FEWEST, LEAST_SHARE = 50, 0.2


def trusted(points: GroundPoints) -> GroundPoints:
    """Points of three and more rays, and those of two that agree with them."""
    keep = trust(points)
    return replace(
        points,
        p_enu=points.p_enu[keep],
        covariance=points.covariance[keep],
        rays=points.rays[keep],
        residual_px=points.residual_px[keep],
    )


def trust(points: GroundPoints) -> NDArray[np.bool_]:
    """Whether each point may carry the ground; (n,)."""
    sound = np.all(np.isfinite(points.p_enu), axis=1)
    sure = sound & (points.rays >= 3)
    pairs = sound & (points.rays < 3)
    if sure.sum() < max(FEWEST, LEAST_SHARE * len(points)) or not np.any(pairs):
        return np.ones(len(points), dtype=np.bool_)
    tree = cKDTree(points.p_enu[sure, :2])
    z = points.p_enu[sure, 2]
    own, _ = tree.query(points.p_enu[sure, :2], NEIGHBOURS + 1)
    reach = FAR * float(np.median(own[:, -1]))
    distance, near = tree.query(points.p_enu[pairs, :2], NEIGHBOURS)
    around = z[near]
    level = np.median(around, axis=1)
    # relief about the point, as its surroundings have it
    spread = 1.4826 * np.median(np.abs(around - level[:, None]), axis=1)
    variance = points.covariance[pairs, 2, 2]
    sigma = np.sqrt(spread**2 + np.where(np.isfinite(variance), _apart(variance), 0.0))
    off = np.abs(points.p_enu[pairs, 2] - level)
    keep = np.ones(len(points), dtype=np.bool_)
    keep[pairs] = (off <= OFF * np.maximum(sigma, 1e-3)) & (distance[:, -1] <= reach)
    return keep


def _apart(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variances without what all points share: the smallest of them."""
    return np.asarray(variance - np.nanmin(variance))
