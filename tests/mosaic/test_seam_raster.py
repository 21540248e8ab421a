"""Seam polygons on windows: the same pixel gets the same label and weights in any window."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.seam_raster import (
    SeamIndex,
    distance_to_seam,
    label_window,
    seam_weights,
)

LEFT, TOP, PIXEL = 512000.0, 4431000.0, 0.05
SIDE = 160
GRID = Grid(crs_wkt="", left=LEFT, top=TOP, pixel=PIXEL, width=SIDE, height=SIDE)
ALL = Window(col=0, row=0, width=SIDE, height=SIDE)
REACH = 6.0
Weights = dict[int, NDArray[np.float32] | None]


def on_map(pixels: list[tuple[float, float]]) -> shapely.Polygon:
    return shapely.Polygon(GRID.map_from_grid(pixels))


def voronoi() -> SeamIndex:
    """Cells about random places within the grid; the ground outside has no cell."""
    places = np.random.default_rng(3).uniform(10, SIDE - 10, (9, 2))
    cells = shapely.get_parts(
        shapely.voronoi_polygons(shapely.MultiPoint(GRID.map_from_grid(places)))
    )
    frame = shapely.box(*on_map([(15, 12), (150, 12), (150, 149.3), (15, 149.3)]).bounds)
    cut = shapely.coverage_clean(shapely.intersection(cells, frame))
    return SeamIndex.of([(10 + k, area) for k, area in enumerate(cut)])


INDEX = voronoi()
LABELS = label_window(INDEX, GRID, ALL)
# left and right of column 80, exactly between two pixels
HALVES = SeamIndex.of(
    [
        (1, on_map([(0, 0), (80, 0), (80, SIDE), (0, SIDE)])),
        (2, on_map([(80, 0), (SIDE, 0), (SIDE, SIDE), (80, SIDE)])),
    ]
)

windows = st.builds(
    Window, col=st.integers(-9, SIDE), row=st.integers(-9, SIDE), width=st.integers(1, 70),
    height=st.integers(1, 70),
)  # fmt: skip


def part(values: NDArray[np.generic], window: Window, outside: float) -> NDArray[np.generic]:
    """What a window shows of an array over the whole grid."""
    padded = np.pad(values, 90, constant_values=outside)
    r, c = window.row + 90, window.col + 90
    return padded[r : r + window.height, c : c + window.width]


def dense(weights: Weights, window: Window) -> dict[int, NDArray[np.float32]]:
    one = np.ones((window.height, window.width), np.float32)
    return {label: one if w is None else w for label, w in weights.items()}


@settings(deadline=None)
@given(windows)
def test_labels_do_not_depend_on_the_window(window: Window) -> None:
    np.testing.assert_array_equal(label_window(INDEX, GRID, window), part(LABELS, window, -1))


@settings(deadline=None)
@given(windows)
def test_weights_and_distances_do_not_depend_on_the_window(window: Window) -> None:
    whole = dense(seam_weights(INDEX, GRID, ALL, REACH), ALL)
    found = dense(seam_weights(INDEX, GRID, window, REACH), window)
    for label, weight in whole.items():
        want = part(weight, window, 0.0)
        np.testing.assert_array_equal(found.get(label, np.zeros_like(want)), want)
        assert (label in found) == bool(want.any())
    distance = distance_to_seam(INDEX, GRID, ALL, 20.0)
    np.testing.assert_array_equal(
        distance_to_seam(INDEX, GRID, window, 20.0), part(distance, window, 0.0)
    )


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_neighbours_share_out_the_pixels(seed: int, on_lattice: bool) -> None:
    """Each pixel has exactly one owner, also where vertices lie on the middles of pixels."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 40, (8, 2))
    if on_lattice:
        places = np.unique(np.round(places * 2) / 2, axis=0)
    triangles = shapely.get_parts(
        shapely.delaunay_triangles(shapely.MultiPoint(GRID.map_from_grid(places)))
    )
    window = Window(col=-2, row=-2, width=45, height=45)
    count = np.zeros((45, 45), int)
    for triangle in triangles:
        count += label_window(SeamIndex.of([(0, triangle)]), GRID, window) == 0
    together = label_window(SeamIndex.of(list(enumerate(triangles))), GRID, window)
    assert count.max() <= 1
    np.testing.assert_array_equal(together >= 0, count == 1)


def test_of_polygons_that_overlap_the_later_wins() -> None:
    big = on_map([(0, 0), (30, 0), (30, 30), (0, 30)])
    small = on_map([(10, 10), (20, 10), (20, 20), (10, 20)])
    window = Window(col=0, row=0, width=30, height=30)
    over = label_window(SeamIndex.of([(7, big), (9, small)]), GRID, window)
    under = label_window(SeamIndex.of([(9, small), (7, big)]), GRID, window)
    assert (over == 9).sum() == 100
    assert (over == 7).sum() == 800
    assert (under == 7).all()


