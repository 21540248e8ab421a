"""Error-state Kalman filter of the inertial state, compiled: prediction, gated updates, one pass.

Error states, in order: dp, dv, phi (NED, m, m/s, rad), gyro bias, accelerometer bias, then where
they are estimated: nine of the gyro's scale and misalignment, three of the slow GNSS error (m), one
of the barometer's offset (m), two of the wind (m/s, north and east). `x` holds the estimates of
all but the first nine. The formulas are those of Groves (2013), ch. 3 and 14, with the attitude
error on the left, in NED.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.navigate.dense import (
    cholesky,
    compiled,
    copy_matrix,
    copy_row,
    pack,
    product,
    product_t,
    sample_before,
    solve_columns,
    symmetrise,
    transposed,
)
from georef_gis.navigate.inertial import (
    corrected_rate,
    orthonormalise,
    propagate,
    radii,
    reset_transition,
    sample_of,
    turn_left,
    turned,
)

IntArray = NDArray[np.int64]
# times the patience with positions while velocities are accepted
PATIENCE = 6.0
# m2 and m2/s2; least variance that is let in when nothing has been accepted for too long
LOOSE_P, LOOSE_V = 100.0, 1.0
# what becomes of a measurement beyond the gate: it counts less, or not at all
LESS, REFUSE = -1, -2


@compiled
def let_in(P: Array, jump: Array) -> None:
    """Add variances (3,) of position, velocity and attitude to a covariance, in place."""
    for i in range(3 * len(jump)):
        P[i, i] += jump[i // 3]


@compiled
def stepped(P: Array, A: Array, dt: float, jump: Array, model: Array) -> tuple[Array, Array]:
    """Transition of all errors over a step, and the covariance predicted at its end.

    Parameters
    ----------
    P : shape (n, n)
    A : shape (9, k)
        Transition as of `advance`.
    dt : s
    jump : shape (3,)
        Variance that enters position, velocity and attitude at the end.
    model : shape (2, n)
        Noise density per s of the random walks, the stationary variance of the correlated states;
        and correlation time, s, 0 for a random walk.

    Returns
    -------
    Phi : shape (n, n); ahead : shape (n, n)
    """
    n = len(P)
    Phi, noise = np.zeros((n, n)), np.empty(n)
    # P is symmetric: its transpose is a copy. Half of the noise enters before the step
    half = transposed(P)
    for i in range(n):
        d, q = 1.0, model[0, i]
        if model[1, i] > 0.0:
            d = math.exp(-dt / model[1, i])
            # what the two halves need for the variance to stay
            q *= 2.0 * (1.0 - d * d) / (1.0 + d * d)
        else:
            q *= dt
        noise[i] = 0.5 * q
        half[i, i] += 0.5 * q
        Phi[i, i] = d
    # a number of rows that the compiler does not know keeps it from writing each one out
    for i in range(len(A)):
        copy_row(A[i], Phi[i, 6 : 6 + A.shape[1]])
    for i in range(len(jump)):
        Phi[i, 3 + i] = dt
    ahead = product(Phi, transposed(product(Phi, half)))
    for i in range(n):
        ahead[i, i] += noise[i]
    let_in(ahead, jump)
    symmetrise(ahead)
    return Phi, ahead


@compiled
def inject(nav: Array, x: Array, d: Array) -> None:
    """Add an error to a state, in place; shapes (15,), (n - 9,), (n,)."""
    rm, rn = radii(nav[0])
    lat = nav[0]
    nav[0] += d[0] / (rm + nav[2])
    nav[1] += d[1] / ((rn + nav[2]) * math.cos(lat))
    nav[2] -= d[2]
    for i in range(3):
        nav[3 + i] += d[3 + i]
    turn_left(nav[6:], d[6], d[7], d[8])
    for i in range(len(x)):
        x[i] += d[9 + i]


@compiled
def difference(nav_a: Array, x_a: Array, nav_b: Array, x_b: Array, out: Array) -> None:
    """Error that takes state b to state a, into `out` (n,)."""
    rm, rn = radii(nav_b[0])
    out[0] = (nav_a[0] - nav_b[0]) * (rm + nav_b[2])
    out[1] = (nav_a[1] - nav_b[1]) * (rn + nav_b[2]) * math.cos(nav_b[0])
    out[2] = -(nav_a[2] - nav_b[2])
    for i in range(3):
        out[3 + i] = nav_a[3 + i] - nav_b[3 + i]
    # half of the skew part of R_a R_b', and its trace
    trace, v0, v1, v2 = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        a0, a1, a2 = nav_a[6 + k], nav_a[9 + k], nav_a[12 + k]
        b0, b1, b2 = nav_b[6 + k], nav_b[9 + k], nav_b[12 + k]
        trace += a0 * b0 + a1 * b1 + a2 * b2
        v0 += 0.5 * (a2 * b1 - a1 * b2)
        v1 += 0.5 * (a0 * b2 - a2 * b0)
        v2 += 0.5 * (a1 * b0 - a0 * b1)
    c = 0.5 * (trace - 1.0)
    s = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    longer = 1.0 if s < 1e-9 else math.atan2(s, c) / s
    out[6], out[7], out[8] = longer * v0, longer * v1, longer * v2
    for i in range(len(x_a)):
        out[9 + i] = x_a[i] - x_b[i]


@compiled
def _gnss_terms(
    nav: Array, x: Array, z: Array, arm: Array, rate: tuple[float, float, float], slow: int
) -> tuple[Array, Array]:
    """H (3, n) and innovation (3,) of the antenna's position (lat, lon, h), or velocity in NED.

    A position where `slow` >= 0, the first column of the slow error or 0; else a velocity.
    """
    H, r = np.zeros((3, 9 + len(x))), np.empty(3)
    a0, a1, a2 = arm[0], arm[1], arm[2]
    first = 0
    if slow < 0:
        first = 3
        w0, w1, w2 = rate
        a0, a1, a2 = w1 * a2 - w2 * a1, w2 * a0 - w0 * a2, w0 * a1 - w1 * a0
    a0, a1, a2 = turned(nav[6:], a0, a1, a2)
    if slow < 0:
        r[0], r[1], r[2] = z[0] - nav[3] - a0, z[1] - nav[4] - a1, z[2] - nav[5] - a2
    else:
        rm, rn = radii(nav[0])
        r[0] = (z[0] - nav[0]) * (rm + nav[2]) - a0
        r[1] = (z[1] - nav[1]) * (rn + nav[2]) * math.cos(nav[0]) - a1
        r[2] = nav[2] - z[2] - a2
    for i in range(3):
        H[i, first + i] = 1.0
        if slow > 0:
            H[i, slow + i] = 1.0
            r[i] -= x[slow + i - 9]
    H[0, 7], H[0, 8], H[1, 6] = a2, -a1, -a2
    H[1, 8], H[2, 6], H[2, 7] = a0, a1, -a0
    return H, r


@compiled
def _aid_terms(
    kind: int, z: float, nav: Array, x: Array, baro: int, wind: int
) -> tuple[Array, Array]:
    """H (1, n) and innovation (1,) of an aid: 0 heading rad, 1 height m, 2 airspeed m/s."""
    H, r = np.zeros((1, 9 + len(x))), np.empty(1)
    if kind == 0:
        # yaw = atan2(R10, R00); phi turns the first column
        r00, r10, r20 = nav[6], nav[9], nav[12]
        c2 = r00 * r00 + r10 * r10
        d = z - math.atan2(r10, r00)
        r[0] = math.atan2(math.sin(d), math.cos(d))
        H[0, 6], H[0, 7], H[0, 8] = -r00 * r20 / c2, -r10 * r20 / c2, 1.0
    elif kind == 1:
        H[0, 2], H[0, baro] = -1.0, 1.0
        r[0] = z - nav[2] - x[baro - 9]
    else:
        a0, a1, a2 = nav[3] - x[wind - 9], nav[4] - x[wind - 8], nav[5]
        speed = max(math.sqrt(a0 * a0 + a1 * a1 + a2 * a2), 1.0)
        H[0, 3], H[0, 4], H[0, 5] = a0 / speed, a1 / speed, a2 / speed
        H[0, wind], H[0, wind + 1] = -a0 / speed, -a1 / speed
        r[0] = z - speed
    return H, r


@compiled
def _gain_of(P: Array, H: Array, r: Array, R: Array) -> tuple[Array, Array, Array]:
    """HP (m, n), ``S^-1 (HP, r)`` (m, n + 1) and the Cholesky factor of the innovations' S."""
    m, n = H.shape
    HP = product(H, P)
    S, K = product_t(HP, H), np.empty((m, n + 1))
    for i in range(m):
        for j in range(m):
            S[i, j] += R[i, j]
        copy_row(HP[i], K[i, :n])
        K[i, n] = r[i]
    L = cholesky(S)
    solve_columns(L, K)
    return HP, K, L


