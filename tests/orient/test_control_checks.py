"""Blunders planted in the control of simulated flights with direct poses, metres off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from control_flights import (
    direct_flight,
    ground_of,
    mark_of,
    names_in,
    observations,
    photos_by_id,
    relabelled,
    shifted,
)

from georef_gis.model.control import ControlObservations
from georef_gis.orient.control_checks import ControlCheck, check_control
from georef_gis.orient.control_model import predict_pixels

DIRECT = direct_flight(2)
PHOTOS, GROUND = photos_by_id(DIRECT), ground_of(DIRECT)
CONTROL = observations(DIRECT)
# a photo that shows seven points
PHOTO = max(set(CONTROL.photo_ids), key=lambda key: (len(names_in(CONTROL, key)), key))


def check(control: ControlObservations) -> ControlCheck:
    return check_control(PHOTOS, control, GROUND)


def suspects(found: ControlCheck) -> set[int]:
    return set(np.flatnonzero(found.suspect).tolist())


def marks_of(control: ControlObservations, *names: str) -> set[int]:
    j = [control.names.index(name) for name in names]
    return set(np.flatnonzero(np.isin(control.point, j)).tolist())


@pytest.mark.slow
def test_good_marks_of_direct_poses_accuse_nobody_and_are_as_far_off_as_they_say() -> None:
    """Six flights, 446 marks; the mean of chi-square with two degrees of freedom is 2."""
    chi2 = []
    for seed in range(1, 7):
        direct = direct_flight(seed)
        found = check_control(photos_by_id(direct), observations(direct), ground_of(direct))
        assert not found.suspect.any()
        assert found.keep.all()
        assert found.doubts == ()
        chi2.append(found.chi2 / found.noise**2)
    rms = np.sqrt(np.mean(np.concatenate(chi2)) / 2)
    assert 0.7 < rms < 1.4


@pytest.mark.slow
def test_predicted_pixels_are_as_far_off_as_their_ellipses_say() -> None:
    """Eight flights, no marks used; the errors within a flight are correlated: wide bounds."""
    normalised = []
    for seed in range(1, 9):
        direct = direct_flight(seed)
        control = observations(direct)
        photos = photos_by_id(direct)
        found = predict_pixels(photos, control, ground_of(direct))
        true = {(direct.flight.names[m.photo], m.point): m.uv_true for m in direct.flight.marks}
        for key, j, uv, C in zip(
            found.photo_ids, found.point, found.uv, found.covariance, strict=True
        ):
            at = true.get((key, control.names[j]))
            if at is not None:
                normalised.append((at - uv) @ np.linalg.solve(C, at - uv) / 2)
    assert len(normalised) > 400
    assert 0.5 < np.sqrt(np.mean(normalised)) < 1.5


def test_two_marks_exchanged_in_one_photo_are_told_as_that() -> None:
    a, b = names_in(CONTROL, PHOTO)[0], names_in(CONTROL, PHOTO)[-1]
    ka, kb = mark_of(CONTROL, PHOTO, a), mark_of(CONTROL, PHOTO, b)
    found = check(relabelled(CONTROL, {ka: b, kb: a}))
    assert suspects(found) == {ka, kb}
    (line,) = found.doubts
    assert f"the marks of {b} and {a} in {PHOTO} are exchanged" in line
    assert not found.keep[[ka, kb]].any()


def test_a_mislabelled_mark_is_told_with_the_point_it_fits() -> None:
    a = names_in(CONTROL, PHOTO)[2]
    wrong = next(name for name in CONTROL.names if name not in names_in(CONTROL, PHOTO))
    k = mark_of(CONTROL, PHOTO, a)
    found = check(relabelled(CONTROL, {k: wrong}))
    assert suspects(found) == {k}
    assert f"mark of {wrong} in {PHOTO}" in found.doubts[0]
    assert f"but fits {a}" in found.doubts[0]


def test_eight_pixels_among_seven_marks_are_noticed() -> None:
    # the mark nearest the image's middle: those about it tell its place best
    own = [k for k, key in enumerate(CONTROL.photo_ids) if key == PHOTO]
    middle = [k for k in own if np.all(np.abs(CONTROL.uv[k] - [648, 432]) < [500, 350])]
    k = middle[0]
    found = check(shifted(CONTROL, k, (6.0, 5.0)))
    assert suspects(found) == {k}
    # the planted error, to the precision of the other marks
    assert np.allclose(found.residual[k], (6.0, 5.0), atol=4 * np.sqrt(found.covariance[k].max()))


def test_a_mark_in_the_wrong_photo_is_noticed() -> None:
    a = names_in(CONTROL, PHOTO)[1]
    k = mark_of(CONTROL, PHOTO, a)
    others = [key for key in PHOTOS if a not in names_in(CONTROL, key) and key in CONTROL.photo_ids]
    keys = list(CONTROL.photo_ids)
    keys[k] = others[0]
    found = check(replace(CONTROL, photo_ids=tuple(keys)))
    assert suspects(found) == {k}
    assert f"mark of {a} in {others[0]}" in found.doubts[0]


@pytest.mark.slow
@pytest.mark.parametrize("pair", [("P01", "P06"), ("P03", "P10")])
def test_points_exchanged_everywhere_are_told_as_that(pair: tuple[str, str]) -> None:
    a, b = pair
    labels = {k: b for k in marks_of(CONTROL, a)} | {k: a for k in marks_of(CONTROL, b)}
    found = check(relabelled(CONTROL, labels))
    assert suspects(found) == marks_of(CONTROL, a, b)
    (line,) = found.doubts
    assert f"points {a} and {b} are exchanged" in line


@pytest.mark.slow
def test_wrong_coordinates_are_told_apart_from_wrong_marks() -> None:
    p = CONTROL.p_enu.copy()
    j = CONTROL.names.index("P05")
    p[j] += (1.5, -1.0, 0.3)
    found = check(replace(CONTROL, p_enu=p))
    assert suspects(found) == marks_of(CONTROL, "P05")
    (line,) = found.doubts
    assert "marks of P05 agree with each other, but put it -1.5" in line


def test_marks_of_resized_photos_are_told_once_and_none_is_used() -> None:
    found = check(replace(CONTROL, uv=0.5 * (CONTROL.uv + 0.5) - 0.5))
    assert not found.keep.any()
    (line,) = found.doubts
    assert "resized to" in line


def test_of_two_marks_of_a_point_in_a_photo_the_fitting_one_stays() -> None:
    k = mark_of(CONTROL, PHOTO, names_in(CONTROL, PHOTO)[3])
    double = replace(
        CONTROL,
        photo_ids=(*CONTROL.photo_ids, PHOTO),
        point=np.r_[CONTROL.point, CONTROL.point[k]].astype(np.int32),
        uv=np.vstack([CONTROL.uv, CONTROL.uv[k] + [120.0, -80.0]]),
        sigma_px=np.r_[CONTROL.sigma_px, 0.3],
        source=(*CONTROL.source, "marks.csv, line 999"),
    )
    found = check(double)
    assert suspects(found) == {len(CONTROL.point)}
    assert found.keep[k]
    assert not found.keep[-1]
    assert "marks.csv, line 999" in found.doubts[0]


def test_a_check_mark_that_disagrees_is_told_but_stays() -> None:
    a = names_in(CONTROL, PHOTO)[3]
    control = observations(DIRECT, roles={a: "check"})
    k = mark_of(control, PHOTO, a)
    found = check(shifted(control, k, (40.0, 30.0)))
    assert suspects(found) == {k}
    assert found.keep[k]
    assert "look at it" in found.doubts[0]


def test_points_that_are_off_and_empty_control_say_nothing() -> None:
    off = observations(DIRECT, roles=dict.fromkeys(CONTROL.names, "off"))
    assert not check(off).suspect.any()
    assert check(CONTROL.with_marks(np.zeros(len(CONTROL.point), bool))).doubts == ()


def test_a_common_shift_of_all_points_accuses_nobody_where_the_datum_is_not_known() -> None:
    moved = replace(CONTROL, p_enu=CONTROL.p_enu + np.array([1.8, -1.2, 0.0]))
    found = check(replace(moved, sigma_shared=np.array([2.0, 2.0, 0.0])))
    assert not found.suspect.any()


def test_points_without_height_are_checked_horizontally() -> None:
    sigma = CONTROL.sigma.copy()
    sigma[:4, 2] = np.inf
    p = CONTROL.p_enu.copy()
    p[:4, 2] = GROUND.z_at(p[:4, :2])
    found = check(replace(CONTROL, sigma=sigma, p_enu=p))
    assert not found.suspect.any()