def test_weights_fall_linearly_across_a_seam() -> None:
    weights = seam_weights(HALVES, GRID, Window(col=60, row=5, width=40, height=2), 8.0)
    left, right = weights[1], weights[2]
    assert left is not None
    assert right is not None
    centre = np.arange(60, 100) + 0.5
    # float32, and coordinates of 4 million m on pixels of 0.05 m: 2e-8 px
    want = np.clip(0.5 - (centre - 80.0) / 16.0, 0.0, 1.0)
    np.testing.assert_allclose(left, [want, want], atol=1e-6)
    np.testing.assert_allclose(left + right, 1.0, atol=1e-6)


def test_weights_sum_to_one_on_cells_and_to_nothing_elsewhere() -> None:
    total = np.sum(list(dense(seam_weights(INDEX, GRID, ALL, REACH), ALL).values()), axis=0)
    np.testing.assert_allclose(total, LABELS >= 0, atol=1e-6)
    assert (LABELS < 0).mean() > 0.1


def test_weights_are_continuous_also_where_three_cells_meet() -> None:
    for weight in dense(seam_weights(INDEX, GRID, ALL, REACH), ALL).values():
        inside = LABELS >= 0
        for axis in (0, 1):
            both = np.logical_and(*(np.take(inside, r, axis) for r in (range(SIDE - 1),
                                  range(1, SIDE))))  # fmt: skip
            # of two cells 1 / (2 reach) a pixel, of three less than three times as much
            assert np.abs(np.diff(weight, axis=axis))[both].max() < 1.5 / REACH


def test_the_rim_of_the_ground_shown_is_no_seam() -> None:
    alone = SeamIndex.of([(4, on_map([(20, 20), (60, 20), (60, 60), (20, 60)]))])
    weight = seam_weights(alone, GRID, ALL, REACH)[4]
    assert weight is not None
    np.testing.assert_array_equal(weight, label_window(alone, GRID, ALL) == 4)
    assert distance_to_seam(alone, GRID, ALL, 9.0)[20, 20] == 9.0


def test_distances_are_those_of_geos() -> None:
    distance = distance_to_seam(INDEX, GRID, ALL, 20.0)
    cells = {10 + k: g for k, g in enumerate(polygons_back(INDEX))}
    rows, cols = np.mgrid[16:145:7, 18:147:9]
    for r, c in zip(rows.ravel(), cols.ravel(), strict=True):
        point = shapely.Point(GRID.map_from_grid((c + 0.5, r + 0.5)))
        others = [g for label, g in cells.items() if label != LABELS[r, c]]
        want = min(20.0, min(shapely.distance(g, point) for g in others) / PIXEL)
        # px; float32 and the rounding of map coordinates
        assert distance[r, c] == pytest.approx(want, abs=1e-4)


def polygons_back(index: SeamIndex) -> list[shapely.Polygon]:
    """Areas from the edges of an index."""
    return [
        shapely.get_parts(shapely.polygonize([
            shapely.LineString([e[:2], e[2:]]) for e in index.edges[a:b]
        ]))[0]
        for a, b in zip(index.first[:-1], index.first[1:], strict=True)
    ]  # fmt: skip


@pytest.mark.parametrize("reach", [0.7, 5.3, 11.1])
def test_labels_count_no_farther_than_reach(reach: float) -> None:
    window = Window(col=40, row=0, width=80, height=3)
    for weight in dense(seam_weights(HALVES, GRID, window, reach), window).values():
        columns = np.nonzero((weight > 0.0) & (weight < 1.0))[1] + 40.5
        assert np.abs(columns - 80.0).max() < reach
    assert seam_weights(INDEX, GRID, ALL, reach).keys() == set(LABELS[LABELS >= 0].tolist())


def test_a_window_deep_in_a_cell_needs_no_weights() -> None:
    deep = Window(col=5, row=5, width=60, height=60)
    assert seam_weights(HALVES, GRID, deep, 8.0) == {1: None}
    assert (label_window(HALVES, GRID, deep) == 1).all()
    assert seam_weights(INDEX, GRID, Window(col=-500, row=-500, width=9, height=9), 8.0) == {}
    assert seam_weights(SeamIndex.of([]), GRID, deep, 8.0) == {}


def test_a_slanting_seam_that_misses_the_window_needs_no_weights() -> None:
    index = SeamIndex.of(
        [
            (1, on_map([(0, 0), (SIDE, 0), (0, SIDE)])),
            (2, on_map([(SIDE, 0), (SIDE, SIDE), (0, SIDE)])),
        ]
    )
    # px from the seam of the nearest pixels: 8.5 and 11.3; the far one's bounds still meet it
    near, far = (Window(col=c, row=64, width=20, height=20) for c in (45, 41))
    assert not index.near(GRID, far, 6.0).has_border(6.0)
    assert seam_weights(index, GRID, far, 6.0) == {1: None}
    assert seam_weights(index, GRID, near, 8.6).keys() == {1, 2}


def test_an_index_survives_the_way_to_another_process() -> None:
    copy = pickle.loads(pickle.dumps(INDEX))
    np.testing.assert_array_equal(label_window(copy, GRID, ALL), LABELS)
