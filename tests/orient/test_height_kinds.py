"""Heights over the ground and over the ellipsoid: two sigmas, and words for what they rest on."""

from __future__ import annotations

import math

import numpy as np
import pytest
import tag_cases as tags

from georef_gis.frames import R_BODY_FROM_CAM_NADIR
from georef_gis.geodesy import Height, HeightKind, MapFrame, geoid_undulation, parse_crs
from georef_gis.model.camera import Camera
from georef_gis.model.ground_point import ground_point_covariance, locate
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Mount, Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.direct import SIGMA_GNSS, DirectSettings, direct_poses
from georef_gis.orient.heights import (
    NO_LEVEL,
    OVER_GROUND,
    SIGMA_GNSS_HEIGHT,
    SIGMA_NO_LEVEL,
    SIGMA_RELATIVE_HEIGHT,
    GroundSetting,
    Heights,
    solve_heights,
)
from georef_gis.project.records import pose_of, pose_row

ELLIPSOIDAL, ORTHOMETRIC = HeightKind.ELLIPSOIDAL, HeightKind.ORTHOMETRIC
UNKNOWN = HeightKind.UNKNOWN
N = float(geoid_undulation(tags.SITE.lat, tags.SITE.lon))


def flown(kind: HeightKind, height: float = 337.6, above: float | None = 60.0, **more) -> list:
    """Three photos 20 m apart; one height in the tag, one above take-off."""
    return [
        tags.photo(
            f"P{i}",
            geotag=tags.geotag(20.0 * i, 0, height, kind, **more),
            attitude=tags.attitude("ypr"),
            height_above_takeoff=above,
        )
        for i in range(3)
    ]


def posed(photos: list, heights: Heights, **settings) -> list[Pose]:
    found = direct_poses(
        photos, tags.SITE, heights, Mount(), DirectSettings(**settings),
        convergence_at=lambda p: 0.0,
    )  # fmt: skip
    return [one.pose for one in found if one.pose is not None]


def test_height_of_unknown_kind_is_sure_over_the_ground_only() -> None:
    photos = flown(UNKNOWN)
    heights = solve_heights(photos, tags.SITE, GroundSetting())
    pose = posed(photos, heights)[0]
    assert np.sqrt(pose.covariance[2, 2]) == pytest.approx(SIGMA_RELATIVE_HEIGHT)
    # Half of the 33 m between geoid and ellipsoid, and the receiver.
    assert pose.sigma_height_shared == pytest.approx(math.hypot(SIGMA_GNSS_HEIGHT, N / 2))
    assert pose.sigma_height == pytest.approx(math.sqrt(1.0 + 25.0 + N * N / 4))
    assert "unknown" in pose.height_kind
    assert "orthometric" in pose.height_kind
    assert any("[gnss] height_kind" in doubt for doubt in heights.doubts)


def test_height_of_unknown_kind_is_taken_as_exif_defines_it() -> None:
    photos = flown(UNKNOWN)
    heights = solve_heights(photos, tags.SITE, GroundSetting())
    assert heights.cameras["P0"] == pytest.approx(337.6 + N, abs=1e-6)
    assert isinstance(heights.terrain, FlatTerrain)
    assert heights.terrain.height_ellipsoidal == pytest.approx(337.6 + N - 60.0, abs=1e-6)


@pytest.mark.parametrize("kind", [ELLIPSOIDAL, ORTHOMETRIC])
def test_height_of_stated_kind_has_the_receivers_sigma(kind: HeightKind) -> None:
    photos = flown(kind)
    heights = solve_heights(photos, tags.SITE, GroundSetting())
    pose = posed(photos, heights)[0]
    assert np.sqrt(pose.covariance[2, 2]) == pytest.approx(SIGMA_RELATIVE_HEIGHT)
    assert pose.sigma_height_shared == pytest.approx(SIGMA_GNSS_HEIGHT)
    assert pose.height_kind.startswith(str(kind))
    assert heights.doubts == ()


