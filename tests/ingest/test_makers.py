"""Tags of 32 makers' photos, from exiftool's JSON and from files written with the same tags."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from makers import MAKERS, Expected

from georef_gis.errors import MissingMetadataError
from georef_gis.ingest.cameras import camera_for
from georef_gis.ingest.photos import photo_from_tags, read_photo
from georef_gis.ingest.tags import tags_from_exiftool_json
from georef_gis.model.photo import AttitudeTag, Photo

Metadata = Mapping[str, dict[str, object]]
ids = pytest.mark.parametrize(("name", "expected"), MAKERS.items(), ids=list(MAKERS))


def photo_of(record: dict[str, object], name: str) -> Photo:
    return photo_from_tags(tags_from_exiftool_json(record), Path(f"{name}.jpg"))


def degrees_of(attitude: AttitudeTag) -> tuple[float, float, float]:
    assert attitude.yaw is not None
    r, p, y = (math.degrees(v) for v in (attitude.roll, attitude.pitch, attitude.yaw))
    return r, p, y


def test_every_maker_has_an_expectation(metadata: Metadata) -> None:
    assert set(metadata) == set(MAKERS)


@ids
def test_attitude_is_that_of_the_dialect(metadata: Metadata, name: str, expected: Expected) -> None:
    attitude = photo_of(metadata[name], name).attitude
    if expected.dialect is None:
        assert attitude is None
        return
    assert attitude is not None
    assert attitude.dialect == expected.dialect
    assert degrees_of(attitude) == pytest.approx(expected.rpy, abs=1e-4)
    if expected.vehicle_yaw is not None:
        assert attitude.vehicle_yaw is not None
        assert math.degrees(attitude.vehicle_yaw) == pytest.approx(expected.vehicle_yaw, abs=1e-4)


@ids
def test_place_and_kind_of_height(metadata: Metadata, name: str, expected: Expected) -> None:
    photo = photo_of(metadata[name], name)
    if expected.position is None:
        assert photo.geotag is None
        return
    tag = photo.geotag
    assert tag is not None
    # 1e-7 deg = 11 mm, the rounding of the expected values
    at = (math.degrees(tag.lat), math.degrees(tag.lon))
    assert at == pytest.approx(expected.position, abs=1e-7)
    assert photo.height_above_takeoff == expected.above_takeoff
    if expected.height is None:
        assert tag.height is None
    else:
        assert tag.height is not None
        assert tag.height.value == pytest.approx(expected.height, abs=1e-3)
        assert tag.height.kind == expected.kind


@ids
def test_focal_length(metadata: Metadata, name: str, expected: Expected) -> None:
    photo = photo_of(metadata[name], name)
    size = (photo.width, photo.height)
    if expected.focal is None:
        with pytest.raises(MissingMetadataError, match=r"\[camera\] focal_px"):
            camera_for(photo.tags, size, source=name)
        return
    camera = camera_for(photo.tags, size, source=name).camera
    assert camera.fx == pytest.approx(expected.focal[0], abs=expected.focal[1])
    assert expected.focal[2] in camera.source
    assert (camera.width, camera.height) == size


@ids
def test_doubts_are_named(metadata: Metadata, name: str, expected: Expected) -> None:
    doubts = photo_of(metadata[name], name).doubts
    for words in expected.doubts:
        assert any(words in doubt for doubt in doubts), (words, doubts)
    assert all(doubt.startswith(f"{name}.jpg: [") for doubt in doubts)


CLEAN = ["dji__dji_phantom4", "parrot__Sequoia_RGB", "sensefly__senseFly_SODA_rtk"]


@pytest.mark.parametrize("name", CLEAN)
def test_a_good_photo_has_no_doubts(metadata: Metadata, name: str) -> None:
    assert photo_of(metadata[name], name).doubts == ()


@pytest.mark.parametrize("as_elements", [False, True], ids=["attributes", "elements"])
@pytest.mark.parametrize("name", list(MAKERS))
def test_file_gives_what_the_json_gives(
    metadata: Metadata, photo_file: Callable[..., Path], name: str, *, as_elements: bool
) -> None:
    record = metadata[name]
    tiff = record["File:FileType"] == "TIFF"
    told = photo_of(record, name)
    size = (told.width, told.height)
    path = photo_file(
        f"{name}{'.tif' if tiff else '.jpg'}", tags=record, size=size, as_elements=as_elements
    )
    read = read_photo(path)
    assert (read.width, read.height) == size
    same_attitude(read.attitude, told.attitude)
    same_place(read, told)
    assert read.camera_clock == told.camera_clock
    assert read.time_source == told.time_source
    assert read.time_gps == pytest.approx(told.time_gps, abs=1e-5)
    assert (read.make, read.model) == (told.make, told.model)


def same_attitude(a: AttitudeTag | None, b: AttitudeTag | None) -> None:
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert (a.dialect, a.yaw_is_course) == (b.dialect, b.yaw_is_course)
        # MakerNote angles are single precision
        assert degrees_of(a) == pytest.approx(degrees_of(b), abs=1e-5)


def same_place(a: Photo, b: Photo) -> None:
    assert (a.geotag is None) == (b.geotag is None)
    if a.geotag is not None and b.geotag is not None:
        # 1e-9 rad = 6 mm: EXIF seconds
        assert (a.geotag.lat, a.geotag.lon) == pytest.approx((b.geotag.lat, b.geotag.lon), abs=1e-9)
        assert (a.geotag.height is None) == (b.geotag.height is None)
        assert (a.geotag.sigma_h, a.geotag.sigma_v) == (b.geotag.sigma_h, b.geotag.sigma_v)
        if a.geotag.height and b.geotag.height:
            assert a.geotag.height.kind == b.geotag.height.kind
            assert a.geotag.height.value == pytest.approx(b.geotag.height.value, abs=1e-5)
    assert a.ground_speed == pytest.approx(b.ground_speed, abs=1e-3)
