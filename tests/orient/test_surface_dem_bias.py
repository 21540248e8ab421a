"""The bias of a user's DEM against adjusted points: found, honest, taken off, told."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from surface_cases import ORIGIN, hills, places, points_of

from georef_gis.geodesy import MapFrame, metres_per_unit, parse_crs
from georef_gis.model.terrain import DemTerrain, dem_terrain
from georef_gis.model.tin import EnuPlane
from georef_gis.orient.dem_bias import DemBias, estimate_bias, unbiased
from georef_gis.orient.surface import fit_surface
from georef_gis.orient.surface_points import Cloud, cloud_of

UTM, FEET = "EPSG:32617", "EPSG:6601"
NOWHERE = np.zeros((0, 2))
RELIEF = hills(np.random.default_rng(0), 3.0, 60.0)


def dem_of(error, code: str = UTM, cell_m: float = 4.0, half: int = 60) -> DemTerrain:
    """The true ground plus an error (east, north) m -> m, in cells of a map."""
    frame = MapFrame(ORIGIN, parse_crs(code))
    unit = metres_per_unit(frame.horizontal)
    cell = cell_m / unit
    centre = frame.map_from_enu(np.zeros(3))[:2]
    left, top = centre[0] - half * cell, centre[1] + half * cell
    k = (np.arange(2 * half) + 0.5) * cell
    x, y = np.meshgrid(left + k, top - k)
    p = frame.enu_from_map(np.stack([x, y, np.full_like(x, 277.6)], axis=-1))[..., :2]
    up = RELIEF(p) + (error(p) if callable(error) else error)
    heights = frame.map_from_enu(np.concatenate([p, up[..., None]], axis=-1))[..., 2]
    return dem_terrain(
        frame, heights, left=left, top=top, cell=(cell, cell), metres_per_unit=unit, sigma=1.0
    )


def points(seed: int = 1, n: int = 500, noise: float = 0.05):
    rng = np.random.default_rng(seed)
    xy = places(rng, n, 180.0)
    return points_of(xy, RELIEF(xy) + noise * rng.normal(size=n), noise), rng


def bias_of(dem: DemTerrain, given, **kw) -> DemBias:
    frame = EnuPlane(origin=ORIGIN, level=277.6)
    found = estimate_bias(cloud_of(given, frame), frame, dem, **kw)
    assert found is not None
    return found


@pytest.mark.parametrize("code", [UTM, FEET])
def test_a_dem_that_lies_too_high_is_lowered_onto_the_points(code: str) -> None:
    given, _ = points()
    dem = dem_of(1.3, code)
    found = fit_surface(given, ORIGIN, NOWHERE, dem=dem)
    bias = found.report.bias
    assert bias is not None
    assert bias.offset == pytest.approx(1.3, abs=0.02)  # m
    assert "the DEM lies 1.30 m above the points" in found.report.notes[-1]
    assert found.report.kind == "dem"
    xy = given.p_enu[:, :2]
    # m; cells of 4 m cut the waves
    assert found.terrain.z_at(xy) == pytest.approx(RELIEF(xy), abs=0.3)
    moved = dem.heights - found.terrain.heights
    assert np.ptp(moved) < 1e-9  # its relief is kept
    assert found.terrain.sigma < 0.2 < dem.sigma


def test_a_tilted_dem_is_levelled() -> None:
    given, _ = points(2)
    dem = dem_of(lambda p: 0.4 + 0.01 * p[..., 0] - 0.004 * p[..., 1], FEET)
    bias = bias_of(dem, given)
    assert (bias.slope_east, bias.slope_north) == pytest.approx((0.01, -0.004), abs=5e-4)
    level = unbiased(dem, bias)
    corners = 150.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert level.z_at(corners) == pytest.approx(RELIEF(corners), abs=0.3)
    assert "tilted by 1.0" in bias.told


def test_a_good_dem_is_left_as_it_is() -> None:
    given, rng = points(3, noise=0.3)
    rough = gaussian_filter(rng.normal(size=(120, 120)), 4.0)
    dem = dem_of(0.0)
    dem.heights[:] += 0.5 * rough / rough.std()
    found = fit_surface(given, ORIGIN, NOWHERE, dem=dem)
    assert found.report.bias is not None
    assert not found.report.bias.used
    assert np.array_equal(found.terrain.heights, dem.heights)
    assert "not significant" in found.report.notes[-1]


def test_trees_do_not_lift_the_dem() -> None:
    given, rng = points(4, n=1000)
    trees = rng.uniform(size=1000) < 0.2
    given.p_enu[trees, 2] += rng.uniform(5, 15, int(trees.sum()))
    bias = bias_of(dem_of(1.0), given)
    assert bias.offset == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [0.01, 3.0, 8.0], ids=["independent", "12 m", "32 m"])
def test_sigma_of_the_offset_holds_for_errors_that_neighbours_share(cells: float) -> None:
    errors = []
    base = dem_of(0.8)
    for seed in range(60):
        given, rng = points(seed, n=300)
        wave = gaussian_filter(rng.normal(size=(120, 120)), cells, mode="wrap")
        bias = bias_of(replace(base, heights=base.heights + 0.6 * wave / wave.std()), given)
        errors.append((bias.offset - 0.8) / bias.sigma_offset)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_what_points_share_does_not_keep_the_dem_from_the_photos() -> None:
    given, _ = points(5)
    bias = bias_of(dem_of(1.3), given, shared=2.0)
    assert bias.used
    assert bias.sigma > 2.0
    assert bias.sigma_offset < 0.2


def test_without_points_on_it_the_dem_is_used_as_it_is() -> None:
    given, _ = points(6, n=4)
    dem = dem_of(1.3)
    found = fit_surface(given, ORIGIN, NOWHERE, dem=dem)
    assert found.terrain is dem
    assert "its bias is not known" in found.report.notes[-1]
    dem = dem_of(0.0, half=2)
    frame = EnuPlane(origin=ORIGIN, level=277.6)
    far = Cloud(np.full((50, 2), 150.0), np.full(50, 280.0), np.full(50, 0.1))
    assert estimate_bias(far, frame, dem) is None


def test_bias_goes_through_json() -> None:
    given, _ = points(7)
    bias = bias_of(dem_of(-0.7), given)
    assert DemBias.from_json(json.loads(json.dumps(bias.as_json()))) == bias
    assert "below the points" in bias.told
