"""Which photos show a place, where, and the line of a click in another photo."""

from __future__ import annotations

import math
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.epipolar import guide_line, guide_lines
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.measure.who_sees import (
    place_on_map,
    who_sees,
    who_sees_on_mosaic,
    who_sees_point,
)
from georef_gis.model.terrain import dem_terrain
from georef_gis.model.tin import EnuPlane

PLACE = np.array([2.0, 3.0, 1.0])
SURVEY = np.diag([0.02, 0.02, 0.03]) ** 2
DRAWS = 250


def test_pixels_are_those_of_each_photo_and_the_best_is_first() -> None:
    scene = scenes.scene()
    found = who_sees(scene, PLACE, SURVEY)
    assert {one.photo_id for one in found} == {"A", "B", "C"}
    for one in found:
        np.testing.assert_allclose(one.uv, scene.photo(one.photo_id).project(PLACE), atol=1e-6)
    assert [one.score for one in found] == sorted(one.score for one in found)
    assert [one.photo_id for one in who_sees(scene, PLACE, SURVEY, best=1)] == [found[0].photo_id]
    # C sees 40 m to its side no more
    assert {o.photo_id for o in who_sees(scene, np.array([40.0, 0, 0]), SURVEY)} < {"A", "B", "C"}
    assert who_sees(scene, np.array([900.0, 0.0, 0.0]), SURVEY) == []


def drawn_scene(rng: np.random.Generator) -> Scene:
    root = np.linalg.cholesky(scenes.pose_covariance())
    return scenes.scene(root @ rng.normal(size=18), scenes.CAMERA_SIGMA * rng.normal(size=11))


@pytest.mark.slow
def test_ellipses_of_a_surveyed_place_are_those_of_draws() -> None:
    rng = np.random.default_rng(3)
    stated = {one.photo_id: one for one in who_sees(scenes.scene(), PLACE, SURVEY)}
    off: dict[str, list[Array]] = {key: [] for key in stated}
    for _ in range(DRAWS):
        scene, p = drawn_scene(rng), PLACE + np.sqrt(np.diag(SURVEY)) * rng.normal(size=3)
        for key, found in off.items():
            found.append(scene.photo(key).project(p))
    for key, found in off.items():
        C, spread = stated[key].covariance, np.cov(np.array(found).T)
        # 250 draws: 4.5 % of a sigma
        np.testing.assert_allclose(np.sqrt(np.diag(spread) / np.diag(C)), 1.0, atol=0.15)
        values = np.sqrt(np.linalg.eigvalsh(spread))
        assert values[1] == pytest.approx(stated[key].semi_major, rel=0.15)


@pytest.mark.slow
def test_ellipses_of_a_measured_place_know_what_it_shares_with_the_photos() -> None:
    """A point intersected in A and B, looked for in A, B and C."""
    rng = np.random.default_rng(4)
    truth = scenes.oriented()
    exact = scenes.marks_of(truth, {"P": (PLACE, "AB")})
    stated = {
        one.photo_id: one
        for one in who_sees_point(intersect_points(scenes.scene(), exact), 0)
    }  # fmt: skip
    off: dict[str, list[Array]] = {key: [] for key in stated}
    for _ in range(DRAWS):
        scene = drawn_scene(rng)
        marks = [
            replace(m, u=m.u + du, v=m.v + dv)
            for m, (du, dv) in zip(exact, scenes.CLICK * rng.normal(size=(2, 2)), strict=True)
        ]
        p = intersect_points(scene, marks).p_enu[0]
        for one, photo in zip(truth, scene.photos.photos, strict=True):
            off[one.id].append(photo.project(p) - one.project(PLACE))
    for key, found in off.items():
        spread = np.cov(np.array(found).T)
        ratio = np.sqrt(np.diag(spread) / np.diag(stated[key].covariance))
        np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    surveyed = {one.photo_id: one for one in who_sees(scenes.scene(), PLACE, SURVEY)}
    assert stated["A"].semi_major < 0.7 * surveyed["A"].semi_major


