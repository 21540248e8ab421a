"""Clicks found again in other photos: to a fraction of a pixel, or refused with a word."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from match_cases import (
    BLANK,
    CLICK,
    DASHES,
    EDGE,
    IDS,
    PERIOD,
    POSE_SIGMA,
    Places,
    click,
    picture,
    place_of,
    scene,
    true_pixel,
)

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.click_match.match import Matched, match_click
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.model.joint_errors import JointErrors

pytestmark = pytest.mark.slow


def misses(found: Matched, place: Array) -> list[tuple[Array, Array]]:
    """Distances of matches, px, from where their photos show a place; and their covariances."""
    out = []
    for one in found.matches:
        uv = np.array([one.mark.u, one.mark.v])
        truth = true_pixel(one.mark.photo, float(place[0]), float(place[1]))
        out.append((uv - truth, one.covariance))
    return out


def with_part(photo_id: str, change: Callable[[np.ndarray], None]) -> Callable[[str], np.ndarray]:
    """Pictures, one of which is changed."""

    def picture_of(key: str) -> np.ndarray:
        out = picture(key).copy()
        if key == photo_id:
            change(out)
        return out

    return picture_of


# -- what is found -------------------------------------------------------------------------------


def test_matches_are_good_to_a_tenth_of_a_pixel_and_say_so_across_turned_photos() -> None:
    places = Places()
    found, refused, seen = [], 0, set()
    for _ in range(40):
        uv, place = next(places)
        one = match_click(scene(), [click("P0", uv)], picture, model_px=0.0)
        found += misses(one, place)
        refused += bool(one.why_not)
        seen |= {match.mark.photo for match in one.matches}
    away = np.array([np.linalg.norm(e) for e, _ in found])
    chi2 = np.array([e @ np.linalg.solve(C, e) for e, C in found])
    # P2 and P4 are turned by 90 deg, P3 by 180 deg; each photo has another light and blur
    assert seen == set(IDS[1:])
    assert refused <= 2
    assert len(found) >= 80
    # px: no match is wrong, and half of them are within 0.05
    assert away.max() < 0.5
    assert np.median(away) < 0.05
    # error/sigma of u and v, some 200 numbers; the floor of 0.03 px makes the best ones cautious
    assert 0.4 < math.sqrt(float(np.mean(chi2)) / 2.0) < 1.4


def test_a_click_between_pixels_is_matched_there() -> None:
    base = np.round(true_pixel("P0", -2.0, -7.0))
    moves = []
    for part in (-0.4, 0.0, 0.4):
        found = match_click(scene(), [click("P0", base + part)], picture)
        truth = place_of("P0", base + part)
        moves += [float(np.linalg.norm(e)) for e, _ in misses(found, truth)]
    assert len(moves) >= 6
    # px; a place rounded to whole pixels would be off by 0.4 and more
    assert max(moves) < 0.2


def test_poses_that_err_by_their_sigmas_do_not_move_a_match() -> None:
    rng = np.random.default_rng(4)
    errors = rng.normal(size=(len(IDS), 6)) * POSE_SIGMA
    uv = true_pixel("P0", 1.0, -7.0)
    found = match_click(scene(errors), [click("P0", uv)], picture)
    assert len(found.matches) >= 2
    assert max(float(np.linalg.norm(e)) for e, _ in misses(found, place_of("P0", uv))) < 0.3


def test_only_photos_that_were_asked_for_are_looked_in() -> None:
    uv = true_pixel("P0", 0.5, -1.0)
    found = match_click(scene(), [click("P0", uv)], picture, photo_ids=["P3"])
    assert [one.mark.photo for one in found.matches] == ["P3"]
    assert set(found.refused) <= {"P3"}
    most = match_click(scene(), [click("P0", uv)], picture, most=2)
    assert len(most.matches) + len(most.refused) == 2


# -- what is refused -----------------------------------------------------------------------------


def test_a_place_without_texture_is_refused_with_that_word() -> None:
    found = match_click(scene(), [click("P0", true_pixel("P0", *BLANK))], picture)
    assert not found.matches
    assert found.place is None
    assert "no texture" in found.why_not


def test_an_edge_alone_is_refused_with_that_word() -> None:
    found = match_click(scene(), [click("P0", true_pixel("P0", *EDGE))], picture)
    assert not found.matches
    assert "edge" in found.why_not


def test_a_row_of_dashes_is_refused_where_only_a_photo_along_the_row_shows_it() -> None:
    # P1 stands along the row: a dash and its neighbour there are one dash at two heights
    corner = true_pixel("P0", DASHES[0], DASHES[1] + 0.15)
    found = match_click(scene(), [click("P0", corner)], picture, photo_ids=["P1"])
    assert not found.matches
    assert "alike" in found.why_not


@pytest.mark.parametrize("column", range(-3, 4))
def test_dashes_are_never_taken_for_their_neighbours(column: int) -> None:
    east = DASHES[0] + column * PERIOD
    corner = true_pixel("P0", east, DASHES[1] + 0.15)
    found = match_click(scene(), [click("P0", corner)], picture)
    for e, _ in misses(found, place_of("P0", corner)):
        # px; a dash is 19 to 22 px from the next
        assert float(np.linalg.norm(e)) < 1.0


def test_a_photo_in_which_the_spot_is_hidden_is_refused_and_the_others_match() -> None:
    uv = true_pixel("P0", 1.0, -7.0)
    u, v = np.round(true_pixel("P2", 1.0, -7.0)).astype(int)

    def hide(image: np.ndarray) -> None:
        other = picture("P1")[40:120, 60:140]
        image[v - 40 : v + 40, u - 40 : u + 40] = other

    found = match_click(scene(), [click("P0", uv)], with_part("P2", hide))
    matched = {one.mark.photo for one in found.matches}
    assert "P2" in found.refused
    assert "P2" not in matched
    assert len(matched) >= 2


def test_a_spot_beside_something_higher_is_refused_not_dragged_along() -> None:
    """The patch holds a blank spot on the ground, and beside it what moves by 3 px against it."""
    uv = true_pixel("P0", *BLANK)
    box = np.clip(cv2.GaussianBlur(picture("P4")[50:80, 50:80], (0, 0), 0.7), 0, 255)

    def put(key: str, image: np.ndarray, move: int) -> None:
        u, v = np.round(true_pixel(key, *BLANK)).astype(int)
        image[v - 15 : v + 15, u + 5 + move : u + 35 + move] = box

    def picture_of(key: str) -> np.ndarray:
        out = picture(key).copy()
        put(key, out, 0 if key == "P0" else 3)
        return out

    found = match_click(scene(), [click("P0", uv)], picture_of, photo_ids=["P1"])
    assert not found.matches
    assert found.why_not


def test_a_click_at_the_border_is_told() -> None:
    found = match_click(scene(), [click("P0", [3.0, 200.0])], picture)
    assert not found.matches
    assert "border" in found.why_not


def test_a_match_off_the_other_guides_is_left_out() -> None:
    """One photo's picture is moved by 4 px across: it matches there, but its ray misses."""
    uv = true_pixel("P0", 0.5, -1.0)

    def move(image: np.ndarray) -> None:
        image[:] = np.roll(image, 4, axis=0)

    found = match_click(scene(), [click("P0", uv)], with_part("P1", move), model_px=0.1)
    assert "P1" not in {one.mark.photo for one in found.matches}
    assert "P1" in found.refused
    assert len(found.matches) >= 2


