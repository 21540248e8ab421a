"""What is known of poses, cameras and the ground before an adjustment."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, first_points
from adjustment_cases import BROWN, Array, oriented, pose_at

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, exp_so3
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.trajectory import StateChain
from georef_gis.orient.adjustment.block import GroundPrior
from georef_gis.orient.adjustment.priors import (
    MountPrior,
    camera_prior,
    navigation_prior,
    tag_prior,
    times_of,
    velocities_of,
)
from georef_gis.orient.adjustment.problem import Problem


def marginal(prior: object) -> Array:
    """Covariance of each pose alone with what the flight shares; (n, 6, 6)."""
    n = len(prior.photos)
    B = np.zeros((n, 6, 10))
    B[:, :3, :3] = B[:, 3:, 3:6] = prior.R_enu_from_body
    B[:, :3, 6:9], B[:, :3, 9], B[:, 3:, 9] = np.eye(3), prior.velocity_enu, prior.rate_enu
    own = prior.covariance.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n), :]
    return own + np.einsum("aij,jk,alk->ail", B, prior.shared_covariance, B)


def joint_of(prior: object) -> Array:
    n = len(prior.photos)
    B = np.zeros((n, 6, 10))
    B[:, :3, :3] = B[:, 3:, 3:6] = prior.R_enu_from_body
    B[:, :3, 6:9], B[:, :3, 9], B[:, 3:, 9] = np.eye(3), prior.velocity_enu, prior.rate_enu
    flat = B.reshape(6 * n, 10)
    return prior.covariance + flat @ prior.shared_covariance @ flat.T


def tagged_photos(spread: list[float], **tags: object) -> list[OrientedPhoto]:
    """A line with tags of those sigmas, m; angles of 2 deg and 5 deg (yaw) about body axes."""
    out = []
    for i, sigma in enumerate(spread):
        pose = pose_at(20.0 * i, 0, 90, tilt=0.0)
        body = pose.R_enu_from_cam @ R_BODY_FROM_CAM_NADIR.T
        turns = body @ np.diag(np.radians([2.0, 2.0, 5.0]) ** 2) @ body.T
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = np.diag([sigma**2, sigma**2, 4 * sigma**2]), turns
        pose = replace(pose, covariance=covariance)
        out.append(oriented(f"P{i}", BROWN, pose, time_gps=1e6 + 2.0 * i, **tags))
    return out


NO_MOUNT = MountPrior(sigma_lever=0.0, sigma_clock=0.0)


def test_each_tag_is_as_good_as_it_says() -> None:
    photos = tagged_photos([1.5] * 6)
    prior = tag_prior("f", photos, np.arange(6), NO_MOUNT)
    for found, photo in zip(marginal(prior), photos, strict=True):
        np.testing.assert_allclose(found, photo.pose.covariance, atol=1e-9)


def test_a_fixed_receiver_keeps_its_centimetres_among_photos_without_a_fix() -> None:
    """Sigmas from each tag within 20 %, of 2 cm and of 3 m on one flight."""
    spread = [0.02, 0.02, 3.0, 3.0, 3.0, 3.0, 0.02]
    photos = tagged_photos(spread)
    found = np.sqrt(np.einsum("aii->ai", marginal(tag_prior("f", photos, np.arange(7), NO_MOUNT))))
    np.testing.assert_allclose(found[:, 0], spread, rtol=0.2)
    np.testing.assert_allclose(found[:, 2], 2 * np.array(spread), rtol=0.2)


def test_errors_of_tags_hang_together() -> None:
    """Position errors of two photos 2 s apart: the mean of them is hardly better than one."""
    prior = tag_prior("f", tagged_photos([1.5] * 6), np.arange(6), NO_MOUNT)
    J = joint_of(prior)
    assert 0.7 < J[0, 6] / J[0, 0] < 0.9
    assert 0.5 < J[5, 11] / J[5, 5] < 0.95
    # and the part that one photo may be trusted less by is in the joint covariance
    np.linalg.cholesky(prior.covariance - 0.99 * block_diagonal(prior.white))


def block_diagonal(blocks: Array) -> Array:
    n = len(blocks)
    out = np.zeros((n, 6, n, 6))
    out[np.arange(n), :, np.arange(n), :] = blocks
    return out.reshape(6 * n, 6 * n)


def test_velocities_come_from_tags_or_from_neighbours_and_not_across_a_turn() -> None:
    place = np.array(
        [[0.0, 0, 90], [20, 0, 90], [40, 0, 91], [40, 30, 90], [20, 30, 90], [0, 30, 90]]
    )
    photos = [oriented(f"P{i}", BROWN, pose_at(*p)).photo for i, p in enumerate(place)]
    t = 2.0 * np.arange(6)
    v = velocities_of(photos, place, t)
    np.testing.assert_allclose(v[1], [10, 0, 0], atol=1e-9)
    np.testing.assert_allclose(v[4], [-10, 0, 0], atol=1e-9)
    # the ends of the lines fly along them
    np.testing.assert_allclose(v[2:4], [[10, 0, 0], [-10, 0, 0]], atol=1e-9)
    # one place 60 m off: its neighbours keep their velocity, its own is not known
    far = place + np.eye(6)[:, 1:2] * [0.0, 60.0, 0.0]
    np.testing.assert_allclose(velocities_of(photos, far, t)[2], v[2], atol=10.0)
    tagged = [replace(p, ground_speed=12.0, course=np.pi / 2) for p in photos]
    np.testing.assert_allclose(velocities_of(tagged, place, t), np.tile([12.0, 0, 0], (6, 1)),
                               atol=1e-9)  # fmt: skip
    # shuffled photos fly the same way
    order = np.array([3, 0, 5, 1, 4, 2])
    mixed = velocities_of([photos[i] for i in order], place[order], t[order])
    np.testing.assert_allclose(mixed, v[order], atol=1e-12)


def test_photos_with_equal_clocks_or_none_still_have_a_prior() -> None:
    """Clocks of whole seconds repeat; without any clock the order tells the time."""
    clock = datetime(2026, 5, 1, 12)
    burst = [
        oriented(f"P{i}", BROWN, pose_at(5.0 * i, 0, 90, sigma=1.0),
                 camera_clock=clock + timedelta(seconds=i // 3))
        for i in range(6)
    ]  # fmt: skip
    np.testing.assert_array_equal(times_of([p.photo for p in burst]), [0, 0, 0, 1, 1, 1])
    none = [oriented(f"P{i}", BROWN, pose_at(5.0 * i, 0, 90)) for i in range(3)]
    np.testing.assert_array_equal(times_of([p.photo for p in none]), [0.0, 3.0, 6.0])
    for photos in (burst, none, burst[:1]):
        prior = tag_prior("f", photos, np.arange(len(photos)))
        np.linalg.cholesky(prior.covariance)


def test_the_prior_of_a_trajectory_is_its_joint_covariance() -> None:
    """Pose errors by a chain of states, mount and times: built here block by block."""
    rng = np.random.default_rng(5)
    n = 4
    gain = 0.9 * np.eye(6) + 0.02 * rng.normal(size=(n, 6, 6))
    A = rng.normal(size=(n, 6, 6))
    last = A[-1] @ A[-1].T
    covariance = np.zeros((n, 6, 6))
    covariance[-1] = last
    for i in range(n - 2, -1, -1):
        covariance[i] = gain[i] @ covariance[i + 1] @ gain[i].T + A[i] @ A[i].T
    L = np.eye(6) + 0.1 * rng.normal(size=(n, 6, 6))
    R = exp_so3(rng.normal(size=(n, 3)))
    M = np.zeros((n, 6, 9))
    M[:, :3, :3] = M[:, 3:, 3:6] = R
    M[:, :3, 6:] = np.eye(3)
    mount = np.diag([0.01, 0.02, 0.03, 1e-3, 2e-3, 3e-3, 0.5, 0.6, 0.0])
    own = np.array([a @ a.T for a in 0.1 * rng.normal(size=(n, 6, 6))])
    v, w = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    photos = [
        oriented(f"P{i}", BROWN, replace(pose_at(i, 0, 90), velocity_enu=v[i], rate_enu=w[i]))
        for i in range(n)
    ]
    columns = {"time": np.arange(n, dtype=float), "covariance": covariance, "gain": gain,
               "to_pose": L, "mount": M, "mount_covariance": mount, "own": own}  # fmt: skip
    prior = navigation_prior("f", photos, np.arange(n), columns, sigma_clock=0.02)
    chain = StateChain(time=np.arange(n, dtype=float), covariance=covariance, gain=gain)
    moved = np.hstack([v, w])
    found = joint_of(prior).reshape(n, 6, n, 6)
    for a in range(n):
        for b in range(n):
            expected = L[a] @ chain.cross(a, b) @ L[b].T + M[a] @ mount @ M[b].T
            expected += 0.02**2 * np.outer(moved[a], moved[b]) + (own[a] if a == b else 0.0)
            np.testing.assert_allclose(found[a, :, b], expected, atol=1e-9)


def test_a_held_camera_and_a_photo_without_motion_have_no_freedom_there() -> None:
    assert not np.any(camera_prior(BROWN, calibrate=False).sigma)
    assert camera_prior(BROWN, moving=False).sigma[10] == 0.0
    still = replace(BROWN, k1=0.0, k2=0.0, k3=0.0, p1=0.0, p2=0.0)
    assert camera_prior(still).sigma[10] > 0.0


def test_heights_of_the_ground_count_as_ten_however_many_points_there_are() -> None:
    flight = sim.strip(25, 3, obs_per_photo=40.0)
    block = block_of(flight)
    z = np.zeros(block.ties.n_points)
    block = replace(block, ground=GroundPrior(z_enu=z, sigma=2.0, independent=10.0))
    information = Problem(block, first_points(flight, block)).information
    assert information[:, 2].sum() == pytest.approx(10.0 / 2.0**2)
    assert not np.any(information[:, :2])
