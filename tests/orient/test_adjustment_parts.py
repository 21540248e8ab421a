"""The parts of an adjustment: sensor axes, priors, weighing, checks, what is kept, covariances."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, first_points, flight_prior, judge, rms
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import R_BODY_FROM_CAM_NADIR, exp_so3, log_so3
from georef_gis.geodesy import Origin
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tie_points import TiePoints
from georef_gis.model.trajectory import StateChain
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import Block, ControlInput, GroundPrior
from georef_gis.orient.adjustment.build import (
    R_turned_from_sensor,
    first_places,
    sensor_views,
    uv_in_sensor,
)
from georef_gis.orient.adjustment.checks import Check, observability, plausibility
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.keep import (
    POINTS,
    load_points,
    load_ties,
    save_adjusted,
    save_ties,
)
from georef_gis.orient.adjustment.priors import (
    MountPrior,
    camera_prior,
    navigation_prior,
    tag_prior,
    times_of,
    velocities_of,
)
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import solve

Array = NDArray[np.float64]
ORIGIN = Origin(lat=0.68, lon=-1.4, height_ellipsoidal=0.0)
BROWN = Camera(
    id="c", width=1200, height=800, fx=900.0, fy=905.0, cx=611.0, cy=395.0, k1=-0.1, k2=0.03,
    k3=-0.004, p1=1e-3, p2=-7e-4,
)  # fmt: skip
FISHEYE = Camera(
    id="f", width=1200, height=800, fx=500.0, fy=500.0, cx=603.0, cy=398.0, model="fisheye",
    k1=0.02, k2=-0.004,
)  # fmt: skip
PIX4D = Camera(
    id="p", width=1200, height=800, fx=800.0, fy=800.0, cx=603.0, cy=398.0, model="fisheye_pix4d",
    poly=(0.01, -0.03),
)  # fmt: skip


def pose_at(*place: float, yaw: float = 0.3, tilt: float = 0.1, sigma: float = 0.05) -> Pose:
    """Pose over the ground, image top about north, turned by `yaw`."""
    R = exp_so3([tilt, 0.05, yaw]) @ np.diag([1.0, -1.0, -1.0])
    c = np.diag([sigma**2] * 3 + [(0.02 + sigma / 10) ** 2] * 3)
    return Pose(origin_enu=np.array(place), R_enu_from_cam=R, covariance=c)


def oriented(name: str, camera: Camera, pose: Pose, **tags: object) -> OrientedPhoto:
    photo = Photo(
        id=name, path=Path(name), width=camera.width, height=camera.height, camera_id=camera.id,
        **tags,  # type: ignore[arg-type]
    )  # fmt: skip
    return OrientedPhoto(photo=photo, camera=camera, pose=pose)


def adjusted(flight: sim.SimFlight, block: Block | None = None) -> Adjusted:
    block = block or block_of(flight)
    return adjust(block, first_points(flight, block))


def errors(flight: sim.SimFlight, answer: Adjusted) -> Array:
    """True less adjusted poses, (n, 6), m and rad in enu."""
    p = np.array([pose.origin_enu for pose in answer.poses])
    R = np.array([pose.R_enu_from_cam for pose in answer.poses])
    turned = log_so3(flight.truth.R_enu_from_cam @ np.swapaxes(R, 1, 2))
    return np.hstack([flight.truth.p_cam - p, turned])


def sigmas(answer: Adjusted) -> Array:
    return np.sqrt([np.diag(pose.covariance) for pose in answer.poses])


# -- build -------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_turned_photo_sees_in_the_sensor_what_it_sees_itself(degrees: int) -> None:
    """Against `Camera.turned`, which knows nothing of poses; 1e-6 px."""
    sensor = oriented("a", BROWN, pose_at(0, 0, 90))
    R = sensor.pose.R_enu_from_cam @ R_turned_from_sensor(degrees).T
    turned = replace(
        sensor, camera=BROWN.turned(degrees), pose=replace(sensor.pose, R_enu_from_cam=R)
    )
    ground = np.array([[3.0, 8.0, 1.0], [-20.0, 11.0, 0.0], [25.0, -9.0, 2.0]])
    seen = turned.project(ground)
    assert np.all(np.isfinite(seen))
    back = uv_in_sensor(seen, BROWN.width, BROWN.height, degrees)
    np.testing.assert_allclose(back, sensor.project(ground), atol=1e-6)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_views_of_sensors_lead_back_to_the_stored_photo(degrees: int) -> None:
    stored = oriented("a", BROWN.turned(degrees), pose_at(4, -3, 80))
    views = sensor_views([stored], {"c": BROWN}, {"a": degrees})
    view = views.photos[0]
    assert view.camera == BROWN
    ground = np.array([[3.0, 8.0, 1.0], [-20.0, 11.0, 0.0], [15.0, -9.0, 2.0]])
    np.testing.assert_allclose(views.uv(0, stored.project(ground)), view.project(ground), atol=1e-6)
    back = views.stored_pose(0, view.pose).R_enu_from_cam
    np.testing.assert_allclose(back, stored.pose.R_enu_from_cam, atol=1e-12)


@pytest.mark.parametrize("camera", [FISHEYE, PIX4D], ids=["fisheye", "Pix4D"])
@pytest.mark.parametrize("degrees", [0, 90])
def test_a_fisheye_is_adjusted_through_a_pinhole_of_its_rays(camera: Camera, degrees: int) -> None:
    """Rays of the pinhole are those of the lens to 1e-6; half a pixel of noise stays half."""
    photo = oriented("a", camera.turned(degrees), pose_at(0, 0, 50))
    views = sensor_views([photo], {camera.id: camera}, {"a": degrees})
    assert views.held == (camera.id,)
    pinhole = views.cameras[0]
    assert pinhole.model == "brown"
    width, height = photo.camera.width, photo.camera.height
    # middle, and towards the corners
    uv = np.array([[0.5, 0.5], [0.55, 0.45], [0.2, 0.3], [0.9, 0.8]]) * [width, height]
    R = views.photos[0].pose.R_enu_from_cam
    np.testing.assert_allclose(pinhole.ray(views.uv(0, uv)) @ R.T, photo.ray(uv), atol=1e-6)
    ties = TiePoints(
        photo_ids=("a", "b"), photo=np.zeros(4, np.int32), point=np.arange(4, dtype=np.int32),
        uv=uv, sigma=np.full(4, 0.5),
    )  # fmt: skip
    found = views.observations(ties).sigma
    area = []
    for place in uv:
        J = [
            (views.uv(0, (place + d)[None]) - views.uv(0, (place - d)[None]))[0] for d in np.eye(2)
        ]
        area.append(0.5 * np.sqrt(abs(np.linalg.det(J)) / 4.0))
    np.testing.assert_allclose(found, area, rtol=0.05)


def test_points_start_where_the_rays_meet_the_ground() -> None:
    """Within the navigation's error at 90 m: some decimetres and 0.2 deg."""
    flight = sim.strip(3, 4, relief=0.1)
    ground = FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)
    first = first_places(block_of(flight), ground)
    assert np.abs(first - flight.points).max() < 12.0
    assert np.median(np.linalg.norm(first - flight.points, axis=1)) < 4.0


