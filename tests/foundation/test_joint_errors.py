"""Covariances of poses and cameras together: of matrices, chains, tags, and blocks by a law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.frames import Array, exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.joint_errors import CameraErrors, JointErrors, PoseSource
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose import Pose
from georef_gis.model.pose_errors import (
    AlikeErrors,
    ChainErrors,
    DenseErrors,
    LoneErrors,
    PoseErrors,
    TagErrors,
    TagFlights,
    roots_of,
)
from georef_gis.model.trajectory import StateChain

N = 8
CAMERA = Camera(
    id="c", width=1200, height=800, fx=900.0, fy=900.0, cx=599.5, cy=399.5, sigma_f=5.0,
    sigma_c=2.0,
)  # fmt: skip


def spd(rng: np.random.Generator, k: int, scale: Array | float = 1.0) -> Array:
    root = rng.normal(size=(k, k)) * np.broadcast_to(scale, (k,))[:, None]
    return np.asarray(root @ root.T)


def strip(seed: int = 0, n: int = N, **pose: object) -> PhotoStack:
    """Photos 15 m and 1.5 s apart, each with a covariance of its own."""
    rng = np.random.default_rng(seed)
    photos = []
    for i in range(n):
        C = spd(rng, 6, np.array([1.0, 1.0, 1.5, 0.02, 0.02, 0.05]))
        R = exp_so3(0.1 * rng.normal(size=3)) @ exp_so3([0, 0, 0.7]) @ np.diag([1.0, -1.0, -1.0])
        one = Pose(
            origin_enu=np.array([15.0 * i, 2.0 * (i % 2), 60.0]), R_enu_from_cam=R, covariance=C,
            **pose,  # type: ignore[arg-type]
        )  # fmt: skip
        photo = Photo(id=f"p{i}", path=Path(f"p{i}"), width=1200, height=800, time_gps=1.5 * i)
        photos.append(OrientedPhoto(photo=photo, camera=CAMERA, pose=one))
    return PhotoStack.of(photos)


def whole(errors: PoseErrors, n: int = N) -> Array:
    a, b = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    out = errors.pairs(a, b).reshape(n, n, 6, 6)
    return np.asarray(np.swapaxes(out, 1, 2).reshape(6 * n, 6 * n))


def chain_errors(rng: np.random.Generator, n: int = N) -> ChainErrors:
    """A stationary chain of nine states."""
    P, gain = spd(rng, 9), 0.9 * np.eye(9)
    return ChainErrors(
        StateChain(time=np.arange(n, dtype=float), covariance=np.array([P] * n),
                   gain=np.array([gain] * (n - 1))),
        np.array([np.eye(6)] * n), np.array([rng.normal(size=(6, 9)) for _ in range(n)]),
        0.1 * np.eye(9), np.array([0.5 * np.eye(6)] * n),
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["matrix", "chain", "tags", "alike", "alone"])
def test_every_law_gives_a_covariance(kind: str) -> None:
    rng, stack = np.random.default_rng(1), strip()
    every = np.arange(N)
    errors: dict[str, PoseErrors] = {
        "matrix": DenseErrors(matrix=spd(rng, 6 * N)),
        "chain": chain_errors(rng),
        "tags": TagErrors(stack, every),
        "alike": AlikeErrors.of(stack, every, length=100.0),
        "alone": LoneErrors(covariance=stack.covariance),
    }
    C = whole(errors[kind])
    np.testing.assert_allclose(C, C.T, atol=1e-9)
    scale = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / np.outer(scale, scale)).min() > -1e-9
    if kind in ("tags", "alike", "alone"):
        for i in range(N):
            block = C[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
            np.testing.assert_allclose(block, stack.covariance[i], atol=1e-9)


def test_roots_make_their_covariances_though_metres_and_radians_stand_apart() -> None:
    rng = np.random.default_rng(2)
    C = np.array([spd(rng, 6, np.array([3.0, 3, 3, 1e-6, 1e-6, 1e-6])) for _ in range(5)])
    G = roots_of(C)
    np.testing.assert_allclose(G @ np.swapaxes(G, 1, 2), C, rtol=1e-9)
    # a sigma of zero is one
    C[:, 2] = C[:, :, 2] = 0.0
    G = roots_of(C)
    np.testing.assert_allclose(G @ np.swapaxes(G, 1, 2), C, atol=1e-15)


def test_tags_of_neighbours_err_alike_and_of_far_ones_share_the_flight() -> None:
    stack = strip(n=200)
    errors = TagErrors(stack, np.arange(200))
    sigma = np.sqrt(np.einsum("aii->ai", stack.covariance))

    def alike(a: int, b: int, c: int) -> float:
        (pair,) = errors.pairs(np.array([a]), np.array([b]))
        return float(pair[c, c] / sigma[a, c] / sigma[b, c])

    near = [alike(i, i + 1, 0) for i in range(50)]
    far = [alike(i, i + 150, 0) for i in range(50)]
    assert np.mean(near) > 0.4 > np.mean(far) > 0.0


def strip_of_unknown_datum() -> PhotoStack:
    """Of the variance of east and north, 4.01 m2, 4 are the datum's."""
    wide = np.diag([4.01, 4.01, 1.0, 1e-4, 1e-4, 1e-4])
    return PhotoStack.of(
        [replace(p, pose=replace(p.pose, covariance=wide)) for p in strip().photos]
    )


