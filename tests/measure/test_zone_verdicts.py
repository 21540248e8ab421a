"""Pass, fail, cannot tell: what the answers promise, for any numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from georef_gis.measure.workzone.verdicts import (
    probability_of_all,
    probability_within,
    sigma_needed,
    verdict_of,
    verdict_of_all,
)

# m; lengths of work zones
VALUES = st.floats(0.0, 1000.0)
SIGMAS = st.floats(1e-3, 100.0)
INF = math.inf


@pytest.mark.parametrize(
    ("value", "sigma", "low", "high", "verdict"),
    [
        # 660 ft asked for; 1.645 sigma is the border
        (201.168 + 1.65, 1.0, 201.168, INF, "pass"),
        (201.168 + 1.64, 1.0, 201.168, INF, "cannot tell"),
        (201.168 - 1.64, 1.0, 201.168, INF, "cannot tell"),
        (201.168 - 1.65, 1.0, 201.168, INF, "fail"),
        (16.0, 0.1, -INF, 16.764, "pass"),
        (17.5, 0.1, -INF, 16.764, "fail"),
        # 55 ft with the 7.8 m of a flight without control
        (16.0, 7.8, -INF, 16.764, "cannot tell"),
        (20.0, 1.0, 15.24, 30.48, "pass"),
        (20.0, 20.0, 15.24, 30.48, "cannot tell"),
        (50.0, 5.0, 15.24, 30.48, "fail"),
        # between two limits with any probability, but beyond neither of them for certain
        (20.0, 500.0, 15.24, 30.48, "cannot tell"),
        (50.0, 500.0, 15.24, 30.48, "cannot tell"),
        (16.764, 0.0, -INF, 16.764, "pass"),
        (16.765, 0.0, -INF, 16.764, "fail"),
    ],
)
def test_verdicts_by_hand(
    value: float, sigma: float, low: float, high: float, verdict: str
) -> None:
    assert verdict_of(value, sigma, low, high) == verdict


@given(value=VALUES, sigma=SIGMAS, limit=VALUES, factor=st.floats(0.01, 1.0))
def test_better_accuracy_never_turns_an_answer_round_or_takes_it_back(
    value: float, sigma: float, limit: float, factor: float
) -> None:
    before = verdict_of(value, sigma, limit, INF)
    after = verdict_of(value, factor * sigma, limit, INF)
    assert after == before or before == "cannot tell"


@given(value=VALUES, sigma=SIGMAS, limit=VALUES)
def test_at_least_and_at_most_are_opposites(value: float, sigma: float, limit: float) -> None:
    at_least = probability_within(value, sigma, limit, INF)
    at_most = probability_within(value, sigma, -INF, limit)
    assert at_least + at_most == pytest.approx(1.0, abs=1e-12)


@given(value=VALUES, low=VALUES, width=st.floats(0.1, 100.0) | st.just(INF))
def test_sigma_needed_is_the_border_of_having_an_answer(
    value: float, low: float, width: float
) -> None:
    needed = sigma_needed(value, low, low + width)
    if needed < 1e-6:
        return
    for factor, told in ((0.999, True), (1.001, False)):
        verdict = verdict_of(value, factor * needed, low, low + width)
        assert (verdict != "cannot tell") is told
    # with an answer, it is the right one
    inside = low <= value <= low + width
    answer = "pass" if inside else "fail"
    assert verdict_of(value, 0.999 * needed, low, low + width) == answer


def test_value_on_the_limit_has_no_answer_and_no_limit_is_always_met() -> None:
    assert sigma_needed(10.0, 10.0, INF) == 0.0
    assert sigma_needed(10.0, -INF, INF) == INF
    assert probability_within(10.0, 5.0, -INF, INF) == 1.0


@given(
    gaps=st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=6),
    correlation=st.floats(0.0, 0.999),
)
def test_all_at_once_lies_within_what_the_single_ones_allow(
    gaps: list[float], correlation: float
) -> None:
    n = len(gaps)
    C = (1 - correlation) * np.eye(n) + correlation
    p = probability_of_all(np.array(gaps), C, np.full(n, -INF), np.zeros(n))
    single = norm.cdf(-np.array(gaps))
    assert max(0.0, 1 - np.sum(1 - single)) - 1e-9 <= p <= single.min() + 1e-9


def test_all_at_once_of_independent_ones_is_their_product() -> None:
    values = np.array([-0.5, -1.0, 0.2])
    p = probability_of_all(values, np.eye(3), np.full(3, -INF), np.zeros(3))
    # 20 000 draws: 4 standard errors
    assert p == pytest.approx(np.prod(norm.cdf(-values)), abs=0.014)


def test_all_at_once_of_one_error_is_the_worst_of_them() -> None:
    values = np.array([-0.5, -1.0, 0.2])
    p = probability_of_all(values, np.ones((3, 3)), np.full(3, -INF), np.zeros(3))
    assert p == pytest.approx(norm.cdf(-0.2), abs=0.014)


@pytest.mark.parametrize(
    ("together", "single", "verdict"),
    [
        (0.96, [0.97, 0.99], "pass"),
        (0.90, [0.95, 0.95], "cannot tell"),
        # 20 that are each undecided: one is surely missed, but which?
        (0.00, [0.5] * 20, "cannot tell"),
        # one in 20 may look missed by chance
        (0.00, [0.04] + [0.9] * 19, "cannot tell"),
        (0.00, [0.002] + [0.9] * 19, "fail"),
        (0.04, [0.04], "fail"),
    ],
)
def test_answers_on_several_at_once(together: float, single: list[float], verdict: str) -> None:
    assert verdict_of_all(together, single) == verdict


def test_all_at_once_without_error_is_yes_or_no() -> None:
    none = np.zeros((2, 2))
    assert probability_of_all(np.array([1.0, 2.0]), none, np.zeros(2), np.full(2, 3.0)) == 1.0
    assert probability_of_all(np.array([1.0, 4.0]), none, np.zeros(2), np.full(2, 3.0)) == 0.0
