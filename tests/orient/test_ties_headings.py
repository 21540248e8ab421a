"""Turned pixels and poor headings are told from the pictures, and nothing else is touched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tie_flights as tf

from georef_gis.frames import exp_so3, rotation_angle
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Pose
from georef_gis.orient.ties import TieSettings, find_ties
from georef_gis.orient.ties.headings import with_turn

SETTINGS = TieSettings(max_side=640, max_features=800, observations=200)


def turned(shots: Sequence[tf.Shot], folder: Path, which: Sequence[int], degrees: int) -> tf.Flown:
    """A flight of which an editor turned some pictures clockwise and told nobody."""

    def change(picture: np.ndarray, index: int) -> np.ndarray:
        return np.rot90(picture, -degrees // 90) if index in which else picture

    flown = tf.fly(folder, shots, change=change)
    if degrees % 180:
        # The file has the other size, and its camera is read for that.
        for i in which:
            flown.photos[i] = replace(flown.photos[i], camera=tf.CAMERA.turned(degrees))
    return flown


def block() -> list[tf.Shot]:
    """Two strips there and back: five photos each, 60 % along and 60 % across."""
    there = [replace(s, x=s.x - 13.0) for s in tf.strip(5)]
    back = [replace(s, x=s.x + 13.0, yaw=s.yaw + 180.0) for s in tf.strip(5, seed=4)]
    return there + back


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_turned_pictures_are_found_and_no_others(degrees: int, tmp_path: Path) -> None:
    which = (1, 5, 6)
    flown = turned(block(), tmp_path, which, degrees)
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    found = {p.id: result.turns[p.id].quarter_deg for p in flown.photos}
    expected = {p.id: degrees if i in which else 0 for i, p in enumerate(flown.photos)}
    assert found == expected
    assert any(f"turned by {degrees} deg" in d and "photo_01" in d for d in result.doubts)
    # The pose for the turned picture shows each pixel where it is.
    i = which[0]
    mended = with_turn(flown.photos[i], result.turns[flown.photos[i].id])
    R = flown.truth[i].pose.R_enu_from_cam @ exp_so3([0.0, 0.0, -np.radians(degrees)])
    assert rotation_angle(R @ mended.pose.R_enu_from_cam.T) < np.radians(15.0)
    corner = np.array([10.0, 20.0])
    w, h = tf.CAMERA.width - 1, tf.CAMERA.height - 1
    turned_corner = {90: [h - 20.0, 10.0], 180: [w - 10.0, h - 20.0], 270: [20.0, w - 10.0]}
    a = tf.GROUND.intersect(*flown.truth[i].rays(corner))
    b = tf.GROUND.intersect(*mended.rays(np.array(turned_corner[degrees])))
    assert np.hypot(*(a - b)[:2]) < 15.0  # m: the tags' errors; unmended it is some 60 m


@pytest.mark.slow
def test_a_flight_turned_as_a_whole_is_told_by_the_positions(tmp_path: Path) -> None:
    flown = turned(block(), tmp_path, range(10), 180)
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert {t.quarter_deg for t in result.turns.values()} == {180}
    assert all(t.absolute for t in result.turns.values())


def without_heading(flown: tf.Flown, sigma: float, rng: np.random.Generator) -> list[OrientedPhoto]:
    """Tags with headings that are wrong by any angle, or by a sigma in rad."""
    out = []
    for photo in flown.photos:
        angle = sigma * rng.normal() if sigma < 1.0 else rng.uniform(-np.pi, np.pi)
        covariance = photo.pose.covariance.copy()
        covariance[5, 5] = sigma**2
        pose: Pose = replace(
            photo.pose,
            R_enu_from_cam=exp_so3([0.0, 0.0, angle]) @ photo.pose.R_enu_from_cam,
            covariance=covariance,
        )
        out.append(replace(photo, pose=pose))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("sigma_deg", [104.0, 15.0], ids=["none", "course"])
def test_headings_come_from_the_pictures_with_sigmas_that_hold(
    sigma_deg: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    normalised = []
    for seed in range(3):
        folder = tmp_path / str(seed)
        folder.mkdir()
        shots = tf.strip(6, seed=20 + seed, yaw=50.0 * seed)
        flown = tf.fly(folder, shots, seed=30 + seed)
        photos = without_heading(flown, np.radians(sigma_deg), rng)
        result = find_ties(photos, tf.GROUND, SETTINGS)
        for tagged, true in zip(photos, flown.truth, strict=True):
            turn = result.turns[tagged.id]
            assert turn.correct
            assert turn.quarter_deg == 0
            mended = with_turn(tagged, turn)
            normalised.append(tf.yaw_error(mended, true) / turn.sigma)
    # One common error per flight dominates: three flights bound it loosely.
    assert 0.2 < np.sqrt(np.mean(np.square(normalised))) < 2.0


def test_good_headings_are_left_alone(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(5))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert not any(t.is_change for t in result.turns.values())
    same = with_turn(flown.photos[0], result.turns["photo_00"]).pose
    assert np.allclose(same.R_enu_from_cam, flown.photos[0].pose.R_enu_from_cam, atol=1e-12)
