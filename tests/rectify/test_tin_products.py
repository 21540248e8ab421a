"""Footprints and orthos over ground from adjusted points, against a DEM of the same ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from rectify_cases import BENT, ORIGIN, camera_at, map_frame

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions, parallax
from georef_gis.model.mesh_step import choose_step
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import DemTerrain, Terrain, dem_terrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import TinTerrain
from georef_gis.orient.surface import fit_surface
from georef_gis.rasters.warp import ground_mesh, positions, warp_window
from georef_gis.rectify.footprints import footprint
from georef_gis.rectify.grids import plan_grid

UTM, FEET = "EPSG:32617", "EPSG:6601"
HALF = 160.0


def up(xy: Array) -> Array:
    """Hills of 6 m and 100 m length, m above the origin."""
    return np.asarray(3.0 * np.sin(xy[..., 0] / 16.0) * np.cos(xy[..., 1] / 21.0))


def points(height: float | None = None) -> GroundPoints:
    xy = np.random.default_rng(3).uniform(-HALF, HALF, (3000, 2))
    z = up(xy) if height is None else np.full(3000, height)
    return GroundPoints(
        p_enu=np.column_stack([xy, z]),
        covariance=np.tile(np.diag([1e-6, 1e-6, 1e-6]), (3000, 1, 1)),
        rays=np.full(3000, 4, np.int32),
        residual_px=np.full(3000, 0.3),
    )


@pytest.fixture(scope="module")
def tin() -> TinTerrain:
    terrain = fit_surface(points(), ORIGIN, np.zeros((0, 2))).terrain
    assert isinstance(terrain, TinTerrain)
    assert terrain.kind == "tin"
    return terrain


@pytest.fixture(scope="module")
def dem(tin: TinTerrain) -> DemTerrain:
    """The TIN's heights in cells of 0.5 m of the map."""
    frame = map_frame(UTM)
    left, top = (float(v) for v in frame.map_from_enu([-HALF, HALF, 0.0])[:2])
    k = (np.arange(640) + 0.5) * 0.5
    x, y = np.meshgrid(left + k, top - k)
    heights = tin.height_on_map(frame, np.stack([x, y], axis=-1))
    return dem_terrain(frame, heights, left=left, top=top, cell=(0.5, 0.5), metres_per_unit=1.0)


PHOTO = {"heading_deg": 133.0, "tilt_deg": 18.0, "camera": BENT}


def ground_of(terrain: Terrain, frame: MapFrame, grid: Grid) -> Ground:
    return Ground.of(frame, grid, terrain, (270.0, 290.0))


def through_mesh(photo: OrientedPhoto, ground: Ground, grid: Grid, window: Window) -> Array:
    step = choose_step(photo, ground, grid, window)
    mesh = ground_mesh(ground, grid, window, step)
    p_enu, delta = mesh.p_enu, mesh.delta
    moves = None if delta is None else parallax(photo, p_enu)
    return positions(photo.project(p_enu), step, (window.height, window.width), delta, moves)


