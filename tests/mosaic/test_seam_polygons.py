"""Labels on the coarse grid as polygons: a coverage that says what the labels say."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import BLOCK, SparseRaster
from georef_gis.mosaic.seam_polygons import SMOOTHING, polygons_of
from georef_gis.mosaic.seam_raster import SeamIndex, label_window

Labels = NDArray[np.int32]
LEFT, TOP, PIXEL = 512000.0, 4431000.0, 0.4

maps = st.tuples(st.integers(1, 12), st.integers(1, 12)).flatmap(
    lambda shape: arrays(np.int32, shape, elements=st.integers(-1, 3))
)


def sparse(values: Labels) -> SparseRaster:
    rows, cols = values.shape
    raster = SparseRaster(width=cols, height=rows, dtype=np.int32, fill=-1)
    raster.write(Window(col=0, row=0, width=cols, height=rows), values, values >= 0)
    return raster


def grid_of(raster: SparseRaster) -> Grid:
    return Grid(
        crs_wkt="", left=LEFT, top=TOP, pixel=PIXEL, width=raster.width, height=raster.height
    )


def areas_of(values: Labels, smoothing: float = SMOOTHING) -> dict[int, shapely.MultiPolygon]:
    raster = sparse(values)
    ids = [str(i) for i in range(int(values.max()) + 1)]
    found = polygons_of(raster, grid_of(raster), ids, smoothing=smoothing)
    return {int(name): area for name, area in found}


def check(values: Labels, areas: dict[int, shapely.MultiPolygon]) -> None:
    assert list(areas) == sorted(set(values[values >= 0].tolist()))
    geometries = list(areas.values())
    assert all(a.geom_type == "MultiPolygon" and a.is_valid for a in geometries)
    assert shapely.coverage_is_valid(geometries)


@settings(deadline=None)
@given(maps)
def test_any_labels_make_a_valid_coverage(values: Labels) -> None:
    for smoothing in (0.0, SMOOTHING):
        check(values, areas_of(values, smoothing))


def rasterised(areas: dict[int, shapely.MultiPolygon], values: Labels) -> Labels:
    """Labels at the middles of the coarse pixels, by GEOS and no code of ours."""
    rows, cols = np.mgrid[: values.shape[0], : values.shape[1]]
    out = np.full(values.shape, -1, np.int32)
    for label, area in areas.items():
        x, y = LEFT + (cols + 0.5) * PIXEL, TOP - (rows + 0.5) * PIXEL
        out[shapely.contains_xy(area, x, y)] = label
    return out


@settings(deadline=None)
@given(maps)
def test_unsmoothed_borders_keep_every_pixel_middle(values: Labels) -> None:
    np.testing.assert_array_equal(rasterised(areas_of(values, 0.0), values), values)


def cells(rng: np.random.Generator, side: int, count: int) -> Labels:
    """Cells about random places with borders that wind, a rim and a hole without a photo."""
    places = rng.uniform(0, side, (count, 2))
    rows, cols = np.mgrid[:side, :side].astype(float)
    r, c = rows + 2 * np.sin(cols / 5), cols + 2 * np.sin(rows / 4)
    distances = np.array([np.hypot(r - y, c - x) for y, x in places])
    out: Labels = np.argmin(distances, axis=0).astype(np.int32)
    out[np.hypot(rows - side / 2, cols - side / 2) > side * 0.48] = -1
    out[side // 2 : side // 2 + 9, side // 3 : side // 3 + 20] = -1
    return out


def test_round_trip_differs_within_a_pixel_of_borders_only(rng: np.random.Generator) -> None:
    values = cells(rng, 300, 20)
    areas = areas_of(values)
    check(values, areas)
    back = rasterised(areas, values)
    # a border moves by less than a pixel: a pixel whose 3 x 3 surroundings agree keeps its label
    inner = maximum_filter(values, 3) == minimum_filter(values, 3)
    assert inner.mean() > 0.8
    np.testing.assert_array_equal(back[inner], values[inner])
    assert (back != values).mean() < 0.01


def test_a_slanting_border_becomes_a_line_without_stairs() -> None:
    rows, cols = np.mgrid[:100, :100]
    values = (cols > 20 + 0.4 * rows).astype(np.int32)
    x, y = np.array(areas_of(values)[0].geoms[0].exterior.coords)[:-1].T
    col, row = (x - LEFT) / PIXEL, (TOP - y) / PIXEL
    border = (col > 1) & (row > 1) & (row < 99)
    # of 140 corners of stairs; px: half a pixel to either side of the line between the labels
    assert border.sum() < 10
    assert np.ptp((col - 0.4 * row)[border]) < 1.0


def test_one_cell_around_another_has_a_hole_and_an_island_in_it() -> None:
    values = np.zeros((20, 20), np.int32)
    values[5:15, 5:15] = 1
    values[9:11, 9:11] = 0
    areas = areas_of(values)
    assert [len(p.interiors) for p in areas[0].geoms] in ([1, 0], [0, 1])
    assert [len(p.interiors) for p in areas[1].geoms] == [1]
    assert sum(a.area for a in areas.values()) == pytest.approx(400 * PIXEL**2, rel=0.01)


def test_a_hole_belongs_to_the_smallest_part_about_it() -> None:
    rows, cols = np.mgrid[:36, :36]
    rings = np.maximum(np.abs(rows - 17.5), np.abs(cols - 17.5)).astype(int) // 3
    areas = areas_of((rings % 2).astype(np.int32), smoothing=0.0)
    # both go round and round each other: parts with a hole each, but for the one in the middle
    assert sorted(len(p.interiors) for p in areas[0].geoms) == [0, 1, 1]
    assert sorted(len(p.interiors) for p in areas[1].geoms) == [1, 1, 1]
    check(rings % 2, areas)


def test_blocks_leave_no_trace(rng: np.random.Generator) -> None:
    values = cells(rng, 60, 5)
    raster = SparseRaster(width=3 * BLOCK, height=2 * BLOCK, dtype=np.int32, fill=-1)
    # about a corner of four blocks, of which two are cut off by the cells' rim
    col, row = 2 * BLOCK - 31, BLOCK - 22
    raster.write(Window(col=col, row=row, width=60, height=60), values, values >= 0)
    found = polygons_of(raster, grid_of(raster), [str(i) for i in range(5)])
    alone = areas_of(values)
    for name, area in found:
        moved = shapely.transform(area, lambda p: p - [col * PIXEL, -row * PIXEL])
        # m; rounding of coordinates of 4 million
        assert shapely.hausdorff_distance(moved, alone[int(name)]) < 1e-6
    assert len(found) == len(alone) == 5


def test_a_diagonal_corridor_costs_what_it_covers() -> None:
    n = 400 * BLOCK
    raster = SparseRaster(width=n, height=n, dtype=np.int32, fill=-1)
    for k in range(40):
        at = k * 10 * BLOCK
        square = Window(col=at, row=at, width=BLOCK, height=BLOCK)
        raster.write(square, np.full((BLOCK, BLOCK), k, np.int32))
    found = polygons_of(raster, grid_of(raster), [str(i) for i in range(40)])
    assert len(found) == 40
    # of each square an eighth of a pixel goes at every corner
    assert {round(a.area / PIXEL**2) for _, a in found} <= {BLOCK**2 - 1, BLOCK**2}


def test_no_label_gives_no_polygon() -> None:
    raster = SparseRaster(width=9, height=9, dtype=np.int32, fill=-1)
    assert polygons_of(raster, grid_of(raster), []) == []


def test_the_raster_of_the_fine_grid_agrees_with_geos(rng: np.random.Generator) -> None:
    areas = areas_of(cells(rng, 120, 8))
    # numbers that put no pixel's middle on a border, where GEOS finds no owner
    grid = Grid(
        crs_wkt="", left=LEFT - 0.0171, top=TOP + 0.0237, pixel=0.13717, width=350, height=350
    )
    window = Window(col=0, row=0, width=350, height=350)
    drawn = label_window(SeamIndex.of(list(areas.items())), grid, window)
    centres = np.stack(np.meshgrid(np.arange(350) + 0.5, np.arange(350) + 0.5), axis=-1)
    x, y = np.moveaxis(grid.map_from_grid(centres), -1, 0)
    for label, area in areas.items():
        np.testing.assert_array_equal(drawn == label, shapely.contains_xy(area, x, y))
