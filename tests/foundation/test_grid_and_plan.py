"""Grid against rasterio's affine, Plan against shapely."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rasterio.transform import Affine
from shapely import box
from shapely.geometry import MultiPoint

from georef_gis.model.grid import Grid
from georef_gis.model.plan import Plan, plan_tiles

SIDE = st.floats(0.5, 5000.0)
PLACE = st.floats(-1e6, 1e7)
PIXEL = st.sampled_from([0.01, 0.025, 0.1, 0.5, 1.0, 3.28125])


def grid_of(width: int = 1000, height: int = 700, pixel: float = 0.5) -> Grid:
    return Grid(crs_wkt="", left=100.0, top=900.0, pixel=pixel, width=width, height=height)


@given(PLACE, PLACE, st.floats(0.5, 50.0), st.floats(0.5, 50.0), PIXEL)
def test_grid_over_bounds_covers_them_and_is_aligned(
    left: float, bottom: float, width: float, height: float, pixel: float
) -> None:
    grid = Grid.over((left, bottom, left + width, bottom + height), pixel=pixel, crs_wkt="")
    l, b, r, t = grid.bounds  # noqa: E741
    slack = 1e-8 * (abs(left) + abs(bottom) + 1)
    assert l <= left + slack
    assert b <= bottom + slack
    assert r >= left + width - slack
    assert t >= bottom + height - slack
    # No more than one pixel wasted on either side
    assert grid.width <= math.ceil(width / pixel) + 2
    steps = np.array([grid.left, grid.top]) / pixel
    assert steps == pytest.approx(np.round(steps), abs=1e-5)


@given(st.floats(-50, 2000), st.floats(-50, 2000))
def test_grid_is_rasterios_affine_and_goes_back(col: float, row: float) -> None:
    grid = grid_of()
    xy = grid.map_from_grid([col, row])
    assert xy == pytest.approx(Affine(*grid.transform) @ (col, row), abs=1e-9)
    assert grid.grid_from_map(xy) == pytest.approx([col, row], abs=1e-9)


def test_first_pixels_outer_corner_and_centre() -> None:
    grid = grid_of()
    assert np.array_equal(grid.map_from_grid([0, 0]), [100.0, 900.0])
    assert np.array_equal(grid.map_from_grid([0.5, 0.5]), [100.25, 899.75])
    assert grid.bounds == (100.0, 550.0, 600.0, 900.0)


def test_tiles_cover_each_pixel_once() -> None:
    count = np.zeros((700, 1000), int)
    for _, _, w in grid_of().tiles(256):
        count[w.row : w.row + w.height, w.col : w.col + w.width] += 1
    assert np.all(count == 1)


@pytest.mark.parametrize("bad", [{"pixel": 0.0}, {"pixel": float("nan")}, {"width": 0}])
def test_impossible_grids_are_refused(bad: dict) -> None:
    with pytest.raises(ValueError):
        grid_of(**bad)


def test_bounds_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        Grid.over((0.0, 0.0, math.nan, 1.0), pixel=1.0, crs_wkt="")


@given(
    st.lists(
        st.tuples(st.floats(-300, 900), st.floats(300, 1200)), min_size=4, max_size=12, unique=True
    )
)
def test_tiles_of_a_photo_are_those_its_hull_meets(ring: list) -> None:
    grid = grid_of()
    hull = MultiPoint(ring).convex_hull
    if hull.area < 1.0:
        return
    plan = plan_tiles(grid, {"A": np.array(ring)}, tile_size=128)
    ours = {(t.row, t.col) for t in plan.tiles}
    for row, col, w in grid.tiles(128):
        x0, y1 = grid.map_from_grid([w.col, w.row])
        tile = box(x0, y1 - 64.0, x0 + 64.0, y1)  # whole, also where the grid cuts it
        if hull.intersection(tile).area > 1e-6:
            assert (row, col) in ours
        elif hull.distance(tile) > 1e-6:
            assert (row, col) not in ours


def test_plan_lists_photos_by_tile_and_leaves_empty_ones_out() -> None:
    rings = {
        "A": np.array([[100, 900], [150, 900], [150, 850], [100, 850.0]]),
        "B": np.array([[140, 890], [190, 890], [190, 840], [140, 840.0]]),
        "far": np.array([[1e5, 1e5], [1e5 + 9, 1e5], [1e5, 1e5 + 9.0]]),
    }
    plan = plan_tiles(grid_of(), rings, tile_size=100)
    by_place = {(t.row, t.col): t.photo_ids for t in plan.tiles}
    assert by_place[0, 0] == ("A", "B")
    assert by_place[0, 1] == ("A", "B")  # A ends on the tile's side
    assert (5, 5) not in by_place
    assert all("far" not in ids for ids in by_place.values())


def test_plan_survives_json_and_refuses_another_version() -> None:
    ring = np.array([[100, 900], [300, 900], [300, 600], [100, 600.0]])
    plan = plan_tiles(grid_of(), {"A": ring}, tile_size=128)
    assert Plan.from_json(plan.to_json()) == plan
    with pytest.raises(ValueError, match="version 99"):
        Plan.from_json(plan.to_json().replace('"version": 1', '"version": 99'))


def test_tiles_are_worked_off_four_by_four() -> None:
    ring = np.array([[100, 900], [600, 900], [600, 550], [100, 550.0]])
    order = [(t.row, t.col) for t in plan_tiles(grid_of(), {"A": ring}, tile_size=128).tiles]
    assert order[:5] == [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2)]
