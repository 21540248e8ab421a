"""Ellipses and intervals hold the truth as often as they say, over simulated flights.

The claim, 39.3 +- 4 % and 95 +- 2 %, is one over 200 flights or more (GEOREF_FLIGHTS=300, or
`benchmarks/measure_coverage.py`). CI flies a few: there the points of five flights err together,
and only what is grossly too small or too large is noticed.
"""

from __future__ import annotations

import os
from functools import cache

import numpy as np
import pytest
from coverage_cases import Measured, measure_flight, rms_ratio, shares, spread_of_shares

FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
KINDS = (
    "locate, flat, tags", "locate, TIN, tags", "locate, DEM, tags",
    "distance in one photo, flat, tags", "distance between photos, flat, tags",
    "distance in one photo, TIN, tags", "distance between photos, TIN, tags",
    "distance in one photo, DEM, tags", "distance between photos, DEM, tags",
    "intersect, tags", "distance, intersected, tags",
    "locate, own TIN, adjusted", "distance in one photo, own TIN, adjusted",
    "distance between photos, own TIN, adjusted", "intersect, adjusted",
    "distance, intersected, adjusted",
    *(f"{what}, {of}"
      for of in ("flat, tags", "TIN, tags", "DEM, tags", "own TIN, adjusted")
      for what in ("on the ground", "distance, on the ground", "distance, both ways")),
)  # fmt: skip
pytestmark = pytest.mark.slow


@cache
def flown() -> dict[str, list[Measured]]:
    out: dict[str, list[Measured]] = {}
    for seed in range(FLIGHTS):
        for kind, one in measure_flight(seed).items():
            out.setdefault(kind, []).append(one)
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_is_inside_as_often_as_is_said(kind: str) -> None:
    found = flown()[kind]
    small, large = shares(found)
    if FLIGHTS >= 200:
        # two sigmas of chance where the flights are too few to tell 4 and 2 %
        chance = 2.0 * spread_of_shares(found)
        assert small == pytest.approx(0.3935, abs=max(0.04, chance[0]))
        assert large == pytest.approx(0.95, abs=max(0.02, chance[1]))
    # 5 flights of some 6 points that err together: one flight out of bounds is chance
    assert large > 0.7
    assert 0.08 < small < 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_as_large_as_their_sigmas(kind: str) -> None:
    low, high = (0.7, 1.4) if FLIGHTS >= 40 else (0.35, 2.0)
    found = rms_ratio(flown()[kind])
    assert np.all((found > low) & (found < high)), found.round(2)


def test_shares_of_flights_that_err_together_are_known_less_well() -> None:
    """Bootstrap by flight: ten points that are all inside or all outside count as one."""
    rng = np.random.default_rng(2)
    together, apart = [], []
    for _ in range(200):
        one = rng.random() < 0.5
        ratios = np.zeros((10, 1))
        together.append(Measured(inside=np.full((10, 2), one), ratios=ratios))
        apart.append(Measured(inside=rng.random((10, 2)) < 0.5, ratios=ratios))
    # sqrt(0.25 / 200) and sqrt(0.25 / 2000); a bootstrap of 1000 is good to 2 %
    assert spread_of_shares(together) == pytest.approx([0.0354] * 2, rel=0.1)
    assert spread_of_shares(apart) == pytest.approx([0.0112] * 2, rel=0.2)