@pytest.mark.parametrize("crs", [UTM, FEET])
def test_pixels_over_a_tin_are_the_rigorous_ones_and_those_over_the_dem(
    crs: str, tin: TinTerrain, dem: DemTerrain
) -> None:
    frame, photo = map_frame(crs), camera_at(5.0, -3.0, **PHOTO)
    one = footprint(photo, tin, frame)
    grid = plan_grid([one], frame, gsd=0.2)
    window = Window(col=grid.width // 3, row=grid.height // 3, width=200, height=160)
    col, row = np.meshgrid(np.arange(200) + window.col + 0.5, np.arange(160) + window.row + 0.5)
    xy = grid.map_from_grid(np.stack([col, row], axis=-1))
    h = tin.height_on_map(frame, xy)
    true = photo.project(frame.enu_from_map(np.concatenate([xy, h[..., None]], axis=-1)))
    inside = photo.contains(true)
    assert inside.sum() > 10_000
    uv = {t: through_mesh(photo, ground_of(t, frame, grid), grid, window) for t in (tin, dem)}
    assert np.abs(uv[tin] - true)[inside].max() < 0.1  # px
    assert np.abs(uv[tin] - uv[dem])[inside].max() < 0.1


def test_footprint_over_a_tin_is_that_over_the_dem(tin: TinTerrain, dem: DemTerrain) -> None:
    photo, frame = camera_at(5.0, -3.0, **PHOTO), map_frame()
    a, b = footprint(photo, tin, frame), footprint(photo, dem, frame)
    # m; a tenth of a pixel of 0.2 m
    assert np.abs(a.ring_map - b.ring_map).max() < 0.02
    assert a.gsd == pytest.approx(b.gsd, rel=2e-3)
    assert a.height_above_ground == pytest.approx(b.height_above_ground, abs=0.01)


def test_photo_that_sees_beyond_the_points_has_a_whole_footprint(tin: TinTerrain) -> None:
    photo, frame = camera_at(HALF - 10.0, 0.0), map_frame()
    found = footprint(photo, tin, frame)
    assert not found.clipped
    # 600 x 400 px of 1/500 at 100 m or 97 m
    assert shapely.Polygon(found.ring_enu[:, :2]).area == pytest.approx(120 * 80, rel=0.1)
    east = found.ring_enu[:, 0].max()
    assert east == pytest.approx(HALF - 10.0 + 60.0, abs=4.0)


def test_oblique_photo_is_clipped_not_refused(tin: TinTerrain) -> None:
    found = footprint(camera_at(tilt_deg=75.0), tin, map_frame())
    assert found.clipped
    assert np.all(np.isfinite(found.ring_enu))


def test_ortho_over_a_tin_has_no_holes_and_the_dem_s_pixels(
    tin: TinTerrain, dem: DemTerrain
) -> None:
    photo, frame = camera_at(5.0, -3.0, **PHOTO), map_frame(FEET)
    v, u = np.mgrid[:400, :600]
    image = (np.stack([u, v], axis=-1) * 40.0).astype(np.uint16)
    grid = plan_grid([footprint(photo, tin, frame)], frame, gsd=0.2)
    window = Window(col=0, row=0, width=grid.width, height=grid.height)
    tiles = []
    for terrain in (tin, dem):
        ground = ground_of(terrain, frame, grid)
        step = choose_step(photo, ground, grid, window)
        tile = warp_window(photo, image, ground, grid, window, step=step)
        assert tile is not None
        data, mask = tile
        assert mask is not None
        tiles.append((data.astype(float) / 40.0, mask))
    both = tiles[0][1] & tiles[1][1]
    assert both.sum() > 100_000
    assert np.count_nonzero(tiles[0][1] ^ tiles[1][1]) < 0.002 * both.sum()
    # px; OpenCV's 1/32 px in each
    assert np.abs(tiles[0][0] - tiles[1][0])[both].max() < 0.1 + 1 / 16


def test_a_plane_is_warped_like_flat_ground(tmp_path: Path) -> None:
    plane = fit_surface(points(0.0), ORIGIN, np.zeros((0, 2))).terrain
    assert isinstance(plane, TinTerrain)
    assert plane.kind == "plane"
    photo, frame = camera_at(5.0, -3.0, **PHOTO), map_frame()
    grid = plan_grid([footprint(photo, plane, frame)], frame, gsd=0.2)
    ground = ground_of(plane, frame, grid)
    window = Window(col=100, row=100, width=200, height=160)
    assert not ground.has_relief
    assert choose_step(photo, ground, grid, window) >= 8
    uv = through_mesh(photo, ground, grid, window)
    p = ground.enu_at(grid, node_positions(window, 1))[1:-1, 1:-1]
    assert np.abs(uv - photo.project(p)).max() < 0.1
