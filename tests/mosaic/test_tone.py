"""Gains that spare what is near white."""

from __future__ import annotations

import numpy as np
import pytest

from georef_gis.mosaic.tone import grown, tone_of, toned

KNEE = 1.0 / 255.0


def test_without_a_knee_it_is_a_product_bit_for_bit(rng: np.random.Generator) -> None:
    value = rng.uniform(0.0, 300.0, (50, 3)).astype(np.float32)
    factor = rng.uniform(0.5, 2.0, (50, 3)).astype(np.float32)
    np.testing.assert_array_equal(toned(value, factor, 0.0), value * factor)


def test_black_and_white_stay_and_nothing_exceeds_white(rng: np.random.Generator) -> None:
    value = rng.uniform(0.0, 255.0, 500)
    for factor in (0.3, 1.0, 3.0):
        np.testing.assert_allclose(toned(np.array([0.0, 255.0]), factor, KNEE), [0.0, 255.0])
        out = toned(value, np.full(500, factor), KNEE)
        assert out.max() <= 255.0 + 1e-9
        # the order of grey values stays
        assert (np.diff(out[np.argsort(value)]) >= 0.0).all()


def test_dark_values_gain_by_the_factor() -> None:
    np.testing.assert_allclose(toned(np.array([0.1]), np.array([2.0]), KNEE), 0.2, rtol=1e-3)


@pytest.mark.parametrize("knee", [0.0, KNEE])
def test_two_gains_one_after_the_other_are_their_product(
    rng: np.random.Generator, knee: float
) -> None:
    value, first, second = rng.uniform([1.0, 0.5, 0.5], [254.0, 2.0, 2.0], (200, 3)).T
    once = toned(value, first * second, knee)
    np.testing.assert_allclose(toned(toned(value, first, knee), second, knee), once, rtol=1e-12)


@pytest.mark.parametrize("knee", [0.0, KNEE])
def test_logarithms_of_gains_are_added_to_the_tone(rng: np.random.Generator, knee: float) -> None:
    value, log = rng.uniform([5.0, -0.7], [230.0, 0.05], (200, 2)).T
    after = tone_of(toned(value, np.exp(log), knee), 0.1, knee)
    np.testing.assert_allclose(after, tone_of(value, 0.1, knee) + log, rtol=1e-9)


@pytest.mark.parametrize("knee", [0.0, KNEE])
def test_growth_is_the_derivative(rng: np.random.Generator, knee: float) -> None:
    value = rng.uniform(5.0, 250.0, 100)
    step = 1e-5
    slope = (toned(value, np.exp(step), knee) - toned(value, np.exp(-step), knee)) / (2 * step)
    # of differences over 1e-5
    np.testing.assert_allclose(grown(tone_of(value, 0.1, knee), knee), slope, rtol=1e-6)


def test_values_at_the_ends_have_finite_tones() -> None:
    tones = tone_of(np.array([-3.0, 0.0, 255.0, 300.0]), 0.5, KNEE)
    assert np.isfinite(tones).all()
    assert tones[0] == tones[1] < tones[2] == tones[3]