def test_photos_that_look_at_the_sky_are_told() -> None:
    flight = sim.two_photos(1)
    block = block_of(flight)
    up = [replace(p, R_enu_from_cam=np.diag([1.0, -1, -1]) @ p.R_enu_from_cam) for p in block.poses]
    ground = FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)
    with pytest.raises(AdjustmentError, match="no photo looks at the ground"):
        first_places(replace(block, poses=tuple(up)), ground)


# -- priors ------------------------------------------------------------------------------------


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


# -- adjust ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_noise_twice_as_stated_is_found_and_its_sigmas_raised() -> None:
    """sigma0 is 2 within 10 %, 1 within 10 % where it is as stated."""
    flight = sim.survey(11, 3, 5, noise_px=1.0)
    block = block_of(flight)
    told = replace(block, ties=replace(block.ties, sigma=0.5 * block.ties.sigma))
    wrong, right = adjusted(flight, told), adjusted(flight, block)
    assert wrong.sigma0 == pytest.approx(2.0, rel=0.1)
    assert right.sigma0 == pytest.approx(1.0, rel=0.1)
    np.testing.assert_allclose(sigmas(wrong), sigmas(right), rtol=0.15)


@pytest.mark.slow
def test_fifteen_percent_of_wrong_matches_go_and_hardly_anything_else() -> None:
    flight = sim.survey(12, 3, 5, outliers=0.15)
    answer = adjusted(flight)
    kept = {(i, *uv) for i, uv in zip(answer.block.ties.photo, answer.block.ties.uv.tolist(),
                                      strict=True)}  # fmt: skip
    stays = np.array([
        (i, *uv) in kept for i, uv in zip(flight.photo, flight.uv.tolist(), strict=True)
    ])  # fmt: skip
    assert np.mean(stays[flight.outlier]) < 0.06
    # a good observation also goes where the other ones of its point are wrong
    assert np.mean(~stays[~flight.outlier]) < 0.06
    assert answer.sigma0 == pytest.approx(1.0, rel=0.1)
    assert np.sqrt(np.mean((errors(flight, answer) / sigmas(answer)) ** 2)) < 2.0


