"""Rolling shutter: each row has its own time, and rays undo the projection."""

from __future__ import annotations

from dataclasses import replace

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.frames import exp_so3
from georef_gis.model.ground_point import locate
from georef_gis.model.terrain import FlatTerrain

PINHOLE = replace(cases.CAMERA, k1=0.0, k2=0.0, k3=0.0, p1=0.0, p2=0.0, readout_s=0.04)
FLAT = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6)


def test_by_hand_last_row_of_a_camera_flying_to_the_right() -> None:
    """20 m/s for 20 ms is 0.4 m: at 50 m and 1043.4 px the last row lies 8.35 px further left."""
    p = np.array([0.0, (863 - PINHOLE.cy) / PINHOLE.fy * 50.0, 50.0])
    uv = PINHOLE.project(p, velocity_cam=[20.0, 0.0, 0.0])
    assert uv == pytest.approx([PINHOLE.cx - 0.4 * 1043.4 / 50.0, 863.0], abs=1e-6)


def test_flying_along_the_rows_stretches_the_picture() -> None:
    """Camera moving to image down at 20 m/s: dv = -(v / 863 - 1 / 2) * 0.04 s * 20 m/s * f / z."""
    z = 50.0
    p = np.array([0.0, (863 - PINHOLE.cy) / PINHOLE.fy * z, z])
    v = float(PINHOLE.project(p, velocity_cam=[0.0, 20.0, 0.0])[1])
    shift = (v / 863 - 0.5) * 0.04 * 20.0 * 1043.4 / z
    assert v == pytest.approx(863.0 - shift, abs=1e-5)


def test_the_middle_row_is_exposed_in_the_middle() -> None:
    v = (PINHOLE.height - 1) / 2
    ray = PINHOLE.ray([200.0, v])
    moved = PINHOLE.project(40.0 * ray, velocity_cam=[20.0, 3.0, 1.0], rate_cam=[0.2, 0.3, 0.1])
    assert moved == pytest.approx([200.0, v], abs=1e-6)


def test_a_turning_camera_is_the_camera_turned_at_each_rows_time() -> None:
    rate = np.array([0.1, -0.4, 0.3])
    p = np.array([[8.0, 12.0, 50.0], [-20.0, -15.0, 60.0]])
    uv = PINHOLE.project(p, rate_cam=rate)
    t = PINHOLE.row_time(uv[:, 1])
    exact = np.array(
        [
            replace(PINHOLE, readout_s=0.0).project(exp_so3(-ti * rate) @ q)
            for q, ti in zip(p, t, strict=True)
        ]
    )
    # px: second order, (0.5 rad/s * 0.02 s)^2 / 2 * 1043 px = 0.05
    assert uv == pytest.approx(exact, abs=0.06)


def test_a_mechanical_shutter_ignores_the_motion() -> None:
    p = np.array([3.0, 2.0, 50.0])
    moved = cases.CAMERA.project(p, velocity_cam=[20.0, 0.0, 0.0])
    assert np.array_equal(moved, cases.CAMERA.project(p))


@pytest.fixture
def photo():
    return cases.oriented(
        (6.0, -9.0, 130.0),
        camera=cases.rolling(0.05),
        velocity_enu=np.array([12.0, -15.0, 1.5]),
        rate_enu=np.array([0.15, -0.25, 0.4]),
    )


def test_rays_are_the_inverse_of_the_projection(photo) -> None:
    uv = np.random.default_rng(7).uniform([0, 0], [1295, 863], size=(200, 2))
    origins, d = photo.rays(uv)
    assert np.linalg.norm(d, axis=1) == pytest.approx(np.ones(200), abs=1e-12)
    for distance in (30.0, 90.0):
        assert photo.project(origins + distance * d) == pytest.approx(uv, abs=1e-5)  # px
    assert np.array_equal(photo.ray(uv), d)


def test_each_row_starts_where_the_camera_was(photo) -> None:
    origins, _ = photo.rays(np.array([[600.0, 0.0], [600.0, 431.5], [600.0, 863.0]]))
    # m: 0.025 s * 19.3 m/s, and the turn acts on it at second order
    expected = np.array([-0.025, 0.0, 0.025])[:, None] * photo.pose.velocity_enu
    assert origins - photo.pose.origin_enu == pytest.approx(expected, abs=0.006)


def test_located_points_project_back_onto_their_pixels(photo) -> None:
    uv = np.array([[100.0, 20.0], [1200.0, 840.0], [640.0, 430.0]])
    p = locate(photo, uv, FLAT)
    assert photo.project(p) == pytest.approx(uv, abs=1e-4)
    still = cases.oriented((6.0, -9.0, 130.0))
    assert np.linalg.norm(locate(still, uv, FLAT) - p, axis=1)[:2].min() > 0.3  # m


def test_without_motion_rays_start_at_the_centre() -> None:
    still = cases.oriented(camera=cases.rolling(0.05))
    origins, d = still.rays(np.zeros((3, 2)))
    assert np.array_equal(origins, np.tile([0.0, 0.0, 60.0], (3, 1)))
    assert d == pytest.approx(still.pose.enu_directions(still.camera.ray(np.zeros((3, 2)))))
