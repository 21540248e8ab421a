"""Resection of one photo from surveyed marks."""

from __future__ import annotations

import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.orient.pixel_derivatives import pose_jacobian, projection_jacobian
from georef_gis.orient.resection import resect
from georef_gis.orient.resection_marks import ControlMarks

CAMERA = Camera(
    id="c", width=4000, height=3000, fx=2900.0, fy=2895.0, cx=2012.0, cy=1490.0,
    k1=-0.05, k2=0.02, p1=3e-4, p2=-2e-4, b2=0.8,
)  # fmt: skip
FISHEYE = Camera(
    id="f", width=3000, height=3000, fx=1300.0, fy=1300.0, cx=1499.5, cy=1499.5, model="fisheye",
    k1=0.01, k2=-0.002,
)  # fmt: skip


def nadir(yaw: float, tilt: float = 0.0, height: float = 100.0) -> tuple[Array, Array]:
    """Projection centre and R_enu_from_cam, written out here: columns are the camera's axes."""
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    forward = np.array([np.sin(yaw), np.cos(yaw), 0.0])
    R = np.column_stack([right, -forward, [0.0, 0.0, -1.0]])
    return np.array([300.0, -200.0, height]), exp_so3(tilt * right) @ R


def scene(
    rng: np.random.Generator, n: int, *, relief: float = 15.0, camera: Camera = CAMERA,
    tilt: float = 0.1,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """C, R, points and exact pixels of a photo."""
    C, R = nadir(rng.uniform(-3, 3), tilt)
    uv = rng.uniform([200, 200], [camera.width - 200, camera.height - 200], (n, 2))
    d = camera.ray(uv) @ R.T
    depth = (C[2] - rng.uniform(-relief, relief, n) / 2) / -d[:, 2]
    p = C + depth[:, None] * d
    return C, R, p, uv


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["brown", "fisheye"])
@pytest.mark.parametrize("n", [4, 5, 8, 30])
def test_exact_marks_give_the_exact_pose(n: int, camera: Camera) -> None:
    C, R, p, uv = scene(np.random.default_rng(n), n, camera=camera)
    found = resect(camera, ControlMarks(p_enu=p, uv=uv))
    assert found.pose.origin_enu == pytest.approx(C, abs=1e-6)  # m
    assert np.linalg.norm(log_so3(found.pose.R_enu_from_cam @ R.T)) < 1e-8  # rad
    assert found.used.all()


def test_derivatives_agree_with_moved_poses() -> None:
    C, R, p, _ = scene(np.random.default_rng(0), 6)
    J = pose_jacobian(projection_jacobian(CAMERA, (p - C) @ R), R, p - C)
    h = 1e-5
    for k, step in enumerate(np.eye(6) * h):
        ends = [
            CAMERA.project((p - C - s * step[:3]) @ (exp_so3(s * step[3:]) @ R)) for s in (1, -1)
        ]
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(J[:, :, k], rel=1e-5, abs=1e-4)


