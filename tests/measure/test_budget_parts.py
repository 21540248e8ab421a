"""Covariances taken apart by source: of tags, of a trajectory, of an adjustment."""

from __future__ import annotations

from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.frames import Array, skew
from georef_gis.measure.budget.adjusted import (
    BlockSplit,
    Known,
    known_directly,
    position_and_angles,
    split,
)
from georef_gis.measure.budget.parts import (
    ChainSplit,
    FixedSplit,
    SourcedErrors,
    TagSplit,
    by_blocks,
)
from georef_gis.measure.budget.shares import point_budgets, remedies, signed_root, usual_budget
from georef_gis.measure.points import Mark, MeasuredPoints, intersect_points, locate_points
from georef_gis.model.joint_errors import JointErrors, PoseSource
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose_errors import ChainErrors, TagErrors
from georef_gis.model.trajectory import StateChain

EVERY = np.arange(3)


def spd(rng: np.random.Generator, n: int, scale: float = 1.0) -> Array:
    A = rng.standard_normal((n, n))
    return np.asarray(scale * (A @ A.T / n + 0.1 * np.eye(n)))


def with_covariance(covariances: Array) -> PhotoStack:
    photos = [
        replace(photo, pose=replace(photo.pose, covariance=c))
        for photo, c in zip(scenes.oriented(), covariances, strict=True)
    ]
    return PhotoStack.of(photos)


def assert_adds_up(errors: SourcedErrors) -> dict[str, Array]:
    parts = dict(errors.parts(EVERY))
    total = errors.errors.joint(EVERY)
    assert sum(parts.values()) == pytest.approx(total, rel=1e-9, abs=1e-12)
    return parts


# -- tags ----------------------------------------------------------------------------------------


def test_parts_of_tags_are_what_their_covariance_was_made_of() -> None:
    """The sum of a direct pose, by hand: receiver, datum, angles, boresight, lever arm."""
    lever = np.array([0.4, -0.2, 0.3])
    gnss, datum, tilt, yaw, boresight, arm = 2.2, 2.0, 0.03, 0.08, 0.01, 0.05
    G = np.vstack([-skew(lever), np.eye(3)])
    theta = np.diag([tilt**2, tilt**2, yaw**2])
    made = {
        "gnss": np.diag([gnss**2, gnss**2, 1.0, 0, 0, 0]),
        "datum": np.diag([datum**2, datum**2, 0, 0, 0, 0]),
        "attitude": G @ theta @ G.T,
        "boresight": boresight**2 * G @ G.T,
        "lever_arm": np.diag([arm**2] * 3 + [0.0] * 3),
    }
    stack = with_covariance(np.array([sum(made.values())] * 3))
    law = TagErrors(stack, EVERY, sigma_datum=datum)
    errors = JointErrors(stack, [PoseSource(photos=EVERY, errors=law)])
    tags = TagSplit(
        errors=errors, levers=np.array([lever] * 3), sigma_boresight=boresight,
        sigma_lever_arm=arm, sigma_datum=datum,
    )  # fmt: skip
    parts = assert_adds_up(SourcedErrors(errors=errors, kinds=np.zeros(3, int), splits=(tags,)))
    for source, expected in made.items():
        assert parts[source][:6, :6] == pytest.approx(expected, abs=1e-9), source
    # the same datum, boresight and lever arm in both photos; the receiver's error only in part
    assert parts["datum"][:2, 6:8] == pytest.approx(np.eye(2) * datum**2, abs=1e-9)
    assert parts["boresight"][3:6, 9:12] == pytest.approx(np.eye(3) * boresight**2, abs=1e-9)
    assert 0.0 < parts["gnss"][0, 6] < gnss**2


def test_a_mount_that_is_less_sure_than_the_angles_leaves_nothing_negative() -> None:
    stack = with_covariance(np.array([np.diag([1.0, 1, 1, 1e-4, 1e-4, 4e-4])] * 3))
    errors = JointErrors(stack)
    tags = TagSplit(
        errors=errors, levers=np.zeros((3, 3)), sigma_boresight=0.5, sigma_lever_arm=3.0,
        sigma_datum=5.0,
    )  # fmt: skip
    parts = assert_adds_up(SourcedErrors(errors=errors, kinds=np.zeros(3, int), splits=(tags,)))
    for source, part in parts.items():
        assert np.linalg.eigvalsh(part)[0] > -1e-9, source