def test_a_datum_that_nobody_stated_is_the_same_for_all() -> None:
    stack = strip_of_unknown_datum()
    C = whole(TagErrors(stack, np.arange(N), sigma_datum=2.0))
    # the rest is each photo's or slow
    assert C[0::6, 0::6].min() > 4.0 - 1e-9
    assert C[2::6, 2::6].min() < 1.0


@pytest.mark.parametrize("datum", [2.0, 0.5])
def test_flights_by_tags_share_the_datum_and_nothing_else(datum: float) -> None:
    stack, tail = strip_of_unknown_datum(), N // 2
    parts = np.arange(N - tail), np.arange(N - tail, N)
    single = [TagErrors(stack, at, sigma_datum=datum) for at in parts]
    C = whole(TagFlights(single))
    for at, one in zip(parts, single, strict=True):
        rows = (6 * at[:, None] + np.arange(6)).ravel()
        np.testing.assert_array_equal(C[np.ix_(rows, rows)], whole(one, len(at)))
    across = C[: 6 * (N - tail), 6 * (N - tail) :].reshape(N - tail, 6, tail, 6)
    for c in (0, 1):
        np.testing.assert_allclose(across[:, c, :, c], datum**2, rtol=1e-12)
    assert not across[:, 2:, :, 2:].any()
    assert np.linalg.eigvalsh(C).min() > -1e-9


def test_a_long_chain_says_the_same_as_a_short_one(monkeypatch: pytest.MonkeyPatch) -> None:
    import georef_gis.model.pose_errors as module

    at_once = whole(chain_errors(np.random.default_rng(5)))
    monkeypatch.setattr(module, "_MOST_AT_ONCE", 2)
    pair_by_pair = whole(chain_errors(np.random.default_rng(5)))
    np.testing.assert_allclose(pair_by_pair, at_once, atol=1e-12)


# -- poses and cameras together -----------------------------------------------------------------


def joint_of_two_sources() -> tuple[JointErrors, Array, Array]:
    """Photos 0 to 3 by a matrix with their camera, 4 to 6 by another, 7 in none."""
    rng, stack = np.random.default_rng(3), strip()
    full = spd(rng, 6 * 4 + 11)
    across = np.zeros((N, 6, 11))
    across[:4] = full[:24, 24:].reshape(4, 6, 11)
    cameras = CameraErrors(
        ids=("c",), covariance=full[24:, 24:], sensor_of=np.zeros(N, dtype=np.int64),
        turns=np.zeros(N, dtype=np.int64), with_poses=across,
    )  # fmt: skip
    other = spd(rng, 18)
    sources = [
        # in an order of their own
        PoseSource(photos=np.array([2, 0, 1, 3]), errors=DenseErrors(matrix=_moved(full))),
        PoseSource(photos=np.array([4, 5, 6]), errors=DenseErrors(matrix=other)),
    ]
    return JointErrors(stack, sources, cameras), full, other


