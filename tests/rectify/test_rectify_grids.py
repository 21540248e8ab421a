"""Grids of the products: pixel size, alignment and the refusal of the absurd."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rectify_cases import map_frame, square

from georef_gis.errors import InputError
from georef_gis.rectify.grids import nice_pixel, plan_grid

FRAME = map_frame()
FEET = map_frame("EPSG:6601")
# m; US survey foot, exactly 1200/3937
FOOT = 1200.0 / 3937.0


@given(st.floats(1e-4, 1e3))
def test_nice_pixel_has_two_digits_and_is_not_coarser(gsd: float) -> None:
    pixel = nice_pixel(gsd)
    assert 0.9 * gsd <= pixel <= gsd * (1 + 1e-9)
    assert float(f"{pixel:.1e}") == pixel


def test_grid_covers_the_footprints() -> None:
    prints = [square(FRAME, 0.0, 0.0, 100.0), square(FRAME, 80.0, -30.0, 60.0)]
    left, bottom, right, top = plan_grid(prints, FRAME).bounds
    ring = np.vstack([f.ring_map for f in prints])
    assert left <= ring[:, 0].min() < left + 0.2
    assert right >= ring[:, 0].max() > right - 0.2
    assert bottom <= ring[:, 1].min()
    assert top >= ring[:, 1].max()


def test_grids_of_one_pixel_size_are_aligned() -> None:
    a = plan_grid([square(FRAME, 0.0, 0.0, 100.0)], FRAME, gsd=0.07)
    b = plan_grid([square(FRAME, 33.3, -12.7, 55.0)], FRAME, gsd=0.07)
    shift = np.array([a.left - b.left, a.top - b.top]) / 0.07
    np.testing.assert_allclose(shift, np.rint(shift), atol=1e-6)  # px


def test_pixel_in_feet_is_nice_in_feet() -> None:
    grid = plan_grid([square(FEET, 0.0, 0.0, 100.0)], FEET)
    # GSD 0.2 m = 0.65617 ftUS
    assert grid.pixel == 0.65
    assert grid.width * grid.pixel == pytest.approx(100.0 / FOOT, rel=0.03)  # convergence


def test_gsd_asked_for_is_in_metres_on_a_map_in_feet() -> None:
    grid = plan_grid([square(FEET, 0.0, 0.0, 100.0)], FEET, gsd=0.3)
    assert grid.pixel == pytest.approx(0.3 / FOOT, rel=1e-12)


def test_international_foot_is_another_one() -> None:
    frame = map_frame("EPSG:2992")  # Oregon GIC Lambert, international feet: only the unit counts
    grid = plan_grid([square(FRAME, 0.0, 0.0, 100.0)], frame, gsd=0.3048)
    assert grid.pixel == pytest.approx(1.0, rel=1e-12)


def test_absurd_gsd_is_refused_with_the_number() -> None:
    with pytest.raises(InputError, match=r"gsd: 1e-06 m over 10\d x 10\d m makes 1\.\de\+16 px"):
        plan_grid([square(FRAME, 0.0, 0.0, 100.0)], FRAME, gsd=1e-6)


def test_no_footprint_is_refused() -> None:
    with pytest.raises(InputError, match="nothing to map"):
        plan_grid([], FRAME)


def test_tiny_footprint_has_a_pixel() -> None:
    grid = plan_grid([square(FRAME, 0.0, 0.0, 0.01)], FRAME, gsd=10.0)
    assert grid.width >= 1
    assert math.isfinite(grid.left)
