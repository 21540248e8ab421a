"""Volumes over a base: by hand, by their invariances, and with their sigma by draws."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.surface.base import GivenHeight, LowestLevel, OtherSurface, RimPlane
from georef_gis.measure.surface.common_errors import CommonErrors
from georef_gis.measure.surface.field import GroundField
from georef_gis.measure.surface.integral import cells_of, correlated_variance, ring_of
from georef_gis.measure.surface.points import PointField
from georef_gis.measure.surface.volume import Volume, volume
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.tie_points import GroundPoints

# 5 surfaces in the daily tests; 40 when asked
DRAWS = max(8, int(os.environ.get("GEOREF_FLIGHTS", "8")))
LOW, HIGH = (0.7, 1.4) if DRAWS >= 40 else (0.4, 2.0)
# m, one sigma of heights against their surroundings
LOCAL = 0.05
ORIGIN = Origin(lat=0.68, lon=-1.4, height_ellipsoidal=250.0)
Heights = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Formula:
    """A surface of a formula, known to `sigma`, m, with no correlation that is told."""

    heights: Heights
    sigma: float
    detail: float = 0.5

    def z_at(self, xy_enu: ArrayLike) -> Array:
        return self.heights(np.asarray(xy_enu, float))


def field(heights: Heights, *, shared: float = 0.0, length: float = 2.0) -> GroundField:
    terrain = Formula(heights=heights, sigma=math.hypot(LOCAL, shared))
    errors = GroundErrors(terrain=terrain, shared=shared, length=length)  # type: ignore[arg-type]
    common = CommonErrors.level(shared)
    return GroundField(terrain=terrain, errors=errors, name="formula", common=common)  # type: ignore[arg-type]


def circle(radius: float, x: float = 0.0, y: float = 0.0) -> shapely.Polygon:
    return shapely.Point(x, y).buffer(radius, quad_segs=64)


def cone(xy: Array, *, height: float = 5.0, radius: float = 10.0) -> Array:
    return np.asarray(height * np.maximum(1.0 - np.hypot(*np.moveaxis(xy, -1, 0)) / radius, 0.0))


def rim(surface: GroundField, area: shapely.Polygon) -> Volume:
    return volume(surface, area, lambda one: RimPlane.of(one, area))


# -- by hand -------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.08, -0.05)], ids=["level", "sloping"])
def test_cone_on_a_plane(slope: tuple[float, float]) -> None:
    """pi r^2 h / 3; the plane through the rim finds the slope."""
    found = rim(field(lambda xy: cone(xy) + xy @ np.array(slope) + 3.0), circle(13.0))
    assert found.above == pytest.approx(math.pi * 100 * 5 / 3, rel=2e-3)  # cells of 0.2 m
    assert found.below == pytest.approx(0.0, abs=0.2)
    assert found.area == pytest.approx(circle(13.0).area, rel=1e-9)
    assert found.highest == pytest.approx(5.0, abs=0.15)
    assert found.level_cancels


def test_trench_is_to_be_filled() -> None:
    """2 m wide, 1.5 m deep, 20 m long."""

    def trench(xy: Array) -> Array:
        inside = (np.abs(xy[..., 0]) < 1.0) & (np.abs(xy[..., 1]) < 10.0)
        return np.where(inside, -1.5, 0.0)

    found = rim(field(trench), shapely.box(-4, -14, 4, 14))
    # the rows of cells along its sides
    assert found.below == pytest.approx(60.0, rel=0.06)
    assert found.above == pytest.approx(0.0, abs=1e-6)
    assert found.net == pytest.approx(-found.below)


def test_against_a_level_that_is_given() -> None:
    area = shapely.box(0, 0, 20, 10)
    level = GivenHeight(origin=ORIGIN, height_ellipsoidal=251.0, sigma=0.02)
    found = volume(field(lambda xy: 3.0 + 0.0 * xy[..., 0], shared=0.1), area, lambda one: level)
    # the Earth bends by 0.03 mm
    assert found.net == pytest.approx(20 * 10 * 2.0, rel=1e-4)
    assert not found.level_cancels
    # 0.1 m and 0.02 m over 200 m2
    assert found.parts["block"] == pytest.approx(20.0, rel=1e-6)
    assert found.parts["base"] == pytest.approx(4.0, rel=1e-6)


def test_between_two_surfaces() -> None:
    area = shapely.box(0, 0, 20, 10)
    before = field(lambda xy: 1.0 + 0.0 * xy[..., 0], shared=0.3)
    after = field(lambda xy: np.where(xy[..., 0] < 10.0, 2.0, 0.5), shared=0.4)
    found = volume(after, area, lambda one: OtherSurface(field=before))
    assert (found.above, found.below) == (pytest.approx(100.0), pytest.approx(50.0))
    # each surface has a level of its own
    assert found.parts["block"] == pytest.approx(0.4 * 200, rel=1e-6)
    assert found.parts["base"] > 0.3 * 200


def test_lowest_stretch_of_the_rim() -> None:
    area = shapely.box(-10, -10, 10, 10)
    surface = field(lambda xy: 0.1 * xy[..., 0])
    found = volume(surface, area, lambda one: LowestLevel.of(one, area))
    assert found.net == pytest.approx(400 * 1.0, rel=1e-3)


# -- invariances ---------------------------------------------------------------------------------


def test_rim_does_not_mind_a_shift_or_a_tilt_of_all() -> None:
    plain = rim(field(cone), circle(13.0))
    moved = rim(field(lambda xy: cone(xy) + 40.0 + xy @ np.array([0.03, 0.07])), circle(13.0))
    assert moved.net == pytest.approx(plain.net, rel=1e-3)
    shared = rim(field(cone, shared=5.0), circle(13.0))
    assert shared.sigma_net == pytest.approx(plain.sigma_net)


def test_a_pile_on_the_rim_is_left_out_of_the_plane() -> None:
    """A machine stands over a tenth of the rim."""

    def with_machine(xy: Array) -> Array:
        at = np.hypot(xy[..., 0] - 13.0, xy[..., 1]) < 3.5
        return cone(xy) + np.where(at, 2.5, 0.0)

    found = rim(field(with_machine), circle(13.0))
    inside = circle(13.0).intersection(circle(3.5, 13.0)).area * 2.5
    assert found.net == pytest.approx(math.pi * 100 * 5 / 3 + inside, rel=0.01)


def test_area_beside_the_surface_is_refused() -> None:
    def half(xy: Array) -> Array:
        return np.where(xy[..., 0] < 0.0, 1.0, np.nan)

    with pytest.raises(GeometryError, match=r"formula: .* % of the area has no height"):
        volume(
            field(half), circle(5.0), lambda one: GivenHeight(origin=ORIGIN, height_ellipsoidal=0)
        )
    with pytest.raises(GeometryError, match="rim"):
        RimPlane.of(field(lambda xy: np.full(xy.shape[:-1], np.nan)), circle(5.0))


# -- sigma ---------------------------------------------------------------------------------------


def test_variance_of_a_sum_is_that_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(1)
    cells = cells_of(circle(9.0), detail=0.8)
    weights = rng.uniform(0.5, 1.5, len(cells.xy))
    for length in (0.7, 3.0, 20.0):
        apart = np.sum((cells.xy[:, None] - cells.xy) ** 2, axis=-1)
        dense = weights @ np.exp(-0.5 * apart / length**2) @ weights
        fast = correlated_variance(cells.xy, weights, length, cells.side)
        # a place may move by a sixteenth of the length
        assert fast == pytest.approx(dense, rel=0.01), length


def test_cells_add_to_the_area_and_the_ring_closes() -> None:
    area = shapely.Polygon([(0, 0), (30, 2), (22, 17), (3, 14)])
    cells = cells_of(area, detail=1.0)
    assert cells.area.sum() == pytest.approx(area.area)
    ring = ring_of(area, step=0.5)
    steps = np.hypot(*np.diff(np.vstack([ring, ring[:1]]), axis=0).T)
    # corners are cut
    assert steps.max() == pytest.approx(area.length / len(ring), rel=1e-6)
    with pytest.raises(GeometryError, match="too thin"):
        cells_of(shapely.box(0, 0, 100.0, 1e-4), detail=1.0)


@pytest.mark.slow
def test_sigma_of_a_law_is_that_of_draws() -> None:
    """Correlated errors drawn on a lattice: the sum's spread, against the base of the rim."""
    rng = np.random.default_rng(4)
    step, half, length = 0.5, 32.0, 2.0
    axis = np.arange(-half, half, step)
    lag = np.minimum(np.arange(len(axis)), len(axis) - np.arange(len(axis))) * step
    kernel = np.exp(-((lag[:, None] ** 2 + lag**2) / length**2))
    kernel /= math.sqrt(np.sum(kernel**2))
    spectrum = np.fft.rfft2(kernel)

    def drawn() -> Heights:
        white = rng.standard_normal((len(axis), len(axis)))
        noise = LOCAL * np.fft.irfft2(np.fft.rfft2(white) * spectrum, white.shape)

        def heights(xy: Array) -> Array:
            at = np.clip(np.round((xy + half) / step).astype(int), 0, len(axis) - 1)
            return cone(xy) + noise[at[..., 0], at[..., 1]]

        return heights

    area = circle(13.0)
    cells = cells_of(area, detail=0.5)
    nets = []
    for _ in range(200):
        surface = field(drawn())
        off = surface.z_at(cells.xy) - RimPlane.of(surface, area).z_at(cells.xy)
        nets.append(float(off @ cells.area))
    stated = rim(field(cone, length=length), area).parts["surface"]
    support = RimPlane.of(field(cone), area).support(cells, cells.area)
    weights = LOCAL * np.concatenate([cells.area, support.weights])
    places = np.vstack([cells.xy, support.xy])
    known = math.sqrt(correlated_variance(places, weights, length, cells.side))
    # 200 draws: 5 % of a standard deviation; the plane's weights follow the draws
    assert np.std(nets) == pytest.approx(known, rel=0.2)
    # where the length is not known, the worst is taken
    assert stated > known


