"""First attitude without a magnetometer: right within its sigma, whatever way the vehicle moves."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from analytic_flights import multirotor, standing, straight, waiting_first
from navigation_flights import drawn, errors_at, logs_of, smoothed, truth_at

from georef_gis.errors import NavigationError
from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.model.logs import GnssLog, unknown
from georef_gis.navigate.alignment import SIGMA_ANY, Alignment, align, carried_back
from georef_gis.navigate.filter_pass import imu_table
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.simulate import SimulatedFlight

SURVEYS = [(seed, gnss) for seed in range(3) for gnss in ("white", "coloured")]


def aligned(flight: SimulatedFlight, **changes: object) -> tuple[Alignment, Array]:
    """First attitude of a flight and its error, true less found, about N, E, D, rad."""
    log, gnss = logs_of(flight)
    found = align(imu_table(log), prepare_fixes(replace(gnss, **changes)))
    return found, error_of(flight, found)


def error_of(flight: SimulatedFlight, found: Alignment) -> Array:
    R = truth_at(flight, np.array([found.time]))[2][0]
    return np.asarray(log_so3(R @ found.R_ned_from_body.T))


def assert_right(found: Alignment, error: Array) -> None:
    """Within three sigmas: the tail of a normal error."""
    assert np.abs(error[:2]).max() < 3.0 * found.sigma_level
    assert abs(error[2]) < 3.0 * found.sigma_heading


def every(gnss: GnssLog, step: int) -> GnssLog:
    """Every so many fixes of a log."""
    rows = {
        f.name: getattr(gnss, f.name)[::step]
        for f in dataclasses.fields(gnss)
        if isinstance(getattr(gnss, f.name), np.ndarray)
    }
    return replace(gnss, **rows)


@pytest.mark.parametrize(("seed", "gnss"), SURVEYS)
def test_survey_is_aligned_by_its_turns(seed: int, gnss: str) -> None:
    found, error = aligned(drawn(seed, 2, gnss=gnss))
    assert_right(found, error)
    assert found.sigma_heading < math.radians(5.0)


@pytest.mark.parametrize("yaw_deg", [50.0, -130.0, 180.0, 0.0])
def test_multirotor_flying_sideways_is_aligned_to_its_nose(yaw_deg: float) -> None:
    found, error = aligned(multirotor(3, yaw_deg))
    assert_right(found, error)
    assert abs(error[2]) < math.radians(5.0)
    assert "course" not in found.method


def test_multirotor_that_turns_all_the_time_is_aligned() -> None:
    found, error = aligned(multirotor(4, 10.0, yaw_rate_deg=20.0))
    assert_right(found, error)
    assert abs(error[2]) < math.radians(5.0)


def test_heading_of_multirotors_is_as_good_as_its_sigma() -> None:
    ratio = []
    for seed in range(12):
        found, error = aligned(multirotor(seed, 30.0 * seed, legs=4))
        ratio.append(error[2] / found.sigma_heading)
    # conservative is right for a first attitude: the filter only starts there
    assert np.sqrt(np.mean(np.square(ratio))) < 1.4


@pytest.mark.parametrize("seed", range(3))
def test_waiting_on_the_ground_does_not_spoil_it(seed: int) -> None:
    found, error = aligned(waiting_first(seed, 200.0))
    assert_right(found, error)
    assert found.sigma_heading < math.radians(5.0)


@pytest.mark.parametrize("seed", range(4))
def test_straight_flight_has_its_course_with_a_sigma_that_covers_crab(seed: int) -> None:
    found, error = aligned(straight(seed, 100.0, shake=0.05))
    assert_right(found, error)
    assert found.sigma_heading > math.radians(7.0)
    assert abs(error[2]) < math.radians(30.0)  # the crab is 8 deg


@pytest.mark.parametrize("seed", range(6))
def test_standing_vehicle_has_no_heading_and_says_so(seed: int) -> None:
    found, error = aligned(standing(seed, 60.0))
    assert found.sigma_heading >= math.radians(60.0)
    assert np.abs(error[:2]).max() < 3.0 * found.sigma_level
    assert found.sigma_heading <= SIGMA_ANY


def test_positions_alone_align_a_survey() -> None:
    flight = drawn(1, 3)
    n = len(flight.gnss.time)
    found, error = aligned(flight, v_ned=unknown(n, 3), covariance_v_ned=unknown(n, 3, 3))
    assert_right(found, error)
    assert found.sigma_heading < math.radians(15.0)


@pytest.mark.parametrize("seed", range(3))
def test_positions_once_a_second_align_a_survey(seed: int) -> None:
    flight = drawn(seed, 3)
    log, gnss = logs_of(flight)
    n = len(gnss)
    bare = replace(gnss, v_ned=unknown(n, 3), covariance_v_ned=unknown(n, 3, 3))
    found = align(imu_table(log), prepare_fixes(every(bare, 5)))
    assert_right(found, error_of(flight, found))


def test_late_fixes_do_not_turn_the_nose() -> None:
    flight = drawn(2, 3)
    found, error = aligned(flight, time=logs_of(flight)[1].time + 0.25)
    # 0.25 s of a turn at 6 deg/s is 1.5 deg
    assert abs(error[2]) < 3.0 * found.sigma_heading + math.radians(1.5)


def test_real_axes_do_not_matter() -> None:
    found, error = aligned(drawn(3, 3, gyro_scale_percent=0.5, gyro_misalignment_deg=0.3))
    assert_right(found, error)


def test_large_bias_of_the_gyro_does_not_matter() -> None:
    found, error = aligned(drawn(4, 3, gyro_bias_deg_h=1000.0, accel_bias=0.15))
    assert_right(found, error)


def test_any_mounting_is_aligned() -> None:
    """Axes turned by any angle: the attitude is that of the axes as logged."""
    flight = drawn(1, 2)
    log, gnss = logs_of(flight)
    for angle in ([0.0, 0.0, 2.5], [math.pi, 0.0, 0.0], [0.0, 1.2, 0.4]):
        R_body_turned = exp_so3(np.array(angle))
        turned = replace(log, gyro=log.gyro @ R_body_turned, accel=log.accel @ R_body_turned)
        found = align(imu_table(turned), prepare_fixes(gnss))
        R = truth_at(flight, np.array([found.time]))[2][0] @ R_body_turned
        error = log_so3(R @ found.R_ned_from_body.T)
        assert np.abs(error[:2]).max() < 3.0 * found.sigma_level
        assert abs(error[2]) < 3.0 * found.sigma_heading


def test_attitude_is_carried_back_by_the_gyro() -> None:
    flight = drawn(6, 2)
    log, _ = logs_of(flight, errors=False)
    start, later = log.time[0] + 5.0, log.time[0] + 45.0
    R = truth_at(flight, np.array([start, later]))[2]
    at = Alignment(time=later, R_ned_from_body=R[1], sigma_level=0.0, sigma_heading=0.0, method="")
    back = carried_back(imu_table(log), at, np.zeros(3), start)
    # the Earth turns by 15 deg/h: 0.17 deg in 40 s
    assert np.linalg.norm(log_so3(R[0] @ back.T)) < math.radians(0.2)


def test_logs_without_common_time_are_refused() -> None:
    log, gnss = logs_of(drawn(0, 1))
    with pytest.raises(NavigationError, match="do not overlap"):
        align(imu_table(log), prepare_fixes(replace(gnss, time=gnss.time + 86400.0)))


@pytest.mark.slow
def test_waiting_vehicle_is_smoothed_back_to_its_start_within_its_sigma() -> None:
    squares = []
    for seed in range(4):
        flight = waiting_first(seed, 200.0, gnss="white")
        trajectory = smoothed(flight)
        assert trajectory.span[0] < flight.start_gps + 1.0
        times = flight.start_gps + np.arange(5.0, 200.0, 15.0)
        error = errors_at(flight, trajectory, times)
        covariance = trajectory.at(times).covariance
        squares.append(error**2 / np.einsum("nii->ni", covariance))
    ratio = np.sqrt(np.mean(squares, axis=(0, 1)))
    assert np.sqrt(np.mean(ratio[:3] ** 2)) < 1.6
    assert np.sqrt(np.mean(ratio[3:] ** 2)) < 1.6  # four flights: one value each of tilt
    assert np.sqrt(np.max(squares)) < 4.5
