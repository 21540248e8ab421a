"""Blocks of simulated flights for the adjustment, and how far its answers lie off the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from adjustment_flights import (
    SimFlight,
    Surveyed,
    oriented_photos,
    photo_ids,
    pose_jacobian,
    rotvec,
    ties,
)
from numpy.typing import NDArray

from georef_gis.model.photo import OrientedPhoto
from georef_gis.orient.adjustment.block import Block, CameraPrior, ControlInput, FlightPrior
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import Solution, solve

Array = NDArray[np.float64]


def flight_prior(flight: SimFlight, photos: list[OrientedPhoto]) -> FlightPrior:
    """The joint prior that the flight's errors were drawn from."""
    n, model = len(photos), flight.navigation
    L = np.stack([pose_jacobian(flight, i)[:, :6] for i in range(n)])
    joint = np.zeros((n, 6, n, 6))
    for c, block in enumerate(model.covariance(flight.truth.times)):
        joint[:, c, :, c] = block
    joint = np.einsum("aij,ajbk,blk->aibl", L, joint, L)
    white = np.einsum("aij,j,akj->aik", L, model.white**2, L)
    s = flight.sigmas
    shared = np.concatenate([s.lever, s.boresight, s.bias, [s.clock]])
    return FlightPrior(
        id="flight",
        photos=np.arange(n),
        covariance=joint.reshape(6 * n, 6 * n),
        white=white,
        R_enu_from_body=flight.R_nav,
        velocity_enu=np.array([p.pose.velocity_enu for p in photos]),
        rate_enu=np.array([p.pose.rate_enu for p in photos]),
        shared_covariance=np.diag(shared**2),
    )


def camera_sigma(flight: SimFlight) -> Array:
    """Sigmas of the camera's unknowns as the flight drew them."""
    s = flight.camera_sigma
    return np.concatenate([s[:1], s[2:], [flight.sigma_readout_s]])


def control_input(*groups: tuple[Surveyed, bool]) -> ControlInput:
    """Surveyed points with their marks; the flag tells whether they take part."""
    counts = np.cumsum([0] + [len(g.p) for g, _ in groups])
    return ControlInput(
        names=tuple(f"P{i}" for i in range(counts[-1])),
        p_enu=np.concatenate([g.p for g, _ in groups]),
        sigma=np.concatenate([np.broadcast_to(g.sigma, g.p.shape) for g, _ in groups]),
        used=np.concatenate([np.full(len(g.p), used) for g, used in groups]),
        photo=np.concatenate([g.photo for g, _ in groups]),
        point=np.concatenate([g.point + at for (g, _), at in zip(groups, counts, strict=False)]),
        uv=np.concatenate([g.uv for g, _ in groups]),
        sigma_px=np.concatenate([np.full(len(g.photo), g.sigma_px) for g, _ in groups]),
    )


def block_of(flight: SimFlight, **changes: object) -> Block:
    """Block with the priors that the flight was drawn from."""
    photos = oriented_photos(flight)
    block = Block(
        photo_ids=photo_ids(flight),
        poses=tuple(photo.pose for photo in photos),
        camera_of=np.zeros(len(photos), dtype=np.int64),
        cameras=(CameraPrior(camera=photos[0].camera, sigma=camera_sigma(flight)),),
        flights=(flight_prior(flight, photos),),
        ties=ties(flight),
    )
    return replace(block, **changes)  # type: ignore[arg-type]


def first_points(flight: SimFlight, block: Block, z: float = 0.0) -> Array:
    """Where the rays of the navigation meet a plane, averaged; control behind the tie points."""
    places = np.zeros((block.ties.n_points, 3))
    rays = np.bincount(block.ties.point, minlength=block.ties.n_points)
    for i, photo in enumerate(oriented_photos(flight)):
        mine = block.ties.photo == i
        o, d = photo.rays(block.ties.uv[mine])
        hit = o + ((z - o[:, 2]) / d[:, 2])[:, None] * d
        np.add.at(places, block.ties.point[mine], hit / rays[block.ties.point[mine]][:, None])
    if block.control is None:
        return places
    marked = np.unique(block.control.point)
    return np.vstack([places, np.nan_to_num(block.control.p_enu[marked])])


def true_shared(flight: SimFlight) -> Array:
    """True steps of the shared unknowns from their priors, in the order of the block."""
    t, s = flight.shared_true, flight.shared
    camera = flight.camera_true.values - flight.camera.values
    readout = flight.camera_true.readout_s - flight.camera.readout_s
    # the flight tells how far the navigation is off, the block how far the truth is
    mount = [t.lever - s.lever, t.boresight - s.boresight, s.bias - t.bias, [s.clock - t.clock]]
    return np.concatenate([camera[:1], camera[2:], [readout], *mount, [0.0, 0.0]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """Errors over sigma of poses (n, 6), shared unknowns (G,), points (k, 3); and the rest."""

    poses: Array
    shared: Array
    points: Array
    errors: Array
    problem: Problem
    solution: Solution
    covariances: Covariances


def judge(flight: SimFlight, block: Block | None = None) -> Judged:
    """Adjust a flight and compare with the truth."""
    block = block or block_of(flight)
    problem = Problem(block, first_points(flight, block))
    solution = solve(problem, problem.start)
    covariances = Covariances(problem, solution.state, solution.loss.signed)
    truth, state = flight.truth, solution.state
    up = np.array([0.0, 0.0, state.level])
    turned = truth.R_enu_from_cam @ np.swapaxes(state.rotation, 1, 2)
    errors = np.hstack([truth.p_cam - state.origin - up, rotvec(turned)])
    sigma = np.sqrt(np.einsum("nii->ni", covariances.poses()))
    spread = np.sqrt(np.maximum(np.diag(covariances.shared()), 0.0))
    off = true_shared(flight) - problem.shared_vector(state)
    n = block.ties.n_points
    places = np.sqrt(np.einsum("kii->ki", covariances.points()[:n]))
    return Judged(
        poses=errors / sigma,
        shared=np.divide(off, spread, out=np.full_like(off, np.nan), where=spread > 0),
        points=(flight.points - state.points[:n] - up) / places,
        errors=errors,
        problem=problem,
        solution=solution,
        covariances=covariances,
    )


def rms(values: list[Array]) -> Array:
    """Root mean square over the flights and rows, NaN left out."""
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(values) ** 2, axis=0)))
