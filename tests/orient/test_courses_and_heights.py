"""Course made good, and where the ground lies under the cameras, branch by branch."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest
import tag_cases as tags

from georef_gis.errors import InputError
from georef_gis.geodesy import Height, HeightKind, MapFrame, geoid_undulation, parse_crs
from georef_gis.model.terrain import FlatTerrain, dem_terrain
from georef_gis.orient.direct import courses_over_ground
from georef_gis.orient.heights import (
    SIGMA_GNSS_HEIGHT,
    SIGMA_RELATIVE_HEIGHT,
    GroundSetting,
    heights_above_ground,
    solve_heights,
    tag_height,
)

ORTHOMETRIC, UNKNOWN = HeightKind.ORTHOMETRIC, HeightKind.UNKNOWN


def track(*places: tuple[float, float], **more) -> list:
    return [
        tags.photo(f"P{i}", geotag=tags.geotag(e, n), **more) for i, (e, n) in enumerate(places)
    ]


def courses_deg(photos: list) -> dict[str, float]:
    found = courses_over_ground(photos, tags.SITE)
    return {k: math.degrees(v) % 360 for k, v in found.items()}


def test_course_of_a_straight_line_east() -> None:
    found = courses_deg(track((0, 0), (20, 0), (40, 0)))
    assert found == pytest.approx({"P0": 90.0, "P1": 90.0, "P2": 90.0}, abs=1e-3)


def test_a_slight_bend_takes_the_mean_of_both_legs() -> None:
    s = 20 * math.sin(math.radians(20)), 20 + 20 * math.cos(math.radians(20))
    assert courses_deg(track((0, 0), (0, 20), s))["P1"] == pytest.approx(10.0, abs=1e-2)


def test_at_the_end_of_a_line_the_turn_does_not_count() -> None:
    found = courses_deg(track((0, 0), (0, 20), (0, 40), (60, 45), (60, 25), (60, 5)))
    assert math.cos(math.radians(found["P2"])) == pytest.approx(1.0, abs=1e-9)
    assert found["P3"] == pytest.approx(180.0, abs=1e-3)


@pytest.mark.parametrize("clock", ["camera", "gps"])
def test_the_clocks_tell_a_turn_that_is_shorter_than_a_leg(clock: str) -> None:
    """Crossing lines: 18 m and ten seconds of turn lie between the legs of 30 m."""
    photos = track((0, 0), (30, 0), (45, -10), (45, 20))
    start = datetime(2009, 6, 20, 20)
    timed = []
    for p, s in zip(photos, (0, 1, 12, 13), strict=True):
        when = {"camera_clock": start + timedelta(seconds=s)}
        timed.append(replace(p, **(when if clock == "camera" else {"time_gps": float(s)})))
    found = courses_deg(timed)
    assert found["P1"] == pytest.approx(90.0, abs=1e-3)
    assert math.cos(math.radians(found["P2"])) == pytest.approx(1.0, abs=1e-9)


def test_hovering_and_lonely_photos_have_no_course() -> None:
    assert courses_deg(track((0, 0), (1, 0), (2, 0))) == {}
    assert courses_deg(track((0, 0))) == {}


def test_flights_are_not_joined_and_photos_without_gps_are_passed_over() -> None:
    first = track((0, 0), (0, 20))
    other = [replace(p, id=f"Q{p.id}", flight_id="two") for p in track((50, 0), (70, 0))]
    lost = tags.photo("lost", geotag=None)
    found = courses_deg([first[0], lost, first[1], *other])
    assert set(found) == {"P0", "P1", "QP0", "QP1"}
    assert math.cos(math.radians(found["P1"])) == pytest.approx(1.0, abs=1e-9)


def flown(heights: list[float | None], kind: HeightKind, relative: list[float | None]) -> list:
    return [
        tags.photo(
            f"P{i}",
            geotag=tags.geotag(20.0 * i, 0, h, kind),
            height_above_takeoff=r,
        )
        for i, (h, r) in enumerate(zip(heights, relative, strict=True))
    ]


def test_tag_heights_by_kind() -> None:
    n = float(geoid_undulation(tags.SITE.lat, tags.SITE.lon))
    assert tag_height(tags.photo(), None) == 337.6
    sea = tags.photo(geotag=tags.geotag(height=371.0, kind=ORTHOMETRIC))
    assert tag_height(sea, None) == pytest.approx(371.0 + n, abs=1e-6)
    assert n == pytest.approx(-33.4, abs=0.1)
    unknown = tags.photo(geotag=tags.geotag(kind=UNKNOWN))
    assert tag_height(unknown, None) is None
    # The user's word goes before the tag's.
    assert tag_height(unknown, HeightKind.ELLIPSOIDAL) == 337.6
    assert tag_height(tags.photo(geotag=None), None) is None
    assert tag_height(tags.photo(geotag=tags.geotag(height=None)), None) is None


def test_the_users_height_above_ground_goes_first() -> None:
    photos = flown([337.0, 338.0, 339.0], HeightKind.ELLIPSOIDAL, [50.0, 51.0, 52.0])
    found = solve_heights(photos, tags.SITE, GroundSetting(height_above_ground=60.0))
    assert found.cameras == {"P0": 337.0, "P1": 338.0, "P2": 339.0}
    assert found.terrain.z_at([0, 0]) == pytest.approx(278.0 - 277.6, abs=1e-3)
    assert found.terrain.sigma == pytest.approx(3.0)


def test_the_users_height_holds_where_no_tag_has_a_known_height() -> None:
    photos = flown([100.0, 110.0, None], UNKNOWN, [None, None, None])
    found = solve_heights(photos, tags.SITE, GroundSetting(height_above_ground=60.0, sigma=1.0))
    n = float(geoid_undulation(tags.SITE.lat, tags.SITE.lon))
    expected = [100.0 + n, 110.0 + n, 105.0 + n]
    assert list(found.cameras.values()) == pytest.approx(expected, abs=1e-6)
    assert found.terrain.z_at([0, 0]) == pytest.approx(105.0 + n - 60.0 - 277.6, abs=1e-3)


def test_known_ground_with_known_tag_heights() -> None:
    photos = flown([337.0, 338.0], HeightKind.ELLIPSOIDAL, [None, None])
    ground = GroundSetting(height=Height(value=310.985, kind=ORTHOMETRIC))
    found = solve_heights(photos, tags.SITE, ground)
    assert found.cameras == {"P0": 337.0, "P1": 338.0}
    assert found.sigma["P0"] == SIGMA_GNSS_HEIGHT
    assert found.terrain.z_at([0, 0]) == pytest.approx(0.0, abs=0.1)
    assert not found.doubts


def test_over_a_dem_without_known_heights_those_above_take_off_count() -> None:
    photos = flown([500.0, 500.0], UNKNOWN, [60.0, 61.0])
    dem = FlatTerrain(origin=tags.SITE, height_ellipsoidal=280.0)
    found = solve_heights(photos, tags.SITE, GroundSetting(dem=dem))
    assert found.cameras == pytest.approx({"P0": 340.0, "P1": 341.0}, abs=1e-3)
    assert any("take-off" in doubt for doubt in found.doubts)


def test_two_heights_that_disagree_are_doubtful() -> None:
    photos = flown([337.0, 371.0], HeightKind.ELLIPSOIDAL, [57.0, 57.0])
    dem = FlatTerrain(origin=tags.SITE, height_ellipsoidal=280.0)
    found = solve_heights(photos, tags.SITE, GroundSetting(dem=dem))
    assert set(found.photo_doubts) == {"P1"}
    assert "91 m" in found.photo_doubts["P1"]
    assert "57 m" in found.photo_doubts["P1"]


def test_known_ground_but_no_height_of_the_cameras_is_refused() -> None:
    photos = flown([337.0], UNKNOWN, [None])
    dem = FlatTerrain(origin=tags.SITE, height_ellipsoidal=280.0)
    with pytest.raises(InputError, match="height_kind"):
        solve_heights(photos, tags.SITE, GroundSetting(dem=dem))


def test_a_dem_elsewhere_is_refused() -> None:
    frame = MapFrame(tags.SITE, parse_crs("EPSG:32617"))
    dem = dem_terrain(frame, np.full((4, 4), 280.0), left=0, top=0, cell=(1, 1), metres_per_unit=1)
    photos = flown([337.0], HeightKind.ELLIPSOIDAL, [60.0])
    with pytest.raises(InputError, match="CRS and extent"):
        solve_heights(photos, tags.SITE, GroundSetting(dem=dem))


def test_take_off_level_is_the_median_and_the_barometer_gives_the_shape() -> None:
    photos = flown([337.0, 341.0, 345.0], HeightKind.ELLIPSOIDAL, [60.0, 61.0, 62.0])
    found = solve_heights(photos, tags.SITE, GroundSetting())
    # Differences are 277, 280, 283.
    assert found.cameras == {"P0": 340.0, "P1": 341.0, "P2": 342.0}
    assert set(found.sigma.values()) == {SIGMA_RELATIVE_HEIGHT}
    assert found.terrain.z_at([0, 0]) == pytest.approx(280.0 - 277.6, abs=1e-3)


def test_heights_of_unknown_kind_still_lie_above_take_off() -> None:
    photos = flown([198.0, 199.0], UNKNOWN, [40.0, 41.0])
    found = solve_heights(photos, tags.SITE, GroundSetting())
    assert "unknown kind" in found.source
    origins = tags.SITE.enu_from_geo(
        [[p.geotag.lat, p.geotag.lon, found.cameras[p.id]] for p in photos]
    )
    assert heights_above_ground(origins, found.terrain) == pytest.approx([40, 41], abs=1e-3)


def test_no_height_above_anything_is_refused() -> None:
    with pytest.raises(InputError, match="height_above_ground_m"):
        solve_heights(flown([337.0], UNKNOWN, [None]), tags.SITE, GroundSetting())


def test_a_logged_height_above_ground_goes_before_take_off() -> None:
    photo = tags.photo("A", height_above_takeoff=50.0, height_above_ground=60.0)
    found = solve_heights([photo], tags.SITE, GroundSetting())
    assert found.terrain.z_at([0, 0]) == pytest.approx(337.6 - 60.0 - 277.6, abs=1e-3)
