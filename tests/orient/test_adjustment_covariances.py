"""Joint covariances of poses, shared unknowns and points, against drawn blocks."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, flight_prior
from adjustment_cases import Array

from georef_gis.frames import exp_so3, log_so3
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import solve


@pytest.mark.slow
def test_joint_covariances_are_those_of_300_drawn_blocks() -> None:
    """Errors of a hundredth of their sigmas, so that all is linear; with control and level."""
    flight = sim.strip(19, 3, obs_per_photo=15.0, control=3)
    made = _TrueBlock(flight)
    asked = {"photos": [0, 2], "shared": [0, 16, 20], "points": [1, made.n_ties - 1, made.n_ties]}
    rng = np.random.default_rng(1)
    drawn = np.array([made.draw(rng, asked) for _ in range(300)])
    problem = Problem(made.block, made.points)
    joint = Covariances(problem, problem.start, 0.0).joint(**asked)
    z = np.linalg.solve(np.linalg.cholesky(joint), drawn.T)
    found = z @ z.T / 300
    # one sigma of a covariance of 300 is 0.058 off the diagonal and 0.082 on it
    assert np.abs(found - np.eye(len(found))).max() < 0.35


class _TrueBlock:
    """A block at its truth, whose observations and priors are drawn anew, a hundredth as far."""

    SHARE = 0.01

    def __init__(self, flight: sim.SimFlight) -> None:
        photos = sim.oriented_photos(flight, true=True)
        rough = block_of(flight, control=control_input((flight.control, True)), sigma_level=2.0)
        truth = [replace(photo.pose, covariance=rough.poses[0].covariance) for photo in photos]
        camera = replace(rough.cameras[0], camera=photos[0].camera)
        prior = flight_prior(flight, photos)
        self.n_ties = rough.ties.n_points
        self.points = np.vstack([flight.points, flight.control.p_true])
        ties = rough.ties
        uv = np.zeros_like(ties.uv)
        marks = np.zeros_like(rough.control.uv)
        for i, photo in enumerate(photos):
            mine, own = ties.photo == i, rough.control.photo == i
            uv[mine] = photo.project(flight.points[ties.point[mine]])
            marks[own] = photo.project(flight.control.p_true[rough.control.point[own]])
        control = replace(rough.control, uv=marks, p_enu=flight.control.p_true)
        self.block = replace(
            rough, poses=tuple(truth), cameras=(camera,), ties=replace(ties, uv=uv),
            control=control, flights=(prior,),
        )  # fmt: skip
        self.half = np.linalg.cholesky(prior.covariance + 1e-14 * np.eye(len(prior.covariance)))

    def draw(self, rng: np.random.Generator, asked: dict[str, list[int]]) -> Array:
        """Errors of the answer over SHARE, in the order of `Covariances.joint`."""
        block, share = self.block, self.SHARE
        prior, camera = block.flights[0], block.cameras[0]
        shared = np.sqrt(np.diag(prior.shared_covariance)) * rng.normal(size=10) * share
        lens = camera.sigma * rng.normal(size=11) * share
        level = block.sigma_level * rng.normal() * share
        own = share * (self.half @ rng.normal(size=len(self.half))).reshape(-1, 6)
        R, n = prior.R_enu_from_body, len(own)
        own[:, :3] += R @ shared[:3] + shared[6:9] + prior.velocity_enu * shared[9]
        own[:, 3:] += R @ shared[3:6] + prior.rate_enu * shared[9]
        poses = tuple(
            replace(
                p, origin_enu=p.origin_enu - own[i, :3] - [0, 0, level],
                R_enu_from_cam=exp_so3(-own[i, 3:]) @ p.R_enu_from_cam,
            )
            for i, p in enumerate(block.poses)
        )  # fmt: skip
        values = camera.camera.parameters.copy()
        values[:2] -= lens[0]
        values[2:] -= lens[1:10]
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
        off = replace(
            camera.camera, readout_s=camera.camera.readout_s - lens[10],
            **dict(zip(names, values.tolist(), strict=True)),
        )  # fmt: skip
        ties, control = block.ties, block.control
        noise = share * ties.sigma[:, None] * rng.normal(size=ties.uv.shape)
        marked = share * control.sigma_px[:, None] * rng.normal(size=control.uv.shape)
        survey = share * control.sigma * rng.normal(size=control.p_enu.shape)
        spoilt = replace(
            block, poses=poses, cameras=(replace(camera, camera=off),),
            ties=replace(ties, uv=ties.uv + noise),
            control=replace(control, uv=control.uv + marked, p_enu=control.p_enu + survey),
        )  # fmt: skip
        problem = Problem(spoilt, self.points - [0, 0, level])
        state = solve(problem, problem.start, robust=False, gain=1e-9).state
        up = np.array([0.0, 0.0, state.level])
        out = []
        for i in asked["photos"]:
            out += [block.poses[i].origin_enu - state.origin[i] - up,
                    log_so3(block.poses[i].R_enu_from_cam @ state.rotation[i].T)]  # fmt: skip
        true = np.concatenate([lens, shared])
        out.append(true[asked["shared"]] - problem.shared_vector(state)[asked["shared"]])
        out += [self.points[j] - state.points[j] - up for j in asked["points"]]
        assert n == len(block.poses)
        return np.concatenate(out) / share
