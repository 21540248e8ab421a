"""Photos whose tags put them in a wrong place, found on the ground before anything is adjusted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve

from georef_gis.frames import Array
from georef_gis.orient.adjustment.problem import Problem, State

# sigmas beyond which a photo is in a wrong place, and photos that must say so
FAR, WITNESSES = 6.0, 2
# matches of two photos below which they say nothing
FEWEST = 8
# of the height above ground: how far relief, tilt and heading move the ground under a match
OF_HEIGHT = 0.05
# of the photos of a flight; where more are off, it is not single photos that are wrong
MOST = 0.4
# matches further on in a track that a photo is compared with
REACH = 6
ROUNDS = 40


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pairs:
    """How far photo a sees the ground from where photo b sees it.

    `off` (k, 2) m in the median, `spread` (k,) m about it.
    """

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    off: Array
    spread: Array


def misplaced(problem: Problem) -> Array:
    """How far single photos must be moved, (n, 2) m east and north; 0 for all others.

    Notes
    -----
    Every photo sees its matches on level ground where its tags put them. What two photos see apart
    is the difference of their errors there; least absolute values over all pairs and all tags
    tell which photo is the one that is off, for a wrong one contradicts all its neighbours. It is
    linear: a place 1 km off is found as well as one of 30 m, before it bends a block.
    """
    n = len(problem.block.photo_ids)
    hits, height = _on_level_ground(problem)
    pairs = _compared(problem, hits, height)
    out = np.zeros((n, 2))
    if not len(pairs.a):
        return out
    own = _sigmas(problem, height)
    shift = OF_HEIGHT * height
    off = _least_absolute(pairs, own, shift, n)
    ratio = np.linalg.norm(off, axis=1) / np.hypot(own, shift)
    fits = np.linalg.norm(off[pairs.a] - off[pairs.b] - pairs.off, axis=1) < 3.0 * shift
    votes = np.bincount(pairs.a[fits], minlength=n) + np.bincount(pairs.b[fits], minlength=n)
    bad = (ratio > FAR) & (votes >= WITNESSES)
    for flight in problem.flights:
        here = flight.prior.photos
        if np.count_nonzero(bad[here]) > MOST * len(here):
            bad[here] = False
    out[bad] = -off[bad]
    return out


def moved_start(problem: Problem, move: Array) -> State:
    """Start with misplaced photos moved, and their points where the other photos see them."""
    state = problem.start
    origin = state.origin.copy()
    origin[:, :2] += move
    bad = np.any(move != 0.0, axis=1)
    hits, _ = _on_level_ground(problem)
    hits = hits + move[problem.ties.photo]
    points = state.points.copy()
    point = problem.ties.point
    touched = np.zeros(len(points), dtype=np.bool_)
    touched[point[bad[problem.ties.photo]]] = True
    touched &= np.bincount(point[problem.mark_of >= 0], minlength=len(points)) == 0
    good = np.all(np.isfinite(hits), axis=1) & touched[point]
    count = np.maximum(np.bincount(point[good], minlength=len(points)), 1)
    for c in range(2):
        mean = np.bincount(point[good], weights=hits[good, c], minlength=len(points)) / count
        points[:, c] = np.where(touched, mean, points[:, c])
    return replace(state, origin=origin, points=points)


def _on_level_ground(problem: Problem) -> tuple[Array, float]:
    """Where the start's rays meet the level of the points, (m, 2) m; height above it, m."""
    block, state, ties = problem.block, problem.start, problem.ties
    z = float(np.median(state.points[:, 2])) if len(state.points) else 0.0
    out = np.full((len(ties.photo), 2), np.nan)
    for i in np.unique(ties.photo):
        mine = ties.photo == i
        camera = block.cameras[block.camera_of[i]].camera
        d = camera.ray(ties.uv[mine]) @ state.rotation[i].T
        up = state.origin[i, 2] - z
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(d[:, 2] < 0.0, -up / d[:, 2], np.nan)
            hit = state.origin[i, :2] + s[:, None] * d[:, :2]
        # a ray that grazes the ground says little of where its point lies
        near = np.linalg.norm(hit - state.origin[i, :2], axis=1) < 3.0 * up
        out[mine] = np.where(near[:, None], hit, np.nan)
    return out, max(float(np.median(state.origin[:, 2])) - z, 1.0)


def _compared(problem: Problem, hits: Array, height: float) -> _Pairs:
    ties, n = problem.ties, len(problem.block.photo_ids)
    photo, point = ties.photo.astype(np.int64), ties.point
    keys, offs = [], []
    for step in range(1, REACH + 1):
        together = (point[step:] == point[:-step]) & np.isfinite(hits[step:] - hits[:-step])[:, 0]
        a, b = photo[:-step][together], photo[step:][together]
        swap = a > b
        off = np.where(swap[:, None], -1.0, 1.0) * (hits[:-step] - hits[step:])[together]
        keys.append(np.minimum(a, b) * n + np.maximum(a, b))
        offs.append(off)
    key, off = np.concatenate(keys), np.concatenate(offs)
    order = np.argsort(key, kind="stable")
    key, off = key[order], off[order]
    unique, first, count = np.unique(key, return_index=True, return_counts=True)
    enough = count >= FEWEST
    unique, first, count = unique[enough], first[enough], count[enough]
    middle, spread = np.zeros((len(unique), 2)), np.zeros(len(unique))
    for k, (at, m) in enumerate(zip(first, count, strict=True)):
        own = off[at : at + m]
        middle[k] = np.median(own, axis=0)
        spread[k] = np.median(np.linalg.norm(own - middle[k], axis=1))
    # a wrong heading turns the ground instead of moving it
    moved = np.linalg.norm(middle, axis=1)
    plain = spread < np.maximum(0.5 * moved, OF_HEIGHT * height)
    return _Pairs(
        a=(unique // n)[plain], b=(unique % n)[plain], off=middle[plain], spread=spread[plain]
    )


def _sigmas(problem: Problem, height: float) -> Array:
    """One sigma of where each photo sees the ground by its tags, m; (n,)."""
    covariance = np.array([pose.covariance for pose in problem.block.poses])
    place = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2.0)
    angle = np.sqrt((covariance[:, 3, 3] + covariance[:, 4, 4]) / 2.0)
    return np.asarray(np.hypot(place, height * angle))


def _least_absolute(pairs: _Pairs, own: Array, shift: float, n: int) -> Array:
    """Errors on the ground, (n, 2) m, of least sum of distances: weighted squares, repeated."""
    off = np.zeros((n, 2))
    a, b = pairs.a, pairs.b
    for _ in range(ROUNDS):
        left = np.linalg.norm(off[a] - off[b] - pairs.off, axis=1)
        w = 1.0 / (shift * np.maximum(left, 0.1 * shift))
        p = 1.0 / (own * np.maximum(np.linalg.norm(off, axis=1), 0.1 * own))
        pull = np.zeros((n, 2))
        np.add.at(pull, a, w[:, None] * pairs.off)
        np.add.at(pull, b, -w[:, None] * pairs.off)
        rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
        H = coo_matrix((np.concatenate([w, w, -w, -w]), (rows, columns)), shape=(n, n)) + diags(p)
        new = np.asarray(spsolve(H.tocsc(), pull)).reshape(n, 2)
        done = np.abs(new - off).max() < 0.01 * shift
        off = new
        if done:
            break
    return off
