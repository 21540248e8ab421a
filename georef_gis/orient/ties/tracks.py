"""From matches of pairs to ground points seen by many photos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from georef_gis.frames import Array
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.ties.features import Features
from georef_gis.orient.ties.matching import Index

Matches = Mapping[tuple[int, int], tuple[Index, Index]]

# px of the reduced picture: features this near are one point
SAME_POINT = 0.5
# one sigma of a feature's place, px of the reduced picture: a floor, and a share of its blur
SIGMA_FLOOR = 0.25
SIGMA_SHARE = 0.10
# cells on the longer side over which a photo's tie points are spread
CELLS = 12


def tie_points(
    photo_ids: Sequence[str], features: Sequence[Features], matches: Matches, *, observations: int
) -> TiePoints:
    """Tie points of verified matches.

    Parameters
    ----------
    features
        Of every photo; empty where it has none.
    matches
        Verified matches by pair of photos: indices of their features.
    observations
        Kept per photo, about; long tracks first, spread over the picture.
    """
    places = [_places(f) for f in features]
    start = np.concatenate([[0], np.cumsum([len(f) for f in features])])
    photo = np.repeat(np.arange(len(features)), np.diff(start))
    first, second = [], []
    for (i, j), (ia, ib) in matches.items():
        first.append(start[i] + places[i][ia])
        second.append(start[j] + places[j][ib])
    if not first:
        return _as_ties(photo_ids, features, photo, start, np.zeros(0, int), np.zeros(0, int))
    node, point = _tracks(np.concatenate(first), np.concatenate(second), photo)
    uv = np.concatenate([f.uv for f in features])
    keep = _thinned(node, point, photo, uv, features, observations)
    return _as_ties(photo_ids, features, photo, start, node[keep], point[keep])


def _places(features: Features) -> Index:
    """For every feature the first one at its place; shape (n,).

    A place with several directions has several features.
    """
    grid = np.round(features.uv * features.scale / SAME_POINT).astype(np.int64)
    key = grid[:, 0] * (1 << 32) + grid[:, 1]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()], dtype=np.intp)


def _tracks(
    first: Index, second: Index, photo: NDArray[np.intp]
) -> tuple[Index, NDArray[np.int64]]:
    """Connected features without conflicts: nodes, and the number of the point of each."""
    n = len(photo)
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(n, n))
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    used = np.unique(np.concatenate([first, second]))
    clash = _clashing(label[used], photo[used])
    torn = np.isin(label[first], clash)
    if np.any(torn):
        fresh = int(label.max()) + 1
        parts = _split(first[torn], second[torn], photo)
        for node, part in parts.items():
            label[node] = fresh + part
    label = label[used]
    order = np.lexsort((photo[used], label))
    return used[order], label[order]


def _clashing(label: NDArray[np.int64], photo: NDArray[np.intp]) -> NDArray[np.int64]:
    """Labels under which a photo stands twice."""
    order = np.lexsort((photo, label))
    a, b = label[order], photo[order]
    twice = (a[1:] == a[:-1]) & (b[1:] == b[:-1])
    return np.asarray(np.unique(a[1:][twice]))


def _split(first: Index, second: Index, photo: NDArray[np.intp]) -> dict[int, int]:
    """Tracks with a photo twice, grown again from the matches that most others support.

    A match is joined unless that would put a photo twice into a track.
    """
    neighbours: dict[int, set[int]] = {}
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    edges = sorted(
        {(min(a, b), max(a, b)) for a in neighbours for b in neighbours[a]},
        key=lambda e: (-len(neighbours[e[0]] & neighbours[e[1]]), e),
    )
    track = {node: i for i, node in enumerate(neighbours)}
    members = {i: {int(photo[node])} for node, i in track.items()}
    nodes = {i: [node] for node, i in track.items()}
    for a, b in edges:
        i, j = track[a], track[b]
        if i == j or members[i] & members[j]:
            continue
        if len(nodes[i]) < len(nodes[j]):
            i, j = j, i
        for node in nodes[j]:
            track[node] = i
        nodes[i] += nodes.pop(j)
        members[i] |= members.pop(j)
    return track


def _thinned(
    node: Index,
    point: NDArray[np.int64],
    photo: NDArray[np.intp],
    uv: Array,
    features: Sequence[Features],
    observations: int,
) -> NDArray[np.bool_]:
    """Which observations to keep; shape (m,).

    Points are taken, those of most rays first, while a cell of one of their photos is in want.
    """
    start = np.flatnonzero(np.r_[True, point[1:] != point[:-1]])
    rays = np.diff(np.r_[start, len(point)])
    cell, cells_of_photo = _cells(photo[node], uv[node], features)
    quota = np.ceil(observations / cells_of_photo).astype(int)[photo[node]]
    filled: dict[int, int] = {}
    counted = np.zeros(len(features), dtype=int)
    keep = np.zeros(len(node), dtype=bool)
    cell_list, quota_list, photo_list = cell.tolist(), quota.tolist(), photo[node].tolist()
    for t in np.lexsort((node[start], -rays)).tolist():
        if rays[t] < 2:
            break
        span = range(int(start[t]), int(start[t] + rays[t]))
        wanted = any(filled.get(cell_list[k], 0) < quota_list[k] for k in span)
        if not wanted:
            continue
        for k in span:
            filled[cell_list[k]] = filled.get(cell_list[k], 0) + 1
            counted[photo_list[k]] += 1
            keep[k] = True
    return keep


def _cells(
    photo: NDArray[np.intp], uv: Array, features: Sequence[Features]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the cell of each observation, across photos, and the cells of each photo."""
    size = np.array([[f.width, f.height] for f in features])
    grid = np.maximum(np.round(size * CELLS / size.max(axis=1, keepdims=True)), 1).astype(int)
    share = (uv + 0.5) / size[photo]
    at = np.clip((share * grid[photo]).astype(int), 0, grid[photo] - 1)
    cell = photo * CELLS**2 + at[:, 1] * CELLS + at[:, 0]
    return cell, grid.prod(axis=1)


def _as_ties(
    photo_ids: Sequence[str],
    features: Sequence[Features],
    photo: NDArray[np.intp],
    start: NDArray[np.intp],
    node: Index,
    point: NDArray[np.int64],
) -> TiePoints:
    number = np.unique(point, return_inverse=True)[1].ravel() if len(point) else point
    order = np.lexsort((photo[node], number))
    node, number = node[order], number[order]
    of = photo[node]
    uv, sigma = np.zeros((len(node), 2)), np.zeros(len(node))
    for i in np.unique(of):
        mine = of == i
        f = features[i]
        k = node[mine] - start[i]
        uv[mine] = f.uv[k]
        sigma[mine] = np.hypot(SIGMA_FLOOR, SIGMA_SHARE * f.size[k]) / f.scale
    return TiePoints(
        photo_ids=tuple(photo_ids),
        photo=of.astype(np.int32),
        point=number.astype(np.int32),
        uv=uv,
        sigma=sigma,
    )
