"""The adjustment against Ceres with COLMAP's camera: the same minimum, the same covariances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, first_points

from georef_gis.orient.adjustment.block import Block
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import Solution, solve

pytest.importorskip("pyceres", reason="the oracle needs pycolmap and pyceres")
pytest.importorskip("pycolmap", reason="the oracle needs pycolmap and pyceres")
from ceres_oracle import OracleResult, solve_with_ceres

pytestmark = pytest.mark.slow

# where the oracle's shared unknowns (boresight, lever, bias, clock, fx fy cx cy k1 k2 k3 p1 p2)
# stand among ours (camera's 11, lever, boresight, bias, clock); fy moves with fx
IN_OURS = [14, 15, 16, 11, 12, 13, 17, 18, 19, 20, 0, 1, 2, 3, 4, 5, 6, 7]
IN_CERES = [*range(11), *range(12, 19)]
# the flight tells how far the navigation is off in place, the block how far the truth is
SIGN = np.r_[np.ones(6), -np.ones(4), np.ones(8)]

FLIGHTS: dict[str, Callable[[], sim.SimFlight]] = {
    "calibration": lambda: sim.calibration_flight(1, obs_per_photo=120.0),
    "slow": lambda: sim.calibration_flight(2, slow=True, obs_per_photo=100.0),
    "slow survey": lambda: sim.survey(3, 3, 6, navigation=sim.TIGHT_SLOW),
    "tags": lambda: sim.gps_only(4, 3, 6),
    "RTK and control": lambda: sim.rtk(5, 3, 6, control=5),
    "strip": lambda: sim.strip(6),
    "two photos": lambda: sim.two_photos(7),
}


def ours(flight: sim.SimFlight) -> tuple[Block, Problem, Solution, Covariances]:
    """Squares minimised, for observations without outliers; steps below 1e-7 of the cost end."""
    block = block_of(flight)
    if len(flight.control.p):
        block = block_of(flight, control=control_input((flight.control, True)))
    problem = Problem(block, first_points(flight, block))
    solution = solve(problem, problem.start, robust=False, gain=1e-6)
    return block, problem, solution, Covariances(problem, solution.state, solution.loss.signed)


@pytest.fixture(scope="module", params=list(FLIGHTS))
def both(request: pytest.FixtureRequest) -> tuple[Any, ...]:
    flight = FLIGHTS[request.param]()
    points = tuple(range(0, len(flight.points), max(len(flight.points) // 5, 1)))
    return (flight, *ours(flight), solve_with_ceres(flight, points=points), points)


def test_poses_are_those_of_ceres(both: tuple[Any, ...]) -> None:
    """Within 0.15 sigma, m and rad: both stop within a part of a sigma of the minimum."""
    _, _, _, solution, _, oracle, _ = both
    assert solution.converged
    state, sigma = solution.state, np.sqrt(np.einsum("nii->ni", oracle.pose_covariance))
    turned = sim.rotvec(state.rotation @ np.swapaxes(oracle.R_enu_from_cam, 1, 2))
    off = np.hstack([state.origin - oracle.origins, turned]) / sigma
    assert np.abs(off).max() < 0.15, np.abs(off).max(axis=0)


def test_sigmas_of_poses_are_those_of_ceres(both: tuple[Any, ...]) -> None:
    """Each within 1 %, and their correlations within 0.01."""
    _, _, _, _, covariances, oracle, _ = both
    mine, ref = covariances.poses(), oracle.pose_covariance
    sd, sd_ref = (np.sqrt(np.einsum("nii->ni", c)) for c in (mine, ref))
    np.testing.assert_allclose(sd, sd_ref, rtol=0.01)
    r = mine / np.einsum("ni,nj->nij", sd, sd)
    r_ref = ref / np.einsum("ni,nj->nij", sd_ref, sd_ref)
    np.testing.assert_allclose(r, r_ref, atol=0.01)


def test_shared_unknowns_and_their_sigmas_are_those_of_ceres(both: tuple[Any, ...]) -> None:
    """Sigmas within 2 %: a boresight of 2 deg turns its own axes by so much."""
    flight, block, problem, solution, covariances, oracle, _ = both
    sigma = np.sqrt(np.diag(covariances.shared()))[IN_OURS]
    ref = np.sqrt(np.diag(oracle.shared_covariance))[IN_CERES]
    np.testing.assert_allclose(sigma, ref, rtol=0.02)
    mine = SIGN * problem.shared_vector(solution.state)[IN_OURS]
    assert np.abs((mine - shared_of(oracle, flight, block)) / ref).max() < 0.15


def shared_of(oracle: OracleResult, flight: sim.SimFlight, block: Block) -> np.ndarray:
    """Steps of the shared unknowns from their priors, as Ceres has them; shape (18,)."""
    s, lens = oracle.shared, oracle.camera - block.cameras[0].camera.parameters[:9]
    lever = s.lever - flight.shared.lever
    return np.concatenate([s.boresight, lever, s.bias, [s.clock], lens[:1], lens[2:]])


def test_points_and_their_sigmas_are_those_of_ceres(both: tuple[Any, ...]) -> None:
    _, _, _, solution, covariances, oracle, points = both
    mine = covariances.points()
    for k in points:
        sigma = np.sqrt(np.diag(oracle.point_covariance[k]))
        np.testing.assert_allclose(np.sqrt(np.diag(mine[k])), sigma, rtol=0.01)
        assert np.abs((solution.state.points[k] - oracle.points[k]) / sigma).max() < 0.15
