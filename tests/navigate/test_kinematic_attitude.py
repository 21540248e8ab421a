"""Logged attitudes with planted errors: between samples, in gaps, with and without GNSS."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from navigation_flights import drawn, errors_at, logs_of, truth_at

from georef_gis.errors import NavigationError
from georef_gis.frames import (
    Array,
    R_ned_from_body,
    exp_so3,
    log_so3,
    rpy_from_R_ned_from_body,
)
from georef_gis.model.logs import AttitudeLog
from georef_gis.navigate.attitude_track import AttitudeSettings, attitude_track
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.kinematic import KinematicSettings, KinematicTrajectory
from georef_gis.navigate.kinematic_solution import smooth_fixes
from georef_gis.simulate import SimulatedFlight

SIGMA = np.radians([1.5, 1.5, 5.0])


def markov(rng: np.random.Generator, time: Array, tau: float) -> Array:
    """Three stationary unit processes at increasing times."""
    out = rng.normal(size=(len(time), 3))
    for i, rho in enumerate(np.exp(-np.diff(time) / tau), start=1):
        out[i] = rho * out[i - 1] + np.sqrt(1.0 - rho**2) * out[i]
    return out


def logged(flight: SimulatedFlight, seed: int, *, rate: float = 10.0, errors: float = 1.0
) -> AttitudeLog:  # fmt: skip
    """Autopilot's attitude with errors of its angles that stay for 15 s, no sigmas stated."""
    time = flight.start_gps + np.arange(1.0, flight.path.duration - 1.0, 1.0 / rate)
    rpy = rpy_from_R_ned_from_body(truth_at(flight, time)[2])
    rpy = rpy + errors * SIGMA * markov(np.random.default_rng(seed), time, 15.0)
    rpy[:, 2] = np.mod(rpy[:, 2], 2.0 * np.pi)
    return AttitudeLog(time=time, rpy=rpy, sigma_rpy=np.full(rpy.shape, np.nan), source="att.csv")


def rms(values: list[Array]) -> Array:
    return np.asarray(np.sqrt(np.mean(np.concatenate(values) ** 2, axis=0)))


def fair(value: Array) -> bool:
    return bool(np.all((value > 0.7) & (value < 1.4)))


@pytest.mark.slow
def test_pose_and_differences_are_as_good_as_they_say_with_a_lever_arm() -> None:
    arm = (-1.25, 0.3, -0.5)
    settings = KinematicSettings(lever_arm_body_antenna=np.array(arm))
    D = np.hstack([-np.eye(6), np.eye(6)])
    singles, over = [], {1.0: [], 5.0: [], 15.0: []}
    for seed in range(20):
        flight = drawn(seed, rows=2, lever_arm_antenna=arm, gnss="coloured")
        found = smooth_fixes(prepare_fixes(logs_of(flight)[1]), logged(flight, seed), settings)
        t = np.arange(found.span[0] + 3.0, found.span[1] - 18.0, 13.0)
        sigma = np.sqrt(np.einsum("nii->ni", found.at(t).covariance))
        singles.append(errors_at(flight, found, t) / sigma)
        for lag, parts in over.items():
            d = errors_at(flight, found, t + lag) - errors_at(flight, found, t)
            joint = [found.joint_covariance([s, s + lag]) for s in t]
            parts.append(d / np.sqrt([(D @ J @ D.T).diagonal() for J in joint]))
    assert fair(rms(singles)), rms(singles)
    for lag, parts in over.items():
        assert fair(rms(parts)), (lag, rms(parts))


def test_lever_arm_and_its_swing_are_taken_off_exactly() -> None:
    arm = (-3.0, 2.0, -1.0)
    flight = drawn(1, rows=2, lever_arm_antenna=arm, lever_arm_sigma=0.0, gnss="white",
                   gnss_cep=0.001, gnss_velocity=0.001)  # fmt: skip
    fixes = prepare_fixes(logs_of(flight)[1], slow_sigma=0.0)
    settings = KinematicSettings(lever_arm_body_antenna=np.array(arm))
    found = smooth_fixes(fixes, logged(flight, 0, rate=50.0, errors=0.0), settings)
    t = fixes.time[10:-10:7]
    assert np.sqrt(np.mean(errors_at(flight, found, t)[:, :3] ** 2)) < 0.02  # m
    _, v, _ = truth_at(flight, t)
    assert np.sqrt(np.mean((found.at(t).v_ned - v) ** 2)) < 0.05  # m/s, of a swing of 1 m/s
    states, joint = found.at(t[:1]), found.joint_covariance(t[:1])
    np.testing.assert_allclose(joint, states.covariance[0], rtol=1e-9, atol=1e-12)
    # where the antenna is known the vehicle swings about it: dp = -dtheta x arm
    P, lever = states.covariance[0], states.R_ned_from_body[0] @ np.array(arm)
    J = np.stack([-np.cross(axis, lever) for axis in np.eye(3)], axis=-1)
    np.testing.assert_allclose(P[:3, 3:], J @ P[3:, 3:], rtol=1e-6, atol=1e-9)
    # a yaw error of 5 deg turns 3.6 m of arm: the place is known no better
    assert 0.1 < np.sqrt(states.covariance[0, :2, :2].trace()) < 0.6


