"""A spot on the ground that several photos show has its rays and the ground."""

from __future__ import annotations

import re
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.measure import on_ground
from georef_gis.measure.budget.shares import point_budgets
from georef_gis.measure.on_ground import SURER
from georef_gis.measure.points import Mark, MeasuredPoint, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.model.joint_errors import JointErrors

SPOT = scenes.on_slope(1.0, 3.0)


def marks(scene: Scene, p: Array = SPOT, keys: str = "AB", *, on_ground: bool = True) -> list[Mark]:
    made = scenes.marks_of(scene.photos.photos, {"P": (p, keys)})
    return [replace(mark, on_ground=on_ground) for mark in made]


def one(
    scene: Scene, p: Array = SPOT, keys: str = "AB", *, on_ground: bool = True
) -> MeasuredPoint:
    return intersect_points(scene, marks(scene, p, keys, on_ground=on_ground))[0]


def up(height: float) -> Array:
    return np.array([0.0, 0.0, height])


def plan(point: MeasuredPoint) -> float:
    """Largest sigma in the plan, m."""
    return float(np.sqrt(np.linalg.eigvalsh(point.covariance[:2, :2])[1]))


def sharp() -> Scene:
    """Poses known to 1 cm and 0.1 mrad: rays meet to some 3 cm."""
    scene = scenes.scene()
    sigma = np.diag(np.tile([0.01] * 3 + [1e-4] * 3, 3) ** 2)
    return replace(scene, errors=JointErrors.of_matrix(scene.photos, sigma))


def test_a_second_photo_makes_a_spot_on_the_ground_no_less_sure() -> None:
    scene = scenes.scene()
    located = locate_points(scene, marks(scene, keys="A"))[0]
    rays, both = one(scene, on_ground=False), one(scene)
    assert rays.method == "intersect"
    assert both.method == "intersect_ground"
    # what the ground is for: rays 20 m apart know the height worse than the ground does
    assert rays.covariance[2, 2] > 1.5 * located.covariance[2, 2]
    for other in (rays, located):
        for k in range(3):
            assert both.covariance[k, k] < 1.0001 * other.covariance[k, k]
        assert plan(both) < 1.0001 * plan(other)
    assert both.dof == rays.dof + 1 == 2
    assert both.sigma0 < 1e-2


def test_the_ground_moves_a_place_and_its_residuals_tell() -> None:
    """Marks of a spot 10 cm up are drawn down by the share that the two variances say."""
    scene = scenes.scene()
    p = SPOT + up(0.1)
    rays, both = one(scene, p, on_ground=False), one(scene, p)
    normal = np.array([0.1, -0.06, 1.0])
    variance = normal @ rays.covariance @ normal
    ground = scenes.GROUND_SHARED**2 + scenes.GROUND_LOCAL**2
    left = normal @ (both.p_enu - SPOT)
    assert left == pytest.approx(0.1 * ground / (variance + ground), rel=1e-3)
    assert both.sigma0**2 * both.dof == pytest.approx(0.01 / (variance + ground), rel=1e-3)
    assert np.abs(rays.residuals).max() < 1e-4
    seen = [scene.photo(key).project(both.p_enu) for key in both.photo_ids]
    np.testing.assert_allclose(both.residuals, both.uv - seen, atol=1e-9)
    assert np.abs(both.residuals).max() > 0.5


@pytest.mark.parametrize(("height", "side"), [(2.5, "above"), (-2.0, "below")])
def test_a_spot_that_stands_up_is_told_with_its_height_and_placed_by_its_rays(
    height: float, side: str
) -> None:
    scene = sharp()
    p = SPOT + up(height)
    point, rays = one(scene, p), one(scene, p, on_ground=False)
    assert point.method == "intersect"
    np.testing.assert_allclose(point.p_enu, p, atol=1e-3)
    np.testing.assert_array_equal(point.covariance, rays.covariance)
    (line,) = point.doubts
    found = re.fullmatch(r"its rays meet (.*) \+- (.*) m (above|below) the ground: .*", line)
    assert found is not None, line
    assert float(found[1]) == pytest.approx(abs(height), abs=0.006)
    # m; nearly all of it is the ground's
    assert float(found[2]) == pytest.approx(0.33, abs=0.02)
    assert found[3] == side


