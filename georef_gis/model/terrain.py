"""Terrain: the ground as a surface in the project's enu; height at a place, and where rays meet it.

All surfaces answer in enu, so they bend with the Earth: 8 cm at 1 km, 2 m at 5 km.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import CRS, WGS84_A, WGS84_E2, MapFrame, Origin

# m; bisection stops here
HIT_TOLERANCE = 1e-4


class Terrain(Protocol):
    """The ground."""

    @property
    def sigma(self) -> float:
        """One standard deviation of the ground's height, m."""
        ...

    @property
    def detail(self) -> float:
        """Horizontal distance, m, within which the ground is smooth; inf if it is everywhere."""
        ...

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu of the ground at east, north; (..., 2) m -> (...), NaN outside."""
        ...

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Ellipsoidal height, m, at places of a map; (..., 2) CRS units -> (...), NaN outside."""
        ...

    def intersect(self, origin_enu: ArrayLike, d_enu: ArrayLike) -> Array:
        """First meeting of rays with the ground; (..., 3) m, NaN where a ray misses."""
        ...


class PlaneFrame(Protocol):
    """A plane on which a raster of ellipsoidal heights lies: a map, or the project's own plane."""

    @property
    def origin(self) -> Origin:
        """Origin of the project's enu."""
        ...

    @property
    def horizontal(self) -> CRS | None:
        """CRS of the plane; None where it has none."""
        ...

    def map_from_enu(self, p_enu: ArrayLike) -> Array:
        """(x, y in the plane's units, ellipsoidal height m) of enu m; shape (..., 3)."""
        ...

    def map_from_geo(self, p_geo: ArrayLike) -> Array:
        """The same of (lat, lon rad, ellipsoidal height m); shape (..., 3)."""
        ...

    def enu_from_map(self, p_map: ArrayLike) -> Array:
        """Enu m of (x, y, ellipsoidal height m); shape (..., 3)."""
        ...


