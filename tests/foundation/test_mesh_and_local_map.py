"""The mesh through which photos are warped, against the rigorous projection of every pixel."""

from __future__ import annotations

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.geodesy import metres_per_unit
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import (
    LOCAL_MAP_TOLERANCE,
    Ground,
    LocalMap,
    node_positions,
    parallax,
)
from georef_gis.model.mesh_step import choose_step
from georef_gis.model.terrain import FlatTerrain, Terrain
from georef_gis.rasters.warp import ground_mesh, positions

FLAT = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6)


def make_grid(code: str, gsd: float, half: float = 40.0) -> Grid:
    f = cases.frame(code)
    pixel = gsd / metres_per_unit(f.horizontal)
    centre = f.map_from_enu(np.zeros(3))[:2]
    reach = half / metres_per_unit(f.horizontal)
    bounds = (*(centre - reach), *(centre + reach))
    return Grid.over(bounds, pixel=pixel, crs_wkt=f.horizontal.to_wkt())


def through_mesh(photo, ground: Ground, grid: Grid, window: Window, step: int) -> np.ndarray:
    """uv of every pixel centre of a window as a warp takes it."""
    mesh = ground_mesh(ground, grid, window, step)
    p_enu, delta = mesh.p_enu, mesh.delta
    moves = None if delta is None else parallax(photo, p_enu)
    return positions(photo.project(p_enu), step, (window.height, window.width), delta, moves)


def rigorous(photo, terrain: Terrain, code: str, grid: Grid, window: Window) -> np.ndarray:
    """uv of every pixel centre by PROJ, the ground's height and the full camera."""
    col, row = np.meshgrid(
        window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5
    )
    xy = grid.map_from_grid(np.stack([col, row], axis=-1))
    f = cases.frame(code)
    h = terrain.height_on_map(f, xy)
    return np.asarray(photo.project(f.enu_from_map(np.concatenate([xy, h[..., None]], axis=-1))))


@pytest.mark.parametrize("code", [cases.UTM, cases.FEET], ids=["utm", "state-plane-ft"])
@pytest.mark.parametrize("ground_kind", ["flat", "kinked"])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 20.0), (14.0, -18.0, 200.0)], ids=["nadir", "tilted"])
def test_mesh_is_the_rigorous_projection_to_a_tenth_of_a_pixel(
    code: str, ground_kind: str, tilt: tuple
) -> None:
    terrain = FLAT if ground_kind == "flat" else cases.kinked_dem(code)
    grid = make_grid(code, 0.1)
    ground = Ground.of(cases.frame(code), grid, terrain, (270.0, 300.0))
    photo = cases.oriented(tilt)
    window = Window(col=330, row=210, width=200, height=150)
    step = choose_step(photo, ground, grid, window)
    truth = rigorous(photo, terrain, code, grid, window)
    error = (through_mesh(photo, ground, grid, window, step) - truth)[photo.contains(truth)]
    assert len(error) > 5000
    assert np.abs(error).max() < 0.1  # px


def test_dem_in_another_crs_is_met_through_a_checked_polynomial() -> None:
    grid = make_grid(cases.FEET, 0.1)
    dem = cases.kinked_dem(cases.UTM)
    ground = Ground.of(cases.frame(cases.FEET), grid, dem, (270.0, 300.0))
    assert ground.to_dem is not None
    xy = grid.map_from_grid(np.random.default_rng(5).uniform(0, grid.width, (300, 2)))
    rigorous_heights = dem.height_on_map(cases.frame(cases.FEET), xy)
    assert np.nanmax(np.abs(ground.heights_at(xy) - rigorous_heights)) < 0.01  # m


def test_mesh_is_refined_where_parallax_alone_does_not_hold() -> None:
    grid = make_grid(cases.UTM, 0.1)
    window = Window(col=300, row=300, width=256, height=256)
    photo = cases.oriented()
    steps = {}
    for name, terrain in {"flat": FLAT, "kinked": cases.kinked_dem()}.items():
        ground = Ground.of(cases.frame(), grid, terrain, (270.0, 300.0))
        steps[name] = choose_step(photo, ground, grid, window)
    assert steps["flat"] >= 8 > steps["kinked"]


def test_nodes_ring_the_window_and_cell_centres_land_on_pixels() -> None:
    nodes = node_positions(Window(col=10, row=20, width=9, height=5), 4)
    assert nodes.shape == (2 + 2, 3 + 2, 2)
    assert np.array_equal(nodes[0, 0], [8.0, 18.0])
    assert np.array_equal(nodes[1, 1], [12.0, 22.0])


@pytest.mark.parametrize("code", [cases.UTM, cases.FEET, "EPSG:3857"])
def test_local_map_keeps_its_tolerance_over_a_site(code: str) -> None:
    f = cases.frame(code)
    unit = metres_per_unit(f.horizontal)
    c = f.map_from_enu(np.zeros(3))
    r = 600.0 / unit
    bounds = (c[0] - r, c[1] - r, c[0] + r, c[1] + r)
    local = LocalMap.fit(f, bounds, (250.0, 330.0))
    assert local.coefficients is not None
    rng = np.random.default_rng(3)
    p = np.column_stack([rng.uniform(c[:2] - r, c[:2] + r, (500, 2)), rng.uniform(250, 330, 500)])
    error = local.enu_from_map(p) - f.enu_from_map(p)
    assert np.abs(error).max() < 2 * LOCAL_MAP_TOLERANCE


def test_where_the_polynomial_does_not_hold_the_rigorous_way_is_taken() -> None:
    f = cases.frame("EPSG:3857")
    c = f.map_from_enu(np.zeros(3))
    bounds = (c[0] - 4e5, c[1] - 4e5, c[0] + 4e5, c[1] + 4e5)
    local = LocalMap.fit(f, bounds, (250.0, 330.0))
    assert local.coefficients is None
    p = np.array([c[0] + 3e5, c[1] - 2e5, 280.0])
    assert np.array_equal(local.enu_from_map(p), f.enu_from_map(p))


def test_a_site_without_coordinates_is_refused() -> None:
    with pytest.raises(GeometryError, match="no coordinates"):
        LocalMap.fit(cases.frame(cases.UTM), (1e12, 1e12, 2e12, 2e12), (0.0, 1.0))
