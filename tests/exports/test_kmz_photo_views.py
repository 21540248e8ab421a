"""A photo in Google Earth: what its camera and field of view say is where the ground is seen.

The check is plain trigonometry of its own: a point of the ground, known by longitude, latitude and
height, goes by way of Camera and ViewVolume to a place on the thumbnail. There a mark was painted
into the distorted photo before, by a lens model written down here once more.
"""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from kml_checks import GX, K, documents, faults_of
from pyproj import Geod
from site_cases import ORIGIN, make_site

from exports.kml.kml import write_kmz
from exports.kml.options import KmzOptions
from exports.kml.photos import view_angles
from exports.site.site import SiteLayers, SitePhoto
from georef_gis.frames import R_ecef_from_enu
from georef_gis.geodesy import geoid_undulation
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose
from georef_gis.toolbox import CollectingFeedback

# Principal point well off the middle, strong barrel
CAMERA = Camera(
    id="cam", width=2400, height=1600, fx=1900.0, fy=1900.0, cx=1290.0, cy=740.0,
    k1=-0.12, k2=0.05, p1=0.001, p2=-0.0015,
)  # fmt: skip
HEIGHT = 100.0
SIDE = 512
# heading of the view, angle off nadir, turn of the camera about its view, deg
CASES = {
    "nadir, top to the north": (0.0, 0.0, 0.0),
    "nadir, turned": (123.0, 0.0, 0.0),
    "nearly nadir": (310.0, 1.5, -75.0),
    "oblique": (40.0, 35.0, 0.0),
    "oblique, rolled right": (200.0, 30.0, -18.0),
    "oblique, upside down": (95.0, 25.0, 170.0),
    "steep and rolled left": (-20.0, 52.0, 12.0),
}


def rotation(heading: float, tilt: float, roll: float) -> np.ndarray:
    """East, north, up from camera axes: the view, right and down vectors by hand."""
    h, t, r = map(math.radians, (heading, tilt, roll))
    view = np.array([math.sin(h) * math.sin(t), math.cos(h) * math.sin(t), -math.cos(t)])
    right0 = np.array([math.cos(h), -math.sin(h), 0.0])
    down0 = np.cross(view, right0)
    # Left side of the camera down: the right vector goes up, away from down.
    right = math.cos(r) * right0 - math.sin(r) * down0
    return np.column_stack([right, np.cross(view, right), view])


def distorted(x: float, y: float) -> tuple[float, float]:
    """Pixel of a ray (x, y, 1), Brown's model as the books have it."""
    c, r2 = CAMERA, x * x + y * y
    radial = 1.0 + c.k1 * r2 + c.k2 * r2**2
    u = x * radial + 2.0 * c.p1 * x * y + c.p2 * (r2 + 2.0 * x * x)
    v = y * radial + c.p1 * (r2 + 2.0 * y * y) + 2.0 * c.p2 * x * y
    return c.cx + c.fx * u, c.cy + c.fy * v


@dataclass
class Scene:
    site: SiteLayers
    # East, north, up of the marks from the camera's place on the ellipsoid, m
    ground: np.ndarray


