"""Truth and measurements of a flight in memory."""

import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from georef_gis.simulate import (
    FlightSettings,
    ellipsoid,
    project_truth,
    simulate_flight,
    simulate_imu,
    site,
)
from georef_gis.simulate.flight import NOMINAL_BODY_FROM_CAM, rotation_of_vector
from georef_gis.simulate.optics import pixels_from_cam, rays_of_pixels


def opencv_pixels(flight, index, points, R=None, shift=0.0, swap=False):
    """OpenCV's pixels of ECEF points, with a mistake if asked for one."""
    c = flight.settings.camera
    R = flight.R_ecef_from_cam[index].T if R is None else R
    K = np.array([[c.fx, 0, c.cx + shift], [0, c.fy, c.cy + shift], [0, 0, 1.0]])
    d = (points - flight.p_ecef[index]) @ R.T
    coefficients = np.array([c.k1, c.k2, c.p1, c.p2, c.k3])
    uv = cv2.projectPoints(d, np.zeros(3), np.zeros(3), K, coefficients)[0].reshape(-1, 2)
    return uv[:, ::-1] if swap else uv


def targets_in(flight, index):
    names = {m.point for m in flight.marks if m.photo == index}
    return np.array([p.p_ecef for p in flight.control if p.name in names])


def test_projection_agrees_with_opencv(flight):
    for i in range(len(flight.names)):
        points = targets_in(flight, i)
        expected = opencv_pixels(flight, i, points)
        np.testing.assert_allclose(project_truth(flight, i, points), expected, atol=1e-6)  # px


@pytest.mark.parametrize(
    ("mistake", "pixels"),
    [("transposed", 100.0), ("swapped", 100.0), ("half a pixel", 0.4), ("mirrored", 10.0)],
)
def test_a_planted_mistake_shows_in_the_oracle(flight, mistake, pixels):
    points = targets_in(flight, 6)
    R = flight.R_ecef_from_cam[6]
    wrong = {
        "transposed": {"R": R},
        "swapped": {"swap": True},
        "half a pixel": {"shift": 0.5},
        "mirrored": {"R": np.diag([-1.0, -1.0, 1.0]) @ R.T},
    }[mistake]
    miss = opencv_pixels(flight, 6, points, **wrong) - project_truth(flight, 6, points)
    assert np.abs(miss).max() > pixels


def test_rays_and_pixels_are_inverse(flight):
    camera = flight.settings.camera
    uv = np.array([[0.0, 0.0], [1295, 863], [1295, 0], [camera.cx, camera.cy]])
    np.testing.assert_allclose(pixels_from_cam(rays_of_pixels(uv, camera), camera), uv, atol=1e-6)


def test_points_behind_the_camera_have_no_pixel(flight):
    above = flight.p_ecef[0] + 50.0 * flight.p_ecef[0] / np.linalg.norm(flight.p_ecef[0])
    assert np.isnan(project_truth(flight, 0, above)).all()


def test_nadir_camera_sees_forward_at_the_top(flight):
    i = 2
    velocity = flight.states.v_ecef[i] / np.linalg.norm(flight.states.v_ecef[i])
    down = -flight.p_ecef[i] / np.linalg.norm(flight.p_ecef[i])
    ahead, behind = (project_truth(flight, i, flight.p_ecef[i] + 60 * down + s * 15 * velocity)
                     for s in (1, -1))  # fmt: skip
    assert ahead[1] < behind[1] - 300  # px


def test_camera_hangs_on_its_lever_arm_and_boresight(flight):
    R = flight.states.R_ecef_from_body
    arm = np.einsum("nji,nj->ni", R, flight.p_ecef - flight.states.p_ecef)
    np.testing.assert_allclose(arm, np.broadcast_to(flight.lever_arm_camera, arm.shape), atol=1e-6)
    R_bc = Rotation.from_rotvec(flight.boresight).as_matrix() @ np.array(NOMINAL_BODY_FROM_CAM)
    np.testing.assert_allclose(R @ R_bc, flight.R_ecef_from_cam, atol=1e-12)
    np.testing.assert_allclose(rotation_of_vector(np.zeros(3)), np.eye(3))


