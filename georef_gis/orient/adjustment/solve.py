"""Levenberg-Marquardt over the reduced normal equations, with a loss that tightens as it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from georef_gis.errors import AdjustmentError
from georef_gis.orient.adjustment.problem import Problem, State

# of a residual's sigma, where Cauchy's loss begins to bend in the end
FINAL_SCALE = 3.0
MOST_STEPS = 60
# of the cost, which counts half squared sigmas: a step that gains less ends the search
GAIN = 0.003
SMALLEST_DAMPING = 1e-14
# how often points are placed by the first poses before these move
FIRST_ROUNDS = 3

Cancelled = Callable[[], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """How residuals count: squared up to `scale` sigmas, less beyond.

    Huber's keeps the search convex while it is far off; Cauchy's leaves wrong matches hardly any
    say, but from far off its steps crawl.
    """

    kind: Literal["none", "huber", "cauchy"]
    scale: float

    @property
    def signed(self) -> float:
        """Squared scale as the kernels take it: negative for Huber's, 0 for none."""
        return {"none": 0.0, "huber": -1.0, "cauchy": 1.0}[self.kind] * self.scale**2

    @property
    def is_final(self) -> bool:
        """Whether nothing tighter follows."""
        return self.kind != "huber"


NONE = Loss(kind="none", scale=0.0)
FINAL = Loss(kind="cauchy", scale=FINAL_SCALE)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Where the search ended.

    Parameters
    ----------
    state
        Values of all unknowns.
    cost
        Robust image cost plus prior cost.
    loss
        At the end, in sigmas of the observations.
    steps
        How many were taken.
    converged
        Whether the last step changed nothing to speak of.
    """

    state: State
    cost: float
    loss: Loss
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
        Where the loss begins; by default from the residuals of the start, and tightened. At
        `FINAL_SCALE` the search is Cauchy's from the start.
    gain
        Of the cost, below which a step ends the search.

    Raises
    ------
    AdjustmentError
        If the normal equations cannot be solved at all.
    """
    state = start
    loss = _first_loss(problem, state, scale) if robust else NONE
    if loss.kind == "huber":
        for _ in range(FIRST_ROUNDS):
            state = problem.with_placed_points(state, loss.signed)
        loss = _first_loss(problem, state, scale)
    cost = _cost(problem, state, loss)
    damping, rejected = 1e-5, 0
    for step in range(1, steps + 1):
        if cancelled is not None and cancelled():
            break
        moved, damping = _try(problem, state, loss, damping)
        new = _cost(problem, moved, loss)
        better = new < cost
        if better:
            gained, state, cost, rejected = cost - new, moved, new, 0
            damping = max(damping / 50.0, SMALLEST_DAMPING)
            enough = gained < (gain if loss.is_final else 0.1 * (cost + gained))
        else:
            rejected += 1
            damping = max(damping, 1e-9) * 8.0
            enough = damping > 1e8 or (rejected > 3 and abs(new - cost) <= gain)
        if not enough:
            continue
        if loss.is_final:
            return Solution(state=state, cost=cost, loss=loss, steps=step, converged=True)
        loss = _tightened(problem, state, loss)
        cost, rejected = _cost(problem, state, loss), 0
    return Solution(state=state, cost=cost, loss=loss, steps=steps, converged=False)


def _cost(problem: Problem, state: State, loss: Loss) -> float:
    return problem.image_cost(state, loss.signed)[0] + problem.prior_cost(state)


def _try(problem: Problem, state: State, loss: Loss, damping: float) -> tuple[State, float]:
    """State after one damped step, and the damping that it took to make the matrix sound."""
    for _ in range(12):
        reduced = problem.reduced(state, loss.signed, damping)
        try:
            factor, rhs = problem.factor(state, reduced, damping)
            step = factor.solve(rhs)
        except np.linalg.LinAlgError:
            damping = max(damping, 1e-9) * 20.0
            continue
        return problem.moved(state, step, loss.signed, damping), damping
    raise AdjustmentError(
        "the normal equations cannot be solved: the photos are not held by their priors; "
        "state sigmas of positions and angles"
    )


def _first_loss(problem: Problem, state: State, scale: float | None) -> Loss:
    """Loss that keeps most of the observations in its quadratic part."""
    if scale is not None:
        return Loss(kind="cauchy" if scale <= FINAL_SCALE else "huber", scale=scale)
    if not len(problem.sigma):
        return FINAL
    return Loss(kind="huber", scale=max(FINAL_SCALE, 3.0 * _typical(problem, state)))


def _tightened(problem: Problem, state: State, loss: Loss) -> Loss:
    """Next loss: a narrower Huber's while residuals shrink, Cauchy's at the end."""
    if loss.scale <= FINAL_SCALE:
        return FINAL
    scale = max(FINAL_SCALE, min(loss.scale / 2.0, 3.0 * _typical(problem, state)))
    return Loss(kind="huber", scale=scale)


def _typical(problem: Problem, state: State) -> float:
    """Median residual in sigmas of one coordinate."""
    _, r, _ = problem.image_cost(state, NONE.signed)
    ratio = np.hypot(r[:, 0], r[:, 1]) / problem.sigma
    ratio = ratio[np.isfinite(ratio)]
    # the median of a Rayleigh distribution is 1.18 sigma
    return float(np.median(ratio)) / 1.18 if len(ratio) else FINAL_SCALE
