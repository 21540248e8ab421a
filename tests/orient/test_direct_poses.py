"""Direct poses: levers, doubts, refusals and covariances of photos made by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import tag_cases as tags

from georef_gis.errors import MissingMetadataError
from georef_gis.frames import exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Mount
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.direct import (
    SIGMA_ANY_HEADING,
    SIGMA_CRAB,
    SIGMA_GNSS,
    SIGMA_LEVEL,
    DirectPose,
    DirectSettings,
    direct_poses,
)
from georef_gis.orient.heights import GroundSetting, solve_heights

GROUND = GroundSetting(dem=FlatTerrain(origin=tags.SITE, height_ellipsoidal=277.6))


def poses(
    photos: list, mount: Mount | None = None, *, sigma_v: float | None = None, **settings
) -> list[DirectPose]:
    heights = solve_heights(photos, tags.SITE, GROUND, sigma_v=sigma_v)
    return direct_poses(
        photos,
        tags.SITE,
        heights,
        mount or Mount(),
        DirectSettings(**settings),
        convergence_at=lambda p: 0.0,
    )


def one(attitude=None, mount: Mount | None = None, settings: dict | None = None, **photo):
    return poses([tags.photo("A", attitude=attitude, **photo)], mount, **(settings or {}))[0]


def sigmas(found: DirectPose) -> np.ndarray:
    assert found.pose is not None
    return np.sqrt(np.diag(found.pose.covariance))


LEVEL = tags.attitude("ypr")


def test_nadir_photo_stands_where_its_tag_says() -> None:
    found = one(LEVEL)
    assert found.pose.origin_enu == pytest.approx([0, 0, 60.0], abs=1e-6)
    assert found.height_above_ground == pytest.approx(60.0, abs=1e-6)
    assert found.pose.tilt == pytest.approx(0.0, abs=1e-6)
    assert found.doubts == ()


@pytest.mark.parametrize(
    ("yaw", "expected"), [(0.0, [0.02, 0.4, -0.2]), (90.0, [0.4, -0.02, -0.2])]
)
def test_lever_arm_leads_from_the_antenna_to_the_camera(yaw: float, expected: list) -> None:
    """Forward 0.4, right 0.02, down 0.2 m."""
    mount = Mount(
        lever_arm_body_camera=np.array([0.15, 0.02, 0.08]),
        lever_arm_body_antenna=np.array([-0.25, 0.0, -0.12]),
    )
    found = one(tags.attitude("ypr", yaw), mount)
    assert found.pose.origin_enu - [0, 0, 60.0] == pytest.approx(expected, abs=1e-6)


def test_a_tag_of_the_camera_needs_no_lever_arm() -> None:
    mount = Mount(lever_arm_body_antenna=np.array([-0.25, 0.0, -0.12]))
    found = one(LEVEL, mount, geotag=tags.geotag(of="camera"))
    assert found.pose.origin_enu == pytest.approx([0, 0, 60.0], abs=1e-6)


def test_the_lever_arm_hangs_on_the_body_not_on_the_camera() -> None:
    """A boresight turns the camera, not the rod between antenna and camera."""
    arm = np.array([1.0, 0.0, 0.0])
    straight = one(LEVEL, Mount(lever_arm_body_camera=arm))
    turned = one(LEVEL, Mount(lever_arm_body_camera=arm, boresight_body=np.radians([0, 0, 10.0])))
    assert turned.pose.origin_enu == pytest.approx(straight.pose.origin_enu, abs=1e-9)
    assert math.degrees(turned.pose.image_up_azimuth) == pytest.approx(10.0, abs=1e-6)


def test_no_attitude_is_level_with_a_doubt_and_a_sigma_to_match() -> None:
    photos = [tags.photo(f"P{i}", geotag=tags.geotag(20.0 * i, 0)) for i in range(3)]
    found = poses(photos)[1]
    assert math.degrees(found.pose.image_up_azimuth) == pytest.approx(90.0, abs=1e-2)
    assert sigmas(found)[3:] == pytest.approx([SIGMA_LEVEL, SIGMA_LEVEL, SIGMA_CRAB], rel=1e-6)
    assert any("no attitude" in d for d in found.doubts)
    assert any("course made good 90 deg" in d for d in found.doubts)


def test_a_lonely_photo_without_heading_is_laid_north_up() -> None:
    found = one(tags.attitude("drone-dji", None, -90.0))
    assert found.pose.image_up_azimuth == pytest.approx(0.0, abs=1e-9)
    assert sigmas(found)[5] == pytest.approx(SIGMA_ANY_HEADING)
    assert any("laid north-up" in d for d in found.doubts)


def test_the_photos_own_course_goes_before_the_neighbours() -> None:
    photos = [
        tags.photo(f"P{i}", geotag=tags.geotag(20.0 * i, 0), course=math.radians(45))
        for i in range(2)
    ]
    assert math.degrees(poses(photos)[0].pose.image_up_azimuth) == pytest.approx(45, abs=1e-2)


def test_yaw_source_course_overrules_the_tag() -> None:
    photos = [
        tags.photo(f"P{i}", geotag=tags.geotag(0, 20.0 * i), attitude=tags.attitude("ypr", 170.0))
        for i in range(2)
    ]
    assert poses(photos)[0].pose.image_up_azimuth == pytest.approx(math.radians(170), abs=1e-4)
    by_course = poses(photos, yaw_source="course")[0]
    assert by_course.pose.image_up_azimuth == pytest.approx(0.0, abs=1e-4)
    assert sigmas(by_course)[5] == pytest.approx(SIGMA_CRAB)


def test_a_yaw_that_is_a_course_has_the_crab_in_its_sigma() -> None:
    found = one(tags.attitude("sensefly", 20.0, yaw_is_course=True))
    assert sigmas(found)[5] >= SIGMA_CRAB


def test_sigmas_of_user_tag_and_table_in_this_order() -> None:
    tag = tags.attitude("ypr", sigma_roll_pitch=0.01, sigma_yaw=0.02)
    position = tags.geotag(sigma_h=0.5, sigma_v=0.7)
    s = sigmas(one(tag, geotag=position))
    assert s == pytest.approx([0.5, 0.5, 0.7, 0.01, 0.01, 0.02], rel=1e-6)
    settings = {"sigma_h": 0.1, "sigma_v": 0.2, "sigma_roll_pitch": 0.03, "sigma_yaw": 0.04}
    s = sigmas(one(tag, settings=settings, geotag=position))
    assert s == pytest.approx([0.1, 0.1, 0.2, 0.03, 0.03, 0.04], rel=1e-6)
    s = sigmas(one(LEVEL))
    assert s[0] == pytest.approx(SIGMA_GNSS)
    assert s[3:] == pytest.approx(np.radians([2.0, 2.0, 5.0]), rel=1e-6)


def test_datum_and_mount_add_to_the_sigmas() -> None:
    mount = Mount(sigma_lever_arm=0.3, sigma_boresight=0.03)
    tag = tags.attitude("ypr", sigma_roll_pitch=0.04, sigma_yaw=0.04)
    settings = {"sigma_h": 0.4, "sigma_v": 0.4, "sigma_datum": 1.2}
    s = sigmas(one(tag, mount, settings))
    assert s == pytest.approx([1.3, 1.3, 0.5, 0.05, 0.05, 0.05], rel=1e-6)


def test_the_lever_arm_carries_the_attitudes_error_into_the_place() -> None:
    """2 m ahead, heading north: 0.05 rad of yaw moves the camera 0.1 m west, and they agree."""
    mount = Mount(lever_arm_body_camera=np.array([2.0, 0.0, 0.0]))
    tag = tags.attitude("ypr", sigma_roll_pitch=1e-9, sigma_yaw=0.05)
    c = one(tag, mount, {"sigma_h": 1e-9, "sigma_v": 1e-9}).pose.covariance
    assert np.sqrt(c[0, 0]) == pytest.approx(0.1, rel=1e-6)
    assert c[0, 5] / np.sqrt(c[0, 0] * c[5, 5]) == pytest.approx(-1.0, abs=1e-6)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_photo_turned_by_an_editor_sees_the_same_ground(degrees: int) -> None:
    """Camera.turned and the pose turned back: a ground point falls on the turned pixel."""
    camera = Camera(
        id="c", width=1296, height=864, fx=1043, fy=1041, cx=657, cy=424, k1=-0.16, p1=6e-4
    )
    attitude = tags.attitude("ypr", 33.0, 4.0, -7.0)
    straight, turned = one(attitude), one(attitude, settings={"rotate_photos": {"A": degrees}})
    ground = np.array([8.0, -5.0, 0.0])
    u, v = camera.project(straight.pose.cam_from_enu(ground))
    w, h = camera.width, camera.height
    for _ in range(degrees // 90):
        u, v, w, h = h - 1 - v, u, h, w
    uv = camera.turned(degrees).project(turned.pose.cam_from_enu(ground))
    assert uv == pytest.approx([u, v], abs=1e-8)
    assert turned.turned_deg == degrees


def test_turning_by_file_name_is_the_same() -> None:
    by_name = one(LEVEL, settings={"rotate_photos": {"A.JPG": 180}})
    assert by_name.turned_deg == 180
    assert by_name.pose.R_enu_from_cam == pytest.approx(
        one(LEVEL).pose.R_enu_from_cam @ exp_so3([0, 0, math.pi]), abs=1e-12
    )


@pytest.mark.parametrize(
    ("photo", "field"),
    [
        ({"geotag": None}, "GPS"),
        ({"geotag": tags.geotag(height=None)}, "GPSAltitude"),
        ({"geotag": tags.geotag(height=279.0)}, "height"),
        ({"attitude": tags.attitude("drone-dji", 0.0, -5.0)}, "pitch"),
    ],
    ids=["no-gps", "no-height", "on-the-ground", "horizontal"],
)
def test_one_useless_photo_is_refused_and_the_others_go_on(photo: dict, field: str) -> None:
    good = tags.photo("good", attitude=LEVEL)
    bad = tags.photo("bad", **{"attitude": LEVEL, **photo})
    found = poses([good, bad, replace(good, id="other")])
    assert [p.pose is None for p in found] == [False, True, False]
    assert isinstance(found[1].refused, MissingMetadataError)
    assert found[1].refused.field == field
    assert "bad" in str(found[1].refused)


def test_heights_that_disagree_are_a_doubt_of_the_photo() -> None:
    photo = tags.photo("A", attitude=LEVEL, height_above_takeoff=120.0)
    assert any("check [gnss] height_kind" in d for d in poses([photo])[0].doubts)
