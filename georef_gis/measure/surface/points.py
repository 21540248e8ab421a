"""The adjusted points themselves as a surface: flat triangles between them, nothing smoothed.

The ground that photos are laid on is smooth, and takes what stands on it for blunders. A stockpile
is such a thing; so its volume is that of the points.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.measure.surface.common_errors import CommonErrors
from georef_gis.measure.surface.field import Sampled, bounds_of
from georef_gis.model.mesh import LocalMap
from georef_gis.model.tie_points import GroundPoints

# random halves of the points, in pairs
HALVES = 16
# m; points nearer than this are one
_SAME = 1e-3
# of a triangle's longest side: gaps between points are no surface
_GAP = 8.0
# neighbours of a point, and their robust standard deviations off which it is a blunder
_NEIGHBOURS, _BLUNDER = 8, 6.0
# m; scatter below which no point is one
_FLOOR = 0.02
# shares of the points that are left to see what triangles miss
_LEFT = (0.5, 0.25, 0.125)
# mean side of a triangle, in spacings of a square grid of as many points
_SIDE = 1.2
# powers of a triangle's size that what it misses grows by: from rough ground to smooth
_POWERS = (1.0, 4.0)
# points that a small part of a surface must have
_TRIANGLES = 8
# rays from which on a wrong match shows, and points below which two must do
_RAYS, _FEWEST = 3, 40


@dataclass(frozen=True, kw_only=True, eq=False)
class PointField:
    """Triangles between points.

    Parameters
    ----------
    p_enu : shape (n, 3), m
        Without blunders.
    sigma : shape (n,), m
        One sigma of each height by itself.
    common, scale
        Of the block, see `HeightField`.
    """

    p_enu: Array
    sigma: Array
    common: CommonErrors
    scale: float = 0.0
    name: str = "adjusted points"

    @classmethod
    def of(
        cls, points: GroundPoints, *, level: float = 0.0, common: CommonErrors | None = None,
        scale: float = 0.0,
    ) -> PointField:  # fmt: skip
        """Surface of an adjustment's points.

        Parameters
        ----------
        level : m
            One sigma of a shift of points and photos together.
        common
            Of the heights but for that; without it what the points' own sigmas hold beyond their
            scatter is taken for a shift.

        Raises
        ------
        GeometryError
            If they do not make a triangle.
        """
        p, sigma = _usable(points)
        if len(p) < 4:
            raise GeometryError(f"{len(p)} adjusted points make no surface; match more photos")
        keep = _without_blunders(p)
        p, sigma = p[keep], sigma[keep]
        off = _stands_off(p)[0]
        # a point stands off the mean of its neighbours by a little more than its own error
        seen = (1.4826 * float(np.median(np.abs(off)))) ** 2 / (1.0 + 1.0 / _NEIGHBOURS)
        stated = float(np.median(sigma**2))
        own = min(1.0, seen / stated) if stated > 0 else 1.0
        known = common or CommonErrors.level(math.sqrt(stated * (1.0 - own)))
        return cls(p_enu=p, sigma=sigma * math.sqrt(own), common=known.raised(level), scale=scale)

    @functools.cached_property
    def _tin(self) -> Delaunay:
        try:
            return Delaunay(self.p_enu[:, :2] - self._middle)
        except QhullError as error:
            raise GeometryError("the adjusted points lie on a line: no surface") from error

    @functools.cached_property
    def _middle(self) -> Array:
        return np.asarray(self.p_enu[:, :2].mean(axis=0))

    @functools.cached_property
    def spacing(self) -> float:
        """Mean distance of the points, m: of as many in a square grid."""
        corners = self.p_enu[self._tin.simplices, :2]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        areas = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        # half as many points as triangles; slivers along the hull are not what they usually cover
        return float(math.sqrt(2.0 * np.median(areas)))

    @property
    def detail(self) -> float:
        """Distance over which it is smooth, m."""
        return self.spacing / 2.0

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu, m; (..., 2) -> (...), NaN outside and in gaps."""
        return self._z(*self._triangles(xy_enu))

    def on_map(self, frame: MapFrame, xy_map: Array) -> Sampled:
        """Heights and local sigmas at places of a map; (..., 2) CRS units -> (...)."""
        level = float(frame.origin.geo_from_enu(np.append(self._middle, self._usual_z))[2])
        plane = LocalMap.fit(frame, bounds_of(xy_map), (level, level))
        level_of = np.full((*xy_map.shape[:-1], 1), level)
        p = plane.enu_from_map(np.concatenate([xy_map, level_of], axis=-1))
        triangle, share = self._triangles(p[..., :2])
        # up is the plumb line to 1e-8 within a km
        return Sampled(
            height=level + self._z(triangle, share) - p[..., 2], local=self._local(triangle, share)
        )

    def local(self, xy_enu: ArrayLike) -> Array:
        """One sigma of heights against their surroundings, m; (..., 2) -> (...).

        That of the points, and of what a flat triangle misses: it grows with the triangle.
        """
        return self._local(*self._triangles(xy_enu))

    def _z(self, triangle: NDArray[np.intp], share: Array) -> Array:
        return _over_corners(share, self._heights, triangle)

    def _local(self, triangle: NDArray[np.intp], share: Array) -> Array:
        squares = share**2
        # nothing is missed at a corner, and most amid the triangle: the mean of this is one
        amid = 2.0 * (1.0 - squares.sum(axis=0))
        noise = _over_corners(squares, self._variances, triangle)
        return np.asarray(np.sqrt(noise + self._missed_in[triangle] * amid))

    @functools.cached_property
    def _missed(self) -> tuple[float, float]:
        """Variance, m^2, that triangles of a mean side a miss: factor and power of a.

        By points left out against triangles between ever fewer of the others.
        """
        rng = np.random.default_rng(0)
        sizes, variances = [], []
        for share in _LEFT:
            some = rng.random(len(self.p_enu)) < share
            if min(np.count_nonzero(some), np.count_nonzero(~some)) < _TRIANGLES:
                continue
            coarse, others = self._part(some), self.p_enu[~some]
            triangle, weights = coarse._triangles(others[:, :2])
            off = others[:, 2] - coarse._z(triangle, weights)
            noise = _over_corners(weights**2, coarse._variances, triangle)
            noise = noise + self.sigma[~some] ** 2
            known = np.isfinite(off)
            if not np.any(known):
                continue
            limit = _BLUNDER * 1.4826 * float(np.median(np.abs(off[known])))
            seen = np.clip(off[known], -limit, limit) ** 2
            variances.append(float(np.mean(seen) - np.mean(noise[known])))
            sizes.append(coarse.spacing * _SIDE)
        return _power_law(np.array(sizes), np.array(variances))

    def _triangles(self, xy_enu: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Triangle of each place, -1 outside, and the shares of its corners; (...), (3, ...)."""
        xy = np.asarray(xy_enu, dtype=np.float64) - self._middle
        triangle = self._tin.find_simplex(xy)
        x0, y0, a, b, c, d = self._transforms
        x, y = xy[..., 0] - x0[triangle], xy[..., 1] - y0[triangle]
        share = np.empty((3, *xy.shape[:-1]))
        share[0] = a[triangle] * x + b[triangle] * y
        share[1] = c[triangle] * x + d[triangle] * y
        share[2] = 1.0 - share[0] - share[1]
        return triangle, share

    @functools.cached_property
    def _transforms(self) -> Array:
        """Last corner of each triangle, m, and what takes places to shares, 1/m; (6, t)."""
        transform = self._tin.transform
        return np.vstack([transform[:, 2].T, transform[:, 0].T, transform[:, 1].T])

    @functools.cached_property
    def _sides(self) -> Array:
        """Sides of the triangles, m; (t, 3)."""
        corners = self.p_enu[self._tin.simplices, :2]
        return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2))

    @functools.cached_property
    def _heights(self) -> Array:
        """Of the corners of triangles, m; (3, t + 1): NaN for a gap, and in the last for none."""
        z = self.p_enu[self._tin.simplices.T, 2]
        z[:, self._sides.max(axis=1) > _GAP * self.spacing] = np.nan
        return np.hstack([z, np.full((3, 1), np.nan)])

    @functools.cached_property
    def _variances(self) -> Array:
        """Like `_heights`: of the heights, m^2."""
        variances = self.sigma[self._tin.simplices.T] ** 2
        gaps = np.isnan(self._heights)
        return np.where(gaps, np.nan, np.hstack([variances, np.zeros((3, 1))]))

    @functools.cached_property
    def _missed_in(self) -> Array:
        """Variance of what each triangle misses, m^2; (t + 1,)."""
        factor, power = self._missed
        return np.append(factor * self._sides.mean(axis=1) ** power, np.nan)

    @functools.cached_property
    def _usual_z(self) -> float:
        return float(np.median(self.p_enu[:, 2]))

    def alike(self, extent: float) -> Sequence[float]:
        """Length, m, over which local errors are alike: that of a triangle."""
        return [self.spacing / 2.0]

    def resampled(self, bounds: tuple[float, float, float, float]) -> Sequence[PointField]:
        """Surfaces within bounds, m, of random halves of the points."""
        rng, reach = np.random.default_rng(0), _GAP * self.spacing
        low, high = np.array(bounds[:2]) - reach, np.array(bounds[2:]) + reach
        near = np.flatnonzero(np.all((self.p_enu[:, :2] > low) & (self.p_enu[:, :2] < high), 1))
        out = []
        for _ in range(HALVES // 2):
            order = rng.permutation(near)
            for half in (order[: len(order) // 2], order[len(order) // 2 :]):
                if len(half) >= _TRIANGLES:
                    out.append(self._part(half))
        return out

    def _part(self, chosen: NDArray[Any]) -> PointField:
        """The same surface from some of its points."""
        return PointField(
            p_enu=self.p_enu[chosen], sigma=self.sigma[chosen], common=self.common,
            scale=self.scale, name=self.name,
        )  # fmt: skip

    def near(self, middle: Array, reach: float) -> PointField:
        """The points within a square about a place, m: a small part of a large block.

        Raises
        ------
        GeometryError
            If hardly a point is there.
        """
        inside = np.all(np.abs(self.p_enu[:, :2] - middle) <= reach, axis=1)
        if np.count_nonzero(inside) < _TRIANGLES:
            raise GeometryError(
                f"{np.count_nonzero(inside)} adjusted points lie within {reach:.0f} m of the "
                "area: no surface; draw it where photos overlap"
            )
        return self._part(inside)


def _over_corners(weights: Array, values: Array, triangle: NDArray[np.intp]) -> Array:
    """Weighted sum over the corners of triangles; (3, ...), (3, t), (...) -> (...)."""
    return np.asarray(sum(w * v[triangle] for w, v in zip(weights, values, strict=True)))


def _power_law(sizes: Array, variances: Array) -> tuple[float, float]:
    """Factor and power of a law through variances that are positive; nothing where none is."""
    good = variances > 0.0
    if not np.any(good):
        return 0.0, _POWERS[0]
    x, y = np.log(sizes[good]), np.log(variances[good])
    power = float(np.polyfit(x, y, 1)[0]) if len(x) > 1 else _POWERS[0]
    power = float(np.clip(power, *_POWERS))
    return float(np.exp(np.mean(y - power * x))), power


def _usable(points: GroundPoints) -> tuple[Array, Array]:
    """Places and sigmas of the heights of points that can be used, one per place."""
    with np.errstate(invalid="ignore"):
        variance = points.covariance[:, 2, 2]
        good = np.isfinite(points.p_enu).all(axis=1) & np.isfinite(variance) & (variance > 0)
    sure = good & (points.rays >= _RAYS)
    good = sure if np.count_nonzero(sure) >= _FEWEST else good
    p, sigma = points.p_enu[good], np.sqrt(variance[good])
    order = np.argsort(sigma, kind="stable")
    _, first = np.unique(np.round(p[order, :2] / _SAME), axis=0, return_index=True)
    chosen = np.sort(order[first])
    return p[chosen], sigma[chosen]


def _stands_off(p: Array) -> tuple[Array, Array]:
    """How far points stand off planes through their neighbours, and how these scatter; (n,), m."""
    k = min(_NEIGHBOURS + 1, len(p))
    _, near = cKDTree(p[:, :2]).query(p[:, :2], k=k)
    others = near[:, 1:]
    d = p[others] - p[:, None]
    width = np.linalg.norm(d[..., :2], axis=2).max(axis=1)[:, None, None]
    X = np.concatenate([np.ones((*others.shape, 1)), d[..., :2] / width], axis=2)
    normal = np.swapaxes(X, 1, 2) @ X + 1e-3 * np.eye(3)
    beta = np.linalg.solve(normal, np.swapaxes(X, 1, 2) @ d[..., 2:])
    left = (d[..., 2:] - X @ beta)[..., 0]
    return -beta[:, 0, 0], 1.4826 * np.median(np.abs(left), axis=1)


def _without_blunders(p: Array) -> NDArray[np.bool_]:
    """Which points do not stand alone far off all that is about them; (n,)."""
    keep = np.ones(len(p), dtype=np.bool_)
    for _ in range(3):
        at = np.flatnonzero(keep)
        if len(at) <= 2 * _NEIGHBOURS:
            break
        off, scatter = _stands_off(p[at])
        usual = 1.4826 * float(np.median(np.abs(off)))
        bad = np.abs(off) > _BLUNDER * np.maximum(np.maximum(scatter, usual), _FLOOR)
        if not np.any(bad):
            break
        keep[at[bad]] = False
    return keep
