"""How coarse a mesh between map and photo may be: by its error, which is looked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.geodesy import metres_per_unit
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.model.photo import OrientedPhoto

# px; a mesh is refined until the middle of its cells is this good (a fifth of what is promised)
MESH_TOLERANCE = 0.02
# px; what the ground between the nodes may add
RELIEF_TOLERANCE = 0.05
MESH_STEPS = (64, 32, 16, 8, 4, 2, 1)
# places along each side of a window at which a step is tried; a few of them tell most that fail
PROBES, FEW = 12, 5
# grid px, a multiple of every step: relief is looked at in blocks of this side
RELIEF_BLOCK = 256
# cells of a DEM along a mesh cell's side beyond which its slopes say nothing of what lies between
MANY_CELLS = 8
_HALF_METRE = np.array([0.0, 0.0, 0.5])


def choose_step(photo: OrientedPhoto, ground: Ground, grid: Grid, window: Window) -> int:
    """Coarsest mesh step, px, through which pixels are good to the tolerances.

    What a warp does is compared with the rigorous projection at places all over the window:
    bilinear in the mesh, and over a DEM moved by the parallax times the height that the mesh
    leaves out. That height is bounded by the DEM's slopes, and where the bound is too wide it is
    looked for at every half cell: a bank between two places would slip through.
    """
    places = np.stack(
        np.meshgrid(
            window.col + window.width * (np.arange(PROBES) + 0.5) / PROBES,
            window.row + window.height * (np.arange(PROBES) + 0.5) / PROBES,
        ),
        axis=-1,
    ).reshape(-1, 1, 2)
    for step in MESH_STEPS[:-1]:
        some = (places[::FEW], places)
        # NaN compares as false: it is not good
        if not all(_mesh_error(photo, ground, grid, p, step) <= MESH_TOLERANCE for p in some):
            continue
        if not ground.has_relief:
            return step
        heights = _left_out(ground, grid, window, step)
        if any(
            _parallax_error(photo, ground, grid, places, h) <= RELIEF_TOLERANCE for h in heights
        ):
            return step
    return MESH_STEPS[-1]


def _mesh_error(
    photo: OrientedPhoto, ground: Ground, grid: Grid, places: Array, step: int
) -> float:
    """Largest error of a warp, px, at the middles of cells and of their sides; inf if unknown."""
    unit = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    xy = grid.map_from_grid(places + unit * step)
    h = ground.heights_at(xy)[..., None]
    p = ground.local.enu_from_map(np.concatenate([xy, h], axis=-1))
    if ground.has_relief:
        corners = p[:, :4]
        p = np.concatenate([p, corners + _HALF_METRE, corners - _HALF_METRE], axis=1)
    uv = photo.project(p)
    true, guess = uv[:, 4:7], _bilinear(uv)
    if ground.has_relief:
        guess = guess + _bilinear(uv[:, 7:11] - uv[:, 11:]) * (h[:, 4:] - _bilinear(h))
    error = np.abs(true - guess)[photo.contains(true)]
    return float(np.max(error, initial=0.0)) if np.all(np.isfinite(error)) else np.inf


def _bilinear(values: Array) -> Array:
    """At the middle of cells and of two sides, from the four corners; (n, 4+, k) -> (n, 3, k)."""
    a, b, c, d = (values[:, i] for i in range(4))
    return np.stack([(a + b + c + d) / 4, (a + b) / 2, (a + c) / 2], axis=1)


def _parallax_error(
    photo: OrientedPhoto, ground: Ground, grid: Grid, places: Array, height: float
) -> float:
    """What the parallax times a height, m, misses of the true move of a pixel, px, at most."""
    ups = np.array([0.0, 0.5, -0.5, height, -height])[:, None] * [0.0, 0.0, 1.0]
    uv = photo.project(ground.enu_at(grid, places) + ups)
    seen, here = photo.contains(uv[:, 0]), uv[:, 0]
    move = uv[:, 1] - uv[:, 2]
    worst = 0.0
    for there, h in ((uv[:, 3], height), (uv[:, 4], -height)):
        missed = np.abs(there - here - move * h)[seen]
        worst = max(worst, float(np.max(missed, initial=0.0, where=np.isfinite(missed))))
    return worst


def _left_out(ground: Ground, grid: Grid, window: Window, step: int) -> Iterator[float]:
    """Heights, m, that a mesh leaves out between its nodes at most: a quick bound, the largest."""
    bound = _ReliefBound.of(ground, grid, window, step)
    most = bound.over(ground, grid, window)
    if np.isfinite(most):
        yield most
    blocks = list(_blocks(window, step))
    mosts = np.array([bound.over(ground, grid, block) for block in blocks])
    worst = 0.0
    for k in np.argsort(-mosts):
        if mosts[k] <= worst:
            break
        worst = max(worst, _sampled_relief(ground, grid, blocks[k], step))
    yield worst


def _blocks(window: Window, step: int) -> Iterator[Window]:
    """Parts of a window and a little around, whose corners are those of the grid's mesh cells."""
    left, top = window.col // step * step, window.row // step * step
    right, bottom = window.col + window.width, window.row + window.height
    for row in range(top, bottom, RELIEF_BLOCK):
        for col in range(left, right, RELIEF_BLOCK):
            yield Window(
                col=col, row=row,
                width=min(RELIEF_BLOCK, right - col), height=min(RELIEF_BLOCK, bottom - row),
            )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _ReliefBound:
    """Height, m, that a mesh leaves out at most, by the DEM cell in which a mesh cell begins.

    Notes
    -----
    What bilinear interpolation from the corners of a mesh cell misses at a place is the mean, by
    the corners' weights, of how far each corner lies off the place's own slope. Slopes in the cell
    differ from their middle by half their range, and the weights' mean distance along an axis is
    half a side at most: so it misses a quarter of side times range, along each axis. Nor does it
    miss more than the heights in the cell differ.
    """

    values: Array
    # (col, row) of the first value's cell in the DEM, and cells that a mesh cell spans
    first: Array
    span: Array

    @classmethod
    def of(cls, ground: Ground, grid: Grid, window: Window, step: int) -> _ReliefBound:
        """Bound for the mesh cells that meet a window; inf where it would say nothing."""
        at = _dem_corners(ground, grid, window)
        # DEM cells along the sides of a mesh cell, and a little for how maps bend
        size = [[window.width], [window.height]]
        sides = 1.01 * step * (at[1:3] - at[0]) / size
        span = np.abs(sides).sum(axis=0)
        cols, rows = (int(n) for n in np.ceil(span) + 1)
        first, last = np.floor(at.min(axis=0) - span), np.floor(at.max(axis=0))
        if span.max() > MANY_CELLS:
            return cls(np.full((1, 1), np.inf), first, span)
        heights = ground.dem.heights
        j = np.arange(int(first[0]), int(last[0]) + cols + 1).clip(0, heights.shape[1] - 1)
        i = np.arange(int(first[1]), int(last[1]) + rows + 1).clip(0, heights.shape[0] - 1)
        part = heights[i[:, None], j[None, :]]
        along = _range(np.diff(part, axis=1), rows + 1, cols)
        across = _range(np.diff(part, axis=0), rows, cols + 1)
        reach = np.hypot(sides[0], sides[1]) / 4.0
        slopes = reach[0] * along + reach[1] * across
        most = np.minimum(slopes, _range(part, rows + 1, cols + 1))
        return cls(np.where(np.isnan(most), np.inf, most), first, span)

    def over(self, ground: Ground, grid: Grid, window: Window) -> float:
        """Bound over a part of the window."""
        at = _dem_corners(ground, grid, window)
        last = np.array(self.values.shape[::-1]) - 1
        low = np.clip(np.floor(at.min(axis=0) - self.span) - self.first, 0, last).astype(int)
        high = np.clip(np.floor(at.max(axis=0)) - self.first, 0, last).astype(int)
        return float(self.values[low[1] : high[1] + 1, low[0] : high[0] + 1].max())


