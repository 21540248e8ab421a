"""Planted mistakes: the check that exact tags reproduce the truth must fail for each of them.

The simulator shares no frame, projection or distortion code with the estimators, so a mistake in
one of them shows. Each patch below puts one classic mistake into the estimators' code.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from georef_gis import ellipsoid
from georef_gis.errors import GeorefError
from georef_gis.geodesy import (
    Height,
    HeightKind,
    MapFrame,
    Origin,
    heights,
    map_crs,
    metres_per_unit,
)
from georef_gis.model.camera import Camera
from georef_gis.model.grid import Grid
from georef_gis.model.ground_point import locate
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import AttitudeTag, Geotag, OrientedPhoto, Photo
from georef_gis.model.pose import Mount, Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient import dialects, direct
from georef_gis.orient.direct import DirectSettings, direct_poses
from georef_gis.orient.heights import GroundSetting, solve_heights
from georef_gis.rasters import reading
from georef_gis.simulate import (
    FlightSettings,
    SimulatedFlight,
    project_truth,
    simulate_flight,
    site,
)
from georef_gis.simulate import ellipsoid as true_ellipsoid
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# m, rad and px to which exact tags must reproduce the truth
PLACE, ANGLE, PIXEL = 0.01, math.radians(0.001), 0.1
MAP = "EPSG:6601"
EXACT = FlightSettings(
    attitude_sigma_deg=0.0,
    boresight_sigma_deg=0.8,
    lever_arm_camera=(0.9, 0.4, 0.3),
    lever_arm_antenna=(-0.8, -0.2, -0.5),
    control_sigma_h=0.0,
    control_sigma_v=0.0,
)
PHOTOS = (1, 6, 9)
Patch = pytest.MonkeyPatch


@cache
def flight() -> SimulatedFlight:
    return simulate_flight(EXACT, seed=2009)


def origins() -> list[Origin]:
    """At the site, and 20 km south-west of it: enu is not level where the vehicle is."""
    lat, lon, h = site.ORIGIN_LAT, site.ORIGIN_LON, site.ORIGIN_HEIGHT
    return [
        Origin(lat=lat, lon=lon, height_ellipsoidal=h),
        Origin(lat=lat - 0.0022, lon=lon - 0.0030, height_ellipsoidal=250.0),
    ]


def opk_of_truth(f: SimulatedFlight, i: int) -> tuple[float, float, float]:
    """Omega, phi, kappa on the state plane's map, by a step north and the truth alone."""
    lat, lon, _ = true_ellipsoid.geodetic_from_ecef(f.p_ecef[i])
    plane = true_ellipsoid.state_plane_from_geodetic
    x, y = (plane(lat + 1e-6, lon) - plane(lat - 1e-6, lon)) / np.hypot(
        *(plane(lat + 1e-6, lon) - plane(lat - 1e-6, lon))
    )
    # Columns: where the place's north, east and down lie on the map.
    R_map_ned = np.array([[x, y, 0.0], [y, -x, 0.0], [0.0, 0.0, -1.0]])
    m = R_map_ned @ f.R_ned_from_cam[i] @ np.diag([1.0, -1.0, -1.0])
    return math.atan2(-m[1, 2], m[2, 2]), math.asin(m[0, 2]), math.atan2(-m[0, 1], m[0, 0])


def tagged(f: SimulatedFlight, i: int, dialect: str) -> Photo:
    """Photo with the errorless tags of one exposure in a dialect."""
    p = f.states.p_ecef[i] + f.states.R_ecef_from_body[i] @ f.lever_arm_antenna
    lat, lon, h = true_ellipsoid.geodetic_from_ecef(p)
    angles = opk_of_truth(f, i) if dialect == "opk" else tuple(f.states.rpy[i])
    roll, pitch, yaw = (float(a) for a in angles)
    height = Height(value=float(h - site.geoid_height(lat, lon)), kind=HeightKind.ORTHOMETRIC)
    return Photo(
        id=f.names[i],
        path=Path(f.names[i]),
        width=EXACT.camera.width,
        height=EXACT.camera.height,
        geotag=Geotag(lat=float(lat), lon=float(lon), height=height, of="antenna"),
        attitude=AttitudeTag(dialect=dialect, roll=roll, pitch=pitch, yaw=yaw),
    )


