"""Rotations of frames.py against hand cases, their inverses and scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from georef_gis import frames

ANGLE = st.floats(-math.pi, math.pi)
ROTVEC = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
STEEP = st.floats(-math.pi / 2, math.pi / 2)


def scipy_quaternion(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(canonical=True), 1)


@given(ROTVEC)
def test_exp_is_scipys(v: np.ndarray) -> None:
    assert frames.exp_so3(v) == pytest.approx(Rotation.from_rotvec(v).as_matrix(), abs=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-8, 0.99e-6, 1.01e-6, 1e-4, 3.14159])
def test_exp_and_log_are_inverse_at_every_size(size: float) -> None:
    v = size * np.array([0.6, -0.48, 0.64])
    assert frames.log_so3(frames.exp_so3(v)) == pytest.approx(v, abs=1e-14 + 1e-9 * size**2)


@given(ROTVEC)
def test_log_is_scipys(v: np.ndarray) -> None:
    rotation = Rotation.from_rotvec(v)
    ours = frames.log_so3(rotation.as_matrix())
    if np.linalg.norm(rotation.as_rotvec()) < math.pi - 1e-6:
        assert ours == pytest.approx(rotation.as_rotvec(), abs=1e-9)
    assert frames.rotation_angle(rotation.as_matrix()) == pytest.approx(
        rotation.magnitude(), abs=1e-7
    )


def test_half_turns_have_a_logarithm() -> None:
    for axis in np.eye(3):
        R = 2 * np.outer(axis, axis) - np.eye(3)
        assert np.abs(frames.log_so3(R)) == pytest.approx(math.pi * axis, abs=1e-12)


@given(ROTVEC)
def test_quaternion_is_scipys(v: np.ndarray) -> None:
    rotation = Rotation.from_rotvec(v)
    ours = frames.quaternion_from_R(rotation.as_matrix())
    assert abs(ours @ scipy_quaternion(rotation)) == pytest.approx(1.0, abs=1e-12)
    assert ours[0] >= 0
    assert frames.R_from_quaternion(3.0 * ours) == pytest.approx(rotation.as_matrix(), abs=1e-12)


def test_many_at_once_are_the_same_as_one_by_one() -> None:
    v = np.random.default_rng(7).normal(size=(4, 5, 3))
    R = frames.exp_so3(v)
    assert R.shape == (4, 5, 3, 3)
    assert R[2, 3] == pytest.approx(frames.exp_so3(v[2, 3]), abs=1e-15)
    assert frames.quaternion_from_R(R)[1, 4] == pytest.approx(frames.quaternion_from_R(R[1, 4]))


@given(ROTVEC, ROTVEC)
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    assert frames.skew(a) @ b == pytest.approx(np.cross(a, b), abs=1e-12)


@given(ANGLE, STEEP, ANGLE)
def test_body_angles_are_scipys_zyx(roll: float, pitch: float, yaw: float) -> None:
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    ours = frames.R_ned_from_body(roll, pitch, yaw)
    assert ours == pytest.approx(theirs, abs=1e-14)
    back = frames.rpy_from_R_ned_from_body(ours)
    assert frames.R_ned_from_body(*back) == pytest.approx(ours, abs=1e-8)


@given(ANGLE, STEEP, ANGLE)
def test_opk_is_scipys_xyz(omega: float, phi: float, kappa: float) -> None:
    theirs = Rotation.from_euler("XYZ", [omega, phi, kappa]).as_matrix()
    ours = frames.R_map_from_photo(omega, phi, kappa)
    assert ours == pytest.approx(theirs, abs=1e-14)
    back = frames.opk_from_R_map_from_photo(ours)
    assert frames.R_map_from_photo(*back) == pytest.approx(ours, abs=1e-8)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_angles_come_back_themselves(a: float, b: float, c: float) -> None:
    rpy = frames.rpy_from_R_ned_from_body(frames.R_ned_from_body(a, b, c))
    assert rpy == pytest.approx([a, b, c], abs=1e-12)
    opk = frames.opk_from_R_map_from_photo(frames.R_map_from_photo(a, b, c))
    assert opk == pytest.approx([a, b, c], abs=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_lock_the_whole_turn_is_yaw(sign: int) -> None:
    R = frames.R_ned_from_body(0.3, sign * math.pi / 2, 0.5)
    roll, pitch, yaw = frames.rpy_from_R_ned_from_body(R)
    assert (roll, pitch) == pytest.approx((0.0, sign * math.pi / 2), abs=1e-9)
    assert yaw == pytest.approx(0.5 - sign * 0.3, abs=1e-9)


@pytest.mark.parametrize(
    ("angles", "body", "ned"),
    [
        ((0, 0, 90), [1, 0, 0], [0, 1, 0]),  # heading east, forward is east
        ((0, 30, 0), [1, 0, 0], [math.cos(math.radians(30)), 0, -0.5]),  # nose up
        ((90, 0, 0), [0, 1, 0], [0, 0, 1]),  # right wing down
        ((0, 0, 90), [0, 1, 0], [-1, 0, 0]),  # heading east, right is south
    ],
    ids=["yaw", "pitch", "roll", "right-wing"],
)
def test_senses_of_roll_pitch_yaw(angles: tuple, body: list, ned: list) -> None:
    R = frames.R_ned_from_body(*np.radians(angles))
    assert R @ body == pytest.approx(ned, abs=1e-15)


def test_nominal_cameras_see_where_their_name_says() -> None:
    forward, right, down = np.eye(3)
    nadir, horizon = frames.R_BODY_FROM_CAM_NADIR, frames.R_BODY_FROM_CAM_HORIZON
    # Columns: image right, image down, view.
    assert np.array_equal(nadir.T, [right, -forward, down])
    assert np.array_equal(horizon.T, [right, down, forward])
    tipped = frames.R_ned_from_body(0.0, -math.pi / 2, 0.0) @ horizon
    assert tipped == pytest.approx(nadir, abs=1e-15)


def test_conventions_nadir_body_from_photo() -> None:
    R_body_from_photo = frames.R_BODY_FROM_CAM_NADIR @ frames.R_PHOTO_FROM_CAM.T
    assert np.array_equal(R_body_from_photo, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])


def test_zero_opk_looks_down_with_the_top_to_grid_north() -> None:
    R_map_cam = frames.R_map_from_photo(0.0, 0.0, 0.0) @ frames.R_PHOTO_FROM_CAM
    assert np.array_equal(R_map_cam @ [0, 0, 1], [0, 0, -1])
    assert np.array_equal(R_map_cam @ [0, -1, 0], [0, 1, 0])


def test_convergence_turns_true_north_to_the_left_of_grid_north_when_positive() -> None:
    # Grid north lies east of true north, so true north lies west of grid north.
    assert (frames.R_map_from_enu(math.radians(1)) @ [0, 1, 0])[0] < 0


@pytest.mark.parametrize(
    ("lat", "lon", "east", "north", "up"),
    [
        (0, 0, [0, 1, 0], [0, 0, 1], [1, 0, 0]),
        (0, 90, [-1, 0, 0], [0, 0, 1], [0, 1, 0]),
        (90, 0, [0, 1, 0], [-1, 0, 0], [0, 0, 1]),
        (-90, 0, [0, 1, 0], [1, 0, 0], [0, 0, -1]),
    ],
    ids=["gulf", "indian-ocean", "north-pole", "south-pole"],
)
def test_local_axes_at_equator_and_poles(
    lat: float, lon: float, east: list, north: list, up: list
) -> None:
    R = frames.R_ecef_from_enu(*np.radians([lat, lon]))
    assert R.T == pytest.approx(np.array([east, north, up]), abs=1e-15)
    ned = frames.R_ecef_from_ned(*np.radians([lat, lon]))
    assert ned.T == pytest.approx(np.array([north, east, np.negative(up)]), abs=1e-15)


def test_at_the_origin_enu_from_ned_is_the_swap() -> None:
    R = frames.R_enu_from_ned(0.68, -1.4, 0.68, -1.4)
    assert pytest.approx(R, abs=1e-15) == frames.R_ENU_FROM_NED_SAME_PLACE


@pytest.mark.parametrize(("dn", "de"), [(20e3, 0.0), (0.0, 20e3), (-12e3, 16e3)])
def test_twenty_km_away_the_plumb_line_leans_by_its_180_thousandths_of_a_degree(
    dn: float, de: float
) -> None:
    lat, lon = math.radians(39.1), math.radians(-80.5)
    R = frames.R_enu_from_ned(lat, lon, lat + dn / 6.36e6, lon + de / (6.386e6 * math.cos(lat)))
    lean = math.degrees(math.acos(-R[2, 2]))
    assert lean == pytest.approx(0.009 * 20.0, abs=0.002)  # deg: a constant swap gives 0
    # Down at the vehicle points back towards the origin's plumb line.
    horizontal = R[:2, 2]
    assert horizontal @ [de, dn] < 0
    assert horizontal / np.linalg.norm(horizontal) == pytest.approx(
        -np.array([de, dn]) / 20e3, abs=0.01
    )


def test_enu_from_ned_20_km_east_turns_north_by_the_meridian_convergence() -> None:
    lat = math.radians(60.0)
    dlon = 20e3 / (6.39e6 * math.cos(lat))
    R = frames.R_enu_from_ned(lat, 0.0, lat, dlon)
    # North of a place further east leans west by dlon sin(lat).
    assert math.atan2(R[0, 0], R[1, 0]) == pytest.approx(-dlon * math.sin(lat), rel=1e-3)