# -- trajectory ----------------------------------------------------------------------------------


@pytest.fixture
def exposures() -> dict[str, Array]:
    rng = np.random.default_rng(3)
    n = 3
    covariance = np.array([spd(rng, 9, 0.01) for _ in range(n)])
    to_pose = np.tile(np.eye(6), (n, 1, 1))
    to_pose[:, :3, 3:] = 0.2 * rng.standard_normal((n, 3, 3))
    mount = np.zeros((n, 6, 9))
    mount[:, :3, :3] = mount[:, 3:, 3:6] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    mount[:, :3, 6:] = np.eye(3)
    moved = rng.standard_normal((n, 6))
    return {
        "ids": np.array(scenes.IDS), "time": np.arange(3.0), "covariance": covariance,
        "gain": 0.8 * np.tile(np.eye(9), (n, 1, 1)), "to_pose": to_pose, "mount": mount,
        "mount_covariance": np.diag([0.01**2] * 3 + [0.002**2] * 3 + [1.5**2, 1.5**2, 0.0]),
        "own": 1e-4 * moved[:, :, None] * moved[:, None, :],
    }  # fmt: skip


def chain_errors(exposures: dict[str, Array]) -> JointErrors:
    names = ("to_pose", "mount", "mount_covariance", "own")
    chain = StateChain(
        time=exposures["time"], covariance=exposures["covariance"], gain=exposures["gain"]
    )
    law = ChainErrors(chain, *(exposures[name] for name in names))
    return JointErrors(PhotoStack.of(scenes.oriented()), [PoseSource(photos=EVERY, errors=law)])


def test_parts_of_a_trajectory_add_to_its_joint_covariance(exposures: dict[str, Array]) -> None:
    errors = chain_errors(exposures)
    chain = ChainSplit.of(exposures, errors)
    parts = assert_adds_up(SourcedErrors(errors=errors, kinds=np.zeros(3, int), splits=(chain,)))
    assert np.allclose(chain.scale, 1.0)
    # the datum is the same in all photos, time each one's own
    assert parts["datum"][0, 6] == pytest.approx(1.5**2)
    assert parts["time"][:6, 6:12] == pytest.approx(np.zeros((6, 6)))
    assert parts["time"][:6, :6] == pytest.approx(exposures["own"][0])
    assert "coupling" in parts


def test_angles_that_a_gimbal_holds_are_the_attitudes(exposures: dict[str, Array]) -> None:
    exposures["mount"][:, 3:, 3:6] = 0.0
    exposures["own"][:, 3:, :3] = exposures["own"][:, :3, 3:] = 0.0
    errors = chain_errors(exposures)
    chain = ChainSplit.of(exposures, errors)
    parts = assert_adds_up(SourcedErrors(errors=errors, kinds=np.zeros(3, int), splits=(chain,)))
    assert not np.any(parts["time"][3:6, 3:6])
    assert np.trace(parts["attitude"][3:6, 3:6]) > np.trace(exposures["own"][0, 3:, 3:])


def test_blocks_and_their_coupling() -> None:
    C = np.array([[4.0, 1.0], [1.0, 9.0]])
    J = np.array([[1.0, 1.0]])
    parts = by_blocks(C, ("gnss", "attitude"), J)
    assert {name: float(part[0, 0]) for name, part in parts.items()} == {
        "gnss": 4.0, "attitude": 9.0, "coupling": 2.0,
    }  # fmt: skip
    assert signed_root([-4.0, 9.0]) == pytest.approx([-2.0, 3.0])


# -- adjustment ----------------------------------------------------------------------------------


def linear_network() -> tuple[Array, list[Known], dict[str, tuple[Array, Array]]]:
    """Covariance of a small network, its priors as groups, and (design, noise) of every group."""
    rng = np.random.default_rng(9)
    n = 14
    design = {
        "poses": (np.eye(n)[:12] + 0.05 * rng.standard_normal((12, n)), spd(rng, 12)),
        "camera": (np.eye(n)[12:13], np.array([[0.5]])),
        "level": (np.eye(n)[13:14], np.array([[2.0]])),
        "pixels": (rng.standard_normal((20, n)), 0.3 * np.eye(20)),
    }
    normal = sum(A.T @ np.linalg.inv(S) @ A for A, S in design.values())
    C = np.linalg.inv(normal)
    A, S = design["poses"]
    known = [
        Known(gain=np.linalg.inv(S) @ A @ C, by_source=position_and_angles(S)),
        known_directly(C, np.array([12]), design["camera"][1], ["calibration"]),
        known_directly(C, np.array([13]), design["level"][1], ["level"]),
    ]
    return C, known, design


