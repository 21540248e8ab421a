"""Ground from adjusted points as a grid: where rays meet it, against triangles and PROJ."""

from __future__ import annotations

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.model.terrain import dem_terrain
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain

FRAME = EnuPlane(origin=cases.SITE, level=280.0)
# m; the Earth bends by this over the 100 m that a plane of enu is compared over
BEND = 100.0**2 / 2 / 6.37e6


def surface(heights, *, half: float = 100.0, cell: float = 1.0, sigmas=None, **given) -> TinTerrain:
    """Heights, m, as a function of x and y over a square about the origin."""
    n = int(2 * half / cell)
    k = (np.arange(n) + 0.5) * cell - half
    x, y = np.meshgrid(k, -k)
    known = {"kind": "tin", "sigma": 0.1, "sigma_shared": 0.0, **given}
    return tin_terrain(
        FRAME, SquareCells(left=-half, top=half, cell=cell),
        np.broadcast_to(heights(x, y), x.shape),
        np.full((4, 4), 0.1) if sigmas is None else sigmas, **known,
    )  # fmt: skip


def roof(x, y):
    """Ridge along y = 20 m, 12 m high, sides of 40 %; level 280 m."""
    return 292.0 - 0.4 * np.abs(y - 20.0)


def projs_height(p_enu: np.ndarray) -> np.ndarray:
    return np.asarray(cases.frame().map_from_enu(p_enu)[..., 2])


def test_plane_of_the_project_is_a_map_with_heights() -> None:
    rng = np.random.default_rng(3)
    p = np.column_stack([rng.uniform(-5e3, 5e3, (50, 2)), rng.uniform(-50, 200, 50)])
    on_plane = FRAME.map_from_enu(p)
    assert FRAME.enu_from_map(on_plane) == pytest.approx(p, abs=2e-4)  # m
    assert on_plane[:, 2] == pytest.approx(projs_height(p), abs=1e-4)  # m
    geo = cases.SITE.geo_from_enu(p)
    higher = FRAME.map_from_geo(geo + np.array([0, 0, 300.0]))
    assert higher[:, :2] == pytest.approx(on_plane[:, :2], abs=1e-9)
    # at its own level it is enu itself
    level = cases.SITE.enu_from_geo(np.column_stack([geo[:, :2], np.full(50, 280.0)]))
    assert on_plane[:, :2] == pytest.approx(level[:, :2], abs=1e-9)


def test_hits_on_a_slanting_plane_have_its_height() -> None:
    plane = surface(lambda x, y: 280.0 + 0.08 * x - 0.05 * y, cell=25.0, kind="plane")
    rng = np.random.default_rng(5)
    d = np.column_stack([rng.uniform(-0.6, 0.6, (100, 2)), np.full(100, -1.0)])
    p = plane.intersect([4.0, -7.0, 90.0], d)
    expected = 280.0 + 0.08 * p[:, 0] - 0.05 * p[:, 1]
    assert projs_height(p) == pytest.approx(expected, abs=1e-3)  # m
    assert plane.z_at(p[:, :2]) == pytest.approx(p[:, 2], abs=1e-3)
    assert plane.detail == np.inf


