"""The simulated observations that adjustments are judged by, against hand cases and the model."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from types import ModuleType
from typing import Any

import adjustment_flights as sim
import numpy as np
import pytest

from georef_gis.frames import log_so3

NO_SHARED = sim.shared_sigmas(0.0, 0.0, 0.0, 0.0)
EXACT = sim.navigation_model((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))


def nadir_flight(yaw: float) -> sim.SimFlight:
    """Two photos whose first hangs level 100 m above (0, 0), heading `yaw`, without distortion."""
    flight = sim.two_photos(
        3, sigmas=NO_SHARED, navigation=EXACT, lever=(0.0, 0.0, 0.0), distortion=(0.0,) * 5,
        sigma_distortion=(0.0,) * 5, sigma_focal=0.0, sigma_principal=0.0,
    )  # fmt: skip
    forward = np.array([math.sin(yaw), math.cos(yaw), 0.0])
    right = np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    t = flight.truth
    R_body, R_cam = t.R_enu_from_body.copy(), t.R_enu_from_cam.copy()
    R_body[0] = np.column_stack([forward, right, down])
    R_cam[0] = np.column_stack([right, -forward, down])
    places = t.p_cam.copy()
    places[0] = [0.0, 0.0, 100.0]
    still = np.zeros_like(t.velocity)
    truth = replace(t, R_enu_from_body=R_body, R_enu_from_cam=R_cam, p_imu=places, p_cam=places,
                    velocity=still, rate=still)  # fmt: skip
    return replace(flight, truth=truth)


def test_a_nadir_photo_heading_north_shows_east_on_the_right_and_north_on_top() -> None:
    uv = nadir_flight(0.0).true_pixels(0, np.array([[0.0, 0, 0], [10, 0, 0], [0, 4, 0]]))
    # 2500 px at 100 m: 25 px per m; the principal point is (21, -14) off (1999.5, 1499.5)
    expected = [[2020.5, 1485.5], [2270.5, 1485.5], [2020.5, 1385.5]]
    np.testing.assert_allclose(uv, expected, atol=1e-9)


def test_a_nadir_photo_heading_east_shows_south_on_the_right() -> None:
    uv = nadir_flight(math.pi / 2).true_pixels(0, np.array([[10.0, 0, 0], [0, 4, 0]]))
    np.testing.assert_allclose(uv, [[2020.5, 1235.5], [1920.5, 1485.5]], atol=1e-9)


def test_body_axes_of_a_level_flight_are_forward_right_down() -> None:
    """Course east: forward is east, right is south; the tilts are small and even."""
    flight = sim.strip(1, 40, tilt_deg=0.0)
    mean = flight.truth.R_enu_from_body.mean(axis=0)
    # 4 deg of crab and 1.5 deg of yaw noise
    np.testing.assert_allclose(mean, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=0.25)


def test_brown_distortion_moves_a_pixel_as_computed_by_hand() -> None:
    camera = sim.SimCamera(
        width=4000, height=3000,
        values=np.array([1000.0, 1000, 0, 0, 0.1, 0.01, 0.001, 0.002, 0.003, 5, 7]),
    )  # fmt: skip
    # x = 0.6, y = 0.8, r = 1: radial 1.111; 2 p1 x y = 0.00192, p2 (1 + 2 x^2) = 0.00516;
    # p1 (1 + 2 y^2) = 0.00456, 2 p2 x y = 0.00288
    x, y = 0.6 * 1.111 + 0.00192 + 0.00516, 0.8 * 1.111 + 0.00456 + 0.00288
    expected = [1005 * x + 7 * y, 1000 * y]
    np.testing.assert_allclose(camera.pixels(np.array([1.2, 1.6, 2.0])), expected, atol=1e-9)


def test_the_calibration_flight_is_that_of_the_reference() -> None:
    flight = sim.calibration_flight(1)
    assert flight.n_photos == 96
    # 3 242 points and 37 476 observations there
    assert 2900 < len(flight.points) < 3600
    assert 34000 < len(flight.uv) < 41000
    heights = flight.truth.p_imu[:, 2]
    assert np.all(np.minimum(abs(heights - 70), abs(heights - 110)) < 4)
    speeds = np.hypot(*flight.truth.velocity[:, :2].T)
    assert np.all(np.minimum(abs(speeds - 15), abs(speeds - 22)) < 2)


@pytest.mark.parametrize("readout", [0.0, 0.02])
def test_at_the_truth_the_package_sees_only_the_noise(readout: float) -> None:
    """0.5 px; with 20 ms of readout the package's first order in time leaves < 0.05 px."""
    flight = sim.calibration_flight(2, sigma_affinity=2.0, readout_s=readout, rate_deg_s=5.0)
    photos = sim.oriented_photos(flight, true=True)
    residuals = np.empty_like(flight.uv)
    for i, photo in enumerate(photos):
        mine = flight.photo == i
        residuals[mine] = photo.project(flight.points[flight.point[mine]]) - flight.uv[mine]
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    # sigma / sqrt(2 * 37 000) is 0.4 %
    np.testing.assert_allclose(rms, 0.5, rtol=0.015)