def test_sigma_of_the_tags_or_the_user_is_that_of_the_level() -> None:
    """An RTK height of 2 cm does not make the barometer's height above take-off better."""
    photos = flown(ELLIPSOIDAL, sigma_v=0.02)
    by_tag = posed(photos, solve_heights(photos, tags.SITE, GroundSetting()))[0]
    assert by_tag.sigma_height_shared == pytest.approx(0.02)
    assert by_tag.sigma_height == pytest.approx(1.0, abs=1e-3)
    by_user = posed(photos, solve_heights(photos, tags.SITE, GroundSetting(), sigma_v=0.3))[0]
    assert by_user.sigma_height_shared == pytest.approx(0.3)
    assert np.sqrt(by_user.covariance[2, 2]) == pytest.approx(SIGMA_RELATIVE_HEIGHT)


def test_height_given_by_the_user_says_nothing_of_the_level() -> None:
    """One sigma of 5 m in all: what three photos have in common is with the level."""
    ground = GroundSetting(height_above_ground=60.0)
    known = solve_heights(flown(ELLIPSOIDAL, above=None), tags.SITE, ground)
    assert known.sigma["P0"] == pytest.approx(SIGMA_GNSS_HEIGHT * math.sqrt(2 / 3))
    assert known.sigma_shared == pytest.approx(SIGMA_GNSS_HEIGHT * math.sqrt(1 / 3))
    unknown = solve_heights(flown(UNKNOWN, above=None), tags.SITE, ground)
    assert unknown.sigma == known.sigma
    assert unknown.sigma_shared == pytest.approx(math.hypot(known.sigma_shared, N / 2))


@pytest.mark.parametrize("kind", [ELLIPSOIDAL, UNKNOWN])
def test_under_a_stated_height_the_tags_keep_their_differences(kind: HeightKind) -> None:
    """Flown at 55, 60 and 85 m: 60 m is the usual height, not that of every photo."""
    photos = [
        tags.photo(f"P{i}", geotag=tags.geotag(20.0 * i, 0, 280.0 + above, kind))
        for i, above in enumerate((55.0, 60.0, 85.0))
    ]
    heights = solve_heights(photos, tags.SITE, GroundSetting(height_above_ground=60.0))
    assert isinstance(heights.terrain, FlatTerrain)
    above = [h - heights.terrain.height_ellipsoidal for h in heights.cameras.values()]
    assert above == pytest.approx([55.0, 60.0, 85.0], abs=1e-9)
    assert not heights.photo_doubts


def test_under_a_stated_height_the_receivers_sigma_is_that_of_each_photo() -> None:
    ground = GroundSetting(height_above_ground=60.0)
    by_tag = solve_heights(flown(ELLIPSOIDAL, above=None, sigma_v=3.0), tags.SITE, ground)
    assert by_tag.sigma["P0"] == pytest.approx(3.0 * math.sqrt(2 / 3))
    photos = flown(ELLIPSOIDAL, above=None)
    by_user = solve_heights(photos, tags.SITE, ground, sigma_v=20.0)
    pose = posed(photos, by_user)[0]
    assert pose.sigma_height == pytest.approx(20.0)
    assert by_user.sigma["P0"] == pytest.approx(20.0 * math.sqrt(2 / 3))


def test_the_sigma_of_a_stated_height_is_that_of_the_ground_below() -> None:
    for above, sigma in ((20.0, 2.0), (60.0, 3.0)):
        ground = GroundSetting(height_above_ground=above)
        heights = solve_heights(flown(ELLIPSOIDAL, above=None), tags.SITE, ground)
        assert heights.terrain.sigma == pytest.approx(sigma)


def test_under_a_stated_height_only_a_photo_without_any_height_takes_it() -> None:
    photos = flown(ELLIPSOIDAL, 350.0, None)
    lost = tags.photo("lost", geotag=tags.geotag(60.0, 0, None))
    ground = GroundSetting(height_above_ground=70.0)
    heights = solve_heights([*photos, lost], tags.SITE, ground)
    assert heights.cameras["lost"] == pytest.approx(350.0)
    assert heights.sigma["lost"] == pytest.approx(3.5 * math.sqrt(3 / 4))
    alone = solve_heights([lost], tags.SITE, ground)
    assert alone.cameras["lost"] == pytest.approx(70.0)
    assert alone.sigma["lost"] == SIGMA_RELATIVE_HEIGHT


