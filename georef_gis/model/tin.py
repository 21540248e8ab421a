"""The ground as adjusted points tell it: a TIN or a plane, laid out once as a grid of heights.

A mesh asks for millions of heights, a triangulation answers one in microseconds. So triangles are
looked up once, at the nodes of a grid finer than the points, and the grid is a `DemTerrain` like a
DEM of the user: exact at the nodes, bilinear between them. Its plane is that of the project, not
of the map: it stays what it is when the CRS of the map is changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from georef_gis.frames import Array
from georef_gis.geodesy import CRS, MapFrame, Origin
from georef_gis.model.terrain import DemTerrain, z_of_constant_height

SurfaceKind = Literal["tin", "plane"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EnuPlane:
    """The project's enu as a map: a place's east and north at one level, and its height.

    Taken at one level, m above the ellipsoid, they depend on latitude and longitude alone, as on
    any map; over a point 50 m higher and 1 km off, enu's own would be 8 mm beside it.
    """

    origin: Origin
    level: float

    @property
    def horizontal(self) -> CRS | None:
        """None: it has no CRS."""
        return None

    def map_from_geo(self, p_geo: ArrayLike) -> Array:
        """(x m, y m, ellipsoidal height m) of (lat, lon rad, height m); shape (..., 3)."""
        geo = np.array(p_geo, dtype=np.float64)
        height = geo[..., 2].copy()
        geo[..., 2] = self.level
        out = self.origin.enu_from_geo(geo)
        out[..., 2] = height
        return out

    def map_from_enu(self, p_enu: ArrayLike) -> Array:
        """(x m, y m, ellipsoidal height m) of enu m; shape (..., 3)."""
        return self.map_from_geo(self.origin.geo_from_enu(p_enu))

    def enu_from_map(self, p_map: ArrayLike) -> Array:
        """Enu m of (x m, y m, ellipsoidal height m); shape (..., 3)."""
        p = np.asarray(p_map, dtype=np.float64)
        z = z_of_constant_height(self.origin, self.level, p[..., :2])
        geo = self.origin.geo_from_enu(np.concatenate([p[..., :2], z[..., None]], axis=-1))
        geo[..., 2] = p[..., 2]
        return self.origin.enu_from_geo(geo)


@dataclass(frozen=True, slots=True, kw_only=True)
class SquareCells:
    """North-up cells on the project's plane: outer corner of the first, and their side, m."""

    left: float
    top: float
    cell: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TinTerrain(DemTerrain):
    """Ground from adjusted points; it has a height everywhere, beyond its grid that of the rim.

    `sigma` is one number for the whole: the root mean square over the area of the points.

    Parameters
    ----------
    sigmas : shape (k, l), m
        One sigma of the height against its surroundings, over the same extent as `heights`,
        bilinear between the cell centres.
    sigma_shared : m
        One sigma of a shift of the whole surface together with the photos; part of `sigma`
        unless the poses hold it already.
    steepest
        Largest slope between neighbouring nodes.
    """

    kind: SurfaceKind
    sigmas: Array
    sigma_shared: float
    steepest: float

    @property
    def detail(self) -> float:
        """A cell, m; inf for a plane."""
        return float("inf") if self.kind == "plane" else 2.0 * self.step

    def lies_on(self, frame: MapFrame) -> bool:
        """No map is the project's own plane."""
        return False

    def sigma_at(self, xy_enu: ArrayLike) -> Array:
        """One sigma of the ground's height, m, at east, north; (..., 2) m -> (...).

        It grows with the distance from the points.
        """
        xy = np.asarray(xy_enu, dtype=np.float64)
        p = np.concatenate([xy, self.z_at(xy)[..., None]], axis=-1)
        at = self.position(self.frame.map_from_enu(p)[..., :2])
        scale = np.array(self.sigmas.shape[::-1]) / np.array(self.heights.shape[::-1])
        local = _bilinear(self.sigmas, (at + 0.5) * scale - 0.5)
        return np.asarray(np.hypot(local, self.sigma_shared))

    def beside_photos(self) -> TinTerrain:
        """The same ground with its sigma against photos whose poses hold the shared one."""
        own = float(np.sqrt(max(self.sigma**2 - self.sigma_shared**2, 0.0)))
        return replace(self, sigma=own, sigma_shared=0.0)

    def height_at(self, at: Array) -> Array:
        """Ellipsoidal height, m, at (col, row), see `position`; (..., 2) -> (...)."""
        return _bilinear(self.heights, at)

    def _free_run(self, d: Array, slant: Array, clearance: Array) -> Array:
        # Ground that is nowhere steeper cannot come up faster; enu bends away by 1 % in 60 km.
        closing = -d[:, 2] + (self.steepest + 0.01) * slant
        return np.asarray(np.maximum(clearance, 0.0) / np.maximum(closing, 1e-9))


def _bilinear(values: Array, at: Array) -> Array:
    """Values at (col, row), beyond the rim those of the rim; (..., 2) -> (...), NaN for NaN."""
    rows, cols = values.shape
    known = np.isfinite(at[..., 0]) & np.isfinite(at[..., 1])
    col = np.clip(np.where(known, at[..., 0], 0.0), 0.0, cols - 1.0)
    row = np.clip(np.where(known, at[..., 1], 0.0), 0.0, rows - 1.0)
    j = np.minimum(col.astype(np.intp), max(cols - 2, 0))
    i = np.minimum(row.astype(np.intp), max(rows - 2, 0))
    right, below = min(1, cols - 1), cols if rows > 1 else 0
    u, v = col - j, row - i
    flat = values.ravel()
    k: NDArray[np.intp] = i * cols + j
    top = flat[k] + u * (flat[k + right] - flat[k])
    k = k + below
    bottom = flat[k] + u * (flat[k + right] - flat[k])
    return np.asarray(np.where(known, top + v * (bottom - top), np.nan))


def tin_terrain(
    frame: EnuPlane,
    cells: SquareCells,
    heights: Array,
    sigmas: Array,
    *,
    kind: SurfaceKind,
    sigma: float,
    sigma_shared: float,
) -> TinTerrain:
    """Ground from heights, m above the ellipsoid, on a grid of the project's plane; all in m.

    `heights` (rows, cols) are those of `cells`, finite; the rest is told at `TinTerrain`.
    """
    if min(heights.shape) < 2 or not np.all(np.isfinite(heights)):
        raise ValueError("heights must be finite, in at least two rows and columns")
    slope = [np.abs(np.diff(heights, axis=k)).max() / cells.cell for k in (0, 1)]
    return TinTerrain(
        frame=frame,
        heights=np.ascontiguousarray(heights, dtype=np.float64),
        left=cells.left,
        top=cells.top,
        cell=(cells.cell, cells.cell),
        step=0.5 * cells.cell,
        sigma=sigma,
        kind=kind,
        sigmas=np.ascontiguousarray(sigmas, dtype=np.float64),
        sigma_shared=sigma_shared,
        steepest=float(np.hypot(*slope)),
    )
