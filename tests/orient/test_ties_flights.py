"""Tie points of flights over a painted plane: the right places, in every kind of flight."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tie_flights as tf

from georef_gis.orient.ties import TieSettings, find_ties
from georef_gis.orient.ties.features import find_features, read_picture

SETTINGS = TieSettings(max_side=640, max_features=1200, observations=300)


def assert_right(flown: tf.Flown, result, *, least: int = 50) -> None:
    """Every photo has tie points, and they are where the truth has them."""
    seen = np.bincount(result.ties.photo, minlength=len(flown.photos))
    assert seen.min() >= least
    miss, sigma = flown.misses(result.ties)
    off = np.hypot(miss[:, 0], miss[:, 1])
    assert np.mean(off > 3.0) < 0.01  # share of wrong ones; 3 px is 8 sigma
    ratio = 1.4826 * np.median(np.abs(miss) / sigma[:, None])
    # error / sigma: the sigmas are those of real photos; a painted plane, sharp and flat, is better
    assert ratio < 1.0


@pytest.mark.parametrize("n", [2, 3, 5])
def test_few_photos_hang_together(n: int, tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(n))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [n]
    assert_right(flown, result)
    assert result.doubts == ()


def test_a_single_strip_of_eight_hangs_together(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(8, yaw=35.0))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [8]
    assert_right(flown, result, least=150)
    assert result.doubts == ()
    cells = np.floor((result.ties.uv + 0.5) / [160.0, 120.0]).astype(int) @ [4, 1]
    for i in range(1, 7):
        assert len(np.unique(cells[result.ties.photo == i])) >= 14  # of 16


def test_a_fifth_of_overlap_is_enough(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(4, overlap=0.2))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [4]
    assert_right(flown, result, least=25)


def test_photos_of_one_place_keep_their_headings(tmp_path: Path) -> None:
    """Their positions tell no direction: tags and pictures must not be set at odds."""
    shots = [tf.Shot(x=0.3 * i, y=0.0, height=50.0 + i, yaw=20.0 * i) for i in range(5)]
    flown = tf.fly(tmp_path, shots)
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [5]
    assert_right(flown, result, least=150)
    assert not any(t.is_change or t.absolute for t in result.turns.values())


def test_no_overlap_gives_no_ties_and_a_clear_word(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(4, overlap=-1.5))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert len(result.ties.photo) == 0
    assert result.ties.photo_ids == tuple(p.id for p in flown.photos)
    assert len(result.doubts) == 1
    assert "no two of the 4 photos overlap" in result.doubts[0]


def test_a_photo_of_something_else_is_named_and_left_out(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(5))
    other = np.rot90(tf.painted_ground(seed=9)[:640, :480])
    tf.save(flown.photos[2].photo.path, other.astype(np.float32))
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert not np.any(result.ties.photo == 2)
    assert any(d.startswith("photo_02: no tie points, though") for d in result.doubts)
    miss, _ = flown.misses(result.ties)
    assert np.mean(np.hypot(*miss.T) > 3.0) < 0.01


def test_blank_and_broken_photos_do_not_stop_the_rest(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(5, overlap=0.7))
    tf.save(flown.photos[0].photo.path, np.full((480, 640), 90.0, dtype=np.float32))
    flown.photos[4].photo.path.write_bytes(b"not a picture")
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [3]
    assert any("photo_04" in d and "no features" in d for d in result.doubts)
    assert any("photo_00" in d for d in result.doubts)


def hot_spot(picture: np.ndarray, index: int) -> np.ndarray:
    """Light that moves with the aircraft, and a sky that darkens: bright middle, dim rim."""
    v, u = np.mgrid[:480, :640].astype(np.float32)
    spot = 70.0 * np.exp(-((u - 150.0) ** 2 + (v - 330.0) ** 2) / (2 * 60.0**2))
    return 0.5 * picture * (1.0 - 0.0008 * u) * (1.0 - 0.08 * index) + spot


def bland(picture: np.ndarray, index: int) -> np.ndarray:
    """A bare field: a tenth of the contrast."""
    return 150.0 + 0.12 * (picture - 120.0)


def sixteen_bits(picture: np.ndarray, index: int) -> np.ndarray:
    """A sensor of 12 bits whose picture fills a part of 16."""
    return (800.0 + 4.0 * picture).astype(np.uint16)


def near_infrared(picture: np.ndarray, index: int) -> np.ndarray:
    """Bright and pale, strongly vignetted."""
    v, u = np.mgrid[:480, :640].astype(np.float32)
    return (190.0 + 0.3 * (picture - 120.0)) * (1.0 - 1e-6 * ((u - 320) ** 2 + (v - 240) ** 2) * 2)


@pytest.mark.parametrize(
    ("change", "suffix"),
    [(hot_spot, ".jpg"), (bland, ".png"), (sixteen_bits, ".tif"), (near_infrared, ".png")],
)
def test_light_and_sensor_do_not_matter(change: tf.Change, suffix: str, tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(4), change=change, suffix=suffix)
    result = find_ties(flown.photos, tf.GROUND, SETTINGS)
    assert [len(c) for c in result.components] == [4]
    miss, _ = flown.misses(result.ties)
    assert np.mean(np.hypot(*miss.T) > 3.0) < 0.02
    assert np.bincount(result.ties.photo, minlength=4).min() >= 50


def test_the_reduced_picture_gives_pixels_of_the_full_one(tmp_path: Path) -> None:
    """A rule of half a pixel mistaken would cancel between photos: hence the board."""
    flown = tf.fly(tmp_path, tf.strip(3, overlap=0.7), suffix=".jpg")
    full = find_ties(flown.photos, tf.GROUND, SETTINGS)
    half = find_ties(flown.photos, tf.GROUND, TieSettings(max_side=320, max_features=1500))
    miss, _ = flown.misses(half.ties)
    assert np.mean(np.hypot(*miss.T) > 5.0) < 0.04  # px; 100 matches of 320 x 240 px
    assert np.abs(np.median(miss, axis=0)).max() < 0.1  # px
    assert np.median(half.ties.sigma) > 1.7 * np.median(full.ties.sigma)
    # Against an independent place: saddles of a board painted into both scales.
    board = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((80, 80))) * 200.0 + 20.0
    tf.save(tmp_path / "board.png", cv2.GaussianBlur(board.astype(np.float32), (0, 0), 2.0))
    picture = read_picture(tmp_path / "board.png", width=640, height=480, max_side=320)
    uv = find_features(picture, max_features=2000).uv
    # Features of a symmetrical board mirror about its middle, which is (319.5, 239.5).
    mirrored = np.array([639.0, 479.0]) - uv
    gap = np.hypot(*(uv[:, None] - mirrored[None]).T).min(axis=0)
    assert np.median(gap) < 0.2  # px; a mistake of half a reduced pixel shifts it by 2


def test_a_search_is_stopped_from_outside_and_tells_its_progress(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(3))
    told: list[float] = []
    find_ties(flown.photos, tf.GROUND, SETTINGS, progress=lambda share, what: told.append(share))
    assert told == sorted(told)
    assert told[-1] == 1.0

    def stop(share: float, what: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_ties(flown.photos, tf.GROUND, SETTINGS, progress=stop)


def test_two_runs_give_the_same(tmp_path: Path) -> None:
    flown = tf.fly(tmp_path, tf.strip(3))
    a, b = (find_ties(flown.photos, tf.GROUND, SETTINGS).ties for _ in range(2))
    assert np.array_equal(a.uv, b.uv)
    assert np.array_equal(a.point, b.point)