def _moved(full: Array) -> Array:
    rows = (6 * np.array([2, 0, 1, 3])[:, None] + np.arange(6)).ravel()
    return np.asarray(full[np.ix_(rows, rows)])


def test_joint_covariance_has_each_source_where_it_belongs() -> None:
    errors, full, other = joint_of_two_sources()
    C = errors.joint([1, 3, 5, 7])
    rows = np.r_[6:12, 18:24]
    np.testing.assert_array_equal(C[:12, :12], full[np.ix_(rows, rows)])
    np.testing.assert_array_equal(C[12:18, 12:18], other[6:12, 6:12])
    np.testing.assert_array_equal(C[18:24, 18:24], errors.stack.covariance[7])
    assert not C[:12, 12:24].any()
    np.testing.assert_array_equal(C[:12, 24:35], full[rows, 24:])
    np.testing.assert_array_equal(C[24:35, 24:35], full[24:, 24:])
    assert C[-1, -1] == 1.0
    assert not errors.known_together
    np.testing.assert_array_equal(
        errors.columns([1, 3]), np.r_[6:12, 18:24, 6 * N : 6 * N + 12]
    )  # fmt: skip
    assert errors.size == 6 * N + 12


def test_blocks_are_the_joint_covariances_of_their_photos() -> None:
    errors, _, _ = joint_of_two_sources()
    groups = np.array([[0, 2, 5], [7, 3, 1]])
    for group, block in zip(groups, errors.blocks(groups), strict=True):
        np.testing.assert_allclose(block, errors.joint(group)[:-1, :-1], atol=1e-12)


def test_two_sensors_keep_their_own_unknowns() -> None:
    base = strip()
    other = replace(CAMERA, id="d", fx=950.0, fy=950.0)
    stack = PhotoStack.of(
        [replace(p, camera=other) if i % 2 else p for i, p in enumerate(base.photos)]
    )
    errors = JointErrors(stack)
    assert errors.cameras.ids == ("c", "d")
    first = 6 * N
    np.testing.assert_array_equal(errors.camera_columns(np.arange(3)), first + np.array([0, 11, 0]))


def test_a_turned_picture_is_of_its_sensor() -> None:
    base = strip()
    sensor = replace(CAMERA, cx=612.0, cy=391.0, p1=1e-3)
    photos = [replace(p, camera=sensor) for p in base.photos]
    lying = sensor.turned(90)
    photos[3] = replace(photos[3], camera=lying)
    errors = JointErrors(PhotoStack.of(photos))
    assert errors.cameras.ids == ("c",)
    np.testing.assert_array_equal(errors.cameras.turns, [0, 0, 0, 1, 0, 0, 0, 0])
    moved = errors.by_sensor(np.array([3]), np.eye(11)[None])
    # the lying picture's cx is the sensor's cy, from the other side
    assert moved[0, 1, 2] == -1.0
    # where the first photo lies, the sensor is known by its own
    known = CameraErrors.stated(PhotoStack.of(photos[::-1]), {"c": sensor})
    assert known.turns.sum() == 1


def test_level_is_what_each_photo_says() -> None:
    stack = strip(sigma_height_shared=4.0)
    assert JointErrors(stack).level_sigma(np.array([1, 2])) == pytest.approx([4.0, 4.0])


def test_nadir_camera_axes_are_the_bodys() -> None:
    """Angles of tags hang together about the body's axes, whatever the heading."""
    base = strip(n=2)
    C = np.diag([1.0, 1, 1, 0.02**2, 0.02**2, 0.2**2])
    photos = []
    for p, yaw in zip(base.photos, (0.0, np.pi), strict=True):
        R = exp_so3([0, 0, yaw]) @ np.diag([1.0, -1.0, -1.0])
        photos.append(replace(p, pose=replace(p.pose, R_enu_from_cam=R, covariance=C)))
    errors = TagErrors(PhotoStack.of(photos), np.arange(2))
    (pair,) = errors.pairs(np.array([0]), np.array([1]))
    # a roll to the right is to the east one way and to the west the other
    assert pair[3, 3] < 0.0
    assert pair[4, 4] < 0.0
    assert pair[5, 5] > 0.0
