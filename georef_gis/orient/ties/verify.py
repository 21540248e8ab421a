"""Which matches of a pair the geometry of two views allows, and which pairs their neighbours do."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from georef_gis.frames import Array
from georef_gis.orient.ties.epipolar import (
    TOLERANCE,
    epipolar_geometry,
    line_distance,
    matches_along_lines,
    supported,
)
from georef_gis.orient.ties.matching import Index, Mask, Sight, apply

# px of the reduced picture; how far a match may lie off the ground that its neighbours show
RELIEF_TOLERANCE = 6.0
NEIGHBOURS = 9
# share of the guided matches that must be verified: of wrong pairs few agree with each other
LEAST_SHARE = 0.2
# share of the verified matches that one homography must explain for a plane
PLANE_SHARE = 0.9
# rad, and log of the scale, by which a loop of three photos may fail to close
LOOP_TURN = np.radians(10.0)
LOOP_SCALE = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verified:
    """Verified matches of a pair.

    Parameters
    ----------
    a, b : shape (m,)
        Indices of the features.
    geometry
        ``"plane"`` or ``"parallax"``.
    residual : px of the reduced picture
        Median distance from the epipolar line.
    similarity : complex
        Turn and scale of the second photo's ground to the first's: `g_a = similarity * g_b + shift`
        with east + i north.
    middle : shape (2, 2), m
        Mean place of the matches on the ground by the pose of the first and of the second photo.
    """

    a: Index
    b: Index
    geometry: str
    residual: float
    similarity: complex
    middle: Array


def verified_matches(
    a: Sight, b: Sight, ia: Index, ib: Index, H: Array, *, lean: float, least: int
) -> Verified | str:
    """Matches that lie on epipolar lines and beside their neighbours, or why there are none.

    Parameters
    ----------
    ia, ib : shape (m,)
        Matches of the guided search.
    H : shape (3, 3)
        Homography of the planes.
    lean : px of the reduced picture
        How far what stands on the ground may lie from its place on the plane.
    """
    n = len(ia)
    if n < least:
        return f"{n} matches, {least} are needed"
    near = _beside_neighbours(a.plane[ia], b.plane[ib])
    ia, ib = ia[near], ib[near]
    if len(ia) < least:
        return f"{len(ia)} of {n} matches hang together, {least} are needed"
    F, inside = epipolar_geometry(a, b, ia, ib)
    ia, ib = ia[inside], ib[inside]
    if len(ia) < max(least, LEAST_SHARE * n):
        return f"{len(ia)} of {n} matches fit two views"
    ia, ib, F = _with_what_stands(a, b, ia, ib, F, H, lean)
    p, q = a.plane[ia], b.plane[ib]
    _, flat = cv2.findHomography(p, q, cv2.USAC_MAGSAC, TOLERANCE, None, 500, 0.99)
    plane = flat is not None and np.count_nonzero(flat) >= PLANE_SHARE * len(ia)
    return Verified(
        a=ia,
        b=ib,
        geometry="plane" if plane else "parallax",
        residual=float(np.median(line_distance(F, p, q))),
        similarity=_similarity(b.ground[ib], a.ground[ia]),
        middle=np.stack([a.ground[ia].mean(axis=0), b.ground[ib].mean(axis=0)]),
    )


def _with_what_stands(
    a: Sight, b: Sight, ia: Index, ib: Index, F: Array, H: Array, lean: float
) -> tuple[Index, Index, Array]:
    """Matches of the ground with those of what stands on it; the same where these bring none."""
    ja, jb = matches_along_lines(a, b, F, H, lean)
    if len(ja) <= len(ia):
        return ia, ib, F
    good = supported(H, a.plane[ja], b.plane[jb])
    ja, jb = ja[good], jb[good]
    if len(ja) <= len(ia):
        return ia, ib, F
    G, inside = epipolar_geometry(a, b, ja, jb)
    if np.count_nonzero(inside) <= len(ia):
        return ia, ib, F
    return ja[inside], jb[inside], G


def _beside_neighbours(p: Array, q: Array) -> Mask:
    """Matches whose way off the common plane is that of most of their neighbours; shape (n,)."""
    H, _ = cv2.findHomography(p, q, cv2.USAC_MAGSAC, 6.0, None, 1000, 0.999)
    if H is None:
        return np.zeros(len(p), dtype=bool)
    off = q - apply(np.asarray(H, dtype=float), p)
    near = cKDTree(p).query(p, k=min(NEIGHBOURS, len(p)))[1]
    middle = np.median(off[near], axis=1)
    spread = np.median(np.abs(off[near] - middle[:, None]), axis=1).max(axis=1)
    far = np.hypot(*(off - middle).T)
    # Where even the neighbours differ the ground is rough, or the matches are chance.
    return np.asarray((far < RELIEF_TOLERANCE + spread) & (spread < RELIEF_TOLERANCE))


def _similarity(p: Array, q: Array) -> complex:
    """Turn and scale that lays p on q in least squares, as a complex number; shapes (n, 2)."""
    z = (p - p.mean(axis=0)) @ np.array([1.0, 1.0j])
    w = (q - q.mean(axis=0)) @ np.array([1.0, 1.0j])
    return complex(np.vdot(z, w) / max(np.vdot(z, z).real, 1e-12))


def against_the_loops(
    similarities: Mapping[tuple[int, int], complex], inliers: Mapping[tuple[int, int], int]
) -> list[tuple[int, int]]:
    """Pairs that mostly break the loops of three photos they stand in.

    A false match of look-alikes (crop rows, parked cars) turns or scales its two photos otherwise
    than the way by a third photo does.
    """
    good: dict[tuple[int, int], int] = defaultdict(int)
    bad: dict[tuple[int, int], int] = defaultdict(int)
    for pairs, closes in _loops(similarities):
        # Of a loop that does not close the pair of fewest matches is the likeliest to be wrong.
        for pair in pairs if closes else [min(pairs, key=lambda p: inliers[p])]:
            (good if closes else bad)[pair] += 1
    return [pair for pair in bad if bad[pair] > good[pair]]


def _loops(
    similarities: Mapping[tuple[int, int], complex],
) -> Sequence[tuple[list[tuple[int, int]], bool]]:
    neighbours: dict[int, set[int]] = defaultdict(set)
    for i, j in similarities:
        neighbours[i].add(j)
    out = []
    for (i, j), first in similarities.items():
        for k in sorted(neighbours[i] & neighbours[j]):
            closure = first * similarities[j, k] / similarities[i, k]
            closes = abs(np.angle(closure)) < LOOP_TURN and abs(np.log(abs(closure))) < LOOP_SCALE
            out.append(([(i, j), (j, k), (i, k)], bool(closes)))
    return out
