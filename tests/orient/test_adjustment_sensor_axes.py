"""Stored photos as the sensors saw them, and where their points start."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of
from adjustment_cases import BROWN, ORIGIN, oriented, pose_at

from georef_gis.errors import AdjustmentError
from georef_gis.model.camera import Camera
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.adjustment.build import (
    R_turned_from_sensor,
    first_places,
    sensor_views,
    uv_in_sensor,
)

FISHEYE = Camera(
    id="f", width=1200, height=800, fx=500.0, fy=500.0, cx=603.0, cy=398.0, model="fisheye",
    k1=0.02, k2=-0.004,
)  # fmt: skip
PIX4D = Camera(
    id="p", width=1200, height=800, fx=800.0, fy=800.0, cx=603.0, cy=398.0, model="fisheye_pix4d",
    poly=(0.01, -0.03),
)  # fmt: skip


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_turned_photo_sees_in_the_sensor_what_it_sees_itself(degrees: int) -> None:
    """Against `Camera.turned`, which knows nothing of poses; 1e-6 px."""
    sensor = oriented("a", BROWN, pose_at(0, 0, 90))
    R = sensor.pose.R_enu_from_cam @ R_turned_from_sensor(degrees).T
    turned = replace(
        sensor, camera=BROWN.turned(degrees), pose=replace(sensor.pose, R_enu_from_cam=R)
    )
    ground = np.array([[3.0, 8.0, 1.0], [-20.0, 11.0, 0.0], [25.0, -9.0, 2.0]])
    seen = turned.project(ground)
    assert np.all(np.isfinite(seen))
    back = uv_in_sensor(seen, BROWN.width, BROWN.height, degrees)
    np.testing.assert_allclose(back, sensor.project(ground), atol=1e-6)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_views_of_sensors_lead_back_to_the_stored_photo(degrees: int) -> None:
    stored = oriented("a", BROWN.turned(degrees), pose_at(4, -3, 80))
    views = sensor_views([stored], {"c": BROWN}, {"a": degrees})
    view = views.photos[0]
    assert view.camera == BROWN
    ground = np.array([[3.0, 8.0, 1.0], [-20.0, 11.0, 0.0], [15.0, -9.0, 2.0]])
    np.testing.assert_allclose(views.uv(0, stored.project(ground)), view.project(ground), atol=1e-6)
    back = views.stored_pose(0, view.pose).R_enu_from_cam
    np.testing.assert_allclose(back, stored.pose.R_enu_from_cam, atol=1e-12)


@pytest.mark.parametrize("camera", [FISHEYE, PIX4D], ids=["fisheye", "Pix4D"])
@pytest.mark.parametrize("degrees", [0, 90])
def test_a_fisheye_is_adjusted_through_a_pinhole_of_its_rays(camera: Camera, degrees: int) -> None:
    """Rays of the pinhole are those of the lens to 1e-6; half a pixel of noise stays half."""
    photo = oriented("a", camera.turned(degrees), pose_at(0, 0, 50))
    views = sensor_views([photo], {camera.id: camera}, {"a": degrees})
    assert views.held == (camera.id,)
    pinhole = views.cameras[0]
    assert pinhole.model == "brown"
    width, height = photo.camera.width, photo.camera.height
    # middle, and towards the corners
    uv = np.array([[0.5, 0.5], [0.55, 0.45], [0.2, 0.3], [0.9, 0.8]]) * [width, height]
    R = views.photos[0].pose.R_enu_from_cam
    np.testing.assert_allclose(pinhole.ray(views.uv(0, uv)) @ R.T, photo.ray(uv), atol=1e-6)
    ties = TiePoints(
        photo_ids=("a", "b"), photo=np.zeros(4, np.int32), point=np.arange(4, dtype=np.int32),
        uv=uv, sigma=np.full(4, 0.5),
    )  # fmt: skip
    found = views.observations(ties).sigma
    area = []
    for place in uv:
        J = [
            (views.uv(0, (place + d)[None]) - views.uv(0, (place - d)[None]))[0] for d in np.eye(2)
        ]
        area.append(0.5 * np.sqrt(abs(np.linalg.det(J)) / 4.0))
    np.testing.assert_allclose(found, area, rtol=0.05)


def test_points_start_where_the_rays_meet_the_ground() -> None:
    """Within the navigation's error at 90 m: some decimetres and 0.2 deg."""
    flight = sim.strip(3, 4, relief=0.1)
    ground = FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)
    first = first_places(block_of(flight), ground)
    assert np.abs(first - flight.points).max() < 12.0
    assert np.median(np.linalg.norm(first - flight.points, axis=1)) < 4.0


def test_photos_that_look_at_the_sky_are_told() -> None:
    flight = sim.two_photos(1)
    block = block_of(flight)
    up = [replace(p, R_enu_from_cam=np.diag([1.0, -1, -1]) @ p.R_enu_from_cam) for p in block.poses]
    ground = FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)
    with pytest.raises(AdjustmentError, match="no photo looks at the ground"):
        first_places(replace(block, poses=tuple(up)), ground)
