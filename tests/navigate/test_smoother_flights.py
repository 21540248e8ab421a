"""Accuracy and honesty of smoothed surveys: ideal and real axes, white and slow GNSS errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from navigation_flights import drawn, errors_at, logs_of, settings_of, smoothed, truth_at

from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.simulate import SimulatedFlight

pytestmark = pytest.mark.slow

FLIGHTS = 4
# what the data sheet of the simulated unit says, axes taken as perfect
SHEET = {
    "gyro_bias": math.radians(100.0) / 3600.0,
    "accel_bias": 0.03,
    "scale": 0.0,
    "misalignment": 0.0,
}
REAL_AXES = {"gyro_scale_percent": 0.5, "gyro_misalignment_deg": 0.3}


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Over flights: rms of N, E, D (m) and roll, pitch, heading (deg); squared ratios.

    `ratio` (6,) is rms of error/sigma; `nees_p`, `nees_att` the mean of NEES / 3; `steps` rows of
    (lag s, rms of the error of a position's difference m, its rms error/sigma, that in attitude).
    """

    ned: Array
    rph: Array
    ratio: Array
    nees_p: float
    nees_att: float
    steps: Array


def rph_errors(R_true: Array, theta_ned: Array) -> Array:
    """Errors about the nose's level direction, the wing's and down, deg; small angles."""
    heading = np.arctan2(R_true[:, 1, 0], R_true[:, 0, 0])
    c, s = np.cos(heading), np.sin(heading)
    n, e, d = theta_ned.T
    return np.degrees(np.stack([c * n + s * e, c * e - s * n, d], axis=-1))


def without_constant(R_true: Array, R_est: Array) -> Array:
    """Attitude errors in NED after the flight's mean rotation in the body is taken out, rad."""
    mean = log_so3(np.swapaxes(R_est, -1, -2) @ R_true).mean(axis=0)
    return np.asarray(log_so3(R_true @ exp_so3(-mean) @ np.swapaxes(R_est, -1, -2)))


def nees(error: Array, covariance: Array) -> Array:
    """Error' covariance^-1 error / 3 of rows (n, 3)."""
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0


def steps_of(trajectory: InertialTrajectory, flight: SimulatedFlight, lag: float) -> Array:
    """Squares (position m^2, error/sigma of position, of attitude) of differences, (3,)."""
    starts = np.arange(trajectory.span[0] + 10.0, trajectory.span[1] - 20.0, 9.7)
    times = np.sort(np.concatenate([starts, starts + lag]))
    chain = trajectory.chain(times)
    error = errors_at(flight, trajectory, times)
    rows = []
    for start in starts:
        i, j = np.searchsorted(times, [start, start + lag - 1e-9])
        cross = chain.cross(int(i), int(j))
        C = chain.covariance[i][:6, :6] + chain.covariance[j][:6, :6] - cross - cross.T
        rows.append(np.concatenate([error[j] - error[i], np.sqrt(C.diagonal())]))
    d, sigma = np.split(np.array(rows), 2, axis=1)
    ratio = (d / sigma) ** 2
    return np.array([np.mean(d[:, :3] ** 2), np.mean(ratio[:, :3]), np.mean(ratio[:, 3:])])


def solved(flight: SimulatedFlight, *, sheet: bool, real_axes: bool) -> InertialTrajectory:
    """Trajectory; nothing is gated where axes are taken as perfect that are not."""
    log, gnss = logs_of(flight)
    settings = settings_of(flight, **(SHEET if sheet else {}))
    if sheet and real_axes:
        settings = replace(settings, gate=1e-12)
    return smooth_flight(log, prepare_fixes(gnss), settings)