def test_under_a_stated_height_the_barometer_gives_the_shape() -> None:
    """Heights above take-off on a hill: their differences hold, their zero does not."""
    photos = [
        tags.photo(f"P{i}", geotag=tags.geotag(20.0 * i, 0, h), height_above_takeoff=r)
        for i, (h, r) in enumerate(((337.0, 20.0), (341.0, 21.0), (345.0, 22.0)))
    ]
    heights = solve_heights(photos, tags.SITE, GroundSetting(height_above_ground=60.0))
    assert heights.cameras == pytest.approx({"P0": 340.0, "P1": 341.0, "P2": 342.0})
    assert set(heights.sigma.values()) == {SIGMA_RELATIVE_HEIGHT}
    assert heights.sigma_shared == pytest.approx(SIGMA_GNSS_HEIGHT)


def test_a_height_far_from_the_stated_one_is_doubtful() -> None:
    photos = flown(ELLIPSOIDAL, above=None)
    high = tags.photo("high", geotag=tags.geotag(60.0, 0, 437.6))
    heights = solve_heights([*photos, high], tags.SITE, GroundSetting(height_above_ground=60.0))
    assert set(heights.photo_doubts) == {"high"}
    assert "160 m" in heights.photo_doubts["high"]


def test_errors_of_200_flights_fit_a_stated_height() -> None:
    """Error/sigma over the ellipsoid and the ground: a receiver with white and slow errors."""
    rng = np.random.default_rng(41)
    absolute, relative = [], []
    flying = np.array([55.0, 58.0, 60.0, 60.0, 63.0, 85.0])
    for _ in range(200):
        error = rng.normal(0, 2.0) + rng.normal(0, 1.5, 6)
        stated = 60.0 + rng.normal(0, 3.0)
        photos = [
            tags.photo(f"P{i}", geotag=tags.geotag(20.0 * i, 0, 280.0 + h, sigma_v=2.5))
            for i, h in enumerate(flying + error)
        ]
        heights = solve_heights(photos, tags.SITE, GroundSetting(height_above_ground=stated))
        assert isinstance(heights.terrain, FlatTerrain)
        own = np.array(list(heights.sigma.values()))
        z = np.array(list(heights.cameras.values()))
        absolute.append((z - 280.0 - flying) / np.hypot(own, heights.sigma_shared))
        off = z - heights.terrain.height_ellipsoidal - flying
        relative.append(off / np.hypot(own, heights.terrain.sigma))
    assert 0.7 < np.sqrt(np.mean(np.square(absolute))) < 1.4
    assert 0.7 < np.sqrt(np.mean(np.square(relative))) < 1.4


def test_over_ground_of_known_height_nothing_is_shared() -> None:
    ground = GroundSetting(dem=FlatTerrain(origin=tags.SITE, height_ellipsoidal=277.6))
    tagged = solve_heights(flown(ELLIPSOIDAL), tags.SITE, ground)
    assert tagged.sigma_shared == 0.0
    assert tagged.sigma["P0"] == SIGMA_GNSS_HEIGHT
    assert set(tagged.kinds.values()) == {"ellipsoidal"}
    above = solve_heights(flown(UNKNOWN), tags.SITE, ground)
    assert above.sigma_shared == 0.0
    assert set(above.kinds.values()) == {OVER_GROUND}


@pytest.mark.parametrize(
    "photos", [flown(UNKNOWN, 60.03), flown(HeightKind.ABOVE_GROUND, 60.0), flown(UNKNOWN, None)],
    ids=["repeats the relative height", "above ground", "no height"],
)  # fmt: skip
def test_without_any_absolute_height_the_sigma_says_so(photos: list) -> None:
    heights = solve_heights(photos, tags.SITE, GroundSetting())
    assert heights.sigma_shared == SIGMA_NO_LEVEL
    assert set(heights.kinds.values()) == {NO_LEVEL}
    assert any("not to be used" in doubt for doubt in heights.doubts)
    agl = posed(photos, heights)[0].origin_enu[2] - heights.terrain.z_at([0.0, 0.0])
    assert agl == pytest.approx(60.0, abs=0.01)


