"""Minimum cuts of grids, against SciPy's maximum flow."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from georef_gis.mosaic.min_cut import STEPS, min_cut

Ints = NDArray[np.int32]


def neighbours(shape: tuple[int, int], k: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Pixels that have a neighbour in direction k, and these neighbours."""
    (dr, dc), (rows, cols) = STEPS[k], shape
    return (slice(0, rows - dr), slice(0, cols - dc)), (slice(dr, rows), slice(dc, cols))


def graph_of(edges: Ints, terminals: Ints) -> csr_matrix:
    """The same graph for SciPy: pixels in rows, then the source, then the sink."""
    shape = terminals.shape
    index = np.arange(terminals.size).reshape(shape)
    source, sink = terminals.size, terminals.size + 1
    tails, heads, values = [], [], []
    for k in range(len(edges)):
        p, q = neighbours(shape, k)
        for tail, head in ((p, q), (q, p)):
            tails.append(index[tail].ravel())
            heads.append(index[head].ravel())
            values.append(edges[k][p].ravel())
    flat = terminals.ravel()
    tails += [np.full(flat.size, source), index.ravel()]
    heads += [index.ravel(), np.full(flat.size, sink)]
    values += [np.maximum(flat, 0), np.maximum(-flat, 0)]
    graph = coo_matrix(
        (np.concatenate(values), (np.concatenate(tails), np.concatenate(heads))),
        shape=(sink + 1, sink + 1),
    )
    return graph.tocsr().astype(np.int32)


def oracle(edges: Ints, terminals: Ints) -> int:
    """Maximum flow, by SciPy."""
    n = terminals.size
    return int(maximum_flow(graph_of(edges, terminals), n, n + 1).flow_value)


def least_source(edges: Ints, terminals: Ints) -> NDArray[np.bool_]:
    """Pixels that the source still reaches when SciPy's flow is the largest."""
    n = terminals.size
    graph = graph_of(edges, terminals)
    left = graph - maximum_flow(graph, n, n + 1).flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    reached = breadth_first_order(left, n, return_predecessors=False)
    mask = np.zeros(n + 2, np.bool_)
    mask[reached] = True
    return mask[:n].reshape(terminals.shape)


def cut_cost(edges: Ints, terminals: Ints, source: NDArray[np.bool_]) -> int:
    """Cost of a division."""
    cost = int(
        terminals[~source & (terminals > 0)].sum() - terminals[source & (terminals < 0)].sum()
    )
    for k in range(len(edges)):
        p, q = neighbours(terminals.shape, k)
        cost += int(edges[k][p][source[p] != source[q]].sum())
    return cost


@pytest.mark.parametrize("seed", range(60))
def test_random_grids_are_cut_as_cheaply_as_the_largest_flow(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 14, 2))
    edges = rng.integers(0, [3, 10, 1000][seed % 3], (2, *shape), dtype=np.int32)
    # many without a link to a terminal, so that trees grow far
    terminals = rng.integers(-900, 900, shape, dtype=np.int32) * (rng.random(shape) < 0.3)
    terminals = terminals.astype(np.int32)
    source, cost = min_cut(edges, terminals)
    assert cost == oracle(edges, terminals)
    assert cut_cost(edges, terminals, source) == cost


@pytest.mark.parametrize("seed", range(20))
def test_of_all_cheapest_cuts_it_is_the_one_with_the_smallest_source(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    shape = tuple(rng.integers(2, 12, 2))
    # few values, so that many cuts cost the same
    edges = rng.integers(0, 3, (2, *shape), dtype=np.int32)
    terminals = rng.integers(-2, 3, shape, dtype=np.int32)
    source, _ = min_cut(edges, terminals)
    np.testing.assert_array_equal(source, least_source(edges, terminals))


def test_a_picture_sized_grid_is_cut_as_cheaply_as_the_largest_flow() -> None:
    rng = np.random.default_rng(3)
    edges = rng.integers(1, 200, (2, 60, 90), dtype=np.int32)
    terminals = rng.integers(-40, 41, (60, 90), dtype=np.int32)
    terminals[:, 0], terminals[:, -1] = 2000, -2000
    source, cost = min_cut(edges, terminals)
    assert cost == oracle(edges, terminals)
    assert cut_cost(edges, terminals, source) == cost


def test_the_cut_takes_the_cheap_way_round_a_costly_block() -> None:
    edges = np.full((2, 21, 30), 10, np.int32)
    edges[:, 5:16, 12:20] = 500
    terminals = np.zeros((21, 30), np.int32)
    terminals[:, 0], terminals[:, -1] = 10**6, -(10**6)
    source, _ = min_cut(edges, terminals)
    block = source[6:15, 13:19]
    assert block.all() or not block.any()
    assert source[:, 0].all()
    assert not source[:, -1].any()


def test_pixels_without_a_preference_or_edge_go_to_the_sink() -> None:
    source, cost = min_cut(np.zeros((2, 3, 4), np.int32), np.zeros((3, 4), np.int32))
    assert not source.any()
    assert cost == 0


def test_the_given_costs_are_left_as_they_are() -> None:
    edges = np.ones((2, 5, 5), np.int32)
    terminals = np.arange(-12, 13, dtype=np.int32).reshape(5, 5)
    before = edges.copy(), terminals.copy()
    min_cut(edges, terminals)
    np.testing.assert_array_equal(edges, before[0])
    np.testing.assert_array_equal(terminals, before[1])