def z_of_constant_height(origin: Origin, height: float, xy: Array) -> Array:
    """Up coordinate of the surface of one ellipsoidal height, to < 0.1 mm within 20 km.

    Notes
    -----
    Closed form on the ellipsoid with both semi-axes enlarged by the height. It lies below the
    surface of that height by up to 1.4e-6 of the height, nearly the same over a site: taken off.
    """
    a = WGS84_A + height
    b = WGS84_A * np.sqrt(1.0 - WGS84_E2) + height
    R = origin.R_ecef_from_enu
    # p = p0 + x E + y N + z U on X^2/a^2 + Y^2/a^2 + Z^2/b^2 = 1: a quadratic in z.
    w = np.array([1.0 / a**2, 1.0 / a**2, 1.0 / b**2])
    base = origin.p_ecef + xy @ R[:, :2].T
    up = R[:, 2]
    qa = float(up @ (w * up))
    qb = base @ (w * up)
    qc = np.sum(w * base * base, axis=-1) - 1.0
    z = (-qb + np.sqrt(np.maximum(qb * qb - qa * qc, 0.0))) / qa
    base0 = origin.p_ecef
    b0, c0 = float(base0 @ (w * up)), float(base0 @ (w * base0)) - 1.0
    z0 = (-b0 + np.sqrt(b0 * b0 - qa * c0)) / qa
    return np.asarray(z + (height - origin.height_ellipsoidal - z0))


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatTerrain:
    """Ground of one ellipsoidal height, m."""

    origin: Origin
    height_ellipsoidal: float
    sigma: float = 0.0

    @property
    def detail(self) -> float:
        """Smooth everywhere."""
        return float("inf")

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate of the ground; (..., 2) m -> (...)."""
        xy = np.asarray(xy_enu, dtype=np.float64)
        return z_of_constant_height(self.origin, self.height_ellipsoidal, xy)

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Ellipsoidal height, m, at places of a map: the one height; (..., 2) -> (...)."""
        return np.full(np.shape(xy_map)[:-1], self.height_ellipsoidal)

    def intersect(self, origin_enu: ArrayLike, d_enu: ArrayLike) -> Array:
        """First meeting of rays with the ground; (..., 3) m, NaN where a ray misses."""
        o, d = np.broadcast_arrays(np.asarray(origin_enu, float), np.asarray(d_enu, float))
        _refuse_below(self, o)
        z = self.height_ellipsoidal - self.origin.height_ellipsoidal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(d[..., 2] < -1e-6, (z - o[..., 2]) / d[..., 2], np.nan)
            for _ in range(12):
                p = o + t[..., None] * d
                ground = self.z_at(p[..., :2])
                # Secant through the plane tangent below the point: converges in a few steps.
                step = (ground - p[..., 2]) / d[..., 2]
                t = t + step
                if _largest(np.abs(step)) <= HIT_TOLERANCE / 10:
                    break
            t = np.where((t > 0) & (np.abs(step) < 1.0), t, np.nan)
        return np.asarray(o + t[..., None] * d)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DemTerrain:
    """Ground from a raster of ellipsoidal heights, m, bilinear between the cell centres.

    `heights` (rows, cols) north-up, NaN where there is none; (`left`, `top`) is the outer corner
    of the first cell in the CRS of `frame`, `cell` its (width, height) in CRS units.
    """

    frame: PlaneFrame
    heights: Array
    left: float
    top: float
    cell: tuple[float, float]
    # ground step for marching along a ray, m
    step: float
    sigma: float = 0.0

    @property
    def detail(self) -> float:
        """A cell, m: the surface has its kinks at the cell centres' lines."""
        return 2.0 * self.step

    def lies_on(self, frame: MapFrame) -> bool:
        """Whether the raster's plane is that of a map."""
        own = self.frame.horizontal
        return own is not None and bool(frame.horizontal == own)

    def position(self, xy_map: Array) -> Array:
        """(col, row), (0, 0) = centre of the first cell, of places of the DEM's map; (..., 2)."""
        return np.stack(
            [
                (xy_map[..., 0] - self.left) / self.cell[0] - 0.5,
                (self.top - xy_map[..., 1]) / self.cell[1] - 0.5,
            ],
            axis=-1,
        )

    def position_on_map(self, frame: MapFrame, xy_map: Array) -> Array:
        """Like `position`, of places of any map; (..., 2) CRS units -> (..., 2)."""
        if self.lies_on(frame):
            return self.position(xy_map)
        # Two projections of one ellipsoid: the place does not depend on the height used here.
        level = np.full((*xy_map.shape[:-1], 1), float(np.nanmean(self.heights)))
        geo = frame.geo_from_map(np.concatenate([xy_map, level], axis=-1))
        return self.position(self.frame.map_from_geo(geo)[..., :2])

    def height_at_map(self, xy_map: ArrayLike) -> Array:
        """Ellipsoidal height, m, at map coordinates; (..., 2) -> (...), NaN outside."""
        return self.height_at(self.position(np.asarray(xy_map, dtype=np.float64)))

    def height_at(self, at: Array) -> Array:
        """Ellipsoidal height, m, at (col, row), see `position`; (..., 2) -> (...), NaN outside."""
        col, row = at[..., 0], at[..., 1]
        rows, cols = self.heights.shape
        with np.errstate(invalid="ignore"):
            inside = (col >= -0.5) & (row >= -0.5) & (col <= cols - 0.5) & (row <= rows - 0.5)
        # Half a cell at the rim is extended: the outermost centres are not the raster's edge.
        col = np.clip(np.where(inside, col, 0.0), 0.0, cols - 1.0)
        row = np.clip(np.where(inside, row, 0.0), 0.0, rows - 1.0)
        i = np.clip(row.astype(int), 0, max(rows - 2, 0))
        j = np.clip(col.astype(int), 0, max(cols - 2, 0))
        i2, j2 = np.minimum(i + 1, rows - 1), np.minimum(j + 1, cols - 1)
        v, u = row - i, col - j
        h = self.heights
        z = (h[i, j] * (1 - u) + h[i, j2] * u) * (1 - v) + (h[i2, j] * (1 - u) + h[i2, j2] * u) * v
        return np.asarray(np.where(inside, z, np.nan))

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Ellipsoidal height, m, at places of any map; (..., 2) CRS units -> (...), NaN outside."""
        return self.height_at(self.position_on_map(frame, np.asarray(xy_map, dtype=np.float64)))

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate of the ground; (..., 2) m -> (...), NaN outside the raster."""
        xy = np.asarray(xy_enu, dtype=np.float64)
        z = np.zeros(xy.shape[:-1])
        # The place on the map depends on z only through the tilt of the vertical: 1e-4 per km.
        for _ in range(3):
            p = self.frame.map_from_enu(np.concatenate([xy, z[..., None]], axis=-1))
            h = self.height_at_map(p[..., :2])
            z = z + np.where(np.isfinite(h), h - p[..., 2], 0.0)
        return np.asarray(np.where(np.isfinite(h), z, np.nan))

    def intersect(self, origin_enu: ArrayLike, d_enu: ArrayLike) -> Array:
        """First meeting of rays with the ground; (..., 3) m, NaN where a ray misses.

        Notes
        -----
        Marches downward from the highest ground in steps of half a cell, then bisects.
        """
        o, d = np.broadcast_arrays(np.asarray(origin_enu, float), np.asarray(d_enu, float))
        _refuse_below(self, o)
        shape = d.shape
        o, d = o.reshape(-1, 3), d.reshape(-1, 3)
        near, far = self._bracket(o, d)
        near, far = self._march(o, d, near, far)
        for _ in range(40):
            middle = (near + far) / 2.0
            above = self._clearance(o, d, middle) > 0
            near, far = np.where(above, middle, near), np.where(above, far, middle)
            if _largest(far - near) <= HIT_TOLERANCE:
                break
        return np.asarray((o + far[:, None] * d).reshape(shape))

    def _clearance(self, o: Array, d: Array, t: Array) -> Array:
        p = o + t[:, None] * d
        return np.asarray(p[:, 2] - self.z_at(p[:, :2]))

    def _bracket(self, o: Array, d: Array) -> tuple[Array, Array]:
        """Ray parameters, m, where the rays pass the highest and the lowest ground."""
        h0 = self.frame.origin.height_ellipsoidal
        high = float(np.nanmax(self.heights)) - h0 + 1.0
        low = float(np.nanmin(self.heights)) - h0 - 1.0
        # The surface bends away from enu's plane by at most this over the raster.
        reach = np.hypot(*np.array(self.heights.shape)) * 2 * self.step + np.abs(o[:, 2]).max() * 20
        low -= reach**2 / (2 * WGS84_A)
        with np.errstate(divide="ignore", invalid="ignore"):
            down = d[:, 2] < -1e-3
            near = np.where(down, np.maximum((high - o[:, 2]) / d[:, 2], 0.0), np.nan)
            far = np.where(down, (low - o[:, 2]) / d[:, 2], np.nan)
        return near, far

    def _march(self, o: Array, d: Array, near: Array, far: Array) -> tuple[Array, Array]:
        """Narrow [near, far] to one step in which the ray goes below the ground."""
        slant = np.linalg.norm(d[:, :2], axis=-1)
        # Half a cell of ground, or a tenth of the relief where the ray is steep.
        step = np.maximum(self.step / np.maximum(slant, 1e-9), 0.0)
        step = np.minimum(step, np.maximum(far - near, 1e-6))
        hit_near, hit_far = np.full_like(near, np.nan), np.full_like(far, np.nan)
        t = near.copy()
        open_rays = np.isfinite(t)
        for _ in range(20000):
            if not np.any(open_rays):
                break
            i = np.flatnonzero(open_rays)
            following = np.minimum(t[i] + step[i], far[i])
            c = self._clearance(o[i], d[i], following)
            below = c <= 0
            hit_near[i[below]], hit_far[i[below]] = t[i[below]], following[below]
            # Outside the raster (NaN) a ray goes on: it may enter from the side.
            done = below | (following >= far[i])
            t[i] = np.minimum(following + self._free_run(d[i], slant[i], c), far[i])
            open_rays[i[done]] = False
        return hit_near, hit_far

    def _free_run(self, d: Array, slant: Array, clearance: Array) -> Array:
        """How far rays can go on, m, before they may meet the ground; shape (n,)."""
        return np.zeros_like(slant)