def test_a_rolling_shutter_moves_the_rows_of_a_photo_as_its_readout_says() -> None:
    """15 m/s for half of 20 ms at 90 m and 2500 px: 4 px at the first and last row."""
    still = {"rate_deg_s": 0.0, "relief": 0.0, "tilt_deg": 0.0, "sigma_principal": 0.0}
    flight = sim.strip(4, 2, readout_s=0.02, **still)
    frozen = replace(flight, camera_true=replace(flight.camera_true, readout_s=0.0))
    half = 0.45 * 90 * 3000 / 2500
    at = flight.truth.p_cam[0] + [[half, 0, -90.0], [0, 0, -90.0], [-half, 0, -90.0]]
    moved = (flight.true_pixels(0, at) - frozen.true_pixels(0, at))[:, 1]
    # East is forward, at the top of the image, read first. A camera that moves on sees the scene
    # move back, down the image, and at the first row it has not yet moved: up there.
    slope = 15 * 0.02 / 90 * 2500
    np.testing.assert_allclose(moved, [-0.45 * slope, 0.0, 0.45 * slope], rtol=0.1, atol=0.2)


def test_the_clock_offset_reads_the_path_later_and_the_bias_shifts_it() -> None:
    flight = sim.strip(5, 3, navigation=EXACT, sigmas=sim.shared_sigmas(0.0, 0.0, 0.3, 0.02))
    t, late = flight.truth, flight.shared_true.clock
    assert abs(late) > 1e-4
    np.testing.assert_allclose(
        flight.p_nav, t.p_imu + late * t.velocity + flight.shared_true.bias, atol=1e-12
    )
    turned = log_so3(flight.R_nav @ np.swapaxes(t.R_enu_from_body, 1, 2))
    np.testing.assert_allclose(turned, late * t.rate, atol=1e-9)


def test_lever_arm_and_boresight_place_the_camera_on_the_body() -> None:
    flight = sim.strip(6, 3, sigmas=sim.shared_sigmas(3.0, 0.5, 0.0, 0.0))
    t, shared = flight.truth, flight.shared_true
    arm = np.einsum("nji,nj->ni", t.R_enu_from_body, t.p_cam - t.p_imu)
    np.testing.assert_allclose(arm, np.tile(shared.lever, (3, 1)), atol=1e-9)
    R_body_from_cam = np.swapaxes(t.R_enu_from_body, 1, 2) @ t.R_enu_from_cam
    boresight = log_so3(R_body_from_cam @ sim.R_BODY_FROM_CAM.T)
    np.testing.assert_allclose(boresight, np.tile(shared.boresight, (3, 1)), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["correlated", "tags"])
