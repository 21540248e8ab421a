"""From map pixels to photo pixels through a coarse mesh whose error is checked, not hoped for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.grid import Grid, Window
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import DemTerrain, Terrain

# m; the polynomial may differ from the rigorous way by this much
LOCAL_MAP_TOLERANCE = 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """Map to enu over one site as a polynomial: cubic in the plane, linear in height.

    The rigorous way costs 2 microseconds a point; the polynomial is fitted to it and checked at
    other points. Where it would be off by more than `LOCAL_MAP_TOLERANCE` the rigorous way is
    used.
    """

    frame: MapFrame
    centre: Array
    scale: Array
    coefficients: Array | None

    @classmethod
    def fit(
        cls,
        frame: MapFrame,
        bounds: tuple[float, float, float, float],
        heights: tuple[float, float],
    ) -> LocalMap:
        """Polynomial over (left, bottom, right, top) CRS units and a range of heights, m."""
        left, bottom, right, top = bounds
        lo, hi = heights[0] - 1.0, heights[1] + 1.0
        centre = np.array([(left + right) / 2, (bottom + top) / 2, (lo + hi) / 2])
        scale = np.maximum(np.array([right - left, top - bottom, hi - lo]) / 2, 1e-6)
        t = np.cos(np.pi * (np.arange(7) + 0.5) / 7)  # Chebyshev nodes
        nodes = np.stack(np.meshgrid(t, t, [-1.0, 0.0, 1.0], indexing="ij"), -1).reshape(-1, 3)
        enu = frame.enu_from_map(centre + nodes * scale)
        if not np.all(np.isfinite(enu)):
            raise GeometryError(f"'{frame.crs.name}' has no coordinates at the site")
        coefficients, *_ = np.linalg.lstsq(_terms(nodes), enu, rcond=None)
        check = np.random.default_rng(0).uniform(-1, 1, size=(60, 3))
        error = np.abs(_terms(check) @ coefficients - frame.enu_from_map(centre + check * scale))
        good = float(error.max()) < LOCAL_MAP_TOLERANCE
        return cls(frame, centre, scale, coefficients.astype(np.float64) if good else None)

    def enu_from_map(self, p_map: Array) -> Array:
        """Enu m of (easting, northing, ellipsoidal height m); shape (..., 3)."""
        if self.coefficients is None:
            return self.frame.enu_from_map(p_map)
        x, y, h = np.moveaxis((p_map - self.centre) / self.scale, -1, 0)
        out = np.empty(p_map.shape)
        for k, c in enumerate(self.coefficients.T):
            out[..., k] = _cubic(c, x, y) + h * (c[10] + x * c[11] + y * c[12])
        return out


def _terms(t: Array) -> Array:
    x, y, h = t[:, 0], t[:, 1], t[:, 2]
    return np.column_stack([_plane_terms(t[:, :2]), h, h * x, h * y])


@dataclass(frozen=True, slots=True, eq=False)
class PlanePolynomial:
    """From one map to another over one site, cubic in the plane."""

    centre: Array
    scale: Array
    coefficients: Array

    @classmethod
    def between(
        cls, frame: MapFrame, dem: DemTerrain, bounds: tuple[float, float, float, float]
    ) -> PlanePolynomial | None:
        """From a map to a DEM's CRS over bounds; None where it would miss by 1 % of a cell."""
        left, bottom, right, top = bounds
        centre = np.array([(left + right) / 2, (bottom + top) / 2])
        scale = np.maximum(np.array([right - left, top - bottom]) / 2, 1e-6)
        level = float(np.nanmean(dem.heights))

        def rigorous(t: Array) -> Array:
            p = np.concatenate([centre + t * scale, np.full((len(t), 1), level)], axis=-1)
            return dem.frame.map_from_geo(frame.geo_from_map(p))[:, :2]

        t = np.cos(np.pi * (np.arange(7) + 0.5) / 7)
        nodes = np.stack(np.meshgrid(t, t, indexing="ij"), -1).reshape(-1, 2)
        values = rigorous(nodes)
        if not np.all(np.isfinite(values)):
            return None
        coefficients, *_ = np.linalg.lstsq(_plane_terms(nodes), values, rcond=None)
        check = np.random.default_rng(0).uniform(-1, 1, size=(40, 2))
        error = np.abs(_plane_terms(check) @ coefficients - rigorous(check)).max(axis=0)
        if np.any(error > 0.01 * np.abs(dem.cell)):
            return None
        return cls(centre, scale, coefficients.astype(np.float64))

    def __call__(self, xy: Array) -> Array:
        """Coordinates in the other map; shape (..., 2)."""
        x, y = np.moveaxis((xy - self.centre) / self.scale, -1, 0)
        return np.stack([_cubic(c, x, y) for c in self.coefficients.T], axis=-1)