@cache
def figures(
    gnss: str, *, sheet: bool, real_axes: bool, flights: int = FLIGHTS, rows: int = 10
) -> Figures:
    lags = (1.0, 2.0, 5.0)
    ned, rph, ratio, consistency, steps = [], [], [], [], []
    for seed in range(flights):
        flight = drawn(seed, rows, gnss=gnss, **(REAL_AXES if real_axes else {}))
        trajectory = solved(flight, sheet=sheet, real_axes=real_axes)
        times = np.arange(trajectory.span[0] + 1.0, trajectory.span[1] - 1.0, 0.73)
        states = trajectory.at(times)
        error = errors_at(flight, trajectory, times)
        R_true = truth_at(flight, times)[2]
        theta = error[:, 3:]
        if real_axes:
            theta = without_constant(R_true, states.R_ned_from_body)
        C = states.covariance
        ned.append(np.mean(error[:, :3] ** 2, axis=0))
        rph.append(np.mean(rph_errors(R_true, theta) ** 2, axis=0))
        ratio.append(np.mean(error**2 / np.einsum("nii->ni", C), axis=0))
        consistency.append([
            nees(error[:, :3], C[:, :3, :3]).mean(), nees(error[:, 3:], C[:, 3:, 3:]).mean(),
        ])  # fmt: skip
        steps.append([steps_of(trajectory, flight, lag) for lag in lags])
    p, att = np.mean(consistency, axis=0)
    return Figures(
        ned=np.sqrt(np.mean(ned, axis=0)), rph=np.sqrt(np.mean(rph, axis=0)),
        ratio=np.sqrt(np.mean(ratio, axis=0)), nees_p=float(p), nees_att=float(att),
        steps=np.column_stack([lags, np.sqrt(np.mean(steps, axis=0))]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def white() -> Figures:
    return figures("white", sheet=True, real_axes=False)


@pytest.fixture(scope="module")
def slow() -> Figures:
    return figures("coloured", sheet=True, real_axes=False)


@pytest.fixture(scope="module")
def real() -> Figures:
    return figures("white", sheet=False, real_axes=True, flights=2)


def test_ideal_axes_and_white_fixes_reach_centimetres_and_hundredths(white: Figures) -> None:
    # limits of the specification
    assert np.all(white.ned <= [0.15, 0.15, 0.18])  # m
    assert np.all(white.rph <= [0.015, 0.015, 0.05])  # deg


def test_ideal_axes_and_white_fixes_give_honest_sigmas(white: Figures) -> None:
    assert np.all((white.ratio > 0.7) & (white.ratio < 1.4))
    assert 0.8 <= white.nees_att <= 1.25
    assert 0.5 <= white.nees_p <= 1.5  # few independent positions: they average over minutes


def test_slow_error_stays_in_position_and_its_sigma_says_so(slow: Figures) -> None:
    # a handful of independent values a flight and axis, so all axes together
    assert 0.7 < np.sqrt(np.mean(slow.ratio[:3] ** 2)) < 1.4
    assert 0.8 <= slow.nees_att <= 1.25


def test_slow_error_does_not_reach_the_attitude(white: Figures, slow: Figures) -> None:
    assert np.all(slow.rph <= 1.1 * white.rph)


@pytest.mark.parametrize("kind", ["white", "slow"])
def test_neighbouring_exposures_lie_right_to_each_other(
    kind: str, request: pytest.FixtureRequest
) -> None:
    found: Figures = request.getfixturevalue(kind)
    assert np.all(found.steps[:, 1] <= 0.15)  # m, 1 to 5 s apart
    assert np.all((found.steps[:, 2:] > 0.7) & (found.steps[:, 2:] < 1.4))


def test_default_settings_cost_no_position(white: Figures) -> None:
    usual = figures("white", sheet=False, real_axes=False, flights=2)
    np.testing.assert_array_less(usual.ned, [0.17, 0.17, 0.19])  # m
    # the misalignment allowed for is a rotation that only the flight's dynamics tell
    assert 0.5 <= usual.nees_att <= 2.0
    assert np.all((usual.steps[:, 2:] > 0.6) & (usual.steps[:, 2:] < 1.4))


def test_real_axes_break_a_filter_that_takes_them_as_perfect() -> None:
    plain = figures("white", sheet=True, real_axes=True, flights=2)
    assert plain.rph[2] > 0.2  # deg
    assert plain.nees_att > 20.0


def test_real_axes_are_held_by_the_extra_states(real: Figures) -> None:
    assert np.all(real.rph <= [0.1, 0.1, 0.3])  # deg, constant rotation removed
    assert np.all(real.ned <= [0.17, 0.17, 0.19])  # m
    assert 0.4 <= real.nees_att <= 2.0
    assert np.all(real.steps[:, 1] <= 0.15)  # m


def test_real_axes_with_slow_fixes_are_held_too() -> None:
    found = figures("coloured", sheet=False, real_axes=True, flights=2)
    assert np.all(found.rph <= [0.1, 0.1, 0.3])  # deg
    assert 0.3 <= found.nees_att <= 2.0
    assert np.all(found.steps[:, 1] <= 0.15)  # m


def bends(error: Array) -> Array:
    """Second differences of rows."""
    return error[2:] - 2.0 * error[1:-1] + error[:-2]


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_smoothed_position_does_not_jump_at_fixes(rate: float) -> None:
    flight = drawn(2, 2, gnss_rate=rate)
    trajectory = smoothed(flight)
    rng = np.random.default_rng(0)
    fixes = trajectory.nodes[trajectory.chi[:, 0] >= 0.0][5:-5]
    fixes = rng.choice(fixes, min(150, len(fixes)), replace=False)
    between = fixes + rng.uniform(0.02, 0.98 / rate - 0.02, len(fixes))
    step = 0.01  # s
    size = {}
    for name, at in (("fix", fixes), ("between", between)):
        times = (at[:, None] + step * np.array([-1.0, 0.0, 1.0])).ravel()
        order = np.argsort(times)
        error = np.empty((len(times), 6))
        error[order] = errors_at(flight, trajectory, times[order])
        bent = np.concatenate([bends(e) for e in error.reshape(-1, 3, 6)])
        size[name] = np.sqrt(np.mean(bent**2, axis=0))
    # the inertial noise bends the path everywhere alike; seconds since 1980 resolve 0.1 us, 2 um
    assert np.all(size["fix"][:3] < 1.5 * size["between"][:3] + 3e-6)  # m
    assert np.all(size["fix"][3:] < 1.5 * size["between"][3:])  # rad
    assert np.all(size["fix"][:3] < 1e-4)  # m; the filter's own steps are millimetres and more


def test_filter_alone_jumps_at_fixes() -> None:
    """What the one above would see if the smoother did nothing."""
    flight = drawn(2, 2)
    trajectory = smoothed(flight)
    at_fix = np.flatnonzero(trajectory.chi[:, 0] >= 0.0)[300:400]
    p = trajectory.post_nav[:, 2]
    smooth = trajectory.nav[:, 2]
    jumps = np.abs(np.diff(p - smooth))[at_fix]
    assert np.median(jumps) > 3e-3  # m a fix, down