def oriented(origin: Origin, dialect: str) -> dict[int, OrientedPhoto]:
    """Photos by index, oriented from exact tags with the true mount."""
    f, c = flight(), EXACT.camera
    photos = [tagged(f, i, dialect) for i in PHOTOS]
    ground = GroundSetting(dem=FlatTerrain(origin=origin, height_ellipsoidal=270.0))
    mount = Mount(
        lever_arm_body_camera=f.lever_arm_camera,
        lever_arm_body_antenna=f.lever_arm_antenna,
        boresight_body=f.boresight,
    )
    found = direct_poses(
        photos,
        origin,
        solve_heights(photos, origin, ground),
        mount,
        DirectSettings(),
        convergence_at=MapFrame(origin, map_crs(MAP)).convergence_at,
    )
    names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    camera = Camera(id="rebel", **{name: getattr(c, name) for name in names})
    out = {}
    for i, photo, one in zip(PHOTOS, photos, found, strict=True):
        assert one.pose is not None, one.refused
        out[i] = OrientedPhoto(photo=photo, camera=camera, pose=one.pose)
    return out


def check_poses(photos: dict[int, OrientedPhoto], origin: Origin) -> None:
    """Centre and view against the truth in ecef."""
    f = flight()
    for i, photo in photos.items():
        p_ecef = origin.ecef_from_enu(photo.pose.origin_enu)
        assert np.abs(p_ecef - f.p_ecef[i]).max() < PLACE
        R_ecef_cam = origin.R_ecef_from_enu @ photo.pose.R_enu_from_cam
        cosine = (np.trace(R_ecef_cam.T @ f.R_ecef_from_cam[i]) - 1.0) / 2.0
        assert math.acos(min(1.0, cosine)) < ANGLE


def check_pixels(photos: dict[int, OrientedPhoto], origin: Origin) -> None:
    """Targets project where the oracle sees them; marks are located where the survey has them."""
    f = flight()
    frame = MapFrame(origin, map_crs(MAP))
    targets = {p.name: p for p in f.control}
    for mark in (m for m in f.marks if m.photo in photos):
        photo, target = photos[mark.photo], targets[mark.point]
        true_uv = project_truth(f, mark.photo, target.p_ecef)
        uv = photo.project(origin.enu_from_ecef(target.p_ecef))
        assert np.abs(uv - true_uv).max() < PIXEL
        height = float(true_ellipsoid.geodetic_from_ecef(target.p_ecef)[2])
        ground = FlatTerrain(origin=origin, height_ellipsoidal=height)
        e, n, h = frame.map_from_enu(locate(photo, true_uv, ground))
        assert abs(e - target.easting) < 2 * PLACE / US_SURVEY_FOOT
        assert abs(n - target.northing) < 2 * PLACE / US_SURVEY_FOOT
        assert abs(h - height) < PLACE


def check_ortho(photos: dict[int, OrientedPhoto], origin: Origin) -> None:
    """The middle of an ortho's pixel takes its colour from where the oracle sees that place."""
    f = flight()
    frame = MapFrame(origin, map_crs(MAP))
    target = f.control[0]
    height = float(true_ellipsoid.geodetic_from_ecef(target.p_ecef)[2])
    pixel = 0.05 / metres_per_unit(frame.horizontal)
    # The target lies in the middle of pixel (row 300, column 400).
    grid = Grid(
        crs_wkt=frame.crs.to_wkt(),
        left=target.easting - 400.5 * pixel,
        top=target.northing + 300.5 * pixel,
        pixel=pixel,
        width=800,
        height=600,
    )
    ground = Ground.of(
        frame, grid, FlatTerrain(origin=origin, height_ellipsoidal=height), (height, height)
    )
    for i, photo in photos.items():
        uv = photo.project(ground.enu_at(grid, np.array([[400.5, 300.5]])))[0]
        assert np.abs(uv - project_truth(f, i, target.p_ecef)).max() < PIXEL


