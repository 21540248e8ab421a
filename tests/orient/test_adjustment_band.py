"""Large blocks, kept as a band, give what the dense solution gives."""

from __future__ import annotations

import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, first_points
from adjustment_flights import gps_only, strip

from georef_gis.orient.adjustment import problem as problem_module
from georef_gis.orient.adjustment.adjust import adjust
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import solve


def solved(flight, block):
    problem = Problem(block, first_points(flight, block))
    solution = solve(problem, problem.start)
    return problem, solution, Covariances(problem, solution.state, solution.loss.signed)


@pytest.fixture(scope="module")
def both():
    """The same block of 30 photos with control, dense and as a band."""
    flight = gps_only(3, 3, 10, control=2, obs_per_photo=150.0)
    block = block_of(flight, control=control_input((flight.control, True)), sigma_level=10.0)
    dense = solved(flight, block)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem_module, "LARGE", 5)
        band = solved(flight, block)
    assert band[0].large
    assert not dense[0].large
    return dense, band


def test_band_finds_the_same_solution(both) -> None:
    (_, dense, cov), (_, band, _) = both
    sigma = np.sqrt(np.einsum("nii->ni", cov.poses()))[:, :3]
    off = np.abs(band.state.origin - dense.state.origin)
    # the memory of 12 photos leaves out hardly anything
    assert np.all(off < 0.02 * sigma)


def test_band_gives_the_same_covariances(both) -> None:
    (_, _, dense), (_, _, band) = both
    pairs = [(dense.poses(), band.poses()), (dense.points(), band.points())]
    for a, b in pairs:
        s, t = (np.sqrt(np.einsum("...ii->...i", m)) for m in (a, b))
        np.testing.assert_allclose(t, s, rtol=5e-3)
    shared = np.sqrt(np.diag(dense.shared()))
    np.testing.assert_allclose(np.sqrt(np.diag(band.shared())), shared, rtol=5e-3)


def test_band_gives_the_same_cross_terms(both) -> None:
    (_, _, dense), (_, _, band) = both
    asked = {"photos": [1, 17], "shared": [0, 14], "points": [3, 40]}
    a, b = dense.joint(**asked), band.joint(**asked)
    scale = np.sqrt(np.outer(np.diag(a), np.diag(a)))
    np.testing.assert_allclose(b / scale, a / scale, atol=5e-3)


def test_wrong_places_are_weighed_down_in_a_band_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    flight = strip(4, 12, obs_per_photo=120.0)
    block = block_of(flight)
    poses = list(block.poses)
    poses[5] = replace(poses[5], origin_enu=poses[5].origin_enu + np.array([0.0, 0.0, 60.0]))
    block = replace(block, poses=tuple(poses))
    monkeypatch.setattr(problem_module, "LARGE", 5)
    answer = adjust(block, first_points(flight, block))
    assert (5, 2) in {(d.photo, d.component) for d in answer.doubted}
    off = answer.poses[5].origin_enu - flight.truth.p_cam[5]
    # m; it had been 60 m up
    assert np.abs(off).max() < 1.5


def test_ceiling_of_the_band_is_the_memory_of_the_flight() -> None:
    """A chain that forgets in one step is exact with any memory: the hand-computable case."""
    from georef_gis.orient.adjustment.block import FlightPrior
    from georef_gis.orient.adjustment.flight_model import FlightModel
    from georef_gis.orient.adjustment.long_flight import LongFlightModel

    n, rho = 20, 0.8
    times = np.arange(n, dtype=float)
    lag = np.abs(times[:, None] - times)
    joint = np.kron(rho**lag, np.diag([4.0, 4.0, 9.0, 1e-4, 1e-4, 4e-4]))

    def part(indices):
        view = joint.reshape(n, 6, n, 6)[indices][:, :, indices]
        return view.reshape(6 * len(indices), 6 * len(indices))

    prior = FlightPrior(
        id="f", photos=np.arange(n), covariance=joint, white=np.zeros((n, 6, 6)),
        R_enu_from_body=np.tile(np.eye(3), (n, 1, 1)), velocity_enu=np.zeros((n, 3)),
        rate_enu=np.zeros((n, 3)), shared_covariance=np.zeros((10, 10)), times=times, joint=part,
    )  # fmt: skip
    origin, rotation = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    dense, band = (m(prior, origin, rotation) for m in (FlightModel, LongFlightModel))
    d = np.random.default_rng(5).standard_normal((n, 6)) * [1, 1, 1, 1e-2, 1e-2, 1e-2]
    assert band.cost(d, np.zeros(10)) == pytest.approx(dense.cost(d, np.zeros(10)), rel=1e-6)
    np.testing.assert_allclose(band.own_blocks(), dense.own_blocks(), rtol=1e-5, atol=1e-9)