# -- adjusted points -----------------------------------------------------------------------------


def points_over(
    heights: Heights, seed: int, *, spacing: float, noise: float, size: float = 70.0
) -> PointField:
    rng = np.random.default_rng(seed)
    n = int((size / spacing) ** 2)
    xy = rng.uniform(-size / 2, size / 2, (n, 2))
    shared = 0.3
    z = heights(xy) + noise * rng.standard_normal(n) + shared * rng.standard_normal()
    covariance = np.tile(np.diag([1e-4, 1e-4, noise**2 + shared**2]), (n, 1, 1))
    return PointField.of(
        GroundPoints(
            p_enu=np.column_stack([xy, z]), covariance=covariance, rays=np.full(n, 4, np.int32),
            residual_px=np.full(n, 0.3),
        )
    )  # fmt: skip


def waves(seed: int, size: float) -> Heights:
    rng = np.random.default_rng(1000 + seed)
    lengths, ways = rng.uniform(30, 150, 8), rng.uniform(0, 2 * np.pi, 8)
    w = 2 * np.pi / lengths[:, None] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    a, phase = size * lengths / 300 * rng.standard_normal(8), rng.uniform(0, 2 * np.pi, 8)
    tilt = rng.normal(0, 0.02, 2)
    return lambda xy: xy @ tilt + np.sin(xy @ w.T + phase) @ a


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "relief"), [(0.05, 0.0), (0.05, 0.5), (0.2, 0.5)],
    ids=["level ground", "uneven ground", "noisy points"],
)  # fmt: skip
def test_errors_of_volumes_agree_with_their_sigmas(noise: float, relief: float) -> None:
    area, ratios = circle(13.0), []
    for seed in range(DRAWS):
        ground = waves(seed, relief)
        surface = points_over(lambda xy, g=ground: g(xy) + cone(xy), seed, spacing=1.5, noise=noise)
        found = volume(surface, area, lambda one: RimPlane.of(one, area))
        ratios.append((found.net - math.pi * 100 * 5 / 3) / found.sigma_net)
    assert LOW < np.sqrt(np.mean(np.square(ratios))) < HIGH


