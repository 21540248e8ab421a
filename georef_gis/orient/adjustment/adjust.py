"""The adjustment from block to answer: solve, weigh down what contradicts, solve again, judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import GroundPoints
from georef_gis.orient.adjustment.block import FLIGHT_UNKNOWNS, Block
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.flight_model import DOUBTED
from georef_gis.orient.adjustment.kernels import CAMERA_UNKNOWNS
from georef_gis.orient.adjustment.problem import Problem, State
from georef_gis.orient.adjustment.solve import FINAL_SCALE, Cancelled, Solution, solve

# of its sigma; a residual beyond is a wrong match and is taken out
WRONG = 5.0
ROUNDS = 8
# of a photo's matches: where more lie far off, they are held against its navigation
CONTRADICTED = 0.5
# of the photos of a flight that may be let loose
MOST_FREED = 0.4
# m and rad, one sigma of a navigation that is worth nothing
LOOSE = np.array([300.0, 300.0, 300.0, 0.7, 0.7, 0.7])
# gain in cost that ends a search whose answer is weighed anew
ROUGH = 0.05
# unknowns from which on the linear algebra may use threads
THREADED = 4000
# degrees of freedom from which on sigma0 may scale what the pixels claim
ENOUGH = 30
# how much less than 2 squared residuals in sigmas count under Cauchy's weights at FINAL_SCALE:
# the mean of chi2 / (1 + chi2 / 9) over a chi-square of two degrees of freedom
CAUCHY_SHARE = 1.4410 / 2.0

Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubted:
    """A part of a photo's navigation that contradicts the rest and was weighed down.

    `component` counts dp_enu, dtheta_enu; `sigmas` is how far off it is.
    """

    photo: int
    component: int
    sigmas: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """Answer of an adjustment.

    Parameters
    ----------
    block, problem, solution
        What was solved; `block.ties` are the observations that were kept.
    covariances
        On demand from the kept factor.
    poses
        With their covariances, of kind "adjusted", in the sensors' axes.
    cameras
        Adjusted, with their sigmas of focal length and principal point.
    points
        Tie points.
    control_places : shape (c, 3), m
        Marked control and check points as the photos see them, and their covariances.
    residuals : shape (m, 2), px
        Of the observations of `problem.ties`.
    sigma0
        Scatter of the pixels by what was stated; their sigma was raised by it if above 1.
    removed : shape (n,)
        Wrong matches taken out, by photo.
    doubted
        Navigation that was weighed down.
    """

    block: Block
    problem: Problem
    solution: Solution
    covariances: Covariances
    poses: tuple[Pose, ...]
    cameras: tuple[Camera, ...]
    points: GroundPoints
    control_places: Array
    control_covariance: Array
    residuals: Array
    sigma0: float
    removed: NDArray[np.int64]
    doubted: tuple[Doubted, ...]

    @property
    def shared(self) -> Array:
        """Steps of the shared unknowns from their priors, after `Block.shared_names`."""
        return self.problem.shared_vector(self.solution.state)

    def flight(self, index: int) -> tuple[Array, Array]:
        """Lever arm, boresight, bias and clock of a flight, (10,), and their covariance."""
        at = self.block.flight_at(index)
        here = slice(at, at + FLIGHT_UNKNOWNS)
        return self.shared[here], self.covariances.shared()[here, here]

    def rms_by_photo(self) -> tuple[Array, NDArray[np.int64]]:
        """Root mean square residual, px, and number of observations of each photo."""
        n = len(self.block.photo_ids)
        square = np.nansum(self.residuals**2, axis=1)
        count = np.bincount(self.problem.ties.photo, minlength=n)
        total = np.bincount(self.problem.ties.photo, weights=square, minlength=n)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(total / (2.0 * count)), count


def adjust(
    block: Block,
    first: Array,
    *,
    cancelled: Cancelled | None = None,
    progress: Progress | None = None,
) -> Adjusted:
    """Adjust a block.

    Parameters
    ----------
    first : shape (k, 3), m
        First places of the tie points and of the marked control points.

    Raises
    ------
    AdjustmentError
        If the block cannot be solved.
    """
    tell = progress or (lambda _share, _message: None)
    # Threads of the linear algebra cost more than they bring to matrices of this size.
    small = 6 * len(block.photo_ids) < THREADED
    with threadpool_limits(limits=1 if small else None, user_api="blas"):
        return _adjust(Problem(block, first), cancelled, tell)


def _adjust(problem: Problem, cancelled: Cancelled | None, tell: Progress) -> Adjusted:
    block = problem.block
    solution = solve(problem, problem.start, gain=ROUGH, cancelled=cancelled)
    solution, doubted = _freed(problem, solution, cancelled)
    tell(0.4, "first solution")
    removed = np.zeros(len(block.photo_ids), dtype=np.int64)
    sigma0 = 1.0
    for number in range(ROUNDS):
        problem, solution, out = _without_wrong(problem, solution)
        removed += out
        found = _weigh_down(problem, solution.state)
        doubted += found
        sigma0 = _sigma0(problem, solution)
        if sigma0 > 1.0 and _freedom(problem) > ENOUGH:
            problem.sigma = np.where(problem.mark_of < 0, sigma0, 1.0) * problem.ties.sigma
        again = solve(problem, solution.state, scale=FINAL_SCALE, steps=30, cancelled=cancelled)
        settled = not found and not np.any(out) and number > 0
        solution = again
        tell(0.4 + 0.4 * (number + 1) / ROUNDS, "weighing observations")
        if settled:
            break
    return _answer(problem, solution, sigma0, removed, doubted)


def _freed(
    problem: Problem, first: Solution, cancelled: Cancelled | None
) -> tuple[Solution, list[Doubted]]:
    """Solution where photos that all their matches contradict went where these put them.

    A receiver that is sure of a wrong place outweighs any pixel. Such photos are let loose; where
    their matches agree among themselves, the navigation is what is weighed down.
    """
    loose = np.zeros(len(problem.block.photo_ids), dtype=np.bool_)
    free = first
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
    while found := _weigh_down(problem, state):
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
            flight._invert()


def _without_wrong(
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
        new_block = replace(
            new_block, ground=replace(block.ground, z_enu=block.ground.z_enu[rays >= 2])
        )
    stay = np.concatenate([rays >= 2, np.ones(len(problem.marked), dtype=np.bool_)])
    points = solution.state.points[stay]
    new = Problem(new_block, points)
    for fresh, known in zip(new.flights, problem.flights, strict=True):
        fresh.extra, fresh.information = known.extra, known.information
    return new, replace(solution, state=replace(solution.state, points=points))


def _weigh_down(problem: Problem, state: State) -> list[Doubted]:
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
        flight._invert()
        found += [
            Doubted(photo=int(flight.prior.photos[i]), component=int(c), sigmas=float(ratio[i, c]))
            for i, c in np.argwhere(wrong)
        ]
    return found


def _freedom(problem: Problem) -> int:
    """Degrees of freedom of the tie points' pixels alone."""
    m = int(np.count_nonzero(problem.mark_of < 0))
    seen = len(np.unique(problem.ties.photo))
    return 2 * m - 3 * problem.block.ties.n_points - max(6 * seen - 7, 0)