def check_decoding(folder: Path) -> None:
    """Pixels are those stored, whatever Orientation says: a bright corner stays where it is."""
    stored = np.full((48, 64, 3), 30, np.uint8)
    stored[:16, :16] = 220
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(stored).save(folder / "turned.jpg", exif=exif, quality=95)
    image = reading.read_image(folder / "turned.jpg")
    assert image.shape == (48, 64, 3)
    assert image[4, 4, 0] > 180
    assert image[4, 60, 0] < 80


def check_everything(folder: Path) -> None:
    """From tags to pixels, map and ortho: what an errorless flight must reproduce."""
    for origin in origins():
        for dialect in ("pix4d-camera", "opk"):
            photos = oriented(origin, dialect)
            check_poses(photos, origin)
            check_pixels(photos, origin)
            check_ortho(photos, origin)
    check_decoding(folder)


def test_exact_tags_reproduce_the_truth(tmp_path: Path) -> None:
    check_everything(tmp_path)


# ---------------------------------------------------------------------------------------------
# The mistakes
# ---------------------------------------------------------------------------------------------


def change_angles(change: Callable[..., tuple]) -> Callable[[Patch], None]:
    """Mistake in the sense or the unit of roll, pitch, yaw."""
    right = dialects.R_ned_from_body
    return lambda patch: patch.setattr(dialects, "R_ned_from_body", lambda *a: right(*change(*a)))


def change_pixels(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Patch], None]:
    right = Camera._pixels_from_distorted
    return lambda patch: patch.setattr(
        Camera, "_pixels_from_distorted", lambda self, xy: change(right(self, xy))
    )


def change_map(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Patch], None]:
    right = MapFrame.map_from_geo
    return lambda patch: patch.setattr(
        MapFrame, "map_from_geo", lambda self, p: change(right(self, p))
    )


def transposed_rotation(patch: Patch) -> None:
    patch.setattr(
        Pose, "cam_from_enu", lambda self, p: (p - self.origin_enu) @ self.R_enu_from_cam.T
    )


def swapped_lat_lon(patch: Patch) -> None:
    right = Origin.enu_from_geo
    patch.setattr(
        Origin, "enu_from_geo", lambda self, p: right(self, np.asarray(p)[..., [1, 0, 2]])
    )


def lever_arm_sign(patch: Patch) -> None:
    patch.setattr(
        Mount,
        "antenna_to_camera_body",
        property(lambda self: self.lever_arm_body_antenna - self.lever_arm_body_camera),
    )


def lever_arm_in_body_axes(patch: Patch) -> None:
    """Right, forward, up, as the 2012 paper has it."""
    patch.setattr(
        Mount,
        "antenna_to_camera_body",
        property(
            lambda self: (
                ((self.lever_arm_body_camera - self.lever_arm_body_antenna)[[1, 0, 2]])
                * np.array([1.0, 1.0, -1.0])
            )
        ),
    )


def boresight_sign(patch: Patch) -> None:
    right = dialects.exp_so3
    patch.setattr(dialects, "exp_so3", lambda v: right(-np.asarray(v)))


def convergence_sign(patch: Patch) -> None:
    right = dialects.R_map_from_enu
    patch.setattr(dialects, "R_map_from_enu", lambda c: right(-c))


def no_convergence(patch: Patch) -> None:
    patch.setattr(dialects, "R_map_from_enu", lambda c: np.eye(3))


def geoid_sign(patch: Patch) -> None:
    right = heights.geoid_undulation
    patch.setattr(heights, "geoid_undulation", lambda *a, **k: -right(*a, **k))


def no_geoid(patch: Patch) -> None:
    patch.setattr(heights, "geoid_undulation", lambda lat, lon, **k: np.zeros_like(lat))


def constant_axis_swap(patch: Patch) -> None:
    swap = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    for module in (dialects, direct):
        patch.setattr(module, "R_enu_from_ned", lambda *a: swap)