def test_what_points_share_is_told_from_how_they_scatter() -> None:
    surface = points_over(waves(0, 0.3), 0, spacing=1.5, noise=0.05)
    # m; stated 0.304, of which the neighbours scatter 0.05
    assert surface.common.sigma == pytest.approx(0.3, abs=0.01)
    assert float(surface.sigma.mean()) == pytest.approx(0.05, rel=0.15)
    assert surface.spacing == pytest.approx(1.5, rel=0.2)


def test_sigma_of_a_surface_of_points_agrees_with_its_errors() -> None:
    ground = waves(1, 0.5)
    surface = points_over(ground, 1, spacing=2.0, noise=0.02)
    at = np.random.default_rng(8).uniform(-30, 30, (800, 2))
    off = surface.z_at(at) - ground(at)
    off -= np.nanmean(off)
    assert 0.7 < np.sqrt(np.nanmean((off / surface.local(at)) ** 2)) < 1.4


def test_wrong_matches_are_no_surface() -> None:
    clean = points_over(cone, 2, spacing=1.5, noise=0.03)
    rng = np.random.default_rng(3)
    bad = clean.p_enu.copy()
    spoilt = rng.random(len(bad)) < 0.02
    bad[spoilt, 2] += rng.choice([-6.0, 6.0], np.count_nonzero(spoilt))
    n = len(bad)
    dirty = PointField.of(
        GroundPoints(
            p_enu=bad, covariance=np.tile(0.03**2 * np.eye(3), (n, 1, 1)),
            rays=np.full(n, 3, np.int32), residual_px=np.full(n, 0.3),
        )
    )  # fmt: skip
    area = circle(13.0)
    nets = [
        volume(one, area, lambda surface: RimPlane.of(surface, area)).net for one in (clean, dirty)
    ]
    # m3 of 524; one blunder of 6 m that stays is 4 m3
    assert abs(nets[1] - nets[0]) < 6.0


