"""Overlap map, covered area and holes against shapely."""

import numpy as np
import pytest
import shapely
from rectify_cases import GROUND, camera_at, map_frame, square

from georef_gis.frames import Array
from georef_gis.model.grid import Grid
from georef_gis.rectify.coverage import covered_area, footprint_side, holes, overlap_map
from georef_gis.rectify.footprints import footprint

FRAME = map_frame()


def found_holes(footprints: list) -> list[Array]:  # type: ignore[type-arg]
    grid, counts = overlap_map(footprints, FRAME)
    return holes(grid, counts, footprint_cells=footprint_side(footprints, grid, FRAME))


def block(columns: int, rows: int, step: float = 60.0, side: float = 100.0) -> list:  # type: ignore[type-arg]
    return [
        square(FRAME, step * i, step * j, side, f"F{i}-{j}")
        for i in range(columns)
        for j in range(rows)
    ]


def test_counts_are_those_of_shapely(rng: np.random.Generator) -> None:
    photos = [
        camera_at(*rng.uniform(-60, 60, 2), heading_deg=rng.uniform(0, 360), tilt_deg=15.0)
        for _ in range(8)
    ]
    prints = [footprint(photo, GROUND, FRAME) for photo in photos]
    grid, counts = overlap_map(prints, FRAME)
    polygons = [shapely.Polygon(f.ring_map) for f in prints]
    cells = np.stack([rng.integers(0, grid.width, 4000), rng.integers(0, grid.height, 4000)], -1)
    points = shapely.points(grid.map_from_grid(cells + 0.5))
    expected = sum(shapely.contains(p, points).astype(int) for p in polygons)
    # A cell that a border crosses may go either way.
    clear = np.min([shapely.distance(p.exterior, points) for p in polygons], axis=0) > grid.pixel
    np.testing.assert_array_equal(counts[cells[clear, 1], cells[clear, 0]], expected[clear])
    assert clear.mean() > 0.9


def test_covered_area_is_that_of_the_union() -> None:
    prints = block(3, 2)
    grid, counts = overlap_map(prints, FRAME)
    union = shapely.union_all([shapely.Polygon(f.ring_map) for f in prints])
    # Half a cell at each rim.
    assert covered_area(grid, counts, FRAME) == pytest.approx(union.area, rel=0.01)
    assert counts.max() == 4


def test_area_in_feet_is_in_square_metres() -> None:
    frame = map_frame("EPSG:6601")
    prints = [square(frame, 0.0, 0.0, 100.0)]
    grid, counts = overlap_map(prints, frame)
    assert covered_area(grid, counts, frame) == pytest.approx(1e4, rel=0.01)


def test_full_block_has_no_hole() -> None:
    assert found_holes(block(4, 4)) == []


def test_enclosed_gap_is_a_hole_at_its_place() -> None:
    prints = [f for f in block(7, 7, step=60.0, side=100.0) if f.photo_id not in {
        f"F{i}-{j}" for i in (2, 3, 4) for j in (2, 3, 4)}]  # fmt: skip
    (ring,) = found_holes(prints)
    union = shapely.union_all([shapely.Polygon(f.ring_map) for f in prints])
    gap = shapely.Polygon(union.interiors[0])
    assert shapely.Polygon(ring).symmetric_difference(gap).area < 0.1 * gap.area


def test_gap_between_strips_open_at_its_ends_is_a_hole() -> None:
    strips = [square(FRAME, 60.0 * i, north, 100.0, f"F{i}-{north}")
              for i in range(8) for north in (0.0, 120.0)]  # fmt: skip
    (ring,) = found_holes(strips)
    gap = shapely.Polygon(ring)
    assert gap.area > 0.7 * 520.0 * 20.0
    x, y = FRAME.map_from_enu([260.0, 110.0, 0.0])[:2]
    assert gap.contains(shapely.Point(x, y))


def test_wide_valley_between_two_sites_is_no_hole() -> None:
    assert (
        found_holes([*block(3, 3), *(square(FRAME, 600.0, 60.0 * j, 100.0) for j in range(3))])
        == []
    )


def test_ragged_rim_is_no_hole(rng: np.random.Generator) -> None:
    strips = [
        square(FRAME, 60.0 * i + 35.0 * (j % 2), 60.0 * j + rng.uniform(-4, 4), 100.0)
        for i in range(6)
        for j in range(5)
    ]
    assert found_holes(strips) == []


def test_hole_does_not_depend_on_how_much_empty_map_is_around(rng: np.random.Generator) -> None:
    height, width, empty, side = 120, 160, 100, 40.0
    found = 0
    for _ in range(10):
        counts = np.zeros((height, width), np.uint16)
        for _ in range(12):
            row, col = rng.integers(0, height - 20), rng.integers(0, width - 20)
            counts[row : row + 40, col : col + 40] += 1
        tight = Grid.over((0.0, 0.0, width, height), pixel=1.0, crs_wkt="")
        wide = Grid.over((-empty, -empty, width + empty, height + empty), pixel=1.0, crs_wkt="")
        rings = holes(tight, counts, footprint_cells=side)
        around = holes(wide, np.pad(counts, empty), footprint_cells=side)
        assert len(rings) == len(around)
        for ring, other in zip(rings, around, strict=True):
            np.testing.assert_array_equal(ring, other)
        found += len(rings)
    assert found >= 3


@pytest.mark.parametrize("east", [0.0, 4000.0], ids=["here", "4 km on"])
def test_hole_does_not_depend_on_the_place(east: float) -> None:
    prints = [square(FRAME, east + 60.0 * i, 60.0 * j, 100.0) for i in range(7) for j in range(7)
              if not (2 <= i <= 4 and 2 <= j <= 4)]  # fmt: skip
    assert len(found_holes(prints)) == 1