def with_tags(flight: sim.SimFlight, off: dict[int, Array]) -> Block:
    """Block of a flight whose navigation is off by (dp, dtheta) at some photos."""
    block = block_of(flight)
    poses = list(block.poses)
    for i, d in off.items():
        poses[i] = replace(
            poses[i],
            origin_enu=poses[i].origin_enu + d[:3],
            R_enu_from_cam=exp_so3(d[3:]) @ poses[i].R_enu_from_cam,
        )
    return replace(block, poses=tuple(poses))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tags", "RTK"])
def test_heights_of_a_few_photos_100_m_off_do_not_tilt_the_block(kind: str) -> None:
    flight = {"tags": sim.gps_only, "RTK": sim.rtk}[kind](13, 3, 6)
    off = np.array([0, 0, 100.0, 0, 0, 0])
    block = with_tags(flight, dict.fromkeys((0, 1, 12), off))
    answer, good = adjusted(flight, block), adjusted(flight)
    assert {(d.photo, d.component) for d in answer.doubted} >= {(0, 2), (1, 2), (12, 2)}
    shift = (errors(flight, answer) - errors(flight, good)) / sigmas(good)
    assert np.abs(shift).max() < 1.5, np.abs(shift).max(axis=0)
    assert all(c.passed for c in plausibility(answer, None)), plausibility(answer, None)


PLACES = {
    "one": {7: [300.0, -100, 0]},
    "one at the rim": {0: [-60.0, 40, 0]},
    "three, two of them neighbours": {3: [80.0, 0, 0], 4: [80.0, 0, 0], 12: [0, -2000.0, 0]},
}


