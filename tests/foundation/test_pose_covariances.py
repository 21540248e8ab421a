"""Converters of the pose covariance, each against 40 000 draws of the other program's error."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from georef_gis import frames

N = 40_000
# share of sqrt(C_ii C_jj): a covariance from N draws is good to sqrt(2 / N) = 0.7 %; 4.5 sigma
TOLERANCE = 0.032


def random_covariance(rng: np.random.Generator, sigmas: np.ndarray) -> np.ndarray:
    A = np.eye(len(sigmas)) + 0.4 * rng.normal(size=(len(sigmas), len(sigmas)))
    C = A @ A.T
    s = sigmas / np.sqrt(np.diag(C))
    return np.asarray(C * np.outer(s, s))


def assert_same_covariance(drawn: np.ndarray, expected: np.ndarray) -> None:
    sample = np.cov(drawn.T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((sample - expected) / scale).max() < TOLERANCE


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def test_filters_left_error_in_ned(rng: np.random.Generator) -> None:
    C_ned = random_covariance(rng, np.array([1.0, 2.0, 3.0, 0.01, 0.02, 0.03]))
    R_enu_ned = frames.R_enu_from_ned(0.68, -1.4, 0.683, -1.396)
    R_ned_cam = frames.R_ned_from_body(0.3, -1.2, 2.5)
    e = rng.multivariate_normal(np.zeros(6), C_ned, N)
    true = R_enu_ned @ frames.exp_so3(e[:, 3:]) @ R_ned_cam
    dtheta = frames.log_so3(true @ (R_enu_ned @ R_ned_cam).T)
    drawn = np.hstack([e[:, :3] @ R_enu_ned.T, dtheta])
    assert_same_covariance(drawn, frames.covariance_from_ned(C_ned, R_enu_ned))


def test_colmaps_cam_from_world(rng: np.random.Generator) -> None:
    C_cam = random_covariance(rng, np.array([0.002, 0.001, 0.003, 0.2, 0.1, 0.3]))
    R_enu_cam = frames.exp_so3([2.8, 0.4, -0.9])
    origin = np.array([120.0, -300.0, 80.0])
    R_cw, t = R_enu_cam.T, -R_enu_cam.T @ origin
    e = rng.multivariate_normal(np.zeros(6), C_cam, N)
    R_cw_true = frames.exp_so3(e[:, :3]) @ R_cw
    t_true = t + e[:, 3:]
    origin_true = -np.einsum("nji,nj->ni", R_cw_true, t_true)
    dtheta = frames.log_so3(np.swapaxes(R_cw_true, 1, 2) @ R_enu_cam.T)
    drawn = np.hstack([origin_true - origin, dtheta])
    assert_same_covariance(drawn, frames.covariance_from_colmap(C_cam, R_enu_cam, origin))


def test_ceres_tangent_is_half_the_angle(rng: np.random.Generator) -> None:
    half = random_covariance(rng, np.array([0.002, 0.004, 0.003]))
    delta = rng.multivariate_normal(np.zeros(3), half, N)
    # EigenQuaternionManifold: plus(q, delta) = [sin|delta| delta/|delta|, cos|delta|] * q
    size = np.linalg.norm(delta, axis=1, keepdims=True)
    q = np.hstack([np.cos(size), np.sin(size) / size * delta])
    dtheta = frames.log_so3(frames.R_from_quaternion(q))
    assert_same_covariance(dtheta, frames.covariance_from_ceres_half_angle(half))


def test_ceres_hundredth_of_a_radian() -> None:
    back = frames.covariance_from_ceres_half_angle(np.eye(3) * 0.005**2)
    assert back == pytest.approx(np.eye(3) * 0.01**2, abs=1e-18)


CASES = [(0.0, 0.0, 0.0), (0.1, -0.05, 2.0), (1.2, -1.1, -2.9), (-2.0, 1.3, 0.7), (0.4, 1.5, 1.0)]


@pytest.mark.parametrize("angles", CASES, ids=str)
@pytest.mark.parametrize(
    ("rotation", "jacobian"),
    [
        (frames.R_ned_from_body, frames.jacobian_theta_ned_from_rpy),
        (frames.R_map_from_photo, frames.jacobian_theta_map_from_opk),
    ],
    ids=["rpy", "opk"],
)
def test_jacobians_of_angles(
    rng: np.random.Generator, angles: tuple, rotation: Callable, jacobian: Callable
) -> None:
    C = random_covariance(rng, np.array([0.002, 0.001, 0.003]))
    e = rng.multivariate_normal(np.zeros(3), C, N)
    true = rotation(*(np.array(angles) + e).T)
    drawn = frames.log_so3(true @ rotation(*angles).T)
    J = jacobian(*angles)
    assert_same_covariance(drawn, J @ C @ J.T)


@pytest.mark.parametrize("angles", CASES, ids=str)
def test_jacobians_are_the_derivatives(angles: tuple) -> None:
    h = 1e-6
    for rotation, jacobian in (
        (frames.R_ned_from_body, frames.jacobian_theta_ned_from_rpy),
        (frames.R_map_from_photo, frames.jacobian_theta_map_from_opk),
    ):
        for i in range(3):
            step = h * np.eye(3)[i]
            plus, minus = (rotation(*(np.array(angles) + s * step)) for s in (1, -1))
            numeric = frames.log_so3(plus @ minus.T) / (2 * h)
            assert jacobian(*angles)[:, i] == pytest.approx(numeric, abs=1e-8)


def test_level_flight_north_yaw_is_minus_up() -> None:
    theta_ned = frames.jacobian_theta_ned_from_rpy(0.0, 0.0, 0.0)
    assert np.array_equal(theta_ned, np.eye(3))
    swapped = frames.covariance_from_ned(
        np.diag([1.0, 4.0, 9.0, 0.1, 0.2, 0.3]), frames.R_ENU_FROM_NED_SAME_PLACE
    )
    assert np.diag(swapped) == pytest.approx([4.0, 1.0, 9.0, 0.2, 0.1, 0.3])
    assert math.isclose(np.linalg.det(frames.R_ENU_FROM_NED_SAME_PLACE), 1.0)