def test_same_seed_same_flight_and_another_seed_another():
    a, b, c = (simulate_flight(seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(a.p_ecef, b.p_ecef)
    np.testing.assert_array_equal(a.tags.lat_deg, b.tags.lat_deg)
    np.testing.assert_array_equal(simulate_imu(a).gyro, simulate_imu(b).gyro)
    assert a.clock_offset != c.clock_offset
    assert np.abs(a.boresight - c.boresight).max() > 0


def test_a_flight_takes_less_than_half_a_second():
    start = time.process_time()
    simulate_flight(seed=1)
    assert time.process_time() - start < 0.5  # s


def test_a_switch_moves_no_other_draw(flight):
    white = simulate_flight(replace(flight.settings, gnss="white"), seed=7)
    np.testing.assert_array_equal(white.p_ecef, flight.p_ecef)
    np.testing.assert_array_equal(white.marks[0].uv, flight.marks[0].uv)
    none = simulate_flight(replace(flight.settings, attitude_tag="none"), seed=7)
    assert np.isnan(none.tags.yaw_deg).all()
    np.testing.assert_array_equal(none.tags.lat_deg, flight.tags.lat_deg)


def tag_errors(settings, seed):
    """Tag minus truth: east, north, up (m), roll, pitch, yaw (deg), shape (n, 6)."""
    f = simulate_flight(settings, seed)
    tags = f.tags
    lat, lon = np.radians(tags.lat_deg), np.radians(tags.lon_deg)
    h = tags.height_orthometric + site.geoid_height(lat, lon)
    here = f.states.p_ecef + f.states.R_ecef_from_body @ f.lever_arm_antenna
    turn = site.rotation_ecef_from_site_enu()
    d_enu = (ellipsoid.ecef_from_geodetic(lat, lon, h) - here) @ turn
    angles = np.column_stack([tags.roll_deg, tags.pitch_deg, tags.yaw_deg])
    d_angles = (angles - np.degrees(f.states.rpy) + 180.0) % 360.0 - 180.0
    return np.hstack([d_enu, d_angles])


@pytest.mark.slow
@pytest.mark.parametrize("gnss", ["coloured", "white"])
def test_tag_errors_have_the_stated_sigmas(gnss):
    settings = FlightSettings(gnss=gnss)
    errors = np.concatenate([tag_errors(settings, seed) for seed in range(60)])
    rms = np.sqrt(np.mean(errors**2, axis=0))
    a = settings.attitude_sigma_deg
    sigma = [settings.tag_sigma_h] * 2 + [settings.tag_sigma_v, a, a, settings.tag_sigma_yaw_deg]
    # 60 flights of correlated errors: a ratio spreads by about 0.1
    assert np.all(np.abs(rms / sigma - 1.0) < 0.3), rms / sigma


def test_white_gnss_has_its_circular_error_probable():
    settings = FlightSettings(gnss="white")
    error = np.concatenate([simulate_flight(settings, s).gnss.error_ned[:, :2] for s in range(6)])
    assert np.median(np.hypot(*error.T)) == pytest.approx(2.5, rel=0.06)  # m: 3300 fixes


def test_coloured_gnss_forgets_with_its_time_constant():
    rows = [simulate_flight(seed=s).gnss.error_ned for s in range(40)]
    near = np.mean([np.mean(e[1:] * e[:-1]) for e in rows])
    # m2: white noise falls out of the lag product, 2 m squared of Gauss-Markov stays
    assert near == pytest.approx(4.0, rel=0.35)


def test_imu_errors_have_their_biases(flight):
    true, noisy = simulate_imu(flight, errors=False), simulate_imu(flight)
    gyro, accel = noisy.gyro - true.gyro, noisy.accel - true.accel
    np.testing.assert_allclose(gyro.mean(axis=0), noisy.gyro_bias, atol=1e-4)  # rad/s
    np.testing.assert_allclose(accel.mean(axis=0), noisy.accel_bias, atol=2e-3)  # m/s2
    assert gyro.std() > 0
    assert len(noisy.time) > 9000


def test_gnss_stands_at_the_antenna(flight):
    states = flight.path.states(flight.gnss.time)
    arm = np.einsum("nji,nj->ni", states.R_ecef_from_body, flight.gnss.p_ecef_true - states.p_ecef)
    np.testing.assert_allclose(arm, np.broadcast_to(flight.lever_arm_antenna, arm.shape), atol=1e-6)


def test_tag_is_the_last_fix_before_the_exposure(flight):
    k = np.array([np.argmin(np.abs(np.radians(lat) - flight.gnss.lat)) for lat in
                  flight.tags.lat_deg])  # fmt: skip
    age = flight.exposures - flight.gnss.time[k]
    assert age.min() >= 0.0
    assert age.max() <= 0.2  # s: 5 Hz


def test_camera_clock_is_local_time_with_offset_and_drift(flight):
    from georef_gis.simulate.flight import LOCAL_FROM_UTC
    from georef_gis.units import utc_from_gps

    for t, shown in zip(flight.exposures, flight.tags.camera_clock, strict=True):
        local = (utc_from_gps(flight.start_gps + t) + LOCAL_FROM_UTC).replace(tzinfo=None)
        expected = flight.clock_offset + flight.clock_drift * t
        assert -1.0 < (shown - local).total_seconds() - expected <= 1e-3  # s: cut to seconds


def test_one_trigger_is_missed_and_one_is_spurious():
    for seed in range(10):
        photos = [t.photo for t in simulate_flight(seed=seed).triggers]
        known = [p for p in photos if p is not None]
        assert len(photos) == 16
        assert photos.count(None) == 1
        assert known == sorted(known)
        assert len(known) == 15


def test_every_target_is_marked_in_three_photos_or_more():
    for seed in range(5):
        marks = [m.point for m in simulate_flight(seed=seed).marks]
        assert min(marks.count(f"P{i:02d}") for i in range(1, 13)) >= 3
