"""Rauch-Tung-Striebel smoother on the nodes of the filter, and covariances between any two times.

Rauch, Tung, Striebel (1965) in closed-loop form: the state at a node is moved by ``G (smoothed
ahead - predicted ahead)``. Smoothed errors are a Markov chain, so with ``G`` of each step
``Cov(x_i, x_j) = G_i G_(i+1) .. G_(j-1) P_j`` for i < j: any time between two nodes is put in as a
node of its own without a measurement, which changes nothing but gives its covariances exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.navigate.dense import (
    cholesky,
    compiled,
    copy_row,
    pack,
    product,
    product_t,
    sample_before,
    solve_columns,
    symmetrise,
    transposed,
    unpack,
)
from georef_gis.navigate.inertial import propagate, reset_transition
from georef_gis.navigate.kalman import (
    difference,
    inject,
    stepped,
)


@compiled
def gain(P: Array, Phi: Array, ahead: Array) -> Array:
    """Smoother gain ``P Phi' ahead^-1``, (n, n); scaled, for the states differ by 1e10."""
    n = len(P)
    scale, scaled = np.empty(n), np.empty((n, n))
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(ahead[i, i]) if ahead[i, i] > 0.0 else 1.0
    # of P and ahead, which are symmetric: G' = ahead^-1 Phi P
    G = product(Phi, P)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = ahead[i, j] * scale[i] * scale[j]
            G[i, j] *= scale[i]
    solve_columns(cholesky(scaled), G)
    for i in range(n):
        for j in range(n):
            G[i, j] *= scale[i]
    return transposed(G)


@compiled
def smoothed_covariance(P: Array, G: Array, smoothed: Array, ahead: Array) -> Array:
    """``P + G (smoothed ahead - predicted ahead) G'``, symmetric, (n, n)."""
    n = len(P)
    change = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            change[i, j] = smoothed[i, j] - ahead[i, j]
    out = product_t(product(G, change), G)
    for i in range(n):
        for j in range(n):
            out[i, j] += P[i, j]
    symmetrise(out)
    return out


@compiled
def run_smoother(
    nodes: Array, jump: Array, model: Array, passed: tuple[Array, ...], nav: Array, x: Array,
    packed: Array,
) -> None:  # fmt: skip
    """Backward pass over what `kalman.run_filter` left in `passed`.

    Fills `nav` (m, 15), `x` (m, n - 9) and `packed` (m, n (n + 1) / 2) with the smoothed nodes.
    """
    prior_nav, prior_x, post_nav, post_x, kept, trans = passed
    last = len(nodes) - 1
    n = model.shape[1]
    copy_row(post_nav[last], nav[last])
    copy_row(post_x[last], x[last])
    copy_row(kept[last], packed[last])
    P_s = unpack(kept[last], n)
    d, move = np.empty(n), np.empty(n)
    for m in range(last - 1, -1, -1):
        P = unpack(kept[m], n)
        Phi, ahead = stepped(P, trans[m], nodes[m + 1] - nodes[m], jump[m + 1], model)
        G = gain(P, Phi, ahead)
        difference(nav[m + 1], x[m + 1], prior_nav[m + 1], prior_x[m + 1], d)
        copy_row(post_nav[m], nav[m])
        copy_row(post_x[m], x[m])
        for i in range(n):
            move[i] = 0.0
            for j in range(n):
                move[i] += G[i, j] * d[j]
        inject(nav[m], x[m], move)
        P_s = smoothed_covariance(P, G, P_s, ahead)
        pack(P_s, packed[m])


