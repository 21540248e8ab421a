"""Boresight and lever arm from photos of targets, taken while standing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.orient.calibration.static import StaticSettings, calibrate_static
from georef_gis.orient.resection import resect
from georef_gis.orient.resection_marks import ControlMarks
from georef_gis.orient.two_step import MountEstimate, NavigationPose, two_step

CAMERA = Camera(id="c", width=4000, height=3000, fx=3000.0, fy=3000.0, cx=2010.0, cy=1492.0)
ARM = np.array([0.11, -0.04, 0.16])
ANTENNA = np.array([-0.20, 0.0, -0.35])
BORESIGHT = np.radians([0.8, -1.1, 0.6])
# the camera looks forward at a wall of targets
NOMINAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SIGMA_NAV = np.array([0.01, 0.01, 0.015, 2e-3, 2e-3, 6e-3])


@dataclass
class Session:
    poses: dict[str, Pose]
    navigation: list[NavigationPose]
    stands: dict[str, str]


def session(rng: np.random.Generator, *, stands: int = 4, photos: int = 4, of: str = "imu",
            noise: float = 1.0) -> Session:  # fmt: skip
    """Photos of targets from several stands: marks resected, navigation wrong once per stand."""
    poses, navigation, where = {}, [], {}
    for s in range(stands):
        yaw = s * 2 * np.pi / stands + rng.normal(0, 0.1)
        e = noise * rng.standard_normal(6) * SIGMA_NAV
        R = SWAP @ exp_so3([0, 0, yaw]) @ exp_so3([0, rng.normal(0, 0.05), 0])
        R = R @ exp_so3([rng.normal(0, 0.05), 0, 0])
        p = rng.normal(0, 1.0, 3)
        for k in range(photos):
            photo = f"S{s}P{k}"
            C = p + R @ ARM
            R_cam = R @ exp_so3(BORESIGHT) @ NOMINAL
            uv = rng.uniform([100, 100], [3900, 2900], (12, 2))
            d = CAMERA.ray(uv) @ R_cam.T
            targets = C + rng.uniform(6.0, 12.0, (12, 1)) * d
            marks = ControlMarks(
                p_enu=targets + noise * 0.002 * rng.standard_normal((12, 3)),
                uv=uv + noise * 0.3 * rng.standard_normal((12, 2)),
                sigma_px=0.3,
                sigma_enu=0.002,
            )
            poses[photo] = resect(CAMERA, marks).pose
            place = p if of == "imu" else p + R @ ANTENNA
            navigation.append(
                NavigationPose(
                    photo_id=photo,
                    p_enu=place - e[:3],
                    R_enu_from_body=exp_so3(-e[3:]) @ R,
                    covariance=np.diag(SIGMA_NAV**2),
                )
            )
            where[photo] = f"stand {s}"
    return Session(poses, navigation, where)


def error(found: MountEstimate) -> Array:
    turn = log_so3(exp_so3(BORESIGHT) @ NOMINAL @ found.R_body_from_cam.T)
    return np.concatenate([ARM - found.lever_arm_body_camera, turn])


@pytest.mark.parametrize("of", ["imu", "antenna"])
def test_exact_marks_and_logs_give_the_exact_mount(of: str) -> None:
    s = session(np.random.default_rng(0), of=of, noise=0.0, stands=2, photos=2)
    antenna = ANTENNA if of == "antenna" else None
    found = calibrate_static(
        s.poses, s.navigation, StaticSettings(stands=s.stands, lever_arm_body_antenna=antenna)
    )
    assert error(found) == pytest.approx(np.zeros(6), abs=1e-7)


@pytest.mark.slow
def test_errors_agree_with_sigmas_over_40_sessions() -> None:
    rng = np.random.default_rng(1)
    ratio, alone = [], []
    for _ in range(40):
        s = session(rng)
        found = calibrate_static(s.poses, s.navigation, StaticSettings(stands=s.stands))
        ratio.append(error(found) / np.sqrt(np.diag(found.covariance)))
        mean = two_step(s.poses, s.navigation)
        alone.append(error(mean) / np.sqrt(np.diag(mean.covariance_independent)))
    rms = np.sqrt(np.mean(np.square(ratio), axis=0))
    assert np.all((rms > 0.7) & (rms < 1.4)), rms
    # Four photos of one stand share an error: as independent they claim too much, up to sqrt(4).
    assert np.sqrt(np.mean(np.square(alone), axis=0)).max() > 1.5


def test_errors_common_to_all_stands_are_added_and_named() -> None:
    s = session(np.random.default_rng(2))
    tilt = np.array([0.0, 0.0, 0.0, 3e-3, 3e-3, 0.0])
    plain = calibrate_static(s.poses, s.navigation, StaticSettings(stands=s.stands))
    held = calibrate_static(
        s.poses, s.navigation, StaticSettings(stands=s.stands, sigma_common=tilt)
    )
    assert np.diag(held.covariance - plain.covariance) == pytest.approx(tilt**2, abs=1e-12)
    assert any("accelerometers" in d for d in plain.doubts)
    assert not any("accelerometers" in d for d in held.doubts)


def test_a_single_stand_is_named() -> None:
    s = session(np.random.default_rng(3), stands=1)
    found = calibrate_static(s.poses, s.navigation, StaticSettings(stands=s.stands))
    assert any("one stand" in d for d in found.doubts)
    # four photos of one stand know the mount no better than the navigation does
    assert np.all(np.diag(found.covariance)[3:] > 0.9 * SIGMA_NAV[3:].min() ** 2)


def test_a_vehicle_that_moved_within_a_stand_is_named() -> None:
    s = session(np.random.default_rng(4), stands=2)
    one = dict.fromkeys(s.stands, "the same")
    found = calibrate_static(s.poses, s.navigation, StaticSettings(stands=one))
    assert any("turned by" in d for d in found.doubts)
