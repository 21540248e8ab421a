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
from georef_gis.orient.adjustment.contradictions import Doubted, freed, weigh_down
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.ground_weight import weigh_ground
from georef_gis.orient.adjustment.kernels import CAMERA_UNKNOWNS
from georef_gis.orient.adjustment.level_check import (
    free_contradicted_height,
    without_contradicting_surface,
)
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import FINAL_SCALE, Cancelled, Solution, solve
from georef_gis.orient.adjustment.wrong_matches import freedom, sigma0, without_wrong

ROUNDS = 8
# gain in cost that ends the last search
POLISHED = 1e-6
# unknowns from which on the linear algebra may use threads
THREADED = 4000
# degrees of freedom from which on sigma0 may scale what the pixels claim
ENOUGH = 30
Progress = Callable[[float, str], None]


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
    notes
        What was decided on the way, for people.
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
    notes: tuple[str, ...] = ()

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
    solution, doubted = freed(problem, cancelled)
    tell(0.4, "first solution")
    removed = np.zeros(len(block.photo_ids), dtype=np.int64)
    scatter, notes = 1.0, list[str]()
    for number in range(ROUNDS):
        problem, solution, out = without_wrong(problem, solution)
        removed += out
        if number == 0:
            notes += without_contradicting_surface(problem, solution)
            free_contradicted_height(problem, solution)
        if problem.block.ground is not None:
            state, n = solution.state, problem.block.ties.n_points
            problem.know_ground(weigh_ground(problem.block.ground, state.points[:n], state.level))
        found = weigh_down(problem, solution.state)
        doubted += found
        scatter = sigma0(problem, solution)
        if freedom(problem) > ENOUGH:
            # set anew: an early scatter of photos that are still off must not stay
            worse = max(scatter, 1.0)
            problem.sigma = np.where(problem.mark_of < 0, worse, 1.0) * problem.ties.sigma
        again = solve(problem, solution.state, scale=FINAL_SCALE, steps=30, cancelled=cancelled)
        settled = not found and not np.any(out) and number > 0
        solution = again
        tell(0.4 + 0.4 * (number + 1) / ROUNDS, "weighing observations")
        if settled:
            break
    # weak directions, such as the tilt of a strip, are still a step off: two runs would differ
    last = solve(
        problem, solution.state, scale=FINAL_SCALE, steps=10, gain=POLISHED, cancelled=cancelled
    )
    solution = replace(last, converged=last.converged or solution.converged)
    return replace(_answer(problem, solution, scatter, removed, doubted), notes=tuple(notes))


def _answer(
    problem: Problem,
    solution: Solution,
    scatter: float,
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
        control_covariance=each[n:], residuals=r, sigma0=scatter, removed=removed,
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
