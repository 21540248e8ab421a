"""Covariance of a point located from one photo, against 4 000 draws of everything."""

from __future__ import annotations

from dataclasses import replace

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.frames import exp_so3
from georef_gis.model.ground_point import (
    ground_normal,
    ground_point_covariance,
    ground_point_jacobians,
    locate,
)
from georef_gis.model.joint_errors import SIGMA_LENS, camera_sigmas
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

N = 4000
LENS = ("k1", "k2", "k3", "p1", "p2")
POSE_SIGMAS = np.array([0.3, 0.2, 0.25, 0.004, 0.003, 0.006])


def pose_covariance(rng: np.random.Generator) -> np.ndarray:
    A = np.eye(6) + 0.3 * rng.normal(size=(6, 6))
    C = A @ A.T
    s = POSE_SIGMAS / np.sqrt(np.diag(C))
    return np.asarray(C * np.outer(s, s))


def drawn_points(
    photo: OrientedPhoto, uv: np.ndarray, sigma_uv: float, sigma_h: float, rng: np.random.Generator
) -> np.ndarray:
    """The same click with the true pose, camera, ground and mark drawn anew."""
    camera = photo.camera
    e = rng.multivariate_normal(np.zeros(6), photo.pose.covariance, N)
    out = np.empty((N, 3))
    for k in range(N):
        pose = Pose(
            origin_enu=photo.pose.origin_enu + e[k, :3],
            R_enu_from_cam=exp_so3(e[k, 3:]) @ photo.pose.R_enu_from_cam,
            covariance=np.zeros((6, 6)),
            velocity_enu=photo.pose.velocity_enu,
        )
        off = rng.normal(size=11) * camera_sigmas(camera)
        lens = {n: getattr(camera, n) + d for n, d in zip(LENS, off[3:8], strict=True)}
        true_camera = replace(
            camera, fx=camera.fx + off[0], fy=camera.fy + off[0], cx=camera.cx + off[1],
            cy=camera.cy + off[2], **lens,
        )  # fmt: skip
        ground = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6 + sigma_h * rng.normal())
        true = OrientedPhoto(photo=photo.photo, camera=true_camera, pose=pose)
        out[k] = locate(true, uv + sigma_uv * rng.normal(size=2), ground)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("readout_s", [0.0, 0.05], ids=["global", "rolling"])
def test_covariance_of_a_ground_point_is_that_of_the_draws(readout_s: float) -> None:
    rng = np.random.default_rng(7)
    camera = replace(cases.rolling(readout_s), sigma_f=4.0, sigma_c=2.0)
    photo = cases.oriented(
        (12.0, -15.0, 70.0),
        camera=camera,
        covariance=pose_covariance(rng),
        velocity_enu=np.array([15.0, 10.0, 0.0]),
    )
    ground = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6, sigma=0.4)
    uv = np.array([1100.0, 150.0])
    p = locate(photo, uv, ground)
    C = ground_point_covariance(photo, p, ground, sigma_uv=1.5)
    sample = np.cov(drawn_points(photo, uv, 1.5, 0.4, rng).T)
    scale = np.sqrt(np.outer(np.diag(C), np.diag(C)))
    # 4 000 draws: 2.2 %, and the second order of 0.006 rad
    assert np.abs((sample - C) / scale).max() < 0.10


def test_nadir_by_hand() -> None:
    """60 m up: 0.01 rad of roll moves the point 0.6 m, a height error below does nothing."""
    C6 = np.diag([0.0, 0, 0, 0.01**2, 0, 0])
    camera = replace(cases.CAMERA, cx=647.5, cy=431.5)
    photo = cases.oriented(camera=camera, covariance=C6)
    ground = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6, sigma=5.0)
    p = locate(photo, [647.5, 431.5], ground)
    C = ground_point_covariance(photo, p, ground, sigma_uv=0.0)
    # About the east axis: the point moves north. Up takes the height's own sigma.
    assert np.sqrt(np.diag(C)) == pytest.approx([0.0, 0.6, 5.0], abs=1e-5)


