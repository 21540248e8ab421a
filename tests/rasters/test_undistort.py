"""Undistorted photos: the map against OpenCV's, straight lines, tags, whole files."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import piexif
import pytest
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.model.camera import Camera
from georef_gis.rasters.reading import read_image
from georef_gis.rasters.undistort import (
    overlay,
    pinhole_of,
    undistort_image,
    undistort_map,
    undistort_photo,
)

BROWN = Camera(
    id="b", width=1203, height=901, fx=900.0, fy=896.0, cx=611.0, cy=442.0,
    k1=-0.12, k2=0.05, k3=-0.01, p1=7e-4, p2=-5e-4,
)  # fmt: skip
SKEW = replace(BROWN, b1=3.0, b2=-2.5)
FISHEYE = Camera(
    id="f", width=1200, height=900, fx=700.0, fy=702.0, cx=604.0, cy=446.0, model="fisheye",
    k1=0.02, k2=-0.005,
)  # fmt: skip
# the direction of the 2012 paper, scaled to the size
INVERSE = replace(BROWN, model="brown_inverse", k1=0.1, k2=-0.05, k3=0.0)
CAMERAS = [BROWN, SKEW, FISHEYE, INVERSE]
NAMES = ["brown", "skew", "fisheye", "inverse"]


def test_the_map_is_opencvs_for_brown_and_for_fisheye() -> None:
    for camera in (BROWN, FISHEYE):
        pinhole = pinhole_of(camera)
        K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        P = np.array([[pinhole.fx, 0, pinhole.cx], [0, pinhole.fy, pinhole.cy], [0, 0, 1.0]])
        size = (camera.width, camera.height)
        if camera.model == "brown":
            d = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
            theirs = cv2.initUndistortRectifyMap(K, d, None, P, size, cv2.CV_32FC1)
        else:
            d = np.array([camera.k1, camera.k2, camera.k3, camera.k4])
            theirs = cv2.fisheye.initUndistortRectifyMap(K, d, np.eye(3), P, size, cv2.CV_32FC1)
        for own, other in zip(undistort_map(camera, pinhole), theirs, strict=True):
            assert np.abs(own - other).max() < 0.03  # px


@pytest.mark.parametrize("camera", CAMERAS, ids=NAMES)
def test_the_map_is_exact_to_a_fiftieth_of_a_pixel(camera: Camera) -> None:
    pinhole = pinhole_of(camera)
    u, v = undistort_map(camera, pinhole)
    rng = np.random.default_rng(0)
    col, row = rng.integers(0, camera.width, 500), rng.integers(0, camera.height, 500)
    ray = np.column_stack([(col - pinhole.cx) / pinhole.fx, (row - pinhole.cy) / pinhole.fy])
    exact = camera.project(np.column_stack([ray, np.ones(500)]))
    got = np.column_stack([u[row, col], v[row, col]])
    assert np.abs(got - exact).max() < 0.021  # px


@pytest.mark.parametrize("camera", CAMERAS, ids=NAMES)
def test_inside_has_no_empty_pixel_and_all_leaves_nothing_out(camera: Camera) -> None:
    u, v = undistort_map(camera, pinhole_of(camera, keep="inside"))
    assert u.min() > -1.0 and v.min() > -1.0  # noqa: PT018
    assert u.max() < camera.width and v.max() < camera.height  # noqa: PT018
    whole = pinhole_of(camera, keep="all")
    places = whole.project(camera.ray(camera.border_uv()))
    assert places.min() > -1.5
    assert np.all(places.max(axis=0) < [camera.width + 0.5, camera.height + 0.5])


@pytest.mark.parametrize("camera", CAMERAS, ids=NAMES)
def test_a_straight_line_of_the_world_is_straight_afterwards(camera: Camera) -> None:
    pinhole = pinhole_of(camera)
    t = np.linspace(-0.3, 0.3, 400)
    line = np.column_stack([t, 0.28 + 0.1 * t, np.ones_like(t)])
    uv = camera.project(line)
    bend = np.polyval(np.polyfit(uv[:, 0], uv[:, 1], 1), uv[:, 0]) - uv[:, 1]
    assert np.abs(bend).max() > 1.0  # px; the photo bends it
    photo = np.zeros((camera.height, camera.width), np.uint8)
    cv2.polylines(photo, [np.round(uv * 256).astype(np.int32)], False, 255, 5, cv2.LINE_AA, 8)
    flat = undistort_image(photo[..., None], undistort_map(camera, pinhole))[..., 0].astype(float)
    cols = np.flatnonzero(flat.sum(axis=0) > 500)[20:-20]
    rows = (flat[:, cols] * np.arange(camera.height)[:, None]).sum(axis=0) / flat[:, cols].sum(
        axis=0
    )
    expected = pinhole.cy + pinhole.fy * (0.28 + 0.1 * (cols - pinhole.cx) / pinhole.fx)
    assert np.abs(rows - expected).max() < 0.3  # px; half a pixel or a wrong centre would show


def jpeg_with_tags(path: Path, camera: Camera) -> NDArray[np.uint8]:
    rng = np.random.default_rng(1)
    small = rng.integers(0, 255, (30, 40, 3), dtype=np.uint8)
    image = cv2.resize(small, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    raw = cv2.imencode(".jpg", image)[1].tobytes()
    exif = piexif.dump(
        {
            "0th": {piexif.ImageIFD.Make: b"Maker", piexif.ImageIFD.Orientation: 6},
            "Exif": {piexif.ExifIFD.DateTimeOriginal: b"2026:11:01 10:00:00"},
            "GPS": {
                piexif.GPSIFD.GPSLatitudeRef: b"N",
                piexif.GPSIFD.GPSLatitude: ((39, 1), (57, 1), (4012345, 100000)),
                piexif.GPSIFD.GPSLongitudeRef: b"W",
                piexif.GPSIFD.GPSLongitude: ((83, 1), (1, 1), (12, 1)),
            },
        }
    )
    stream = io.BytesIO()
    piexif.insert(exif, raw, stream)
    packet = (
        b'http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
        b'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:GimbalYawDegree="+12.5" '
        b'drone-dji:DewarpData="2020-01-01;900,900,0,0,-0.1,0,0,0,0" drone-dji:DewarpFlag="0"/>'
        b"</rdf:RDF></x:xmpmeta>"
    )
    raw = stream.getvalue()
    segment = b"\xff\xe1" + (len(packet) + 2).to_bytes(2, "big") + packet
    at = 4 + int.from_bytes(raw[4:6], "big")
    path.write_bytes(raw[:at] + segment + raw[at:])
    return image


def test_a_copy_keeps_exif_gps_and_xmp_but_no_calibration(tmp_path: Path) -> None:
    source, target = tmp_path / "a.jpg", tmp_path / "out.jpg"
    jpeg_with_tags(source, BROWN)
    maps = undistort_map(BROWN, pinhole_of(BROWN))
    before = source.read_bytes()
    assert undistort_photo(source, target, maps) == ()
    assert source.read_bytes() == before
    old, new = (piexif.load(str(p)) for p in (source, target))
    assert new["GPS"] == old["GPS"]
    assert new["0th"] == old["0th"]
    assert new["Exif"] == old["Exif"]
    raw = target.read_bytes()
    assert b'GimbalYawDegree="+12.5"' in raw
    assert b"Dewarp" not in raw
    expected = undistort_image(read_image(source), maps).astype(float)
    assert np.abs(read_image(target) - expected).mean() < 2.0  # grey values of 255
    assert [p.name for p in tmp_path.iterdir() if p.name not in ("a.jpg", "out.jpg")] == []


def test_sixteen_bits_stay_sixteen_bits(tmp_path: Path) -> None:
    image = np.random.default_rng(2).integers(0, 60000, (901, 1203), dtype=np.uint16)
    source, target = tmp_path / "a.tif", tmp_path / "b.tif"
    cv2.imwrite(str(source), image)
    doubts = undistort_photo(source, target, undistort_map(BROWN, pinhole_of(BROWN)))
    assert read_image(target).dtype == np.uint16
    assert any("tags" in d for d in doubts)


def test_unfit_input_leaves_no_file(tmp_path: Path) -> None:
    source = tmp_path / "a.jpg"
    jpeg_with_tags(source, BROWN)
    other = replace(BROWN, width=600, height=450)
    maps = undistort_map(other, pinhole_of(other))
    with pytest.raises(InputError, match="1203 x 901"):
        undistort_photo(source, tmp_path / "b.jpg", maps)
    maps = undistort_map(BROWN, pinhole_of(BROWN))
    with pytest.raises(InputError, match="original"):
        undistort_photo(source, source, maps)
    with pytest.raises(InputError, match="no kind of file"):
        undistort_photo(source, tmp_path / "b.gif", maps)
    assert [p.name for p in tmp_path.iterdir()] == ["a.jpg"]


def test_the_overlay_shows_the_shift_of_the_corners() -> None:
    image = np.full((BROWN.height, BROWN.width, 3), 120, np.uint8)
    picture = overlay(image, BROWN, pinhole_of(BROWN), width=800)
    assert picture.shape[1:] == (800, 3)
    assert picture.shape[0] > round(901 * 800 / 1203)
    # both colours of lines, thin and softened
    yellow = (picture[..., 0] > 180) & (picture[..., 1] > 160) & (picture[..., 2] < 100)
    assert yellow.sum() > 1000