# -- the place -----------------------------------------------------------------------------------


def test_the_place_and_its_sigma_hold_against_redrawn_poses_and_clicks() -> None:
    rng = np.random.default_rng(5)
    places = Places(rng=np.random.default_rng(6))
    chi2 = []
    for _ in range(30):
        errors = rng.normal(size=(len(IDS), 6)) * POSE_SIGMA
        uv, place = next(places)
        mark = click("P0", uv + CLICK * rng.normal(size=2))
        found = match_click(scene(errors), [mark], picture, model_px=0.0)
        if found.place is not None:
            e = found.place.p_enu[0] - place
            chi2.append(e**2 / np.diag(found.place.each[0]))
    assert len(chi2) >= 25
    ratio = np.sqrt(np.mean(chi2, axis=0))
    # 30 draws: one sigma of such a ratio is 0.13
    assert np.all(ratio > 0.65), ratio
    assert np.all(ratio < 1.4), ratio


def test_the_clicks_error_does_not_fall_with_the_number_of_photos() -> None:
    uv = true_pixel("P0", 0.5, -1.0)
    exact = click("P0", uv, sigma_px=0.01)
    loose = replace(exact, sigma_px=2.0)
    by_sigma = [match_click(scene(), [mark], picture).place for mark in (exact, loose)]
    assert by_sigma[0] is not None
    assert by_sigma[1] is not None
    more = by_sigma[1].each[0] - by_sigma[0].each[0]
    gsd = 25.0 / 500.0
    # m^2; 2 px on the ground once, to 10 %: the photo leans and the spot is beside its middle
    assert more[0, 0] == pytest.approx((2.0 * gsd) ** 2, rel=0.1)
    assert more[1, 1] == pytest.approx((2.0 * gsd) ** 2, rel=0.1)
    # m^2; along level ground no height is in it
    assert abs(more[2, 2]) < 1e-6
    assert np.allclose(by_sigma[0].p_enu, by_sigma[1].p_enu, atol=1e-9)


