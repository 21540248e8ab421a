"""Ground that is known everywhere, and adjusted points on it with their errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.geodesy import Origin
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import TinTerrain

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
Up = Callable[[Array], Array]


def bend(xy: Array) -> Array:
    """By how much level ground lies below the origin's plane, m: a sphere is good to 0.1 mm."""
    return np.asarray(np.sum(xy**2, axis=-1) / (2 * 6.371e6))


def hills(rng: np.random.Generator, relief: float, length: float, tilt: float = 0.03) -> Up:
    """Random ground of a standard deviation, m, and length of its waves, m, with a tilt."""
    k, phase = rng.normal(size=(40, 2)) / length, rng.uniform(0, 2 * np.pi, 40)
    a, slope = rng.normal(size=40) * relief / math.sqrt(20), rng.normal(size=2) * tilt

    def up(xy: Array) -> Array:
        waves = np.sin(np.einsum("...i,ki->...k", xy, k) + phase)
        return np.asarray(waves @ a + xy @ slope - bend(xy))

    return up


def places(rng: np.random.Generator, n: int, half: float = 150.0) -> Array:
    return rng.uniform(-half, half, (n, 2))


def points_of(xy: Array, up: Array, sigma: Array | float, shared: float = 0.0) -> GroundPoints:
    """Points as given, their stated sigma in height that of own and shared error."""
    n = len(xy)
    sigma = np.broadcast_to(np.asarray(sigma, dtype=float), n)
    covariance = np.zeros((n, 3, 3))
    covariance[:, 0, 0] = covariance[:, 1, 1] = (0.3 * sigma) ** 2
    covariance[:, 2, 2] = sigma**2 + shared**2
    return GroundPoints(
        p_enu=np.column_stack([xy, up]),
        covariance=covariance,
        rays=np.full(n, 4, np.int32),
        residual_px=np.full(n, 0.3),
    )


@dataclass
class Sample:
    """Points with planted blunders, and the ground that they lie on."""

    points: GroundPoints
    up: Up
    bad: np.ndarray
    rng: np.random.Generator

    def errors(self, ground: TinTerrain, xy: Array) -> tuple[Array, Array]:
        """Errors of a surface, m, and in its own sigmas."""
        error = ground.z_at(xy) - self.up(xy)
        return error, error / ground.sigma_at(xy)


def sample(
    seed: int, *, n: int = 400, relief: float = 2.0, length: float = 40.0, noise: float = 0.1,
    shared: float = 0.0, blunders: float = 0.0,
) -> Sample:  # fmt: skip
    """Points 300 m about: own noise that varies from point to point, one shift, gross errors."""
    rng = np.random.default_rng(seed)
    up = hills(rng, relief, length)
    xy = places(rng, n)
    sigma = noise * np.exp(0.4 * rng.normal(size=n))
    z = up(xy) + sigma * rng.normal(size=n) + shared * rng.normal()
    bad = rng.uniform(size=n) < blunders
    z[bad] += rng.choice([-20.0, 20.0], np.count_nonzero(bad))
    return Sample(points_of(xy, z, sigma, shared), up, bad, rng)
