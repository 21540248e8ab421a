"""Many intersections at once are each what one alone is."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.frames import Array, exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.intersection import intersect
from georef_gis.model.intersection_rays import Marks
from georef_gis.model.intersections import BLUNDER, intersect_many
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose import Pose

CAMERA = Camera(
    id="c", width=4000, height=3000, fx=3000.0, fy=3000.0, cx=1990.0, cy=1505.0, k1=-0.06,
    p1=3e-4, sigma_f=4.0, sigma_c=2.0,
)  # fmt: skip
SIGMA = np.array([0.05, 0.05, 0.05, 5e-4, 5e-4, 5e-4])
K = 12


def photos() -> list[OrientedPhoto]:
    """Three lines of four photos, one camera, tilted a little."""
    rng = np.random.default_rng(2)
    out = []
    for k in range(K):
        place = np.array([15.0 * (k % 4), 18.0 * (k // 4), 60.0 + rng.normal()])
        R = exp_so3(0.05 * rng.normal(size=3)) @ np.diag([1.0, -1.0, -1.0])
        pose = Pose(origin_enu=place, R_enu_from_cam=R, covariance=np.diag(SIGMA**2))
        photo = Photo(id=f"p{k}", path=Path(f"p{k}"), width=4000, height=3000)
        out.append(OrientedPhoto(photo=photo, camera=CAMERA, pose=pose))
    return out


def joint() -> Array:
    """Neighbouring poses err alike."""
    near = np.exp(-np.abs(np.subtract.outer(np.arange(K), np.arange(K))) / 6.0)
    return np.asarray(np.kron(near, np.diag(SIGMA**2)))


def marks(stack: PhotoStack, n: int, rng: np.random.Generator, noise: float = 0.5) -> Marks:
    """Places in two to seven photos each."""
    photo, point, uv = [], [], []
    for i in range(n):
        p = np.append(rng.uniform([0, 0], [45, 36]), rng.normal())
        seen = np.flatnonzero(
            stack.contains(np.arange(K), stack.project(np.arange(K), np.tile(p, (K, 1))))
        )
        chosen = rng.permutation(seen)[: rng.integers(2, min(len(seen), 7) + 1)]
        photo += list(chosen)
        point += [i] * len(chosen)
        uv += list(stack.project(chosen, np.tile(p, (len(chosen), 1))))
    shuffled = rng.permutation(len(photo))
    noisy = np.array(uv) + noise * rng.normal(size=(len(uv), 2))
    return Marks(
        photo=np.array(photo)[shuffled], point=np.array(point)[shuffled], uv=noisy[shuffled],
        sigma=np.full(len(photo), 0.5),
    )  # fmt: skip


def test_each_is_what_it_is_alone() -> None:
    rng, many = np.random.default_rng(3), photos()
    stack = PhotoStack.of(many)
    some = marks(stack, 20, rng)
    found = intersect_many(JointErrors.of_matrix(stack, joint()), some, robust=False)
    C = joint()
    for i in range(20):
        rows = np.flatnonzero(some.point == i)
        own = [many[k] for k in some.photo[rows]]
        at = (6 * some.photo[rows][:, None] + np.arange(6)).ravel()
        alone = intersect(own, some.uv[rows], 0.5, joint=lambda ids, at=at: C[np.ix_(at, at)])
        np.testing.assert_allclose(found.p_enu[i], alone.p_enu, atol=1e-6)
        np.testing.assert_allclose(found.covariance[i], alone.covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(found.residuals[rows], alone.residuals_uv, atol=1e-3)
        np.testing.assert_allclose(found.normalised[rows], alone.normalised, atol=1e-3)


def test_sensitivities_and_the_clicks_make_the_covariance() -> None:
    """C = S Cx S^T + own, of every point: what it shares is told without rest."""
    rng, stack = np.random.default_rng(4), PhotoStack.of(photos())
    errors = JointErrors.of_matrix(stack, joint())
    some = marks(stack, 15, rng)
    found = intersect_many(errors, some)
    full = errors.joint(np.arange(K))[:-1, :-1]
    for i in range(15):
        S = np.zeros((3, 6 * K + 11))
        for row in np.flatnonzero(some.point == i):
            k = some.photo[row]
            S[:, 6 * k : 6 * k + 6] += found.by_pose[row]
            S[:, 6 * K :] += found.by_camera[row]
        C = S @ full @ S.T + found.own[i]
        np.testing.assert_allclose(C, found.covariance[i], rtol=1e-6, atol=1e-12)


def test_wrong_marks_are_found_and_good_ones_stay() -> None:
    rng, stack = np.random.default_rng(5), PhotoStack.of(photos())
    some = marks(stack, 300, rng)
    wrong = np.zeros(len(some.photo), dtype=bool)
    rays = np.bincount(some.point)
    for i in np.flatnonzero(rays >= 5)[:60]:
        wrong[rng.choice(np.flatnonzero(some.point == i), size=1 + i % 2, replace=False)] = True
    way = rng.uniform(0, 2 * np.pi, len(wrong))
    off = rng.uniform(30, 300, len(wrong)) * wrong
    spoilt = replace(some, uv=some.uv + off[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1))
    found = intersect_many(JointErrors.of_matrix(stack, joint()), spoilt)
    assert not found.failed
    # two slips of five along the base may agree
    assert np.mean(~found.used[wrong]) > 0.93
    # one good mark of 16 000 by chance, and a few beside a wrong one
    assert np.mean(found.used[~wrong]) > 0.99
    assert found.normalised[wrong & ~found.used].min() > BLUNDER


def test_good_marks_alone_are_left_in_peace() -> None:
    """chi^2 is that of its degrees of freedom where errors are drawn as stated."""
    rng, stack = np.random.default_rng(6), PhotoStack.of(photos())
    root = np.linalg.cholesky(joint())
    chi2, dof, used = [], [], []
    for _ in range(40):
        e = (root @ rng.normal(size=6 * K)).reshape(K, 6)
        true = [
            replace(
                p,
                pose=replace(
                    p.pose,
                    origin_enu=p.pose.origin_enu + e[k, :3],
                    R_enu_from_cam=exp_so3(e[k, 3:]) @ p.pose.R_enu_from_cam,
                ),
            )
            for k, p in enumerate(stack.photos)
        ]
        some = marks(PhotoStack.of(true), 40, rng)
        found = intersect_many(JointErrors.of_matrix(stack, joint()), some)
        chi2.append(found.chi2.sum())
        dof.append(np.sum(2 * found.rays - 3))
        used.append(found.used.mean())
    # the points of a flight share its poses: one flight scatters by 30 %. The camera errs not at
    # all here, which leaves 0.9
    assert np.sum(chi2) / np.sum(dof) == pytest.approx(0.9, abs=0.2)
    assert np.mean(used) > 0.998


def test_reasons_are_told_by_point() -> None:
    stack = PhotoStack.of(photos())
    p = np.array([20.0, 15.0, 0.0])
    uv = stack.project(np.arange(4), np.tile(p, (4, 1)))
    away = np.array([[100.0, 1500.0], [3900.0, 1500.0]])
    some = Marks(
        photo=np.array([0, 1, 2, 0, 3]), point=np.array([0, 0, 1, 2, 2]),
        uv=np.vstack([uv[:3], away]), sigma=np.full(5, 0.5),
    )  # fmt: skip
    found = intersect_many(JointErrors(stack), some)
    assert set(found.failed) == {1, 2}
    assert found.failed[1].startswith("1 ray gives no point")
    assert found.failed[2].startswith("the rays do not meet in front")
    assert np.isnan(found.p_enu[1:]).all()
    np.testing.assert_allclose(found.p_enu[0], p, atol=1e-6)
    np.testing.assert_array_equal(found.used, [True, True, False, False, False])


def test_marks_surer_than_anything_are_not_infinitely_sure() -> None:
    known = [replace(p, pose=replace(p.pose, covariance=np.zeros((6, 6)))) for p in photos()[:3]]
    sure = [replace(p, camera=replace(CAMERA, sigma_f=0.0, sigma_c=0.0)) for p in known]
    stack = PhotoStack.of(sure)
    p = np.array([15.0, 9.0, 1.0])
    some = Marks(
        photo=np.arange(3), point=np.zeros(3, dtype=np.int64),
        uv=stack.project(np.arange(3), np.tile(p, (3, 1))), sigma=np.zeros(3),
    )  # fmt: skip
    found = intersect_many(JointErrors(stack), some)
    np.testing.assert_allclose(found.p_enu[0], p, atol=1e-6)


@pytest.mark.slow
def test_ten_thousand_points_take_seconds() -> None:
    """2 s is the aim, told in the benchmarks; a busy machine may be five times slower."""
    rng, stack = np.random.default_rng(7), PhotoStack.of(photos())
    few = marks(stack, 500, rng)
    times = 20
    some = Marks(
        photo=np.tile(few.photo, times),
        point=(few.point + 500 * np.arange(times)[:, None]).ravel(),
        uv=np.tile(few.uv, (times, 1)), sigma=np.tile(few.sigma, times),
    )  # fmt: skip
    errors = JointErrors.of_matrix(stack, joint())
    begun = time.process_time()
    found = intersect_many(errors, some)
    assert time.process_time() - begun < 10.0
    assert len(found.p_enu) == 10_000
