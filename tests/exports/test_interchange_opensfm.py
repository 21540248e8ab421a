"""OpenSfM's reconstruction.json: projections by its own formulas, frames, round trips."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from interchange_cases import CAMERAS, PLACES, make_block_site, points_before, tie_points
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from exports.poses.opensfm import write_opensfm
from georef_gis.errors import InputError
from georef_gis.ingest.poses import read_poses
from georef_gis.model.interchange.opensfm import (
    blocks_from_opensfm,
    camera_from_opensfm,
    camera_to_opensfm,
    tracks_lines,
)


def theirs_normalised(camera: dict, p: np.ndarray) -> np.ndarray:
    """A point in camera axes as OpenSfM projects it, from `camera_functions.h`."""
    kind = camera.get("projection_type", "perspective")
    if kind in ("fisheye", "fisheye_opencv"):
        theta = math.atan2(math.hypot(p[0], p[1]), p[2])
        direction = np.array(p[:2]) / math.hypot(p[0], p[1])
        k = [camera.get(f"k{i}", 0.0) for i in (1, 2, 3, 4)]
        xy = direction * theta * (1 + sum(c * theta ** (2 * i + 2) for i, c in enumerate(k)))
    else:
        x, y = p[0] / p[2], p[1] / p[2]
        r2 = x * x + y * y
        k1, k2, k3, p1, p2 = (camera.get(n, 0.0) for n in ("k1", "k2", "k3", "p1", "p2"))
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        xy = np.array(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
            ]
        )
    focal = [camera.get("focal_x", camera.get("focal")), camera.get("focal_y", camera.get("focal"))]
    return focal * xy + [camera.get("c_x", 0.0), camera.get("c_y", 0.0)]


def pixels(camera: dict, normalised: np.ndarray) -> np.ndarray:
    """`features.denormalized_image_coordinates`: (0, 0) is the centre of the first pixel."""
    w, h = camera["width"], camera["height"]
    return normalised * max(w, h) - 0.5 + np.array([w, h]) / 2.0


@pytest.mark.parametrize("name", CAMERAS)
def test_their_formulas_give_our_pixels(name: str) -> None:
    camera = CAMERAS[name]
    points = points_before(camera)
    found = camera_to_opensfm(camera)
    uv = np.array([pixels(found, theirs_normalised(found, p)) for p in points])
    assert uv == pytest.approx(camera.project(points), abs=1e-6)
    back = camera_from_opensfm("x", json.loads(json.dumps(found)), "test")
    assert back.project(points) == pytest.approx(camera.project(points), abs=1e-9)


@pytest.mark.parametrize(
    "given",
    [
        {"projection_type": "perspective", "focal": 0.9, "k1": -0.1, "k2": 0.02},
        {"focal": 0.9, "k1": -0.1, "k2": 0.02},
        {"projection_type": "simple_radial", "focal_x": 0.9, "focal_y": 0.91, "c_x": 0.01,
         "c_y": -0.02, "k1": -0.1},
        {"projection_type": "radial", "focal_x": 0.9, "focal_y": 0.91, "c_x": 0.01, "c_y": -0.02,
         "k1": -0.1, "k2": 0.01},
        {"projection_type": "fisheye", "focal": 0.5, "k1": 0.03, "k2": -0.01},
    ],
)  # fmt: skip
def test_projections_that_we_do_not_write_are_read(given: dict) -> None:
    given = given | {"width": 640, "height": 480}
    camera = camera_from_opensfm("x", given, "test")
    points = points_before(camera)
    uv = [pixels(given, theirs_normalised(given, p)) for p in points]
    assert camera.project(points) == pytest.approx(np.array(uv), abs=1e-6)


def test_projections_that_are_not_ours_are_refused_by_name() -> None:
    size = {"width": 640, "height": 480}
    for kind in ("dual", "fisheye62", "spherical"):
        with pytest.raises(InputError, match=f"'{kind}' is not known"):
            camera_from_opensfm("x", {"projection_type": kind, "focal": 1.0} | size, "test")
    with pytest.raises(InputError, match="skew b2 = 2 px"):
        camera_to_opensfm(replace(CAMERAS["k3"], b2=2.0))
    with pytest.raises(InputError, match="no model like 'fisheye_pix4d'"):
        camera_to_opensfm(replace(CAMERAS["fisheye"], model="fisheye_pix4d"))


@pytest.mark.parametrize("place", PLACES)
def test_shots_lie_where_our_poses_do(tmp_path: Path, place: str) -> None:
    site = make_block_site(place)
    report = write_opensfm(site, tmp_path / "r.json")
    assert report.height_kind == "ellipsoidal"
    (one,) = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    lla = one["reference_lla"]
    assert -180.0 <= lla["longitude"] <= 180.0
    # The frame of OpenSfM's geo.py by PROJ's own topocentric conversion.
    to_enu = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lon_0={lla['longitude']!r} +lat_0={lla['latitude']!r} +h_0={lla['altitude']!r}"
    )
    for photo in site.photos:
        shot = one["shots"][photo.photo.path.name]
        R = Rotation.from_rotvec(shot["rotation"]).as_matrix()
        centre = -R.T @ shot["translation"]
        lat, lon, h = site.frame.origin.geo_from_enu(photo.pose.origin_enu)
        enu = to_enu.transform(math.degrees(lon), math.degrees(lat), h)
        # m; by way of ecef, 6.4e6 m
        assert centre == pytest.approx(enu, abs=1e-6)
        assert R.T == pytest.approx(photo.pose.R_enu_from_cam, abs=1e-12)
        p = photo.pose.origin_enu + 80.0 * photo.pose.R_enu_from_cam @ [0.1, -0.2, 1.0]
        camera = one["cameras"][shot["camera"]]
        uv = pixels(camera, theirs_normalised(camera, R @ p + shot["translation"]))
        own = site.cameras[0].project(photo.pose.cam_from_enu(p))
        assert uv == pytest.approx(own, abs=1e-6)


def angles_of(site, one) -> np.ndarray:
    """R_ned_from_body of a camera that looks down, level at the photo; scipy and PROJ only."""
    lat, lon, _ = site.frame.origin.geo_from_enu(one.pose.origin_enu)
    local = Rotation.from_euler("ZY", [lon, -lat - math.pi / 2]).as_matrix()
    o = site.frame.origin
    enu = Rotation.from_euler("ZY", [o.lon, -o.lat - math.pi / 2]).as_matrix() @ [
        [0, 1, 0], [1, 0, 0], [0, 0, -1],
    ]  # fmt: skip
    nadir = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return local.T @ enu @ one.pose.R_enu_from_cam @ nadir.T


@pytest.mark.parametrize("place", PLACES)
def test_poses_come_back_with_their_sigmas(tmp_path: Path, place: str) -> None:
    site = make_block_site(place)
    write_opensfm(site, tmp_path / "reconstruction.json")
    poses = read_poses(tmp_path / "reconstruction.json")
    for one in site.photos:
        geotag, attitude = poses[one.photo.path.name]
        lat, lon, h = site.frame.origin.geo_from_enu(one.pose.origin_enu)
        # rad; 1e-11 is 0.06 mm
        assert (geotag.lat, math.remainder(geotag.lon - lon, 2 * math.pi)) == pytest.approx(
            (lat, 0.0), abs=1e-11
        )
        assert geotag.height is not None
        assert geotag.height.value == pytest.approx(h, abs=1e-6)
        assert (geotag.height.kind, geotag.of) == ("ellipsoidal", "camera")
        c = one.pose.covariance
        up = math.sqrt(c[2, 2] + one.pose.sigma_height_shared**2)
        # The place is level 2 km off: 0.02 deg.
        assert geotag.sigma_v == pytest.approx(up, rel=2e-3)
        assert geotag.sigma_h == pytest.approx(math.sqrt((c[0, 0] + c[1, 1]) / 2), rel=2e-3)
        assert attitude is not None
        found = Rotation.from_euler("ZYX", [attitude.yaw, attitude.pitch, attitude.roll])
        off = Rotation.from_matrix(angles_of(site, one)).inv() * found
        assert off.magnitude() < 1e-9
        assert attitude.sigma_yaw is not None
        assert 0.3 < attitude.sigma_yaw / math.sqrt(c[5, 5]) < 3.0


def test_points_and_tracks_are_the_adjusted_ones(tmp_path: Path) -> None:
    site = make_block_site()
    ties, ground = tie_points(site)
    write_opensfm(site, tmp_path / "r.json", ties=ties, points=ground)
    (one,) = json.loads((tmp_path / "r.json").read_text())
    assert len(one["points"]) == len(ground)
    assert one["points"]["3"]["coordinates"] == ground.p_enu[3].tolist()
    (block,) = blocks_from_opensfm([one], "r")
    assert block.points is not None
    block = replace(
        block,
        points=replace(
            block.points,
            ties=replace(ties, photo_ids=tuple(s.photo.path.name for s in site.photos)),
        ),
    )
    lines = list(tracks_lines(block))
    assert lines[0] == "OPENSFM_TRACKS_VERSION_v2"
    cells = lines[1].split("\t")
    camera = one["cameras"][one["shots"][cells[0]]["camera"]]
    uv = pixels(camera, np.array([float(cells[3]), float(cells[4])]))
    assert uv == pytest.approx(ties.uv[0], abs=1e-5)
    assert len({tuple(line.split("\t")[i] for i in (0, 2)) for line in lines[1:]}) == len(ties.uv)


def shots(**more: object) -> dict:
    camera = {"projection_type": "perspective", "width": 64, "height": 48, "focal": 0.9}
    shot = {"rotation": [0.0, 3.0, 0.0], "translation": [0.0, 0.0, 9.0], "camera": "c"}
    return {"cameras": {"c": camera}, "shots": {"a.jpg": shot}} | more


def test_a_file_of_theirs_has_heights_of_unknown_kind_and_may_lie_nowhere(tmp_path: Path) -> None:
    lla = {"latitude": -41.0, "longitude": 174.0, "altitude": 12.0}
    path = tmp_path / "reconstruction.json"
    path.write_text(json.dumps([shots(reference_lla=lla)]))
    ((geotag, _),) = read_poses(path).values()
    assert geotag.height is not None
    assert geotag.height.kind == "unknown"
    # Without GPS OpenSfM puts its frame at zero.
    nowhere = {"latitude": 0.0, "longitude": 0.0, "altitude": 0.0}
    path.write_text(json.dumps([shots(reference_lla=nowhere)]))
    with pytest.raises(InputError, match="has no place on the Earth"):
        read_poses(path)
    # Old versions wrote the reference into a file of its own.
    path.write_text(json.dumps([shots()]))
    (tmp_path / "reference_lla.json").write_text(json.dumps(lla))
    ((geotag, _),) = read_poses(path).values()
    assert math.degrees(geotag.lat) == pytest.approx(-41.0, abs=1e-3)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({}, "a list of reconstructions"),
        ([], "has no shots"),
        ([shots(shots={"a": {"rotation": [1, 2], "camera": "c"}})], "shot a: rotation: three"),
        ([shots(shots={"a": {"rotation": [1, 2, "x"], "camera": "c"}})], "'x' is not a number"),
        ([shots(cameras={})], "camera 'c' is not among the cameras"),
        ([shots(reference_lla={"latitude": 95.0, "longitude": 1, "altitude": 2})], "latitude 95"),
        ([shots(points={"1": {"coordinates": [1, 2]}})], "points: cannot be read"),
        ([shots(georef_gis={"version": 9})], "version 9 is not known"),
        ([shots(georef_gis={"version": 1})], "the frame cannot be read"),
    ],
)
def test_bad_reconstructions_are_refused_by_name(data: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        blocks_from_opensfm(data, "r.json")
