"""A TIN through ground points: how much to smooth it, how far to trust it, and its grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from georef_gis.frames import Array
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain
from georef_gis.orient.surface_plane import Plane, fit_plane
from georef_gis.orient.surface_points import FLOOR, Cloud, Indices, Mask, local_planes

# neighbours that a vertex is smoothed over; 0 leaves it as it is
SMOOTHINGS = (64, 32, 16, 8, 0)
# points held out, and parts that the points are divided into for it
HELD_OUT, FOLDS = 2000, 5
# a smoother surface is taken when it is worse by no more than this
AS_GOOD = 1.02
# the best of several is flattered by its choice: by this over the number of points held out
FLATTERY = 5.0
# robust standard deviations at which residuals are cut
CLIP = 4.0
# cells of the grid at most, of 8 bytes; cells per mean distance of the points, and along a side
CELLS, CELLS_PER_SPACING, LEAST_CELLS = 2_000_000, 4.0, 256
# cells along the longer side of the grid of sigmas
SIGMA_CELLS = 192
# m; how far the grid goes beyond what must be covered, at least, and as a share of its size
MARGIN, MARGIN_SHARE = 30.0, 0.1
# share of the hull's size over which the surface goes over into the plane beyond the points
FADE = 0.15
# directions of the rings around the points
RING = 64
# pairs of points, and classes of distances, for how ground differs with the distance
PAIRS, CLASSES = 4000, 20
# nodes looked up at once
ROWS_AT_ONCE = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What held-out points say of one surface.

    Parameters
    ----------
    rms : m
        Of the held-out points against the surface of the others, large ones cut; their own noise
        included.
    excess : m
        What is left of it without the noise of point and surface: the ground between the points.
    reach : m
        Root mean square distance of held-out points to the nearest of the others.
    """

    neighbours: int
    rms: float
    excess: float
    reach: float


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Surfaces of rising roughness, and a plane, at the same held-out points."""

    tins: tuple[Trial, ...]
    plane_rms: float
    held_out: int

    @property
    def best(self) -> Trial:
        """The smoothest of those that are as good as the best."""
        least = min(trial.rms for trial in self.tins)
        return next(trial for trial in self.tins if trial.rms <= AS_GOOD * least)


def try_surfaces(cloud: Cloud) -> Trials | None:
    """Hold points out in turn and compare; None where the others do not surround any of them."""
    rng = np.random.default_rng(0)
    order = rng.permutation(len(cloud))
    size = min(-(-len(order) // FOLDS), HELD_OUT)
    folds = [order[i : i + size] for i in range(0, len(order), size)][:FOLDS]
    if size == HELD_OUT:
        folds = folds[:1]
    found = [part for fold in folds for part in [_hold_out(cloud, fold)] if part is not None]
    if not found:
        return None
    errors = {k: np.concatenate([f.errors[k] for f in found]) for k in (*SMOOTHINGS, -1)}
    own = np.concatenate([f.own for f in found])
    reach = float(np.sqrt(np.mean(np.concatenate([f.reach for f in found]) ** 2)))
    # A poor point tells less; twice the usual sigma, a quarter.
    weight = 1.0 / (np.median(own**2) + own**2)
    trials = []
    for k in SMOOTHINGS:
        variance = np.concatenate([f.variance[k] for f in found])
        squared = _cut(errors[k]) ** 2
        excess = float(np.average(squared - own**2 - variance, weights=weight))
        rms = float(np.sqrt(np.average(squared, weights=weight)))
        spread = float(np.sqrt(max(excess, FLOOR**2))) * (1.0 + FLATTERY / len(own))
        trials.append(Trial(k, rms, spread, reach))
    plane = float(np.sqrt(np.average(_cut(errors[-1]) ** 2, weights=weight)))
    return Trials(tuple(trials), plane, len(own))


def _cut(r: Array) -> Array:
    limit = CLIP * 1.4826 * float(np.median(np.abs(r))) + FLOOR
    return np.clip(r, -limit, limit)


@dataclass(frozen=True, slots=True, eq=False)
class _HeldOut:
    """Errors at held-out points by smoothing (-1: the plane), with the variance of the surface."""

    errors: dict[int, Array]
    variance: dict[int, Array]
    own: Array
    reach: Array


def _hold_out(cloud: Cloud, fold: Indices) -> _HeldOut | None:
    keep = np.ones(len(cloud), dtype=np.bool_)
    keep[fold] = False
    rest, out = cloud.part(keep), cloud.part(fold)
    middle = rest.xy.mean(axis=0)
    tin = Delaunay(rest.xy - middle)
    simplex = tin.find_simplex(out.xy - middle)
    out, simplex = out.part(simplex >= 0), simplex[simplex >= 0]
    if not len(out):
        return None
    corners, share = _corners(tin, simplex, out.xy - middle)
    used, at = np.unique(corners, return_inverse=True)
    at = at.reshape(corners.shape)
    errors = {-1: out.h - fit_plane(rest).at(out.xy)}
    variance = {}
    for k in SMOOTHINGS:
        h, v = smoothed(rest, k, used)
        errors[k] = out.h - np.sum(share * h[at], axis=1)
        variance[k] = np.sum(share**2 * v[at], axis=1)
    reach = cKDTree(rest.xy).query(out.xy)[0]
    return _HeldOut(errors, variance, out.sigma, reach)


def smoothed(cloud: Cloud, k: int, which: Indices | None = None) -> tuple[Array, Array]:
    """Heights, m, of vertices smoothed over k neighbours, and their variance, m^2; shape (n,)."""
    places = cloud if which is None else cloud.part(which)
    if k == 0:
        return places.h, places.sigma**2
    fit = local_planes(cloud, places.xy, k)
    return fit.h, fit.variance


def _corners(tin: Delaunay, simplex: Indices, xy: Array) -> tuple[Indices, Array]:
    """Vertices of the triangles of places and their shares; shape (n, 3) each."""
    t = tin.transform[simplex]
    two = np.einsum("nij,nj->ni", t[:, :2], xy - t[:, 2])
    share = np.column_stack([two, 1.0 - two.sum(axis=1)])
    # a sliver has no transform: its nearest corner stands for it
    share = np.where(np.isfinite(share).all(axis=1, keepdims=True), share, [1.0, 0.0, 0.0])
    return tin.simplices[simplex], share


# -- grid --------------------------------------------------------------------------------------


def plane_terrain(
    plane: Plane, frame: EnuPlane, points: Array, area: Array, *, shared: float
) -> TinTerrain:
    """The plane as a grid over points and area; shape (n, 2) and (m, 2), m."""
    lattice = Lattice.over(np.concatenate([points, area]), cell=None)
    sigmas = plane.sigma_at(lattice.sigma_nodes())
    own = float(np.sqrt(np.mean(plane.sigma_at(points) ** 2)))
    return tin_terrain(
        frame, lattice, plane.at(lattice.nodes(slice(None))), sigmas,
        kind="plane", sigma=float(np.hypot(own, shared)), sigma_shared=shared,
    )  # fmt: skip


def tin_of(
    cloud: Cloud, trial: Trial, frame: EnuPlane, area: Array, *, shared: float
) -> TinTerrain:
    """The TIN as a grid over its points and an area, (m, 2) m; beyond the points it fades out."""
    plane = fit_plane(cloud)
    h, variance = smoothed(cloud, trial.neighbours)
    hull = ConvexHull(cloud.xy)
    # a hull's "volume" in the plane is its area
    spacing = float(np.sqrt(hull.volume / len(cloud)))
    lattice = Lattice.over(np.concatenate([cloud.xy, area]), cell=spacing / CELLS_PER_SPACING)
    ghosts, raised = _ring(cloud.xy, h, hull, plane, lattice)
    middle = cloud.xy.mean(axis=0)
    tin = Delaunay(np.concatenate([cloud.xy, ghosts]) - middle)
    values = np.concatenate([h, raised])
    heights = np.empty((lattice.rows, lattice.cols))
    at_once = max(1, ROWS_AT_ONCE // lattice.cols)
    for first in range(0, lattice.rows, at_once):
        rows = slice(first, min(first + at_once, lattice.rows))
        heights[rows] = _on_tin(tin, values, lattice.nodes(rows) - middle, plane, middle)
    nodes = lattice.sigma_nodes()
    inside = Delaunay(cloud.xy[hull.vertices] - middle).find_simplex(nodes - middle) >= 0
    sigmas = _sigmas(cloud, variance, trial, plane, nodes, inside)
    own = float(np.sqrt(np.mean((sigmas[inside] if inside.any() else sigmas) ** 2)))
    return tin_terrain(
        frame, lattice, heights, sigmas,
        kind="tin", sigma=float(np.hypot(own, shared)), sigma_shared=shared,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Lattice(SquareCells):
    """So many rows and columns of them."""

    rows: int
    cols: int

    @classmethod
    def over(cls, xy: Array, *, cell: float | None) -> Lattice:
        """Grid over places (n, 2) with a margin; without a cell one fit for a plane."""
        low, high = xy.min(axis=0), xy.max(axis=0)
        margin = max(MARGIN, MARGIN_SHARE * float(np.hypot(*(high - low))))
        low, high = low - margin, high + margin
        width, height = high - low
        longer = max(width, height)
        least = longer / 32.0 if cell is None else min(cell, longer / LEAST_CELLS)
        size = max(least, float(np.sqrt(width * height / CELLS)))
        cols, rows = int(np.ceil(width / size)) + 1, int(np.ceil(height / size)) + 1
        return cls(left=float(low[0]), top=float(high[1]), cell=size, rows=rows, cols=cols)

    def nodes(self, rows: slice) -> Array:
        """Centres of the cells of some rows; shape (rows, cols, 2)."""
        x = self.left + (np.arange(self.cols) + 0.5) * self.cell
        y = self.top - (np.arange(self.rows)[rows] + 0.5) * self.cell
        return np.stack(np.meshgrid(x, y), axis=-1)

    def sigma_nodes(self) -> Array:
        """Centres of the cells of a coarser grid over the same extent; shape (k, l, 2)."""
        size = max(1.0, max(self.rows, self.cols) / SIGMA_CELLS)
        k, n = int(np.ceil(self.rows / size)), int(np.ceil(self.cols / size))
        x = self.left + (np.arange(n) + 0.5) / n * self.cols * self.cell
        y = self.top - (np.arange(k) + 0.5) / k * self.rows * self.cell
        return np.stack(np.meshgrid(x, y), axis=-1)


def _on_tin(tin: Delaunay, values: Array, xy: Array, plane: Plane, middle: Array) -> Array:
    """Heights of a TIN, beyond its ghosts those of the plane; (..., 2) m -> (...)."""
    flat = xy.reshape(-1, 2)
    simplex = tin.find_simplex(flat)
    out = plane.at(flat + middle)
    on = simplex >= 0
    corners, share = _corners(tin, simplex[on], flat[on])
    out[on] = np.sum(share * values[corners], axis=1)
    return out.reshape(xy.shape[:-1])


def _ring(
    xy: Array, h: Array, hull: ConvexHull, plane: Plane, lattice: Lattice
) -> tuple[Array, Array]:
    """Places beyond the points and heights there, which go over from theirs into the plane."""
    corners = xy[hull.vertices]
    side = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*side.T)
    along = (np.arange(RING) + 0.5) / RING * length.sum()
    ends = np.cumsum(length)
    i = np.minimum(np.searchsorted(ends, along), len(ends) - 1)
    t = (along - (ends[i] - length[i])) / length[i]
    # counter-clockwise: outward is to the right of the way
    outward = np.stack([side[i, 1], -side[i, 0]], axis=1) / length[i, None]
    reach = FADE * float(np.hypot(*np.ptp(corners, axis=0)))
    rim = corners[i] + t[:, None] * side[i]
    rings = [rim + outward * (reach * k) for k in (0.5, 1.0, 2.0)]
    x0, y0 = lattice.left - reach, lattice.top + reach
    x1 = lattice.left + lattice.cols * lattice.cell + reach
    y1 = lattice.top - lattice.rows * lattice.cell - reach
    far = np.array([[x, y] for x in np.linspace(x0, x1, 9) for y in np.linspace(y0, y1, 9)
                    if x in (x0, x1) or y in (y0, y1)])  # fmt: skip
    ghosts = np.concatenate([*rings, far])
    # by number of the ring, as the place of a ring about a corner is nearer than its number says
    away = np.concatenate([np.full(RING, 0.5), np.full(RING, 1.0), np.full(RING, 2.0),
                           np.full(len(far), np.inf)])  # fmt: skip
    d, near = cKDTree(xy).query(ghosts, k=min(12, len(xy)))
    weight = 1.0 / d**2
    stands_off = np.average((h - plane.at(xy))[near], axis=1, weights=weight)
    return ghosts, plane.at(ghosts) + stands_off * np.exp(-away)


def _sigmas(
    cloud: Cloud, variance: Array, trial: Trial, plane: Plane, nodes: Array, inside: Mask
) -> Array:
    """One sigma of the surface, m, at places; (k, l, 2) -> (k, l).

    The noise of the vertices, and the ground that no point tells. Between points that is known
    from held-out ones and grows with the distance to the nearest. In gaps and beyond the points it
    is what two places as far apart differ by, and beyond them the tilt of the plane is added.
    """
    d, near = cKDTree(cloud.xy).query(nodes, k=min(3, len(cloud)))
    noise = np.mean(variance[near], axis=-1)
    ratio = d[..., 0] / trial.reach
    between = trial.excess**2 * (1.0 + 3.0 * ratio**2) / 4.0
    off = Cloud(cloud.xy, cloud.h - plane.at(cloud.xy), cloud.sigma)
    relief = max(float(np.var(off.h)), trial.excess**2)
    alike = _variogram(off)
    # from both sides a gap is known to half of that
    gap = alike(d[..., 0]) / 2.0 * np.clip(ratio - 2.0, 0.0, 1.0)
    fade = np.exp(-d[..., 0] / (FADE * float(np.hypot(*np.ptp(cloud.xy, axis=0)))))
    beyond = (1.0 - fade) ** 2 * relief + fade * alike(d[..., 0])
    tilt = np.maximum(plane.sigma_at(nodes) ** 2 - plane.relief**2, 0.0)
    ground = np.where(
        inside, np.maximum(np.minimum(between, relief), gap), np.maximum(between, beyond + tilt)
    )
    return np.asarray(np.sqrt(noise + np.minimum(ground, 4.0 * relief + tilt)))


def _variogram(cloud: Cloud) -> Callable[[Array], Array]:
    """Mean square, m^2, by which heights differ over a distance, m, their noise left out."""
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, len(cloud), (2, PAIRS))
    i, j = i[i != j], j[i != j]
    tree = cKDTree(cloud.xy)
    # random pairs are far apart: near ones besides
    _, near = tree.query(cloud.xy[i[: PAIRS // 4]], k=min(24, len(cloud)))
    column = rng.integers(1, near.shape[1], len(near))
    i = np.concatenate([i, i[: PAIRS // 4]])
    j = np.concatenate([j, near[np.arange(len(near)), column]])
    distance = np.hypot(*(cloud.xy[i] - cloud.xy[j]).T)
    squared = (cloud.h[i] - cloud.h[j]) ** 2 - cloud.sigma[i] ** 2 - cloud.sigma[j] ** 2
    order = np.argsort(distance)
    bins = np.array_split(order, CLASSES)
    at = np.array([0.0, *(distance[b].mean() for b in bins)])
    value = np.maximum.accumulate([0.0, *(max(float(squared[b].mean()), 0.0) for b in bins)])
    return lambda d: np.interp(d, at, value)
