"""The mechanisation against the analytic flight, and its transition against differences."""

import numpy as np
import pytest
from navigation_flights import drawn, logs_of, truth_at

from georef_gis.frames import Array, exp_so3
from georef_gis.navigate.dense import cholesky, pack, solve_rows, unpack
from georef_gis.navigate.filter_pass import imu_table
from georef_gis.navigate.inertial import advance, gravity, nav_of, propagate, reset_transition
from georef_gis.navigate.kalman import difference, inject

RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def exact() -> tuple[Array, Array, Array]:
    """Error-free samples of a survey with the true states at the first and a later one."""
    flight = drawn(3, rows=2)
    log, _ = logs_of(flight, errors=False)
    p, v, R = truth_at(flight, log.time)
    states = np.stack([nav_of(p[i], v[i], R[i]) for i in (0, 6000)])
    return imu_table(log), states, log.time[[0, 6000]]


def test_error_free_samples_lead_to_the_true_state(exact: tuple[Array, Array, Array]) -> None:
    imu, states, time = exact
    nav = states[0].copy()
    propagate(imu, 0, time[0], time[1], nav, np.zeros(6), np.zeros((9, 0)))
    d = np.empty(15)
    difference(nav, np.zeros(6), states[1], np.zeros(6), d)
    assert np.abs(d[:3]).max() < 0.3  # m after 60 s: samples of 100 Hz taken as straight lines
    assert np.abs(d[3:6]).max() < 0.02  # m/s
    assert np.abs(d[6:9]).max() < 3e-5  # rad


def test_going_back_returns_to_the_start(exact: tuple[Array, Array, Array]) -> None:
    imu, states, time = exact
    nav = states[0].copy()
    propagate(imu, 0, time[0], time[0] + 3.137, nav, np.zeros(6), np.zeros((9, 0)))
    propagate(imu, 300, time[0] + 3.137, time[0], nav, np.zeros(6), np.zeros((9, 0)))
    d = np.empty(15)
    difference(nav, np.zeros(6), states[0], np.zeros(6), d)
    assert np.abs(d[:9]).max() < 2e-3  # m, m/s, rad: Euler steps of velocity are not symmetric


def test_two_halves_make_the_whole(exact: tuple[Array, Array, Array]) -> None:
    imu, states, time = exact
    once, twice = states[0].copy(), states[0].copy()
    none, aux = np.zeros((9, 0)), np.zeros(6)
    propagate(imu, 0, time[0], time[0] + 2.0, once, aux, none)
    at = propagate(imu, 0, time[0], time[0] + 1.0, twice, aux, none)
    propagate(imu, at, time[0] + 1.0, time[0] + 2.0, twice, aux, none)
    np.testing.assert_allclose(once, twice, atol=1e-12)


@pytest.mark.parametrize("scaled", [False, True], ids=["15 states", "24 states"])
def test_transition_agrees_with_differences(
    exact: tuple[Array, Array, Array], *, scaled: bool
) -> None:
    imu, states, time = exact
    size = 15 if scaled else 6
    aux = 1e-3 * RNG.normal(size=size)
    A = np.zeros((9, 3 + size))
    reset_transition(A)
    end = time[0] + 0.2
    base = states[0].copy()
    propagate(imu, 0, time[0], end, base, aux, A)
    small = 1e-4  # below, the steps of lat and lon in double precision show
    for column in range(3 + size):
        d = np.zeros(9 + size)
        d[6 + column] = small
        nav, x = states[0].copy(), aux.copy()
        inject(nav, x, d)
        propagate(imu, 0, time[0], end, nav, x, np.zeros((9, 0)))
        moved = np.empty(9 + size)
        difference(nav, x, base, aux, moved)
        # one in a thousand of the largest: first-order terms of 10 ms steps
        np.testing.assert_allclose(moved[:9] / small, A[:, column], atol=2e-3)


def test_gravity_at_equator_pole_and_height() -> None:
    assert gravity(0.0, 0.0) == pytest.approx(9.7803253, abs=1e-6)
    assert gravity(np.pi / 2, 0.0) == pytest.approx(9.8321849, abs=1e-6)
    # free air: 3.086e-6 m/s2 per m
    assert gravity(0.7, 1000.0) - gravity(0.7, 0.0) == pytest.approx(-3.084e-3, abs=5e-6)


def test_vehicle_at_rest_stays_where_it_is() -> None:
    lat, h = 0.68, 300.0
    earth = 7.292115e-5
    w = np.array([earth * np.cos(lat), 0.0, -earth * np.sin(lat)])
    f = np.array([0.0, 0.0, -gravity(lat, h)])
    nav = nav_of(np.array([lat, -1.4, h]), np.zeros(3), np.eye(3))
    for _ in range(6000):
        advance(nav, np.zeros(6), w, f, 0.01, np.zeros((9, 0)))
    np.testing.assert_allclose(nav[3:6], 0.0, atol=1e-9)
    np.testing.assert_allclose(nav[6:], np.eye(3).ravel(), atol=1e-9)


def test_inject_and_difference_are_inverse() -> None:
    nav = nav_of(np.array([0.68, -1.4, 300.0]), RNG.normal(size=3), exp_so3(RNG.normal(size=3)))
    x = RNG.normal(size=6)
    d = np.concatenate([10.0 * RNG.normal(size=6), 0.3 * RNG.normal(size=3), RNG.normal(size=6)])
    moved, moved_x = nav.copy(), x.copy()
    inject(moved, moved_x, d)
    back = np.empty(15)
    difference(moved, moved_x, nav, x, back)
    np.testing.assert_allclose(back, d, atol=1e-5)  # m: radii are those of the first place


def test_packed_matrix_comes_back() -> None:
    a = RNG.normal(size=(5, 5))
    packed = np.empty(15)
    pack(a + a.T, packed)
    np.testing.assert_array_equal(unpack(packed, 5), a + a.T)


def test_cholesky_solves_as_numpy_and_leaves_out_what_has_no_variance() -> None:
    a = RNG.normal(size=(4, 4))
    S = a @ a.T + np.eye(4)
    rows = RNG.normal(size=(2, 4))
    expected = np.linalg.solve(S, rows.T).T
    solve_rows(cholesky(S), rows)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    S[2, :] = S[:, 2] = 0.0
    assert np.isfinite(cholesky(S)).all()
