"""Where rays meet flat ground and a DEM, against PROJ's heights."""

from __future__ import annotations

import math

import geometry_cases as cases
import numpy as np
import pytest
from pyproj import Transformer

from georef_gis.errors import GeometryError
from georef_gis.geodesy import CRS, MapFrame
from georef_gis.model.terrain import DemTerrain, FlatTerrain, dem_terrain

FLAT = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6)


def projs_height(p_enu: np.ndarray) -> np.ndarray:
    """Ellipsoidal height, m, of enu points by PROJ alone."""
    lat, lon, h = math.degrees(cases.SITE.lat), math.degrees(cases.SITE.lon), 277.6
    pipeline = (
        "+proj=pipeline "
        f"+step +inv +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={h} "
        "+step +inv +proj=cart +ellps=WGS84"
    )
    return np.asarray(Transformer.from_pipeline(pipeline).transform(*p_enu.T)[2])


def test_straight_down_is_the_height() -> None:
    assert FLAT.intersect([0, 0, 60.0], [0, 0, -2.0]) == pytest.approx([0, 0, 0], abs=1e-6)


@pytest.mark.parametrize(("distance", "drop"), [(1e3, 0.078), (5e3, 1.96), (20e3, 31.4)])
@pytest.mark.parametrize("azimuth", [0.0, 77.0, 205.0])
def test_flat_ground_bends_with_the_earth(distance: float, drop: float, azimuth: float) -> None:
    a = math.radians(azimuth)
    xy = distance * np.array([math.sin(a), math.cos(a)])
    z = FLAT.z_at(xy)
    assert -z == pytest.approx(drop, rel=0.01, abs=1e-3)
    assert projs_height(np.array([[*xy, z]])) == pytest.approx([277.6], abs=1e-3)  # m


def test_slanting_rays_end_on_the_ground_at_5_and_20_km() -> None:
    origin = np.array([4900.0, 300.0, 120.0])
    d = np.array([[0.3, -0.2, -1.0], [1.0, 1.0, -0.5], [-0.2, 0.9, -0.3]])
    p = FLAT.intersect(origin, d)
    assert projs_height(p) == pytest.approx([277.6] * 3, abs=1e-3)  # m
    along = np.cross(p - origin, d)
    assert along == pytest.approx(np.zeros((3, 3)), abs=1e-6)
    far = FLAT.intersect([0, 20e3, 100.0], [0.1, 0.4, -1.0])
    assert projs_height(far[None]) == pytest.approx([277.6], abs=1e-3)


@pytest.mark.parametrize("d", [[0, 0, 1.0], [1, 0, 0.0], [1.0, 0, 0.2]])
def test_rays_to_the_sky_miss_flat_ground(d: list) -> None:
    assert np.all(np.isnan(FLAT.intersect([0, 0, 60.0], d)))


def test_a_centre_below_the_ground_is_refused() -> None:
    with pytest.raises(GeometryError, match=r"5\.0 m below"):
        FLAT.intersect([0, 0, -5.0], [0, 0, -1.0])
    with pytest.raises(GeometryError, match="below the ground"):
        cases.kinked_dem().intersect([0, 0, -30.0], [0, 0.1, -1.0])


def residual(dem: DemTerrain, p: np.ndarray) -> np.ndarray:
    """Height of points above the DEM at their map place, m."""
    on_map = dem.frame.map_from_enu(p)
    return np.asarray(on_map[:, 2] - dem.height_at_map(on_map[:, :2]))


@pytest.mark.parametrize("code", [cases.UTM, cases.FEET])
def test_hits_lie_on_the_dem_and_nothing_stands_before_them(code: str) -> None:
    dem = cases.kinked_dem(code)
    rng = np.random.default_rng(7)
    d = np.column_stack([rng.uniform(-1, 1, (200, 2)), np.full(200, -1.0)])
    origin = np.array([5.0, -8.0, 60.0])
    p = dem.intersect(origin, d)
    assert np.all(np.isfinite(p))
    assert np.abs(residual(dem, p)).max() < 1e-3  # m
    for share in np.linspace(0.3, 0.99, 30):
        before = origin + share * (p - origin)
        # m: a step of half a cell may cut a corner
        assert np.all(residual(dem, before) > -0.02)


