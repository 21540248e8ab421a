"""Each row of the table of dialects, by hand: where the camera looks and where its top lies."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import tag_cases as tags
from scipy.spatial.transform import Rotation

from georef_gis import frames
from georef_gis.errors import InputError
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.model.pose import Mount
from georef_gis.orient.dialects import R_enu_from_cam_of_tag, dialect, dialects

NADIR = ["sensefly", "pix4d-camera", "ypr"]
HORIZON = ["drone-dji", "dji-makernote", "drone-parrot", "skydio"]
E, N, U = np.eye(3)


def rotation(
    name: str, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0, **more
) -> np.ndarray:
    """Angles in degrees, at the origin."""
    tag = tags.attitude(name, yaw, pitch, roll)
    place = {"vehicle_lat": tags.SITE.lat, "vehicle_lon": tags.SITE.lon, "mount": Mount()}
    return R_enu_from_cam_of_tag(tag, yaw=tag.yaw, origin=tags.SITE, **{**place, **more})


def looks(R: np.ndarray) -> np.ndarray:
    return R[:, 2]


def top(R: np.ndarray) -> np.ndarray:
    """Direction of the top of the image."""
    return -R[:, 1]


def test_every_row_is_tested_here() -> None:
    assert set(dialects()) == {*NADIR, *HORIZON, "opk"}


@pytest.mark.parametrize("name", [*NADIR, *HORIZON])
def test_nadir_looking_north(name: str) -> None:
    R = rotation(name, pitch=0.0 if name in NADIR else -90.0)
    assert looks(R) == pytest.approx(-U, abs=1e-12)
    assert top(R) == pytest.approx(N, abs=1e-12)
    assert R[:, 0] == pytest.approx(E, abs=1e-12)


@pytest.mark.parametrize("name", [*NADIR, *HORIZON])
def test_yaw_90_has_the_top_of_the_image_in_the_east(name: str) -> None:
    R = rotation(name, yaw=90.0, pitch=0.0 if name in NADIR else -90.0)
    assert looks(R) == pytest.approx(-U, abs=1e-12)
    assert top(R) == pytest.approx(E, abs=1e-12)


@pytest.mark.parametrize("name", [*NADIR, *HORIZON])
def test_ten_degrees_more_pitch_look_forward(name: str) -> None:
    R = rotation(name, yaw=90.0, pitch=10.0 if name in NADIR else -80.0)
    expected = math.sin(math.radians(10)) * E - math.cos(math.radians(10)) * U
    assert looks(R) == pytest.approx(expected, abs=1e-12)
    assert top(R)[2] > 0  # the far side of the ground is at the top


@pytest.mark.parametrize("name", NADIR)
def test_right_wing_down_looks_left(name: str) -> None:
    R = rotation(name, roll=10.0)
    expected = -math.sin(math.radians(10)) * E - math.cos(math.radians(10)) * U
    assert looks(R) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", HORIZON)
def test_at_zero_a_gimbal_looks_ahead_and_roll_leans_it_right(name: str) -> None:
    assert looks(rotation(name)) == pytest.approx(N, abs=1e-12)
    assert top(rotation(name)) == pytest.approx(U, abs=1e-12)
    leaning = rotation(name, roll=10.0)
    assert looks(leaning) == pytest.approx(N, abs=1e-12)
    # Clockwise seen from behind: the camera's top goes to the right.
    assert top(leaning) @ E == pytest.approx(math.sin(math.radians(10)), abs=1e-12)


@pytest.mark.parametrize("name", HORIZON)
@pytest.mark.parametrize(("yaw", "roll"), [(30.0, 40.0), (-150.0, 180.0), (12.0, -12.0)])
def test_at_the_lock_yaw_and_roll_add_up(name: str, yaw: float, roll: float) -> None:
    locked = rotation(name, yaw=yaw, pitch=-90.0, roll=roll)
    assert locked == pytest.approx(rotation(name, yaw=yaw + roll, pitch=-90.0), abs=1e-12)


@pytest.mark.parametrize("name", HORIZON)
@pytest.mark.parametrize("beyond", [0.0, 5.0, 30.0])
def test_past_nadir_is_the_same_as_yaw_and_roll_turned_over(name: str, beyond: float) -> None:
    """DJI writes a gimbal past nadir both ways: pitch -100, or -80 with yaw and roll + 180."""
    past = rotation(name, yaw=25.0, pitch=-90.0 - beyond, roll=0.0)
    over = rotation(name, yaw=205.0, pitch=-90.0 + beyond, roll=180.0)
    assert past == pytest.approx(over, abs=1e-12)
    assert looks(past) @ [math.sin(math.radians(25)), math.cos(math.radians(25)), 0] == (
        pytest.approx(-math.sin(math.radians(beyond)), abs=1e-12)
    )


def test_gimbal_is_scipys_zyx_of_an_aircraft_with_a_camera_in_its_nose() -> None:
    R_ned_body = Rotation.from_euler("ZYX", [200.0, -63.0, 7.0], degrees=True).as_matrix()
    forward_right_down_in_cam = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    expected = swap @ R_ned_body @ forward_right_down_in_cam.T
    assert rotation("drone-dji", 200.0, -63.0, 7.0) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", [*NADIR, *HORIZON])
def test_boresight_turns_in_body_axes_of_a_camera_that_looks_down(name: str) -> None:
    """+1 deg about body x (right wing down) moves the view to the left in every dialect."""
    mount = Mount(boresight_body=np.radians([1.0, 0.0, 0.0]))
    pitch = 0.0 if name in NADIR else -90.0
    R = rotation(name, yaw=90.0, pitch=pitch, mount=mount)
    assert looks(R) @ N == pytest.approx(math.sin(math.radians(1)), abs=1e-12)


def test_skydios_quaternion_agrees_with_its_angles() -> None:
    """It turns forward-left-up into NED, the angles forward-right-down; they part by 0.02 deg."""
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    path = Path(folder) / "metadata" / "skydio__Skydio2_skydio-catilina.json"
    record = json.loads(path.read_text())
    for what in ("Camera", "Vehicle"):
        prefix = f"XMP-drone-skydio:{what}Orientation"
        q = [record[f"{prefix}QuatNED{axis}"] for axis in "WXYZ"]
        rpy = np.radians([record[f"{prefix}NED{n}"] for n in ("Roll", "Pitch", "Yaw")])
        R_ned_flu = frames.R_from_quaternion(q)
        assert R_ned_flu @ np.diag([1, -1, -1]) == pytest.approx(
            frames.R_ned_from_body(*rpy), abs=1e-3
        )


def opk_of(R_map_cam: np.ndarray) -> np.ndarray:
    return np.degrees(frames.opk_from_R_map_from_photo(R_map_cam @ frames.R_PHOTO_FROM_CAM.T))


@pytest.mark.parametrize("east_km", [0.0, 20.0])
def test_opk_is_ypr_in_the_axes_of_the_map(east_km: float) -> None:
    frame = MapFrame(tags.SITE, parse_crs("EPSG:32617"))
    p = np.array([east_km * 1e3, 0.0, 0.0])
    lat, lon, _ = tags.SITE.geo_from_enu(p)
    convergence = frame.convergence_at(p)
    here = Origin(lat=lat, lon=lon, height_ellipsoidal=0.0)
    level = {"vehicle_lat": lat, "vehicle_lon": lon, "mount": Mount()}
    ypr = tags.attitude("ypr", 130.0, 6.0, -9.0)
    local = R_enu_from_cam_of_tag(ypr, yaw=ypr.yaw, origin=here, **level)
    omega, phi, kappa = opk_of(frames.R_map_from_enu(convergence) @ local)
    opk = tags.attitude("opk", kappa, phi, omega)
    more = {"yaw": opk.yaw, "origin": tags.SITE, "convergence": convergence}
    assert R_enu_from_cam_of_tag(opk, **more, **level) == pytest.approx(
        R_enu_from_cam_of_tag(ypr, yaw=ypr.yaw, origin=tags.SITE, **level), abs=1e-12
    )


@pytest.mark.parametrize("code", ["EPSG:32617", "EPSG:6601"])
@pytest.mark.parametrize("east_km", [0.0, 20.0])
def test_zero_opk_has_its_columns_along_grid_east(code: str, east_km: float) -> None:
    """A step in easting on PROJ's map is a step along the image's columns and nothing else."""
    frame = MapFrame(tags.SITE, parse_crs(code))
    p = np.array([east_km * 1e3, 0.0, 0.0])
    lat, lon, _ = tags.SITE.geo_from_enu(p)
    R = rotation("opk", convergence=frame.convergence_at(p), vehicle_lat=lat, vehicle_lon=lon)
    on_map = frame.map_from_enu(p)
    east, north = (frame.enu_from_map(on_map + d) - p for d in ([300.0, 0, 0], [0, 300.0, 0]))
    in_cam = np.array([east, north]) @ R
    assert math.degrees(math.atan2(in_cam[0, 1], in_cam[0, 0])) == pytest.approx(0, abs=2e-3)
    assert math.degrees(math.atan2(in_cam[1, 0], -in_cam[1, 1])) == pytest.approx(0, abs=2e-3)
    # The image plane is level at the vehicle, so both steps stay at one depth.
    assert in_cam[:, 2] == pytest.approx([0, 0], abs=0.02)


@pytest.mark.parametrize(
    ("angles", "moved"),
    [
        # omega turns about easting: the view goes to +north; phi about northing: to -east
        ({"roll": 10.0}, [0, math.sin(math.radians(10))]),
        ({"pitch": 10.0}, [-math.sin(math.radians(10)), 0]),
    ],
    ids=["omega", "phi"],
)
def test_senses_of_omega_and_phi(angles: dict, moved: list) -> None:
    assert looks(rotation("opk", **angles))[:2] == pytest.approx(moved, abs=1e-12)


def test_kappa_is_counter_clockwise() -> None:
    R = rotation("opk", yaw=90.0)
    assert top(R) == pytest.approx(-E, abs=1e-12)


def test_twenty_km_away_nadir_is_the_places_own() -> None:
    p = np.array([0.0, 20e3, 0.0])
    lat, lon, _ = tags.SITE.geo_from_enu(p)
    R = rotation("drone-dji", pitch=-90.0, vehicle_lat=lat, vehicle_lon=lon)
    down = tags.SITE.enu_from_geo([[lat, lon, 0.0], [lat, lon, 100.0]])
    assert looks(R) == pytest.approx((down[0] - down[1]) / 100.0, abs=1e-9)


def test_an_unknown_dialect_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="drone-dji"):
        dialect("autel")
