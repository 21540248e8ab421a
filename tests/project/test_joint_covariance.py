"""The joint covariance in a project: written by the adjustment, read for chosen photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.project.joint_covariance import load_pose_covariance, save_joint_covariance

IDS, SHARED = ("a", "b"), ("cam f", "level")


@pytest.fixture
def full() -> Array:
    """Covariance of two poses, a focal length and the level, (14, 14)."""
    root = np.random.default_rng(3).standard_normal((14, 14))
    return root @ root.T


def save(path: Path, full: Array, *, with_level: bool) -> None:
    save_joint_covariance(
        path, photo_ids=IDS, shared_names=SHARED, covariance=full, with_level=with_level
    )


def test_the_poses_come_back_in_the_order_asked_for(tmp_path: Path, full: Array) -> None:
    save(tmp_path / "c.npz", full, with_level=False)
    found = load_pose_covariance(tmp_path / "c.npz")
    assert found is not None
    np.testing.assert_array_equal(found.matrix, full[:12, :12])
    turned = found.of(["b", "a"])
    assert turned is not None
    np.testing.assert_array_equal(turned[:6, 6:], full[6:12, :6])
    assert found.of(["a", "c"]) is None


def test_the_level_lifts_every_photo_alike(tmp_path: Path, full: Array) -> None:
    save(tmp_path / "c.npz", full, with_level=True)
    found = load_pose_covariance(tmp_path / "c.npz")
    assert found is not None
    lift = np.zeros((12, 14))
    lift[:, :12] = np.eye(12)
    lift[[2, 8], 13] = 1.0
    # rounding of a sum of four terms, here below 100 m2
    np.testing.assert_allclose(found.matrix, lift @ full @ lift.T, atol=1e-12)


def test_a_project_without_adjustment_has_none(tmp_path: Path) -> None:
    assert load_pose_covariance(tmp_path / "c.npz") is None
