"""A plane through ground points, robust, its tilt held by what ground usually does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.orient.surface_points import FLOOR, Cloud, Scattered, own_share

# one sigma of the ground's slope along x and along y, where the points say nothing
SLOPE_SIGMA = 0.05
# no plane is tilted more; points that say so lie on one line, or on a wall
STEEPEST = 0.5
# m, one sigma of the ground about its plane before any point is seen, and what points this weighs
RELIEF_SIGMA, RELIEF_WEIGHT = 0.7, 3.0
# witnesses that one point counts for: its neighbours stand on the same hump
WITNESS = 0.5
# standard deviations beyond which a point does not count
CUT = 5.0
ITERATIONS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """h = level + slope . (xy - centre).

    Parameters
    ----------
    coefficients, covariance : shape (3,), (3, 3)
        (level m, slope along x, along y) and their covariance.
    relief : m
        One standard deviation of the ground about the plane.
    used : shape (n,)
        Which of the points count.
    """

    centre: Array
    coefficients: Array
    covariance: Array
    relief: float
    used: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    limited: bool

    def at(self, xy: Array) -> Array:
        """Height, m, at places; (..., 2) m -> (...)."""
        return np.asarray(_terms(xy - self.centre) @ self.coefficients)

    def sigma_at(self, xy: Array) -> Array:
        """One sigma, m, of the ground at places: of the plane, and of the ground about it."""
        t = _terms(xy - self.centre)
        return np.asarray(
            np.sqrt(np.einsum("...i,ij,...j->...", t, self.covariance, t) + self.relief**2)
        )


def _terms(d: Array) -> Array:
    return np.concatenate([np.ones((*d.shape[:-1], 1)), d], axis=-1)


def fit_plane(cloud: Cloud) -> Plane:
    """Plane through one point or more; with few the slope stays near zero.

    Notes
    -----
    Tukey's biweight, from the median height and no slope on; the ground's relief about the plane is
    estimated beside it and weighs as `RELIEF_WEIGHT` points of `RELIEF_SIGMA` would.
    """
    centre = np.median(cloud.xy, axis=0)
    X = _terms(cloud.xy - centre)
    level = float(np.median(cloud.h))
    y = cloud.h - level
    prior = np.diag([0.0, SLOPE_SIGMA**-2, SLOPE_SIGMA**-2])
    beta, relief = np.zeros(3), RELIEF_SIGMA
    covariance, keep = np.eye(3), np.ones(len(y))
    for i in range(ITERATIONS):
        r = y - X @ beta
        relief = _relief(r, cloud.sigma, keep, first=i == 0)
        spread = np.sqrt(cloud.sigma**2 + relief**2)
        if len(y) > 3:
            wide = max(1.0, float(1.4826 * np.median(np.abs(r / spread))))
            keep = np.clip(1.0 - (r / (CUT * wide * spread)) ** 2, 0.0, None) ** 2
        W = keep / spread**2
        covariance = np.linalg.inv(X.T @ (W[:, None] * X) + prior)
        before, beta = beta, covariance @ (X.T @ (W * y))
        if np.abs(before - beta).max() < 1e-6 and i > 3:
            break
    slope = float(np.hypot(*beta[1:]))
    if slope > STEEPEST:
        beta[1:] *= STEEPEST / slope
    return Plane(
        centre=centre,
        coefficients=np.array([level + beta[0], beta[1], beta[2]]),
        covariance=covariance / WITNESS,
        relief=relief,
        used=keep > 0.0,
        limited=slope > STEEPEST,
    )


def _relief(r: Array, sigma: Array, keep: Array, *, first: bool) -> float:
    """One sigma of the ground about its plane, m."""
    if first:
        return max(float(1.4826 * np.median(np.abs(r))), RELIEF_SIGMA)
    excess = np.sum(keep * (r**2 - sigma**2))
    # three points are spent on the plane itself
    weight = max(float(keep.sum()) - 3.0, 0.0)
    share = weight / max(float(keep.sum()), 1e-9)
    found = RELIEF_WEIGHT * RELIEF_SIGMA**2 + max(float(excess), 0.0)
    return max(float(np.sqrt(found / (RELIEF_WEIGHT + weight))) if share else RELIEF_SIGMA, FLOOR)


def few_points(cloud: Cloud) -> Scattered:
    """Points that are too few for neighbourhoods, with what their scatter about a plane says.

    Of less than five it says nothing: what the best of them is off may be common to all.
    """
    if len(cloud) < 5:
        shared = float(cloud.sigma.min())
        own = np.sqrt(np.maximum(cloud.sigma**2 - shared**2, FLOOR**2))
        return Scattered(Cloud(cloud.xy, cloud.h, own), shared, 0)
    plane = fit_plane(cloud)
    r = (cloud.h - plane.at(cloud.xy))[plane.used]
    freedom = max(len(r) - 2.0, 1.0)
    own, shared = own_share(cloud.sigma, float(np.sum(r**2)) / freedom, freedom=freedom)
    return Scattered(Cloud(cloud.xy, cloud.h, own), shared, 0)
