"""The smoother of fixes against dense least squares and matrix exponentials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from georef_gis.frames import Array
from georef_gis.navigate.dense import unpack
from georef_gis.navigate.kinematic_smoother import (
    PACKED,
    STATES,
    axis_noise,
    backward,
    forward,
    insert,
    response,
    step,
)

MODEL = np.array([[1.5, 4.0], [1.5, 4.0], [0.4, 1.0]])
SLOW = np.array([2.0, 2.0, 3.0, 100.0])


@pytest.mark.parametrize("dt", [1e-3, 0.03, 0.2, 1.0, 7.0, 60.0])
@pytest.mark.parametrize("tau", [0.5, 4.0, 40.0])
def test_step_is_that_of_the_matrix_exponential(dt: float, tau: float) -> None:
    F = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]])
    big = np.zeros((6, 6))
    big[:3, :3], big[3:, 3:] = -F, F.T
    big[2, 5] = 2.0 * 1.3**2 / tau
    # Van Loan (1978) in short pieces, for exp(F dt / tau) of a long step loses digits
    pieces = max(1, int(np.ceil(dt / 0.25)))
    E = expm(big * dt / pieces)
    phi = E[3:, 3:].T
    piece = phi @ E[:3, 3:]
    Phi, Q = np.eye(3), np.zeros((3, 3))
    for _ in range(pieces):
        Q = phi @ Q @ phi.T + piece
        Phi = phi @ Phi
    g, q = np.empty(3), np.empty((3, 3))
    response(dt, tau, g)
    axis_noise(dt, 1.3, tau, q)
    np.testing.assert_allclose(g, Phi[:, 2], rtol=1e-9, atol=1e-15)
    s = np.sqrt(Q.diagonal())
    np.testing.assert_allclose(q / np.outer(s, s), Q / np.outer(s, s), atol=1e-8)


def dense(
    time: Array, z: Array, R: Array, prior: tuple[Array, Array], jump: Array
) -> tuple[Array, Array]:
    """Mean (12 k) and covariance of the states at times, of all measurements at once."""
    k = len(time)
    mean, cov = np.zeros((k, STATES)), np.zeros((k, STATES, k, STATES))
    mean[0], cov[0, :, 0, :] = prior
    for i in range(1, k):
        Phi, Q = step(time[i] - time[i - 1], MODEL, SLOW, jump[i, 2])
        Q[:3, :3] += jump[i, 0] * np.eye(3)
        Q[3:6, 3:6] += jump[i, 1] * np.eye(3)
        mean[i] = Phi @ mean[i - 1]
        for j in range(i):
            cov[i, :, j, :] = Phi @ cov[i - 1, :, j, :]
            cov[j, :, i, :] = cov[i, :, j, :].T
        cov[i, :, i, :] = Phi @ cov[i - 1, :, i - 1, :] @ Phi.T + Q
    x, P = mean.ravel(), cov.reshape(k * STATES, k * STATES)
    rows, values, noise = [], [], []
    for block in range(2):
        for i in np.flatnonzero(np.isfinite(z[block, :, 0])):
            H = np.zeros((3, k * STATES))
            H[:, STATES * i + 3 * block : STATES * i + 3 * block + 3] = np.eye(3)
            if block == 0:
                H[:, STATES * i + 9 : STATES * i + 12] = np.eye(3)
            rows.append(H)
            values.append(z[block, i])
            noise.append(R[block, i])
    H = np.concatenate(rows)
    N = np.zeros((len(H), len(H)))
    for i, part in enumerate(noise):
        N[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = part
    K = np.linalg.solve(H @ P @ H.T + N, H @ P).T
    return x + K @ (np.concatenate(values) - H @ x), P - K @ H @ P


def test_states_and_all_their_correlations_are_those_of_dense_least_squares() -> None:
    rng = np.random.default_rng(2)
    # fixes at some of the times; the others are asked for, also two in one step, and both ends
    time = np.array([0.0, 0.2, 0.3, 0.4, 1.0, 1.7, 2.1, 2.6, 5.0, 9.0, 9.3, 10.0])
    fix = np.array([0, 1, 3, 4, 7, 9, 11])
    z = rng.normal(0.0, 5.0, size=(2, len(time), 3))
    z[1, 3] = np.nan
    a = rng.normal(size=(2, len(time), 3, 3))
    R = a @ np.swapaxes(a, -1, -2) + 0.1 * np.eye(3)
    jump = np.tile([0.0, 0.0, 1.0], (len(time), 1))
    jump[8:10, 2] = 1.7
    prior = (rng.normal(size=STATES), np.diag(rng.uniform(1.0, 30.0, STATES)))
    only = z.copy()
    only[:, np.setdiff1d(np.arange(len(time)), fix)] = np.nan
    mean, P = dense(time, only, R, prior, jump)
    m = len(fix)
    out = (np.empty((m, STATES)), np.empty((m, STATES)), np.empty((m, PACKED)), jump[fix].copy(),
           np.empty((m, 2)))  # fmt: skip
    forward(time[fix], np.ascontiguousarray(z[:, fix]), np.ascontiguousarray(R[:, fix]), MODEL,
            SLOW, np.array([np.inf, 1e9]), prior[0].copy(), prior[1].copy(), out)  # fmt: skip
    x, packed = np.empty((m, STATES)), np.empty((m, PACKED))
    backward(time[fix], MODEL, SLOW, out[:4], x, packed)
    np.testing.assert_allclose(x.ravel(), mean.reshape(-1, STATES)[fix].ravel(), atol=1e-7)
    index = np.clip(np.searchsorted(time[fix], time, side="right") - 1, 0, m - 2)
    got, cov, G = insert(time[fix], MODEL, SLOW, out[:4], (x, packed), time, index, True)
    np.testing.assert_allclose(got.ravel(), mean, atol=1e-7)
    joint = P.reshape(len(time), STATES, len(time), STATES)
    scale = np.sqrt(np.outer(P.diagonal(), P.diagonal())).reshape(joint.shape)
    for i in range(len(time)):
        product = np.eye(STATES)
        for j in range(i, len(time)):
            found = product @ cov[j]
            np.testing.assert_allclose(
                found / scale[i, :, j, :], joint[i, :, j, :] / scale[i, :, j, :], atol=1e-7
            )
            product = product @ G[j]
    np.testing.assert_allclose(unpack(packed[2], STATES), cov[3], atol=1e-9)


def test_a_lasting_jump_is_believed_after_a_while_and_its_variance_let_in() -> None:
    time = np.arange(200) * 0.2
    z = np.zeros((2, 200, 3))
    z[0, 100:, 0] = 500.0
    R = np.tile(np.eye(3), (2, 200, 1, 1))
    R[1] *= 0.01
    out = (np.empty((200, STATES)), np.empty((200, STATES)), np.empty((200, PACKED)),
           np.tile([0.0, 0.0, 1.0], (200, 1)), np.empty((200, 2)))  # fmt: skip
    cov = np.diag([100.0] * 6 + [1.0] * 3 + [4.0] * 3)
    forward(time, z, R, MODEL, SLOW, np.array([16.27, 10.0]), np.zeros(STATES), cov, out)
    at = int(np.argmax(out[3][:, 0]))
    assert time[at] - time[100] == pytest.approx(10.0, abs=0.5)
    assert abs(out[1][at - 1, 0]) < 10.0  # m: refused fixes hardly pull
    assert out[1][at + 1, 0] > 480.0  # m
