"""Seam polygons on windows of the fine grid: labels, weights, distances.

Every value follows from the pixel's centre and the polygons alone, in coordinates of the whole
grid: whatever the windows, a pixel gets the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.compiled import compiled

if TYPE_CHECKING:
    from shapely import MultiPolygon, Polygon

Labels = NDArray[np.int32]
Weights = NDArray[np.float32]
# px; float64 coordinates of a grid are safe to far less
MARGIN = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeamIndex:
    """Polygons ready to be drawn; can be pickled.

    Parameters
    ----------
    labels : shape (n,)
        Label of each polygon.
    edges : shape (m, 4), map
        x and y of the lower end, x and y of the upper one: neighbours hold the same numbers, so
        that rounding cannot part them.
    first : shape (n + 1,)
        Where the edges of each polygon start, and where the last ends.
    tree
        STRtree of the polygons' bounds.
    """

    labels: Labels
    edges: Array
    first: NDArray[np.int64]
    tree: Any

    @classmethod
    def of(cls, polygons: Sequence[tuple[int, Polygon | MultiPolygon]]) -> SeamIndex:
        """Index of labels and their areas, one per label; where they overlap the later wins."""
        import shapely

        areas = np.array([area for _, area in polygons], dtype=object)
        rings, ring_area = _rings_of(areas)
        xy, ring = shapely.get_coordinates(rings, return_index=True)
        same = ring[1:] == ring[:-1]
        a, b = xy[:-1][same], xy[1:][same]
        up = (a[:, 1] < b[:, 1]) | ((a[:, 1] == b[:, 1]) & (a[:, 0] < b[:, 0]))
        edges = np.where(up[:, None], np.hstack([a, b]), np.hstack([b, a]))
        count = np.bincount(ring_area[ring[1:][same]], minlength=len(areas))
        bounds = shapely.bounds(areas).reshape(-1, 4)
        return cls(
            labels=np.array([label for label, _ in polygons], dtype=np.int32),
            edges=np.ascontiguousarray(edges, dtype=np.float64),
            first=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
            tree=shapely.STRtree(shapely.box(*bounds.T)),
        )

    def near(self, grid: Grid, window: Window, reach: float) -> Near:
        """Polygons whose bounds come within `reach` px of a window, in px of the grid."""
        import shapely

        r = reach + MARGIN
        low = (window.col - r, window.row + window.height + r)
        high = (window.col + window.width + r, window.row - r)
        (x0, y0), (x1, y1) = grid.map_from_grid([low, high])
        hits = np.sort(self.tree.query(shapely.box(x0, y0, x1, y1)))
        parts = [self.edges[self.first[k] : self.first[k + 1]] for k in hits.tolist()]
        edges = np.concatenate(parts) if parts else np.empty((0, 4))
        ends = grid.grid_from_map(edges.reshape(-1, 2, 2)).reshape(-1, 4)
        first = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
        return Near(window=window, labels=self.labels[hits], edges=ends, first=first)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Near:
    """Polygons near a window; `edges` in px (col, row) of the grid, from the lower end on."""

    window: Window
    labels: Labels
    edges: Array
    first: NDArray[np.int64]

    def has_border(self, reach: float) -> bool:
        """Whether an edge crosses the window, grown by `reach` px to all sides."""
        w, r = self.window, reach + MARGIN
        left, right, top, bottom = w.col - r, w.col + w.width + r, w.row - r, w.row + w.height + r
        x0, y1, x1, y0 = self.edges.T
        across = (np.minimum(x0, x1) < right) & (np.maximum(x0, x1) > left)
        x0, y1, x1, y0 = self.edges[across & (y0 < bottom) & (y1 > top)].T
        # The bounds meet; an edge misses where all four corners lie on one side of it.
        sides = [
            (x1 - x0) * (y - y1) - (y0 - y1) * (x - x0)
            for x, y in ((left, top), (right, top), (left, bottom), (right, bottom))
        ]
        return bool(np.any((np.min(sides, axis=0) <= 0.0) & (np.max(sides, axis=0) >= 0.0)))

    def draw(self, height: int, width: int) -> NDArray[np.int32]:
        """Place among `labels` of the polygon at each pixel from the window's corner on, or -1."""
        out = np.full((height, width), -1, dtype=np.int32)
        _draw(self.edges, self.first, float(self.window.col), float(self.window.row), out)
        return out

    def distances(self, reach: float) -> Weights:
        """Distance to the border of each polygon, px, inf beyond `reach`; (n, rows, cols)."""
        shape = (len(self.labels), self.window.height, self.window.width)
        out = np.full(shape, np.inf, dtype=np.float32)
        corner = (float(self.window.col), float(self.window.row))
        _square_distances(self.edges, self.first, corner, float(reach), out)
        return np.sqrt(out, out=out)