def test_dem_in_geographic_degrees() -> None:
    base = CRS.from_epsg(4326)
    f = MapFrame(cases.SITE, base)
    cell = 1e-5  # deg, about 1 m
    lon, lat = math.degrees(cases.SITE.lon), math.degrees(cases.SITE.lat)
    k = np.arange(240) - 119.5
    heights = 277.6 + 0.05 * np.abs(k)[None, :] + 0.02 * k[:, None]
    dem = dem_terrain(
        f, heights, left=lon - 120 * cell, top=lat + 120 * cell, cell=(cell, cell),
        metres_per_unit=111e3,
    )  # fmt: skip
    p = dem.intersect([0, 0, 70.0], [[0.3, 0.2, -1.0], [-0.4, 0.5, -1.0], [0, 0, -1.0]])
    assert np.abs(residual(dem, p)).max() < 1e-3
    assert f.map_from_enu(p)[2, :2] == pytest.approx([lon, lat], abs=1e-9)


def test_bilinear_between_cell_centres_by_hand() -> None:
    f = cases.frame()
    dem = dem_terrain(
        f, np.array([[1.0, 3.0], [5.0, 11.0]]), left=100.0, top=200.0, cell=(2.0, 4.0),
        metres_per_unit=1.0,
    )  # fmt: skip
    at = dem.height_at_map
    assert at([101.0, 198.0]) == 1.0  # centre of the first cell
    assert at([102.0, 196.0]) == 5.0  # the middle: mean of four
    assert at([102.0, 198.0]) == 2.0
    assert at([100.0, 200.0]) == 1.0  # the rim is extended to the raster's edge
    assert np.isnan(at([99.9, 198.0]))
    assert np.isnan(at([101.0, 191.9]))


def test_rays_past_the_dem_miss() -> None:
    dem = cases.kinked_dem()
    d = np.array([[0, 0, -1.0], [3.0, 0, -1.0], [0, 0, 1.0]])
    p = dem.intersect([0, 0, 60.0], d)
    assert np.all(np.isfinite(p[0]))
    assert np.all(np.isnan(p[1:]))


def test_a_hole_in_the_dem_is_a_miss() -> None:
    dem = cases.kinked_dem()
    dem.heights[100:140, 100:140] = np.nan
    p = dem.intersect([0, 0, 60.0], [[0, 0, -1.0], [0.6, 0, -1.0]])
    assert np.all(np.isnan(p[0]))
    assert np.all(np.isfinite(p[1]))


def test_dem_without_a_height_is_refused() -> None:
    with pytest.raises(GeometryError, match="no height"):
        dem_terrain(
            cases.frame(), np.full((3, 3), np.nan), left=0, top=0, cell=(1, 1), metres_per_unit=1
        )


def test_a_ridge_hides_what_lies_behind() -> None:
    f = cases.frame()
    e0, n0 = f.map_from_enu(np.zeros(3))[:2]
    heights = np.full((100, 200), 277.6)
    heights[:, 120:124] = 297.6  # a wall 20 m high, 20 m east
    dem = dem_terrain(f, heights, left=e0 - 100, top=n0 + 50, cell=(1.0, 1.0), metres_per_unit=1.0)
    p = dem.intersect([0, 0, 30.0], [1.0, 0, -0.9])
    # Without the wall the ray would reach the ground 33 m away.
    assert 19.0 < p[0] < 20.5


def test_height_on_another_map_is_the_same_ground() -> None:
    dem, feet = cases.kinked_dem(), cases.frame(cases.FEET)
    p_enu = np.array([[3.2, 40.1, 0.0], [-50.3, 7.7, 0.0]])
    ours = dem.height_on_map(feet, feet.map_from_enu(p_enu)[:, :2])
    assert ours == pytest.approx(dem.height_at_map(dem.frame.map_from_enu(p_enu)[:, :2]), abs=1e-3)
    assert np.all(FLAT.height_on_map(feet, np.zeros((4, 2))) == 277.6)
