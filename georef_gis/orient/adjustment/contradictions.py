"""Navigation that the pixels contradict: let loose, told by its matches, weighed down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.orient.adjustment.flight_model import DOUBTED
from georef_gis.orient.adjustment.misplaced import misplaced, moved_start
from georef_gis.orient.adjustment.problem import Problem, State
from georef_gis.orient.adjustment.solve import FINAL_SCALE, Cancelled, Solution, solve
from georef_gis.orient.adjustment.wrong_matches import WRONG

# rounds in which photos are let loose
ROUNDS = 8
# of a photo's matches: where more lie far off, they are held against its navigation
CONTRADICTED = 0.5
# of the photos of a flight that may be let loose
MOST_FREED = 0.4
# m and rad, one sigma of a navigation that is worth nothing
LOOSE = np.array([300.0, 300.0, 300.0, 0.7, 0.7, 0.7])
# gain in cost that ends a search whose answer is weighed anew
ROUGH = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubted:
    """A part of a photo's navigation that contradicts the rest and was weighed down.

    `component` counts dp_enu, dtheta_enu; `sigmas` is how far off it is.
    """

    photo: int
    component: int
    sigmas: float


def freed(problem: Problem, cancelled: Cancelled | None) -> tuple[Solution, list[Doubted]]:
    """Solution where photos that all their matches contradict went where these put them.

    A receiver that is sure of a wrong place outweighs any pixel. Such photos are let loose; where
    their matches agree among themselves, the navigation is what is weighed down.
    """
    move = misplaced(problem)
    loose = np.any(move != 0.0, axis=1)
    if np.any(loose):
        problem.start = moved_start(problem, move)
        _loosen(problem, loose, 1.0)
    first = free = solve(problem, problem.start, gain=ROUGH, cancelled=cancelled)
    for _ in range(ROUNDS):
        # the worst bend the block, and hide others that are wrong
        more = _held_wrongly(problem, free.state, loose)
        if not np.any(more):
            break
        loose |= more
        _loosen(problem, more, 1.0)
        # the loss begins where their pixels still count
        scale = 3.0 * float(_contradicted(problem, problem.start)[1][loose].max())
        free = solve(problem, problem.start, scale=scale, gain=ROUGH, cancelled=cancelled)
    if not np.any(loose):
        return first, []
    _loosen(problem, loose, -1.0)
    back = loose & (_contradicted(problem, free.state)[0] > CONTRADICTED)
    state = replace(
        free.state,
        origin=np.where(back[:, None], first.state.origin, free.state.origin),
        rotation=np.where(back[:, None, None], first.state.rotation, free.state.rotation),
    )
    doubted: list[Doubted] = []
    # all at once: one that is still held would have its matches taken out
    while found := weigh_down(problem, state):
        doubted += found
    return replace(free, state=state), doubted


def _held_wrongly(problem: Problem, state: State, loose: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Photos, beside those that are loose, whose matches contradict their navigation; (n,)."""
    n = len(problem.block.photo_ids)
    share, _ = _contradicted(problem, state)
    count = np.bincount(problem.ties.photo, minlength=n)
    out = np.zeros(n, dtype=np.bool_)
    for flight in problem.flights:
        seen = flight.prior.photos[count[flight.prior.photos] > 0]
        bad = seen[(share[seen] > CONTRADICTED) & ~loose[seen]]
        held = len(seen) - len(bad) - np.count_nonzero(loose[seen])
        # where most of a flight is off, it is not single photos that are wrong
        if held >= max((1.0 - MOST_FREED) * len(seen), 3):
            out[bad] = True
    return out


def _contradicted(problem: Problem, state: State) -> tuple[Array, Array]:
    """Share of each photo's matches that lie far off, and its median residual in sigmas; (n,)."""
    n = len(problem.block.photo_ids)
    _, r, _ = problem.image_cost(state, 0.0)
    ratio = np.hypot(r[:, 0], r[:, 1]) / problem.sigma
    good = ratio[np.isfinite(ratio)]
    far = ~(ratio <= WRONG * max(float(np.median(good)) / 1.18 if len(good) else 1.0, 1.0))
    count = np.bincount(problem.ties.photo, minlength=n)
    share = np.bincount(problem.ties.photo, weights=far, minlength=n) / np.maximum(count, 1)
    typical = np.zeros(n)
    for i in np.flatnonzero(count):
        own = ratio[problem.ties.photo == i]
        own = own[np.isfinite(own)]
        typical[i] = np.median(own) if len(own) else FINAL_SCALE
    return share, typical


def _loosen(problem: Problem, photos: NDArray[np.bool_], sign: float) -> None:
    """Add what makes the navigation of some photos worth nothing, or take it off again."""
    for flight in problem.flights:
        here = photos[flight.prior.photos]
        if np.any(here):
            flight.extra[here] += sign * LOOSE**2
            flight.renew()


def weigh_down(problem: Problem, state: State) -> list[Doubted]:
    """Trust contradicted parts of photos less, the worst first: it makes others look wrong."""
    found = []
    seen = np.bincount(problem.ties.photo, minlength=len(state.origin)) > 0
    for index, flight in enumerate(problem.flights):
        if np.count_nonzero(seen[flight.prior.photos]) < 3:
            continue
        d = flight.residual(state.origin, state.rotation, state.flights[index])
        off, sigma = flight.foretold(d)
        ratio = np.abs(off) / sigma
        wrong = ratio > max(DOUBTED, 0.5 * float(ratio.max()))
        if not np.any(wrong):
            continue
        flight.extra[wrong] += off[wrong] ** 2
        flight.renew()
        found += [
            Doubted(photo=int(flight.prior.photos[i]), component=int(c), sigmas=float(ratio[i, c]))
            for i, c in np.argwhere(wrong)
        ]
    return found