def _cubic(c: Array, x: Array, y: Array) -> Array:
    """Sum of the first ten coefficients times `_plane_terms`, by Horner's rule."""
    by_y = c[2] + x * (c[4] + x * c[7]) + y * (c[5] + x * c[8] + y * c[9])
    return np.asarray(c[0] + x * (c[1] + x * (c[3] + x * c[6])) + y * by_y)


def _plane_terms(t: Array) -> Array:
    x, y = t[:, 0], t[:, 1]
    return np.stack(
        [np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The ground as a map grid sees it."""

    local: LocalMap
    terrain: Terrain
    # (easting, northing) of the map to those of a DEM in another CRS; None = one CRS or no DEM
    to_dem: PlanePolynomial | None = None

    @classmethod
    def of(
        cls, frame: MapFrame, grid: Grid, terrain: Terrain, heights: tuple[float, float]
    ) -> Ground:
        """Ground under a grid; `heights` is the range of ellipsoidal heights, m."""
        to_dem = None
        if isinstance(terrain, DemTerrain) and not terrain.lies_on(frame):
            to_dem = PlanePolynomial.between(frame, terrain, grid.bounds)
        local = LocalMap.fit(frame, grid.bounds, heights)
        return cls(local=local, terrain=terrain, to_dem=to_dem)

    def heights_at(self, xy_map: Array) -> Array:
        """Ellipsoidal height of the ground, m, at places of the map; (..., 2) -> (...)."""
        if self.to_dem is not None and isinstance(self.terrain, DemTerrain):
            return self.terrain.height_at_map(self.to_dem(xy_map))
        return self.terrain.height_on_map(self.local.frame, xy_map)

    @property
    def dem(self) -> DemTerrain:
        """The ground's raster of heights."""
        if not isinstance(self.terrain, DemTerrain):
            raise ValueError("there is no DEM")
        return self.terrain

    @property
    def has_relief(self) -> bool:
        """Whether the ground has detail finer than a mesh."""
        return bool(np.isfinite(self.terrain.detail))

    def dem_position(self, xy_map: Array) -> Array:
        """(col, row) in the DEM, (0, 0) = centre of its first cell, of places; (..., 2)."""
        if self.to_dem is not None:
            return self.dem.position(self.to_dem(xy_map))
        return self.dem.position_on_map(self.local.frame, xy_map)

    def enu_at(self, grid: Grid, colrow: Array) -> Array:
        """Ground points, m in enu, under grid positions; shape (..., 2) -> (..., 3)."""
        xy = grid.map_from_grid(colrow)
        h = self.heights_at(xy)
        return self.local.enu_from_map(np.concatenate([xy, h[..., None]], axis=-1))


def node_positions(window: Window, step: int) -> Array:
    """Grid positions (col, row) of the mesh over a window; shape (rows, cols, 2).

    Nodes are the centres of cells of `step` pixels, with one ring of cells around the window, so
    that an area resize of the mesh by `step` lands on pixel centres.
    """
    n_cols, n_rows = -(-window.width // step), -(-window.height // step)
    col = window.col + (np.arange(-1, n_cols + 1) + 0.5) * step
    row = window.row + (np.arange(-1, n_rows + 1) + 0.5) * step
    out = np.empty((row.size, col.size, 2))
    out[..., 0], out[..., 1] = col[None, :], row[:, None]
    return out


def parallax(photo: OrientedPhoto, p_enu: Array) -> Array:
    """How far the pixels of ground points move per metre of height; (..., 3) -> (..., 2) px/m."""
    half = np.array([0.0, 0.0, 0.5])
    both = photo.project(np.stack([p_enu + half, p_enu - half]))
    return np.asarray(both[0] - both[1])
