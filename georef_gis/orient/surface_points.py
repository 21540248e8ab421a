"""Adjusted points as heights: which are usable, which are blunders, and how they scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from georef_gis.frames import Array
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import EnuPlane

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

# points beyond this are left out evenly: a ground of 1 km^2 has one every 3.5 m then
MOST_POINTS = 80_000
# m; points nearer than this are one
SAME_PLACE = 1e-3
# neighbours whose plane a point must fit
NEIGHBOURS = 16
# standard deviations beyond which a point is a blunder; one in 150 000 of a normal sample is
BLUNDER = 4.5
# looks for blunders, each without those of the one before
PASSES = 4
# m; no point is taken for better than this
FLOOR = 0.005
# one sigma of the slope of a neighbourhood: it settles those whose points lie on a line
LOCAL_SLOPE = 0.5
# share of the stated variance below which the scatter shows that points err together
SHARED_BELOW = 0.8
# rounds of a robust fit
ROUNDS = 4
# points taken at once: small enough for a processor's cache
CHUNK = 2_000


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Heights over the project's plane.

    Parameters
    ----------
    xy : shape (n, 2), m
    h : shape (n,), m
        Above the ellipsoid.
    sigma : shape (n,), m
        One standard deviation of each height, as stated or, from `scattered`, its own share.
    """

    xy: Array
    h: Array
    sigma: Array

    def __len__(self) -> int:
        """Number of points."""
        return len(self.h)

    def part(self, keep: Mask | Indices) -> Cloud:
        """Those points."""
        return Cloud(self.xy[keep], self.h[keep], self.sigma[keep])


def cloud_of(points: GroundPoints, frame: EnuPlane) -> Cloud:
    """Points that can be used, at most `MOST_POINTS`, one per place."""
    with np.errstate(invalid="ignore"):
        variance = np.diagonal(points.covariance, axis1=1, axis2=2)
        usable = np.isfinite(points.p_enu).all(axis=1) & np.isfinite(variance).all(axis=1)
        usable &= (variance > 0).all(axis=1)
    p, variance = points.p_enu[usable], variance[usable]
    if len(p) > MOST_POINTS:
        some = np.sort(np.random.default_rng(0).permutation(len(p))[:MOST_POINTS])
        p, variance = p[some], variance[some]
    on_plane = frame.map_from_enu(p)
    sigma = np.maximum(np.sqrt(variance[:, 2]), FLOOR)
    return _merged(Cloud(on_plane[:, :2], on_plane[:, 2], sigma))


def _merged(cloud: Cloud) -> Cloud:
    """One point for those of one place: the best of them, a mean would take a blunder in."""
    if not len(cloud):
        return cloud
    order = np.argsort(cloud.sigma, kind="stable")
    places = np.round(cloud.xy[order] / SAME_PLACE)
    _, first = np.unique(places, axis=0, return_index=True)
    return cloud.part(np.sort(order[first]))


# -- neighbourhoods ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class LocalFit:
    """Planes through neighbourhoods.

    Parameters
    ----------
    h : shape (n,), m
        Height of the plane at the place.
    variance : shape (n,), m^2
        Of that height by the points' own sigmas, as if these were independent.
    scatter : shape (n,), m
        Robust standard deviation of the neighbours about the plane.
    """

    h: Array
    variance: Array
    scatter: Array