def steady(rate: float, gap: tuple[float, float] | None = None) -> AttitudeLog:
    """A steady turn about the vertical through south, where yaw wraps, at 20 deg/s."""
    t = np.arange(0.0, 30.0, 1.0 / rate)
    if gap is not None:
        t = t[(t <= gap[0]) | (t >= gap[1])]
    yaw = np.mod(np.radians(100.0 + 20.0 * t) + np.pi, 2.0 * np.pi) - np.pi
    rpy = np.stack([np.full(len(t), 0.4), np.full(len(t), 0.1), yaw], axis=-1)
    return AttitudeLog(time=1e9 + t, rpy=rpy, sigma_rpy=np.tile(SIGMA, (len(t), 1)), source="a")


def test_wrapped_yaw_is_interpolated_the_short_way_with_the_true_rate() -> None:
    track = attitude_track(steady(5.0))
    t = np.array([3.3, 4.05, 4.15, 13.07, 22.5])
    states = track.at(1e9 + t)
    truth = R_ned_from_body(np.full(5, 0.4), np.full(5, 0.1), np.radians(100.0 + 20.0 * t))
    assert np.abs(log_so3(states.R_ned_from_body @ np.swapaxes(truth, -1, -2))).max() < 1e-7
    rate = np.einsum("nij,nj->ni", states.R_ned_from_body, states.rate_body)
    np.testing.assert_allclose(rate, np.tile([0, 0, np.radians(20.0)], (5, 1)), atol=1e-6)


def test_attitude_alone_has_covariances_that_fade_with_time() -> None:
    track = attitude_track(steady(5.0))
    P = track.at([1e9 + 5.0]).covariance[0]
    J = track.joint_covariance([1e9 + 5.0, 1e9 + 5.0, 1e9 + 23.0])
    np.testing.assert_allclose(J[:3, :3], P, rtol=1e-9)
    # a full turn later the axes are the same: what is left is exp(-18 / 15)
    np.testing.assert_allclose(J[:3, 6:], np.exp(-18.0 / 15.0) * P, rtol=1e-3, atol=1e-8)
    assert np.linalg.eigvalsh(J).min() > -1e-12


def test_sigmas_of_the_log_are_believed_and_missing_ones_taken_from_the_settings() -> None:
    log = steady(10.0)
    stated = replace(log, sigma_rpy=np.full(log.rpy.shape, np.radians(0.3)))
    none = replace(log, sigma_rpy=np.full(log.rpy.shape, np.nan))
    usual = AttitudeSettings(sigma_roll_pitch=np.radians(2.0), sigma_yaw=np.radians(7.0))
    t = [1e9 + 5.0]
    level = np.radians(0.3) ** 2 * 3
    # trace in angles that are not quite at right angles at 6 deg of pitch
    assert np.trace(attitude_track(stated, usual).at(t).covariance[0]) == pytest.approx(
        level, rel=0.02
    )
    expected = np.radians(2.0) ** 2 * 2 + np.radians(7.0) ** 2
    assert np.trace(attitude_track(none, usual).at(t).covariance[0]) == pytest.approx(
        expected, rel=0.02
    )
    assert "sigmas of the settings" in attitude_track(none).notes[0]
    assert "delay" in attitude_track(none).notes[0]


