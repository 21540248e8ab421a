"""Delay of the fixes and noise of the IMU, found in the log itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from analytic_flights import multirotor, standing
from navigation_flights import drawn, errors_at, logs_of, settings_of

from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.tuning import Tuned, tune
from georef_gis.simulate import SimulatedFlight

pytestmark = pytest.mark.slow

REAL_AXES = {"gyro_scale_percent": 0.5, "gyro_misalignment_deg": 0.3}
# s of delay planted, by flight; the last has the axes of a real unit
PLANTED = ((0, 0.05, {}), (1, 0.3, {}), (2, 0.123, REAL_AXES), (0, 0.2, {"gnss": "white"}))


def tuned(
    flight: SimulatedFlight, late: float, *, noise: bool = False, delay: bool = True
) -> Tuned:  # fmt: skip
    log, gnss = logs_of(flight)
    fixes = prepare_fixes(replace(gnss, time=gnss.time + late))
    return tune(log, fixes, settings_of(flight), noise=noise, delay=delay)


@cache
def planted(seed: int, late: float, kind: int) -> Tuned:
    return tuned(drawn(seed, 3, **PLANTED[kind][2]), late)


@pytest.mark.parametrize("kind", range(len(PLANTED)))
def test_delay_is_found_to_ten_milliseconds(kind: int) -> None:
    seed, late, _ = PLANTED[kind]
    found = planted(seed, late, kind).delay
    assert found is not None
    assert found.seconds == pytest.approx(late, abs=0.010)  # s, of the specification
    assert f"{1e3 * found.seconds:.0f} +-" in planted(seed, late, kind).notes[-1]


def test_sigma_of_the_delay_is_honest() -> None:
    ratio = []
    for kind, (seed, late, _) in enumerate(PLANTED):
        found = planted(seed, late, kind).delay
        assert found is not None
        assert 0.0005 < found.sigma < 0.005  # s
        ratio.append((found.seconds - late) / found.sigma)
    assert np.abs(ratio).max() < 3.0
    # four flights: chi-square of four degrees of freedom exceeds 2 sigma^2 once in ten
    assert np.sqrt(np.mean(np.square(ratio))) < 1.5


def test_fixes_are_shifted_by_the_delay_found() -> None:
    flight = drawn(0, 3, gnss="white")
    log, gnss = logs_of(flight)
    fixes = prepare_fixes(replace(gnss, time=gnss.time + 0.2))
    found = planted(0, 0.2, 3)
    assert found.delay is not None
    # s: a tenth of a millisecond is 2 mm
    np.testing.assert_allclose(found.fixes.time, fixes.time - found.delay.seconds, atol=1e-4)
    trajectory = smooth_flight(log, found.fixes, found.settings)
    times = np.arange(trajectory.span[0] + 2.0, trajectory.span[1] - 2.0, 1.7)
    # m; 0.2 s at 20 m/s would be 4 m
    assert np.abs(errors_at(flight, trajectory, times)[:, :3]).max() < 1.0


@pytest.mark.parametrize("seed", [3, 4])
def test_fixes_in_time_are_left_alone(seed: int) -> None:
    found = tuned(drawn(seed, 3, gnss="white" if seed == 3 else "coloured"), 0.0)
    assert found.delay is not None
    assert not found.delay.significant
    assert abs(found.delay.seconds) < 0.006  # s
    assert found.notes == ()


def test_early_stamps_are_found_too() -> None:
    found = tuned(drawn(5, 3), -0.06).delay
    assert found is not None
    assert found.seconds == pytest.approx(-0.06, abs=0.010)  # s


def test_delay_of_a_multirotor_is_found() -> None:
    found = tuned(multirotor(1, 50.0), 0.15).delay
    assert found is not None
    assert found.seconds == pytest.approx(0.15, abs=0.02)  # s: 5 m/s tell less than 20 m/s


def test_log_that_stands_tells_no_delay() -> None:
    found = tuned(standing(0, 120.0), 0.2, noise=True)
    assert found.delay is None or not found.delay.significant
    assert found.delay is None or found.delay.sigma > 0.05  # s


def test_honest_noise_is_left_alone() -> None:
    found = tuned(drawn(6, 3), 0.0, noise=True, delay=False)
    assert max(found.noise_factors) <= 3.5
    assert min(found.noise_factors) >= 1.0 / 3.5


@pytest.mark.parametrize(("gyro", "accel"), [(10.0, 10.0), (10.0, 1.0), (1.0, 30.0)])
def test_noise_of_the_imu_is_found_within_half_a_decade(gyro: float, accel: float) -> None:
    flight = drawn(7, 3, gyro_walk_deg_rt_h=0.3 * gyro, accel_walk_rt_h=0.1 * accel)
    found = tuned(flight, 0.0, noise=True, delay=False)
    # neighbours of the search are a factor of 3.2 apart; less noise than stated costs no accuracy
    assert gyro / 3.5 < found.noise_factors[0] < gyro * 3.5
    assert accel / 3.5 < found.noise_factors[1] < accel * 3.5


def test_tuned_noise_makes_the_sigmas_honest() -> None:
    flight = drawn(7, 3, gyro_walk_deg_rt_h=3.0, accel_walk_rt_h=1.0, gnss="white")
    log, gnss = logs_of(flight)
    found = tuned(flight, 0.0, noise=True, delay=False)
    ratio = []
    for settings in (settings_of(flight), found.settings):
        trajectory = smooth_flight(log, prepare_fixes(gnss), settings)
        times = np.arange(trajectory.span[0] + 5.0, trajectory.span[1] - 5.0, 1.1)
        error = errors_at(flight, trajectory, times)
        covariance = trajectory.at(times).covariance
        ratio.append(np.sqrt(np.mean(error**2 / np.einsum("nii->ni", covariance), axis=0)))
    assert ratio[0][3:5].max() > 1.5
    assert ratio[1].max() < 1.8  # one flight: a few independent values of each
