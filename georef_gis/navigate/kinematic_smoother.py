"""Kalman filter and smoother of fixes alone: where no IMU says how the vehicle moved.

States, in axes that are north, east, down at one place of the flight: position m, velocity m/s,
acceleration m/s2, slow GNSS error m; three of each. The acceleration of an axis is a first-order
Gauss-Markov process (Singer 1970): it forgets, so that a gap in the fixes lets the uncertainty grow
as a vehicle can and not as an unbounded jerk would. The smoother is that of Rauch, Tung and
Striebel (1965); a time between two fixes is put in as a node of its own without a measurement,
which changes nothing and gives its state and covariances exactly.
"""

from __future__ import annotations

import math

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.logs import IntArray
from georef_gis.navigate.dense import (
    cholesky,
    compiled,
    pack,
    product,
    product_t,
    solve_rows,
    symmetrise,
    unpack,
)
from georef_gis.navigate.smoother import gain, smoothed_covariance

STATES = 12
PACKED = STATES * (STATES + 1) // 2
# first states of position, velocity, acceleration, slow error
P, V, A, S = 0, 3, 6, 9
# normalised innovation squared above which an outlier says no more about the model
MOST_TELLING = 30.0
# Gauss-Legendre on [-1, 1], exact to the ninth power
_AT = np.array([-0.9061798459386640, -0.5384693101056831, 0.0, 0.5384693101056831,
                0.9061798459386640])  # fmt: skip
_WEIGHT = np.array([0.2369268850561891, 0.4786286704993665, 0.5688888888888889, 0.4786286704993665,
                    0.2369268850561891])  # fmt: skip


@compiled
def response(dt: float, tau: float, out: Array) -> None:
    """Position, velocity and acceleration after `dt` s of a unit acceleration that decays."""
    x = dt / tau
    lost = -math.expm1(-x)
    # x + expm1(-x) loses its digits below
    if x < 0.01:
        out[0] = dt * dt * (0.5 - x / 6.0 + x * x / 24.0 - x * x * x / 120.0)
    else:
        out[0] = tau * tau * (x - lost)
    out[1] = tau * lost
    out[2] = 1.0 - lost


@compiled
def axis_noise(dt: float, sigma: float, tau: float, out: Array) -> None:
    """Covariance (3, 3) that a step of `dt` s lets into position, velocity, acceleration.

    By quadrature of the response over pieces of at most half a correlation time: positive
    semidefinite by construction, where the closed form loses all its digits in short steps.
    """
    out[:] = 0.0
    pieces = max(1, min(math.ceil(2.0 * dt / tau), 200))
    width = dt / pieces
    density = 2.0 * sigma * sigma / tau
    g = np.empty(3)
    for piece in range(pieces):
        for k in range(5):
            response(width * (piece + 0.5 + 0.5 * _AT[k]), tau, g)
            w = 0.5 * width * _WEIGHT[k] * density
            for i in range(3):
                for j in range(3):
                    out[i, j] += w * g[i] * g[j]


@compiled
def step(dt: float, model: Array, slow: Array, loose: float) -> tuple[Array, Array]:
    """Transition and noise of a step, (12, 12) each.

    Parameters
    ----------
    dt : s
    model : shape (3, 2)
        Per axis: sigma of the acceleration m/s2, its correlation time s.
    slow : shape (4,)
        Sigmas of the slow error m, and its correlation time s.
    loose
        Factor on the sigma of the acceleration's noise.
    """
    Phi, Q = np.zeros((STATES, STATES)), np.zeros((STATES, STATES))
    g, q = np.empty(3), np.empty((3, 3))
    decay = math.exp(-dt / slow[3])
    for k in range(3):
        sigma, tau = model[k]
        response(dt, tau, g)
        axis_noise(dt, loose * sigma, tau, q)
        Phi[P + k, P + k] = Phi[V + k, V + k] = 1.0
        Phi[P + k, V + k] = dt
        Phi[P + k, A + k], Phi[V + k, A + k], Phi[A + k, A + k] = g
        for i in range(3):
            for j in range(3):
                Q[3 * i + k, 3 * j + k] = q[i, j]
        Phi[S + k, S + k] = decay
        Q[S + k, S + k] = slow[k] ** 2 * (1.0 - decay * decay)
    return Phi, Q


