"""Matches of two photos: a coarse search that needs no pose, then a narrow one that it guides.

The coarse search compares the outstanding features of both photos, wherever they lie and however
they are turned, and asks which of these matches agree on one turn, scale and shift of the ground.
The narrow one compares every feature with those near the place where that geometry predicts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain
from georef_gis.orient.ties.features import Features

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

# features of each photo that the coarse search compares
COARSE = 1000
# rows of descriptors compared at once; keeps the table of products at 20 MB
ROWS = 1000
# squared length of a descriptor
UNIT = 512.0**2
# squared ratio of the distances to the best and to the second best descriptor
COARSE_RATIO = 0.85**2
GUIDED_RATIO = 0.85**2
# least product of descriptors of a guided match
LEAST_ALIKE = 0.72
# share of the ground's extent within which coarse matches agree
COARSE_TOLERANCE = 0.04
LEAST_COARSE = 8
# the scale of two photos may differ from the prediction by this factor
SCALE_RANGE = 5.0
# rad, and factor, by which a feature's direction and size may differ from those predicted
ANGLE_TOLERANCE = np.radians(35.0)
SIZE_TOLERANCE = 1.7
# px of the reduced picture within which a match is sought about its predicted place
NARROW = (14.0, 70.0)
# px; features nearer than this are one
SAME_PLACE = 2.0
# tan of the angle from the axis beyond which a plane no longer stands for the picture
WIDEST = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Features of one photo with their places.

    Parameters
    ----------
    plane : shape (n, 2), px of the reduced picture
        Undistorted, from the principal point; NaN beyond `WIDEST`.
    ground : shape (n, 2), m
        Place on the ground by the pose, east and north; NaN where the ray misses.
    focal : px of the reduced picture
        Of `plane`.
    extent : m
        Diagonal of what the features' places cover, but for the outermost of them.
    position : shape (3,), m
        Projection centre.
    height : m
        Of the camera above the ground.
    """

    features: Features
    plane: Array
    ground: Array
    focal: float
    extent: float
    position: Array
    height: float

    @property
    def usable(self) -> Mask:
        """Features with both places; shape (n,)."""
        return np.asarray(np.isfinite(self.plane[:, 0]) & np.isfinite(self.ground[:, 0]))


