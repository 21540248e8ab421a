"""Planted mistakes of an adjustment: each must show in a check that passes without it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from georef_gis.frames import log_so3
from georef_gis.orient.adjustment import build, covariance, flight_model, problem
from georef_gis.orient.adjustment.block import Block
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import solve

sys.path.insert(0, str(Path(__file__).parents[1] / "orient"))

import adjustment_flights as sim
from adjustment_blocks import block_of, control_input, first_points

Patch = pytest.MonkeyPatch
SEEDS = range(60, 66)


@cache
def flights() -> tuple[sim.SimFlight, ...]:
    """With control, so that bias and level are told, and a boresight of some degrees."""
    shared = sim.shared_sigmas(4.0, 0.05, 0.5, 0.05)
    return tuple(
        sim.survey(s, 2, 4, obs_per_photo=60.0, navigation=sim.TIGHT_SLOW, sigmas=shared, control=4)
        for s in SEEDS
    )


def shared_in_one(flight: sim.SimFlight) -> Block:
    return block_of(flight, control=control_input((flight.control, True)), sigma_level=2.0)


def errors_agree_with_their_sigmas() -> bool:
    """Over six flights: pose errors of 0.6 to 1.6 sigma, points too, none beyond 6 sigma."""
    poses, points = [], []
    for flight in flights():
        block = shared_in_one(flight)
        p = Problem(block, first_points(flight, block))
        found = solve(p, p.start)
        if not found.converged:
            return False
        c = Covariances(p, found.state, 3.0)
        t, up = flight.truth, np.array([0.0, 0.0, found.state.level])
        turned = log_so3(t.R_enu_from_cam @ np.swapaxes(found.state.rotation, 1, 2))
        e = np.hstack([t.p_cam - found.state.origin - up, turned])
        poses.append(e / np.sqrt(np.einsum("nii->ni", c.poses())))
        n = block.ties.n_points
        spread = np.sqrt(np.einsum("kii->ki", c.points()[:n]))
        points.append((flight.points - found.state.points[:n] - up) / spread)
    rms = [np.sqrt(np.mean(np.concatenate(z) ** 2, axis=0)) for z in (poses, points)]
    all_rms = np.concatenate(rms)
    worst = max(float(np.abs(z).max()) for z in poses)
    return bool(np.all((all_rms > 0.5) & (all_rms < 1.7)) and worst < 6.0)


def test_without_a_mistake_errors_agree_with_their_sigmas() -> None:
    assert errors_agree_with_their_sigmas()


def boresight_the_wrong_way(patch: Patch) -> None:
    real = flight_model.FlightModel.residual

    def wrong(self, origin, rotation, shared):
        turned = shared.copy()
        turned[3:6] *= -1.0
        return real(self, origin, rotation, turned)

    patch.setattr(flight_model.FlightModel, "residual", wrong)


def clock_left_out(patch: Patch) -> None:
    real = flight_model.FlightModel.residual

    def wrong(self, origin, rotation, shared):
        still = shared.copy()
        still[9] = 0.0
        return real(self, origin, rotation, still)

    patch.setattr(flight_model.FlightModel, "residual", wrong)


def photos_taken_for_independent(patch: Patch) -> None:
    """The joint covariance of a flight cut down to its blocks."""
    real = flight_model.FlightModel.__init__

    def wrong(self, prior, origin, rotation):
        n = len(prior.photos)
        blocks = prior.covariance.reshape(n, 6, n, 6).copy()
        blocks *= np.eye(n)[:, None, :, None]
        real(self, replace(prior, covariance=blocks.reshape(6 * n, 6 * n)), origin, rotation)

    patch.setattr(flight_model.FlightModel, "__init__", wrong)


def level_forgotten_in_sigmas(patch: Patch) -> None:
    real = covariance.Covariances.__init__

    def wrong(self, *args, **options):
        real(self, *args, **options)
        self.with_level = False

    patch.setattr(covariance.Covariances, "__init__", wrong)


def focal_length_moved_backwards(patch: Patch) -> None:
    real = problem.moved_camera_vector
    patch.setattr(problem, "moved_camera_vector", lambda vector, step: real(vector, -step))


def sigmas_of_pixels_halved(patch: Patch) -> None:
    real = problem.Problem.__init__

    def wrong(self, block, points):
        real(self, block, points)
        self.sigma = 0.4 * self.sigma

    patch.setattr(problem.Problem, "__init__", wrong)


MISTAKES: list[Callable[[Patch], None]] = [
    boresight_the_wrong_way,
    clock_left_out,
    photos_taken_for_independent,
    level_forgotten_in_sigmas,
    focal_length_moved_backwards,
    sigmas_of_pixels_halved,
]


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda m: m.__name__)
def test_a_planted_mistake_shows(
    mistake: Callable[[Patch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    mistake(monkeypatch)
    assert not errors_agree_with_their_sigmas()


def turned_pixels_agree() -> bool:
    """A photo turned by a quarter sees what its sensor sees."""
    flight = flights()[0]
    photo = sim.oriented_photos(flight, true=True)[0]
    ground = flight.points[flight.point[flight.photo == 0]]
    T = build.R_turned_from_sensor(90)
    turned = replace(
        photo,
        camera=replace(photo.camera, b1=0.0, b2=0.0).turned(90),
        pose=replace(photo.pose, R_enu_from_cam=photo.pose.R_enu_from_cam @ T.T),
    )
    own = replace(photo, camera=replace(photo.camera, b1=0.0, b2=0.0))
    back = build.uv_in_sensor(turned.project(ground), own.camera.width, own.camera.height, 90)
    return bool(np.nanmax(np.abs(back - own.project(ground))) < 1e-6)


def test_turned_pixels_agree_without_a_mistake() -> None:
    assert turned_pixels_agree()


def test_turning_the_wrong_way_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    real = build.R_turned_from_sensor
    monkeypatch.setattr(build, "R_turned_from_sensor", lambda degrees: real(-degrees))
    assert not turned_pixels_agree()


def test_edges_taken_for_pixels_show(monkeypatch: pytest.MonkeyPatch) -> None:
    real = build.uv_in_sensor
    monkeypatch.setattr(build, "uv_in_sensor", lambda uv, w, h, d: real(uv, w + 1, h + 1, d))
    assert not turned_pixels_agree()