@pytest.mark.slow
@pytest.mark.parametrize("places", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("seed", [14, 15, 18])
def test_wrong_places_neither_move_the_block_nor_have_it_refused(
    seed: int, places: dict[int, list[float]]
) -> None:
    flight = sim.gps_only(seed, 3, 6)
    off = {i: np.array([*d, 0.0, 0.0, 0.0]) for i, d in places.items()}
    answer = adjusted(flight, with_tags(flight, off))
    assert {d.photo for d in answer.doubted} >= set(places)
    assert answer.solution.converged
    assert np.abs(errors(flight, answer) / sigmas(answer)).max() < 4.5
    failed = [c.told() for c in plausibility(answer, None) if not c.passed]
    assert not failed


@pytest.mark.slow
def test_a_heading_that_is_turned_is_weighed_down() -> None:
    flight = sim.gps_only(15, 3, 6)
    answer = adjusted(flight, with_tags(flight, {4: np.array([0, 0, 0, 0, 0, np.radians(60)])}))
    assert (4, 5) in {(d.photo, d.component) for d in answer.doubted}
    assert np.abs(errors(flight, answer) / sigmas(answer)).max() < 4.5


@pytest.mark.slow
def test_two_blocks_without_common_points_share_what_their_flight_learns() -> None:
    """Boresight and clock of a block are worth to the other what they are worth to its own."""
    whole = sim.survey(16, 4, 6, navigation=sim.TIGHT_SLOW)
    block = block_of(whole)
    first = block.ties.photo < 12
    rays = np.stack([
        np.bincount(block.ties.point[side], minlength=block.ties.n_points)
        for side in (first, ~first)
    ])  # fmt: skip
    inside = np.where(rays[0] >= rays[1], 0, 1)[block.ties.point] == np.where(first, 0, 1)
    parted = replace(block, ties=block.ties.selected(inside))
    side = block.ties.selected(inside & first)
    alone = replace(block, ties=side)
    both, one = (adjust(b, np.zeros((b.ties.n_points, 3))) for b in (parted, alone))
    assert np.all(both.rms_by_photo()[1] > 0)
    assert np.sqrt(np.mean((errors(whole, both) / sigmas(both)) ** 2)) < 1.8
    # the second block's photos in an adjustment of the first: better than nothing, and told
    assert np.all(one.rms_by_photo()[1][12:] == 0)
    direct = np.sqrt([np.diag(p.covariance) for p in block.poses])[12:]
    learned = sigmas(one)[12:]
    assert np.median(learned[:, 3] / direct[:, 3]) < 0.6
    assert np.sqrt(np.mean((errors(whole, one)[12:] / learned) ** 2)) < 1.8
    assert np.all(np.median(sigmas(both)[12:], axis=0) < np.median(learned, axis=0))


@pytest.mark.slow
def test_a_photo_without_ties_takes_the_bias_and_the_boresight_of_its_flight() -> None:
    """Control shows the bias: the lone photo's place and angles are corrected by it."""
    made = []
    for seed in range(17, 23):
        flight = sim.rtk(seed, 3, 5, control=5, sigmas=sim.shared_sigmas(3.0, 0.02, 3.0, 0.005))
        block = block_of(flight, control=control_input((flight.control, True)))
        ties = block.ties.selected(block.ties.photo != 7)
        control = without_marks(block.control, 7)
        answer = adjusted(flight, replace(block, ties=ties, control=control))
        assert answer.rms_by_photo()[1][7] == 0
        e, s = errors(flight, answer)[7], sigmas(answer)[7]
        before = np.sqrt(np.diag(block.poses[7].covariance))
        assert np.all(s[:3] < 0.1 * before[:3])
        assert np.all(s[3:] < 0.9 * before[3:])
        made.append((e / s)[None])
    assert np.all(rms(made) < 2.2)


def without_marks(control: ControlInput | None, photo: int) -> ControlInput:
    assert control is not None
    keep = control.photo != photo
    return replace(
        control, photo=control.photo[keep], point=control.point[keep], uv=control.uv[keep],
        sigma_px=control.sigma_px[keep],
    )  # fmt: skip


@pytest.mark.slow
def test_readout_time_is_found_where_speeds_differ() -> None:
    """20 ms, one sigma 5 ms; with and against the wind and across: within 3 of its sigmas."""
    flights = [
        sim.calibration_flight(seed, readout_s=0.02, obs_per_photo=60.0) for seed in (31, 32, 33)
    ]
    found = []
    for flight in flights:
        block = block_of(flight)
        # a lens that states none: the prior is at zero
        camera = block.cameras[0]
        blank = replace(camera, camera=replace(camera.camera, readout_s=0.0))
        blank.sigma[10] = 0.03
        answer = adjusted(flight, replace(block, cameras=(blank,)))
        sigma = np.sqrt(answer.covariances.shared()[10, 10])
        assert sigma < 0.004
        found.append((answer.cameras[0].readout_s - flight.camera_true.readout_s) / sigma)
    assert np.abs(found).max() < 3.5, found


@pytest.mark.slow
def test_boresight_lever_arm_and_clock_are_found_within_their_sigmas() -> None:
    made = []
    for seed in range(41, 45):
        flight = sim.calibration_flight(seed, obs_per_photo=60.0)
        answer = adjusted(flight)
        values, covariance = answer.flight(0)
        t, s = flight.shared_true, flight.shared
        true = np.concatenate(
            [t.lever - s.lever, t.boresight - s.boresight, s.bias - t.bias, [s.clock - t.clock]]
        )
        made.append(((true - values) / np.sqrt(np.diag(covariance)))[None])
        assert np.degrees(np.sqrt(np.diag(covariance))[3:6]).max() < 0.06
    assert np.all(rms(made) < 2.2), rms(made)


def test_a_block_of_photos_without_any_tie_point_stays_where_it_is() -> None:
    flight = sim.strip(18, 3)
    block = block_of(flight)
    nothing = block.ties.selected(np.zeros(len(block.ties.photo), bool))
    answer = adjust(replace(block, ties=nothing), np.zeros((0, 3)))
    for old, new in zip(block.poses, answer.poses, strict=True):
        np.testing.assert_allclose(new.origin_enu, old.origin_enu, atol=1e-9)
        # floor of the prior: 0.1 mm and 1e-6 rad
        np.testing.assert_allclose(new.covariance, old.covariance, rtol=2e-2, atol=1e-4)


# -- covariances --------------------------------------------------------------------------------


@pytest.mark.slow
def test_joint_covariances_are_those_of_300_drawn_blocks() -> None:
    """Errors of a hundredth of their sigmas, so that all is linear; with control and level."""
    flight = sim.strip(19, 3, obs_per_photo=15.0, control=3)
    made = _TrueBlock(flight)
    asked = {"photos": [0, 2], "shared": [0, 16, 20], "points": [1, made.n_ties - 1, made.n_ties]}
    rng = np.random.default_rng(1)
    drawn = np.array([made.draw(rng, asked) for _ in range(300)])
    problem = Problem(made.block, made.points)
    joint = Covariances(problem, problem.start, 0.0).joint(**asked)
    z = np.linalg.solve(np.linalg.cholesky(joint), drawn.T)
    found = z @ z.T / 300
    # one sigma of a covariance of 300 is 0.058 off the diagonal and 0.082 on it
    assert np.abs(found - np.eye(len(found))).max() < 0.35


class _TrueBlock:
    """A block at its truth, whose observations and priors are drawn anew, a hundredth as far."""

    SHARE = 0.01

    def __init__(self, flight: sim.SimFlight) -> None:
        photos = sim.oriented_photos(flight, true=True)
        rough = block_of(flight, control=control_input((flight.control, True)), sigma_level=2.0)
        truth = [replace(photo.pose, covariance=rough.poses[0].covariance) for photo in photos]
        camera = replace(rough.cameras[0], camera=photos[0].camera)
        prior = flight_prior(flight, photos)
        self.n_ties = rough.ties.n_points
        self.points = np.vstack([flight.points, flight.control.p_true])
        ties = rough.ties
        uv = np.zeros_like(ties.uv)
        marks = np.zeros_like(rough.control.uv)
        for i, photo in enumerate(photos):
            mine, own = ties.photo == i, rough.control.photo == i
            uv[mine] = photo.project(flight.points[ties.point[mine]])
            marks[own] = photo.project(flight.control.p_true[rough.control.point[own]])
        control = replace(rough.control, uv=marks, p_enu=flight.control.p_true)
        self.block = replace(
            rough, poses=tuple(truth), cameras=(camera,), ties=replace(ties, uv=uv),
            control=control, flights=(prior,),
        )  # fmt: skip
        self.half = np.linalg.cholesky(prior.covariance + 1e-14 * np.eye(len(prior.covariance)))

    def draw(self, rng: np.random.Generator, asked: dict[str, list[int]]) -> Array:
        """Errors of the answer over SHARE, in the order of `Covariances.joint`."""
        block, share = self.block, self.SHARE
        prior, camera = block.flights[0], block.cameras[0]
        shared = np.sqrt(np.diag(prior.shared_covariance)) * rng.normal(size=10) * share
        lens = camera.sigma * rng.normal(size=11) * share
        level = block.sigma_level * rng.normal() * share
        own = share * (self.half @ rng.normal(size=len(self.half))).reshape(-1, 6)
        R, n = prior.R_enu_from_body, len(own)
        own[:, :3] += R @ shared[:3] + shared[6:9] + prior.velocity_enu * shared[9]
        own[:, 3:] += R @ shared[3:6] + prior.rate_enu * shared[9]
        poses = tuple(
            replace(
                p, origin_enu=p.origin_enu - own[i, :3] - [0, 0, level],
                R_enu_from_cam=exp_so3(-own[i, 3:]) @ p.R_enu_from_cam,
            )
            for i, p in enumerate(block.poses)
        )  # fmt: skip
        values = camera.camera.parameters.copy()
        values[:2] -= lens[0]
        values[2:] -= lens[1:10]
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
        off = replace(
            camera.camera, readout_s=camera.camera.readout_s - lens[10],
            **dict(zip(names, values.tolist(), strict=True)),
        )  # fmt: skip
        ties, control = block.ties, block.control
        noise = share * ties.sigma[:, None] * rng.normal(size=ties.uv.shape)
        marked = share * control.sigma_px[:, None] * rng.normal(size=control.uv.shape)
        survey = share * control.sigma * rng.normal(size=control.p_enu.shape)
        spoilt = replace(
            block, poses=poses, cameras=(replace(camera, camera=off),),
            ties=replace(ties, uv=ties.uv + noise),
            control=replace(control, uv=control.uv + marked, p_enu=control.p_enu + survey),
        )  # fmt: skip
        problem = Problem(spoilt, self.points - [0, 0, level])
        state = solve(problem, problem.start, robust=False, gain=1e-9).state
        up = np.array([0.0, 0.0, state.level])
        out = []
        for i in asked["photos"]:
            out += [block.poses[i].origin_enu - state.origin[i] - up,
                    log_so3(block.poses[i].R_enu_from_cam @ state.rotation[i].T)]  # fmt: skip
        true = np.concatenate([lens, shared])
        out.append(true[asked["shared"]] - problem.shared_vector(state)[asked["shared"]])
        out += [self.points[j] - state.points[j] - up for j in asked["points"]]
        assert n == len(block.poses)
        return np.concatenate(out) / share


# -- checks ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def believed() -> tuple[Adjusted, FlatTerrain]:
    flight = sim.survey(21, 3, 5, relief=1.0)
    return adjusted(flight), FlatTerrain(origin=ORIGIN, height_ellipsoidal=0.0, sigma=1.0)


def failed(checks: list[Check]) -> list[str]:
    return [check.name for check in checks if not check.passed]


def moved(answer: Adjusted, about: Array, turn: Array, scale: float, up: float) -> Adjusted:
    """The whole block turned about a place (rad), scaled and lifted; pixels still fit."""
    R = exp_so3(turn)

    def there(p: Array) -> Array:
        return np.asarray(about + scale * (p - about) @ R.T + [0, 0, up])

    state = replace(
        answer.solution.state, origin=there(answer.solution.state.origin),
        rotation=R @ answer.solution.state.rotation, points=there(answer.solution.state.points),
    )  # fmt: skip
    poses = tuple(
        replace(p, origin_enu=there(p.origin_enu), R_enu_from_cam=R @ p.R_enu_from_cam)
        for p in answer.poses
    )
    return replace(
        answer, solution=replace(answer.solution, state=state), poses=poses,
        points=replace(answer.points, p_enu=there(answer.points.p_enu)),
    )  # fmt: skip


def test_a_good_adjustment_passes_all_checks(believed: tuple[Adjusted, FlatTerrain]) -> None:
    checks = plausibility(*believed)
    assert len(checks) == 5
    assert failed(checks) == []
    assert all("agrees" in check.told() for check in checks)


def test_a_focal_length_of_30_percent_more_is_refused(
    believed: tuple[Adjusted, FlatTerrain],
) -> None:
    answer, ground = believed
    camera = answer.cameras[0]
    long = replace(answer, cameras=(replace(camera, fx=1.3 * camera.fx),))
    (name,) = failed(plausibility(long, ground))
    assert name.startswith("focal length")


@pytest.mark.parametrize(
    ("turn", "scale", "word"),
    [((0.0, 0.0, 0.0), 0.7, "scale"), ((np.radians(40), 0.0, 0.0), 1.0, "turn"),
     ((0.0, 0.0, np.radians(180)), 1.0, "turn")],
)  # fmt: skip
def test_a_block_that_shrank_tilted_or_turned_is_refused(
    believed: tuple[Adjusted, FlatTerrain], turn: tuple[float, ...], scale: float, word: str
) -> None:
    answer, ground = believed
    about = np.mean([p.origin_enu for p in answer.poses], axis=0)
    names = failed(plausibility(moved(answer, about, np.array(turn), scale, 0.0), ground))
    assert any(name.startswith(word) for name in names), names


@pytest.mark.parametrize("share", [-0.3, 0.3])
def test_a_height_above_ground_a_third_off_is_refused_or_the_ground_is(
    believed: tuple[Adjusted, FlatTerrain], share: float
) -> None:
    """Cameras at another height over the same points; 5 % of relief are allowed for.

    Where focal length and scale are right, the block has its size, and the ground is what is off.
    """
    answer, ground = believed
    poses = tuple(replace(p, origin_enu=p.origin_enu * [1, 1, 1 + share]) for p in answer.poses)
    off = replace(answer, poses=poses)
    check = next(c for c in plausibility(off, ground) if c.name == "height above ground")
    assert check.passed
    assert "[ground] dem" in check.remark
    cameras = tuple(replace(c, fx=1.1 * c.fx) for c in off.cameras)
    assert "height above ground" in failed(plausibility(replace(off, cameras=cameras), ground))


def test_mostly_wrong_matches_are_refused(believed: tuple[Adjusted, FlatTerrain]) -> None:
    answer, ground = believed
    many = np.full(len(answer.poses), 2 * len(answer.problem.ties.photo) // len(answer.poses))
    names = failed(plausibility(replace(answer, removed=many), ground))
    assert names == ["share of wrong matches"]


def test_what_one_height_and_speed_cannot_tell_apart_is_said() -> None:
    """Lever arm and clock of a single strip: the prior holds or they are told as a pair."""
    answer = adjusted(sim.strip(22))
    told = observability(answer)
    names = {u.name: u for u in told.unknowns}
    assert names["flight lever_x"].held
    assert told.condition > 10.0
    assert any("prior holds" in line and "flight lever_x" in line for line in told.told())
    assert np.allclose(np.diag(told.correlation), 1.0)
    assert "sim f" in names
    assert names["flight clock"].unit == "s"


# -- keep --------------------------------------------------------------------------------------


def test_points_and_ties_come_back_as_they_were_kept(tmp_path: Path) -> None:
    answer = adjusted(sim.two_photos(23))
    files = save_adjusted(tmp_path, answer)
    assert set(files) == {path.name for path in tmp_path.iterdir()}
    points = load_points(files[POINTS])
    np.testing.assert_array_equal(points.p_enu, answer.points.p_enu)
    np.testing.assert_allclose(points.covariance, answer.points.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(points.rays, answer.points.rays)
    save_ties(tmp_path / "ties.npz", answer.block.ties)
    ties = load_ties(tmp_path / "ties.npz")
    assert ties.photo_ids == answer.block.ties.photo_ids
    for name in ("photo", "point", "uv", "sigma"):
        np.testing.assert_array_equal(getattr(ties, name), getattr(answer.block.ties, name))


def spoilt_ties(path: Path, ties: TiePoints, how: str) -> None:
    columns = {
        "photo_ids": list(ties.photo_ids), "photo": ties.photo, "point": ties.point,
        "uv": ties.uv, "sigma": ties.sigma,
    }  # fmt: skip
    from georef_gis.project.columns_file import write_columns

    if how == "without uv":
        del columns["uv"]
    elif how == "NaN":
        columns["uv"] = np.full_like(ties.uv, np.nan)
    elif how == "photo that is not there":
        columns["photo"] = ties.photo + 7
    write_columns(path, "tie points", columns)
    if how == "cut off":
        path.write_bytes(path.read_bytes()[:-200])
    elif how == "empty":
        path.write_bytes(b"")


@pytest.mark.parametrize(
    "how", ["without uv", "NaN", "photo that is not there", "cut off", "empty"]
)
def test_broken_tie_points_are_told_with_their_file(tmp_path: Path, how: str) -> None:
    path = tmp_path / "ties.npz"
    spoilt_ties(path, sim.ties(sim.two_photos(24)), how)
    with pytest.raises(InputError, match=r"ties\.npz"):
        load_ties(path)


# -- ground prior --------------------------------------------------------------------------------


def test_heights_of_the_ground_count_as_ten_however_many_points_there_are() -> None:
    flight = sim.strip(25, 3, obs_per_photo=40.0)
    block = block_of(flight)
    z = np.zeros(block.ties.n_points)
    block = replace(block, ground=GroundPrior(z_enu=z, sigma=2.0, independent=10.0))
    information = Problem(block, first_points(flight, block)).information
    assert information[:, 2].sum() == pytest.approx(10.0 / 2.0**2)
    assert not np.any(information[:, :2])


def test_solution_does_not_hang_on_who_counts_first() -> None:
    """The same photos in another order give the same poses, to a hundredth of a sigma."""
    flight = sim.strip(26, 4)
    block = block_of(flight)
    order = np.array([2, 0, 3, 1])
    back = np.argsort(order)
    t = block.ties
    mixed = Block(
        photo_ids=tuple(block.photo_ids[i] for i in order),
        poses=tuple(block.poses[i] for i in order),
        camera_of=block.camera_of[order],
        cameras=block.cameras,
        flights=(replace(block.flights[0], photos=back),),
        ties=replace(
            t, photo=back[t.photo].astype(np.int32),
            photo_ids=tuple(block.photo_ids[i] for i in order),
        ),
    )  # fmt: skip
    first = first_points(flight, block)
    a, b = adjust(block, first), adjust(mixed, first)
    for i in range(4):
        off = a.poses[i].origin_enu - b.poses[back[i]].origin_enu
        assert np.abs(off / np.sqrt(np.diag(a.poses[i].covariance))[:3]).max() < 0.02


def test_the_judge_of_these_tests_sees_an_error() -> None:
    """A flight judged against another's truth is far off."""
    flight = sim.two_photos(27)
    moved_truth = replace(flight.truth, p_cam=flight.truth.p_cam + np.array([0.0, 3.0, 0.0]))
    assert np.abs(judge(replace(flight, truth=moved_truth), block_of(flight)).poses).max() > 5.0
