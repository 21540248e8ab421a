"""Wrong matches taken out, and the scatter of the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import Solution

# of its sigma; a residual beyond is a wrong match and is taken out
WRONG = 5.0
# the plain scatter by that of the median, at most: real pixels have some tails
MOST_OF_MEDIAN = 1.25


def without_wrong(
    problem: Problem, solution: Solution
) -> tuple[Problem, Solution, NDArray[np.int64]]:
    """Problem without wrong matches; marks of control stay, they are judged by name."""
    _, r, _ = problem.image_cost(solution.state, 0.0)
    ratio = np.hypot(r[:, 0], r[:, 1]) / problem.sigma
    tie = problem.mark_of < 0
    # while sigma is not yet settled the scatter itself is the measure
    good = ratio[tie & np.isfinite(ratio)]
    typical = max(float(np.median(good)) / 1.18, 1.0) if len(good) else 1.0
    wrong = tie & ~(ratio <= WRONG * typical)
    n = len(problem.block.photo_ids)
    if not np.any(wrong):
        return problem, solution, np.zeros(n, dtype=np.int64)
    out = np.bincount(problem.ties.photo[wrong], minlength=n)
    return *_kept(problem, solution, ~wrong[tie]), out.astype(np.int64)


def _kept(
    problem: Problem, solution: Solution, keep: NDArray[np.bool_]
) -> tuple[Problem, Solution]:
    """Problem and solution with some of the tie observations; points left with one go."""
    block = problem.block
    old = block.ties
    # the tie observations of the problem stand in the order of the block's, sorted by photo
    order = np.lexsort((old.photo, old.point))
    mask = np.zeros(len(old.photo), dtype=np.bool_)
    mask[order] = keep
    rays = np.bincount(old.point[mask], minlength=old.n_points)
    new_block = replace(block, ties=old.selected(mask))
    if block.ground is not None:
        new_block = replace(new_block, ground=block.ground.selected(rays >= 2))
    stay = np.concatenate([rays >= 2, np.ones(len(problem.marked), dtype=np.bool_)])
    points = solution.state.points[stay]
    new = Problem(new_block, points)
    for fresh, known in zip(new.flights, problem.flights, strict=True):
        fresh.adopt(known)
    return new, replace(solution, state=replace(solution.state, points=points))


def freedom(problem: Problem) -> int:
    """Degrees of freedom of the tie points' pixels alone."""
    m = int(np.count_nonzero(problem.mark_of < 0))
    seen = len(np.unique(problem.ties.photo))
    return 2 * m - 3 * problem.block.ties.n_points - max(6 * seen - 7, 0)


def sigma0(problem: Problem, solution: Solution) -> float:
    """Scatter of the tie points' pixels by their stated sigma, when wrong matches are out."""
    tie = problem.mark_of < 0
    degrees = freedom(problem)
    if degrees <= 0:
        return 1.0
    _, r, _ = problem.image_cost(solution.state, 0.0)
    ratio = r[tie] / problem.ties.sigma[tie, None]
    ratio = ratio[np.all(np.isfinite(ratio), axis=1)]
    if not len(ratio):
        return 1.0
    # Sums see all of the scatter, but a photo that is still off spoils them; the median of a
    # Rayleigh distribution is 1.18 sigma.
    plain = np.sqrt(float(np.sum(ratio**2)) / degrees)
    share = np.sqrt(2.0 * len(ratio) / degrees)
    robust = float(np.median(np.hypot(ratio[:, 0], ratio[:, 1]))) / 1.18 * share
    return float(min(plain, MOST_OF_MEDIAN * robust))