def test_click_and_focal_length_by_hand() -> None:
    camera = replace(cases.CAMERA, k1=0, k2=0, k3=0, p1=0, p2=0, cx=647.5, cy=431.5, sigma_f=10.0)
    photo = cases.oriented(camera=camera)
    ground = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6)
    p = locate(photo, [647.5 + 521.7, 431.5], ground)  # half a focal length to the right: 30 m
    C = ground_point_covariance(photo, p, ground, sigma_uv=2.0)
    # ideal radius 1/2; of the lens k1 r^3, k2 r^5, k3 r^7 east, p2 3 r^2 east and p1 r^2 north
    k1, k2, k3, p1, p2 = SIGMA_LENS
    lens_east = 60.0 * np.linalg.norm([k1 / 8, k2 / 32, k3 / 128, p2 * 3 / 4])
    east = np.linalg.norm([2.0 * 60.0 / 1043.4, 30.0 * 10.0 / 1043.4, lens_east])
    north = np.hypot(2.0 * 60.0 / 1043.4, 60.0 * p1 / 4)
    assert np.sqrt(np.diag(C)) == pytest.approx([east, north, 0.0], abs=1e-4)


def test_a_camera_that_states_no_sigma_is_taken_as_known() -> None:
    assert not camera_sigmas(cases.CAMERA).any()
    calibrated = camera_sigmas(replace(cases.CAMERA, sigma_f=1.0))
    assert np.all(calibrated[3:8] > 0.0)
    nobody_knows = replace(cases.CAMERA, sigma_f=1.0, k1=0, k2=0, k3=0, p1=0, p2=0)
    assert np.all(camera_sigmas(nobody_knows)[3:8] > calibrated[3:8])


@pytest.mark.parametrize("ground_kind", ["flat", "slope"])
def test_jacobians_are_the_derivatives(ground_kind: str) -> None:
    flat = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6)
    ground = flat if ground_kind == "flat" else cases.kinked_dem()
    photo = cases.oriented((10.0, 8.0, 33.0), origin_enu=(3.0, -5.0, 66.0))
    uv = np.array([300.0, 500.0])
    p = locate(photo, uv, ground)
    J_pose, _, J_uv = ground_point_jacobians(photo, p, ground)
    assert J_uv == pytest.approx(
        np.column_stack([
            (locate(photo, uv + s, ground) - locate(photo, uv - s, ground)) / 0.2
            for s in ([0.1, 0.0], [0.0, 0.1])
        ]),
        abs=2e-3,
    )  # fmt: skip
    for k in range(6):
        step = 1e-3 * np.eye(6)[k]
        moved = []
        for s in (step, -step):
            pose = replace(
                photo.pose,
                origin_enu=photo.pose.origin_enu + s[:3],
                R_enu_from_cam=exp_so3(s[3:]) @ photo.pose.R_enu_from_cam,
            )
            moved.append(locate(replace(photo, pose=pose), uv, ground))
        numeric = (moved[0] - moved[1]) / 2e-3
        assert J_pose[:, k] == pytest.approx(numeric, abs=0.3 if k > 2 else 2e-2)


def test_normal_of_a_slope() -> None:
    ground = cases.kinked_dem()
    p = np.array([6.0, 3.5, 0.0])
    n = ground_normal(ground, p)
    assert n[2] == 1.0
    assert abs(n[0]) == pytest.approx(0.3, abs=0.01)
    assert n[1] == pytest.approx(-0.1, abs=0.01)


def test_a_ray_along_the_ground_has_no_place() -> None:
    photo = cases.oriented((0.0, 0.0, 0.0), origin_enu=(0, 0, 60.0))
    flat = FlatTerrain(origin=cases.SITE, height_ellipsoidal=337.6)
    z = float(flat.z_at(np.array([50.0, 0.0])))
    with pytest.raises(GeometryError, match="along the ground"):
        ground_point_jacobians(
            replace(photo, pose=replace(photo.pose, origin_enu=np.array([0, 0, z + 0.0004]))),
            np.array([50.0, 0.0, z]),
            flat,
        )