def test_the_clicks_part_is_that_of_moving_it() -> None:
    uv = true_pixel("P0", 1.0, -2.0)
    marks = [Mark(name="x", photo=key, u=float(p[0]), v=float(p[1]), sigma_px=0.1)
             for key in IDS for p in [true_pixel(key, 1.0, -2.0)]]  # fmt: skip
    sharing = [replace(mark, shared_px=1.5) for mark in marks]
    covariance = (
        intersect_points(scene(), sharing).each[0] - intersect_points(scene(), marks).each[0]
    )
    rng = np.random.default_rng(8)
    draws = []
    for _ in range(400):
        p = place_of("P0", uv + 1.5 * rng.normal(size=2))
        moved = [replace(m, u=float(q[0]), v=float(q[1]))
                 for m in marks for q in [true_pixel(m.photo, p[0], p[1])]]  # fmt: skip
        draws.append(intersect_points(scene(), moved).p_enu[0])
    spread = np.cov(np.array(draws)[:, :2].T)
    # 400 draws: 7 % of a variance is one sigma
    assert np.allclose(np.diag(covariance)[:2], np.diag(spread), rtol=0.2)


def test_marks_that_are_kept_give_the_place_that_matching_gave() -> None:
    uv = true_pixel("P0", 0.5, -1.0)
    found = match_click(scene(), [click("P0", uv, sigma_px=1.0)], picture)
    assert found.place is not None
    kept = [*found.own, *(one.mark for one in found.matches)]
    again = intersect_points(scene(), kept)
    assert np.allclose(again.p_enu, found.place.p_enu, atol=1e-9)
    assert np.allclose(again.each, found.place.each, rtol=1e-9, atol=1e-12)
    assert np.allclose(again.covariance(), found.place.covariance(), rtol=1e-9, atol=1e-12)
    # none of them says how unsure the click is as if it were its own
    assert all(mark.sigma_px < 0.6 < mark.shared_px < 1.5 for mark in kept)