@compiled
def carried(
    cov: Array, dt: float, model: Array, slow: Array, loose: float
) -> tuple[Array, Array]:  # fmt: skip
    """Transition over a step and the covariance predicted at its end."""
    Phi, out = step(dt, model, slow, loose)
    out += product_t(product(Phi, cov), Phi)
    symmetrise(out)
    return Phi, out


@compiled
def _measured(x: Array, cov: Array, z: Array, first: int) -> tuple[Array, Array, Array]:
    """Cov H' (12, 3), H cov H' (3, 3) and innovation (3,) of a position or a velocity."""
    n = len(x)
    H, S_, r = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(3):
        r[k] = z[k] - x[first + k]
        for i in range(n):
            H[i, k] = cov[i, first + k]
        if first == P:
            r[k] -= x[S + k]
            for i in range(n):
                H[i, k] += cov[i, S + k]
    for i in range(3):
        for k in range(3):
            S_[i, k] = H[first + i, k]
            if first == P:
                S_[i, k] += H[S + i, k]
    return H, S_, r


@compiled
def _update(
    x: Array, cov: Array, z: Array, R: Array, first: int, gate: float, late: bool, told: Array
) -> tuple[float, float]:
    """Update in place; adds the log-likelihoods of the level and the vertical to `told` (2,).

    Returns
    -------
    nis
        Normalised innovation squared, negative where it was beyond the gate.
    added
        Variance that was let in because nothing had been believed for too long.
    """
    added, floor = 0.0, 100.0 if first == P else 1.0
    for _ in range(2):
        H, S_, r = _measured(x, cov, z, first)
        S_ += R
        y = r.reshape((1, 3)).copy()
        solve_rows(cholesky(S_), y)
        nis = r[0] * y[0, 0] + r[1] * y[0, 1] + r[2] * y[0, 2]
        if nis <= gate or not late or added > 0.0:
            break
        added = (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) / 3.0 + floor
        for i in range(first, first + 3):
            cov[i, i] += added
    det = S_[0, 0] * S_[1, 1] - S_[0, 1] ** 2
    level = (S_[1, 1] * r[0] ** 2 - 2.0 * S_[0, 1] * r[0] * r[1] + S_[0, 0] * r[1] ** 2) / det
    told[0] -= 0.5 * (min(level, MOST_TELLING) + math.log(det))
    told[1] -= 0.5 * (min(r[2] ** 2 / S_[2, 2], MOST_TELLING) + math.log(S_[2, 2]))
    sign = 1.0
    if nis > gate:
        # as if its noise were so large that it just passes: a pull that fades with its distance
        sign = -1.0
        S_ *= nis / gate
    K = H.copy()
    solve_rows(cholesky(S_), K)
    for i in range(len(x)):
        for k in range(3):
            x[i] += K[i, k] * r[k]
        for j in range(i + 1):
            s = 0.0
            for k in range(3):
                s += K[i, k] * H[j, k]
            cov[i, j] -= s
            cov[j, i] = cov[i, j]
    return sign * nis, added


@compiled
def forward(
    time: Array, z: Array, R: Array, model: Array, slow: Array, options: Array,
    x: Array, cov: Array, out: tuple[Array, ...],
) -> Array:  # fmt: skip
    """One pass of the filter; `x` and `cov` are the prior at the first fix and are used up.

    Parameters
    ----------
    time : shape (m,), s
    z : shape (2, m, 3)
        Positions m and velocities m/s, NaN = none.
    R : shape (2, m, 3, 3)
    model, slow
        See `step`.
    options : shape (2,)
        Gate, and s of unbelieved fixes after which the next is believed.
    out
        Prior states (m, 12), states (m, 12), packed covariances (m, 78), jumps (m, 3), normalised
        innovations squared (m, 2): filled. The jumps are variances let into position and velocity;
        their last column is given: `loose` of the step before, see `step`.

    Returns
    -------
    shape (2,)
        Log-likelihood of level and vertical innovations.
    """
    prior, post, packed, jump, chi = out
    good = np.full(2, time[0])
    told = np.zeros(2)
    for m in range(len(time)):
        if m > 0:
            Phi, cov = carried(cov, time[m] - time[m - 1], model, slow, jump[m, 2])
            x = product(Phi, x.reshape((len(x), 1)))[:, 0].copy()
        prior[m] = x
        for block in range(2):
            jump[m, block], chi[m, block] = 0.0, np.nan
            if math.isnan(z[block, m, 0] + z[block, m, 1] + z[block, m, 2]):
                continue
            late = time[m] - good[block] > options[1]
            nis, added = _update(
                x, cov, z[block, m], R[block, m], P if block == 0 else V, options[0], late, told
            )
            jump[m, block], chi[m, block] = added, nis
            if nis >= 0.0:
                good[block] = time[m]
        post[m] = x
        pack(cov, packed[m])
    return told


