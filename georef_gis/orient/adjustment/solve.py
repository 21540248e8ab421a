"""Levenberg-Marquardt over the reduced normal equations, with a loss that tightens as it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from georef_gis.errors import AdjustmentError
from georef_gis.frames import Array
from georef_gis.orient.adjustment.problem import Problem, State

# of a residual's sigma, where Cauchy's loss begins to bend in the end
FINAL_SCALE = 3.0
MOST_STEPS = 60
# of the cost, which counts half squared sigmas: a step that gains less ends the search
GAIN = 0.003
SMALLEST_DAMPING = 1e-14

Cancelled = Callable[[], bool]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Where the search ended.

    Parameters
    ----------
    state
        Values of all unknowns.
    cost
        Robust image cost plus prior cost.
    scale
        Of the loss at the end, in sigmas of the observations.
    steps
        How many were taken.
    converged
        Whether the last step changed nothing to speak of.
    """

    state: State
    cost: float
    scale: float
    steps: int
    converged: bool


def solve(
    problem: Problem,
    start: State,
    *,
    robust: bool = True,
    scale: float | None = None,
    steps: int = MOST_STEPS,
    gain: float = GAIN,
    cancelled: Cancelled | None = None,
) -> Solution:
    """Minimise the cost from a state.

    Parameters
    ----------
    robust
        Without, squares are minimised: for observations that are known to be clean.
    scale
        Where the loss begins; by default from the residuals of the start, and tightened.
    gain
        Of the cost, below which a step ends the search.

    Raises
    ------
    AdjustmentError
        If the normal equations cannot be solved at all.
    """
    state = start
    scale = _first_scale(problem, state, scale) if robust else 0.0
    cost = _cost(problem, state, scale)
    damping = 1e-5
    rejected = 0
    for step in range(1, steps + 1):
        if cancelled is not None and cancelled():
            break
        moved, damping = _try(problem, state, scale, damping)
        new = _cost(problem, moved, scale)
        if not new < cost:
            rejected += 1
            damping = max(damping, 1e-9) * 8.0
            if damping > 1e8 or (rejected > 3 and abs(new - cost) <= gain):
                if scale <= FINAL_SCALE:
                    return Solution(state=state, cost=cost, scale=scale, steps=step, converged=True)
                scale = _tightened(problem, state, scale)
                cost, damping, rejected = _cost(problem, state, scale), 1e-7, 0
            continue
        gained, state, cost, rejected = cost - new, moved, new, 0
        damping = max(damping / 50.0, SMALLEST_DAMPING)
        if scale > FINAL_SCALE and gained < 0.3 * (cost + gained):
            scale = _tightened(problem, state, scale)
            cost = _cost(problem, state, scale)
        elif gained < gain and scale <= FINAL_SCALE:
            return Solution(state=state, cost=cost, scale=scale, steps=step, converged=True)
    return Solution(state=state, cost=cost, scale=scale, steps=steps, converged=False)


def _cost(problem: Problem, state: State, scale: float) -> float:
    return problem.image_cost(state, scale * scale)[0] + problem.prior_cost(state)


def _try(problem: Problem, state: State, scale: float, damping: float) -> tuple[State, float]:
    """State after one damped step, and the damping that it took to make the matrix sound."""
    for _ in range(12):
        reduced = problem.reduced(state, scale * scale, damping)
        H, rhs = problem.dense_normal(state, reduced)
        try:
            step = solved(H, rhs, damping)
        except np.linalg.LinAlgError:
            damping = max(damping, 1e-9) * 20.0
            continue
        return problem.moved(state, step, scale * scale, damping), damping
    raise AdjustmentError(
        "the normal equations cannot be solved: the photos are not held by their priors; "
        "state sigmas of positions and angles"
    )


def solved(H: Array, rhs: Array, damping: float) -> Array:
    """Step of a damped normal matrix, scaled to a unit diagonal before it is factored."""
    diagonal = np.diag(H).copy()
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
    N = H * scale[:, None]
    N *= scale
    N[np.diag_indices_from(N)] = 1.0 + damping
    factor = cho_factor(N, lower=True, overwrite_a=True, check_finite=False)
    step = cho_solve(factor, rhs * scale, check_finite=False) * scale
    if not np.all(np.isfinite(step)):
        raise np.linalg.LinAlgError("step is not finite")
    return np.asarray(step)


def _first_scale(problem: Problem, state: State, scale: float | None) -> float:
    """Scale that keeps most of the observations in the quadratic part of the loss."""
    if scale is not None:
        return max(scale, FINAL_SCALE)
    if not len(problem.sigma):
        return FINAL_SCALE
    return max(FINAL_SCALE, 3.0 * _typical(problem, state))


def _tightened(problem: Problem, state: State, scale: float) -> float:
    return max(FINAL_SCALE, min(scale / 2.0, 3.0 * _typical(problem, state)))


def _typical(problem: Problem, state: State) -> float:
    """Median residual in sigmas of one coordinate."""
    _, r, _ = problem.image_cost(state, 0.0)
    ratio = np.hypot(r[:, 0], r[:, 1]) / problem.sigma
    ratio = ratio[np.isfinite(ratio)]
    # the median of a Rayleigh distribution is 1.18 sigma
    return float(np.median(ratio)) / 1.18 if len(ratio) else FINAL_SCALE