def test_a_click_of_its_own_beside_matched_ones_betters_what_they_share() -> None:
    """Five marks of one click, and one that somebody clicked: two clicks, not six, not one."""
    marks = [Mark(name="x", photo=key, u=float(p[0]), v=float(p[1]), sigma_px=0.1, shared_px=1.0)
             for key in IDS for p in [true_pixel(key, 1.0, -2.0)]]  # fmt: skip
    own = replace(marks[-1], sigma_px=1.0, shared_px=0.0)
    known = JointErrors.of_matrix(scene().photos, 1e-12 * np.eye(6 * len(IDS)))
    exact = replace(scene(), errors=known)
    once = intersect_points(exact, marks[:-1]).each[0]
    both = intersect_points(exact, [*marks[:-1], own]).each[0]
    assert math.sqrt(both[0, 0] / once[0, 0]) == pytest.approx(math.sqrt(0.5), rel=0.1)


def test_who_takes_marks_as_independent_is_not_too_sure_of_the_plan() -> None:
    uv = true_pixel("P0", 0.5, -1.0)
    found = match_click(scene(), [click("P0", uv, sigma_px=1.0)], picture)
    assert found.place is not None
    kept = [*found.own, *(one.mark for one in found.matches)]
    alone = [replace(m, sigma_px=m.kept_px(len(kept)), shared_px=0.0) for m in kept]
    again, once = intersect_points(scene(), alone).each[0], found.place.each[0]
    for k in range(2):
        # photos count by their scale
        assert 0.9 < math.sqrt(again[k, k] / once[k, k]) < 1.3
    assert again[2, 2] > once[2, 2]


def test_matches_make_the_height_known() -> None:
    uv = true_pixel("P0", 0.5, -1.0)
    found = match_click(scene(), [click("P0", uv)], picture)
    assert found.place is not None
    # m; level ground is known to 0.3, the height of 25 m above it by rays 6 m apart to some 0.15
    assert math.sqrt(found.before.each[0][2, 2]) == pytest.approx(0.3, abs=1e-6)
    assert math.sqrt(found.place.each[0][2, 2]) < 0.2


# -- several clicks ------------------------------------------------------------------------------


def test_two_clicks_of_one_spot_halve_its_variance_and_meet_between() -> None:
    uv, other = (true_pixel(key, 0.5, -1.0) for key in ("P0", "P2"))
    move = np.array([0.6, 0.0])
    one = match_click(scene(), [click("P0", uv)], picture)
    both = match_click(scene(), [click("P0", uv + move), click("P2", other)], picture)
    assert {m.mark.photo for m in both.matches} <= {"P1", "P3", "P4"}
    seen = {m.mark.photo: np.array([m.mark.u, m.mark.v]) for m in both.matches}
    alone = {m.mark.photo: np.array([m.mark.u, m.mark.v]) for m in one.matches}
    for key in set(seen) & set(alone):
        # px; half of the first click's 0.6, scales of the photos 0.9 to 1.1
        assert float(np.linalg.norm(seen[key] - alone[key])) == pytest.approx(0.3, abs=0.12)
    assert not both.doubts


def test_clicks_on_different_spots_are_told() -> None:
    uv, other = (true_pixel(key, 0.5, -1.0) for key in ("P0", "P2"))
    marks = [click("P0", uv, 0.3), click("P2", other + np.array([2.5, 0.0]), 0.3)]
    found = match_click(scene(), marks, picture)
    assert found.place is not None
    told = [*found.doubts, *found.place.doubts[0]]
    assert any("P2" in line for line in told)


def test_clicks_that_show_no_place_raise_one_line() -> None:
    with pytest.raises(GeometryError) as error:
        match_click(scene(), [click("P0", [900.0, 10.0])], picture)
    assert "\n" not in str(error.value)


def test_before_is_the_place_of_the_clicks_alone() -> None:
    mark = click("P0", true_pixel("P0", 0.5, -1.0))
    found = match_click(scene(), [mark], picture)
    assert np.array_equal(found.before.p_enu, locate_points(scene(), [mark]).p_enu)