@compiled
def _ahead(
    cov: Array, dt: float, model: Array, slow: Array, jump: Array
) -> tuple[Array, Array]:  # fmt: skip
    """As `carried`, within the step to a node with a jump, to its end where that lets some in."""
    Phi, out = carried(cov, dt, model, slow, jump[2])
    for k in range(3):
        out[P + k, P + k] += jump[0]
        out[V + k, V + k] += jump[1]
    return Phi, out


@compiled
def _part(jump: Array, ends: bool) -> Array:
    """Jump of a step, or of a part of it that does not reach its end."""
    out = jump.copy()
    if not ends:
        out[:2] = 0.0
    return out


@compiled
def _moved(x: Array, G: Array, d: Array) -> Array:
    return x + product(G, d.reshape((len(d), 1)))[:, 0]


@compiled
def backward(
    time: Array, model: Array, slow: Array, passed: tuple[Array, ...], x: Array, packed: Array
) -> None:
    """Smoothed states (m, 12) and packed covariances (m, 78) of what `forward` left, filled in."""
    prior, post, kept, jump = passed
    last = len(time) - 1
    x[last], packed[last] = post[last], kept[last]
    smoothed = unpack(kept[last], STATES)
    for m in range(last - 1, -1, -1):
        cov = unpack(kept[m], STATES)
        Phi, ahead = _ahead(cov, time[m + 1] - time[m], model, slow, jump[m + 1])
        G = gain(cov, Phi, ahead)
        x[m] = _moved(post[m], G, x[m + 1] - prior[m + 1])
        smoothed = smoothed_covariance(cov, G, smoothed, ahead)
        pack(smoothed, packed[m])


@compiled
def insert(
    time: Array, model: Array, slow: Array, passed: tuple[Array, ...],
    smoothed: tuple[Array, Array], at: Array, index: IntArray, chained: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """States at times between the nodes, their covariances and the gains between neighbours.

    Parameters
    ----------
    passed
        Prior states, states, packed covariances and jumps of `forward`.
    smoothed
        States and packed covariances of `backward`.
    at, index : shape (k,)
        Times, s, and the node at or before each, the last but one at most.
    chained
        Whether gains are wanted; the times must then increase.

    Returns
    -------
    x : shape (k, 12); cov : shape (k, 12, 12)
    G : shape (k, 12, 12)
        ``Cov(x_i, x_(i+1)) = G_i cov_(i+1)``; zeros for the last, or where not wanted.
    """
    prior, post, kept, jump = passed
    k = len(at)
    x, cov = np.empty((k, STATES)), np.empty((k, STATES, STATES))
    gains = np.zeros((k, STATES, STATES))
    for i in range(k):
        m = index[i]
        Phi, here = carried(unpack(kept[m], STATES), at[i] - time[m], model, slow, jump[m + 1, 2])
        after = unpack(smoothed[1][m + 1], STATES)
        if at[i] < time[m + 1]:
            mean = product(Phi, post[m].reshape((STATES, 1)))[:, 0].copy()
            Phi, ahead = _ahead(here, time[m + 1] - at[i], model, slow, jump[m + 1])
            G = gain(here, Phi, ahead)
            x[i] = _moved(mean, G, smoothed[0][m + 1] - prior[m + 1])
            cov[i] = smoothed_covariance(here, G, after, ahead)
        else:
            G = np.eye(STATES)
            x[i], cov[i] = smoothed[0][m + 1], after
        if not chained or i == k - 1:
            continue
        end = index[i + 1]
        if end == m:
            # the last node lies at the end of its interval, with what was let in there
            ends = at[i] < at[i + 1] == time[m + 1]
            Phi, ahead = _ahead(here, at[i + 1] - at[i], model, slow, _part(jump[m + 1], ends))
            gains[i] = gain(here, Phi, ahead)
            continue
        for j in range(m + 1, end + 1):
            until = time[j + 1] if j < end else at[i + 1]
            here = unpack(kept[j], STATES)
            part = _part(jump[j + 1], until == time[j + 1])
            Phi, ahead = _ahead(here, until - time[j], model, slow, part)
            G = product(G, gain(here, Phi, ahead))
        gains[i] = G
    return x, cov, gains