def label_window(index: SeamIndex, grid: Grid, window: Window) -> Labels:
    """Label of the polygon that holds a pixel's centre, -1 where none does; (rows, cols)."""
    near = index.near(grid, window, 0.0)
    if not near.has_border(0.0):
        return np.full((window.height, window.width), _only_label(near), dtype=np.int32)
    return _labels_of(near.labels, near.draw(window.height, window.width))


def seam_weights(
    index: SeamIndex, grid: Grid, window: Window, reach: float
) -> dict[int, Weights | None]:
    """How much each label counts at the pixels of a window.

    A label counts 1 deep inside its own cell, 0.5 on the seam and 0 `reach` px beyond it; where
    more than two meet they share out 1. Only borders with other cells count, not those with no
    cell at all; where there is no cell, all weights are 0.

    Parameters
    ----------
    reach
        px, > 0.

    Returns
    -------
    dict
        Label -> weight (rows, cols), 0..1, of those that count anywhere; None = 1 everywhere.
    """
    near = index.near(grid, window, reach)
    if not near.has_border(reach):
        label = _only_label(near)
        return {} if label < 0 else {label: None}
    place = near.draw(window.height, window.width)
    weights = near.distances(reach)
    _weigh(weights, place, np.float32(reach))
    counts = {
        int(label): weight
        for label, weight in zip(near.labels.tolist(), weights, strict=True)
        if weight.any()
    }
    if len(counts) == 1:
        ((label, weight),) = counts.items()
        return {label: None if weight.all() else weight}
    return dict(counts)


def distance_to_seam(index: SeamIndex, grid: Grid, window: Window, limit: float) -> Weights:
    """Distance to the nearest other cell, px, up to `limit`; 0 where no cell is; (rows, cols)."""
    near = index.near(grid, window, limit)
    shape = (window.height, window.width)
    if not near.has_border(limit):
        return np.full(shape, limit if _only_label(near) >= 0 else 0.0, dtype=np.float32)
    out = np.zeros(shape, dtype=np.float32)
    _to_others(near.distances(limit), near.draw(*shape), np.float32(limit), out)
    return out


def _only_label(near: Near) -> int:
    """Label of a window that no border crosses."""
    return int(_labels_of(near.labels, near.draw(1, 1))[0, 0])


def _labels_of(labels: Labels, place: NDArray[np.int32]) -> Labels:
    """Labels of places among them; place -1 takes the -1 at the end."""
    return np.append(labels, np.int32(-1))[place]