def make_scene(folder: Path, angles: tuple[float, float, float]) -> Scene:
    """A photo with marks where points of flat ground are seen."""
    R = rotation(*angles)
    rng = np.random.default_rng(3)
    image = np.full((CAMERA.height, CAMERA.width, 3), 60, np.uint8)
    ground = []
    for x, y in rng.uniform([-0.5, -0.3], [0.42, 0.34], (400, 2)):
        ray = R @ [x, y, 1.0]
        u, v = distorted(x, y)
        inside = 40 < u < CAMERA.width - 40 and 40 < v < CAMERA.height - 40
        if ray[2] > -0.15 or not inside:
            continue
        if any(math.hypot(u - a, v - b) < 90 for *_, a, b in ground):
            continue
        # 16 sub-steps of a pixel: the mark lies where it should to 0.03 px
        place = (round((u + 0.5) * 16) - 8, round((v + 0.5) * 16) - 8)
        cv2.circle(image, place, 14 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
        ground.append((*(ray * (HEIGHT / -ray[2])), u, v))
    cv2.imwrite(str(folder / "p.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    photo = Photo(id="p.jpg", path=folder / "p.jpg", width=CAMERA.width, height=CAMERA.height,
                  camera_id="cam")  # fmt: skip
    pose = Pose(
        origin_enu=np.array([0.0, 0.0, HEIGHT]), R_enu_from_cam=R, covariance=np.eye(6) * 1e-4
    )
    one = SitePhoto(photo=photo, pose=pose, height_above_ground=HEIGHT)
    site = replace(make_site(folder), photos=(one,), footprints=(), cameras=(CAMERA,))
    return Scene(site=site, ground=np.array(ground))


def overlay_of(kmz: Path) -> tuple[dict[str, float], str, np.ndarray]:
    """Numbers of the one PhotoOverlay, its altitude mode, and its picture."""
    root = dict(documents(kmz))["doc.kml"]
    (view,) = root.iter(K + "PhotoOverlay")
    numbers = {
        e.tag.removeprefix(K): float(e.text)
        for part in ("Camera", "ViewVolume") for e in view.find(K + part)
        if e.tag != K + "altitudeMode"
    }  # fmt: skip
    with zipfile.ZipFile(kmz) as archive:
        data = np.frombuffer(archive.read(view.findtext(f"{K}Icon/{K}href")), np.uint8)
    return numbers, view.findtext(f"{K}Camera/{K}altitudeMode"), cv2.imdecode(data, 0)


def seen_at(n: dict[str, float], enu: np.ndarray, size: tuple[int, int]) -> tuple[float, float]:
    """Pixel of a direction by the camera's angles: turned back one angle after the other."""
    east, north, up = enu
    h, t, r = (math.radians(n[name]) for name in ("heading", "tilt", "roll"))
    # Heading: the camera's own right and forward on the ground, clockwise from north.
    right = east * math.cos(h) - north * math.sin(h)
    forward = east * math.sin(h) + north * math.cos(h)
    # Tilt: looking down at 0, ahead at 90.
    ahead = forward * math.sin(t) - up * math.cos(t)
    above = forward * math.cos(t) + up * math.sin(t)
    # Roll: left side down, so the scene turns clockwise on the screen.
    x = right * math.cos(r) + above * math.sin(r)
    y = -right * math.sin(r) + above * math.cos(r)
    left, width = (math.tan(math.radians(n["leftFov"])), math.tan(math.radians(n["rightFov"])))
    top, bottom = (math.tan(math.radians(n[name])) for name in ("topFov", "bottomFov"))
    u = (x / ahead - left) / (width - left) * size[0]
    v = (top - y / ahead) / (top - bottom) * size[1]
    return u, v


@pytest.mark.parametrize("name", CASES)
def test_ground_is_seen_where_the_thumbnail_shows_it(name, tmp_path):
    scene = make_scene(tmp_path, CASES[name])
    write_kmz(scene.site, tmp_path / "s.kmz", KmzOptions(thumbnail_px=SIDE), CollectingFeedback())
    assert faults_of(tmp_path / "s.kmz") == []
    numbers, mode, picture = overlay_of(tmp_path / "s.kmz")
    assert mode == "absolute"
    n = float(geoid_undulation(ORIGIN.lat, ORIGIN.lon))
    assert numbers["altitude"] + n == pytest.approx(
        ORIGIN.height_ellipsoidal + HEIGHT, abs=0.002
    )  # m
    assert picture.shape[::-1] == (512, 341)
    size = (picture.shape[1], picture.shape[0])
    off = []
    for *enu, _, _ in scene.ground:
        u, v = seen_at(numbers, np.array(enu), size)
        i, j = int(v), int(u)
        if not (6 < i < size[1] - 7 and 6 < j < size[0] - 7):
            continue
        patch = np.clip(picture[i - 6 : i + 7, j - 6 : j + 7].astype(float) - 90.0, 0.0, None)
        yy, xx = np.mgrid[i - 6 : i + 7, j - 6 : j + 7] + 0.5
        off.append([(xx * patch).sum() / patch.sum() - u, (yy * patch).sum() / patch.sum() - v])
    assert len(off) > 30
    # px of the thumbnail: a mark of 6 px, JPEG; a lens not taken out would be 3 px off
    assert np.abs(np.mean(off, axis=0)).max() < 0.05
    assert np.abs(off).max() < 0.2


def test_looking_straight_down_is_all_in_the_heading(tmp_path):
    for angles in ((77.0, 0.0, 0.0), (0.0, 0.0, 40.0)):
        scene = make_scene(tmp_path, angles)
        write_kmz(scene.site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback())
        numbers, _, _ = overlay_of(tmp_path / "s.kmz")
        # turned left by 40 deg the top looks to 320 deg
        assert numbers["heading"] == pytest.approx((angles[0] - angles[2]) % 360.0, abs=1e-5)
        assert (numbers["tilt"], numbers["roll"]) == (pytest.approx(0.0, abs=1e-5), 0.0)


def test_angles_are_of_the_vertical_at_the_camera_not_at_the_origin(tmp_path):
    """20 km east of the origin, up is 0.18 deg off the origin's: a photo of 300 px would miss."""
    scene = make_scene(tmp_path, (0.0, 30.0, 0.0))
    geod = Geod(ellps="WGS84")
    lon, lat, _ = geod.fwd(math.degrees(ORIGIN.lon), math.degrees(ORIGIN.lat), 90.0, 20_000.0)
    one = scene.site.photos[0]
    place = scene.site.frame.origin.enu_from_geo(
        np.array([math.radians(lat), math.radians(lon), ORIGIN.height_ellipsoidal + HEIGHT])
    )
    assert one.pose is not None
    # level at its own place: a camera that looks down there
    there = R_ecef_from_enu(math.radians(lat), math.radians(lon))
    R = scene.site.frame.origin.R_ecef_from_enu.T @ there @ rotation(0.0, 30.0, 0.0)
    moved = replace(one, pose=replace(one.pose, origin_enu=place, R_enu_from_cam=R))
    site = replace(scene.site, photos=(moved,))
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback())
    numbers, _, _ = overlay_of(tmp_path / "s.kmz")
    assert numbers["longitude"] == pytest.approx(lon, abs=1e-9)
    assert numbers["latitude"] == pytest.approx(lat, abs=1e-9)
    found = [numbers[name] for name in ("heading", "tilt", "roll")]
    assert found == pytest.approx([0.0, 30.0, 0.0], abs=1e-5)


def test_angles_turn_back_into_the_rotation():
    rng = np.random.default_rng(5)
    for h, t, r in rng.uniform([0, 0.1, -180], [360, 179.9, 180], (200, 3)):
        R = rotation(h, t, r) @ np.diag([1.0, -1.0, -1.0])
        found = np.degrees(view_angles(R))
        assert np.cos(np.radians(found - [h, t, r])) == pytest.approx(np.ones(3), abs=1e-12)


@pytest.mark.parametrize("name", ["nadir, turned", "steep and rolled left"])
def test_the_picture_hangs_above_the_ground(name, tmp_path):
    scene = make_scene(tmp_path, CASES[name])
    write_kmz(scene.site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback())
    n, _, _ = overlay_of(tmp_path / "s.kmz")
    R = rotation(*CASES[name])
    for x in (n["leftFov"], n["rightFov"]):
        for y in (n["topFov"], n["bottomFov"]):
            corner = np.array([math.tan(math.radians(x)), -math.tan(math.radians(y)), 1.0])
            assert (R @ corner * n["near"])[2] > -HEIGHT
    assert n["near"] > 0.05 * HEIGHT


def test_without_pose_or_picture_there_is_a_placemark_and_no_view(site, tmp_path):
    feedback = CollectingFeedback()
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(), feedback)
    assert faults_of(tmp_path / "s.kmz") == []
    root = dict(documents(tmp_path / "s.kmz"))["doc.kml"]
    views = [v.findtext(K + "name") for v in root.iter(K + "PhotoOverlay")]
    assert len(views) == 2
    assert "missing.jpg" not in views
    assert any("missing.jpg" in warning for warning in feedback.warnings)
    marks = {m.findtext(K + "name"): m for m in root.iter(K + "Placemark")
             if m.get("id").startswith("photo-")}  # fmt: skip
    assert "missing.jpg" in marks
    assert "<img" in marks["p1.jpg"].findtext(K + "description")
    assert root.find(f".//{GX}Track") is not None
