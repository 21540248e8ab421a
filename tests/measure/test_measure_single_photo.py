"""What one photo tells: the 2009 report's worked example, and its slips done right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pyproj import Geod

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, exp_so3
from georef_gis.geodesy import MapFrame, Origin, prime_vertical_radius, utm_crs
from georef_gis.measure.lengths import Leg, measure_lines
from georef_gis.measure.points import Mark, MeasuredPoints, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.measure.single_photo import camera_field_of_view, field_of_view
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

# The report's camera: Rebel XTi, 22.2 x 14.8 mm, 3888 x 2592 px, 18 mm
CAMERA = Camera(
    id="xti", width=3888, height=2592, fx=18 / 22.2 * 3888, fy=18 / 22.2 * 3888, cx=1943.5,
    cy=1295.5, sigma_f=3.0, sigma_c=2.0,
)  # fmt: skip
ORIGIN = Origin(lat=math.radians(39.0), lon=math.radians(-80.0), height_ellipsoidal=250.0)
GROUND = FlatTerrain(origin=ORIGIN, height_ellipsoidal=250.0, sigma=0.5)
GEOD = Geod(ellps="WGS84")
HEIGHT = 52.1208
COVARIANCE = np.diag([2.0, 2.0, 1.0, 0.02, 0.02, 0.05]) ** 2


def photo(
    heading_deg: float = 0.0, tilt: Array | None = None, camera: Camera = CAMERA
) -> OrientedPhoto:
    a = math.radians(heading_deg)
    turn = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1.0]])
    R = turn @ np.diag([1.0, -1.0, -1.0])
    if tilt is not None:
        R = exp_so3(tilt) @ R
    pose = Pose(origin_enu=np.array([0, 0, HEIGHT]), R_enu_from_cam=R, covariance=COVARIANCE)
    return OrientedPhoto(
        photo=Photo(id="P1", path=Path("P1.jpg"), width=3888, height=2592), camera=camera, pose=pose
    )


def measured(one: OrientedPhoto, uv: Sequence[Sequence[float]]) -> MeasuredPoints:
    """Places of pixels of a photo over level ground."""
    frame = MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon))
    marks = [Mark(name="", photo=one.id, u=u, v=v, sigma_px=1.0) for u, v in uv]
    return locate_points(Scene.of(frame, GROUND, [one]), marks)


def lines(one: OrientedPhoto, uv: Sequence[Sequence[float]]) -> tuple[Leg, ...]:
    return measure_lines(measured(one, uv)).legs


def test_worked_example_of_the_report() -> None:
    fov = field_of_view(52.1208, (22.2, 14.8), 18.0, pixels=3888)
    # Figure 8 gives four decimals.
    assert fov.width == pytest.approx(64.2823, abs=5e-5)
    assert fov.height == pytest.approx(42.8549, abs=5e-5)
    assert math.degrees(fov.angle_width) == pytest.approx(63.32, abs=0.005)
    assert fov.gsd == pytest.approx(64.2823 / 3888, abs=1e-7)


def test_camera_in_pixels_gives_the_same_field() -> None:
    fov = camera_field_of_view(CAMERA, 52.1208)
    assert (fov.width, fov.height) == (
        pytest.approx(64.2823, abs=5e-5),
        pytest.approx(42.8549, abs=5e-5),
    )


@pytest.mark.parametrize("bad", [(0.0, 18.0), (-1.0, 18.0), (50.0, 0.0)])
def test_impossible_field_of_view_is_refused(bad: tuple[float, float]) -> None:
    with pytest.raises(GeometryError, match="positive"):
        field_of_view(bad[0], (22.2, 14.8), bad[1], pixels=3888)


@pytest.mark.parametrize("heading", [0.0, 45.0, 90.0, 180.0, 271.0])
def test_heading_is_clockwise_from_north(heading: float) -> None:
    """The report's equations (13) to (15) turn the other way."""
    (line,) = lines(photo(heading), [[1943.5, 1295.5], [1943.5, 0.0]])
    # north and a degree less is 360: compared on the circle
    off = (math.degrees(line.bearing_true.value) - heading + 180.0) % 360.0 - 180.0
    assert off == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("uv", "azimuth"),
    [((2500, 700), 45), ((2500, 1852), 135), ((1387, 1852), 225), ((1387, 700), 315),
     ((2500, 1295.5), 90), ((1387, 1295.5), 270), ((1943.5, 1852), 180)],
)  # fmt: skip
def test_azimuth_in_all_quadrants(uv: tuple[float, float], azimuth: float) -> None:
    """The report's arctan knows two of the four."""
    (line,) = lines(photo(), [[1943.5, 1295.5], uv])
    assert math.degrees(line.bearing_true.value) == pytest.approx(azimuth, abs=3.0)
    expected = math.degrees(math.atan2(uv[0] - 1943.5, 1295.5 - uv[1])) % 360
    assert math.degrees(line.bearing_true.value) == pytest.approx(expected, abs=1e-3)