@compiled
def states_at(
    imu: Array, nodes: Array, nav: Array, x: Array, times: Array, index: Array, dynamic: int
) -> tuple[Array, Array]:
    """Smoothed states at times by the inertial samples, with what the next node tells.

    From the node before, the state is carried to the time and on to the next node; what it misses
    there is the noise of the step, a share of which belongs to the time. So the result is smooth
    and passes through every node.

    Parameters
    ----------
    times : shape (k,), s; index : shape (k,)
        The node at or before each; the last but one at most.

    Returns
    -------
    out : shape (k, 15); out_x : shape (k, n - 9)
    """
    none, size = np.zeros((9, 0)), x.shape[1]
    out, out_x = np.empty((len(times), 15)), np.empty((len(times), size))
    there, d = np.empty(15), np.empty(9 + size)
    for i in range(len(times)):
        m, time = index[i], times[i]
        here, aux = out[i], out_x[i]
        copy_row(nav[m], here)
        copy_row(x[m], aux)
        kept = aux[: dynamic - 3]
        at = propagate(imu, sample_before(imu, nodes[m]), nodes[m], time, here, kept, none)
        copy_row(here, there)
        propagate(imu, at, time, nodes[m + 1], there, kept, none)
        difference(nav[m + 1], x[m + 1], there, aux, d)
        share = (time - nodes[m]) / (nodes[m + 1] - nodes[m])
        for k in range(len(d)):
            d[k] *= share
        inject(here, aux, d)
    return out, out_x


def _carried(
    imu: Array, index: int, span: tuple[float, float], nav: Array, aux: Array, A: Array
) -> int:
    """As `propagate`, with the transition of this span alone in A."""
    reset_transition(A)
    return int(propagate(imu, index, span[0], span[1], nav, aux, A))


def chain_at(
    imu: Array, nodes: Array, jump: Array, model: Array, post: tuple[Array, Array],
    kept: tuple[Array, Array], trans: Array, times: Array, index: NDArray[np.int64],
) -> tuple[Array, Array]:  # fmt: skip
    """Covariance of the smoothed error at times, and gains between neighbours.

    Parameters
    ----------
    post
        Nav and x of the filter at the nodes: where the transition is taken.
    kept
        Packed covariances at the nodes: of the filter and of the smoother.
    times, index
        Increasing, s, and the node at or before each.

    Returns
    -------
    P : shape (k, n, n); G : shape (k, n, n)
        ``Cov(x_i, x_(i+1)) = G_i P_(i+1)``; the last G is not used.
    """
    n, k, width = model.shape[1], len(times), trans.shape[2]
    P_out, G_out = np.empty((k, n, n)), np.zeros((k, n, n))
    A, none = np.zeros((9, width)), np.zeros(3)
    for i in range(k):
        m, now = index[i], times[i]
        here, aux = post[0][m].copy(), post[1][m, : width - 3]
        # over every time in this interval, from the node's filtered covariance
        P = unpack(kept[0][m], n)
        at = _carried(imu, sample_before(imu, nodes[m]), (nodes[m], now), here, aux, A)
        if now > nodes[m]:
            P = stepped(P, A, now - nodes[m], none, model)[1]
        _carried(imu, at, (now, nodes[m + 1]), here.copy(), aux, A)
        P_out[i], G = unpack(kept[1][m + 1], n), np.eye(n)
        if now < nodes[m + 1]:
            Phi, ahead = stepped(P, A, nodes[m + 1] - now, jump[m + 1], model)
            G = gain(P, Phi, ahead)
            P_out[i] = smoothed_covariance(P, G, P_out[i], ahead)
        if i == k - 1:
            break
        then = times[i + 1]
        if index[i + 1] == m:
            _carried(imu, at, (now, then), here, aux, A)
            G = gain(P, *stepped(P, A, then - now, none, model))
        for j in range(m + 1, index[i + 1] + 1):
            P = unpack(kept[0][j], n)
            if j < index[i + 1]:
                step = stepped(P, trans[j], nodes[j + 1] - nodes[j], jump[j + 1], model)
                G = G @ gain(P, *step)
            elif then > nodes[j]:
                here, aux = post[0][j].copy(), post[1][j, : width - 3]
                _carried(imu, sample_before(imu, nodes[j]), (nodes[j], then), here, aux, A)
                G = G @ gain(P, *stepped(P, A, then - nodes[j], none, model))
        G_out[i] = G
    return P_out, G_out