def local_planes(
    cloud: Cloud, xy: Array, k: int, *, without_self: bool = False, robust: bool = False
) -> LocalFit:
    """Planes through the k nearest points of places, nearer ones weighing more.

    Parameters
    ----------
    xy : shape (m, 2), m
    without_self
        `xy` are the cloud's own places: each is judged by the others.
    robust
        Outlying neighbours do not count (Tukey's biweight about the median).
    """
    tree = cKDTree(cloud.xy)
    k = min(k, len(cloud) - int(without_self))
    parts = []
    for first in range(0, len(xy), CHUNK):
        places = xy[first : first + CHUNK]
        _, near = tree.query(places, k=k + int(without_self))
        near = near.reshape(len(places), -1)
        if without_self:
            near = _others(near, np.arange(first, first + len(places)))
        parts.append(_fit(cloud, places, near, robust))
    return LocalFit(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _others(near: Indices, own: Indices) -> Indices:
    """Neighbours without the point itself; the farthest where it is not among them."""
    is_own = near == own[:, None]
    is_own[~is_own.any(axis=1), -1] = True
    return np.asarray(near[~is_own].reshape(len(near), -1))


def _fit(cloud: Cloud, xy: Array, near: Indices, robust: bool) -> tuple[Array, Array, Array]:
    d = cloud.xy[near] - xy[:, None]
    h, variance = cloud.h[near], cloud.sigma[near] ** 2
    width = np.maximum(np.hypot(d[..., 0], d[..., 1]).max(axis=1) * 1.05, SAME_PLACE)
    far = np.hypot(d[..., 0], d[..., 1]) / width[:, None]
    X = np.concatenate([np.ones((*near.shape, 1)), d / width[:, None, None]], axis=-1)
    XT = np.ascontiguousarray(X.transpose(0, 2, 1))
    level = np.median(h, axis=1)
    y = h - level[:, None]
    base = (1.0 - far**3) ** 3 / variance
    slope_weight = 1.0 / (LOCAL_SLOPE * width) ** 2
    r = y
    for _ in range(ROUNDS if robust else 1):
        keep = _biweight(r, variance) if robust else 1.0
        WX = X * (base * keep)[..., None]
        N = XT @ WX
        N[:, 1, 1] += slope_weight
        N[:, 2, 2] += slope_weight
        N[:, 0, 0] += 1e-12 / variance.mean(axis=1)
        inverse = np.linalg.inv(N)
        beta = inverse @ (WX.transpose(0, 2, 1) @ y[..., None])
        r = y - (X @ beta)[..., 0]
    scatter = _scale(r) * np.sqrt(near.shape[1] / max(near.shape[1] - 3, 1))
    lever = (WX @ inverse[:, 0, :, None])[..., 0]
    return beta[:, 0, 0] + level, np.sum(lever**2 * variance, axis=1), scatter


def _scale(r: Array) -> Array:
    """Normal-consistent scale of residuals about zero, per row."""
    return np.asarray(1.4826 * np.median(np.abs(r), axis=-1))


def _biweight(r: Array, variance: Array) -> Array:
    """Weights of residuals about their median: 0 beyond 6 robust standard deviations."""
    centred = r - np.median(r, axis=-1, keepdims=True)
    scale = np.maximum(_scale(centred)[..., None], np.sqrt(variance) * 0.05 + FLOOR)
    return np.asarray(np.clip(1.0 - (centred / (6.0 * scale)) ** 2, 0.0, None) ** 2)


# -- blunders and scatter ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Scattered:
    """Points without blunders, with the share of their sigmas that is their own.

    `shared` is one sigma, m, of what moves a neighbourhood as one; `blunders` counts those left
    out.
    """

    cloud: Cloud
    shared: float
    blunders: int


def without_blunders(cloud: Cloud) -> Scattered:
    """Leave out points that stand off their neighbourhood's plane, and tell how the rest scatter.

    A treetop, a vehicle and a mismatch stand off; a bank and a roof that many points show scatter
    their own neighbourhoods, and stay.
    """
    n = len(cloud)
    for _ in range(PASSES):
        fit = local_planes(cloud, cloud.xy, NEIGHBOURS, without_self=True, robust=True)
        off = cloud.h - fit.h
        own = _own_sigma(cloud.sigma, off)[0]
        usual = np.median(own)
        spread = np.hypot(fit.scatter, np.sqrt(np.clip(own**2 - usual**2, 0.0, None)))
        bad = np.abs(off) > BLUNDER * np.maximum(spread, FLOOR)
        bad |= _spikes(cloud, off, np.maximum(spread, FLOOR))
        if not bad.any() or np.count_nonzero(~bad) <= NEIGHBOURS:
            break
        cloud = cloud.part(~bad)
    fit = local_planes(cloud, cloud.xy, NEIGHBOURS, without_self=True, robust=True)
    own, shared = _own_sigma(cloud.sigma, cloud.h - fit.h)
    return Scattered(Cloud(cloud.xy, cloud.h, own), shared, n - len(cloud))


def _spikes(cloud: Cloud, off: Array, spread: Array) -> Mask:
    """Points that all of their nearest six look up (or down) to at 45 degrees or more."""
    k = min(7, len(cloud))
    distance, near = cKDTree(cloud.xy).query(cloud.xy, k=k)
    near = _others(near, np.arange(len(cloud)))
    rise = cloud.h[:, None] - cloud.h[near]
    steep = np.abs(rise) > distance[:, 1:]
    one_way = np.all(rise > 0, axis=1) | np.all(rise < 0, axis=1)
    # among noisy points 45 degrees over a short distance are no more than noise
    return np.asarray(steep.all(axis=1) & one_way & (np.abs(off) > 3.0 * spread))


def _own_sigma(sigma: Array, off: Array) -> tuple[Array, float]:
    # a plane of 16 points adds about a fifth to the variance of the point itself
    return own_share(sigma, float(_scale(off)) ** 2 / 1.2, freedom=float(len(off)))


def own_share(sigma: Array, seen: float, *, freedom: float) -> tuple[Array, float]:
    """Own share of the points' sigmas, m, and the one that they share, from their scatter.

    Stated covariances hold the poses' errors, which move neighbours together: what neighbours do
    not scatter is shared.

    Parameters
    ----------
    seen : m^2
        Variance that the points scatter by.
    freedom
        Degrees of freedom of that.
    """
    stated = float(np.median(sigma**2))
    # the 5 % point of chi-square over its degrees of freedom (Wilson & Hilferty 1931)
    t = 2.0 / (9.0 * freedom)
    if seen >= min(SHARED_BELOW, max(1.0 - t - 1.645 * t**0.5, 0.0) ** 3) * stated:
        return sigma, 0.0
    shared = stated - seen
    own = np.sqrt(np.maximum(sigma**2 - shared, np.minimum(seen, sigma**2)))
    return np.maximum(own, FLOOR), float(np.sqrt(shared))
