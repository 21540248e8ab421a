"""Error ellipses: axes, azimuth from grid north, confidence, polygon."""

from __future__ import annotations

import math

import measure_scenes as scenes
import numpy as np
import pytest
from scipy.stats import chi2, f

from georef_gis.errors import InputError
from georef_gis.measure.ellipses import (
    STANDARD,
    Ellipse,
    ellipse_of,
    ellipse_scale,
    ellipses_of,
    error_ellipse,
    on_map,
)
from georef_gis.measure.points import Mark, locate_points


def turned(azimuth_deg: float, a: float = 3.0, b: float = 1.0) -> np.ndarray:
    """Covariance with sigma a towards an azimuth clockwise from north, and b across."""
    t = math.radians(azimuth_deg)
    along, across = np.array([math.sin(t), math.cos(t)]), np.array([math.cos(t), -math.sin(t)])
    return a**2 * np.outer(along, along) + b**2 * np.outer(across, across)


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 89.0, 135.0, 179.0])
def test_axes_and_azimuth_are_those_of_the_covariance(azimuth: float) -> None:
    found = error_ellipse(turned(azimuth))
    assert (found.semi_major, found.semi_minor) == (pytest.approx(3.0), pytest.approx(1.0))
    assert math.degrees(found.azimuth) == pytest.approx(azimuth, abs=1e-6)
    assert 0.0 <= found.azimuth < math.pi


@pytest.mark.parametrize("conf", [0.3, STANDARD, 0.683, 0.95, 0.99])
def test_scale_is_the_quantile(conf: float) -> None:
    assert ellipse_scale(conf) == pytest.approx(math.sqrt(chi2.ppf(conf, 2)))
    for dof in (1, 3, 30):
        assert ellipse_scale(conf, dof) == pytest.approx(math.sqrt(2 * f.ppf(conf, 2, dof)))
    assert ellipse_scale(conf, 100_000) == pytest.approx(ellipse_scale(conf), rel=1e-4)


def test_one_sigma_is_39_per_cent() -> None:
    assert pytest.approx(0.3935, abs=5e-5) == STANDARD
    assert ellipse_scale(STANDARD) == pytest.approx(1.0)


@pytest.mark.parametrize("conf", [0.0, 1.0, -0.1, 95.0, math.nan])
def test_what_is_no_confidence_is_refused(conf: float) -> None:
    with pytest.raises(InputError, match=r"conf: .* is no confidence; give a number between 0 and"):
        ellipse_scale(conf)


def test_as_many_draws_are_inside_as_the_confidence_says() -> None:
    rng = np.random.default_rng(8)
    C = turned(70.0)
    draws = rng.multivariate_normal(np.zeros(2), C, 20_000)
    for conf in (STANDARD, 0.95):
        inside = error_ellipse(C, conf=conf).holds(draws)
        # 20 000 draws: 0.35 %
        assert np.mean(inside) == pytest.approx(conf, abs=0.012)


def test_the_polygon_lies_on_the_ellipse_and_runs_counter_clockwise() -> None:
    e = Ellipse(semi_major=4.0, semi_minor=0.5, azimuth=math.radians(25.0), conf=0.95)
    foot = 0.3048
    ring = e.polygon([1000.0, 2000.0], n=32, unit=foot)
    assert ring.shape == (33, 2)
    np.testing.assert_array_equal(ring[0], ring[-1])
    d = (ring - [1000.0, 2000.0]) * foot
    assert e.holds(d * 0.999).all()
    assert not e.holds(d * 1.001).any()
    x, y = d[:-1].T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    # 32 corners cut 0.6 % off
    assert area == pytest.approx(math.pi * 4.0 * 0.5, rel=0.01)


def test_points_without_spread_have_an_ellipse_of_no_size() -> None:
    e = error_ellipse(np.zeros((2, 2)))
    assert (e.semi_major, e.semi_minor) == (0.0, 0.0)
    assert e.holds([0.0, 0.0])
    assert not e.holds([1e-3, 0.0])


def test_azimuths_count_from_the_grid_not_from_true_north() -> None:
    """Sigma towards true north: on this map it lies west of grid north by the convergence."""
    p = np.array([[0.0, 40.0, 0.0]])
    (C,) = on_map(scenes.FRAME, p, np.diag([0.01, 4.0, 0.0])[None])
    convergence = math.degrees(scenes.FRAME.convergence_at(p[0]))
    assert abs(convergence) > 0.5
    found = math.degrees(error_ellipse(C).azimuth)
    assert (found + convergence + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=1e-6)


def test_ellipses_of_points_are_those_of_each() -> None:
    scene = scenes.scene()
    marks = [Mark(name="", photo="A", u=u, v=1500.0) for u in (500.0, 3500.0)]
    points = locate_points(scene, marks)
    for one, point in zip(ellipses_of(scenes.FRAME, points, conf=0.95), points, strict=True):
        assert one == ellipse_of(scenes.FRAME, point, conf=0.95)
        assert one.semi_major > one.semi_minor > 0.0
