"""Covariances and correlations of the smoother: algebra, a dense oracle, and Monte Carlo."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from navigation_flights import drawn, errors_at, logs_of, settings_of, smoothed

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.navigate.dense import unpack
from georef_gis.navigate.gnss_noise import Fixes, prepare_fixes
from georef_gis.navigate.inertial import propagate
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.kalman import difference
from georef_gis.navigate.settings import ImuNoise, NavigationSettings
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.simulate import SimulatedFlight

PERFECT_AXES = {"scale": 0.0, "misalignment": 0.0}
SHEET = {"gyro_bias": math.radians(100.0) / 3600.0, "accel_bias": 0.03, **PERFECT_AXES}


@cache
def one(kind: str) -> tuple[SimulatedFlight, InertialTrajectory]:
    flight = drawn(5, 2)
    return flight, smoothed(flight, **(SHEET if kind == "15 states" else {}))


@pytest.fixture(params=["15 states", "24 states"])
def trajectory(request: pytest.FixtureRequest) -> InertialTrajectory:
    return one(request.param)[1]


def some_times(trajectory: InertialTrajectory) -> Array:
    """Neighbours within one step, at nodes, far apart, and both ends."""
    first, last = trajectory.span
    offsets = [0.0, 0.013, 0.05, 0.19, 0.2, 0.21, 1.0, 3.77, 3.78, 20.0, 60.001]
    return np.array([*(first + np.array(offsets)), trajectory.nodes[77], last])


def test_joint_covariance_is_symmetric_and_positive_definite(
    trajectory: InertialTrajectory,
) -> None:
    times = some_times(trajectory)
    times = np.sort(times)
    C = trajectory.joint_covariance(times)
    assert C.shape == (6 * len(times),) * 2
    np.testing.assert_array_equal(C, C.T)
    # scaled to correlations, for metres and radians differ; 13 ms apart little is independent
    s = np.sqrt(C.diagonal())
    assert np.linalg.eigvalsh(C / np.outer(s, s))[0] > -1e-9


def test_well_separated_times_are_strictly_positive_definite(
    trajectory: InertialTrajectory,
) -> None:
    times = np.arange(trajectory.span[0] + 1.0, trajectory.span[1], 2.0)
    C = trajectory.joint_covariance(times)
    s = np.sqrt(C.diagonal())
    assert np.linalg.eigvalsh(C / np.outer(s, s))[0] > 0.0
    np.linalg.cholesky(C)


def test_blocks_on_the_diagonal_are_those_of_at(trajectory: InertialTrajectory) -> None:
    times = np.sort(some_times(trajectory))
    k = len(times)
    blocks = trajectory.joint_covariance(times).reshape(k, 6, k, 6)[range(k), :, range(k)]
    np.testing.assert_allclose(blocks, trajectory.at(times).covariance, rtol=1e-9, atol=1e-15)


def test_times_put_in_between_change_nothing(trajectory: InertialTrajectory) -> None:
    times = np.sort(some_times(trajectory))
    few = [0, 3, 7, 9, 12]
    k = len(few)
    wanted = trajectory.joint_covariance(times).reshape(13, 6, 13, 6)[few][:, :, few]
    alone = trajectory.joint_covariance(times[few]).reshape(k, 6, k, 6)
    s = np.sqrt(np.einsum("iaia->ia", wanted))
    error = (wanted - alone) / (s[:, :, None, None] * s[None, None])
    assert np.abs(error).max() < 1e-6  # as a correlation: transitions of 10 ms steps are cut


def test_order_of_times_does_not_matter_for_states(trajectory: InertialTrajectory) -> None:
    times = some_times(trajectory)
    mixed = np.random.default_rng(3).permutation(len(times))
    one_way, other = trajectory.at(times), trajectory.at(times[mixed])
    np.testing.assert_array_equal(one_way.p_geo[mixed], other.p_geo)
    np.testing.assert_allclose(one_way.covariance[mixed], other.covariance, rtol=1e-9, atol=1e-16)


def test_chain_tells_any_pair_and_any_choice(trajectory: InertialTrajectory) -> None:
    chain = trajectory.chain(np.sort(some_times(trajectory)))
    whole = chain.joint().reshape(13, 6, 13, 6)
    np.testing.assert_allclose(chain.cross(2, 9), whole[2, :, 9], rtol=1e-12)
    np.testing.assert_allclose(chain.cross(9, 2), whole[9, :, 2], rtol=1e-12)
    chosen = [8, 0, 5]
    np.testing.assert_allclose(
        chain.joint(chosen).reshape(3, 6, 3, 6), whole[chosen][:, :, chosen], rtol=1e-9, atol=1e-18
    )


def test_times_of_a_chain_must_not_decrease(trajectory: InertialTrajectory) -> None:
    with pytest.raises(ValueError, match="must not decrease"):
        trajectory.chain(trajectory.span[0] + np.array([2.0, 1.0]))


def test_equal_times_are_fully_correlated(trajectory: InertialTrajectory) -> None:
    time = trajectory.span[0] + 12.345
    C = trajectory.joint_covariance([time, time]).reshape(2, 6, 2, 6)
    np.testing.assert_allclose(C[0, :, 1], C[0, :, 0], rtol=1e-9, atol=1e-15)


def test_finer_nodes_agree_with_coarse_ones() -> None:
    """Interpolation and covariance between nodes against nodes that lie there."""
    flight = drawn(5, 2, gnss_rate=1.0)
    log, gnss = logs_of(flight)
    fixes = prepare_fixes(gnss)
    coarse, fine = (
        smooth_flight(log, fixes, replace(settings_of(flight), node_gap=gap)) for gap in (0.2, 0.05)
    )
    times = np.arange(coarse.span[0] + 1.0, coarse.span[1] - 1.0, 1.93) + 0.1
    a, b = coarse.at(times), fine.at(times)
    sigma = np.sqrt(np.einsum("nii->ni", b.covariance))
    other = np.sqrt(np.einsum("nii->ni", a.covariance))
    np.testing.assert_allclose(other, sigma, rtol=0.01)
    moved = (a.p_geo - b.p_geo) * np.array([6.36e6, 5e6, 1.0])
    assert np.abs(moved / sigma[:, :3]).max() < 0.05  # of one sigma


def dense_posterior(
    trajectory: InertialTrajectory, fixes: Fixes, used: Array, start: int, slow: int
) -> tuple[Array, Array]:
    """Joint covariance of all errors at the nodes from one on, by conditioning in one go.

    Written anew in plain matrices: a stack of the nodes, its prior by the transitions, and one
    normal equation over all fixes behind node `start`. `used` is the fix at each node.

    Returns
    -------
    C : shape (m n, m n)
    mean : shape (m, n)
        Of the error of the path from the filter's state at `start` that no later fix has touched.
    """
    nodes, model = trajectory.nodes[start:], trajectory.model
    m, n = len(nodes), model.shape[1]
    J = np.zeros((m, n, m, n))
    J[0, :, 0] = unpack(trajectory.filtered[start], n)
    nav, x = trajectory.post_nav[start].copy(), trajectory.post_x[start].copy()
    aux_size = trajectory.transitions.shape[2] - 3
    rows, values, noise = [], [], []
    for i in range(1, m):
        dt = nodes[i] - nodes[i - 1]
        Phi, Q = _step(trajectory, start + i - 1, dt)
        J[i, :, :i] = np.einsum("ab,bjc->ajc", Phi, J[i - 1, :, :i])
        J[:i, :, i] = np.moveaxis(J[i, :, :i], 0, -1)
        J[i, :, i] = Phi @ J[i - 1, :, i - 1] @ Phi.T + Q
        propagate(trajectory.imu, 0, nodes[i - 1], nodes[i], nav, x[:aux_size], np.zeros((9, 0)))
        x = x * np.diag(Phi)[9:]
        if (j := int(used[start + i])) < 0:
            continue
        at_fix = nav.copy()
        at_fix[:3], at_fix[3:6] = fixes.p_geo[j], fixes.v[j]
        d = np.empty(n)
        difference(at_fix, x, nav, x, d)
        H = np.zeros((6, m, n))
        H[range(6), i, range(6)] = 1.0
        if slow:
            H[range(3), i, range(slow, slow + 3)] = 1.0
            d[:3] -= x[slow - 9 : slow - 6]
        rows.append(H.reshape(6, m * n))
        values.append(d[:6])
        noise += [fixes.R_p[j], fixes.R_v[j]]
    return _conditioned(J.reshape(m * n, m * n), np.concatenate(rows), np.concatenate(values),
                        noise, (m, n))  # fmt: skip


def _step(trajectory: InertialTrajectory, i: int, dt: float) -> tuple[Array, Array]:
    """Transition from a node to the next and its noise, (n, n) each."""
    model, A = trajectory.model, trajectory.transitions[i]
    Phi = np.eye(model.shape[1])
    Phi[0:3, 3:6] = dt * np.eye(3)
    Phi[:9, 6 : 6 + A.shape[1]] = A
    walk = np.diag(np.where(model[1] > 0.0, 0.0, model[0]) * dt)
    # half of it before the step and half behind, as the filter states it
    Q = 0.5 * (Phi @ walk @ Phi.T + walk)
    for k in np.flatnonzero(model[1] > 0.0):
        Phi[k, k] = math.exp(-dt / model[1, k])
        Q[k, k] = model[0, k] * (1.0 - Phi[k, k] ** 2)
    return Phi, Q


def _conditioned(
    J: Array, H: Array, d: Array, noise: list[Array], shape: tuple[int, int]
) -> tuple[Array, Array]:
    S = H @ J @ H.T
    for i, R in enumerate(noise):
        S[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += R
    K = np.linalg.solve(S, H @ J).T
    return J - K @ H @ J, (K @ d).reshape(shape)


@pytest.mark.parametrize("kind", ["white", "coloured"])
@pytest.mark.parametrize("axes", ["15 states", "24 states"])
def test_smoother_agrees_with_one_dense_solution(kind: str, axes: str) -> None:
    flight = drawn(8, 2, gnss=kind)
    log, gnss = logs_of(flight)
    keep = log.time <= log.time[0] + 60.0
    log = replace(log, time=log.time[keep], gyro=log.gyro[keep], accel=log.accel[keep])
    fixes = prepare_fixes(gnss, slow_sigma=0.0 if kind == "white" else 2.0)
    # without a lever arm the fixes see the states themselves: nothing to linearise
    noise = ImuNoise(**PERFECT_AXES) if axes == "15 states" else ImuNoise()
    found = smooth_flight(log, fixes, NavigationSettings(imu=noise, gate=1e-12))
    slow = 0 if kind == "white" else found.model.shape[1] - 3
    near = np.minimum(np.searchsorted(fixes.time, found.nodes - 1e-7), len(fixes) - 1)
    used = np.where(np.abs(fixes.time[near] - found.nodes) < 1e-6, near, -1)
    # the filter has settled by then, so that both linearise at the same places
    start = len(found.nodes) - 41
    C, mean = dense_posterior(found, fixes, used, start, slow)
    m, n = 41, found.model.shape[1]
    pose = [0, 1, 2, 6, 7, 8]
    C = C.reshape(m, n, m, n)[:, pose][:, :, :, pose]
    ours = found.joint_covariance(found.nodes[start:]).reshape(m, 6, m, 6)
    s = np.sqrt(np.einsum("iaia->ia", C))
    error = (C - ours) / (s[:, :, None, None] * s[None, None])
    assert np.abs(error).max() < 1e-6  # as a correlation
    for i in (0, 20, 40):
        nav, x = found.post_nav[start].copy(), found.post_x[start].copy()
        kept = x[: found.transitions.shape[2] - 3]
        propagate(found.imu, 0, found.nodes[start], found.nodes[start + i], nav, kept,
                  np.zeros((9, 0)))  # fmt: skip
        d = np.empty(n)
        difference(found.nav[start + i], found.x[start + i], nav, x, d)
        assert np.abs((d - mean[i])[pose] / s[i]).max() < 0.05  # of one sigma


@cache
def _drawn_differences(kind: str) -> dict[float, Array]:
    """Squares of error/sigma of differences over many short flights, by lag; (k, 6)."""
    lags = (0.3, 1.0, 5.0, 15.0)
    out: dict[float, list[Array]] = {lag: [] for lag in lags}
    for seed in range(100, 142):
        flight = drawn(seed, 2, gnss="white" if seed % 2 else "coloured", **(
            {"gyro_scale_percent": 0.5, "gyro_misalignment_deg": 0.3} if kind == "real axes" else {}
        ))  # fmt: skip
        trajectory = smoothed(flight, **({} if kind == "real axes" else SHEET))
        first, last = trajectory.span
        starts = np.array([first + 1.03, 0.5 * (first + last) - 7.0, last - 16.41])
        times = np.sort(np.concatenate([starts, *[starts + lag for lag in lags]]))
        chain = trajectory.chain(times)
        joint = chain.joint().reshape(len(times), 6, len(times), 6)
        error = errors_at(flight, trajectory, times)
        for lag in lags:
            for start in starts:
                i = int(np.argmin(np.abs(times - start)))
                j = int(np.argmin(np.abs(times - start - lag)))
                C = joint[i, :, i] + joint[j, :, j] - joint[i, :, j] - joint[j, :, i]
                out[lag].append((error[j] - error[i]) ** 2 / C.diagonal())
    return {lag: np.array(rows) for lag, rows in out.items()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ideal axes", "real axes"])
@pytest.mark.parametrize("lag", [0.3, 1.0, 5.0, 15.0])
def test_differences_between_exposures_scatter_as_their_sigma_says(kind: str, lag: float) -> None:
    squares = _drawn_differences(kind)[lag]
    assert len(squares) >= 120
    position, attitude = np.sqrt(squares[:, :3].mean()), np.sqrt(squares[:, 3:].mean())
    assert 0.7 < position < 1.4
    assert 0.7 < attitude < 1.4


def test_saved_trajectory_comes_back_whole(trajectory: InertialTrajectory, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.npz"
    trajectory.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["trajectory.npz"]
    back = InertialTrajectory.load(path)
    assert (back.notes, back.doubts, back.span) == (
        trajectory.notes, trajectory.doubts, trajectory.span,
    )  # fmt: skip
    times = np.sort(some_times(trajectory))
    one_way, other = trajectory.at(times), back.at(times)
    for name in ("p_geo", "v_ned", "R_ned_from_body", "rate_body", "covariance"):
        np.testing.assert_array_equal(getattr(one_way, name), getattr(other, name))
    np.testing.assert_array_equal(trajectory.joint_covariance(times), back.joint_covariance(times))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 cut off", b"garbage" * 99])
def test_file_that_is_no_trajectory_is_named(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"trajectory\.npz"):
        InertialTrajectory.load(path)


def test_truncated_trajectory_is_named(trajectory: InertialTrajectory, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.npz"
    trajectory.save(path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(InputError, match=r"trajectory\.npz"):
        InertialTrajectory.load(path)


def test_npz_of_something_else_is_named(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.npz"
    np.savez(path, a=np.zeros(3))
    with pytest.raises(InputError, match=r"trajectory\.npz"):
        InertialTrajectory.load(path)


def test_missing_trajectory_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.npz"):
        InertialTrajectory.load(tmp_path / "none.npz")