def test_a_place_read_off_the_mosaic_is_sharp_where_a_surveyed_one_is_not() -> None:
    scene = scenes.scene()
    xy = scenes.FRAME.map_from_enu(scenes.on_slope(2.0, 3.0))[:2]
    sharp = {one.photo_id: one for one in who_sees_on_mosaic(scene, xy)}
    loose = {one.photo_id: one for one in who_sees(scene, *place_on_map(scene, xy))}
    assert sharp.keys() == loose.keys()
    for key, one in sharp.items():
        # px; by the search for the ground
        np.testing.assert_allclose(one.uv, loose[key].uv, atol=0.05)
    # px; the photo that it is read in predicts it to the reading
    read = min(sharp.values(), key=lambda one: one.semi_major)
    assert read.semi_major < 2.0 < 5.0 < loose[read.photo_id].semi_major
    assert who_sees_on_mosaic(scene, xy + 10_000.0) == []


def test_heights_of_a_place_are_the_grounds_or_its_own() -> None:
    scene = scenes.scene()
    at = scenes.on_slope(7.0, -4.0)
    xy = scenes.FRAME.map_from_enu(at)[:2]
    p, C = place_on_map(scene, xy)
    np.testing.assert_allclose(p, at, atol=1e-5)
    assert math.sqrt(C[2, 2]) == pytest.approx(scene.terrain.sigma)
    p, C = place_on_map(scene, xy, height=290.0, sigma_h=0.1, sigma_v=0.2)
    assert scenes.FRAME.origin.geo_from_enu(p)[2] == pytest.approx(290.0, abs=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(C)), [0.1, 0.1, 0.2])


def walled() -> Scene:
    """Level ground with a wall of 30 m north of the origin, photo A south of it."""
    heights = np.full((100, 100), 277.6)
    heights[40:42] = 307.6
    terrain = dem_terrain(
        EnuPlane(origin=scenes.ORIGIN, level=277.6),  # type: ignore[arg-type]
        heights, left=-100.0, top=100.0, cell=(2.0, 2.0), metres_per_unit=1.0,
    )  # fmt: skip
    scene = scenes.scene()
    return Scene.of(scene.frame, terrain, scene.photos.photos)


def test_a_photo_from_which_the_ground_hides_a_place_comes_last_or_not() -> None:
    scene = walled()
    behind = np.array([0.0, 24.0, 0.0])
    seen = {one.photo_id: one for one in who_sees(scene, behind, SURVEY, hidden=True)}
    # A and B stand south of the wall, low; C right above the place
    assert seen["A"].hidden
    assert not seen["C"].hidden
    assert "A" not in {one.photo_id for one in who_sees(scene, behind, SURVEY)}
    before = who_sees(scene, np.array([0.0, 10.0, 0.0]), SURVEY)
    assert "A" in {one.photo_id for one in before}


def test_a_mosaic_shows_a_place_as_a_photo_does_that_sees_it() -> None:
    """Not as the nearest photo, from which a wall hides it: its pixel shows the wall."""
    walls = walled()
    a, _, c = walls.photos.photos
    far = replace(c, pose=replace(c.pose, origin_enu=np.array([2.0, 75.0, 130.0])))
    scene = Scene.of(walls.frame, walls.terrain, [a, far])
    behind = np.array([0.0, 24.0, 0.0])
    assert np.linalg.norm((behind - far.pose.origin_enu)[:2]) > np.linalg.norm(
        (behind - a.pose.origin_enu)[:2]
    )
    (found,) = who_sees_on_mosaic(scene, scenes.FRAME.map_from_enu(behind)[:2])
    assert found.photo_id == "C"
    np.testing.assert_allclose(found.uv, far.project(behind), atol=0.05)  # px; search for ground


def test_ground_that_is_not_known_is_told() -> None:
    with pytest.raises(GeometryError, match="the ground is not known there; give its height"):
        place_on_map(walled(), scenes.FRAME.map_from_enu([5000.0, 0.0, 0.0])[:2])


# -- guide lines ------------------------------------------------------------------------------