def test_a_contradiction_takes_three_sigmas() -> None:
    scene = sharp()
    sigma = 0.325
    for height, method in ((2.7 * sigma, "intersect_ground"), (3.3 * sigma, "intersect")):
        assert one(scene, SPOT + up(height)).method == method


def test_nobody_said_so_but_the_ground_would_help_is_told_with_both_sigmas() -> None:
    """Seen from aside by careless clicks: the height that rays do not know is in the plan."""
    scene = sharp()
    scene = replace(scene, ground=replace(scene.ground, shared=0.02))
    aside = scenes.on_slope(30.0, -6.0)

    def measured(p: Array, *, on_ground: bool) -> MeasuredPoint:
        careless = [
            replace(m, sigma_px=5.0) for m in marks(scene, p, keys="AB", on_ground=on_ground)
        ]
        return intersect_points(scene, careless)[0]

    free, on = measured(aside, on_ground=False), measured(aside, on_ground=True)
    (line,) = free.doubts
    assert line.startswith(f"{SURER}: one sigma {plan(on):.2g} m instead of {plan(free):.2g} m")
    assert on.doubts == ()
    # a spot well above the ground is not asked for it
    assert measured(aside + up(9.0), on_ground=False).doubts == ()


def test_where_no_ground_is_known_that_is_told() -> None:
    scene = scenes.scene()
    hole = scenes.Slope(places=SPOT[None], low=np.array([np.nan]))
    point = one(replace(scene, terrain=hole))
    assert point.method == "intersect"
    assert point.doubts == ("the ground is not known there: it is not used",)


def test_one_mark_that_says_so_is_enough_and_others_stay_free() -> None:
    scene = scenes.scene()
    some = marks(scene, on_ground=False)
    some[1] = replace(some[1], on_ground=True)
    other = [replace(m, name="Q") for m in marks(scene, on_ground=False)]
    assert intersect_points(scene, some + other).methods == ("intersect_ground", "intersect")


def test_the_budget_of_a_spot_by_rays_and_ground_adds_up() -> None:
    scene = scenes.scene()
    points = intersect_points(scene, marks(scene))

    class Whole:
        def parts(self, photos: np.ndarray) -> dict[str, Array]:
            return {"pose": scene.errors.joint(photos)}

    (budget,) = point_budgets(points, Whole())  # type: ignore[arg-type]
    total = np.sum(list(budget.by_source.values()), axis=0)
    np.testing.assert_allclose(total, points.covariance_of(0), rtol=1e-9, atol=1e-12)
    assert np.trace(budget.by_source["ground"]) > 0.0


def test_points_stay_in_their_order_whatever_is_asked_of_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Four kinds, of which the ground is asked for some: by three photos or two, on it or free."""
    monkeypatch.setattr(on_ground, "_FEW_RAYS", 2)
    scene = scenes.scene()
    kinds = {"P": "ABC", "Q": "AB"}
    some = [
        replace(m, name=f"{name}{said}", on_ground=said == "on")
        for said in ("free", "on")
        for name, keys in kinds.items()
        for m in marks(scene, keys=keys)
    ]
    together = intersect_points(scene, some)
    assert together.names == ("Pfree", "Qfree", "Pon", "Qon")
    for i, name in enumerate(together.names):
        alone = intersect_points(scene, [m for m in some if m.name == name])
        assert together.methods[i] == alone.methods[0]
        np.testing.assert_allclose(together.covariance_of(i), alone.covariance_of(0), rtol=1e-9)
        np.testing.assert_allclose(together.covariance([i]), alone.covariance(), rtol=1e-9)
        assert together[i].photo_ids == alone[0].photo_ids
