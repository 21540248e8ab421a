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
    product,
    product_t,
    sample_before,
    solve_rows,
    symmetrise,
)
from georef_gis.navigate.inertial import (
    corrected_rate,
    orthonormalise,
    propagate,
    radii,
    reset_transition,
    turn_left,
)

IntArray = NDArray[np.int64]
# times the patience with positions while velocities are accepted
PATIENCE = 6.0


@compiled
def transition_matrix(A: Array, dt: float, phi_x: Array) -> Array:
    """Whole transition of the errors from that of `advance`; shape (n, n).

    Parameters
    ----------
    A : shape (9, k)
    dt : s
    phi_x : shape (n - 9,)
        Decay of the states behind the nine over the interval, 1 for a constant.
    """
    n = 9 + len(phi_x)
    out = np.zeros((n, n))
    for i in range(6):
        out[i, i] = 1.0
    for i in range(3):
        out[i, 3 + i] = dt
    out[:9, 6 : 6 + A.shape[1]] = A
    for i in range(n - 9):
        out[9 + i, 9 + i] = phi_x[i]
    return out


@compiled
def predicted(P: Array, Phi: Array, noise: Array) -> Array:
    """Covariance after a step: half of the noise enters before it and half behind, (n, n)."""
    half = P.copy()
    for i in range(len(noise)):
        half[i, i] += 0.5 * noise[i]
    out = product_t(product(Phi, half), Phi)
    for i in range(len(noise)):
        out[i, i] += 0.5 * noise[i]
    symmetrise(out)
    return out


@compiled
def step_noise(density: Array, tau: Array, dt: float) -> tuple[Array, Array]:
    """Noise of a step and decay of the states behind the nine.

    Parameters
    ----------
    density : shape (n,)
        Per s of the random walks; the stationary variance where `tau` is given.
    tau : shape (n,), s
        Correlation time, 0 for a random walk.
    dt : s

    Returns
    -------
    noise : shape (n,); phi_x : shape (n - 9,)
    """
    n = len(density)
    noise, phi_x = np.empty(n), np.ones(n - 9)
    for i in range(n):
        if tau[i] > 0.0:
            d = math.exp(-dt / tau[i])
            phi_x[i - 9] = d
            # what `predicted` needs for the variance to stay
            noise[i] = 2.0 * density[i] * (1.0 - d * d) / (1.0 + d * d)
        else:
            noise[i] = density[i] * dt
    return noise, phi_x


@compiled
def _block_update(P: Array, H: Array, S: Array, r: Array, nav: Array, x: Array) -> None:
    """Update with PHt in H (n, m), its innovation covariance S and innovation r, in place."""
    n, m = H.shape
    K = H.copy()
    solve_rows(cholesky(S), K)
    d = np.zeros(n)
    for i in range(n):
        for k in range(m):
            d[i] += K[i, k] * r[k]
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(m):
                s += K[i, k] * H[j, k]
            value = P[i, j] - s
            P[i, j] = value
            P[j, i] = value
    inject(nav, x, d)


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
    R = nav[6:15].reshape(3, 3)
    turn_left(R, d[6:9])
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
    D = product_t(nav_a[6:15].reshape(3, 3), nav_b[6:15].reshape(3, 3))
    c = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    v0, v1, v2 = 0.5 * (D[2, 1] - D[1, 2]), 0.5 * (D[0, 2] - D[2, 0]), 0.5 * (D[1, 0] - D[0, 1])
    s = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    k = 1.0 if s < 1e-9 else math.atan2(s, c) / s
    out[6], out[7], out[8] = k * v0, k * v1, k * v2
    for i in range(len(x_a)):
        out[9 + i] = x_a[i] - x_b[i]


@compiled
def _position_terms(
    P: Array, nav: Array, x: Array, z: Array, arm: Array, slow: int
) -> tuple[Array, Array, Array]:
    """PHt (n, 3), H P Ht (3, 3) and innovation (3,) of a position (lat, lon, h) of the antenna."""
    n = len(P)
    R = nav[6:15].reshape(3, 3)
    a = R @ arm
    rm, rn = radii(nav[0])
    r = np.empty(3)
    r[0] = (z[0] - nav[0]) * (rm + nav[2]) - a[0]
    r[1] = (z[1] - nav[1]) * (rn + nav[2]) * math.cos(nav[0]) - a[1]
    r[2] = nav[2] - z[2] - a[2]
    H = np.zeros((3, n))
    for i in range(3):
        H[i, i] = 1.0
        if slow > 0:
            H[i, slow + i] = 1.0
            r[i] -= x[slow + i - 9]
    _minus_skew(H, a, 6)
    PHt = product_t(P, H)
    return PHt, product(H, PHt), r


