"""What a mesh leaves out of rough ground: bounded by slopes, found where the bound is too wide."""

from __future__ import annotations

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.geodesy import metres_per_unit
from georef_gis.model import mesh_step
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.model.mesh_step import choose_step
from georef_gis.model.terrain import DemTerrain, dem_terrain

WINDOW = Window(col=150, row=90, width=400, height=300)


def rough_dem(*, code: str = cases.UTM, seed: int = 0, hole: bool = False) -> DemTerrain:
    """Heights in cells of 1 m, each by itself; much rougher in one corner of the window."""
    like = cases.kinked_dem(code)
    rng = np.random.default_rng(seed)
    heights = 277.6 + 0.05 * rng.normal(size=like.heights.shape)
    heights[100:110, 100:110] += rng.normal(size=(10, 10))
    if hole:
        heights[120:124, 126:129] = np.nan
    return dem_terrain(
        like.frame, heights, left=like.left, top=like.top, cell=like.cell,
        metres_per_unit=metres_per_unit(like.frame.horizontal),
    )  # fmt: skip


def ground_and_grid(code: str, dem: DemTerrain, gsd: float = 0.1) -> tuple[Ground, Grid]:
    f = cases.frame(code)
    unit = metres_per_unit(f.horizontal)
    centre = f.map_from_enu(np.zeros(3))[:2]
    grid = Grid.over(
        (*(centre - 40.0 / unit), *(centre + 40.0 / unit)), pixel=gsd / unit,
        crs_wkt=f.horizontal.to_wkt(),
    )  # fmt: skip
    return Ground.of(f, grid, dem, (270.0, 290.0)), grid


def left_out_at_pixels(ground: Ground, grid: Grid, window: Window, step: int) -> Array:
    """Height of the ground over the mesh, m, at the centres of all pixels; (rows, cols)."""
    nodes = ground.heights_at(grid.map_from_grid(node_positions(window, step)))
    col, row = np.arange(window.width) + 0.5, np.arange(window.height) + 0.5
    t, s = np.arange(nodes.shape[1]) * step - step / 2, np.arange(nodes.shape[0]) * step - step / 2
    along = np.stack([np.interp(col, t, line) for line in nodes])
    mesh = np.stack([np.interp(row, s, line) for line in along.T], axis=1)
    places = np.stack(np.meshgrid(window.col + col, window.row + row), axis=-1)
    return np.asarray(ground.heights_at(grid.map_from_grid(places)) - mesh)


@pytest.mark.parametrize("code", [cases.UTM, cases.FEET], ids=["same-crs", "turned"])
@pytest.mark.parametrize("step", [2, 4, 8, 16, 64])
def test_the_bound_is_above_what_a_mesh_leaves_out_at_any_pixel(code: str, step: int) -> None:
    ground, grid = ground_and_grid(code, rough_dem())
    largest = np.abs(left_out_at_pixels(ground, grid, WINDOW, step)).max()
    bound = next(mesh_step._left_out(ground, grid, WINDOW, step))
    # and not so far above that it would say nothing
    assert largest < bound < 4.0 * largest


@pytest.mark.parametrize("hole", [False, True], ids=["whole", "with-a-hole"])
@pytest.mark.parametrize("step", [4, 16, 64])
def test_the_largest_height_is_that_of_all_blocks(step: int, hole: bool) -> None:
    ground, grid = ground_and_grid(cases.FEET, rough_dem(hole=hole))
    *_, found = mesh_step._left_out(ground, grid, WINDOW, step)
    blocks = mesh_step._blocks(WINDOW, step)
    assert found == max(mesh_step._sampled_relief(ground, grid, b, step) for b in blocks)
    assert found > 0.1


def test_cells_finer_than_a_pixel_are_looked_at_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    ground, grid = ground_and_grid(cases.UTM, rough_dem(), gsd=1.0)
    monkeypatch.setattr(mesh_step, "MANY_CELLS", 3)
    heights = list(mesh_step._left_out(ground, grid, Window(col=0, row=0, width=60, height=50), 16))
    assert len(heights) == 1
    assert np.isfinite(heights[0])


@pytest.mark.parametrize("up", [30.0, 120.0])
def test_the_step_is_that_of_looking_everywhere(up: float, monkeypatch: pytest.MonkeyPatch) -> None:
    ground, grid = ground_and_grid(cases.FEET, rough_dem())
    photo = cases.oriented((3.0, -2.0, 40.0), (0.0, 0.0, up))
    window = Window(col=100, row=100, width=600, height=600)
    found = choose_step(photo, ground, grid, window)

    def everywhere(ground: Ground, grid: Grid, window: Window, step: int) -> list[float]:
        blocks = mesh_step._blocks(window, step)
        return [max(mesh_step._sampled_relief(ground, grid, b, step) for b in blocks)]

    monkeypatch.setattr(mesh_step, "_left_out", everywhere)
    assert found == choose_step(photo, ground, grid, window)
    assert found < 16