def test_pose_errors_over_200_flights_have_the_covariance_of_the_model(kind: str) -> None:
    """Bounds are four standard deviations of a mean of 200 and of a correlation of 200."""
    navigation = {"correlated": sim.TIGHT_SLOW, "tags": sim.GPS_TAGS}[kind]
    sigmas = sim.shared_sigmas(1.0, 0.2, 0.1, 0.03)
    scaled, raw = [], []
    for seed in range(200):
        flight = sim.strip(seed, 4, navigation=navigation, sigmas=sigmas, obs_per_photo=5.0)
        truth = sim.oriented_photos(flight, true=True)
        photo, true = sim.oriented_photos(flight)[1].pose, truth[1].pose
        turned = log_so3(true.R_enu_from_cam @ photo.R_enu_from_cam.T)
        error = np.r_[true.origin_enu - photo.origin_enu, turned]
        scaled.append(np.linalg.solve(np.linalg.cholesky(photo.covariance), error))
        raw.append(flight.errors)
    z, errors = np.array(scaled), np.array(raw)
    assert np.all(abs(np.mean(z**2, axis=0) - 1) < 4 * math.sqrt(2 / 200)), np.mean(z**2, axis=0)
    assert np.all(abs(np.corrcoef(z.T) - np.eye(6)) < 4 / math.sqrt(200))
    joint = navigation.covariance(flight.truth.times)
    found = np.einsum("fic,fjc->cij", errors, errors) / 200
    sd = np.sqrt(np.einsum("cii,cjj->cij", joint, joint))
    assert np.all(abs(found - joint) / sd < 4 * math.sqrt(2 / 200))


def test_the_camera_is_drawn_about_its_nominal_values_by_its_sigmas() -> None:
    flights = [sim.two_photos(s, obs_per_photo=5.0, sigma_affinity=2.0) for s in range(200)]
    z = np.array([(f.camera_true.values - f.camera.values) / f.camera_sigma for f in flights])
    assert np.all(abs(np.mean(z**2, axis=0) - 1) < 4 * math.sqrt(2 / 200))
    np.testing.assert_array_equal(z[:, 0], z[:, 1])


def test_outliers_are_as_many_as_asked_for_and_far_off() -> None:
    flight = sim.survey(7, outliers=0.1)
    assert abs(np.mean(flight.outlier) - 0.1) < 4 * math.sqrt(0.09 / len(flight.uv))
    off = np.empty(len(flight.uv))
    for i in range(flight.n_photos):
        mine = flight.photo == i
        seen = flight.true_pixels(i, flight.points[flight.point[mine]])
        off[mine] = np.linalg.norm(seen - flight.uv[mine], axis=1)
    assert off[flight.outlier].min() > 2.0
    assert off[~flight.outlier].max() < 3.0


def test_control_and_check_points_are_surveyed_and_marked_with_their_noise() -> None:
    flight = sim.rtk(8, control=5, check=40)
    assert len(flight.control.p) == 5
    check = flight.check
    z = (check.p - check.p_true) / check.sigma
    assert abs(np.mean(z**2) - 1) < 4 * math.sqrt(2 / 120)
    marks = [
        flight.true_pixels(i, check.p_true[k]) - uv
        for i, k, uv in zip(check.photo, check.point, check.uv, strict=True)
    ]
    assert abs(np.sqrt(np.mean(np.square(marks))) - 0.5) < 4 * 0.5 / math.sqrt(4 * len(marks))
    assert np.all(np.bincount(flight.control.point, minlength=5) >= 2)


def test_points_lie_on_the_ground_and_are_seen_within_the_image() -> None:
    flight = sim.survey(9)
    off = flight.points[:, 2] - flight.relief.z_at(flight.points[:, :2])
    # 0.1 m of grass and stones; five of its sigmas
    assert abs(off).max() < 0.5
    assert np.all((flight.uv > 0) & (flight.uv < [3999, 2999]))
    assert np.all(np.bincount(flight.point) >= 2)


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_small_blocks_have_ties_between_neighbours(n: int) -> None:
    tie_points = sim.ties(sim.strip(10, n))
    assert len(tie_points.photo_ids) == n
    assert set(np.unique(tie_points.photo)) == set(range(n))
    assert tie_points.n_points == tie_points.point.max() + 1


def test_equal_seeds_give_equal_flights_and_others_differ() -> None:
    a, b, c = sim.survey(11), sim.survey(11), sim.survey(12)
    np.testing.assert_array_equal(a.uv, b.uv)
    assert a.shared_true.clock != c.shared_true.clock


@pytest.mark.slow
def test_a_large_flight_has_as_many_photos_and_observations_as_asked_for() -> None:
    flight = sim.many(13)
    assert flight.n_photos == 167
    per_photo = np.bincount(flight.photo, minlength=167)
    assert 2600 < per_photo.mean() < 3400