@compiled
def _update(
    P: Array, nav: Array, x: Array, terms: tuple[Array, Array], R: Array, gate: float, loose: int
) -> tuple[float, float, float]:
    """Gated update in place with H (m, n) and innovation (m,), whose noise is R (m, m).

    Beyond the gate nothing is done where `loose` is `REFUSE`. Else the measurement counts as if
    its noise were so large that it just passes: a pull that fades with its distance, where a
    refusal would lock a filter out that has gone astray itself. And where `loose` >= 0, so long
    has nothing been accepted that first the variance of the three states from there grows.

    Returns
    -------
    nis
        Normalised innovation squared, negative if it was beyond the gate.
    likelihood
        Its logarithm without 2 pi.
    added
        The variance let in.
    """
    H, r = terms
    m, n = H.shape
    added, nis, likelihood = 0.0, 0.0, 0.0
    for attempt in range(2):
        HP, K, L = _gain_of(P, H, r, R)
        nis, likelihood, square = 0.0, 0.0, 0.0
        for k in range(m):
            nis += r[k] * K[k, n]
            square += r[k] * r[k]
            likelihood -= math.log(L[k, k])
        if nis <= gate or loose < 0 or attempt == 1:
            break
        added = square / 3.0 + (LOOSE_P if loose == 0 else LOOSE_V)
        for i in range(3):
            P[loose + i, loose + i] += added
    # an outlier counts as no more than that, or one would outweigh a flight
    likelihood -= 0.5 * min(nis, 30.0)
    weight = 1.0
    if not nis <= gate:
        if loose == REFUSE:
            return -nis, likelihood, added
        weight = gate / nis
    d = np.zeros(n)
    for i in range(n):
        for k in range(m):
            gain = weight * K[k, i]
            d[i] += gain * r[k]
            for j in range(n):
                P[i, j] -= gain * HP[k, j]
    symmetrise(P)
    inject(nav, x, d)
    return (nis if weight == 1.0 else -nis), likelihood, added