@compiled
def _velocity_terms(
    P: Array, nav: Array, z: Array, arm: Array, rate: Array
) -> tuple[Array, Array, Array]:
    """As `_position_terms`, of a velocity of the antenna in NED."""
    n = len(P)
    R = nav[6:15].reshape(3, 3)
    swing = np.array([rate[1] * arm[2] - rate[2] * arm[1], rate[2] * arm[0] - rate[0] * arm[2],
                      rate[0] * arm[1] - rate[1] * arm[0]])  # fmt: skip
    a = R @ swing
    r = z - nav[3:6] - a
    H = np.zeros((3, n))
    for i in range(3):
        H[i, 3 + i] = 1.0
    _minus_skew(H, a, 6)
    PHt = product_t(P, H)
    return PHt, product(H, PHt), r


@compiled
def _minus_skew(H: Array, a: Array, column: int) -> None:
    H[0, column + 1], H[0, column + 2] = a[2], -a[1]
    H[1, column], H[1, column + 2] = -a[2], a[0]
    H[2, column], H[2, column + 1] = a[1], -a[0]


@compiled
def _scalar_terms(
    kind: int, z: float, nav: Array, x: Array, baro: int, wind: int
) -> tuple[Array, float]:
    """Row H (n,) and innovation of an aid: 0 heading rad, 1 height m, 2 airspeed m/s."""
    H = np.zeros(9 + len(x))
    R = nav[6:15].reshape(3, 3)
    if kind == 0:
        # yaw = atan2(R10, R00); phi turns the first column
        c2 = R[0, 0] ** 2 + R[1, 0] ** 2
        d = z - math.atan2(R[1, 0], R[0, 0])
        r = math.atan2(math.sin(d), math.cos(d))
        H[6] = -R[0, 0] * R[2, 0] / c2
        H[7] = -R[1, 0] * R[2, 0] / c2
        H[8] = 1.0
    elif kind == 1:
        H[2] = -1.0
        H[baro] = 1.0
        r = z - nav[2] - x[baro - 9]
    else:
        a = nav[3:6].copy()
        a[0] -= x[wind - 9]
        a[1] -= x[wind - 8]
        speed = max(math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2), 1.0)
        for i in range(3):
            H[3 + i] = a[i] / speed
        H[wind], H[wind + 1] = -a[0] / speed, -a[1] / speed
        r = z - speed
    return H, r


