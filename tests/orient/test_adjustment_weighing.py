"""Noise, wrong matches and wrong tags: what an adjustment weighs down, and how it is told."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of
from adjustment_cases import Array, adjusted, errors, sigmas

from georef_gis.frames import exp_so3
from georef_gis.orient.adjustment.block import Block
from georef_gis.orient.adjustment.checks import plausibility


@pytest.mark.slow
def test_noise_twice_as_stated_is_found_and_its_sigmas_raised() -> None:
    """sigma0 is 2 within 10 %, 1 within 10 % where it is as stated."""
    flight = sim.survey(11, 3, 5, noise_px=1.0)
    block = block_of(flight)
    told = replace(block, ties=replace(block.ties, sigma=0.5 * block.ties.sigma))
    wrong, right = adjusted(flight, told), adjusted(flight, block)
    assert wrong.sigma0 == pytest.approx(2.0, rel=0.1)
    assert right.sigma0 == pytest.approx(1.0, rel=0.1)
    np.testing.assert_allclose(sigmas(wrong), sigmas(right), rtol=0.15)


@pytest.mark.slow
def test_fifteen_percent_of_wrong_matches_go_and_hardly_anything_else() -> None:
    flight = sim.survey(12, 3, 5, outliers=0.15)
    answer = adjusted(flight)
    kept = {(i, *uv) for i, uv in zip(answer.block.ties.photo, answer.block.ties.uv.tolist(),
                                      strict=True)}  # fmt: skip
    stays = np.array([
        (i, *uv) in kept for i, uv in zip(flight.photo, flight.uv.tolist(), strict=True)
    ])  # fmt: skip
    assert np.mean(stays[flight.outlier]) < 0.06
    # a good observation also goes where the other ones of its point are wrong
    assert np.mean(~stays[~flight.outlier]) < 0.06
    assert answer.sigma0 == pytest.approx(1.0, rel=0.1)
    assert np.sqrt(np.mean((errors(flight, answer) / sigmas(answer)) ** 2)) < 2.0


def with_tags(flight: sim.SimFlight, off: dict[int, Array]) -> Block:
    """Block of a flight whose navigation is off by (dp, dtheta) at some photos."""
    block = block_of(flight)
    poses = list(block.poses)
    for i, d in off.items():
        poses[i] = replace(
            poses[i],
            origin_enu=poses[i].origin_enu + d[:3],
            R_enu_from_cam=exp_so3(d[3:]) @ poses[i].R_enu_from_cam,
        )
    return replace(block, poses=tuple(poses))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tags", "RTK"])
def test_heights_of_a_few_photos_100_m_off_do_not_tilt_the_block(kind: str) -> None:
    flight = {"tags": sim.gps_only, "RTK": sim.rtk}[kind](13, 3, 6)
    off = np.array([0, 0, 100.0, 0, 0, 0])
    block = with_tags(flight, dict.fromkeys((0, 1, 12), off))
    answer, good = adjusted(flight, block), adjusted(flight)
    assert {(d.photo, d.component) for d in answer.doubted} >= {(0, 2), (1, 2), (12, 2)}
    shift = (errors(flight, answer) - errors(flight, good)) / sigmas(good)
    assert np.abs(shift).max() < 1.5, np.abs(shift).max(axis=0)
    assert all(c.passed for c in plausibility(answer, None)), plausibility(answer, None)


PLACES = {
    "one": {7: [300.0, -100, 0]},
    "one at the rim": {0: [-60.0, 40, 0]},
    "three, two of them neighbours": {3: [80.0, 0, 0], 4: [80.0, 0, 0], 12: [0, -2000.0, 0]},
}


@pytest.mark.slow
@pytest.mark.parametrize("places", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("seed", [14, 15, 18])
def test_wrong_places_neither_move_the_block_nor_have_it_refused(
    seed: int, places: dict[int, list[float]]
) -> None:
    flight = sim.gps_only(seed, 3, 6)
    off = {i: np.array([*d, 0.0, 0.0, 0.0]) for i, d in places.items()}
    answer = adjusted(flight, with_tags(flight, off))
    assert {d.photo for d in answer.doubted} >= set(places)
    assert answer.solution.converged
    assert np.abs(errors(flight, answer) / sigmas(answer)).max() < 4.5
    failed = [c.told() for c in plausibility(answer, None) if not c.passed]
    assert not failed


@pytest.mark.slow
def test_a_heading_that_is_turned_is_weighed_down() -> None:
    flight = sim.gps_only(15, 3, 6)
    answer = adjusted(flight, with_tags(flight, {4: np.array([0, 0, 0, 0, 0, np.radians(60)])}))
    assert (4, 5) in {(d.photo, d.component) for d in answer.doubted}
    assert np.abs(errors(flight, answer) / sigmas(answer)).max() < 4.5
