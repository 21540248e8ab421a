"""Which photos to compare: those whose footprints, widened by the poses' own sigmas, overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely import Geometry, MultiPoint, Point, STRtree, area, intersection

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.model.ground_point import locate
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain

# footprints are cut off at this many heights of flight from the camera
FARTHEST = 4.0
# sigmas by which footprints are widened
WIDENED = 2.0
# rad; beyond this sigma a heading says nothing
ANY_HEADING = 0.7
# share of the smaller widened footprint below which two photos are not compared
LEAST_OVERLAP = 0.03
# ways out of a group of photos that are tried when it hangs together with no other
BRIDGES = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What a photo shows of the ground by its pose.

    Parameters
    ----------
    shape
        Footprint in enu, m; a disc below the camera where the rays do not tell.
    wide
        The same, widened by `sigma`.
    height : m
        Of the camera above the ground below it.
    middle : shape (2,), m
        Middle of the footprint.
    sigma : m
        How far the footprint may be off.
    """

    shape: Geometry
    wide: Geometry
    height: float
    middle: Array
    sigma: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """Two photos to compare, by index, first < second, with their predicted overlap."""

    first: int
    second: int
    overlap: float


def view_of(photo: OrientedPhoto, terrain: Terrain) -> View:
    """Footprint of a photo with its uncertainty."""
    pose = photo.pose
    ground = float(terrain.z_at(pose.origin_enu[:2]))
    height = float(pose.origin_enu[2] - ground)
    if not (np.isfinite(height) and height > 1.0):
        # Off the DEM, or below the ground by a wrong height: the tags' own scale is unknown.
        height = 100.0
    try:
        ring = locate(photo, photo.camera.border_uv(6), terrain)[:, :2]
    except GeometryError:
        ring = np.full((1, 2), np.nan)
    here = pose.origin_enu[:2]
    off = ring - here
    far = np.hypot(off[:, 0], off[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(
            (far > FARTHEST * height)[:, None], off * (FARTHEST * height / far)[:, None], off
        )
    ring = (here + off)[np.isfinite(far)]
    radius = 0.5 * height * np.hypot(photo.camera.width, photo.camera.height) / photo.camera.fx
    if len(ring) >= 3:
        shape = MultiPoint(ring).convex_hull
    else:
        shape = Point(here).buffer(radius)
    sigmas = np.sqrt(np.diag(pose.covariance))
    if sigmas[5] > ANY_HEADING:
        shape = shape.union(Point(here).buffer(radius))
    sigma = float(
        np.hypot(max(sigmas[0], sigmas[1]), height * min(max(sigmas[3], sigmas[4]), 0.5))
        + min(sigmas[5], ANY_HEADING) * 0.5 * radius
    )
    middle = np.array([shape.centroid.x, shape.centroid.y])
    wide = shape.buffer(WIDENED * sigma)
    return View(shape=shape, wide=wide, height=height, middle=middle, sigma=sigma)


def candidate_pairs(
    photos: Sequence[OrientedPhoto], views: Sequence[View], *, neighbours: int
) -> list[Candidate]:
    """Pairs of photos to compare: for each one its neighbours of largest predicted overlap.

    The search goes by a tree of rectangles, so that its cost grows with the number of photos.
    """
    n = len(views)
    wide = np.array([v.wide for v in views], dtype=object)
    first, second = (
        STRtree(wide).query(wide, predicate="intersects") if n else np.zeros((2, 0), int)
    )
    once = first < second
    first, second = first[once], second[once]
    overlap = _shares(wide, first, second)
    # Of photos that stand in one place each sees the others whole: near ones are preferred.
    near = np.array([v.middle for v in views]).reshape(-1, 2)
    size = np.sqrt(area(wide)) if n else np.zeros(0)
    distance = np.hypot(*(near[first] - near[second]).T) / np.minimum(size[first], size[second])
    worth = overlap - 0.1 * distance
    good = overlap >= LEAST_OVERLAP
    first, second, overlap, worth = first[good], second[good], overlap[good], worth[good]
    keep = _best_of_each(n, first, second, worth, neighbours)
    out = [
        Candidate(int(first[i]), int(second[i]), float(overlap[i])) for i in np.flatnonzero(keep)
    ]
    return out + _in_time(photos, {(c.first, c.second) for c in out})


def _shares(wide: np.ndarray, first: np.ndarray, second: np.ndarray) -> Array:
    if not len(first):
        return np.zeros(0)
    smaller = np.minimum(area(wide[first]), area(wide[second]))
    return np.asarray(area(intersection(wide[first], wide[second])) / np.maximum(smaller, 1e-9))


def _best_of_each(n: int, first: Array, second: Array, worth: Array, count: int) -> Array:
    """Whether a pair is among the best `count` of either of its photos; shape (m,)."""
    keep = np.zeros(len(first), dtype=bool)
    photo = np.concatenate([first, second])
    pair = np.tile(np.arange(len(first)), 2)
    order = np.lexsort((-worth[pair], photo))
    ordered = photo[order]
    rank = np.arange(len(order)) - np.searchsorted(ordered, ordered, side="left")
    keep[pair[order[rank < count]]] = True
    return keep


def _in_time(photos: Sequence[OrientedPhoto], known: set[tuple[int, int]]) -> list[Candidate]:
    """Neighbours in time of each flight that are not among the known pairs.

    Poses that contradict the pixels may hide that two photos overlap; the next in time mostly do.
    """
    out = []
    by_flight: dict[str, list[int]] = {}
    for i, photo in enumerate(photos):
        by_flight.setdefault(photo.photo.flight_id, []).append(i)
    for members in by_flight.values():
        ordered = sorted(members, key=lambda i: _when(photos[i], i))
        for a, b in pairwise(ordered):
            pair = (min(a, b), max(a, b))
            if pair not in known:
                out.append(Candidate(*pair, 0.0))
    return out


def _when(photo: OrientedPhoto, index: int) -> tuple[float, float, int]:
    """Key of the order in time: GPS time where known, else the camera's clock, else as given."""
    p = photo.photo
    clock = 0.0 if p.camera_clock is None else p.camera_clock.timestamp()
    return (0.0 if p.time_gps is None else p.time_gps, clock, index)


def groups(n: int, pairs: Sequence[tuple[int, int]]) -> np.ndarray:
    """Number of the group that each of n photos belongs to, shape (n,)."""
    ends = np.array(pairs, dtype=int).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])


def bridges(
    views: Sequence[View],
    group: np.ndarray,
    tried: set[tuple[int, int]],
) -> list[Candidate]:
    """Pairs not yet tried that may join groups of photos: the nearest across their borders."""
    if len(set(group.tolist())) < 2:
        return []
    middle = np.array([v.middle for v in views])
    tree = cKDTree(middle)
    near = tree.query(middle, k=min(len(views), 40))[1]
    out: dict[tuple[int, int], float] = {}
    for g in np.unique(group):
        found = []
        for i in np.flatnonzero(group == g).tolist():
            for j in np.atleast_1d(near[i]).tolist():
                pair = (min(i, j), max(i, j))
                if group[j] == g or pair in tried:
                    continue
                gap = float(np.hypot(*(middle[i] - middle[j])))
                reach = views[i].height + views[j].height + 3.0 * (views[i].sigma + views[j].sigma)
                if gap < reach:
                    found.append((gap, pair))
        for gap, pair in sorted(found)[:BRIDGES]:
            out[pair] = gap
    return [Candidate(*pair, 0.0) for pair in out]