# ---------------------------------------------------------------------------------------------
# The oracle on them
# ---------------------------------------------------------------------------------------------


def oracle() -> ModuleType:
    pytest.importorskip("pyceres", reason="the oracle needs pycolmap and pyceres")
    pytest.importorskip("pycolmap", reason="the oracle needs pycolmap and pyceres")
    return importlib.import_module("ceres_oracle")


def shared_errors(flight: sim.SimFlight, found: Any) -> np.ndarray:
    """Errors over sigma of boresight, lever arm, bias, clock and the camera; shape (19,)."""
    t, s = flight.shared_true, found.shared
    errors = [t.boresight - s.boresight, t.lever - s.lever, t.bias - s.bias, [t.clock - s.clock],
              flight.camera_true.values[:9] - found.camera]  # fmt: skip
    return np.asarray(np.concatenate(errors) / np.sqrt(np.diag(found.shared_covariance)))


def pose_errors(flight: sim.SimFlight, found: Any) -> np.ndarray:
    """Errors over sigma of the poses; shape (n, 6)."""
    turned = flight.truth.R_enu_from_cam @ np.swapaxes(found.R_enu_from_cam, 1, 2)
    errors = np.concatenate([flight.truth.p_cam - found.origins, log_so3(turned)], axis=1)
    return np.asarray(errors / np.sqrt(np.einsum("nii->ni", found.pose_covariance)))


@pytest.mark.slow
def test_ceres_finds_the_standard_deviations_of_the_reference_on_its_flight() -> None:
    """Within 20 %: boresight 0.011/0.010/0.021 deg, clock 1.6 ms, focal 0.75 px, lever arm."""
    flight = sim.calibration_flight(1)
    found = oracle().solve_with_ceres(flight)
    np.testing.assert_allclose(found.sigma_boresight_deg, [0.011, 0.010, 0.021], rtol=0.2)
    np.testing.assert_allclose(found.sigma_clock, 0.0016, rtol=0.2)
    np.testing.assert_allclose(found.sigma_focal, 0.75, rtol=0.2)
    # stated as 0.03, 0.01 and 0.08 m: to one digit, so within half of it besides
    np.testing.assert_allclose(found.sigma_lever, [0.03, 0.01, 0.08], rtol=0.2, atol=0.005)
    assert found.quaternion_norm_error < 1e-9
    # 2 x 37 000 residuals: 0.3 %
    assert abs(found.sigma0 - 1) < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slow", "control"])
def test_errors_of_ceres_over_flights_are_what_its_sigmas_say(kind: str) -> None:
    """12 flights of 10 photos; within four standard deviations where errors hang together."""
    changes: dict[str, Any] = {"navigation": sim.TIGHT_SLOW}
    if kind == "control":
        changes = {"navigation": sim.RTK, "control": 4, "outliers": 0.02}
    poses, shared = [], []
    for seed in range(12):
        flight = sim.survey(seed, 2, 5, obs_per_photo=100.0, **changes)
        found = oracle().solve_with_ceres(flight)
        poses.append(pose_errors(flight, found))
        shared.append(shared_errors(flight, found))
    assert 0.7 < np.sqrt(np.mean(np.square(poses))) < 1.4
    assert 0.7 < np.sqrt(np.mean(np.square(shared))) < 1.3


@pytest.mark.slow
def test_ceres_with_independent_priors_is_over_confident_on_slow_errors() -> None:
    """Why a flight needs one joint prior: the yaw of the boresight seems known twice as well."""
    flight = sim.survey(1, 3, 6, navigation=sim.TIGHT_SLOW, obs_per_photo=60.0)
    sigmas = [
        oracle().solve_with_ceres(flight, independent=independent).sigma_boresight_deg[2]
        for independent in (False, True)
    ]
    assert sigmas[0] > 1.8 * sigmas[1]


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"readout_s": 0.02}, "rolling shutter"), ({"sigma_affinity": 2.0}, "skew")],
)
def test_the_oracle_refuses_what_colmap_cannot_express(
    changes: dict[str, float], word: str
) -> None:
    with pytest.raises(ValueError, match=word):
        oracle().solve_with_ceres(sim.two_photos(1, **changes))