def test_settings_of_the_ground_that_are_not_used_are_named() -> None:
    dem = FlatTerrain(origin=tags.SITE, height_ellipsoidal=277.6)
    both = GroundSetting(dem=dem, height=Height(value=250.0, kind=ELLIPSOIDAL))
    assert any("height_m" in d for d in solve_heights(flown(ELLIPSOIDAL), tags.SITE, both).doubts)
    over = GroundSetting(dem=dem, height_above_ground=50.0)
    assert any("dem" in d for d in solve_heights(flown(ELLIPSOIDAL), tags.SITE, over).doubts)


def test_errors_of_200_flights_fit_both_sigmas() -> None:
    """Error/sigma of heights, each flight with its own receiver, barometer and ground."""
    rng = np.random.default_rng(40)
    absolute, relative = [], []
    for _ in range(200):
        receiver, camera = rng.normal(0, SIGMA_GNSS_HEIGHT), rng.normal(0, SIGMA_RELATIVE_HEIGHT)
        photos = flown(ELLIPSOIDAL, 337.6 + receiver, 60.0)
        heights = solve_heights(photos, tags.SITE, GroundSetting())
        pose = posed(photos, heights)[0]
        # The truth: 337.6 m, over a ground that lies `camera` off from where the barometer says.
        absolute.append((pose.origin_enu[2] - 60.0) / pose.sigma_height)
        above = pose.origin_enu[2] - float(heights.terrain.z_at([0.0, 0.0]))
        relative.append((above - 60.0 + camera) / np.sqrt(pose.covariance[2, 2]))
    assert 0.7 < np.sqrt(np.mean(np.square(absolute))) < 1.4
    assert 0.7 < np.sqrt(np.mean(np.square(relative))) < 1.4


def test_the_shared_height_scales_no_distance() -> None:
    """A ground point's plan sigma holds the camera over the ground, not the level of both."""
    terrain = FlatTerrain(origin=tags.SITE, height_ellipsoidal=277.6, sigma=1.5)
    camera = Camera(id="c", width=1000, height=1000, fx=1000, fy=1000, cx=499.5, cy=499.5)
    covariances = []
    for shared in (0.0, 17.0):
        pose = Pose(
            origin_enu=np.array([0.0, 0.0, 60.0]), R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
            covariance=np.eye(6), sigma_height_shared=shared,
        )  # fmt: skip
        photo = OrientedPhoto(photo=tags.photo(), camera=camera, pose=pose)
        p = locate(photo, [900.0, 499.5], terrain)
        covariances.append(ground_point_covariance(photo, p, terrain))
    assert covariances[1] == pytest.approx(covariances[0], abs=1e-12)


def test_a_pose_keeps_both_sigmas_and_the_words_in_the_database() -> None:
    frame = MapFrame(tags.SITE, parse_crs("EPSG:32617"))
    photos = flown(UNKNOWN)
    pose = posed(photos, solve_heights(photos, tags.SITE, GroundSetting()))[0]
    row = pose_row("P0", pose, frame, height_above_ground=60.0, dialect="ypr", doubts=())
    again = pose_of(row)
    assert again.sigma_height_shared == pose.sigma_height_shared
    assert again.height_kind == pose.height_kind
    assert row["sigma_v_m"] == pytest.approx(pose.sigma_height)
    assert row["extra"]["height_kind"] == pose.height_kind
    assert row["extra"]["sigma_height_absolute_m"] == pytest.approx(pose.sigma_height)
    assert row["extra"]["sigma_height_over_ground_m"] == pytest.approx(SIGMA_RELATIVE_HEIGHT)


def test_the_datums_sigma_enters_east_and_north_once() -> None:
    photos = flown(ELLIPSOIDAL)
    heights = solve_heights(photos, tags.SITE, GroundSetting())
    pose = posed(photos, heights, sigma_datum=2.0)[0]
    without = posed(photos, heights)[0]
    assert np.diag(pose.covariance)[:2] == pytest.approx([SIGMA_GNSS**2 + 4.0] * 2)
    assert pose.sigma_height == without.sigma_height


@pytest.mark.parametrize("sigma", [-1.0, math.nan, math.inf])
def test_a_pose_refuses_a_shared_sigma_that_is_none(sigma: float) -> None:
    with pytest.raises(ValueError, match="sigma_height_shared"):
        Pose(
            origin_enu=np.zeros(3), R_enu_from_cam=R_BODY_FROM_CAM_NADIR, covariance=np.eye(6),
            sigma_height_shared=sigma,
        )  # fmt: skip
