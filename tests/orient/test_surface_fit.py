"""Ground from adjusted points: planes and TINs that are known, blunders, honest sigmas."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from surface_cases import ORIGIN, bend, hills, places, points_of, sample

from georef_gis.errors import GeometryError, InputError
from georef_gis.orient.surface import fit_surface
from georef_gis.project.surface_file import load_surface, save_surface

# m; corners of what the products cover
AREA = 210.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
NOWHERE = np.zeros((0, 2))


def nees(values: list[np.ndarray]) -> float:
    """Root mean square of errors in sigmas over flights."""
    return float(np.sqrt(np.mean([np.mean(v**2) for v in values])))


def slanting(xy: np.ndarray) -> np.ndarray:
    return np.asarray(3.0 + 0.06 * xy[:, 0] - 0.02 * xy[:, 1] - bend(xy))


def test_points_of_a_plane_give_the_plane() -> None:
    xy = places(np.random.default_rng(1), 200)
    found = fit_surface(points_of(xy, slanting(xy), 0.01), ORIGIN, AREA)
    assert found.report.kind == "plane"
    assert found.report.blunders == 0
    assert found.terrain.z_at(AREA) == pytest.approx(slanting(AREA), abs=0.02)  # m; slope prior
    assert found.terrain.z_at(xy) == pytest.approx(slanting(xy), abs=0.01)


def test_between_the_points_lie_their_triangles() -> None:
    rng = np.random.default_rng(2)
    up = hills(rng, 4.0, 15.0)
    xy = places(rng, 1500)
    found = fit_surface(points_of(xy, up(xy), 0.001), ORIGIN, AREA)
    assert (found.report.kind, found.report.smoothed_over) == ("tin", 0)
    # nodes of the grid, where it is exact
    ground = found.terrain
    rows, cols = np.indices(ground.heights.shape)
    x = ground.left + (cols + 0.5) * ground.cell[0]
    y = ground.top - (rows + 0.5) * ground.cell[1]
    on_plane = ground.frame.map_from_enu(np.column_stack([xy, up(xy)]))
    kept = found.report.used
    assert kept > 0.98 * len(xy)
    oracle = LinearNDInterpolator(on_plane[:, :2], on_plane[:, 2])
    inner = np.hypot(x, y) < 110.0
    off = np.abs(ground.heights - oracle(x, y))[inner]
    # where a point was left out the triangles differ: hardly anywhere
    assert np.mean(off < 1e-6) > 0.97


def test_a_ridge_stays_sharp() -> None:
    xy = places(np.random.default_rng(3), 2000)

    def roof(p):
        return 10.0 - 0.5 * np.abs(p[:, 0]) - bend(p)

    found = fit_surface(points_of(xy, roof(xy), 0.02), ORIGIN, NOWHERE)
    line = np.column_stack([np.zeros(60), np.linspace(-140, 140, 60)])
    sides = np.column_stack([np.full(60, 40.0), np.linspace(-140, 140, 60)])
    # what the triangles across it cut off is the points' doing, 6.7 m apart
    oracle = LinearNDInterpolator(xy, roof(xy))
    cut, least = 10.0 - found.terrain.z_at(line), 10.0 - oracle(line)
    assert np.mean(cut) == pytest.approx(np.mean(least), rel=0.05)
    assert found.terrain.z_at(sides) == pytest.approx(roof(sides), abs=0.05)


# -- blunders --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_planted_blunders_are_found_and_no_others(seed: int) -> None:
    case = sample(seed, n=800, blunders=0.05)
    found = fit_surface(case.points, ORIGIN, AREA)
    planted = int(case.bad.sum())
    assert planted > 25
    assert planted <= found.report.blunders <= planted + 0.01 * 800
    error, _ = case.errors(found.terrain, places(case.rng, 1000, 140.0))
    assert np.abs(error).max() < 2.0  # m; one blunder left would stand out by 20
    assert f"{found.report.blunders} of 800 points" in found.report.notes[0]


def test_a_vehicle_and_a_treetop_are_left_out() -> None:
    rng = np.random.default_rng(4)
    xy = places(rng, 1500)
    car = np.array([[20.0, 30.0], [21.5, 30.4], [20.6, 31.2], [22.0, 31.3]])
    tree = np.array([[-60.0, 10.0]])
    up = np.concatenate([slanting(xy) + 0.05 * rng.normal(size=1500), slanting(car) + 2.5,
                         slanting(tree) + 9.0])  # fmt: skip
    found = fit_surface(points_of(np.concatenate([xy, car, tree]), up, 0.05), ORIGIN, AREA)
    for place in (car, tree):
        assert found.terrain.z_at(place) == pytest.approx(slanting(place), abs=0.1)


def test_a_bank_that_many_points_show_stays() -> None:
    rng = np.random.default_rng(5)
    xy = places(rng, 3000)

    def bank(p):
        return 4.0 * (p[:, 0] > 0) - bend(p)

    up = bank(xy) + 0.03 * rng.normal(size=3000)
    found = fit_surface(points_of(xy, up, 0.03), ORIGIN, AREA)
    assert found.report.kind == "tin"
    assert found.report.blunders < 0.03 * 3000
    beside = places(rng, 1000, 140.0)
    beside = beside[np.abs(beside[:, 0]) > 12.0]
    assert found.terrain.z_at(beside) == pytest.approx(bank(beside), abs=0.15)


# -- few, odd and broken points --------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 11])
def test_few_points_give_a_plane_that_they_lie_on(n: int) -> None:
    xy = places(np.random.default_rng(n), n, 60.0)
    found = fit_surface(points_of(xy, slanting(xy), 0.05), ORIGIN, AREA)
    assert found.report.kind == "plane"
    assert found.report.rms_held_out != found.report.rms_held_out  # NaN: nothing was held out
    assert any(f"{n} points do not carry a TIN" in note for note in found.report.notes)
    off = found.terrain.z_at(AREA) - slanting(AREA)
    assert np.all(np.abs(off) < 4.0 * found.terrain.sigma_at(AREA))
    assert found.terrain.z_at(xy) == pytest.approx(slanting(xy), abs=1.0)


def test_one_point_gives_level_ground() -> None:
    found = fit_surface(points_of(np.array([[10.0, 20.0]]), np.array([5.0]), 0.1), ORIGIN, AREA)
    level = found.terrain.z_at(AREA) + bend(AREA)
    assert level == pytest.approx([5.0] * 4, abs=0.01)
    # 5 % of slope over 200 to 300 m
    assert np.all(found.terrain.sigma_at(AREA) > 10.0)


def test_points_on_a_line_tilt_along_it_only() -> None:
    rng = np.random.default_rng(6)
    x = rng.uniform(-150, 150, 60)
    xy = np.column_stack([x, 1e-3 * rng.normal(size=60)])
    up = 0.06 * x + 0.05 * rng.normal(size=60) - bend(xy)
    found = fit_surface(points_of(xy, up, 0.05), ORIGIN, AREA)
    assert found.report.kind == "plane"
    z = found.terrain.z_at([[100.0, 0], [-100.0, 0], [0, 100.0], [0, -100.0]])
    assert (z[0] - z[1]) / 200.0 == pytest.approx(0.06, abs=0.005)
    # noise of 5 cm over 1 mm of width would tilt it by hundreds of percent
    assert abs(z[2] - z[3]) / 200.0 < 0.01


def test_a_blunder_among_few_points_does_not_tilt_them() -> None:
    xy = places(np.random.default_rng(8), 11)
    up = slanting(xy)
    up[4] += 20.0
    found = fit_surface(points_of(xy, up, 0.05), ORIGIN, AREA)
    assert found.report.blunders == 1
    assert found.terrain.z_at(xy) == pytest.approx(slanting(xy), abs=0.3)


def test_points_given_twice_change_nothing() -> None:
    case = sample(9, n=300)
    p = case.points
    twice = np.repeat(np.arange(300), 2)
    double = replace(
        p, p_enu=p.p_enu[twice], covariance=p.covariance[twice], rays=p.rays[twice],
        residual_px=p.residual_px[twice],
    )  # fmt: skip
    one, two = (fit_surface(points, ORIGIN, AREA) for points in (p, double))
    xy = places(case.rng, 200)
    assert two.terrain.z_at(xy) == pytest.approx(one.terrain.z_at(xy), abs=1e-9)
    assert (two.report.points, two.report.used) == (600, one.report.used)


def test_points_without_a_covariance_are_left_out() -> None:
    case = sample(10, n=300)
    p = case.points
    p.covariance[:40] = np.nan
    p.covariance[40, 2, 2] = -1.0
    p.p_enu[41] = np.inf
    p.p_enu[:40, 2] += 30.0
    found = fit_surface(p, ORIGIN, AREA)
    assert found.report.used + found.report.blunders == 258
    error, _ = case.errors(found.terrain, places(case.rng, 300, 120.0))
    assert np.abs(error).max() < 3.0


@pytest.mark.parametrize("n", [0, 4])
def test_no_usable_point_is_refused(n: int) -> None:
    xy = np.zeros((n, 2))
    points = points_of(xy, np.zeros(n), np.nan)
    with pytest.raises(GeometryError, match=f"none of {n} adjusted points"):
        fit_surface(points, ORIGIN, AREA)
    points.p_enu[:] = np.nan
    with pytest.raises(GeometryError, match="direct result stays"):
        fit_surface(points, ORIGIN, AREA)


# -- how far to trust it ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "given",
    [{"blunders": 0.05}, {"noise": 1.0}, {"relief": 3.0, "length": 8.0, "noise": 0.05},
     {"n": 60}, {"n": 8, "relief": 1.0}],
    ids=["blunders", "noisy", "rough", "sixty", "eight"],
)  # fmt: skip
def test_errors_are_what_their_sigmas_say(given: dict) -> None:
    inside, beyond = [], []
    for seed in range(40):
        case = sample(seed, **{"n": 200, **given})
        ground = fit_surface(case.points, ORIGIN, AREA).terrain
        inside.append(case.errors(ground, places(case.rng, 300, 145.0))[1])
        ring = places(case.rng, 600, 200.0)
        beyond.append(case.errors(ground, ring[np.abs(ring).max(axis=1) > 155.0])[1])
    assert 0.7 < nees(inside) < 1.4
    assert 0.4 < nees(beyond) < 1.6  # extrapolated: the ground there is anybody's guess


def test_weak_points_are_smoothed() -> None:
    case = sample(11, n=600, relief=1.5, noise=1.0)
    found = fit_surface(case.points, ORIGIN, AREA)
    error, _ = case.errors(found.terrain, places(case.rng, 1000, 140.0))
    assert found.report.smoothed_over >= 16
    assert np.sqrt(np.mean(error**2)) < 0.5  # m; points have 1 m
    assert found.report.rms_held_out == pytest.approx(1.1, abs=0.2)


def test_what_all_points_share_is_told_apart() -> None:
    case = sample(12, noise=0.1, shared=1.0)
    found = fit_surface(case.points, ORIGIN, AREA)
    assert found.report.sigma_shared == pytest.approx(1.0, rel=0.05)
    assert found.terrain.beside_photos().sigma < 0.35
    assert found.terrain.sigma == pytest.approx(1.03, abs=0.05)
    alone = fit_surface(sample(12, noise=0.1).points, ORIGIN, AREA)
    assert alone.report.sigma_shared == 0.0


def test_sigma_grows_away_from_the_points() -> None:
    case = sample(13)
    ground = fit_surface(case.points, ORIGIN, AREA).terrain
    out = ground.sigma_at([[0, 0], [160.0, 0], [180.0, 0], [205.0, 0]])
    assert np.all(np.diff(out) > 0)
    assert np.all(np.isfinite(ground.z_at(places(case.rng, 500, 3000.0))))


def test_held_out_points_choose_plane_or_tin() -> None:
    flat, rough = sample(14, relief=0.0), sample(14, relief=2.0)
    a, b = (fit_surface(case.points, ORIGIN, AREA).report for case in (flat, rough))
    assert (a.kind, b.kind) == ("plane", "tin")
    assert b.rms_tin < 0.3 * b.rms_plane
    assert a.held_out > 100
    facts = json.loads(json.dumps(b.facts()))
    assert facts["rms_plane_m"] == pytest.approx(b.rms_plane, abs=1e-4)


# -- file ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("relief", [0.0, 2.0])
def test_surface_comes_back_from_its_file(relief: float, tmp_path: Path) -> None:
    case = sample(15, relief=relief, shared=0.5)
    ground = fit_surface(case.points, ORIGIN, AREA).terrain
    save_surface(tmp_path / "s.npz", ground)
    back = load_surface(tmp_path / "s.npz")
    xy = places(case.rng, 300, 400.0)
    assert back.z_at(xy) == pytest.approx(ground.z_at(xy), abs=2e-5)  # m; float32 of the relief
    assert back.sigma_at(xy) == pytest.approx(ground.sigma_at(xy), rel=1e-5)
    assert (back.kind, back.sigma, back.sigma_shared) == (
        ground.kind, ground.sigma, ground.sigma_shared,
    )  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["s.npz"]


def test_a_cut_off_file_is_told(tmp_path: Path) -> None:
    case = sample(16, n=50)
    path = tmp_path / "s.npz"
    save_surface(path, fit_surface(case.points, ORIGIN, AREA).terrain)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(InputError, match=r"s\.npz.*georef run"):
        load_surface(path)
    with pytest.raises(InputError, match="georef run"):
        load_surface(tmp_path / "none.npz")