def _sigma0(problem: Problem, solution: Solution) -> float:
    """Scatter of the tie points' pixels by their stated sigma, robust."""
    tie = problem.mark_of < 0
    m, freedom = int(np.count_nonzero(tie)), _freedom(problem)
    if freedom <= 0:
        return 1.0
    _, r, _ = problem.image_cost(solution.state, 0.0)
    ratio = np.hypot(r[tie, 0], r[tie, 1]) / problem.ties.sigma[tie]
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return 1.0
    scale = max(float(np.median(ratio)) / 1.18, 1e-3)
    for _ in range(20):
        chi2 = (ratio / scale) ** 2
        weighted = float(np.mean(chi2 / (1.0 + chi2 / FINAL_SCALE**2)))
        scale *= np.sqrt(weighted / (2.0 * CAUCHY_SHARE))
    return float(scale * np.sqrt(2.0 * m / freedom))


def _answer(
    problem: Problem,
    solution: Solution,
    sigma0: float,
    removed: NDArray[np.int64],
    doubted: list[Doubted],
) -> Adjusted:
    block, state = problem.block, solution.state
    covariances = Covariances(problem, state, solution.loss.signed)
    up = np.array([0.0, 0.0, state.level])
    poses = []
    for i, covariance in enumerate(covariances.poses()):
        old = block.poses[i]
        poses.append(
            replace(
                old,
                origin_enu=state.origin[i] + up,
                R_enu_from_cam=_orthonormal(state.rotation[i]),
                covariance=covariance,
                kind="adjusted",
                velocity_enu=problem.motion[i, :3] if np.any(problem.motion[i]) else None,
                rate_enu=problem.motion[i, 3:] if np.any(problem.motion[i, 3:]) else None,
                sigma_height_shared=0.0 if block.sigma_level > 0 else old.sigma_height_shared,
            )
        )
    spread = covariances.shared()
    cameras = tuple(
        _camera(p.camera, state.cameras[k], spread, block.camera_at(k))
        for k, p in enumerate(block.cameras)
    )
    _, r, _ = problem.image_cost(state, solution.loss.signed)
    n = block.ties.n_points
    each = covariances.points()
    places = state.points + up
    square = np.bincount(problem.ties.point, weights=np.sum(r**2, axis=1), minlength=len(places))
    rays = np.bincount(problem.ties.point, minlength=len(places))
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(square / (2.0 * rays))
    points = GroundPoints(
        p_enu=places[:n], covariance=each[:n], rays=rays[:n].astype(np.int32), residual_px=rms[:n]
    )
    return Adjusted(
        block=block, problem=problem, solution=solution, covariances=covariances,
        poses=tuple(poses), cameras=cameras, points=points, control_places=places[n:],
        control_covariance=each[n:], residuals=r, sigma0=sigma0, removed=removed,
        doubted=tuple(doubted),
    )  # fmt: skip


def _camera(camera: Camera, vector: Array, spread: Array, at: int) -> Camera:
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2", "readout_s")
    values = dict(zip(names, (float(v) for v in vector), strict=True))
    sigma = np.sqrt(np.diag(spread)[at : at + CAMERA_UNKNOWNS])
    return replace(
        camera,
        **values,  # type: ignore[arg-type]
        sigma_f=float(sigma[0]) or camera.sigma_f,
        sigma_c=float(np.hypot(sigma[1], sigma[2]) / np.sqrt(2.0)) or camera.sigma_c,
        source=f"{camera.source}, adjusted" if np.any(sigma) else camera.source,
    )


def _orthonormal(R: Array) -> Array:
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)
