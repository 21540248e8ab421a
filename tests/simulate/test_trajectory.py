"""The path, its IMU and its place over the ground."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from georef_gis.simulate import ellipsoid, enu_from_ecef, simulate_flight, simulate_imu, site
from georef_gis.simulate.trajectory import dubins, rotation_ned_from_body


def integrate(flight, imu, start_s, seconds):
    """Position after strapdown integration in ECEF of the error-free IMU, shape (3,), m."""
    dt = imu.time[1] - imu.time[0]
    first = round(start_s / dt)
    state = flight.path.states(imu.time[[first]])
    p, v, R = state.p_ecef[0], state.v_ecef[0], state.R_ecef_from_body[0]
    earth = np.array([0.0, 0.0, 7.292115e-5])
    turn_back = Rotation.from_rotvec(-earth * dt).as_matrix()
    for k in range(first, first + round(seconds / dt)):
        rate = (imu.gyro[k] + imu.gyro[k + 1]) / 2
        R_next = turn_back @ R @ Rotation.from_rotvec(rate * dt).as_matrix()
        force = (R @ imu.accel[k] + R_next @ imu.accel[k + 1]) / 2
        lat, lon, h = ellipsoid.geodetic_from_ecef(p)
        down = -np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        a = force + down * ellipsoid.gravity(lat, h) - 2 * np.cross(earth, v)
        p, v, R = p + v * dt + a * dt**2 / 2, v + a * dt, R_next
    return p, imu.time[first + round(seconds / dt)]


@pytest.mark.parametrize("start_s", [3.0, 45.0], ids=["row", "turn"])
def test_error_free_imu_integrates_to_the_path(flight, start_s):
    imu = simulate_imu(flight, errors=False)
    p, time = integrate(flight, imu, start_s, 30.0)
    expected = flight.path.states(np.array([time])).p_ecef[0]
    np.testing.assert_allclose(p, expected, atol=0.05)  # m: trapezoids at 100 Hz over 30 s


def test_a_wrong_sign_of_earth_rate_would_be_seen(flight):
    imu = simulate_imu(flight, errors=False)
    states = flight.path.states(imu.time)
    earth = np.array([0.0, 0.0, 7.292115e-5])
    twice = 2 * np.einsum("nji,j->ni", states.R_ecef_from_body, earth)
    wrong = type(imu)(time=imu.time, gyro=imu.gyro - twice, accel=imu.accel,
                      gyro_bias=imu.gyro_bias, accel_bias=imu.accel_bias)  # fmt: skip
    p, time = integrate(flight, wrong, 3.0, 30.0)
    expected = flight.path.states(np.array([time])).p_ecef[0]
    assert np.linalg.norm(p - expected) > 1.0  # m


def test_velocity_is_the_derivative_of_position(flight):
    t = np.array([5.0, 30.0, 70.0])
    d = 1e-3
    p0, p1 = (flight.path.states(t + s).p_ecef for s in (-d, d))
    v = flight.path.states(t).v_ecef
    np.testing.assert_allclose((p1 - p0) / (2 * d), v, atol=1e-4)  # m/s: rounding of ECEF


def test_written_out_rotation_is_yaw_pitch_roll():
    rpy = np.array([[0.2, -0.3, 2.0], [-0.5, 0.1, -1.0]])
    expected = Rotation.from_euler("ZYX", rpy[:, ::-1]).as_matrix()
    np.testing.assert_allclose(rotation_ned_from_body(rpy), expected, atol=1e-12)


def test_sixteen_photos_in_two_crossing_directions_at_52_to_90_metres():
    for seed in range(20):
        flight = simulate_flight(seed=seed)
        p = enu_from_ecef(flight.p_ecef)
        above = p[:, 2] - site.terrain_up(p[:, 0], p[:, 1])
        assert len(flight.names) == 16
        assert above.min() > 52.0  # m
        assert above.max() < 90.0
        speed = np.linalg.norm(flight.states.v_ecef, axis=-1)
        np.testing.assert_allclose(speed, 20.0, atol=1.5)  # m/s: gusts
    course = np.degrees(flight.states.rpy[:, 2] - site.ROAD_AZIMUTH)
    crossing = np.abs(np.sin(np.radians(course)))
    assert np.sum(crossing < 0.5) == 10
    assert np.sum(crossing > 0.85) == 6


def test_aircraft_rolls_and_pitches_in_turbulence(flight):
    rpy = np.degrees(flight.path.states(np.arange(0.0, 13.0, 0.02)).rpy)
    assert 1.0 < rpy[:, 0].std() < 6.0  # deg
    assert 0.7 < rpy[:, 1].std() < 4.0


def test_dubins_path_starts_and_ends_in_the_given_directions():
    p, q = np.array([0.0, 0.0]), np.array([30.0, 200.0])
    path = dubins(p, 0.3, q, 2.0, 40.0)
    np.testing.assert_allclose(path[[0, -1]], [p, q], atol=1e-9)
    for step, heading in ((path[1] - path[0], 0.3), (path[-1] - path[-2], 2.0)):
        turned = np.arctan2(step[1], step[0]) - heading
        assert abs(np.angle(np.exp(1j * turned))) < 0.03  # rad: one chord
