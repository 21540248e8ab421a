"""Errors of a project's photos from what its runs kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.band_errors import BandErrors
from georef_gis.model.camera import Camera
from georef_gis.model.joint_errors import camera_sigmas
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pixel_derivatives import CAMERA_NAMES
from georef_gis.model.pose import Pose, PoseKind
from georef_gis.project import Project
from georef_gis.project.band_covariance import save_band_covariance
from georef_gis.project.columns_file import write_columns
from georef_gis.project.joint_covariance import load_joint_covariance, save_joint_covariance
from georef_gis.project.records import camera_row
from georef_gis.project.shared_errors import ADJUSTED, ALIKE, TAGS, TRAJECTORY, load_errors

SHARED = [*(f"cam {name}" for name in CAMERA_NAMES), "flight clock", "level"]
TAGGED = Camera(id="cam", width=800, height=600, fx=700.0, fy=700.0, cx=399.5, cy=299.5,
                sigma_f=9.0, sigma_c=4.0)  # fmt: skip
BETTER = Camera(id="cam adjusted", width=800, height=600, fx=711.0, fy=711.0, cx=401.0, cy=298.0,
                sigma_f=1.0, sigma_c=0.5)  # fmt: skip


def spd(k: int, seed: int) -> Array:
    root = np.random.default_rng(seed).normal(size=(k, k))
    return np.asarray(root @ root.T)


@pytest.fixture
def project(tmp_path: Path) -> Project:
    made = Project.create(tmp_path / "site")
    made.adjustment.mkdir()
    made.navigation.mkdir()
    rows = [camera_row(TAGGED), camera_row(BETTER)]
    rows[1]["covariance"] = spd(11, 9).tolist()
    rows[1]["extra"] = {**rows[1]["extra"], "adjusted_of": "cam"}
    with made.database.transaction():
        made.database.replace_rows("camera", rows)
    return made


def stack_of(kinds: dict[str, PoseKind]) -> PhotoStack:
    """Photos of these names, 20 m apart; adjusted ones have the adjusted camera."""
    photos = []
    for i, (key, kind) in enumerate(kinds.items()):
        pose = Pose(
            origin_enu=np.array([20.0 * i, 0.0, 50.0]),
            R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
            covariance=np.diag([4.0, 4.0, 2.0, 0.01, 0.01, 0.02]),
            kind=kind,
        )
        photo = Photo(id=key, path=Path(key), width=800, height=600, time_gps=2.0 * i)
        camera = BETTER if kind == "adjusted" else TAGGED
        photos.append(OrientedPhoto(photo=photo, camera=camera, pose=pose))
    return PhotoStack.of(photos)


def keep_covariance(project: Project, ids: tuple[str, ...], *, with_level: bool = False) -> Array:
    full = spd(6 * len(ids) + len(SHARED), 4)
    save_joint_covariance(
        project.adjustment / "covariance.npz", photo_ids=ids, shared_names=SHARED,
        covariance=full, with_level=with_level,
    )  # fmt: skip
    return full


def test_the_adjustments_covariance_is_used_with_its_camera(project: Project) -> None:
    full = keep_covariance(project, ("c", "a", "b"))
    kinds: dict[str, PoseKind] = {"a": "adjusted", "b": "adjusted"}
    errors = load_errors(project, stack_of(kinds), kinds, height=50.0)
    assert [source.kind for source in errors.sources] == [ADJUSTED]
    assert errors.known_together
    C, rows = errors.joint([0, 1]), np.r_[6:18, 18:29]
    np.testing.assert_array_equal(C[:23, :23], full[np.ix_(rows, rows)])
    assert errors.cameras.ids == ("cam adjusted",)


def test_the_level_of_control_is_in_the_heights_and_their_cameras(project: Project) -> None:
    full = keep_covariance(project, ("a", "b"), with_level=True)
    kept = load_joint_covariance(project.adjustment / "covariance.npz")
    assert kept is not None
    lift = np.eye(len(full))
    lift[[2, 8], -1] = 1.0
    np.testing.assert_allclose(kept.matrix, lift @ full @ lift.T, atol=1e-10)
    clock = kept.shared_rows("flight", ["clock"])
    assert clock is not None
    assert clock.tolist() == [12 + 11]
    assert kept.shared_rows("other flight", ["clock"]) is None


def test_a_block_too_large_to_keep_has_a_stated_law_and_its_cameras_row(project: Project) -> None:
    kinds: dict[str, PoseKind] = {"a": "adjusted", "b": "adjusted"}
    errors = load_errors(project, stack_of(kinds), kinds, height=50.0)
    assert [source.kind for source in errors.sources] == [ALIKE]
    C = errors.joint([0, 1])
    # 20 m apart at 50 m: nearly one error
    assert C[0, 6] / 4.0 == pytest.approx(np.exp(-20.0 / (25.0 * 50.0)))
    np.testing.assert_allclose(C[12:23, 12:23], spd(11, 9))
    assert not C[:12, 12:23].any()


def banded(full: Array, n: int) -> BandErrors:
    """Band of the normal matrix of a covariance of n poses and what they share."""
    normal = np.linalg.inv(full)
    H, E = normal[: 6 * n, : 6 * n], normal[: 6 * n, 6 * n :]
    scale, inverse = 1.0 / np.sqrt(np.diag(H)), np.linalg.inv(H)
    factor = np.linalg.cholesky(H * scale[:, None] * scale)

    def band(lower: Array) -> Array:
        rows = [np.append(np.diag(lower, -k), np.zeros(k)) for k in range(6 * n)]
        return np.array(rows)

    return BandErrors(
        factor=band(factor), inverse=band(inverse), position=np.arange(6 * n), scale=scale,
        to_shared=inverse @ E, shared=full[6 * n :, 6 * n :],
    )  # fmt: skip


def test_a_large_block_is_known_by_its_band_as_a_small_one_by_its_whole(project: Project) -> None:
    ids = ("c", "a", "b")
    kinds: dict[str, PoseKind] = {"a": "adjusted", "b": "adjusted"}
    full = keep_covariance(project, ids)
    whole = load_errors(project, stack_of(kinds), kinds, height=50.0)
    (project.adjustment / "covariance.npz").unlink()
    path = project.adjustment / "covariance_band.npz"
    save_band_covariance(path, photo_ids=ids, shared_names=SHARED, errors=banded(full, 3))
    errors = load_errors(project, stack_of(kinds), kinds, height=50.0)
    assert [source.kind for source in errors.sources] == [ADJUSTED]
    # rounding of an inverse of an inverse
    np.testing.assert_allclose(errors.joint([0, 1]), whole.joint([0, 1]), rtol=1e-5, atol=1e-5)


def test_a_covariance_that_lacks_a_photo_is_not_used_for_some(project: Project) -> None:
    keep_covariance(project, ("a",))
    kinds: dict[str, PoseKind] = {"a": "adjusted", "b": "adjusted"}
    errors = load_errors(project, stack_of(kinds), kinds, height=50.0)
    assert [source.kind for source in errors.sources] == [ALIKE]


def exposures(n: int) -> dict[str, Any]:
    return {
        "time": np.arange(n, dtype=float), "covariance": np.array([spd(9, 7)] * n),
        "gain": np.array([0.8 * np.eye(9)] * (n - 1)), "to_pose": np.array([np.eye(6)] * n),
        "mount": np.zeros((n, 6, 9)), "mount_covariance": np.eye(9),
        "own": np.zeros((n, 6, 6)),
    }  # fmt: skip


def test_each_kind_of_pose_has_its_own_source(project: Project) -> None:
    """A trajectory that knows a photo more, and one that it does not know."""
    full = keep_covariance(project, ("a", "b"))
    path = project.navigation / "exposures.npz"
    write_columns(path, "exposures", {"ids": ["x", "n1", "lost", "n2"], **exposures(4)})
    kinds: dict[str, PoseKind] = {
        "t1": "tags", "a": "adjusted", "n2": "navigation", "b": "adjusted", "n1": "navigation",
        "unknown": "navigation", "t2": "tags",
    }  # fmt: skip
    errors = load_errors(project, stack_of(kinds), kinds, height=50.0)
    found = {source.kind: source.photos.tolist() for source in errors.sources[:2]}
    assert found == {ADJUSTED: [1, 3], TRAJECTORY: [4, 2]}
    assert [s.photos.tolist() for s in errors.sources[2:]] == [[0, 6], [5]]
    assert {s.kind for s in errors.sources[2:]} == {TAGS}
    C = errors.joint(range(7))
    P = spd(9, 7)
    # n1 and n2 are two exposures apart: the gain twice
    np.testing.assert_allclose(C[24:30, 12:18], 0.64 * P[:6, :6])
    np.testing.assert_array_equal(C[6:12, 18:24], full[:6, 6:12])
    assert C[0, 36] > 0.5
    assert not C[0:6, 6:12].any()
    # of two cameras one was adjusted
    assert errors.cameras.ids == ("cam", "cam adjusted")
    at = 6 * 7
    np.testing.assert_allclose(np.diag(C)[at : at + 11], camera_sigmas(TAGGED) ** 2)
    np.testing.assert_array_equal(C[at + 11 : at + 22, at + 11 : at + 22], full[12:23, 12:23])
    np.testing.assert_array_equal(C[6:12, at + 11 : at + 22], full[:6, 12:23])


def test_a_broken_file_names_its_cure(project: Project) -> None:
    kinds: dict[str, PoseKind] = {"a": "adjusted"}
    path = project.adjustment / "covariance.npz"
    keep_covariance(project, ("a",))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match=r"covariance.npz: .*run `georef run`"):
        load_errors(project, stack_of(kinds), kinds, height=50.0)
