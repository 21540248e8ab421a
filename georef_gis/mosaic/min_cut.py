"""Minimum cuts of images: which pixels belong to the source when the cheapest edges are cut.

Notes
-----
Boykov, Kolmogorov, "An experimental comparison of min-cut/max-flow algorithms for energy
minimization in vision" (2004): two trees of residual edges grow from source and sink until they
meet, the path is saturated, and nodes that lost their parent look for another of the same tree.
Distances to the terminals with the time they were found keep paths short (Kolmogorov's thesis,
2003). Of a grid the edges need no lists: neighbours are offsets. Integers make it exact, so that
the result is the same on every machine.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from georef_gis.mosaic.compiled import compiled

Mask = NDArray[np.bool_]
Costs = NDArray[np.int32]

# (row, col) steps to the neighbours that edges are given for; the others are their opposites
STEPS = ((0, 1), (1, 0))
# trees
FREE, SOURCE, SINK = 0, 1, 2
# what may stand for the direction of the parent
TERMINAL, NONE = 4, 5
FAR = 2**30


def min_cut(edges: Costs, terminals: Costs) -> tuple[Mask, int]:
    """Cheapest division of a grid between source and sink.

    Parameters
    ----------
    edges : shape (2, rows, cols)
        Cost, not negative, of parting a pixel from its neighbour in the direction `STEPS[k]`;
        those over the rim do not count.
    terminals : shape (rows, cols)
        Cost of giving a pixel to the sink, less that of giving it to the source.

    Returns
    -------
    source : shape (rows, cols)
        The fewest pixels that may belong to the source.
    cost
        Of the edges cut and, per pixel, of the dearer choice where it was made.
    """
    forest = _planted(edges, terminals)
    flow = _cut(forest)
    rows, cols = terminals.shape
    source = forest.tree.reshape(rows + 2, cols + 2)[1:-1, 1:-1] == SOURCE
    return source, int(flow)


class _Forest(NamedTuple):
    """Residual edges of a padded grid and the two trees that grow in it; arrays by node.

    `capacity` (nodes, 4) in the directions of `offsets`; `excess` what is left of the link to
    the source, if positive, or sink. `parent` is a direction; `depth` the steps to the terminal,
    known at the time of `stamp`. Nodes in the ring `active`, all `waiting`, may grow.
    """

    capacity: Costs
    excess: Costs
    offsets: NDArray[np.int64]
    tree: NDArray[np.uint8]
    parent: NDArray[np.uint8]
    stamp: Costs
    depth: Costs
    waiting: Mask
    active: Costs


def _planted(edges: Costs, terminals: Costs) -> _Forest:
    """Forest of a grid before anything has grown."""
    rows, cols = terminals.shape
    width = cols + 2
    # A ring without edges saves the kernel from looking for the rim.
    capacity = np.zeros((rows + 2, width, 4), np.int32)
    capacity[1:-1, 1:-2, 0] = capacity[1:-1, 2:-1, 1] = edges[0][:, :-1]
    capacity[1:-2, 1:-1, 2] = capacity[2:-1, 1:-1, 3] = edges[1][:-1]
    size = (rows + 2) * width
    excess = np.zeros((rows + 2, width), np.int32)
    excess[1:-1, 1:-1] = terminals
    return _Forest(
        capacity=capacity.reshape(size, 4),
        excess=excess.ravel(),
        offsets=np.array([1, -1, width, -width], np.int64),
        tree=np.zeros(size, np.uint8),
        parent=np.full(size, NONE, np.uint8),
        stamp=np.zeros(size, np.int32),
        depth=np.zeros(size, np.int32),
        waiting=np.zeros(size, np.bool_),
        active=np.empty(size + 1, np.int32),
    )


@compiled
def _cut(f: Any) -> Any:
    """Saturate all paths; the trees tell in the end which side a node is on."""
    n = f.excess.size
    orphans = np.empty(n + 1, np.int32)
    first, last, time, flow = 0, 0, 0, _swept(f)
    for p in range(n):
        if f.excess[p] != 0:
            f.tree[p] = SOURCE if f.excess[p] > 0 else SINK
            f.parent[p], f.depth[p] = TERMINAL, 1
            last = _wait(p, f, last)
    while first != last:
        p = f.active[first]
        last, way = _grow(p, f, last)
        if way < 0:
            first = first + 1 if first < n else 0
            f.waiting[p] = False
            continue
        time += 1
        if f.tree[p] == SINK:
            p, way = p + f.offsets[way], way ^ 1
        pushed, count = _augment(p, way, f, orphans)
        flow += pushed
        last = _adopt(count, time, f, orphans, last)
    return flow


@compiled
def _swept(f: Any) -> Any:
    """Push what nodes have left of their links on to neighbours, all rows and columns each way.

    What meets its opposite is flow that needs no tree, most of it; the rest lies elsewhere, which
    changes neither the cheapest cut nor its cost.
    """
    n, flow = f.excess.size, 0
    for k in (0, 2, 1, 3):
        for i in range(n):
            p = i if f.offsets[k] > 0 else n - 1 - i
            have = f.excess[p]
            if have == 0:
                continue
            q = p + f.offsets[k]
            if have > 0:
                pushed = min(have, f.capacity[p, k])
                flow += min(pushed, max(-f.excess[q], 0))
            else:
                pushed = -min(-have, f.capacity[q, k ^ 1])
                flow += min(-pushed, max(f.excess[q], 0))
            f.excess[p] -= pushed
            f.excess[q] += pushed
            f.capacity[p, k] -= pushed
            f.capacity[q, k ^ 1] += pushed
    return flow


@compiled
def _wait(p: Any, f: Any, last: Any) -> Any:
    """Let a node wait for its turn to grow; end of the ring."""
    if f.waiting[p]:
        return last
    f.waiting[p] = True
    f.active[last] = p
    return last + 1 if last + 1 < f.active.size else 0


@compiled
def _grow(p: Any, f: Any, last: Any) -> Any:
    """Add the free neighbours of a node to its tree; direction in which it meets the other one."""
    own = f.tree[p]
    if own == FREE:
        return last, -1
    for k in range(f.offsets.size):
        q = p + f.offsets[k]
        if (f.capacity[p, k] if own == SOURCE else f.capacity[q, k ^ 1]) == 0:
            continue
        if f.tree[q] == FREE:
            f.tree[q], f.parent[q] = own, k ^ 1
            f.stamp[q], f.depth[q] = f.stamp[p], f.depth[p] + 1
            last = _wait(q, f, last)
        elif f.tree[q] != own:
            return last, k
        elif f.stamp[q] <= f.stamp[p] and f.depth[q] > f.depth[p]:
            f.parent[q], f.stamp[q], f.depth[q] = k ^ 1, f.stamp[p], f.depth[p] + 1
    return last, -1


@compiled
def _augment(p: Any, way: Any, f: Any, orphans: Any) -> Any:
    """Saturate the path over an edge from the source's tree to the sink's.

    Gives the flow and the number of nodes, in `orphans`, that were cut off.
    """
    q = p + f.offsets[way]
    s, above = _narrowest(p, f, 1)
    t, below = _narrowest(q, f, 0)
    least = min(f.capacity[p, way], above, below, f.excess[s], -f.excess[t])
    f.capacity[p, way] -= least
    f.capacity[q, way ^ 1] += least
    count = _push(p, least, f, 1, orphans, 0)
    count = _push(q, least, f, 0, orphans, count)
    f.excess[s] -= least
    f.excess[t] += least
    for r in (s, t):
        if f.excess[r] == 0:
            f.parent[r] = NONE
            orphans[count] = r
            count += 1
    return least, count


@compiled
def _narrowest(p: Any, f: Any, down: Any) -> Any:
    """Root of a node's tree, and the least capacity on the way; `down` is 1 in the source's."""
    least = FAR
    while f.parent[p] != TERMINAL:
        k = f.parent[p]
        above = p + f.offsets[k]
        least = min(least, f.capacity[above, k ^ 1] if down else f.capacity[p, k])
        p = above
    return p, least


@compiled
def _push(p: Any, flow: Any, f: Any, down: Any, orphans: Any, count: Any) -> Any:
    """Push flow between a node and its root; number of orphans with those it makes."""
    while f.parent[p] != TERMINAL:
        k = f.parent[p]
        above = p + f.offsets[k]
        forth = flow if down else -flow
        f.capacity[above, k ^ 1] -= forth
        f.capacity[p, k] += forth
        if (f.capacity[above, k ^ 1] if down else f.capacity[p, k]) == 0:
            f.parent[p] = NONE
            orphans[count] = p
            count += 1
        p = above
    return count


@compiled
def _root_depth(q: Any, time: Any, f: Any) -> Any:
    """Steps from a node to its terminal; `FAR` if it hangs on an orphan. Notes them on the way."""
    steps, r = 0, q
    while True:
        if f.stamp[r] == time:
            steps += f.depth[r]
            break
        if f.parent[r] == NONE:
            return FAR
        steps += 1
        if f.parent[r] == TERMINAL:
            f.stamp[r], f.depth[r] = time, 1
            break
        r += f.offsets[f.parent[r]]
    found, r = steps, q
    while f.stamp[r] != time:
        f.stamp[r], f.depth[r] = time, steps
        steps -= 1
        r += f.offsets[f.parent[r]]
    return found


@compiled
def _adopt(count: Any, time: Any, f: Any, orphans: Any, last: Any) -> Any:
    """Find new parents for orphans; those without are free, and their children orphans."""
    first, size = 0, orphans.size
    while first != count:
        p = orphans[first]
        first = first + 1 if first + 1 < size else 0
        own, best, way = f.tree[p], FAR, -1
        for k in range(f.offsets.size):
            q = p + f.offsets[k]
            if f.tree[q] != own:
                continue
            if (f.capacity[q, k ^ 1] if own == SOURCE else f.capacity[p, k]) > 0:
                steps = _root_depth(q, time, f)
                if steps < best:
                    best, way = steps, k
        if way >= 0:
            f.parent[p], f.stamp[p], f.depth[p] = way, time, best + 1
            continue
        f.tree[p] = FREE
        for k in range(f.offsets.size):
            q = p + f.offsets[k]
            if f.tree[q] != own:
                continue
            # whoever could reach it may grow into it again
            if (f.capacity[q, k ^ 1] if own == SOURCE else f.capacity[p, k]) > 0:
                last = _wait(q, f, last)
            if f.parent[q] == k ^ 1:
                f.parent[q] = NONE
                orphans[count] = q
                count = count + 1 if count + 1 < size else 0
    return last
