"""Which of two adjustments of the same photos agrees better with all that was observed."""

from __future__ import annotations

import numpy as np

from georef_gis.orient.adjustment.adjust import Adjusted
from georef_gis.orient.adjustment.kernels import CAMERA_UNKNOWNS
from georef_gis.orient.adjustment.level_check import FREE
from georef_gis.orient.adjustment.wrong_matches import WRONG

# chi-square that a match taken out, or a navigation weighed down, counts for
TAKEN_OUT = WRONG**2


def misfit(adjusted: Adjusted, *, scatter: float) -> float:
    """Chi-square of pixels, navigation, control and ground; of cameras all but focal lengths.

    Parameters
    ----------
    scatter
        What the stated sigma of tie pixels is multiplied by: the same for all that are compared.

    Notes
    -----
    Matches that were taken out and navigation that was weighed down count as if they stood where
    they just would not have been. So an answer gains nothing by calling its contradictions wrong.
    """
    problem, state = adjusted.problem, adjusted.solution.state
    _, r, _ = problem.image_cost(state, 0.0)
    sigma = problem.ties.sigma * np.where(problem.mark_of < 0, scatter, 1.0)
    seen = np.isfinite(r[:, 0])
    pixels = float(np.sum((r[seen] / sigma[seen, None]) ** 2))
    lost = int(adjusted.removed.sum()) + int(np.count_nonzero(~seen)) + len(adjusted.doubted)
    ground = problem.block.ground
    # a ground whose height was given up is a contradiction too
    lost += int(ground is not None and ground.sigma_free >= FREE)
    focal = slice(0, len(problem.camera_information), CAMERA_UNKNOWNS)
    moved = problem.shared_vector(state)[focal]
    own = float(np.sum(problem.camera_information[focal] * moved**2))
    return pixels + 2.0 * problem.prior_cost(state) - own + TAKEN_OUT * lost