@compiled
def _terms(
    source: int, at: tuple[int, int], state: tuple[Array, Array], rate: tuple[float, float, float],
    layout: IntArray, measured: tuple[Array, Array, Array, Array],
) -> tuple[tuple[Array, Array], Array]:  # fmt: skip
    """H and innovation of one of the five measurements at (node, fix), and the noise's covariance.

    Positions, velocities, heading, height, airspeed: `source` 0 to 4.
    """
    nav, x = state
    values, covariances, aids, arm = measured
    if source < 2:
        slow = layout[0] if source == 0 else -1
        found = _gnss_terms(nav, x, values[source, at[1]], arm, rate, slow)
        return found, covariances[source, at[1]]
    z = aids[at[0], source - 2]
    R = np.empty((1, 1))
    R[0, 0] = z[1] * z[1]
    return _aid_terms(source - 2, z[0], nav, x, layout[1], layout[2]), R


@compiled
def _looseness(source: int, now: float, good: Array, patience: float) -> int:
    """What becomes of a measurement beyond the gate, see `_update`."""
    if source > 1:
        return REFUSE
    # a filter whose velocity agrees cannot be far astray: the positions are
    if source == 0 and now - good[1] <= patience:
        patience *= PATIENCE
    return 3 * source if now - good[source] > patience else LESS