def sight_of(photo: OrientedPhoto, features: Features, terrain: Terrain, height: float) -> Sight:
    """Features of a photo placed in its undistorted picture and on the ground."""
    focal = photo.camera.fx * features.scale
    d = photo.camera.ray(features.uv)
    with np.errstate(invalid="ignore", divide="ignore"):
        plane = focal * d[:, :2] / d[:, 2:]
        seen = (d[:, 2] > 0) & (np.hypot(plane[:, 0], plane[:, 1]) < WIDEST * focal)
    plane = np.where(seen[:, None], plane, np.nan)
    try:
        origin, ray = photo.rays(features.uv)
        ground = terrain.intersect(origin, ray)[:, :2]
    except GeometryError:
        ground = np.full_like(plane, np.nan)
    if not np.any(np.isfinite(ground)):
        ray = photo.pose.enu_directions(d)
        with np.errstate(invalid="ignore", divide="ignore"):
            down = np.where(ray[:, 2:] < -0.1, ray[:, :2] / -ray[:, 2:], np.nan)
        ground = photo.pose.origin_enu[:2] + height * down
    ok = np.isfinite(ground[:, 0])
    spread = np.percentile(ground[ok], [5, 95], axis=0) if np.any(ok) else np.ones((2, 2))
    extent = float(max(np.hypot(*(spread[1] - spread[0])), 1e-3))
    return Sight(
        features=features,
        plane=plane,
        ground=ground,
        focal=focal,
        extent=extent,
        position=photo.pose.origin_enu,
        height=height,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coarse:
    """Result of the coarse search: matches that agree, and the homography of the planes."""

    a: Index
    b: Index
    candidates: int
    H: Array


def coarse_matches(a: Sight, b: Sight, *, deep: bool = False) -> Coarse | int:
    """Coarse matches of two photos, or how many candidates there were when they agree on nothing.

    Parameters
    ----------
    deep
        Compare all features: 25 times the work, for pairs of little overlap.
    """
    count = max(len(a.features), len(b.features)) if deep else COARSE
    ia = np.flatnonzero(a.usable)[:count]
    ib = np.flatnonzero(b.usable)[:count]
    if min(len(ia), len(ib)) < LEAST_COARSE:
        return 0
    i, j = mutual_best(a.features.descriptors[ia], b.features.descriptors[ib], COARSE_RATIO)
    ia, ib = ia[i], ib[j]
    n = len(ia)
    if n < LEAST_COARSE:
        return n
    agree = _agreeing_on_ground(a, b, ia, ib)
    if np.count_nonzero(agree) < LEAST_COARSE:
        return n
    ia, ib = ia[agree], ib[agree]
    H = _homography(a.plane[ia], b.plane[ib], 12.0)
    if H is None:
        return n
    alike = alike_in_turn_and_size(a, b, ia, ib, H) & (
        np.hypot(*(apply(H, a.plane[ia]) - b.plane[ib]).T) < 0.1 * b.focal
    )
    if np.count_nonzero(alike) < max(LEAST_COARSE, 0.02 * n):
        return n
    return Coarse(a=ia[alike], b=ib[alike], candidates=n, H=H)


def mutual_best(
    first: NDArray[np.uint8], second: NDArray[np.uint8], ratio: float
) -> tuple[Index, Index]:
    """Descriptors that are each other's best and pass the ratio test; indices of both."""
    A, B = first.astype(np.float32), second.astype(np.float32)
    m = len(B)
    best_a, good_a = np.zeros(len(A), dtype=np.intp), np.zeros(len(A), dtype=bool)
    best_b, top_b = np.zeros(m, dtype=np.intp), np.full(m, -1.0, dtype=np.float32)
    for start in range(0, len(A), ROWS):
        product = A[start : start + ROWS] @ B.T
        rows = np.arange(len(product))
        best = product.argmax(axis=1)
        top = product[rows, best]
        column = product.argmax(axis=0)
        value = product[column, np.arange(m)]
        better = value > top_b
        best_b[better], top_b[better] = column[better] + start, value[better]
        product[rows, best] = -1.0
        runner_up = product.max(axis=1)
        best_a[start : start + len(rows)] = best
        good_a[start : start + len(rows)] = (UNIT - top) < ratio * (UNIT - runner_up)
    i = np.flatnonzero(good_a & (best_b[best_a] == np.arange(len(A))))
    return i, best_a[i]


def _agreeing_on_ground(a: Sight, b: Sight, ia: Index, ib: Index) -> Mask:
    """Matches that one turn, scale and shift of the ground explains; shape (n,)."""
    origin = a.ground[ia].mean(axis=0)
    tolerance = COARSE_TOLERANCE * 0.5 * (a.extent + b.extent)
    S, inside = cv2.estimateAffinePartial2D(
        a.ground[ia] - origin,
        b.ground[ib] - origin,
        method=cv2.RANSAC,
        ransacReprojThreshold=tolerance,
        maxIters=3000,
        confidence=0.999,
    )
    if S is None or not 1.0 / SCALE_RANGE < np.hypot(S[0, 0], S[1, 0]) < SCALE_RANGE:
        return np.zeros(len(ia), dtype=bool)
    return np.asarray(inside.ravel() > 0)


def _homography(p: Array, q: Array, threshold: float) -> Array | None:
    """Homography of planes from matches, or a similarity where they are too few for one."""
    if len(p) >= 12:
        H, inside = cv2.findHomography(p, q, cv2.USAC_MAGSAC, threshold, None, 2000, 0.999)
        if (
            H is not None
            and np.count_nonzero(inside) >= 0.5 * len(p)
            and _is_tame(np.asarray(H, float), p)
        ):
            return np.asarray(H / H[2, 2])
    S, _ = cv2.estimateAffinePartial2D(
        p, q, method=cv2.RANSAC, ransacReprojThreshold=3.0 * threshold
    )
    return None if S is None else np.vstack([S, [0.0, 0.0, 1.0]])


def _is_tame(H: Array, p: Array) -> bool:
    """Whether a homography neither mirrors nor blows up where the points are."""
    jacobian = jacobians(H, p)
    det = np.linalg.det(jacobian)
    return bool(np.all(det > 0) and det.max() < 30.0 * det.min())


def apply(H: Array, p: Array) -> Array:
    """Points mapped by a homography; shape (n, 2)."""
    q = p @ H[:, :2].T + H[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(q[:, :2] / q[:, 2:])


def jacobians(H: Array, p: Array) -> Array:
    """Derivatives of a homography at points; shape (n, 2) -> (n, 2, 2)."""
    w = p @ H[2, :2] + H[2, 2]
    q = apply(H, p)
    J = H[None, :2, :2] - q[:, :, None] * H[None, 2:3, :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(J / w[:, None, None])


def alike_in_turn_and_size(a: Sight, b: Sight, ia: Index, ib: Index, H: Array) -> Mask:
    """Whether features differ in direction and size as a homography says; shape (n,)."""
    # Once for every feature: there are many times as many pairs of them.
    J = jacobians(H, a.plane)
    angle = a.features.angle
    u, v = np.cos(angle), np.sin(angle)
    with np.errstate(invalid="ignore"):
        size = np.sqrt(np.abs(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]))
        size = size * a.features.size
        turned = np.arctan2(J[:, 1, 0] * u + J[:, 1, 1] * v, J[:, 0, 0] * u + J[:, 0, 1] * v)
    off = np.abs((turned[ia] - b.features.angle[ib] + np.pi) % (2 * np.pi) - np.pi)
    ratio = size[ia] / b.features.size[ib]
    inside = (ratio < SIZE_TOLERANCE) & (ratio > 1.0 / SIZE_TOLERANCE)
    return np.asarray((off < ANGLE_TOLERANCE) & inside)


def lean_of(a: Sight, b: Sight, relief: float) -> float:
    """How far, px of the reduced picture, what stands on the ground leans between two photos.

    A point of `relief` times the height of flight moves by that share of the base's picture.
    """
    base = float(np.hypot(*(a.position - b.position)[:2]))
    return relief * base * b.focal / b.height


def guided_matches(
    a: Sight, b: Sight, coarse: Coarse, *, lean: float
) -> tuple[Index, Index, Array]:
    """All matches near the places that a coarse geometry predicts.

    Parameters
    ----------
    lean : px of the reduced picture
        How far what stands on the ground may lie from its place on the plane.

    Returns
    -------
    ia, ib : shape (m,)
        Indices of the features.
    H : shape (3, 3)
        Homography of the planes, from these matches.
    """
    H, start = coarse.H, np.hypot(*(apply(coarse.H, a.plane[coarse.a]) - b.plane[coarse.b]).T)
    reach = float(np.clip(3.0 * np.median(start) + 0.5 * lean, *NARROW))
    ia, ib = _match_near(a, b, H, reach)
    if len(ia) >= 12:
        again = _homography(a.plane[ia], b.plane[ib], 4.0)
        if again is not None:
            residual = np.hypot(*(apply(again, a.plane[ia]) - b.plane[ib]).T)
            reach = float(np.clip(4.0 * np.median(residual) + 0.25 * lean, *NARROW))
            H = again
            ia, ib = _match_near(a, b, H, reach)
    return ia, ib, H


def _match_near(a: Sight, b: Sight, H: Array, reach: float) -> tuple[Index, Index]:
    """Features that are each other's best within reach of the predicted place."""
    ka, kb = np.flatnonzero(a.usable), np.flatnonzero(b.usable)
    predicted = apply(H, a.plane[ka])
    low, high = b.plane[kb].min(axis=0) - reach, b.plane[kb].max(axis=0) + reach
    inside = np.all((predicted >= low) & (predicted <= high), axis=1)
    ka, predicted = ka[inside], predicted[inside]
    if not len(ka):
        return ka, ka
    found = cKDTree(predicted).sparse_distance_matrix(
        cKDTree(b.plane[kb]), reach, output_type="ndarray"
    )
    i, j = ka[found["i"]], kb[found["j"]]
    alike = alike_in_turn_and_size(a, b, i, j, H)
    i, j = i[alike], j[alike]
    product = products(a.features, b.features, i, j)
    return best_of_both(i, j, product, b.plane)


def products(a: Features, b: Features, i: Index, j: Index) -> Array:
    """Products of pairs of descriptors, 1 for equal ones; shape (m,)."""
    A, B = a.descriptors, b.descriptors
    out = np.empty(len(i), dtype=np.float32)
    for start in range(0, len(i), 20_000):
        part = slice(start, start + 20_000)
        out[part] = np.einsum(
            "nk,nk->n", A[i[part]].astype(np.float32), B[j[part]].astype(np.float32)
        )
    return np.asarray(out / UNIT, dtype=np.float64)


def best_of_both(i: Index, j: Index, product: Array, place: Array) -> tuple[Index, Index]:
    """Pairs that are the best of both, and better than the next elsewhere by the ratio."""
    if not len(i):
        return i, j
    order = np.lexsort((-product, i))
    i, j, product = i[order], j[order], product[order]
    start = np.flatnonzero(np.r_[True, i[1:] != i[:-1]])
    rank_of = np.repeat(start, np.diff(np.r_[start, len(i)]))
    # The runner-up at the same place is the same feature with another direction.
    elsewhere = np.hypot(*(place[j] - place[j[rank_of]]).T) > SAME_PLACE
    second = np.maximum.reduceat(np.where(elsewhere, product, -1.0), start)
    best_i, best_j, top = i[start], j[start], product[start]
    best_of_j = np.full(int(j.max()) + 1, -1.0)
    np.maximum.at(best_of_j, j, product)
    good = (top >= best_of_j[best_j]) & (top > LEAST_ALIKE)
    good &= (1.0 - top) < GUIDED_RATIO * (1.0 - second)
    return best_i[good], best_j[good]