def _rings_of(areas: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Rings of areas, and the index of the area that each belongs to."""
    import shapely

    parts, area = shapely.get_parts(areas, return_index=True)
    rings, part = shapely.get_rings(parts, return_index=True)
    return rings, area[part]


@compiled
def _draw(
    edges: Array, first: NDArray[np.int64], left: float, top: float, out: NDArray[np.int32]
) -> None:
    """Draw polygons one over the other: at a row's centre, pixels between two crossings.

    An edge takes the rows from its upper end down to before its lower end, and a crossing goes to
    the pixel whose centre is the first not left of it: neighbours share out the pixels.
    """
    rows, cols = out.shape
    flips = np.zeros((rows, cols + 1), np.bool_)
    low, high = np.full(rows, cols), np.full(rows, -1)
    for k in range(first.shape[0] - 1):
        for e in range(first[k], first[k + 1]):
            # Rows grow downwards: the upper end on the map is the smaller row.
            x1, y1, x0, y0 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
            r0 = int(max(np.ceil(y0 - 0.5) - top, 0.0))
            r1 = int(min(np.ceil(y1 - 0.5) - top, float(rows)))
            for r in range(r0, r1):
                x = x0 + (r + top + 0.5 - y0) * (x1 - x0) / (y1 - y0)
                c = int(min(max(np.ceil(x - 0.5) - left, 0.0), float(cols)))
                flips[r, c] = not flips[r, c]
                low[r], high[r] = min(low[r], c), max(high[r], c)
        for r in range(rows):
            inside = False
            for c in range(low[r], high[r] + 1):
                if flips[r, c]:
                    inside = not inside
                    flips[r, c] = False
                if inside and c < cols:
                    out[r, c] = k
            low[r], high[r] = cols, -1


@compiled
def _square_distances(
    edges: Array,
    first: NDArray[np.int64],
    corner: tuple[float, float],
    reach: float,
    out: Weights,
) -> None:
    """Lower `out` (polygons, rows, cols), px^2, to the distances from the edges."""
    _, rows, cols = out.shape
    left, top = corner[0] + 0.5, corner[1] + 0.5
    for k in range(out.shape[0]):
        for e in range(first[k], first[k + 1]):
            x0, y0, x1, y1 = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3]
            dx, dy = x1 - x0, y1 - y0
            square = dx * dx + dy * dy
            if square == 0.0:
                continue
            r0 = int(max(np.floor(min(y0, y1) - reach - top), 0.0))
            r1 = int(min(np.ceil(max(y0, y1) + reach - top) + 1.0, float(rows)))
            for r in range(r0, r1):
                y = r + top
                # Part of the edge that this row is within reach of
                ta, tb = 0.0, 1.0
                if abs(dy) > 1e-9:
                    ta = min(max((y - reach - y0) / dy, 0.0), 1.0)
                    tb = min(max((y + reach - y0) / dy, 0.0), 1.0)
                xa, xb = x0 + ta * dx, x0 + tb * dx
                c0 = int(max(np.floor(min(xa, xb) - reach - left), 0.0))
                c1 = int(min(np.ceil(max(xa, xb) + reach - left) + 1.0, float(cols)))
                for c in range(c0, c1):
                    px, py = c + left - x0, y - y0
                    t = min(max((px * dx + py * dy) / square, 0.0), 1.0)
                    ex, ey = px - t * dx, py - t * dy
                    d = np.float32(ex * ex + ey * ey)
                    if d < out[k, r, c]:
                        out[k, r, c] = d


@compiled
def _weigh(weights: Weights, place: NDArray[np.int32], reach: np.float32) -> None:
    """Turn distances to the border of each polygon into weights, in place."""
    half = np.float32(0.5)
    count, rows, cols = weights.shape
    for r in range(rows):
        for c in range(cols):
            own = place[r, c]
            nearest = reach
            total = np.float32(0.0)
            for k in range(count):
                d = weights[k, r, c]
                weights[k, r, c] = np.float32(0.0)
                if k != own and own >= 0 and d < reach:
                    nearest = min(nearest, d)
                    weights[k, r, c] = half - half * d / reach
                    total += weights[k, r, c]
            if own >= 0:
                weights[own, r, c] = half + half * nearest / reach
                total += weights[own, r, c]
                if nearest < reach:
                    for k in range(count):
                        weights[k, r, c] /= total


@compiled
def _to_others(
    distances: Weights, place: NDArray[np.int32], limit: np.float32, out: Weights
) -> None:
    """Distance to the nearest polygon but the pixel's own."""
    count, rows, cols = distances.shape
    for r in range(rows):
        for c in range(cols):
            if place[r, c] >= 0:
                nearest = limit
                for k in range(count):
                    if k != place[r, c]:
                        nearest = min(nearest, distances[k, r, c])
                out[r, c] = nearest
