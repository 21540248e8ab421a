"""Rauch-Tung-Striebel smoother on the nodes of the filter, and covariances between any two times.

Rauch, Tung, Striebel (1965) in closed-loop form: the state at a node is moved by ``G (smoothed
ahead - predicted ahead)``. Smoothed errors are a Markov chain, so with ``G`` of each step
``Cov(x_i, x_j) = G_i G_(i+1) .. G_(j-1) P_j`` for i < j: any time between two nodes is put in as a
node of its own without a measurement, which changes nothing but gives its covariances exactly.
"""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array
from georef_gis.navigate.dense import (
    cholesky,
    compiled,
    product,
    product_t,
    sample_before,
    solve_rows,
    symmetrise,
)
from georef_gis.navigate.inertial import propagate, reset_transition
from georef_gis.navigate.kalman import (
    difference,
    inject,
    pack,
    predicted,
    step_noise,
    transition_matrix,
    unpack,
)


@compiled
def gain(P: Array, Phi: Array, ahead: Array) -> Array:
    """Smoother gain ``P Phi' ahead^-1``, (n, n); scaled, for the states differ by 1e10."""
    n = len(P)
    s = np.empty(n)
    for i in range(n):
        s[i] = 1.0 / np.sqrt(ahead[i, i]) if ahead[i, i] > 0.0 else 1.0
    scaled = np.empty((n, n))
    G = product_t(P, Phi)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = ahead[i, j] * s[i] * s[j]
            G[i, j] *= s[j]
    solve_rows(cholesky(scaled), G)
    for i in range(n):
        for j in range(n):
            G[i, j] *= s[j]
    return G


@compiled
def ahead_of(P: Array, A: Array, dt: float, jump: Array, model: Array) -> tuple[Array, Array]:
    """Transition over a step and the covariance predicted at its end, with the jump there."""
    noise, phi_x = step_noise(model[0], model[1], dt)
    Phi = transition_matrix(A, dt, phi_x)
    out = predicted(P, Phi, noise)
    for b in range(3):
        for i in range(3):
            out[3 * b + i, 3 * b + i] += jump[b]
    return Phi, out


@compiled
def smoothed_covariance(P: Array, G: Array, smoothed: Array, ahead: Array) -> Array:
    """``P + G (smoothed ahead - predicted ahead) G'``, symmetric, (n, n)."""
    out = P + product_t(product(G, smoothed - ahead), G)
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
    nav[last], x[last], packed[last] = post_nav[last], post_x[last], kept[last]
    P_s = unpack(kept[last], n)
    d = np.empty(n)
    for m in range(last - 1, -1, -1):
        P = unpack(kept[m], n)
        Phi, ahead = ahead_of(P, trans[m], nodes[m + 1] - nodes[m], jump[m + 1], model)
        G = gain(P, Phi, ahead)
        difference(nav[m + 1], x[m + 1], prior_nav[m + 1], prior_x[m + 1], d)
        nav[m], x[m] = post_nav[m], post_x[m]
        inject(nav[m], x[m], product_t(G, d.reshape((1, n)))[:, 0].copy())
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
    none = np.zeros((9, 0))
    size = x.shape[1]
    out, out_x = np.empty((len(times), 15)), np.empty((len(times), size))
    d = np.empty(9 + size)
    kept = dynamic - 3
    for i in range(len(times)):
        m = index[i]
        here, aux = nav[m].copy(), x[m].copy()
        start = sample_before(imu, nodes[m])
        at = propagate(imu, start, nodes[m], times[i], here, aux[:kept], none)
        there = here.copy()
        propagate(imu, at, times[i], nodes[m + 1], there, aux[:kept], none)
        difference(nav[m + 1], x[m + 1], there, aux, d)
        share = (times[i] - nodes[m]) / (nodes[m + 1] - nodes[m])
        inject(here, aux, share * d)
        out[i], out_x[i] = here, aux
    return out, out_x


@compiled
def chain_at(
    imu: Array, nodes: Array, jump: Array, model: Array, post: tuple[Array, Array],
    kept: tuple[Array, Array], trans: Array, times: Array, index: Array,
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
    n, dynamic = model.shape[1], trans.shape[2]
    k = len(times)
    P_out, G_out = np.empty((k, n, n)), np.zeros((k, n, n))
    A = np.zeros((9, dynamic))
    for i in range(k):
        m = index[i]
        here, aux = post[0][m].copy(), post[1][m].copy()
        P = unpack(kept[0][m], n)
        at = sample_before(imu, nodes[m])
        now = nodes[m]
        # over every time in this interval, from the node's filtered covariance
        reset_transition(A)
        at = propagate(imu, at, now, times[i], here, aux[: dynamic - 3], A)
        if times[i] > now:
            P = ahead_of(P, A, times[i] - now, np.zeros(3), model)[1]
        reset_transition(A)
        propagate(imu, at, times[i], nodes[m + 1], here.copy(), aux[: dynamic - 3], A)
        if times[i] < nodes[m + 1]:
            Phi, ahead = ahead_of(P, A, nodes[m + 1] - times[i], jump[m + 1], model)
            G = gain(P, Phi, ahead)
            P_out[i] = smoothed_covariance(P, G, unpack(kept[1][m + 1], n), ahead)
        else:
            G = np.eye(n)
            P_out[i] = unpack(kept[1][m + 1], n)
        if i == k - 1:
            break
        if index[i + 1] == m:
            reset_transition(A)
            propagate(imu, at, times[i], times[i + 1], here, aux[: dynamic - 3], A)
            step = times[i + 1] - times[i]
            Phi, ahead = ahead_of(P, A, step, np.zeros(3), model)
            G_out[i] = gain(P, Phi, ahead)
            continue
        for j in range(m + 1, index[i + 1] + 1):
            P = unpack(kept[0][j], n)
            if j < index[i + 1]:
                step = nodes[j + 1] - nodes[j]
                Phi, ahead = ahead_of(P, trans[j], step, jump[j + 1], model)
                G = product(G, gain(P, Phi, ahead))
            elif times[i + 1] > nodes[j]:
                here, aux = post[0][j].copy(), post[1][j].copy()
                at = sample_before(imu, nodes[j])
                reset_transition(A)
                propagate(imu, at, nodes[j], times[i + 1], here, aux[: dynamic - 3], A)
                Phi, ahead = ahead_of(P, A, times[i + 1] - nodes[j], np.zeros(3), model)
                G = product(G, gain(P, Phi, ahead))
        G_out[i] = G
    return P_out, G_out
