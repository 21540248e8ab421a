"""Space intersections against hand cases and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.intersection import intersect, nearest_point
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose

NADIR = np.diag([1.0, -1.0, -1.0])
POINT = np.array([3.0, -2.0, 1.5])
SIGMA_P, SIGMA_ANGLE = 0.05, np.radians(0.03)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def camera(**values: float) -> Camera:
    return Camera(id="c", width=4000, height=3000, fx=3000.0, fy=3000.0, cx=1999.5, cy=1499.5,
                  **values)  # fmt: skip


def photo(name: str, place: Array, *, cam: Camera | None = None, shared: float = 0.0,
          R: Array = NADIR) -> OrientedPhoto:  # fmt: skip
    pose = Pose(
        origin_enu=np.asarray(place, float),
        R_enu_from_cam=R,
        covariance=np.diag([SIGMA_P**2] * 3 + [SIGMA_ANGLE**2] * 3),
        sigma_height_shared=shared,
    )
    cam = cam or camera()
    return OrientedPhoto(
        photo=Photo(id=name, path=Path(f"{name}.jpg"), width=4000, height=3000), camera=cam,
        pose=pose,
    )  # fmt: skip


def strip(n: int, **values: float) -> list[OrientedPhoto]:
    """Photos 60 m above ground, 15 m apart along a line."""
    cam = camera(**values)
    return [photo(f"p{i}", np.array([15.0 * (i - (n - 1) / 2), 4.0 * (i % 2), 60.0]), cam=cam)
            for i in range(n)]  # fmt: skip


def test_two_rays_that_meet_give_their_meeting_point() -> None:
    d = np.array([[1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    found = nearest_point([[0.0, 0.0, 10.0], [20.0, 0.0, 10.0]], d)
    np.testing.assert_allclose(found, [10.0, 0.0, 0.0], atol=1e-12)


def test_exact_pixels_give_the_exact_point() -> None:
    photos = strip(4, k1=-0.08, p1=1e-3)
    uv = np.array([one.project(POINT) for one in photos])
    found = intersect(photos, uv, 0.5)
    np.testing.assert_allclose(found.p_enu, POINT, atol=1e-6)  # m: stop of the iteration
    assert found.sigma0 < 1e-4
    assert found.rays == 4


def test_stereo_pair_has_the_sigmas_of_the_normal_case() -> None:
    # Base B, height H, focal length f: sigma_z = H^2 / (B f) sqrt(2) sigma_px for pixels alone.
    quiet = [
        replace(one, pose=replace(one.pose, covariance=np.zeros((6, 6))))
        for one in (photo("a", [-10.0, 0.0, 60.0]), photo("b", [10.0, 0.0, 60.0]))
    ]
    uv = np.array([one.project(np.zeros(3)) for one in quiet])
    found = intersect(quiet, uv, 0.5)
    expected = 60.0**2 / (20.0 * 3000.0) * np.sqrt(2.0) * 0.5
    # m; the normal case takes base over height as small in nothing but this
    assert np.sqrt(found.covariance[2, 2]) == pytest.approx(expected, rel=1e-3)


def _drawn(rng: np.random.Generator, photos: list[OrientedPhoto], errors: Array, *,
           sigma_f: float = 0.0) -> Array:  # fmt: skip
    """Pixels as cameras see them whose true poses differ from the stated by `errors` (n, 6)."""
    cam = photos[0].camera
    df = sigma_f * rng.normal()
    true_cam = replace(cam, fx=cam.fx + df, fy=cam.fy + df)
    out = []
    for one, e in zip(photos, errors, strict=True):
        pose = replace(
            one.pose,
            origin_enu=one.pose.origin_enu + e[:3],
            R_enu_from_cam=exp_so3(e[3:]) @ one.pose.R_enu_from_cam,
        )
        seen = replace(one, pose=pose, camera=true_cam).project(POINT)
        out.append(seen + 0.5 * rng.normal(size=2))
    return np.array(out)


@pytest.mark.parametrize("sigma_f", [0.0, 15.0], ids=["camera known", "focal length unsure"])
def test_error_over_sigma_holds_with_independent_poses(
    rng: np.random.Generator, sigma_f: float
) -> None:
    photos = strip(5, sigma_f=sigma_f)
    scale = np.array([SIGMA_P] * 3 + [SIGMA_ANGLE] * 3)
    nees, chi2 = [], []
    for _ in range(200):
        uv = _drawn(rng, photos, scale * rng.normal(size=(5, 6)), sigma_f=sigma_f)
        found = intersect(photos, uv, 0.5)
        e = found.p_enu - POINT
        nees.append(e @ np.linalg.solve(found.covariance, e) / 3.0)
        chi2.append(found.sigma0**2)
    # 200 draws of 3: the mean of chi^2 / 3 has a spread of 0.058.
    assert np.mean(nees) == pytest.approx(1.0, abs=0.2)
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.2)


def test_error_over_sigma_holds_for_correlated_poses_by_their_joint_covariance_only(
    rng: np.random.Generator,
) -> None:
    photos = strip(5)
    scale = np.array([SIGMA_P] * 3 + [SIGMA_ANGLE] * 3)
    # 90 % of the variance common to all photos, as along a smoothed trajectory
    correlation = np.full((5, 5), 0.9) + 0.1 * np.eye(5)
    together = np.kron(correlation, np.diag(scale**2))
    root = np.linalg.cholesky(together)
    ratios = {"joint": [], "alone": []}
    for _ in range(200):
        uv = _drawn(rng, photos, (root @ rng.normal(size=30)).reshape(5, 6))
        for key, joint in (("joint", lambda ids: together), ("alone", None)):
            found = intersect(photos, uv, 0.5, joint=joint)
            assert found.independent == (key == "alone")
            e = found.p_enu - POINT
            ratios[key].append(e @ np.linalg.solve(found.covariance, e) / 3.0)
    assert 0.7 < np.sqrt(np.mean(ratios["joint"])) < 1.4
    assert np.sqrt(np.mean(ratios["alone"])) > 1.4  # what the flag `independent` warns of


def test_level_shared_with_the_ground_is_in_the_height_only() -> None:
    photos = strip(3)
    uv = np.array([one.project(POINT) for one in photos])
    shared = [replace(one, pose=replace(one.pose, sigma_height_shared=5.0)) for one in photos]
    more = intersect(shared, uv, 0.5).covariance - intersect(photos, uv, 0.5).covariance
    np.testing.assert_allclose(more, np.diag([0.0, 0.0, 25.0]), atol=1e-9)


def test_a_wrong_mark_is_the_one_that_stands_out() -> None:
    photos = strip(5)
    uv = np.array([one.project(POINT) for one in photos])
    uv[3] += [400.0, 0.0]
    found = intersect(photos, uv, 0.5)
    assert np.argmax(found.normalised) == 3
    assert found.normalised[3] > 4.0
    assert found.sigma0 > 4.0


def test_parallel_rays_are_refused() -> None:
    one = photo("a", [0.0, 0.0, 60.0])
    other = photo("b", [0.0, 0.0, 60.001])
    uv = np.array([one.project(np.zeros(3)), other.project(np.zeros(3))])
    with pytest.raises(GeometryError, match="parallel"):
        intersect([one, other], uv, 0.5)


def test_rays_that_part_are_refused() -> None:
    photos = strip(2)
    # Each mark in the half that looks away from the other photo.
    with pytest.raises(GeometryError, match="in front"):
        intersect(photos, np.array([[200.0, 1500.0], [3800.0, 1500.0]]), 0.5)


def test_one_photo_is_refused() -> None:
    with pytest.raises(GeometryError, match="two photos"):
        intersect(strip(1), np.array([[2000.0, 1500.0]]), 0.5)