def distortion_direction(patch: Patch) -> None:
    distort, undistort = Camera.distort, Camera.undistort
    patch.setattr(Camera, "distort", undistort)
    patch.setattr(Camera, "undistort", distort)


def swapped_p1_p2(patch: Patch) -> None:
    right = Camera._polynomial

    def wrong(self: Camera, xy: np.ndarray) -> np.ndarray:
        # Turned by a quarter and back, p1 and p2 change places.
        return right(self, xy[..., ::-1])[..., ::-1]

    patch.setattr(Camera, "_polynomial", wrong)
    patch.setattr(Camera, "distort", wrong)


def image_y_up(patch: Patch) -> None:
    wrong = {k: v @ np.diag([1.0, -1.0, -1.0]) for k, v in dialects._NOMINAL.items()}
    patch.setattr(dialects, "_NOMINAL", wrong)


def gimbal_nominal(patch: Patch) -> None:
    patch.setitem(dialects._NOMINAL, "nadir", dialects._NOMINAL["horizon"])


def sphere(patch: Patch) -> None:
    patch.setattr(ellipsoid, "WGS84_E2", 0.0)


def ortho_half_pixel(patch: Patch) -> None:
    right = Grid.map_from_grid
    patch.setattr(Grid, "map_from_grid", lambda self, p: right(self, np.asarray(p) - 0.5))


def rows_from_the_bottom(patch: Patch) -> None:
    def wrong(self: Grid, p: np.ndarray) -> np.ndarray:
        p = np.asarray(p)
        bottom = self.top - self.height * self.pixel
        return np.stack([self.left + p[..., 0] * self.pixel, bottom + p[..., 1] * self.pixel], -1)

    patch.setattr(Grid, "map_from_grid", wrong)


def orientation_applied(patch: Patch) -> None:
    patch.setattr(reading.cv2, "IMREAD_IGNORE_ORIENTATION", 0)


MISTAKES: dict[str, Callable[[Patch], None]] = {
    "transposed R": transposed_rotation,
    "swapped u and v": change_pixels(lambda uv: uv[..., ::-1]),
    "half a pixel": change_pixels(lambda uv: uv + 0.5),
    "swapped lat and lon": swapped_lat_lon,
    "degrees for radians": change_angles(lambda *a: tuple(np.degrees(a))),
    "radians for degrees": change_angles(lambda *a: tuple(np.radians(a))),
    "yaw sign": change_angles(lambda r, p, y: (r, p, -y)),
    "pitch sign": change_angles(lambda r, p, y: (r, -p, y)),
    "roll sign": change_angles(lambda r, p, y: (-r, p, y)),
    "swapped roll and pitch": change_angles(lambda r, p, y: (p, r, y)),
    "lever-arm sign": lever_arm_sign,
    "lever arm right, forward, up": lever_arm_in_body_axes,
    "boresight sign": boresight_sign,
    "convergence sign": convergence_sign,
    "no convergence": no_convergence,
    "geoid sign": geoid_sign,
    "no geoid": no_geoid,
    "constant axis swap": constant_axis_swap,
    "distortion direction": distortion_direction,
    "swapped p1 and p2": swapped_p1_p2,
    "image y up": image_y_up,
    "a gimbal's zero": gimbal_nominal,
    "feet for metres": change_map(lambda p: p * [US_SURVEY_FOOT, US_SURVEY_FOOT, 1.0]),
    "international feet": change_map(
        lambda p: p * [US_SURVEY_FOOT / INTERNATIONAL_FOOT, US_SURVEY_FOOT / INTERNATIONAL_FOOT, 1]
    ),
    "northing before easting": change_map(lambda p: p[..., [1, 0, 2]]),
    "a spherical Earth": sphere,
    "half a pixel of the ortho": ortho_half_pixel,
    "rows counted from the bottom": rows_from_the_bottom,
    "Orientation applied by the decoder": orientation_applied,
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_planted_mistake_is_found(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    MISTAKES[name](monkeypatch)
    try:
        check_everything(tmp_path)
    except (AssertionError, GeorefError):
        return
    pytest.fail(f"nothing noticed: {name}")