def _dem_corners(ground: Ground, grid: Grid, window: Window) -> Array:
    """Where the corners of a window lie in the DEM: first, next in its row, below; (4, 2)."""
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    corner, size = [window.col, window.row], [window.width, window.height]
    return ground.dem_position(grid.map_from_grid(corner + unit * size))


def _range(values: Array, rows: int, cols: int) -> Array:
    """Largest less smallest value in every part of so many rows and columns; NaN if unknown."""
    n_rows, n_cols = values.shape[0] - rows + 1, values.shape[1] - cols + 1
    high = low = values[:n_rows]
    for k in range(1, rows):
        high, low = (
            np.maximum(high, values[k : k + n_rows]),
            np.minimum(low, values[k : k + n_rows]),
        )
    highest, lowest = high[:, :n_cols], low[:, :n_cols]
    for k in range(1, cols):
        highest = np.maximum(highest, high[:, k : k + n_cols])
        lowest = np.minimum(lowest, low[:, k : k + n_cols])
    return np.asarray(highest - lowest)


def _sampled_relief(ground: Ground, grid: Grid, window: Window, step: int) -> float:
    """Largest height that a mesh leaves out at every half cell of a DEM, m."""
    frame = ground.local.frame
    cell = ground.terrain.detail / (grid.pixel * metres_per_unit(frame.horizontal))
    h = ground.heights_at(grid.map_from_grid(node_positions(window, step)))
    spacing = float(np.clip(cell / 2.0, 1.0, step / 2.0))
    cols, rows = np.arange(0.5, window.width, spacing), np.arange(0.5, window.height, spacing)
    j, u = _split(cols, step)
    i, v = _split(rows, step)
    across = h[:, j] * (1.0 - u) + h[:, j + 1] * u
    guess = across[i] * (1.0 - v[:, None]) + across[i + 1] * v[:, None]
    colrow = np.stack(np.meshgrid(window.col + cols, window.row + rows), axis=-1)
    error = np.abs(ground.heights_at(grid.map_from_grid(colrow)) - guess)
    return float(np.max(error, initial=0.0, where=np.isfinite(error)))


def _split(
    places: Array, step: int
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], Array]:
    """Node before each place of a window and the share of a cell beyond it."""
    t = places / step + 0.5
    i = np.floor(t).astype(np.intp)
    return i, t - i
