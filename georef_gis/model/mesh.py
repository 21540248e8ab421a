"""From map pixels to photo pixels through a coarse mesh whose error is checked, not hoped for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.model.grid import Grid, Window
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import DemTerrain, Terrain

# m; the polynomial may differ from the rigorous way by this much
LOCAL_MAP_TOLERANCE = 2e-4
# px; a mesh is refined until the middle of its cells is this good (a fifth of what is promised)
MESH_TOLERANCE = 0.02
# px; what kinks of the ground may add, looked for at every half cell of a DEM
RELIEF_TOLERANCE = 0.06
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
        t = ((xy - self.centre) / self.scale).reshape(-1, 2)
        return np.asarray((_plane_terms(t) @ self.coefficients).reshape(xy.shape))


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
        if isinstance(terrain, DemTerrain) and frame.horizontal != terrain.frame.horizontal:
            to_dem = PlanePolynomial.between(frame, terrain, grid.bounds)
        local = LocalMap.fit(frame, grid.bounds, heights)
        return cls(local=local, terrain=terrain, to_dem=to_dem)

    def heights_at(self, xy_map: Array) -> Array:
        """Ellipsoidal height of the ground, m, at places of the map; (..., 2) -> (...)."""
        if self.to_dem is not None and isinstance(self.terrain, DemTerrain):
            return self.terrain.height_at_map(self.to_dem(xy_map))
        return self.terrain.height_on_map(self.local.frame, xy_map)

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


def choose_step(photo: OrientedPhoto, ground: Ground, grid: Grid, window: Window) -> int:
    """Coarsest mesh step, px, whose bilinear interpolation is good to `MESH_TOLERANCE`.

    The middles of cells and of their sides, spread over the window, are compared with the
    rigorous projection. That finds what is smooth; a bank of one DEM cell would slip through, so
    the heights are compared everywhere.
    """
    places = np.stack(
        np.meshgrid(
            window.col + window.width * (np.arange(PROBES) + 0.5) / PROBES,
            window.row + window.height * (np.arange(PROBES) + 0.5) / PROBES,
        ),
        axis=-1,
    ).reshape(-1, 1, 2)
    px_per_m = _pixels_per_height(photo, ground, grid, places)
    unit = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    for step in MESH_STEPS[:-1]:
        uv = photo.project(ground.enu_at(grid, places + unit * step))
        a, b, c, d = (uv[:, i] for i in range(4))
        guess = np.stack([(a + b + c + d) / 4, (a + b) / 2, (a + c) / 2], axis=1)
        true = uv[:, 4:]
        error = np.abs(true - guess)[photo.contains(true)]
        smooth = np.all(np.isfinite(error)) and np.max(error, initial=0.0) <= MESH_TOLERANCE
        if smooth and _relief_error(ground, grid, window, step) * px_per_m <= RELIEF_TOLERANCE:
            return step
    return MESH_STEPS[-1]


def _pixels_per_height(photo: OrientedPhoto, ground: Ground, grid: Grid, places: Array) -> float:
    """How far a pixel moves per metre of the ground's height, px/m, at most."""
    p = ground.enu_at(grid, places)
    uv = photo.project(p)
    moved = np.abs(photo.project(p + np.array([0.0, 0.0, 1.0])) - uv)[photo.contains(uv)]
    return float(np.max(moved, initial=0.0, where=np.isfinite(moved)))


def _relief_error(ground: Ground, grid: Grid, window: Window, step: int) -> float:
    """Largest error of heights interpolated between the nodes of a mesh, m."""
    frame = ground.local.frame
    cell = ground.terrain.detail / (grid.pixel * metres_per_unit(frame.horizontal))
    if not np.isfinite(cell):
        return 0.0
    nodes = node_positions(window, step)
    h = ground.heights_at(grid.map_from_grid(nodes))
    spacing = float(np.clip(cell / 2.0, 1.0, step / 2.0))
    cols = np.arange(0.5, window.width, spacing)
    j, u = _split(cols, step)
    worst = 0.0
    rows_at_once = max(1, 500_000 // cols.size)
    all_rows = np.arange(0.5, window.height, spacing)
    for first in range(0, all_rows.size, rows_at_once):
        rows = all_rows[first : first + rows_at_once]
        i, v = _split(rows, step)
        across = h[:, j] * (1.0 - u) + h[:, j + 1] * u
        guess = across[i] * (1.0 - v[:, None]) + across[i + 1] * v[:, None]
        colrow = np.stack(np.meshgrid(window.col + cols, window.row + rows), axis=-1)
        true = ground.heights_at(grid.map_from_grid(colrow))
        error = np.abs(true - guess)
        worst = max(worst, float(np.max(error, initial=0.0, where=np.isfinite(error))))
    return worst


def _split(
    places: Array, step: int
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], Array]:
    """Node before each place of a window and the share of a cell beyond it."""
    t = places / step + 0.5
    i = np.floor(t).astype(np.intp)
    return i, t - i
