"""Epipolar geometry of two photos, and the matches along its lines.

The first guided search follows the ground as a plane. Crowns of trees and roofs lie off it, but on
the epipolar lines: the second search goes along these as far as what stands on the ground may lean.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from georef_gis.frames import Array
from georef_gis.orient.ties.matching import (
    Index,
    Mask,
    Sight,
    alike_in_turn_and_size,
    apply,
    best_of_both,
    products,
)

# px of the reduced picture: distance of a match from its epipolar line
TOLERANCE = 1.2
# px; the same while the geometry is not final
LOOSE = 3.0
# px; longest search along a line
LONGEST = 120.0
# share of the fundamental matrix' inliers at which the essential matrix is preferred
CALIBRATED_SHARE = 0.8
# a match needs SUPPORT of its NEIGHBOURS with a like way off the plane, px
SUPPORT, NEIGHBOURS, LIKE_WAY = 2, 9, 8.0


def epipolar_geometry(a: Sight, b: Sight, ia: Index, ib: Index) -> tuple[Array, Mask]:
    """Fundamental matrix of the planes (`q^T F p = 0`) and its inliers; zero if there is none.

    Ground is nearly a plane, for which seven points tell no fundamental matrix; five calibrated
    rays tell an essential one. The former is taken only where the camera does not fit.
    """
    p, q = a.plane[ia], b.plane[ib]
    F_best: Array = np.zeros((3, 3))
    best: Mask = np.zeros(len(p), dtype=bool)
    E, inside = cv2.findEssentialMat(
        p / a.focal, q / b.focal, np.eye(3), cv2.USAC_MAGSAC, 0.999, TOLERANCE / a.focal
    )
    if E is not None and E.shape == (3, 3):
        F_best = np.asarray(np.diag([1, 1, b.focal]) @ E @ np.diag([1, 1, a.focal]), dtype=float)
        best = inside.ravel() > 0
    if np.count_nonzero(best) < CALIBRATED_SHARE * len(p):
        F, inside = cv2.findFundamentalMat(p, q, cv2.USAC_MAGSAC, TOLERANCE, 0.999, 2000)
        if F is not None and F.shape == (3, 3):
            good = inside.ravel() > 0
            if np.count_nonzero(best) < CALIBRATED_SHARE * np.count_nonzero(good):
                F_best, best = np.asarray(F, dtype=float), good
    return F_best, best & (line_distance(F_best, p, q) < 2.0 * TOLERANCE)


def line_distance(F: Array, p: Array, q: Array) -> Array:
    """Sampson's distance of matches from their epipolar lines, px; shapes (n, 2) -> (n,)."""
    one = np.ones((len(p), 1))
    x, y = np.hstack([p, one]), np.hstack([q, one])
    Fx, Fy = x @ F.T, y @ F
    norm = np.sqrt(np.sum(Fx[:, :2] ** 2, axis=1) + np.sum(Fy[:, :2] ** 2, axis=1))
    return np.asarray(np.abs(np.sum(y * Fx, axis=1)) / np.maximum(norm, 1e-12))


def matches_along_lines(a: Sight, b: Sight, F: Array, H: Array, lean: float) -> tuple[Index, Index]:
    """Matches near the epipolar lines, at most `lean` px from where the ground's plane puts them.

    None where the epipole lies in or near the picture: there lines have no common direction.
    """
    none = np.zeros(0, dtype=np.intp)
    epipole = np.linalg.svd(F.T)[2][-1]
    ka, kb = np.flatnonzero(a.usable), np.flatnonzero(b.usable)
    q = b.plane[kb]
    scale = np.abs(q).max()
    if abs(epipole[2]) * scale * 1.3 > np.hypot(epipole[0], epipole[1]):
        return none, none
    lean = float(np.clip(lean, 10.0, LONGEST))
    predicted = apply(H, a.plane[ka])
    low, high = q.min(axis=0) - lean, q.max(axis=0) + lean
    inside = np.all((predicted >= low) & (predicted <= high), axis=1)
    ka, predicted = ka[inside], predicted[inside]
    if not len(ka):
        return none, none
    # Across and along the lines through the epipole; the search is an ellipse made round.
    across, along = _across_and_along(np.concatenate([predicted, q]), epipole)
    places = np.stack([across, along * (2.0 * LOOSE / lean)], axis=1)
    n = len(ka)
    found = cKDTree(places[:n]).sparse_distance_matrix(
        cKDTree(places[n:]), 2.0 * LOOSE, output_type="ndarray"
    )
    i, j = ka[found["i"]], kb[found["j"]]
    near = line_distance(F, a.plane[i], b.plane[j]) < LOOSE
    i, j = i[near], j[near]
    alike = alike_in_turn_and_size(a, b, i, j, H)
    i, j = i[alike], j[alike]
    return best_of_both(i, j, products(a.features, b.features, i, j), b.plane)


def _across_and_along(p: Array, epipole: Array) -> tuple[Array, Array]:
    """Coordinates of points across and along the lines through an epipole, px; shapes (n,).

    Across is the angle of the line times the mean distance from the epipole; for one at infinity
    that is the distance from a common line.
    """
    e = epipole / np.hypot(epipole[0], epipole[1])
    # From the epipole e / e_z to a point, times e_z, so that infinity is no exception.
    away = p * e[2] - e[:2]
    normal = np.array([-e[1], e[0]])
    t = -(away @ e[:2])
    angle = np.arctan2(away @ normal, t)
    reach = np.hypot(away[:, 0], away[:, 1])
    if abs(e[2]) < 1e-9:
        return p @ normal, p @ e[:2]
    return angle * np.median(reach) / e[2], reach / e[2]


def supported(H: Array, p: Array, q: Array) -> Mask:
    """Matches with neighbours that leave the plane likewise; shape (n,)."""
    if len(p) <= SUPPORT:
        return np.zeros(len(p), dtype=bool)
    off = q - apply(H, p)
    near = cKDTree(p).query(p, k=min(NEIGHBOURS + 1, len(p)))[1][:, 1:]
    like = np.hypot(*np.moveaxis(off[near] - off[:, None], -1, 0)) < LIKE_WAY
    return np.asarray(np.count_nonzero(like, axis=1) >= SUPPORT)