@compiled
def _gnss_block(
    P: Array, nav: Array, x: Array, z: tuple[Array, Array], arm: Array, rate: Array, slow: int,
    gate: float, late: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Gated update with a position (`slow` >= 0) or a velocity (`slow` < 0), in place.

    Returns the normalised innovation squared, negative if it was too large and the fix counted
    less; the log-likelihood without 2 pi; and the variance that was added because nothing had been
    accepted for too long.
    """
    first, floor = (0, 100.0) if slow >= 0 else (3, 1.0)
    added = 0.0
    for _ in range(2):
        if slow >= 0:
            PHt, HPHt, r = _position_terms(P, nav, x, z[0], arm, slow)
        else:
            PHt, HPHt, r = _velocity_terms(P, nav, z[0], arm, rate)
        S = HPHt + z[1]
        L = cholesky(S)
        y = r.reshape((1, 3)).copy()
        solve_rows(L, y)
        nis = r[0] * y[0, 0] + r[1] * y[0, 1] + r[2] * y[0, 2]
        if nis <= gate or not late or added > 0.0:
            break
        added = (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) / 3.0 + floor
        for i in range(first, first + 3):
            P[i, i] += added
    # an outlier counts as no more than that, or one would outweigh a flight
    likelihood = -0.5 * min(nis, 30.0) - math.log(L[0, 0] * L[1, 1] * L[2, 2])
    sign = 1.0
    if nis > gate:
        # as if its noise were so large that it just passes: a pull that fades with its distance,
        # where a refusal would lock a filter out that has gone astray itself
        sign = -1.0
        S *= nis / gate
    _block_update(P, PHt, S, r, nav, x)
    return sign * nis, likelihood, added


@compiled
def _aid(
    P: Array, nav: Array, x: Array, kind: int, z: Array, layout: IntArray, gate: float
) -> None:  # fmt: skip
    """Gated update with value and sigma of one aid, in place."""
    h, r = _scalar_terms(kind, z[0], nav, x, layout[1], layout[2])
    column = product_t(P, h.reshape((1, len(h))))
    s = z[1] ** 2
    for i in range(len(h)):
        s += h[i] * column[i, 0]
    if r * r / s <= gate:
        _block_update(P, column, np.full((1, 1), s), np.full(1, r), nav, x)


@compiled
def pack(P: Array, out: Array) -> None:
    """Lower triangle by rows, into `out` (n (n + 1) / 2,)."""
    k = 0
    for i in range(len(P)):
        for j in range(i + 1):
            out[k] = P[i, j]
            k += 1


@compiled
def unpack(packed: Array, n: int) -> Array:
    """Matrix of a packed lower triangle, (n, n)."""
    P = np.empty((n, n))
    k = 0
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = packed[k]
            P[j, i] = packed[k]
            k += 1
    return P


@compiled
def run_filter(
    imu: Array, nodes: Array, jump: Array, fix: IntArray, layout: IntArray, model: Array,
    gnss: tuple[Array, Array], aids: Array, arm: Array, options: Array,
    nav: Array, x: Array, P: Array, out: tuple[Array, ...], chi: Array,
) -> int:  # fmt: skip
    """One forward pass; `nav`, `x`, `P` are the prior at the first node and are used up.

    Parameters
    ----------
    imu : shape (n, 7)
        Time s, rate rad/s, force m/s2.
    nodes : shape (m,), s
    jump : shape (m, 3)
        Variance that enters position, velocity and attitude at a node (a gap of the IMU);
        re-acquisition adds to it.
    fix : shape (m,)
        Row of `gnss` at a node, -1 for none.
    layout : shape (4,)
        First columns of the slow error, barometer and wind (0 = none) and of no use.
    model : shape (2, n)
        Density of noise and correlation time, see `step_noise`.
    gnss
        Positions (lat, lon, h) and velocities (2, k, 3), covariances (2, k, 3, 3); NaN = none.
    aids : shape (m, 3, 2)
        Value and sigma of heading, height and airspeed at a node; NaN = none.
    arm : shape (3,), m
        IMU to antenna, body.
    options : shape (3,)
        Gate of three, gate of one degree of freedom, s of refusals before re-acquisition.
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
    prior_nav, prior_x, post_nav, post_x, packed, trans = out
    count, dynamic = len(nodes), trans.shape[2]
    kept = dynamic - 3
    A = np.zeros((9, dynamic))
    index = sample_before(imu, nodes[0])
    good, rate = np.full(2, nodes[0]), np.empty(3)
    for m in range(count):
        if m > 0:
            reset_transition(A)
            index = propagate(imu, index, nodes[m - 1], nodes[m], nav, x[:kept], A)
            trans[m - 1] = A
            dt = nodes[m] - nodes[m - 1]
            noise, phi_x = step_noise(model[0], model[1], dt)
            P = predicted(P, transition_matrix(A, dt, phi_x), noise)
            for i in range(len(phi_x)):
                x[i] *= phi_x[i]
            orthonormalise(nav[6:15].reshape(3, 3))
        for b in range(3):
            for i in range(3):
                P[3 * b + i, 3 * b + i] += jump[m, b]
        before_nav, before_x = nav.copy(), x.copy()
        chi[m, :2] = np.nan
        chi[m, 2:] = 0.0
        j = fix[m]
        if j >= 0:
            i = min(index, len(imu) - 2)
            u = (nodes[m] - imu[i, 0]) / (imu[i + 1, 0] - imu[i, 0])
            corrected_rate(imu[i, 1:4] + u * (imu[i + 1, 1:4] - imu[i, 1:4]), x, kept >= 15, rate)
            for block in range(2):
                if math.isnan(gnss[0][block, j, 0]):
                    continue
                late = nodes[m] - good[block] > options[2]
                if block == 0 and nodes[m] - good[1] <= options[2]:
                    # a filter whose velocity agrees cannot be far astray: the positions are
                    late = nodes[m] - good[0] > PATIENCE * options[2]
                z = (gnss[0][block, j], gnss[1][block, j])
                slow = layout[0] if block == 0 else -1
                nis, ll, added = _gnss_block(P, nav, x, z, arm, rate, slow, options[0], late)
                jump[m, block] += added
                chi[m, block] = nis
                chi[m, 2] += ll
                chi[m, 3] += 3.0
                if nis >= 0.0:
                    good[block] = nodes[m]
        for kind in range(3):
            if not math.isnan(aids[m, kind, 0]):
                _aid(P, nav, x, kind, aids[m, kind], layout, options[1])
        prior_nav[m], prior_x[m] = before_nav, before_x
        post_nav[m], post_x[m] = nav, x
        pack(P, packed[m])
        if not np.isfinite(nav[0] + nav[3] + nav[6] + P[6, 6]) or abs(nav[2]) > 1e5:
            return m
    return count
