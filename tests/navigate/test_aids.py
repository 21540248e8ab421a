"""Aids of the filter: which reading counts at a node, and a barometer of whatever zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from navigation_flights import drawn, errors_at, logs_of, settings_of

from georef_gis.frames import Array
from georef_gis.model.logs import AidLog
from georef_gis.navigate.filter_pass import _aid_table
from georef_gis.navigate.gnss_noise import Fixes, prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.simulate.ellipsoid import geodetic_from_ecef

SURVEY = drawn(1, 4, gnss="white")


@pytest.fixture(scope="module")
def fixes() -> Fixes:
    return prepare_fixes(logs_of(SURVEY)[1])


def aid(kind: str, time: Array, value: Array, sigma: float = 1.0) -> AidLog:
    return AidLog(kind=kind, time=time, value=value, sigma=np.full(len(time), sigma))


@pytest.mark.parametrize("shift", [-0.11, -0.02, 0.0, 0.02, 0.11])
def test_reading_nearest_in_time_counts_at_a_node(fixes: Fixes, shift: float) -> None:
    nodes = fixes.time[:100]
    time = nodes[0] + shift + np.arange(0.0, 20.0, 0.25)
    # the value tells which reading was taken
    table = _aid_table(nodes, [aid("heading", time, time - nodes[0])], fixes)
    used = np.flatnonzero(np.isfinite(table[:, 0, 0]))
    assert len(used) > 30
    for m in used:
        apart = np.abs(time - nodes[m])
        assert table[m, 0, 0] + nodes[0] == pytest.approx(time[np.argmin(apart)], abs=1e-6)
    # at most two a second, and none older or younger than 0.15 s
    assert np.diff(nodes[used]).min() > 0.499
    assert np.abs(table[used, 0, 0] + nodes[0] - nodes[used]).max() <= 0.125 + 1e-6


def test_single_reading_is_found_from_both_sides(fixes: Fixes) -> None:
    nodes = fixes.time[:20]
    for off in (-0.1, 0.1):
        table = _aid_table(nodes, [aid("heading", nodes[7:8] + off, np.array([0.5]))], fixes)
        used = np.flatnonzero(np.isfinite(table[:, 0, 0]))
        assert len(used) == 1
        assert abs(nodes[used[0]] - nodes[7] - off) <= 0.1 + 1e-6


# s on the GPS scale, first and last of an outage of the fixes
OUTAGE = SURVEY.start_gps + np.array([90.0, 130.0])


def with_barometer(zero: float | None) -> InertialTrajectory:
    """Trajectory through an outage by a barometer that shows the true height less `zero` m."""
    log, gnss = logs_of(SURVEY)
    found = prepare_fixes(gnss)
    outside = (found.time < OUTAGE[0]) | (found.time > OUTAGE[1])
    columns = {name: getattr(found, name)[outside] for name in ("time", "p_geo", "R_p", "v", "R_v")}
    time = log.time[::10]
    height = geodetic_from_ecef(SURVEY.path.states(time - SURVEY.start_gps).p_ecef)[2]
    noise = 0.1 * np.random.default_rng(2).normal(size=len(time))
    aids = [] if zero is None else [aid("baro_height", time, height - zero + noise, 0.1)]
    # an airframe that shakes: thirty times the noise, so that the outage shows
    settings = replace(settings_of(SURVEY, accel_walk=0.05), baro_sigma=2.0)
    return smooth_flight(log, replace(found, **columns), settings, aids)


def test_barometer_of_any_zero_carries_the_height_through_an_outage() -> None:
    """812 m are four hundred sigmas of its offset: an outlier unless its zero is found."""
    times = np.arange(OUTAGE[0] + 10.0, OUTAGE[1] - 10.0, 2.0)
    without, true, other = (with_barometer(zero) for zero in (None, 0.0, 812.0))
    moved = other.at(times).p_geo[:, 2] - true.at(times).p_geo[:, 2]
    assert np.abs(moved).max() < 0.01  # m
    alone, true_sigma, sigma = (
        np.sqrt(one.at(times).covariance[:, 2, 2]) for one in (without, true, other)
    )
    np.testing.assert_allclose(sigma, true_sigma, rtol=0.01)
    # the slow error of the fixes, which no barometer takes away, is small beside the drift
    assert sigma.max() < 0.5 * alone.max()
    error = errors_at(SURVEY, other, times)[:, 2]
    assert np.abs(error / sigma).max() < 4.0