def test_groups_of_an_adjustment_add_to_its_covariance() -> None:
    C, known, design = linear_network()
    parts = split(C, known, n_photos=2, with_level=False)
    assert sum(parts.values()) == pytest.approx(C, abs=1e-12)
    A, S = design["pixels"]
    K = C @ A.T @ np.linalg.inv(S)
    # by subtraction it is what the pixels give by themselves
    assert parts["matching"] == pytest.approx(K @ S @ K.T, abs=1e-10)


def test_each_group_is_what_draws_of_its_noise_give() -> None:
    C, known, design = linear_network()
    parts = split(C, known, n_photos=2, with_level=False)
    rng = np.random.default_rng(2)
    A, S = design["poses"]
    noise = position_and_angles(S)["gnss"]
    K = C @ A.T @ np.linalg.inv(S)
    drawn = rng.multivariate_normal(np.zeros(12), noise, size=20000) @ K.T
    # 20 000 draws: half a per cent of a standard deviation, four of them
    assert drawn.std(axis=0) == pytest.approx(np.sqrt(np.diag(parts["gnss"])), rel=0.02)


def test_heights_take_the_level_that_control_gave() -> None:
    C, known, _ = linear_network()
    lifted = np.eye(14)
    lifted[[2, 8], 13] = 1.0
    parts = split(C, known, n_photos=2, with_level=True)
    assert sum(parts.values()) == pytest.approx(lifted @ C @ lifted.T, abs=1e-12)
    assert parts["level"][2, 2] > split(C, known, n_photos=2, with_level=False)["level"][2, 2]


def test_unknowns_that_were_not_adjusted_have_no_part() -> None:
    block = BlockSplit(by_source={"gnss": np.eye(6)}, rows=np.array([3, -1, 5]))
    assert block.parts(EVERY)["gnss"] == pytest.approx(np.diag([1.0, 0.0, 1.0]))


# -- measured points -----------------------------------------------------------------------------


def test_budgets_of_measured_points_add_to_their_covariance() -> None:
    """One by the ground, one by three photos, with poses that hang together."""
    scene = scenes.scene()
    exact = scenes.marks_of(
        scene.photos.photos,
        {"ground": (scenes.on_slope(-8.0, 6.0), "A"), "all": (np.array([1.0, 3.0, 4.0]), "ABC")},
    )
    points = MeasuredPoints.joined(
        locate_points(scene, [m for m in exact if m.name == "ground"]),
        intersect_points(scene, [m for m in exact if m.name == "all"]),
    )
    half = scene.errors.joint(EVERY)[:18, :18] / 2.0
    fixed = FixedSplit(
        by_source={"gnss": np.array([half[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in EVERY])}
    )
    errors = SourcedErrors(errors=scene.errors, kinds=np.zeros(3, int), splits=(fixed,))
    located, crossed = point_budgets(points, errors)
    for budget, covariance in zip((located, crossed), points.each, strict=True):
        assert budget.covariance == pytest.approx(covariance, rel=1e-9)
    assert located.photo_ids == ("A",)
    assert crossed.photo_ids == ("A", "B", "C")
    assert "ground" not in crossed.by_source
    assert np.any(located.by_source["ground"])


def test_one_photo_far_off_does_not_make_the_usual_budget() -> None:
    scene = scenes.scene()
    marks = [Mark(name=f"p{k}", photo="A", u=1500.0 + 90 * k, v=1400.0) for k in range(10)]
    errors = SourcedErrors(errors=scene.errors, kinds=np.full(3, -1))
    budgets = point_budgets(locate_points(scene, marks), errors)
    whole = usual_budget(budgets, "usual")
    far = replace(budgets[0], by_source={s: 1e4 * p for s, p in budgets[0].by_source.items()})
    with_far = usual_budget([far, *budgets[1:]], "usual")
    assert with_far.horizontal() == pytest.approx(whole.horizontal(), rel=0.05)
    assert remedies(whole)[0].now == pytest.approx(whole.horizontal())
