"""Labels on the coarse grid as polygons that share their borders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import SparseRaster
from georef_gis.mosaic.compiled import compiled

if TYPE_CHECKING:
    from shapely import MultiPolygon

# px of the coarse grid; a corner goes if the triangle it makes is smaller than the square of it
SMOOTHING = 1.5
# Side of a cell: neighbour (rows, cols), where the side starts from the cell's upper left corner,
# and the step along it. The cell lies on the left of its sides, as seen on the map.
SIDES = (
    ((1, 0), (1, 0), (0, 1)),
    ((0, 1), (1, 1), (-1, 0)),
    ((-1, 0), (0, 1), (0, -1)),
    ((0, -1), (0, 0), (1, 0)),
)  # fmt: skip
Integers = NDArray[np.int64]


def polygons_of(
    labels: SparseRaster, coarse: Grid, ids: Sequence[str], *, smoothing: float = SMOOTHING
) -> list[tuple[str, MultiPolygon]]:
    """Area of each label as polygons in map coordinates, in the order of the labels.

    They are a coverage: neighbours share their border vertex by vertex, nothing overlaps, and no
    gap arises that was not there. A border runs through the middles of the pixels' sides, which
    turns stairs into slopes, and then loses the corners that hardly show.

    Parameters
    ----------
    labels
        Index into `ids`, -1 where there is no photo; int32.
    smoothing
        px of the coarse grid, see `SMOOTHING`; 0 leaves every corner.
    """
    import shapely

    keys, owners, nodes = _half_edges(labels)
    if not len(keys):
        return []
    order, starts = _rings(_next(keys, coarse.width + 1))
    xy, first = _points(keys[order], nodes[order], starts, coarse.width + 1)
    xy, first, ring_owner = _simple_rings(xy, first, owners[order[starts]])
    found, areas = _assemble(xy, first, ring_owner)
    if smoothing > 0.0:
        areas = shapely.coverage_simplify(areas, smoothing)
    areas = shapely.transform(areas, coarse.map_from_grid)
    whole = [a if a.geom_type == "MultiPolygon" else shapely.MultiPolygon([a]) for a in areas]
    return [(ids[label], area) for label, area in zip(found.tolist(), whole, strict=True)]


def _half_edges(
    labels: SparseRaster,
) -> tuple[Integers, NDArray[np.int32], NDArray[np.bool_]]:
    """Sides of cells that border on another label, sorted by key.

    Returns
    -------
    keys : shape (n,)
        4 times the number of the corner where the side starts, plus the side.
    owners : shape (n,)
        Label of the cell.
    nodes : shape (n,)
        Whether borders of several pairs of labels meet where the side starts.
    """
    keys: list[Integers] = [np.empty(0, np.int64)]
    owners: list[NDArray[np.int32]] = [np.empty(0, np.int32)]
    nodes: list[NDArray[np.bool_]] = [np.empty(0, np.bool_)]
    for window in labels:
        h, w = window.height, window.width
        grown = Window(col=window.col - 1, row=window.row - 1, width=w + 2, height=h + 2)
        values = labels.read(grown)
        own = values[1:-1, 1:-1]
        is_node = _nodes(values)
        for side, ((dr, dc), (sr, sc), _) in enumerate(SIDES):
            other = values[1 + dr : 1 + dr + h, 1 + dc : 1 + dc + w]
            rows, cols = np.nonzero((own != other) & (own >= 0))
            corner = (rows + sr + window.row) * (labels.width + 1) + cols + sc + window.col
            keys.append(4 * corner.astype(np.int64) + side)
            owners.append(own[rows, cols].astype(np.int32))
            nodes.append(is_node[rows + sr, cols + sc])
    key = np.concatenate(keys)
    by_key = np.argsort(key)
    return key[by_key], np.concatenate(owners)[by_key], np.concatenate(nodes)[by_key]


def _nodes(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether more than one border passes the inner corners; (rows - 1, cols - 1) of `values`."""
    a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, :-1], values[1:, 1:]
    borders = sum((x != y).astype(np.int8) for x, y in ((a, b), (c, d), (a, c), (b, d)))
    return np.asarray(borders > 2)