def _largest(x: Array) -> float:
    """Largest of the finite values, 0 where there is none."""
    return float(np.max(x, initial=0.0, where=np.isfinite(x)))


def _refuse_below(terrain: Terrain, origin_enu: Array) -> None:
    o = np.unique(origin_enu.reshape(-1, 3), axis=0)
    ground = terrain.z_at(o[:, :2])
    below = o[:, 2] <= ground
    if np.any(below):
        i = int(np.flatnonzero(below)[0])
        raise GeometryError(
            f"the projection centre lies {ground[i] - o[i, 2]:.1f} m below the ground; "
            "check the kinds of the heights (ellipsoidal or orthometric)"
        )


def dem_terrain(
    frame: MapFrame,
    heights_ellipsoidal: Array,
    *,
    left: float,
    top: float,
    cell: tuple[float, float],
    metres_per_unit: float,
    sigma: float = 0.0,
) -> DemTerrain:
    """DEM from a north-up raster of ellipsoidal heights, m.

    Raises
    ------
    GeometryError
        If no cell has a height.
    """
    if not np.any(np.isfinite(heights_ellipsoidal)):
        raise GeometryError("the DEM has no height in the area of the photos")
    return DemTerrain(
        frame=frame,
        heights=np.ascontiguousarray(heights_ellipsoidal, dtype=np.float64),
        left=left,
        top=top,
        cell=cell,
        step=0.5 * min(cell) * metres_per_unit,
        sigma=sigma,
    )
