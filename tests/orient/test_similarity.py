"""Similarity by positions that may be wrong: what it finds, what sways it, what it refuses."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from georef_gis.errors import GeometryError
from georef_gis.orient.level import SIGMA_LEVEL_SHARED, Level, mean_level
from georef_gis.orient.similarity import estimate_similarity
from georef_gis.orient.similarity_search import umeyama


def flight(n: int = 40, *, lines: int = 4, length: float = 400.0, step: float = 60.0) -> np.ndarray:
    """Places of a mapping flight, m: lines along x at 100 m, with a metre of air under them."""
    along = np.linspace(0.0, length, n // lines)
    x, y = np.meshgrid(along, step * np.arange(lines))
    rng = np.random.default_rng(5)
    return np.column_stack([x.ravel(), y.ravel(), 100.0 + rng.normal(0.0, 1.0, x.size)])


def own_frame(p: np.ndarray, seed: int = 3) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """The same places in a frame of its own, and scale, rotation, shift that lead back."""
    rng = np.random.default_rng(seed)
    scale = math.exp(rng.uniform(-3.0, 3.0))
    R = Rotation.random(random_state=seed).as_matrix()
    shift = rng.uniform(-1000.0, 1000.0, 3)
    return (p - shift) @ R / scale, scale, R, shift


def angle_deg(R_a: np.ndarray, R_b: np.ndarray) -> float:
    return math.degrees(Rotation.from_matrix(R_a @ R_b.T).magnitude())


def test_umeyama_gives_back_a_similarity_and_never_a_mirror() -> None:
    p = flight()
    q, scale, R, shift = own_frame(p)
    found = umeyama(q, p)
    assert found.scale == pytest.approx(scale, rel=1e-12)
    assert found.R_to_from == pytest.approx(R, abs=1e-12)
    assert found.shift == pytest.approx(shift, abs=1e-8)
    flat = p * [1.0, 1.0, 0.0]
    q, scale, R, _ = own_frame(flat)
    assert np.linalg.det(umeyama(q, flat).R_to_from) == pytest.approx(1.0)
    assert umeyama(q, flat).R_to_from == pytest.approx(R, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_exact_positions_give_the_similarity_back(seed: int) -> None:
    p = flight()
    q, scale, R, _ = own_frame(p, seed)
    ones = np.ones(len(p))
    for level in (None, Level(up_from=R.T @ [0, 0, 1], sigma=0.05)):
        fit = estimate_similarity(q, p, sigma_h=ones, sigma_v=ones, level=level)
        assert fit.similarity.scale == pytest.approx(scale, rel=1e-9)
        assert angle_deg(fit.similarity.R_to_from, R) < 1e-6
        assert fit.similarity.apply(q) == pytest.approx(p, abs=1e-6)
        assert np.all(fit.inliers)


def test_a_third_of_wild_positions_does_not_sway_it() -> None:
    rng = np.random.default_rng(8)
    p = flight()
    q, scale, R, _ = own_frame(p)
    seen = p + rng.normal(0.0, [1.0, 1.0, 2.0], p.shape)
    wild = rng.permutation(len(p))[: len(p) // 3]
    seen[wild] += rng.uniform(-500.0, 500.0, (len(wild), 3))
    h, v = np.full(len(p), 1.0), np.full(len(p), 2.0)
    for level in (None, Level(up_from=R.T @ [0, 0, 1], sigma=math.radians(4.0))):
        fit = estimate_similarity(q, seen, sigma_h=h, sigma_v=v, level=level)
        # 1 m over 27 photos of a 400 m block: 0.2 m, and 0.1 % of scale
        assert fit.similarity.scale == pytest.approx(scale, rel=0.01)
        assert np.max(np.abs(fit.similarity.apply(q) - p)) < 3.0
        assert not np.any(fit.inliers[wild[np.abs(seen[wild] - p[wild])[:, :2].max(axis=1) > 20]])


def test_heights_that_drift_by_100_m_do_not_tilt_a_level_block() -> None:
    rng = np.random.default_rng(2)
    p = flight()
    q, _, R, _ = own_frame(p)
    seen = p + rng.normal(0.0, 1.0, p.shape)
    # along the lines, which a plain similarity takes for a tilt of 14 deg
    seen[:, 2] += 0.25 * p[:, 0]
    h, v = np.full(len(p), 1.0), np.full(len(p), 3.0)
    plain = umeyama(q, seen)
    assert angle_deg(plain.R_to_from, R) > 10.0
    off = Rotation.from_rotvec([0.03, -0.02, 0.0]).as_matrix()
    level = Level(up_from=R.T @ off @ [0, 0, 1], sigma=math.radians(3.0))
    fit = estimate_similarity(q, seen, sigma_h=h, sigma_v=v, level=level)
    # what is left is the error of the attitudes, 2.1 deg
    assert angle_deg(fit.similarity.R_to_from, R) < 2.5
    assert not fit.heights_used
    # 14.0 deg of drift and up to 2.1 deg of the attitudes
    assert re.search(r"tilt the block by 1[2-6]\.", fit.doubts[0])
    # The height itself is worth no more than the drift.
    assert fit.similarity.covariance[6, 6] > 20.0**2


def test_outlying_heights_of_100_m_do_not_tilt_a_block_whose_other_heights_are_good() -> None:
    rng = np.random.default_rng(2)
    p = flight()
    q, _, R, _ = own_frame(p)
    seen = p + rng.normal(0.0, [1.0, 1.0, 1.0], p.shape)
    # the first quarter of the flight, at one end
    seen[p[:, 0] < 110.0, 2] += 100.0
    ones = np.ones(len(p))
    level = Level(up_from=R.T @ [0, 0, 1], sigma=math.radians(4.0))
    fit = estimate_similarity(q, seen, sigma_h=ones, sigma_v=2 * ones, level=level)
    assert angle_deg(umeyama(q, seen).R_to_from, R) > 10.0
    # 1 m over 250 m and 28 photos
    assert angle_deg(fit.similarity.R_to_from, R) < 1.0
    assert fit.similarity.apply(q)[:, 2] == pytest.approx(p[:, 2], abs=4.0)


def test_good_heights_mend_a_level_that_is_off() -> None:
    rng = np.random.default_rng(4)
    p = flight()
    q, _, R, _ = own_frame(p)
    seen = p + rng.normal(0.0, 0.05, p.shape)
    off = Rotation.from_rotvec([0.07, 0.05, 0.0]).as_matrix()
    small = np.full(len(p), 0.05)
    level = Level(up_from=R.T @ off @ [0, 0, 1], sigma=math.radians(4.0))
    fit = estimate_similarity(q, seen, sigma_h=small, sigma_v=small, level=level)
    assert fit.heights_used
    assert angle_deg(fit.similarity.R_to_from, R) < 0.05


def test_a_single_strip_is_placed_by_attitudes_and_refused_without() -> None:
    rng = np.random.default_rng(1)
    p = flight(8, lines=1)
    p[:, 2] = 100.0
    q, scale, R, _ = own_frame(p)
    seen = p + rng.normal(0.0, 0.5, p.shape)
    half = np.full(8, 0.5)
    with pytest.raises(GeometryError, match="one line and no attitude"):
        estimate_similarity(q, seen, sigma_h=half, sigma_v=half)
    level = Level(up_from=R.T @ [0, 0, 1], sigma=math.radians(4.0))
    fit = estimate_similarity(q, seen, sigma_h=half, sigma_v=half, level=level)
    assert fit.similarity.scale == pytest.approx(scale, rel=0.01)
    assert angle_deg(fit.similarity.R_to_from, R) < 1.0
    # About the line only the attitudes tell: 4 deg.
    sigma = np.sqrt(np.diag(fit.similarity.covariance))
    assert max(sigma[1], sigma[2]) == pytest.approx(math.radians(4.0), rel=0.1)


def test_positions_that_do_not_tell_are_refused_by_name() -> None:
    p = flight()
    q, *_ = own_frame(p)
    ones = np.ones(len(p))
    level = Level(up_from=np.array([0.0, 0.0, 1.0]), sigma=0.1)
    two = np.where(np.arange(len(p))[:, None] < 2, p, np.nan)
    with pytest.raises(GeometryError, match="2 positions are known and three are needed"):
        estimate_similarity(q, two, sigma_h=ones, sigma_v=ones, level=level)
    mixed = np.random.default_rng(0).permutation(p)
    with pytest.raises(GeometryError, match="no scale and heading bring more than"):
        estimate_similarity(p, mixed, sigma_h=0.5 * ones, sigma_v=ones, level=level)
    near = np.random.default_rng(0).normal(0.0, 1.0, p.shape)
    with pytest.raises(GeometryError, match=r"the scale is known to|all positions are one"):
        estimate_similarity(p, near, sigma_h=2.0 * ones, sigma_v=ones, level=level)
    no_heights = p * [1, 1, np.nan]
    with pytest.raises(GeometryError, match="neither attitudes nor three heights"):
        estimate_similarity(q, no_heights, sigma_h=ones, sigma_v=ones)


def test_errors_agree_with_their_covariance() -> None:
    rng = np.random.default_rng(11)
    p = flight(24, lines=3)
    ratios = []
    for _ in range(120):
        q, scale, R, _ = own_frame(p, int(rng.integers(1 << 30)))
        seen = p + rng.normal(0.0, [1.0, 1.0, 3.0], p.shape)
        sigma = math.radians(4.0)
        tilt = Rotation.from_rotvec([*rng.normal(0.0, sigma, 2), 0.0]).as_matrix()
        level = Level(up_from=R.T @ tilt @ [0, 0, 1], sigma=sigma)
        fit = estimate_similarity(
            q, seen, sigma_h=np.ones(len(p)), sigma_v=np.full(len(p), 3.0), level=level
        )
        found = fit.similarity
        error = np.zeros(7)
        error[0] = math.log(scale / found.scale)
        error[1:4] = Rotation.from_matrix(R @ found.R_to_from.T).as_rotvec()
        error[4:] = (scale * R @ found.pivot + (p - scale * q @ R.T)[0]) - found.apply(found.pivot)
        ratios.append(error @ np.linalg.solve(found.covariance, error) / 7.0)
    # error / sigma over 120 flights of 7 unknowns each
    assert 0.7 < math.sqrt(np.mean(ratios)) < 1.4


def test_the_mean_of_directions_passes_over_wild_ones_and_keeps_what_all_share() -> None:
    rng = np.random.default_rng(6)
    n = 60
    noise = np.column_stack([rng.normal(0.0, math.radians(2.0), (n, 2)), np.zeros(n)])
    up = Rotation.from_rotvec(noise).apply([0.0, 0.0, 1.0])
    up[:15] = Rotation.random(15, random_state=1).apply([0.0, 0.0, 1.0])
    up[15] = np.nan
    level = mean_level(up, np.full(n, math.radians(2.0)))
    assert level is not None
    # 2 deg over 44 photos is 0.3 deg
    assert math.degrees(math.acos(min(1.0, level.up_from[2]))) < 1.0
    assert level.sigma == pytest.approx(SIGMA_LEVEL_SHARED, rel=0.02)
    assert mean_level(np.full((3, 3), np.nan), np.ones(3)) is None