@pytest.mark.slow
def test_errors_agree_with_the_covariance_over_200_photos() -> None:
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(200):
        C, R, p, uv = scene(rng, 9)
        sigma = np.array([0.01, 0.01, 0.03])
        marks = ControlMarks(
            p_enu=p + sigma * rng.standard_normal(p.shape),
            uv=uv + 0.5 * rng.standard_normal(uv.shape),
            sigma_px=0.5,
            sigma_enu=sigma,
        )
        pose = resect(CAMERA, marks).pose
        e = np.concatenate([C - pose.origin_enu, log_so3(R @ pose.R_enu_from_cam.T)])
        squares.append(e @ np.linalg.solve(pose.covariance, e))
    # chi-square of 6 over 200 photos: 6 +- 0.24 (one sigma)
    assert np.mean(squares) == pytest.approx(6.0, abs=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("blunders", [1, 2])
def test_mislabelled_marks_are_left_out_and_named(blunders: int) -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        C, _, p, uv = scene(rng, 9)
        uv = uv + 0.5 * rng.standard_normal(uv.shape)
        uv[:blunders] += rng.uniform(30, 800, (blunders, 2))
        marks = ControlMarks(p_enu=p, uv=uv, names=tuple("ABCDEFGHI"))
        found = resect(CAMERA, marks, photo_id="P1")
        assert not found.used[:blunders].any()
        assert found.used[blunders:].sum() >= 9 - blunders - 1
        assert np.linalg.norm(found.pose.origin_enu - C) < 0.6  # m, 100 m above ground
        assert any("photo P1: mark of A is off by" in d for d in found.doubts)


def test_good_marks_are_kept() -> None:
    rng = np.random.default_rng(17)
    left_out = 0
    for _ in range(50):
        _, _, p, uv = scene(rng, 9)
        marks = ControlMarks(p_enu=p, uv=uv + 0.5 * rng.standard_normal(uv.shape))
        left_out += int((~resect(CAMERA, marks).used).sum())
    # of 900 residuals 6e-5 lie beyond four sigmas
    assert left_out <= 2


def test_two_poses_of_distant_planar_marks_are_reported() -> None:
    # A small plane seen from far away: perspective is weak, the tilt may be mirrored.
    rng = np.random.default_rng(3)
    C, R = nadir(0.3, tilt=0.35, height=400.0)
    axis = C + R[:, 2] * 420.0
    p = np.column_stack([axis[:2] + rng.uniform(-6, 6, (6, 2)), np.zeros(6)])
    uv = CAMERA.project((p - C) @ R) + 0.5 * rng.standard_normal((6, 2))
    found = resect(CAMERA, ControlMarks(p_enu=p, uv=uv))
    assert found.alternative is not None
    assert any("second pose" in d for d in found.doubts)
    prior = Pose(
        origin_enu=C + 2.0,
        R_enu_from_cam=exp_so3([0.01, 0.0, 0.01]) @ R,
        covariance=np.diag([9.0] * 3 + [4e-4] * 3),
    )
    held = resect(CAMERA, ControlMarks(p_enu=p, uv=uv), prior=prior)
    assert held.alternative is None
    assert np.degrees(np.linalg.norm(log_so3(held.pose.R_enu_from_cam @ R.T))) < 1.5


def test_wide_flat_ground_has_one_pose() -> None:
    _, _, p, uv = scene(np.random.default_rng(5), 8, relief=0.0)
    assert resect(CAMERA, ControlMarks(p_enu=p, uv=uv)).alternative is None


@pytest.mark.parametrize("n", [1, 2, 3])
def test_fewer_than_four_marks_need_a_prior(n: int) -> None:
    C, R, p, uv = scene(np.random.default_rng(2), n)
    with pytest.raises(GeometryError, match="prior"):
        resect(CAMERA, ControlMarks(p_enu=p, uv=uv))
    prior = Pose(
        origin_enu=C + np.array([1.0, -1.0, 0.5]),
        R_enu_from_cam=exp_so3([0.01, -0.01, 0.02]) @ R,
        covariance=np.diag([4.0] * 3 + [4e-4] * 3),
    )
    found = resect(CAMERA, ControlMarks(p_enu=p, uv=uv), prior=prior)
    assert np.abs(found.residuals).max() < 1.0  # px
    assert np.all(np.diag(found.pose.covariance) < np.diag(prior.covariance))


def test_marks_in_a_line_and_of_another_scene_are_refused() -> None:
    rng = np.random.default_rng(4)
    C, R, p, uv = scene(rng, 8)
    line = p[0] + np.linspace(0, 1, 6)[:, None] * (p[1] - p[0])
    with pytest.raises(GeometryError, match="in a line"):
        resect(CAMERA, ControlMarks(p_enu=line, uv=CAMERA.project((line - C) @ R)))
    # east and north swapped is a mirrored scene
    with pytest.raises(GeometryError, match=r"fit|swapped"):
        resect(CAMERA, ControlMarks(p_enu=p[:, [1, 0, 2]], uv=uv))


def test_a_rolling_shutter_is_followed_with_the_priors_motion() -> None:
    from dataclasses import replace

    camera = replace(CAMERA, readout_s=0.03)
    C, R, p, _ = scene(np.random.default_rng(9), 12)
    v, w = np.array([12.0, 5.0, 0.3]), np.array([0.02, -0.05, 0.1])
    uv = camera.project((p - C) @ R, velocity_cam=v @ R, rate_cam=w @ R)
    prior = Pose(
        origin_enu=C + 1.0, R_enu_from_cam=R, covariance=np.diag([100.0] * 3 + [0.01] * 3),
        velocity_enu=v, rate_enu=w,
    )  # fmt: skip
    found = resect(camera, ControlMarks(p_enu=p, uv=uv), prior=prior)
    assert found.pose.origin_enu == pytest.approx(C, abs=0.01)  # m; 0.36 m of motion in a readout