def triangles_hit(origin: np.ndarray, d: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Nearest hit of one ray with triangles (n, 3, 3), m (Moeller & Trumbore 1997)."""
    best = np.inf
    for a, b, c in facets:
        across = np.cross(d, c - a)
        det = (b - a) @ across
        if abs(det) < 1e-12:
            continue
        s = origin - a
        u, q = s @ across / det, np.cross(s, b - a)
        v, t = d @ q / det, (c - a) @ q / det
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < t < best:
            best = t
    return np.asarray(origin + best * d) if np.isfinite(best) else np.full(3, np.nan)


def test_hits_on_a_ridge_are_those_of_its_triangles() -> None:
    ridge = surface(roof, cell=1.0)

    def at(x: float, y: float) -> list[float]:
        return [x, y, float(roof(x, y)) - cases.SITE.height_ellipsoidal]

    south = [at(-99, -80), at(99, -80), at(99, 20), at(-99, 20)]
    north = [at(-99, 20), at(99, 20), at(99, 99), at(-99, 99)]
    facets = np.array([[q[0], q[i], q[i + 1]] for q in (south, north) for i in (1, 2)])
    rng = np.random.default_rng(7)
    origin = np.array([3.0, -30.0, 45.0])
    d = np.column_stack([rng.uniform(-0.8, 0.8, (60, 2)), np.full(60, -1.0)])
    # over the ridge and onto its far side, which falls by 40 %
    d[:10] = [0.02, 1.0, -0.60]
    d[:10, 2] += np.arange(10) * 0.01
    expected = np.array([triangles_hit(origin, ray, facets) for ray in d])
    found = ridge.intersect(origin, d)
    assert np.count_nonzero(expected[:, 1] > 20.0) >= 5
    # a cell at the ridge is cut by 0.1 m; beside it the Earth's bend is left, times the slant
    beside = np.abs(expected[:, 1] - 20.0) > 1.0
    assert np.abs(found - expected)[beside].max() < 5 * BEND


def test_a_wall_of_one_cell_is_not_stepped_over() -> None:
    wall = surface(lambda x, y: 280.0 + 15.0 * (np.abs(x - 20.5) < 0.4))
    p = wall.intersect([0.0, 0.0, 30.0], [1.0, 0.0, -0.9])
    assert 19.5 < p[0] < 20.6


def test_it_has_a_height_everywhere() -> None:
    ground = surface(lambda x, y: 280.0 + 0.1 * x)
    z = ground.z_at([[500.0, 0.0], [-3000.0, 4000.0], [100.0, 100.0]])
    assert np.all(np.isfinite(z))
    assert projs_height(np.array([500.0, 0.0, z[0]])) == pytest.approx(289.95, abs=1e-3)
    p = ground.intersect([0, 0, 60.0], [[5.0, 0, -1.0], [0, -20.0, -1.0]])
    assert np.all(np.isfinite(p))
    assert np.isnan(ground.z_at([np.nan, 0.0]))


def test_rays_to_the_sky_miss_and_a_centre_below_is_refused() -> None:
    ground = surface(roof)
    assert np.all(np.isnan(ground.intersect([0, 0, 60.0], [[0, 0, 1.0], [1.0, 0, 0.0]])))
    with pytest.raises(GeometryError, match="below the ground"):
        ground.intersect([0, 20.0, 10.0], [0, 0, -1.0])


@pytest.mark.parametrize("code", [cases.UTM, cases.FEET])
def test_it_agrees_with_a_dem_of_the_same_ground(code: str) -> None:
    dem = cases.kinked_dem(code)
    frame = cases.frame(code)

    def on_dem(x, y):
        p = FRAME.enu_from_map(np.stack([x, y, np.full_like(x, 280.0)], axis=-1))
        return dem.height_at_map(dem.frame.map_from_enu(p)[..., :2])

    tin = surface(on_dem, half=80.0, cell=0.25)
    xy = np.random.default_rng(11).uniform(-75, 75, (2000, 2))
    off = np.abs(tin.z_at(xy) - dem.z_at(xy))
    # m: kinks cut within a quarter of a metre, banks of 2 m per cell
    assert np.quantile(off, 0.9) < 0.02
    assert off.max() < 0.5
    p = frame.map_from_enu(np.column_stack([xy, tin.z_at(xy)]))
    assert tin.height_on_map(frame, p[:, :2]) == pytest.approx(p[:, 2], abs=1e-3)


def test_sigma_is_read_where_it_stands_and_holds_the_shared_one() -> None:
    sigmas = np.array([[1.0, 3.0], [1.0, 3.0]])
    ground = surface(
        lambda x, y: 280.0 + 0 * x, sigmas=sigmas, sigma=np.hypot(2.0, 4.0), sigma_shared=4.0
    )
    # centres of the coarse cells lie at -50 and 50 m
    found = ground.sigma_at([[-50.0, 0.0], [0.0, 0.0], [50.0, 10.0], [900.0, 0.0]])
    assert found == pytest.approx(np.hypot([1.0, 2.0, 3.0, 3.0], 4.0), rel=1e-6)
    beside = ground.beside_photos()
    assert beside.sigma == pytest.approx(2.0)
    assert beside.sigma_at([0.0, 0.0]) == pytest.approx(2.0)


def test_heights_with_a_hole_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        surface(lambda x, y: np.where(x > 0, np.nan, 280.0))


def test_long_rays_take_few_looks() -> None:
    """A ray marched in steps of half a cell would look 2000 times."""
    looks = []

    class Counting(EnuPlane):
        def map_from_geo(self, p_geo):
            looks.append(1)
            return EnuPlane.map_from_geo(self, p_geo)

    base = surface(lambda x, y: 280.0 + 0.5 * np.sin(x / 10.0))
    frame = Counting(origin=cases.SITE, level=280.0)
    ground = tin_terrain(
        frame, SquareCells(left=-100.0, top=100.0, cell=1.0), base.heights, base.sigmas,
        kind="tin", sigma=0.1, sigma_shared=0.0,
    )  # fmt: skip
    p = ground.intersect([0.0, 0.0, 60.0], [1.0, 0.0, -0.06])
    assert projs_height(p) == pytest.approx(ground.height_on_map(
        cases.frame(), cases.frame().map_from_enu(p)[:2]), abs=1e-3)  # fmt: skip
    assert p[0] > 900.0
    assert len(looks) < 600


def test_dem_lies_on_its_own_map_and_a_tin_on_none() -> None:
    dem = dem_terrain(
        cases.frame(), np.ones((2, 2)), left=0, top=0, cell=(1, 1), metres_per_unit=1.0
    )
    assert dem.lies_on(cases.frame())
    assert not dem.lies_on(cases.frame(cases.FEET))
    assert not surface(roof).lies_on(cases.frame())
