"""How well horizontal distances between adjusted ground points are known: accuracy within a site.

What all points share, a shift of the block, is not in a distance; its scale, its turn out of the
level and its bends are, so the joint covariance of both ends is needed and not that of each alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.tie_points import GroundPoints
from georef_gis.orient.adjustment.covariance import Covariances

# m
LENGTHS = (10.0, 50.0)
# pairs of points that stand for all of a length, and points among which they are looked for
PAIRS, AMONG = 30, 300
# share by which a pair may be shorter or longer
_REACH = 0.2
# fewer pairs are no median
_FEWEST = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceSigma:
    """One sigma of horizontal distances of about one length, m: the median over some pairs."""

    length_m: float
    sigma_m: float
    pairs: int


def distance_sigmas(
    points: GroundPoints, covariances: Covariances, lengths: Sequence[float] = LENGTHS
) -> tuple[DistanceSigma, ...]:
    """How well distances of each length are known; those that the site does not hold are left out.

    Parameters
    ----------
    points
        Tie points, counted as the covariances count them.
    lengths : m
    """
    # a third ray shows a wrong match; where few have one, those of two must do
    sound = np.all(np.isfinite(points.p_enu), axis=1) & np.all(
        np.isfinite(points.covariance), axis=(1, 2)
    )
    sure = np.flatnonzero(sound & (points.rays >= 3))
    usable = sure if len(sure) >= PAIRS else np.flatnonzero(sound)
    out = []
    for length in lengths:
        pairs = usable[pairs_at(points.p_enu[usable], length)]
        if len(pairs) < _FEWEST:
            continue
        sigma = float(np.nanmedian(pair_sigmas(points.p_enu, pairs, covariances)))
        if np.isfinite(sigma):
            out.append(DistanceSigma(length_m=length, sigma_m=sigma, pairs=len(pairs)))
    return tuple(out)


def pairs_at(p_enu: Array, length: float) -> NDArray[np.int64]:
    """Up to `PAIRS` pairs of points about `length` m apart on the map; indices, shape (k, 2)."""
    rng = np.random.default_rng(0)
    some = rng.permutation(len(p_enu))[:AMONG]
    xy = p_enu[some, :2]
    apart = np.linalg.norm(xy[:, None] - xy, axis=2)
    near = np.abs(apart - length) <= _REACH * length
    found = np.argwhere(np.triu(near, 1))
    chosen = found[rng.permutation(len(found))[:PAIRS]]
    return np.asarray(some[chosen], dtype=np.int64).reshape(-1, 2)


def pair_sigmas(p_enu: Array, pairs: NDArray[np.int64], covariances: Covariances) -> Array:
    """One sigma of the horizontal distance of each pair, m; shape (k,).

    Parameters
    ----------
    p_enu : shape (n, 3), m
    pairs : shape (k, 2)
        Indices of points.
    """
    ends, at = np.unique(pairs, return_inverse=True)
    at = at.reshape(pairs.shape)
    joint = covariances.joint(points=[int(i) for i in ends])
    along = p_enu[pairs[:, 1], :2] - p_enu[pairs[:, 0], :2]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    rows = np.zeros((len(pairs), len(joint)))
    k = np.arange(len(pairs))
    for axis in range(2):
        rows[k, 3 * at[:, 0] + axis] = -along[:, axis]
        rows[k, 3 * at[:, 1] + axis] = along[:, axis]
    variance = np.einsum("ki,ij,kj->k", rows, joint, rows)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
