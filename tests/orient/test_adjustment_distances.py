"""Distances within an adjusted block: their errors are as large as the joint covariance says."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from adjustment_blocks import Judged, judge
from adjustment_flights import SimFlight, gps_only, rtk, survey

from georef_gis.frames import Array
from georef_gis.model.tie_points import GroundPoints
from georef_gis.orient.adjustment.distances import distance_sigmas, pair_sigmas, pairs_at

# 5 flights in the daily tests; 40 when asked
FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
# the scale of one flight is in all of its distances: the rms of 5 scatters by a third of itself
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.35, 2.1)
KINDS: dict[str, Callable[[int], SimFlight]] = {
    "smoothed navigation": lambda seed: survey(seed, 3, 6),
    "tags": lambda seed: gps_only(seed, 3, 6),
    "RTK": lambda seed: rtk(seed, 3, 6),
}


def ground_points(flight: SimFlight, judged: Judged) -> GroundPoints:
    n = len(flight.points)
    return GroundPoints(
        p_enu=judged.solution.state.points[:n],
        covariance=judged.covariances.points()[:n],
        rays=np.full(n, 3, dtype=np.int32),
        residual_px=np.zeros(n),
    )


def off(flight: SimFlight, points: GroundPoints, pairs: Array) -> Array:
    """Adjusted less true horizontal distance of pairs, m."""

    def lengths(p: Array) -> Array:
        return np.linalg.norm(p[pairs[:, 1], :2] - p[pairs[:, 0], :2], axis=1)

    return lengths(points.p_enu) - lengths(flight.points)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(KINDS))
def test_errors_of_distances_agree_with_their_sigmas(kind: str) -> None:
    ratios: dict[float, list[Array]] = {10.0: [], 50.0: []}
    for seed in range(100, 100 + FLIGHTS):
        flight = KINDS[kind](seed)
        judged = judge(flight)
        points = ground_points(flight, judged)
        for length, found in ratios.items():
            pairs = pairs_at(points.p_enu, length)
            assert len(pairs) > 5
            sigma = pair_sigmas(points.p_enu, pairs, judged.covariances)
            found.append(off(flight, points, pairs) / sigma)
    for found in ratios.values():
        assert LOW < np.sqrt(np.mean(np.concatenate(found) ** 2)) < HIGH


def test_distances_are_known_better_than_places_of_a_block_that_may_shift() -> None:
    """By tags of metres a block may shift; its distances hold to a part of that."""
    flight = gps_only(3, 3, 6)
    judged = judge(flight)
    points = ground_points(flight, judged)
    near, far = distance_sigmas(points, judged.covariances)
    assert (near.length_m, far.length_m) == (10.0, 50.0)
    place = float(np.sqrt(np.median(points.covariance[:, 0, 0])))
    assert near.sigma_m < far.sigma_m < 0.5 * place
    assert near.pairs == far.pairs == 30


def test_a_length_that_the_site_does_not_hold_is_left_out() -> None:
    flight = gps_only(3, 3, 6)
    judged = judge(flight)
    points = ground_points(flight, judged)
    (only,) = distance_sigmas(points, judged.covariances, lengths=(50.0, 5000.0))
    assert only.length_m == 50.0


def test_points_that_could_not_be_placed_are_not_asked_for() -> None:
    flight = gps_only(3, 3, 6)
    judged = judge(flight)
    points = ground_points(flight, judged)
    p = points.p_enu.copy()
    p[::2] = np.nan
    found = distance_sigmas(replace(points, p_enu=p), judged.covariances, lengths=(50.0,))
    assert len(found) == 1
    assert np.isfinite(found[0].sigma_m)
