"""Compiled residuals and derivatives against the camera model and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from adjustment_blocks import block_of, first_points
from adjustment_flights import strip

from georef_gis.frames import exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.orient.adjustment.block import camera_vector, moved_camera_vector
from georef_gis.orient.adjustment.flight_model import FlightModel, left_jacobian_inverse
from georef_gis.orient.adjustment.kernels import observe
from georef_gis.orient.adjustment.problem import Problem

CAMERA = Camera(
    id="c", width=4000, height=3000, fx=2510.0, fy=2500.0, cx=2020.0, cy=1480.0, k1=-0.05,
    k2=0.02, k3=-0.004, p1=7e-4, p2=-4e-4, b1=3.0, b2=-2.0, readout_s=0.03,
)  # fmt: skip
POSE = Pose(
    origin_enu=np.array([10.0, -5.0, 80.0]),
    R_enu_from_cam=exp_so3([0.1, -0.2, 0.7]) @ np.diag([1.0, -1.0, -1.0]),
    covariance=np.eye(6),
    velocity_enu=np.array([12.0, 5.0, -1.0]),
    rate_enu=np.array([0.2, -0.1, 0.3]),
)
POINT = np.array([25.0, 12.0, 3.0])


def observed(uv, *, pose=POSE, camera=CAMERA, vector=None, point=POINT):
    r = np.zeros(2)
    J = np.zeros((2, 6)), np.zeros((2, 3)), np.zeros((2, 11))
    motion = np.concatenate([pose.velocity_enu, pose.rate_enu])
    vector = camera_vector(camera) if vector is None else vector
    seen = observe(
        point, pose.origin_enu, np.ascontiguousarray(pose.R_enu_from_cam), motion, vector,
        float(camera.height), uv, r, *J, True,
    )  # fmt: skip
    assert seen
    return r, J


def test_residual_of_the_camera_models_own_pixel_is_zero() -> None:
    photo = Photo(id="p", path="p.jpg", width=4000, height=3000)
    uv = OrientedPhoto(photo=photo, camera=CAMERA, pose=POSE).project(POINT)
    r, _ = observed(uv)
    # px; the camera model iterates the row time to about this
    np.testing.assert_allclose(r, 0.0, atol=1e-6)


def test_derivatives_are_those_of_finite_differences() -> None:
    uv = np.array([2600.0, 900.0])
    _, (_, Jp, Jc) = observed(uv)
    eps = 1e-6
    for k in range(3):
        step = eps * np.eye(3)[k]
        diff = (observed(uv, point=POINT - step)[0] - observed(uv, point=POINT + step)[0]) / 2 / eps
        np.testing.assert_allclose(Jp[:, k], diff, rtol=1e-5, atol=1e-4)
    steps = 1e-5 * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1, 1, 1e-3])
    for k, size in enumerate(steps):
        step = size * np.eye(11)[k]
        v = camera_vector(CAMERA)
        plus = observed(uv, vector=moved_camera_vector(v, step))[0]
        minus = observed(uv, vector=moved_camera_vector(v, -step))[0]
        np.testing.assert_allclose(Jc[:, k], (minus - plus) / 2 / size, rtol=1e-4, atol=1e-3)


def test_pose_derivatives_are_those_of_the_contracts_error() -> None:
    still = Pose(
        origin_enu=POSE.origin_enu, R_enu_from_cam=POSE.R_enu_from_cam, covariance=np.eye(6),
        velocity_enu=np.zeros(3), rate_enu=np.zeros(3),
    )  # fmt: skip
    uv, eps = np.array([2600.0, 900.0]), 1e-6
    _, (Jx, _, _) = observed(uv, pose=still)
    for k in range(6):
        pair = []
        for sign in (1, -1):
            step = sign * eps * np.eye(6)[k]
            moved = Pose(
                origin_enu=still.origin_enu + step[:3],
                R_enu_from_cam=exp_so3(step[3:]) @ still.R_enu_from_cam,
                covariance=np.eye(6), velocity_enu=np.zeros(3), rate_enu=np.zeros(3),
            )  # fmt: skip
            pair.append(observed(uv, pose=moved)[0])
        np.testing.assert_allclose(Jx[:, k], (pair[1] - pair[0]) / 2 / eps, rtol=1e-5, atol=1e-3)


def test_left_jacobian_inverse_is_the_derivative_of_the_logarithm() -> None:
    from scipy.spatial.transform import Rotation

    phi = np.array([0.4, -0.9, 0.3])
    J, eps = left_jacobian_inverse(phi), 1e-6
    for k in range(3):
        step = Rotation.from_rotvec(eps * np.eye(3)[k])
        diff = ((step * Rotation.from_rotvec(phi)).as_rotvec() - phi) / eps
        np.testing.assert_allclose(J[:, k], diff, atol=1e-5)


def test_normal_equations_are_those_of_a_dense_least_squares() -> None:
    """All unknowns stacked, Jacobian by finite differences: an oracle without Schur complement."""
    flight = strip(2, 3, obs_per_photo=6.0)
    block = block_of(flight)
    problem = Problem(block, first_points(flight, block))
    state = problem.start
    H, rhs = problem.dense_normal(state, problem.reduced(state, 0.0, 0.0))
    A, b = _stacked(problem, flight)
    n = len(H)
    full = A.T @ A
    schur = full[:n, :n] - full[:n, n:] @ np.linalg.solve(full[n:, n:], full[n:, :n])
    right = A.T @ b
    reduced = right[:n] - full[:n, n:] @ np.linalg.solve(full[n:, n:], right[n:])
    free = np.concatenate([np.ones(6 * len(block.photo_ids), bool), problem.free])
    scale = 1.0 / np.sqrt(np.diag(schur)[free])
    off = (H - schur)[np.ix_(free, free)] * scale[:, None] * scale
    # finite differences of the whole residual vector
    assert np.abs(off).max() < 1e-4
    np.testing.assert_allclose(rhs[free] * scale, reduced[free] * scale, rtol=1e-3, atol=1e-2)


def _stacked(problem: Problem, flight) -> tuple[np.ndarray, np.ndarray]:
    """Whitened Jacobian and right side of all unknowns (poses, shared, points)."""
    from dataclasses import replace

    state, model = problem.start, problem.flights[0]
    n, G, k = len(state.origin), problem.block.n_shared, len(state.points)
    root = np.linalg.cholesky(model.information).T
    free = problem.free
    cameras = np.sqrt(problem.camera_information)
    spread = np.sqrt(np.where(model.free, np.diag(model.shared_information), 0.0))

    def whitened(x: np.ndarray) -> np.ndarray:
        pose, shared, points = x[: 6 * n].reshape(n, 6), x[6 * n : 6 * n + G], x[6 * n + G :]
        shared = np.where(free, shared, 0.0)
        moved = replace(
            state,
            origin=state.origin + pose[:, :3],
            rotation=exp_so3(pose[:, 3:]) @ state.rotation,
            cameras=np.array([moved_camera_vector(state.cameras[0], shared[:11])]),
            points=state.points + points.reshape(k, 3),
            flights=state.flights + shared[11:21],
        )
        _, r, _ = problem.image_cost(moved, 0.0)
        d = model.residual(moved.origin, moved.rotation, moved.flights[0])
        own = [cameras * -shared[:11], spread * -moved.flights[0]]
        return np.concatenate([(r / problem.sigma[:, None]).ravel(), -root @ d.ravel(), *own])

    zero = np.zeros(6 * n + G + 3 * k)
    eps = np.full(len(zero), 1e-5)
    eps[6 * n + 3 : 6 * n + 8] = 1e-7
    columns = [
        (whitened(zero - e * row) - whitened(zero + e * row)) / (2 * e)
        for e, row in zip(eps, np.eye(len(zero)), strict=True)
    ]
    return np.stack(columns, axis=1), whitened(zero)


def test_photo_off_the_path_is_told_by_the_others() -> None:
    flight = strip(4)
    block = block_of(flight)
    origin = np.array([pose.origin_enu for pose in block.poses])
    rotation = np.array([pose.R_enu_from_cam for pose in block.poses])
    model = FlightModel(block.flights[0], origin, rotation)
    d = np.zeros((len(origin), 6))
    d[3, 2] = 100.0
    off, sigma = model.foretold(d)
    assert off[3, 2] == pytest.approx(100.0, rel=0.01)
    ratio = np.abs(off) / sigma
    assert np.unravel_index(np.argmax(ratio), ratio.shape) == (3, 2)
