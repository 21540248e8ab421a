"""Camera poses from a trajectory: hand-made cases, derivatives, and draws of all errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from georef_gis.ellipsoid import Origin
from georef_gis.errors import NavigationError
from georef_gis.frames import Array, R_ned_from_body, exp_so3, log_so3
from georef_gis.model.logs import TrajectoryLog, unknown
from georef_gis.model.pose import Mount, Pose
from georef_gis.model.trajectory import StateChain, TrajectoryStates
from georef_gis.navigate.exposure_poses import ExposurePoses, exposure_poses
from georef_gis.navigate.table_trajectory import TableTrajectory
from georef_gis.project import Project
from processing_algorithms.navigate.flight import project_mount

HOME = Origin(lat=math.radians(39.0), lon=math.radians(-80.0), height_ellipsoidal=300.0)
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# N/E/D m and rad
P_TRAJECTORY = np.diag([0.3, 0.4, 0.5, 0.002, 0.003, 0.01]) ** 2
ALIKE = 0.9


@dataclass(frozen=True, kw_only=True)
class Made:
    """Trajectory of a formula: level flight to the east, or one that rolls to and fro.

    `off` (6,) is an error (dp_ned m, dtheta_ned rad) put onto it, whose truth has none.
    """

    sway: float = 0.0
    off: ArrayLike = (0.0,) * 6
    P: Array | None = None
    span: tuple[float, float] = (0.0, 100.0)

    def why_not(self, time: float) -> str:
        return "" if self.span[0] <= time <= self.span[1] else "its time lies outside"

    def place(self, t: Array) -> Array:
        """East, north, up at the home, m."""
        return np.stack([20.0 * t, 3.0 * np.sin(self.sway * t), 50.0 + 0.0 * t], axis=-1)

    def attitude(self, t: Array) -> Array:
        zero = np.zeros_like(t)
        return R_ned_from_body(0.3 * np.sin(self.sway * t), zero, zero + math.pi / 2)

    def at(self, times: ArrayLike) -> TrajectoryStates:
        t = np.atleast_1d(np.asarray(times, float))
        for value in t:
            if why := self.why_not(float(value)):
                raise NavigationError(why)
        off = np.asarray(self.off, float)
        h = 1e-4
        p = self.place(t) + ENU_FROM_NED @ off[:3]
        before, after = self.attitude(t - h), self.attitude(t + h)
        # axes of ned turn by a microradian per six metres, which is left out of the truth too
        R = exp_so3(off[3:]) @ self.attitude(t)
        return TrajectoryStates(
            time=t, p_geo=HOME.geo_from_enu(p),
            v_ned=(self.place(t + h) - self.place(t - h)) / (2 * h) @ ENU_FROM_NED.T,
            R_ned_from_body=R,
            rate_body=log_so3(np.swapaxes(before, -1, -2) @ after) / (2 * h),
            covariance=np.tile(self.covariance, (len(t), 1, 1)),
        )  # fmt: skip

    @property
    def covariance(self) -> Array:
        return P_TRAJECTORY if self.P is None else self.P

    def chain(self, times: ArrayLike) -> StateChain:
        n = len(np.atleast_1d(times))
        return StateChain(
            time=np.asarray(times, float), covariance=np.tile(self.covariance, (n, 1, 1)),
            gain=np.tile(ALIKE * np.eye(6), (n, 1, 1)),
        )  # fmt: skip


def poses_of(
    trajectory: Made, times: ArrayLike, mount: Mount, variance: float = 0.0, **more: object
) -> ExposurePoses:
    t = np.asarray(times, float)
    names = [f"P{i}" for i in range(len(t))]
    return exposure_poses(trajectory, names, t, np.full(len(t), variance), mount, HOME, **more)


def test_level_vehicle_heading_east_by_hand() -> None:
    # 2 m ahead, 1 m to the right, 0.5 m below; flying east, ahead is east and right is south
    mount = Mount(lever_arm_body_camera=np.array([2.0, 1.0, 0.5]))
    pose = poses_of(Made(), [0.0], mount).poses[0]
    # 1e-6: the frame's own rounding, m
    assert pose.origin_enu == pytest.approx([2.0, -1.0, 49.5], abs=1e-6)
    # image right = vehicle's right = south, image down = backwards = west, view = down
    expected = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert pose.R_enu_from_cam == pytest.approx(expected, abs=1e-9)
    assert pose.kind == "navigation"
    assert pose.velocity_enu == pytest.approx([20.0, 0.0, 0.0], abs=1e-6)


def test_covariance_by_hand() -> None:
    mount = Mount(
        lever_arm_body_camera=np.array([2.0, 0.0, 0.0]), sigma_lever_arm=0.1, sigma_boresight=0.02
    )
    variance = 0.01**2
    C = poses_of(Made(), [0.0], mount, variance, sigma_datum=1.5).poses[0].covariance
    # east: trajectory's east, lever arm, 20 m/s times 10 ms, datum
    assert C[0, 0] == pytest.approx(0.4**2 + 0.1**2 + (20 * 0.01) ** 2 + 1.5**2)
    # north: camera 2 m to the east swings with the heading
    assert C[1, 1] == pytest.approx(0.3**2 + 0.1**2 + (2 * 0.01) ** 2 + 1.5**2)
    # up: and with the pitch, about north; the datum is horizontal
    assert C[2, 2] == pytest.approx(0.5**2 + 0.1**2 + (2 * 0.002) ** 2)
    # rotations about east, north, up are those about ned's E, N, -D
    assert np.diag(C)[3:] == pytest.approx(
        [0.003**2 + 0.02**2, 0.002**2 + 0.02**2, 0.01**2 + 0.02**2]
    )
    # a heading error to the right (about down) moves the camera, which is east, to the south
    assert C[1, 5] == pytest.approx(2 * 0.01**2)


@pytest.mark.parametrize("k", range(6))
def test_error_of_the_trajectory_moves_the_pose_as_to_pose_says(k: int) -> None:
    mount = Mount(lever_arm_body_camera=np.array([0.7, -0.4, 0.3]), boresight_body=np.full(3, 0.05))
    times, step = [1.3, 4.1], 1e-4
    base = poses_of(Made(sway=2.0), times, mount)
    moved = poses_of(Made(sway=2.0, off=step * np.eye(6)[k]), times, mount)
    for i in range(len(times)):
        off = np.concatenate([
            moved.poses[i].origin_enu - base.poses[i].origin_enu,
            log_so3(moved.poses[i].R_enu_from_cam @ base.poses[i].R_enu_from_cam.T),
        ])  # fmt: skip
        # 1e-3 relative: second order of the step, and millionths of the frame's curvature
        assert off / step == pytest.approx(base.to_pose[i][:, k], abs=1e-3)


@pytest.mark.parametrize("k", range(6))
def test_error_of_the_mount_moves_the_pose_as_its_derivative_says(k: int) -> None:
    arm, boresight = np.array([0.7, -0.4, 0.3]), np.zeros(3)
    step = 1e-5
    off = step * np.eye(6)[k]
    a = poses_of(Made(sway=2.0), [1.3], Mount(lever_arm_body_camera=arm, boresight_body=boresight))
    b = poses_of(
        Made(sway=2.0), [1.3],
        Mount(lever_arm_body_camera=arm + off[:3], boresight_body=boresight + off[3:]),
    )  # fmt: skip
    turn = log_so3(b.poses[0].R_enu_from_cam @ a.poses[0].R_enu_from_cam.T)
    got = np.concatenate([b.poses[0].origin_enu - a.poses[0].origin_enu, turn]) / step
    assert got == pytest.approx(a.mount[0][:, k], abs=1e-3)


def test_joint_covariance_is_that_of_draws() -> None:
    """Errors drawn of trajectory (alike in time), mount (shared), datum (shared), times (own)."""
    rng = np.random.default_rng(5)
    times = np.array([2.0, 3.0, 9.0])
    sigma_time, datum = 0.008, 0.6
    mount = Mount(
        lever_arm_body_camera=np.array([0.7, -0.4, 0.3]), sigma_lever_arm=0.05, sigma_boresight=0.01
    )
    said = poses_of(Made(sway=1.5), times, mount, sigma_time**2, sigma_datum=datum)
    draws = np.array([_drawn_error(rng, times, mount, sigma_time, datum) for _ in range(3000)])
    J = said.joint()
    # whitened draws have unit covariance: 3000 draws tell each element to 1/sqrt(3000) = 0.018
    # (diagonal sqrt(2) times that), the largest of 171 lies within 4.5 sigmas
    L = np.linalg.cholesky(J)
    W = np.linalg.solve(L, draws.T)
    assert np.abs(np.cov(W) - np.eye(18)).max() < 0.12
    assert said.joint([2, 0]) == pytest.approx(
        J.reshape(3, 6, 3, 6)[[2, 0]][:, :, [2, 0]].reshape(12, 12)
    )
    for i, pose in enumerate(said.poses):
        assert J[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] == pytest.approx(pose.covariance, abs=1e-12)


def _drawn_error(
    rng: np.random.Generator, times: Array, mount: Mount, sigma_time: float, datum: float
) -> Array:
    """Truth less estimate of three poses, flattened; the estimate is without any error."""
    root = np.sqrt(P_TRAJECTORY)
    made = Made(sway=1.5)
    arm = mount.lever_arm_body_camera + mount.sigma_lever_arm * rng.normal(size=3)
    turn = exp_so3(mount.sigma_boresight * rng.normal(size=3))
    shift = np.array([*(datum * rng.normal(size=2)), 0.0])
    # a chain whose neighbours correlate by `ALIKE`
    off = rng.normal(size=6)
    out = []
    for k, t in enumerate(times):
        if k:
            off = ALIKE * off + math.sqrt(1 - ALIKE**2) * rng.normal(size=6)
        e = root @ off
        true_t = np.array([t + sigma_time * rng.normal()])
        R = ENU_FROM_NED @ exp_so3(e[3:]) @ made.attitude(true_t)[0]
        p = made.place(true_t)[0] + ENU_FROM_NED @ e[:3] + R @ arm + shift
        R0 = ENU_FROM_NED @ made.attitude(np.array([t]))[0]
        p0 = made.place(np.array([t]))[0] + R0 @ mount.lever_arm_body_camera
        cam = mount.R_body_from_cam
        out.append(np.concatenate([p - p0, log_so3(R @ turn @ cam @ (R0 @ cam).T)]))
    return np.concatenate(out)


def test_coarse_time_costs_what_the_vehicle_does_around_it() -> None:
    # swaying at 4 rad/s with +-0.3 rad, photographed where the roll stands still: by the rate alone
    # a time known to 0.4 s would cost nothing
    made = Made(sway=4.0)
    sigma, t = 0.4, np.array([5.105])
    assert abs(made.at(t).rate_body[0, 0]) * sigma < 0.01
    C = poses_of(made, t, Mount(), sigma**2).poses[0].covariance
    tried = t + sigma * np.random.default_rng(1).normal(size=4000)
    dp = made.place(tried) - made.place(t)
    turned = made.attitude(tried) @ np.swapaxes(made.attitude(t), -1, -2)
    spread = log_so3(turned) @ ENU_FROM_NED.T
    # 15 %: a tenth of a third of the variance is added in every direction, seven points are tried
    assert C[0, 0] == pytest.approx(np.mean(dp[:, 0] ** 2) + 0.4**2, rel=0.15)
    assert C[3, 3] == pytest.approx(np.mean(spread[:, 0] ** 2) + 0.003**2, rel=0.15)


def test_coarse_time_near_the_end_of_the_log_stays_inside() -> None:
    poses = poses_of(Made(sway=1.0), [0.05, 99.99], Mount(), 0.5**2).poses
    assert all(np.linalg.eigvalsh(pose.covariance).min() > 0 for pose in poses)
    # 20 m/s times 0.5 s, of which half the times lie outside of the log
    assert all(math.sqrt(pose.covariance[0, 0]) > 5.0 for pose in poses)


def test_time_outside_of_the_trajectory_is_refused() -> None:
    with pytest.raises(NavigationError, match="outside"):
        poses_of(Made(), [101.0], Mount())


def held_pose() -> Pose:
    C = np.diag([9.0, 9.0, 9.0, 0.1**2, 0.2**2, 0.3**2])
    return Pose(origin_enu=np.zeros(3), R_enu_from_cam=exp_so3([0.2, 2.0, 0.4]), covariance=C)


def test_gimbal_keeps_the_angles_of_the_tags_and_the_place_of_the_trajectory() -> None:
    tag = held_pose()
    mount = Mount(lever_arm_body_camera=np.array([2.0, 0.0, 0.0]), sigma_boresight=0.02)
    both = poses_of(Made(), [0.0, 1.0], mount, 0.005**2, held=[tag, None])
    fixed = poses_of(Made(), [0.0, 1.0], mount, 0.005**2)
    assert both.poses[0].R_enu_from_cam == pytest.approx(tag.R_enu_from_cam, abs=1e-9)
    assert both.poses[0].covariance[3:, 3:] == pytest.approx(tag.covariance[3:, 3:])
    assert both.poses[0].covariance[:3, 3:] == pytest.approx(np.zeros((3, 3)))
    assert both.poses[0].covariance[:3, :3] == pytest.approx(fixed.poses[0].covariance[:3, :3])
    assert both.poses[0].rate_enu is None
    assert both.poses[1].R_enu_from_cam == pytest.approx(fixed.poses[1].R_enu_from_cam)
    # the boresight, which photos share, does not tie a held angle to another
    J = both.joint()
    assert J[3:6, 9:12] == pytest.approx(np.zeros((3, 3)))
    assert J[:3, 6:9] == pytest.approx(fixed.joint()[:3, 6:9])


@pytest.mark.parametrize(
    ("image_top", "azimuth"), [("forward", 90.0), ("right", 180.0), ("back", 270.0), ("left", 0.0)]
)
def test_image_top_points_where_it_is_said_to(
    tmp_path: Path, image_top: str, azimuth: float
) -> None:
    """Flying east, forward is east and right is south."""
    pose = poses_of(Made(), [0.0], project_mount(_project(tmp_path, image_top, "down"))).poses[0]
    assert pose.enu_directions([0.0, 0.0, 1.0]) == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)
    up = pose.enu_directions([0.0, -1.0, 0.0])
    a = math.radians(azimuth)
    assert up == pytest.approx([math.sin(a), math.cos(a), 0.0], abs=1e-9)
    # seen from above, image right lies clockwise of image top
    right = pose.enu_directions([1.0, 0.0, 0.0])
    assert right == pytest.approx([math.cos(a), -math.sin(a), 0.0], abs=1e-9)


def test_camera_that_looks_forward_stands_upright(tmp_path: Path) -> None:
    pose = poses_of(Made(), [0.0], project_mount(_project(tmp_path, "forward", "forward"))).poses[0]
    assert pose.enu_directions([0.0, 0.0, 1.0]) == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert pose.enu_directions([0.0, -1.0, 0.0]) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def _project(folder: Path, image_top: str, looks: str) -> Project:
    (folder / "photos").mkdir()
    text = f'[mount]\nimage_top = "{image_top}"\nlooks = "{looks}"\n'
    (folder / "project.toml").write_text(text)
    return Project.open(folder)


def test_poses_of_a_table_follow_a_turning_vehicle() -> None:
    made = Made(sway=1.0)
    t = np.arange(0.0, 20.0, 0.1)
    states = made.at(t)
    rpy = np.stack([0.3 * np.sin(t), 0 * t, 0 * t + math.pi / 2], axis=-1)
    log = TrajectoryLog(
        time=t, source="t.csv", lat=states.p_geo[:, 0], lon=states.p_geo[:, 1],
        height=states.p_geo[:, 2], v_ned=states.v_ned, rpy=rpy, covariance=unknown(len(t), 6, 6),
    )  # fmt: skip
    mount = Mount(lever_arm_body_camera=np.array([0.0, 0.0, 1.0]))
    times = [3.33, 7.77]
    table = exposure_poses(
        TableTrajectory(log=log), ["a", "b"], np.array(times), np.zeros(2), mount, HOME
    )
    for mine, true in zip(table.poses, poses_of(made, times, mount).poses, strict=True):
        # interpolated over 0.1 s: millimetres and tenths of a milliradian
        assert mine.origin_enu == pytest.approx(true.origin_enu, abs=0.003)
        assert mine.R_enu_from_cam == pytest.approx(true.R_enu_from_cam, abs=5e-4)
        assert mine.velocity_enu == pytest.approx(true.velocity_enu, abs=0.05)
