"""The shift between two bands of one ground is found, or it is said that it is not."""

import numpy as np
import pytest
from band_cases import pair

from georef_gis.errors import GeometryError
from georef_gis.mosaic.band_shift import WindowShift, common_shift
from georef_gis.rasters.edge_shift import edge_shift

ALL = np.ones((256, 256), np.bool_)


@pytest.mark.parametrize("contrast", ["same", "brighter", "inverted", "folded"])
@pytest.mark.parametrize(
    "shift", [(0.0, 0.0), (0.3, 0.0), (-0.45, 0.55), (5.7, -2.25), (19.0, 8.5)]
)
def test_known_shift_is_found_to_a_tenth_of_a_pixel(
    shift: tuple[float, float], contrast: str
) -> None:
    found = edge_shift(*pair(shift, contrast=contrast), ALL, most=24.0)
    assert found is not None
    # px; what the task asks for
    np.testing.assert_allclose((found.d_col, found.d_row), shift, atol=0.1)


def test_invalid_part_does_not_pull_the_shift() -> None:
    first, second = pair((3.25, 1.5))
    valid = ALL.copy()
    # a rim that lies at the same place in both, brighter than all else
    valid[:, 200:] = False
    first[:, 200:], second[:, 200:] = 5.0, 5.0
    found = edge_shift(first, second, valid, most=16.0)
    assert found is not None
    np.testing.assert_allclose((found.d_col, found.d_row), (3.25, 1.5), atol=0.1)


def test_kind_of_numbers_does_not_matter() -> None:
    first, second = pair((2.5, -1.25))
    eight = np.clip(first * 255, 0, 255).astype(np.uint8)
    sixteen = np.clip(second * 65535, 0, 65535).astype(np.uint16)
    found = edge_shift(eight, sixteen, ALL, most=16.0)
    assert found is not None
    np.testing.assert_allclose((found.d_col, found.d_row), (2.5, -1.25), atol=0.1)


def test_window_of_no_use_says_nothing() -> None:
    rng = np.random.default_rng(1)
    first, second = pair((0.0, 0.0))
    flat = np.full_like(first, 0.5)
    noise = [rng.normal(0.5, 0.01, first.shape) for _ in range(2)]
    assert edge_shift(flat, flat, ALL, most=16.0) is None
    assert edge_shift(first, flat, ALL, most=16.0) is None
    assert edge_shift(noise[0], noise[1], ALL, most=16.0) is None
    few = np.zeros_like(ALL)
    few[:100] = True
    assert edge_shift(first, second, few, most=16.0) is None


def test_straight_edge_alone_says_nothing() -> None:
    """Along a road the shift is unknown."""
    rng = np.random.default_rng(1)
    road = np.where(np.arange(256) < 120, 0.2, 0.8)[None, :, None].repeat(256, axis=0)
    first, second = (road + rng.normal(0.0, 0.005, road.shape) for _ in range(2))
    assert edge_shift(first, second, ALL, most=16.0) is None


def test_furrows_say_nothing() -> None:
    """They look the same after every period."""
    rng = np.random.default_rng(1)
    waves = 0.5 + 0.3 * np.sin(2 * np.pi * np.arange(256) / 9.0)[None, :, None].repeat(256, axis=0)
    first, second = (waves + rng.normal(0.0, 0.005, waves.shape) for _ in range(2))
    assert edge_shift(first, second, ALL, most=16.0) is None


def test_shift_beyond_the_limit_says_nothing() -> None:
    assert edge_shift(*pair((19.0, 0.0)), ALL, most=10.0) is None


def windows(shifts: np.ndarray, places: np.ndarray | None = None) -> list[WindowShift]:
    if places is None:
        places = np.random.default_rng(2).uniform(0, 5000, shifts.shape)
    return [
        WindowShift(col=x, row=y, d_col=dx, d_row=dy, score=0.5)
        for (x, y), (dx, dy) in zip(places.tolist(), shifts.tolist(), strict=True)
    ]


def test_gross_errors_do_not_matter(rng: np.random.Generator) -> None:
    good = np.array([4.0, -2.0]) + rng.normal(0, 0.1, (20, 2))
    bad = rng.uniform(8, 30, (9, 2)) * rng.choice([-1, 1], (9, 2))
    found = common_shift(windows(np.vstack([good, bad])), tried=40, most=32.0)
    # px; 4 deviations of a median of 20 windows of 0.1 px
    np.testing.assert_allclose(found.shift, (4.0, -2.0), atol=4 * 1.25 * 0.1 / np.sqrt(20))
    assert 17 <= found.agreeing <= 20
    assert (found.peaked, found.tried) == (29, 40)
    assert not found.sloped
    assert found.significant
    np.testing.assert_allclose(found.scatter, 0.1, atol=0.05)


def test_sigma_is_that_of_repeated_trials(rng: np.random.Generator) -> None:
    found = [
        common_shift(windows(rng.normal(1.0, 0.2, (11, 2))), tried=11, most=10.0)
        for _ in range(200)
    ]
    errors = np.array([one.shift for one in found]) - 1.0
    told = np.median([one.sigma for one in found])
    # 400 draws: 4 % of the deviation; the robust scatter of 11 windows is low by some percent
    assert 0.75 < told / errors.std() < 1.3


def test_slope_is_found_where_there_is_one(rng: np.random.Generator) -> None:
    places = rng.uniform(0, 5000, (40, 2))
    slope = np.array([[3e-4, -1e-4], [2e-4, 1e-4]])
    true = np.array([1.5, 0.5]) + (places - 2500.0) @ slope
    found = common_shift(windows(true + rng.normal(0, 0.1, true.shape), places), tried=40, most=9.0)
    assert found.sloped
    a, b, c, d, e, f = found.moved
    at = np.column_stack([places, np.ones(40)]) @ np.array([[a, d], [b, e], [c, f]])
    # px; noise of 0.1 px over 40 windows, three unknowns an axis, at the corners
    np.testing.assert_allclose(at - places, true, atol=0.15)


def test_no_slope_is_made_of_noise(rng: np.random.Generator) -> None:
    found = common_shift(windows(rng.normal(0.02, 0.2, (40, 2))), tried=40, most=9.0)
    assert not found.sloped
    assert not found.significant


def test_part_that_lies_otherwise_shows_in_the_scatter(rng: np.random.Generator) -> None:
    """A third of the windows, 2 px off: outliers of the shift, but not of what is left."""
    shifts = rng.normal(0, 0.05, (30, 2))
    shifts[:10, 0] += 2.0
    found = common_shift(windows(shifts), tried=30, most=9.0)
    # px; the root of a third of 2 px squared, over two axes
    np.testing.assert_allclose(found.scatter, np.sqrt(4.0 / 3.0 / 2.0), atol=0.1)


@pytest.mark.parametrize("count", [4, 8, 40])
def test_windows_that_disagree_are_refused_with_figures(
    rng: np.random.Generator, count: int
) -> None:
    spread = rng.uniform(-30, 30, (count, 2))
    with pytest.raises(GeometryError, match=f"of the {count} windows .* at least half must") as e:
        common_shift(windows(spread), tried=50, most=32.0)
    assert "\n" not in str(e.value)


def test_too_few_windows_are_refused_with_figures() -> None:
    with pytest.raises(GeometryError, match="only 3 of 25 windows"):
        common_shift(windows(np.zeros((3, 2))), tried=25, most=32.0)