@compiled
def run_filter(
    imu: Array, plan: tuple[Array, Array, IntArray], states: tuple[IntArray, Array],
    measured: tuple[Array, Array, Array, Array], options: Array,
    prior: tuple[Array, Array, Array], out: tuple[Array, ...], chi: Array,
) -> int:  # fmt: skip
    """One forward pass.

    Parameters
    ----------
    imu : shape (n, 7)
        Time s, rate rad/s, force m/s2.
    plan
        Nodes (m,) s; variance that enters position, velocity and attitude at each (m, 3), a gap
        of the IMU, to which re-acquisition adds; row of the fixes at each, -1 for none.
    states
        Layout (4,): first columns of the slow error, barometer and wind (0 = none), and one of no
        use; model (2, n): density of noise and correlation time, see `stepped`.
    measured
        Positions (lat, lon, h) and velocities (2, k, 3), their covariances (2, k, 3, 3); value and
        sigma of heading, height and airspeed at each node (m, 3, 2); NaN = none. IMU to antenna,
        body, (3,) m.
    options : shape (3,)
        Gate of three, gate of one degree of freedom, s of refusals before re-acquisition.
    prior
        nav (15,), x and P at the first node; used up.
    out
        prior nav (m, 15), prior x, nav (m, 15), x, packed P, A (m, 9, k): filled.
    chi : shape (m, 4)
        Normalised innovations squared of position and velocity (negative = too large, NaN = none),
        log-likelihood, number of degrees of freedom behind it: filled.

    Returns
    -------
    int
        Number of nodes that were reached; less than m if the state became useless.
    """
    nodes, jump, fix = plan
    nav, x, P = prior
    prior_nav, prior_x, post_nav, post_x, packed, trans = out
    A, sample, good = np.zeros((9, trans.shape[2])), np.empty(6), np.empty(2)
    aux = x[: trans.shape[2] - 3]
    index = sample_before(imu, nodes[0])
    good[0] = good[1] = nodes[0]
    let_in(P, jump[0])
    for m in range(len(nodes)):
        now = nodes[m]
        if m > 0:
            reset_transition(A)
            index = propagate(imu, index, nodes[m - 1], now, nav, aux, A)
            copy_matrix(A, trans[m - 1])
            Phi, P = stepped(P, A, now - nodes[m - 1], jump[m], states[1])
            for i in range(len(x)):
                x[i] *= Phi[9 + i, 9 + i]
            orthonormalise(nav[6:])
        copy_row(nav, prior_nav[m])
        copy_row(x, prior_x[m])
        chi[m, 0] = chi[m, 1] = math.nan
        chi[m, 2] = chi[m, 3] = 0.0
        sample_of(imu, min(index, len(imu) - 2), now, sample)
        rate, j = corrected_rate(sample, aux), fix[m]
        for source in range(5):
            if source < 2:
                if j < 0 or math.isnan(measured[0][source, j, 0]):
                    continue
            elif math.isnan(measured[2][m, source - 2, 0]):
                continue
            terms, R = _terms(source, (m, j), (nav, x), rate, states[0], measured)
            loose = _looseness(source, now, good, options[2])
            nis, ll, added = _update(P, nav, x, terms, R, options[min(source // 2, 1)], loose)
            if source < 2:
                jump[m, source] += added
                chi[m, source] = nis
                chi[m, 2] += ll
                chi[m, 3] += 3.0
                if nis >= 0.0:
                    good[source] = now
        copy_row(nav, post_nav[m])
        copy_row(x, post_x[m])
        pack(P, packed[m])
        if not math.isfinite(nav[0] + nav[3] + nav[6] + P[6, 6]) or abs(nav[2]) > 1e5:
            return m
    return len(nodes)
