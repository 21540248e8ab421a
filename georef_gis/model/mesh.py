"""From map pixels to photo pixels through a coarse mesh whose error is checked, not hoped for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.grid import Grid, Window
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain

# m; the polynomial may differ from the rigorous way by this much
LOCAL_MAP_TOLERANCE = 2e-4
# px; a mesh is refined until the middle of its cells is this good (a fifth of what is promised)
MESH_TOLERANCE = 0.02
MESH_STEPS = (64, 32, 16, 8, 4, 2, 1)
# places along each side of a window at which a step is tried
PROBES = 12


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
        shape = p_map.shape
        t = ((p_map - self.centre) / self.scale).reshape(-1, 3)
        return np.asarray((_terms(t) @ self.coefficients).reshape(shape))


def _terms(t: Array) -> Array:
    x, y, h = t[:, 0], t[:, 1], t[:, 2]
    plane = [np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
    return np.stack([*plane, h, h * x, h * y], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The ground as a map grid sees it."""

    local: LocalMap
    terrain: Terrain

    @classmethod
    def of(
        cls, frame: MapFrame, grid: Grid, terrain: Terrain, heights: tuple[float, float]
    ) -> Ground:
        """Ground under a grid; `heights` is the range of ellipsoidal heights, m."""
        return cls(local=LocalMap.fit(frame, grid.bounds, heights), terrain=terrain)

    def enu_at(self, grid: Grid, colrow: Array) -> Array:
        """Ground points, m in enu, under grid positions; shape (..., 2) -> (..., 3)."""
        xy = grid.map_from_grid(colrow)
        h = self.terrain.height_on_map(self.local.frame, xy)
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


def choose_step(photo: OrientedPhoto, ground: Ground, grid: Grid, window: Window) -> int:
    """Coarsest mesh step, px, whose bilinear interpolation is good to `MESH_TOLERANCE`.

    The middles of cells and of their sides, spread over the window, are compared with the
    rigorous projection.
    """
    places = np.stack(
        np.meshgrid(
            window.col + window.width * (np.arange(PROBES) + 0.5) / PROBES,
            window.row + window.height * (np.arange(PROBES) + 0.5) / PROBES,
        ),
        axis=-1,
    ).reshape(-1, 1, 2)
    unit = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    for step in MESH_STEPS[:-1]:
        uv = photo.project(ground.enu_at(grid, places + unit * step))
        a, b, c, d = (uv[:, i] for i in range(4))
        guess = np.stack([(a + b + c + d) / 4, (a + b) / 2, (a + c) / 2], axis=1)
        true = uv[:, 4:]
        error = np.abs(true - guess)[photo.contains(true)]
        if np.all(np.isfinite(error)) and np.max(error, initial=0.0) <= MESH_TOLERANCE:
            return step
    return MESH_STEPS[-1]
