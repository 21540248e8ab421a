"""Parts of the search for tie points: cache, pairs, loops, tracks."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
import tie_flights as tf

from georef_gis.orient.ties import TieSettings, find_ties
from georef_gis.orient.ties import find as find_module
from georef_gis.orient.ties.features import Features
from georef_gis.orient.ties.pairs import candidate_pairs, view_of
from georef_gis.orient.ties.tracks import tie_points
from georef_gis.orient.ties.verify import against_the_loops

SETTINGS = TieSettings(max_side=640, max_features=800, observations=200)


def test_features_are_read_once_and_again_when_a_photo_or_the_cache_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = tf.fly(tmp_path, tf.strip(2))
    cache = tmp_path / "cache"
    read: list[str] = []
    real = find_module.read_picture

    def spy(path: Path, **size: int) -> object:
        read.append(path.name)
        return real(path, **size)

    monkeypatch.setattr(find_module, "read_picture", spy)

    def run() -> tuple[np.ndarray, list[str]]:
        read.clear()
        ties = find_ties(flown.photos, tf.GROUND, SETTINGS, cache=cache).ties
        return ties.uv, sorted(read)

    first, names = run()
    assert names == ["photo_00.png", "photo_01.png"]
    again, names = run()
    assert names == []
    assert np.array_equal(first, again)
    kept = sorted(cache.iterdir())
    assert len(kept) == 2
    kept[0].write_bytes(kept[0].read_bytes()[:1000])
    assert len(run()[1]) == 1
    path = flown.photos[1].photo.path
    os.utime(path, ns=(1, 1))
    assert run()[1] == ["photo_01.png"]
    assert not list(cache.glob("*.part"))


def test_pairs_grow_with_the_photos_and_not_with_their_square() -> None:
    shots = [tf.Shot(x=20.0 * i, y=15.0 * j) for i in range(30) for j in range(30)]
    photos = [
        tf.OrientedPhoto(
            photo=tf.Photo(id=f"{k}", path=Path("none"), width=640, height=480),
            camera=tf.CAMERA,
            pose=shot.pose,
        )
        for k, shot in enumerate(shots)
    ]
    views = [view_of(p, tf.GROUND) for p in photos[:240]]
    few = candidate_pairs(photos[:240], views, neighbours=12)
    views += [view_of(p, tf.GROUND) for p in photos[240:]]
    start = time.process_time()
    many = candidate_pairs(photos, views, neighbours=12)
    assert time.process_time() - start < 10.0  # s
    assert len(many) < 900 * 12
    assert len(many) < 5.0 * len(few)
    # Neighbours in both directions are among them.
    keys = {(c.first, c.second) for c in many}
    assert {(400, 401), (400, 430)} <= keys


def test_a_pair_that_breaks_its_loops_is_refused() -> None:
    turn = {0: 0.1, 1: 0.4, 2: -0.3, 3: 1.2}
    pairs = [(i, j) for i in range(4) for j in range(i + 1, 4)]
    similarities = {(i, j): complex(np.exp(1j * (turn[j] - turn[i]))) for i, j in pairs}
    inliers = dict.fromkeys(pairs, 200)
    assert against_the_loops(similarities, inliers) == []
    similarities[1, 3] *= np.exp(1j * np.pi / 2)
    inliers[1, 3] = 30
    assert against_the_loops(similarities, inliers) == [(1, 3)]


def features_at(*places: tuple[float, float]) -> Features:
    n = len(places)
    return Features(
        uv=np.array(places, dtype=float).reshape(-1, 2),
        size=np.full(n, 2.0, dtype=np.float32),
        angle=np.zeros(n, dtype=np.float32),
        descriptors=np.zeros((n, 128), dtype=np.uint8),
        scale=1.0,
        width=640,
        height=480,
    )


def index(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.intp)


def test_matches_of_three_photos_become_one_point() -> None:
    features = [features_at((10, 10), (300, 200)) for _ in range(3)]
    matches = {
        (0, 1): (index(0, 1), index(0, 1)),
        (1, 2): (index(1, 0), index(1, 0)),
    }
    ties = tie_points(["a", "b", "c"], features, matches, observations=100)
    assert ties.n_points == 2
    assert np.bincount(ties.point).tolist() == [3, 3]


def test_two_features_at_one_place_are_one() -> None:
    features = [features_at((10, 10), (10, 10)), features_at((20, 20), (20, 20))]
    matches = {(0, 1): (index(0, 1), index(0, 1))}
    ties = tie_points(["a", "b"], features, matches, observations=100)
    assert ties.n_points == 1


def test_a_photo_stands_in_a_track_once() -> None:
    """Photo 0 and 1 agree on two points, which one wrong match with photo 2 joins."""
    features = [features_at((10, 10), (300, 200)) for _ in range(4)]
    right = (index(0, 1), index(0, 1))
    matches = {(0, 1): right, (0, 3): right, (1, 3): right}
    matches[1, 2] = (index(0), index(0))
    matches[0, 2] = (index(1), index(0))
    ties = tie_points(["a", "b", "c", "d"], features, matches, observations=100)
    seen = set(zip(ties.point.tolist(), ties.photo.tolist(), strict=True))
    assert len(seen) == len(ties.point)
    for point in range(ties.n_points):
        places = ties.uv[(ties.point == point) & (ties.photo != 2)]
        assert np.ptp(places, axis=0).max() == 0.0


def test_thinning_keeps_long_tracks_and_the_spread() -> None:
    rng = np.random.default_rng(2)
    places = [tuple(p) for p in rng.uniform([0, 0], [639, 479], (3000, 2))]
    features = [features_at(*places) for _ in range(3)]
    every = np.arange(3000)
    matches = {(0, 1): (every, every), (1, 2): (every[:240], every[:240])}
    ties = tie_points(["a", "b", "c"], features, matches, observations=300)
    seen = np.bincount(ties.photo)
    assert 250 <= seen[0] <= 800
    assert np.count_nonzero(np.bincount(ties.point) == 3) > 150
    cells = np.floor((ties.uv[ties.photo == 0] + 0.5) / 80.0).astype(int) @ [6, 1]
    assert len(np.unique(cells)) == 48  # of 8 x 6


def test_one_photo_and_none_have_no_ties() -> None:
    for photos in ([], [tf.OrientedPhoto(
        photo=tf.Photo(id="a", path=Path("none"), width=640, height=480),
        camera=tf.CAMERA,
        pose=tf.Shot(x=0.0, y=0.0).pose,
    )]):  # fmt: skip
        result = find_ties(photos, tf.GROUND)
        assert result.ties.n_points == 0
        assert "tie points need two photos" in result.doubts[0]