def _next(keys: Integers, corners: int) -> Integers:
    """Index of the half edge that follows each one around its label; `corners` in a row.

    Turning left first keeps to one cell, so that cells which touch at a corner stay apart.
    """
    side = keys % 4
    step = np.array([r * corners + c for _, _, (r, c) in SIDES], dtype=np.int64)
    end = 4 * (keys // 4 + step[side])
    out = np.full(len(keys), -1, dtype=np.int64)
    for turn in (1, 0, 3):
        left = np.nonzero(out < 0)[0]
        wanted = end[left] + (side[left] + turn) % 4
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        there = keys[at] == wanted
        out[left[there]] = at[there]
    return out


@compiled
def _rings(following: Integers) -> tuple[Integers, Integers]:
    """Half edges ring by ring, and where in that order each ring starts."""
    n = following.shape[0]
    order = np.empty(n, np.int64)
    starts = np.empty(n, np.int64)
    seen = np.zeros(n, np.bool_)
    count = rings = 0
    for i in range(n):
        if seen[i]:
            continue
        starts[rings] = count
        rings += 1
        k = i
        while not seen[k]:
            seen[k] = True
            order[count] = k
            count += 1
            k = following[k]
    return order, starts[:rings].copy()


def _points(
    keys: Integers, nodes: NDArray[np.bool_], starts: Integers, corners: int
) -> tuple[Integers, Integers]:
    """Vertices of the rings: middles of the sides, and the nodes between them.

    Returns
    -------
    xy : shape (n, 2), half px of the coarse grid
        Columns and rows.
    first : shape (rings + 1,)
        Where the vertices of each ring start, and where the last ends.
    """
    corner, side = keys // 4, keys % 4
    start = 2 * np.stack([corner % corners, corner // corners], axis=-1)
    step = np.array([(c, r) for _, _, (r, c) in SIDES], dtype=np.int64)
    places = np.concatenate([[0], np.cumsum(1 + nodes.astype(np.int64))])
    xy = np.empty((int(places[-1]), 2), dtype=np.int64)
    xy[places[1:] - 1] = start + step[side]
    xy[places[:-1][nodes]] = start[nodes]
    return xy, np.concatenate([places[starts], places[-1:]])


def _simple_rings(
    xy: Integers, first: Integers, owner: NDArray[np.int32]
) -> tuple[Integers, Integers, NDArray[np.int32]]:
    """Cut rings that pass a place twice there, as shells and holes must not touch themselves."""
    ring = np.repeat(np.arange(len(owner)), np.diff(first))
    at = np.nonzero((xy % 2 == 0).all(axis=1))[0]
    _, index, count = np.unique(
        np.column_stack([ring[at], xy[at]]), axis=0, return_index=True, return_counts=True
    )
    twice = np.unique(ring[at[index[count > 1]]])
    if not len(twice):
        return xy, first, owner
    pieces, owners = [], []
    for k in twice.tolist():
        loops = _loops(xy[first[k] : first[k + 1]])
        pieces += loops
        owners += [owner[k]] * len(loops)
    whole = np.ones(len(owner), np.bool_)
    whole[twice] = False
    lengths = np.concatenate([np.diff(first)[whole], [len(piece) for piece in pieces]])
    xy = np.concatenate([xy[whole[ring]], *pieces])
    first = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return xy, first, np.concatenate([owner[whole], np.array(owners, np.int32)])


def _loops(xy: Integers) -> list[Integers]:
    """Loops of one ring that meet at the places it passes twice."""
    loops: list[Integers] = []
    path: list[int] = []
    at: dict[tuple[int, int], int] = {}
    for i, (x, y) in enumerate(xy.tolist()):
        if (x, y) in at:
            start = at[x, y]
            loops.append(xy[path[start:]])
            for k in path[start:]:
                del at[int(xy[k, 0]), int(xy[k, 1])]
            del path[start:]
        at[x, y] = len(path)
        path.append(i)
    loops.append(xy[path])
    return loops


def _assemble(
    xy: Integers, first: Integers, owner: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Labels found, and their multipolygons in px of the coarse grid."""
    import shapely

    number = np.repeat(np.arange(len(owner)), np.diff(first))
    rings = shapely.linearrings(xy / 2.0, indices=number)
    follower = np.arange(1, len(xy) + 1)
    follower[first[1:] - 1] = first[:-1]
    cross = xy[:, 0] * xy[follower, 1] - xy[follower, 0] * xy[:, 1]
    # Rows grow downwards: around a shell the sum is negative.
    is_hole = np.add.reduceat(cross, first[:-1]) > 0
    shell = _shells(rings, is_hole, owner)
    by_shell = np.lexsort([is_hole, shell])
    shells, part = np.unique(shell, return_inverse=True)
    polygons = shapely.polygons(rings[by_shell], indices=part[by_shell])
    by_label = np.argsort(owner[shells], kind="stable")
    found, index = np.unique(owner[shells[by_label]], return_inverse=True)
    return found, shapely.multipolygons(polygons[by_label], indices=index)


def _shells(rings: NDArray[Any], is_hole: NDArray[np.bool_], owner: NDArray[np.int32]) -> Integers:
    """Index of the shell that each ring belongs to: the smallest of its label about it."""
    import shapely

    out = np.arange(len(rings))
    shells = np.nonzero(~is_hole)[0]
    names, place, count = np.unique(owner[shells], return_index=True, return_counts=True)
    holes = np.nonzero(is_hole)[0]
    which = np.searchsorted(names, owner[holes])
    out[holes] = shells[place[which]]
    doubtful = count[which] > 1
    for label in np.unique(owner[holes[doubtful]]):
        mine, of = shells[owner[shells] == label], holes[owner[holes] == label]
        outer = shapely.polygons(rings[mine])
        tree = shapely.STRtree(outer)
        inner, about = tree.query(shapely.polygons(rings[of]), predicate="covered_by")
        by_area = np.lexsort([shapely.area(outer[about]), inner])
        _, smallest = np.unique(inner[by_area], return_index=True)
        out[of] = mine[about[by_area[smallest]]]
    return out