def geocentric_radius(lat: float) -> float:
    """Distance of the ellipsoid from the Earth's centre, m: the report's equation (3)."""
    a, b = 6378137.0, 6356752.314245
    c, s = math.cos(lat), math.sin(lat)
    return math.sqrt(((a * a * c) ** 2 + (b * b * s) ** 2) / ((a * c) ** 2 + (b * s) ** 2))


def test_longitude_has_the_prime_vertical_radius() -> None:
    """Ours agrees with PROJ's geodesic; the report's radius is 0.27 % short at 39 N."""
    lat, lon = math.radians(39.0), math.radians(-80.0)
    step = math.radians(1e-3)
    _, _, true = GEOD.inv(-80.0, 39.0, -80.0 + 1e-3, 39.0)
    ours = float(prime_vertical_radius(lat)) * math.cos(lat) * step
    report = geocentric_radius(lat) * math.cos(lat) * step
    assert ours == pytest.approx(true, rel=1e-6)
    assert 1.0 - report / true == pytest.approx(0.0027, abs=0.0001)
    at_ground = Origin(lat=lat, lon=lon, height_ellipsoidal=0.0)
    east = at_ground.enu_from_geo([lat, lon + step, 0.0])[0]
    assert east == pytest.approx(true, rel=1e-6)


def test_distances_and_azimuths_are_those_of_the_geodesic() -> None:
    found = measured(photo(33.0), [[100, 200], [3500, 300], [2000, 2500]])
    geo = np.degrees(ORIGIN.geo_from_enu(found.p_enu))
    for line, (a, b) in zip(measure_lines(found).legs, pairwise(geo), strict=True):
        azimuth, _, distance = GEOD.inv(a[1], a[0], b[1], b[0])
        # 250 m above the ellipsoid: 4e-5 longer.
        assert line.ground.value == pytest.approx(distance * (1 + 250 / 6.37e6), rel=2e-6)
        assert math.degrees(line.bearing_true.value) == pytest.approx(azimuth % 360, abs=1e-3)


def test_distance_is_far_better_than_places() -> None:
    found = measured(photo(), [[1800, 1200], [2100, 1400]])
    (line,) = measure_lines(found).legs
    place = math.sqrt(found.covariance_of(0)[0, 0])
    assert place > 2.0
    assert line.ground.sigma < place / 10.0
    assert line.ground.better > 10.0


def test_longer_distance_has_the_larger_sigma() -> None:
    short, long = lines(photo(), [[1900, 1290], [2000, 1290], [3800, 1290]])
    assert long.ground.sigma > short.ground.sigma


@pytest.mark.parametrize("uv", [(-1, 100), (100, -0.6), (3888, 100), (100, 2592), (math.nan, 5)])
def test_click_outside_the_photo_is_refused(uv: tuple[float, float]) -> None:
    with pytest.raises(GeometryError, match=r"photo P1: pixel .* lies outside 3888 x 2592 px"):
        measured(photo(), [(100.0, 100.0), uv])


def test_click_at_the_sky_is_refused() -> None:
    looking_up = photo(0.0, np.array([math.radians(85.0), 0.0, 0.0]))
    with pytest.raises(GeometryError, match="does not look at the ground"):
        measured(looking_up, [(1943.0, 10.0)])


def test_one_place_has_no_azimuth() -> None:
    found = measured(photo(), [(100.0, 100.0), (100.0, 100.0)])
    with pytest.raises(GeometryError, match="are one place"):
        measure_lines(found)
