"""What all heights of a surface err by together: by hand, and of blocks that move as a whole."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "orient"))

from adjustment_flights import many, oriented_photos

from georef_gis.frames import Array, skew
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.scene import Scene
from georef_gis.measure.surface.common_errors import CommonErrors, common_errors
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import FlatTerrain

ORIGIN = Origin(lat=0.68, lon=-1.4, height_ellipsoidal=280.0)
FRAME = MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon))
Modes = Callable[[Sequence[OrientedPhoto]], Array]


def places(n: int, width: float, length: float) -> Array:
    """Along a line to the north-east, m."""
    rng = np.random.default_rng(3)
    t = rng.uniform(-0.5, 0.5, (n, 2)) * [length, width]
    return np.asarray(t @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + [40.0, -25.0])


def quadratic(xy: Array) -> Array:
    x, y = xy.T / 100.0
    return np.column_stack([np.ones(len(xy)), x, y, x * x, x * y, y * y])


def test_a_quadratic_error_is_kept_as_it_is() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    covariance = root @ root.T
    known, asked = places(36, 120.0, 200.0), places(9, 100.0, 150.0)
    B, A = quadratic(known), quadratic(asked)
    found = CommonErrors.through(known, B @ covariance @ B.T)
    dense = A @ covariance @ A.T
    assert found.sigma_at(asked) == pytest.approx(np.sqrt(np.diag(dense)))
    weights = rng.uniform(0.0, 5.0, 9)
    assert found.sigma_of_sum(asked, weights) == pytest.approx(np.sqrt(weights @ dense @ weights))
    rise = dense[0, 0] + np.diag(dense) - 2.0 * dense[0]
    assert found.sigma_of_rise(asked, asked[0]) == pytest.approx(np.sqrt(rise), abs=1e-6)
    raised = found.raised(2.0)
    assert raised.sigma_at(asked) == pytest.approx(np.sqrt(np.diag(dense) + 4.0))
    assert raised.sigma_of_rise(asked, asked[0]) == pytest.approx(np.sqrt(rise), abs=1e-6)


def test_a_strip_is_not_bent_across() -> None:
    """Places 400 m along a line and 8 m beside it tell nothing of what is 200 m beside it."""
    known = places(36, 8.0, 400.0)
    covariance = 0.5**2 * np.eye(36)
    found = CommonErrors.through(known, covariance)
    beside = np.array([[40.0 - 120.0, -25.0 + 160.0]])
    assert float(found.sigma_at(beside)[0]) < 0.5


def test_a_shift_is_the_same_everywhere() -> None:
    shift = CommonErrors.level(0.3)
    assert shift.sigma_at([[0.0, 0.0], [1e4, 1e4]]) == pytest.approx([0.3, 0.3])
    assert shift.sigma_of_sum(places(5, 10.0, 10.0), np.array([1.0, 2, 3, -1, -5])) == 0.0


def moved(modes: Modes) -> CommonErrors:
    """Of a block whose poses all err by the same modes, (6 n, k); the camera is known."""
    photos = [
        replace(p, camera=replace(p.camera, sigma_f=0.0, sigma_c=0.0))
        for p in oriented_photos(many(1, 24, 40.0))
    ]
    terrain = FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0)
    n = len(photos)
    scene = Scene.of(FRAME, terrain, photos, covariance=modes(photos) @ modes(photos).T)
    low, high = (f(scene.photos.origin_enu[:, :2], axis=0) for f in (np.min, np.max))
    ground = np.random.default_rng(1).uniform(low, high, (400, 2))
    found = common_errors(scene, np.arange(n), np.column_stack([ground, np.zeros(400)]))
    assert found is not None
    return found


def test_a_block_that_rises_takes_its_ground_along() -> None:
    """All cameras 2 m too low: so is the ground, everywhere."""

    def up(photos: Sequence[OrientedPhoto]) -> Array:
        return 2.0 * np.tile([0.0, 0, 1, 0, 0, 0], len(photos))[:, None]

    found = moved(up)
    assert found.sigma_at([[0.0, 0.0], [60.0, 40.0]]) == pytest.approx([2.0, 2.0], rel=1e-3)


def test_a_block_that_turns_tilts_its_ground() -> None:
    """A rotation of 0.01 rad about the axis to the north: 1 m in 100 m to the east."""

    def turned(photos: Sequence[OrientedPhoto]) -> Array:
        axis = np.array([0.0, 1.0, 0.0])
        rows = [
            np.concatenate([-skew(p.pose.origin_enu) @ axis, axis]) for p in photos
        ]  # fmt: skip
        return 0.01 * np.concatenate(rows)[:, None]

    found = moved(turned)
    to_east = found.sigma_of_rise(np.array([[60.0, 0.0]]), np.array([-40.0, 0.0]))
    to_north = found.sigma_of_rise(np.array([[0.0, 60.0]]), np.array([0.0, -40.0]))
    assert float(to_east[0]) == pytest.approx(1.0, rel=1e-3)
    assert float(to_north[0]) < 1e-3


def test_photos_of_one_side_tell_no_heights() -> None:
    photos = oriented_photos(many(1, 24, 40.0))[:1]
    terrain = FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0)
    scene = Scene.of(FRAME, terrain, photos)
    p = np.append(scene.photos.origin_enu[0, :2], 0.0)
    ground = p + np.random.default_rng(1).uniform(-20, 20, (50, 3)) * [1, 1, 0]
    assert common_errors(scene, np.arange(1), ground) is None
