"""The two real folders: seneca16 (senseFly, Canon) and brighton_beach (DJI Phantom 3)."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from georef_gis.ingest.photos import ReadResult, find_photos, read_photos

TURNED = {f"DJI_00{n}" for n in range(24, 30)}


@pytest.fixture(scope="module")
def brighton(data: Path) -> ReadResult:
    return read_photos(find_photos(data / "brighton_beach" / "photos"), workers=2)


@pytest.fixture(scope="module")
def seneca(data: Path) -> ReadResult:
    return read_photos(find_photos(data / "seneca16" / "photos"))


def test_brighton_photos_turned_in_a_viewer_are_doubtful(brighton: ReadResult) -> None:
    doubtful = {photo.id for photo in brighton.photos if photo.doubts}
    assert doubtful == TURNED
    for photo in brighton.photos:
        for doubt in photo.doubts:
            assert doubt.startswith(f"{photo.path.name}: [EXIF:Software] photo viewer")
            assert "[attitude] rotate_photos" in doubt


def test_brighton_focal_length_by_the_diagonal_rule(brighton: ReadResult) -> None:
    (camera,) = brighton.cameras.values()
    assert camera.fx == pytest.approx(2311.25, abs=0.1)
    assert (camera.cx, camera.cy) == (1999.5, 1124.5)
    assert camera.sigma_f == pytest.approx(0.02 * camera.fx, rel=0.3)
    assert brighton.doubts == ()


def test_brighton_photos_look_down_with_gimbal_and_flight_yaw(brighton: ReadResult) -> None:
    assert len(brighton.photos) == 18
    assert brighton.refused == ()
    for photo in brighton.photos:
        assert photo.attitude is not None
        assert photo.attitude.dialect == "drone-dji"
        assert math.degrees(photo.attitude.pitch) == pytest.approx(-89.95, abs=0.06)
        assert photo.attitude.vehicle_yaw is not None
        assert photo.height_above_takeoff == pytest.approx(40.0, abs=0.5)
        assert photo.geotag is not None
        assert photo.geotag.height is not None
        assert photo.geotag.height.kind == "unknown"


def test_seneca_is_taken_as_resized_and_says_so(seneca: ReadResult) -> None:
    (camera,) = seneca.cameras.values()
    assert camera.fx == pytest.approx(2497.7, abs=0.1)
    # the crop, 2775 px, lies within three sigma
    assert 3.0 * camera.sigma_f > 2775.3 - camera.fx
    (doubt,) = seneca.doubts
    assert "4000 x 3000" in doubt
    assert "focal_px = 2775" in doubt


def test_seneca_heights_are_ellipsoidal_and_yaw_is_a_course(seneca: ReadResult) -> None:
    first = seneca.photos[0]
    assert first.id == "IMG_0474"
    assert first.geotag is not None
    assert first.geotag.height is not None
    assert first.geotag.height.value == pytest.approx(286.01999)
    assert first.geotag.height.kind == "ellipsoidal"
    assert first.attitude is not None
    assert first.attitude.yaw_is_course
    assert math.degrees(first.attitude.yaw or 0.0) == pytest.approx(63.1959, abs=1e-4)
    assert math.degrees(first.attitude.pitch) == pytest.approx(8.7583, abs=1e-4)
    assert first.height_above_takeoff == pytest.approx(73.4236, abs=1e-4)
    assert first.ground_speed == 5.25


def test_seneca_clock_is_behind_utc_by_four_hours_and_34_seconds(seneca: ReadResult) -> None:
    from georef_gis.units import utc_from_gps

    for photo in seneca.photos:
        assert photo.time_gps is not None
        assert photo.camera_clock is not None
        offset = utc_from_gps(photo.time_gps).replace(tzinfo=None) - photo.camera_clock
        assert offset.total_seconds() == pytest.approx(4 * 3600 + 34, abs=1.0)
    assert all(photo.doubts == () for photo in seneca.photos)
