"""The joint covariance of measured points against draws through the functions themselves.

The truth stays; poses, camera, ground and clicks are stated anew each time with errors drawn from
their law, and everything is measured again without any linearisation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.measure.ellipses import on_map
from georef_gis.measure.lengths import Lengths, measure_lines
from georef_gis.measure.points import Mark, MeasuredPoints, intersect_points, locate_points
from georef_gis.measure.scene import Scene

DRAWS, DRAWN_LENGTHS = 400, 200
# a sigma of 400 draws is known to 3.5 %, a correlation to 0.05; three of them and some curvature
SIGMAS, CORRELATIONS = 0.12, 0.17
PLACES = {
    "in A": (scenes.on_slope(-8.0, 6.0), "A"),
    "in A too": (scenes.on_slope(5.0, -9.0), "A"),
    "in B": (scenes.on_slope(14.0, 4.0), "B"),
    "in all": (np.array([1.0, 3.0, 4.0]), "ABC"),
    "in A and B": (np.array([-3.0, -6.0, 1.0]), "AB"),
    "A, B and ground": (scenes.on_slope(-2.0, 12.0), "AB"),
    "A, C and ground": (scenes.on_slope(9.0, 8.0), "AC"),
}
WITH_GROUND = {name for name in PLACES if "ground" in name}
GROUND = np.array([p for name, (p, keys) in PLACES.items()
                   if len(keys) == 1 or name in WITH_GROUND])  # fmt: skip


def measured(scene: Scene, marks: list[Mark]) -> MeasuredPoints:
    marks = [replace(m, on_ground=m.name in WITH_GROUND) for m in marks]
    alone = [m for m in marks if len(PLACES[m.name][1]) == 1]
    return MeasuredPoints.joined(
        locate_points(scene, alone), intersect_points(scene, [m for m in marks if m not in alone])
    )


@pytest.fixture(scope="module")
def stated() -> MeasuredPoints:
    scene = scenes.scene()
    return measured(scene, scenes.marks_of(scene.photos.photos, PLACES))


@pytest.fixture(scope="module")
def draws(stated: MeasuredPoints) -> list[MeasuredPoints]:
    rng = np.random.default_rng(20)
    exact = scenes.marks_of(scenes.oriented(), PLACES)
    root = np.linalg.cholesky(scenes.pose_covariance())
    apart = np.sum((GROUND[:, None, :2] - GROUND[:, :2]) ** 2, axis=-1)
    heights = scenes.GROUND_SHARED**2 + scenes.GROUND_LOCAL**2 * np.exp(
        -apart / (2 * scenes.GROUND_LENGTH**2)
    )
    out = []
    for _ in range(DRAWS):
        low = rng.multivariate_normal(np.zeros(len(GROUND)), heights)
        ground = scenes.Slope(places=GROUND, low=low)
        scene = scenes.scene(
            root @ rng.normal(size=18), scenes.CAMERA_SIGMA * rng.normal(size=11), ground
        )
        clicks = scenes.CLICK * rng.normal(size=(len(exact), 2))
        marks = [
            replace(m, u=m.u + du, v=m.v + dv) for m, (du, dv) in zip(exact, clicks, strict=True)
        ]
        out.append(measured(scene, marks))
    # one of 370 good points has a ground that seems to contradict it, which is then told
    kept = [one for one in out if one.methods == stated.methods]
    assert len(kept) > 0.98 * DRAWS
    return kept


def test_without_errors_the_places_are_the_true_ones(stated: MeasuredPoints) -> None:
    true = np.array([p for p, _ in PLACES.values()])
    # m; where the search for the ground stops
    np.testing.assert_allclose(stated.p_enu, true, atol=2e-4)


@pytest.mark.slow
def test_the_joint_covariance_is_that_of_the_draws(
    stated: MeasuredPoints, draws: list[MeasuredPoints]
) -> None:
    spread = np.cov(np.array([one.p_enu.ravel() for one in draws]).T)
    C = stated.covariance()
    sigma, drawn = np.sqrt(np.diag(C)), np.sqrt(np.diag(spread))
    np.testing.assert_allclose(drawn / sigma, 1.0, atol=SIGMAS)
    found, expected = spread / np.outer(drawn, drawn), C / np.outer(sigma, sigma)
    np.testing.assert_allclose(found, expected, atol=CORRELATIONS)
    # what two kinds of measuring share is not nothing
    assert np.abs(expected[:3, 9:12]).max() > 0.4
    assert np.abs(expected[:3, 15:18]).max() > 0.4


def test_each_point_alone_is_in_the_joint_covariance(stated: MeasuredPoints) -> None:
    C = stated.covariance()
    for i in range(len(stated)):
        block = C[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(block, stated.covariance_of(i), rtol=1e-9, atol=1e-12)
    some = stated.subset([3, 1])
    np.testing.assert_allclose(some.covariance()[:3, 3:], C[9:12, 3:6], atol=1e-12)
    np.testing.assert_allclose(stated.covariance([3, 1]), some.covariance(), atol=1e-12)


def values_of(lines: Lengths) -> dict[str, float]:
    leg = lines.legs[0]
    assert lines.area_ground is not None
    assert lines.area_grid is not None
    return {
        "slope": leg.slope.value, "ground": leg.ground.value, "grid": leg.grid.value,
        "height": leg.height_difference.value, "true": leg.bearing_true.value,
        "map": leg.bearing_grid.value, "perimeter": lines.ground.value,
        "area": lines.area_ground.value, "map area": lines.area_grid.value,
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [(0, 1, 2), (0, 3, 4), (1, 2, 3), (5, 6, 0), (3, 5, 4)])
def test_lengths_and_areas_scatter_as_their_sigmas_say(
    stated: MeasuredPoints, draws: list[MeasuredPoints], chosen: tuple[int, ...]
) -> None:
    lines = measure_lines(stated.subset(chosen), closed=True)
    leg = lines.legs[0]
    assert lines.area_ground is not None
    assert lines.area_grid is not None
    sigma = {
        "slope": leg.slope, "ground": leg.ground, "grid": leg.grid,
        "height": leg.height_difference, "true": leg.bearing_true, "map": leg.bearing_grid,
        "perimeter": lines.ground, "area": lines.area_ground, "map area": lines.area_grid,
    }  # fmt: skip
    found = [
        values_of(measure_lines(one.subset(chosen), closed=True)) for one in draws[:DRAWN_LENGTHS]
    ]
    for name, quantity in sigma.items():
        each = np.array([one[name] for one in found])
        if name in ("true", "map"):
            each = np.angle(np.exp(1j * (each - quantity.value)))
        # 200 draws: 5 %
        assert np.std(each) == pytest.approx(quantity.sigma, rel=0.18), name


def test_a_distance_in_one_photo_is_better_than_the_places(stated: MeasuredPoints) -> None:
    leg = measure_lines(stated.subset([0, 1])).legs[0]
    assert leg.ground.better > 2.0
    both = stated.covariance_of(0)[:2, :2] + stated.covariance_of(1)[:2, :2]
    way = stated.p_enu[1, :2] - stated.p_enu[0, :2]
    way /= np.hypot(*way)
    assert leg.ground.sigma_apart == pytest.approx(math.sqrt(way @ both @ way), rel=0.02)


def test_sensitivities_and_own_part_make_the_covariance(stated: MeasuredPoints) -> None:
    """What a point says of itself is enough to make its covariance again."""
    errors = stated.scene.errors
    for i, point in enumerate(stated):
        photos = [scenes.IDS.index(key) for kind, key in point.sensitivity if kind == "pose"]
        keys = [("pose", scenes.IDS[k]) for k in sorted(photos)]
        J = np.hstack(
            [*(point.sensitivity[key] for key in keys), point.sensitivity["camera", "cam"]]
        )
        C = J @ errors.joint(sorted(photos))[:-1, :-1] @ J.T + point.own
        C += np.outer(point.by_height, point.by_height) * (
            scenes.GROUND_SHARED**2 + scenes.GROUND_LOCAL**2
        )
        np.testing.assert_allclose(C, stated.covariance_of(i), rtol=1e-8, atol=1e-12)


def along_grid(C: Array, p: Array) -> Array:
    (out,) = on_map(scenes.FRAME, p[None], C[None])
    return out


def test_covariances_on_the_map_are_those_of_map_coordinates(stated: MeasuredPoints) -> None:
    """By differences of the map frame itself; its scale, 1e-4, is left out."""
    foot = 1200.0 / 3937.0
    for i in range(len(stated)):
        p, h = stated.p_enu[i], 1.0
        ends = [scenes.FRAME.map_from_enu([p + h * d, p - h * d]) for d in np.eye(3)]
        J = np.stack([(a - b) / (2 * h) * [foot, foot, 1.0] for a, b in ends], axis=1)
        C = stated.covariance_of(i)
        np.testing.assert_allclose(
            along_grid(C, p), J @ C @ J.T, rtol=3e-4, atol=1e-4 * np.trace(C)
        )
