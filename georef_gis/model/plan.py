"""Plan: which photos each tile of a raster needs; one value for threads, processes and resume."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.tile_order import best_order

PLAN_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class TileTask:
    """One tile and the photos that may show it."""

    row: int
    col: int
    window: Window
    photo_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Tiles of a grid that hold something, in the order to work them off.

    The order is one in which neighbours share photos, so that each photo is decoded about once.
    """

    grid: Grid
    tile_size: int
    tiles: tuple[TileTask, ...]

    def without(self, done: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Plan:
        """The plan less the tiles that are done; `done` (rows, cols)."""
        return replace(self, tiles=tuple(t for t in self.tiles if not done[t.row, t.col]))

    def to_json(self) -> str:
        """As JSON text, for another process or a later run."""
        g = self.grid
        return json.dumps(
            {
                "version": PLAN_VERSION,
                "grid": [g.crs_wkt, g.left, g.top, g.pixel, g.width, g.height],
                "tile_size": self.tile_size,
                "tiles": [[t.row, t.col, list(t.photo_ids)] for t in self.tiles],
            }
        )

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Plan from `to_json`.

        Raises
        ------
        ValueError
            If it was written by another version.
        """
        d = json.loads(text)
        if d.get("version") != PLAN_VERSION:
            raise ValueError(f"plan of version {d.get('version')}, not {PLAN_VERSION}")
        wkt, left, top, pixel, width, height = d["grid"]
        grid = Grid(crs_wkt=wkt, left=left, top=top, pixel=pixel, width=width, height=height)
        size = int(d["tile_size"])
        tiles = tuple(_task(grid, size, row, col, tuple(ids)) for row, col, ids in d["tiles"])
        return cls(grid=grid, tile_size=size, tiles=tiles)


def _task(grid: Grid, size: int, row: int, col: int, photo_ids: tuple[str, ...]) -> TileTask:
    window = Window(
        col=col * size,
        row=row * size,
        width=min(size, grid.width - col * size),
        height=min(size, grid.height - row * size),
    )
    return TileTask(row=row, col=col, window=window, photo_ids=photo_ids)


def plan_tiles(
    grid: Grid, rings_map: Mapping[str, Array], *, tile_size: int = 512, capacity: int = 8
) -> Plan:
    """Plan of a grid from the footprints' rings (n, 2) in its CRS.

    A photo belongs to a tile unless a side of the convex hull of its ring or of the tile separates
    them; a tile without photos is left out. The order suits a cache of `capacity` photos.
    """
    rows, cols = -(-grid.height // tile_size), -(-grid.width // tile_size)
    found: dict[tuple[int, int], list[str]] = {}
    for photo_id, ring in rings_map.items():
        p = grid.grid_from_map(ring) / tile_size
        hull = _convex_hull(p)
        c0, r0 = np.floor(hull.min(axis=0)).astype(int)
        c1, r1 = np.floor(hull.max(axis=0)).astype(int)
        c0, r0, c1, r1 = max(c0, 0), max(r0, 0), min(c1, cols - 1), min(r1, rows - 1)
        if c1 < c0 or r1 < r0:
            continue
        touched = _touched(hull, np.arange(c0, c1 + 1), np.arange(r0, r1 + 1))
        for i, j in zip(*np.nonzero(touched), strict=True):
            found.setdefault((int(r0 + i), int(c0 + j)), []).append(photo_id)
    cells = sorted(found)
    order = best_order(cells, [found[cell] for cell in cells], capacity=capacity)
    tiles = tuple(
        _task(grid, tile_size, *cells[i], photo_ids=tuple(found[cells[i]])) for i in order
    )
    return Plan(grid=grid, tile_size=tile_size, tiles=tiles)


def _convex_hull(p: Array) -> Array:
    """Convex hull, counter-clockwise in its own axes (Andrew's monotone chain); (n, 2)."""
    points = sorted({(float(x), float(y)) for x, y in p})
    if len(points) < 3:
        return np.array(points)

    def half(sequence: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for q in sequence:
            while len(out) > 1 and _turn(out[-2], out[-1], q) <= 0:
                out.pop()
            out.append(q)
        return out[:-1]

    return np.array(half(points) + half(points[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _touched(
    hull: Array, cols: Array, rows: Array
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which unit squares at (cols, rows) no side of the hull separates from it."""
    x0, y0 = np.meshgrid(cols, rows)
    out = np.ones(x0.shape, dtype=bool)
    for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        nx, ny = a[1] - b[1], b[0] - a[0]  # inward normal of a counter-clockwise side
        # The corner of the square that lies deepest on the inner side decides.
        depth = (x0 + (nx > 0) - a[0]) * nx + (y0 + (ny > 0) - a[1]) * ny
        out &= depth >= 0
    return out