def test_points_know_no_height_in_a_gap_nor_beyond_their_rim() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-30, 30, (2500, 2))
    xy = xy[(np.abs(xy) > 12.0).any(axis=1)]
    n = len(xy)
    surface = PointField.of(
        GroundPoints(
            p_enu=np.column_stack([xy, 0.1 * xy[:, 0]]),
            covariance=np.tile(1e-4 * np.eye(3), (n, 1, 1)), rays=np.full(n, 3, np.int32),
            residual_px=np.zeros(n),
        )
    )  # fmt: skip
    assert np.isnan(surface.z_at([[0.0, 0.0], [60.0, 0.0]])).all()
    assert surface.z_at([[20.0, 20.0]]) == pytest.approx([2.0], abs=1e-6)
    frame = MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon))
    place = frame.map_from_enu(np.array([[20.0, 20.0, 2.0]]))
    assert surface.on_map(frame, place[:, :2]).height == pytest.approx([252.0], abs=1e-3)


def test_too_few_points_are_refused() -> None:
    few = GroundPoints(
        p_enu=np.eye(3), covariance=np.tile(np.eye(3), (3, 1, 1)), rays=np.full(3, 3, np.int32),
        residual_px=np.zeros(3),
    )  # fmt: skip
    with pytest.raises(GeometryError, match="3 adjusted points make no surface"):
        PointField.of(few)
    surface = points_over(cone, 0, spacing=3.0, noise=0.03)
    with pytest.raises(GeometryError, match="adjusted points lie within 5 m"):
        surface.near(np.array([500.0, 0.0]), 5.0)