def test_the_guide_is_the_ray_between_heights() -> None:
    scene = scenes.scene()
    u, v = scene.photo("A").project(PLACE)
    guide = guide_line(scene, Mark(name="", photo="A", u=u, v=v), "C", low=270.0, high=285.0)
    assert guide.photo_id == "C"
    assert guide.height[0] == pytest.approx(270.0, abs=1e-3)
    assert guide.height[-1] == pytest.approx(285.0, abs=1e-3)
    c = scene.photo("C")
    np.testing.assert_allclose(guide.uv, c.project(guide.p_enu), atol=1e-6)
    # the place itself lies on it: distance from the nearest two points' line
    want = c.project(PLACE)
    i = int(np.argmin(np.linalg.norm(guide.uv - want, axis=1)))
    a, b = guide.uv[max(i - 1, 0)], guide.uv[min(i + 1, len(guide.uv) - 1)]
    across = np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
    # px; the shutter's rows bend the line
    assert abs((want - a) @ across) < 0.1
    assert np.all(guide.width(2.0) == 2.0 * guide.sigma_across)


def test_the_guide_ends_above_and_below_the_ground() -> None:
    scene = scenes.scene()
    mark = scenes.marks_of(scene.photos.photos, {"P": (scenes.on_slope(2.0, 3.0), "A")})[0]
    guides = {one.photo_id: one for one in guide_lines(scene, mark)}
    assert set(guides) == {"B", "C"}
    for key, guide in guides.items():
        ground = scene.photo(key).project(scenes.on_slope(2.0, 3.0))
        np.testing.assert_allclose(guide.ground_uv, ground, atol=0.05)
        assert guide.height[0] < 277.6 < guide.height[-1]


@pytest.mark.slow
def test_the_width_of_a_guide_is_that_of_draws() -> None:
    """Where on the line a place of one height shows, redrawn: its scatter across."""
    rng = np.random.default_rng(6)
    truth = scenes.oriented()
    (exact,) = scenes.marks_of(truth, {"P": (PLACE, "A")})
    mark = replace(exact, sigma_px=scenes.CLICK)
    stated = guide_line(scenes.scene(), mark, "C", low=270.0, high=285.0)
    ends = []
    for _ in range(DRAWS):
        du, dv = scenes.CLICK * rng.normal(size=2)
        moved = replace(mark, u=mark.u + du, v=mark.v + dv)
        ends.append(guide_line(drawn_scene(rng), moved, "C", low=270.0, high=285.0).uv)
    off = np.array(ends) - stated.uv
    along = np.gradient(stated.uv, axis=0)
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    spread = np.std(np.einsum("dki,ki->dk", off, across), axis=0)
    np.testing.assert_allclose(spread / stated.sigma_across, 1.0, atol=0.15)


def test_clicks_that_have_no_line_are_refused() -> None:
    scene = scenes.scene()
    good = Mark(name="", photo="A", u=2000.0, v=1500.0)
    with pytest.raises(GeometryError, match="lies outside"):
        guide_lines(scene, replace(good, u=-9.0))
    with pytest.raises(GeometryError, match="photo Z has no pose"):
        guide_line(scene, good, "Z")
    with pytest.raises(GeometryError, match="from 300 to 290 m there is no height between"):
        guide_line(scene, good, "B", low=300.0, high=290.0)
    with pytest.raises(GeometryError, match="shows nothing that photo C sees"):
        guide_line(scene, replace(good, u=10.0, v=2990.0), "C")


def test_a_height_above_the_camera_ends_below_it() -> None:
    scene = scenes.scene()
    mark = Mark(name="", photo="A", u=2000.0, v=1500.0)
    (guide,) = guide_lines(scene, mark, ["B"], low=270.0, high=900.0)
    assert guide.height[-1] < scene.frame.origin.geo_from_enu(scenes.CENTRES[0])[2]


def test_a_located_point_predicts_its_own_click_to_the_click() -> None:
    scene = scenes.scene()
    points = locate_points(scene, [Mark(name="", photo="A", u=900.0, v=700.0, sigma_px=0.7)])
    one = next(s for s in who_sees_point(points, 0) if s.photo_id == "A")
    np.testing.assert_allclose(one.uv, [900.0, 700.0], atol=1e-2)
    # px; the pose cancels, the click and what the slope leaves do not
    np.testing.assert_allclose(np.sqrt(np.diag(one.covariance)), 0.7, rtol=0.05)