def test_error_between_sparse_samples_is_covered() -> None:
    """Turbulence that 1 Hz does not show, against what the log itself tells of it."""
    z = []
    for seed in range(8):
        flight = drawn(seed, rows=2, roll_sigma_deg=6.0)
        log = logged(flight, seed, rate=1.0, errors=0.0)
        tiny = AttitudeSettings(sigma_roll_pitch=1e-6, sigma_yaw=1e-6, gap=1.01)
        track = attitude_track(log, tiny)
        t = log.time[:-1] + 0.5
        states = track.at(t)
        truth = truth_at(flight, t)[2]
        error = log_so3(truth @ np.swapaxes(states.R_ned_from_body, -1, -2))
        in_body = np.einsum("nji,nj->ni", states.R_ned_from_body, error)
        R = states.R_ned_from_body
        P = np.swapaxes(R, -1, -2) @ states.covariance @ R
        z.append(in_body / np.sqrt(np.einsum("nii->ni", P)))
    value = rms(z)
    # a random walk is rougher than air: cautious by up to two
    assert np.all((value > 0.5) & (value < 1.4)), value


def test_gaps_of_the_attitude_are_refused_and_named() -> None:
    track = attitude_track(steady(10.0, gap=(10.0, 13.0)))
    assert "gap of 3.0 s of the attitude log" in track.why_not(1e9 + 11.0)
    assert track.why_not(1e9 + 9.95) == track.why_not(1e9 + 13.05) == ""
    assert "before the attitude log" in track.why_not(1e9 - 1.0)
    assert "after the attitude log" in track.why_not(1e9 + 31.0)
    assert "not known" in track.why_not(float("nan"))
    assert any("1 gaps of up to 3.0 s" in doubt for doubt in track.doubts)
    with pytest.raises(NavigationError, match=r"gap of 3\.0 s"):
        track.at([1e9 + 5.0, 1e9 + 11.0])


def test_span_is_that_of_both_logs_and_no_overlap_is_an_error() -> None:
    flight = drawn(2, rows=2)
    fixes, log = prepare_fixes(logs_of(flight)[1]), logged(flight, 2)
    found = smooth_fixes(fixes, log)
    assert found.span == (log.time[0], log.time[-1])
    assert "before the attitude log" in found.why_not(float(log.time[0]) - 0.5)
    assert not any("no attitude" in doubt for doubt in found.doubts)
    with pytest.raises(NavigationError, match=r"lies \d+ s off the GNSS log"):
        smooth_fixes(fixes, replace(log, time=log.time + 5000.0))


def test_order_repeats_and_missing_numbers_of_the_log_do_no_harm() -> None:
    log = steady(10.0)
    n = len(log)
    order = np.random.default_rng(0).permutation(np.concatenate([np.arange(n), np.arange(20)]))
    rpy = log.rpy[order].copy()
    mixed = AttitudeLog(time=log.time[order], rpy=rpy, sigma_rpy=log.sigma_rpy[order], source="a")
    np.testing.assert_array_equal(attitude_track(mixed).rpy, attitude_track(log).rpy)
    holed = log.rpy.copy()
    holed[50, 1] = np.nan
    assert len(attitude_track(replace(log, rpy=holed)).time) == n - 1
    with pytest.raises(NavigationError, match="1 usable attitudes"):
        attitude_track(AttitudeLog(time=log.time[:1], rpy=log.rpy[:1],
                                   sigma_rpy=log.sigma_rpy[:1], source="a"))  # fmt: skip


def test_straight_up_is_an_attitude_as_any() -> None:
    t = 1e9 + np.arange(5.0) * 0.1
    rpy = np.tile([0.2, np.pi / 2, 0.5], (5, 1))
    track = attitude_track(AttitudeLog(time=t, rpy=rpy, sigma_rpy=np.tile(SIGMA, (5, 1))))
    states = track.at(t + 0.0)
    assert np.isfinite(states.covariance).all()
    truth = exp_so3(np.zeros(3)) @ R_ned_from_body(0.2, np.pi / 2, 0.5)
    np.testing.assert_allclose(states.R_ned_from_body[2], truth, atol=1e-12)


def test_a_saved_trajectory_keeps_its_attitude(tmp_path: Path) -> None:
    flight = drawn(2, rows=2)
    settings = KinematicSettings(
        attitude=AttitudeSettings(tau=7.0), lever_arm_body_antenna=np.array([1.0, 2.0, 3.0])
    )
    found = smooth_fixes(prepare_fixes(logs_of(flight)[1]), logged(flight, 2), settings)
    found.save(tmp_path / "t.npz")
    again = KinematicTrajectory.load(tmp_path / "t.npz")
    t = np.linspace(*found.span, 7)
    np.testing.assert_array_equal(again.joint_covariance(t), found.joint_covariance(t))
    np.testing.assert_array_equal(again.at(t).R_ned_from_body, found.at(t).R_ned_from_body)
    assert again.settings.attitude == settings.attitude
