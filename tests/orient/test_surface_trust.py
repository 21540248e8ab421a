"""Points of two rays carry the ground only where points of three agree with them."""

from __future__ import annotations

import numpy as np
import pytest

from georef_gis.model.tie_points import GroundPoints
from georef_gis.orient.surface_trust import trust, trusted


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def cloud(xy, z, rays, *, sigma: float = 0.05, shared: float = 2.0) -> GroundPoints:
    n = len(xy)
    covariance = np.tile(np.diag([sigma**2, sigma**2, sigma**2 + shared**2]), (n, 1, 1))
    return GroundPoints(
        p_enu=np.column_stack([xy, z]), covariance=covariance,
        rays=np.asarray(rays, dtype=np.int32), residual_px=np.full(n, 0.5),
    )  # fmt: skip


def test_false_points_of_two_rays_are_left_out_and_good_ones_kept(rng) -> None:
    xy = rng.uniform(0, 100, (900, 2))
    z = 0.05 * xy[:, 0] + 0.05 * rng.standard_normal(900)
    rays = np.where(np.arange(900) < 500, 4, 2)
    wrong = np.arange(900) >= 750
    z[wrong] += rng.choice([-1, 1], 150) * rng.uniform(2, 8, 150)
    keep = trust(cloud(xy, z, rays))
    assert np.all(keep[:500])
    # 3 sigma of the relief among eight neighbours
    assert keep[500:750].mean() > 0.85
    assert keep[wrong].mean() < 0.02


def test_points_that_nobody_vouches_for_are_left_out(rng) -> None:
    land = rng.uniform(0, 100, (300, 2))
    lake = rng.uniform([160, 0], [260, 100], (100, 2))
    xy = np.vstack([land, lake])
    keep = trust(cloud(xy, np.zeros(400), [3] * 300 + [2] * 100))
    assert np.all(keep[:300])
    assert not np.any(keep[300:])


def test_a_pair_of_photos_keeps_all_it_has(rng) -> None:
    xy = rng.uniform(0, 50, (200, 2))
    points = cloud(xy, rng.standard_normal(200), [2] * 200)
    assert len(trusted(points)) == 200
