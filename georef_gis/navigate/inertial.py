"""Strapdown mechanisation in the local level frame and the transition of its errors, compiled.

The state of a vehicle is ``nav``: lat, lon (rad), ellipsoidal height (m), velocity NED (m/s) and
nine numbers of `R_ned_from_body` by rows; beside it ``aux``: gyro bias (rad/s), accelerometer bias
(m/s2) and, where they are estimated, the nine numbers of the gyro's scale and misalignment M by
rows, with ``measured = (1 + M) true + bias``.

Its error is ``(dp_ned m, dv_ned m/s, phi_ned rad, d aux)`` with ``true = estimate + error`` and
``R_true = Exp(phi) R_est``.

Sources: Savage, Strapdown inertial navigation integration algorithm design, JGCD 21 (1998);
Groves, Principles of GNSS, inertial and multisensor integrated navigation systems (2013), ch. 5
and 14; gravity by Somigliana's formula (NGA.STND.0036) with the free-air term.
"""

from __future__ import annotations

import math

import numpy as np

from georef_gis.ellipsoid import WGS84_A, WGS84_E2
from georef_gis.frames import Array
from georef_gis.navigate.dense import compiled

# rad/s; NGA.STND.0036
EARTH_RATE = 7.292115e-5
# m/s2; normal gravity at the equator, and Somigliana's constant, NGA.STND.0036
GRAVITY_EQUATOR = 9.7803253359
SOMIGLIANA = 0.00193185265241
# numbers of `nav`
NAV = 15
# error states before the gyro's scale: position, velocity, attitude, two biases
BASIC = 15
# numbers of M
SCALE = 9


@compiled
def radii(lat: float) -> tuple[float, float]:
    """Radii of curvature along and across the meridian, m."""
    s = math.sin(lat)
    w = 1.0 - WGS84_E2 * s * s
    n = WGS84_A / math.sqrt(w)
    return n * (1.0 - WGS84_E2) / w, n


@compiled
def gravity(lat: float, height: float) -> float:
    """Normal gravity, m/s2, positive down."""
    s = math.sin(lat)
    s2 = s * s
    g = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - WGS84_E2 * s2)
    up = height / WGS84_A
    return g * (1.0 - 2.0 * up * (1.0 + 0.00335281 + 0.00344979 - 0.00670562 * s2) + 3.0 * up * up)


@compiled
def rotate(R: Array, x: float, y: float, z: float) -> None:
    """Replace R, nine numbers by rows, by R Exp(x, y, z); to the fourth order of the angle."""
    a2 = x * x + y * y + z * z
    s = 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0)
    c = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0)
    for i in range(0, 9, 3):
        r0, r1, r2 = R[i], R[i + 1], R[i + 2]
        # rows times the skew matrix, once and twice
        k0, k1, k2 = r1 * z - r2 * y, r2 * x - r0 * z, r0 * y - r1 * x
        R[i] = r0 + s * k0 + c * (k1 * z - k2 * y)
        R[i + 1] = r1 + s * k1 + c * (k2 * x - k0 * z)
        R[i + 2] = r2 + s * k2 + c * (k0 * y - k1 * x)


@compiled
def turn_left(R: Array, x: float, y: float, z: float) -> None:
    """Replace R, nine numbers by rows, by Exp(x, y, z) R, for any angle."""
    a = math.sqrt(x * x + y * y + z * z)
    if a < 1e-8:
        s, c = 1.0, 0.5
    else:
        s, c = math.sin(a) / a, (1.0 - math.cos(a)) / (a * a)
    for j in range(3):
        r0, r1, r2 = R[j], R[3 + j], R[6 + j]
        k0, k1, k2 = y * r2 - z * r1, z * r0 - x * r2, x * r1 - y * r0
        R[j] = r0 + s * k0 + c * (y * k2 - z * k1)
        R[3 + j] = r1 + s * k1 + c * (z * k0 - x * k2)
        R[6 + j] = r2 + s * k2 + c * (x * k1 - y * k0)


@compiled
def orthonormalise(R: Array) -> None:
    """One step of R, nine numbers by rows, towards the nearest rotation: R (3 - R'R) / 2."""
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(0, 9, 3):
        x, y, z = R[i], R[i + 1], R[i + 2]
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
    for i in range(0, 9, 3):
        x, y, z = R[i], R[i + 1], R[i + 2]
        R[i] = 1.5 * x - 0.5 * (x * xx + y * xy + z * xz)
        R[i + 1] = 1.5 * y - 0.5 * (x * xy + y * yy + z * yz)
        R[i + 2] = 1.5 * z - 0.5 * (x * xz + y * yz + z * zz)


@compiled
def turned(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """``R (x, y, z)`` of nine numbers by rows."""
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


@compiled
def corrected_rate(w: Array, aux: Array) -> tuple[float, float, float]:
    """True angular rate of a measured one, rad/s."""
    u0, u1, u2 = w[0] - aux[0], w[1] - aux[1], w[2] - aux[2]
    if len(aux) < 6 + SCALE:
        return u0, u1, u2
    # (1 + M)^-1 u to the second order
    m = aux[6:]
    a0, a1, a2 = turned(m, u0, u1, u2)
    b0, b1, b2 = turned(m, u0 - a0, u1 - a1, u2 - a2)
    return u0 - b0, u1 - b1, u2 - b2


@compiled
def advance(nav: Array, aux: Array, w: Array, f: Array, dt: float, A: Array) -> None:
    """Move a state by `dt` s with mean rate `w` and force `f` of the interval, in place.

    Parameters
    ----------
    nav, aux : shape (15,) and (6,) or (15,)
    w, f : shape (3,), as measured, rad/s and m/s2
    dt : s; negative goes back in time, exactly for the attitude
    A : shape (9, k)
        Transition since the last node of (dp, dv, phi) with respect to (phi, d aux), updated; no
        column = not wanted. That of dp to dv is time, those to dp and dv are identity.
    """
    rate = corrected_rate(w, aux)
    R = nav[6:]
    lat, h, vn, ve, vd = nav[0], nav[2], nav[3], nav[4], nav[5]
    rm, rn = radii(lat)
    rm, rn = rm + h, rn + h
    cos, sin = math.cos(lat), math.sin(lat)
    en, ee, ed = ve / rn, -vn / rm, -ve * sin / cos / rn
    wn, wd = EARTH_RATE * cos, -EARTH_RATE * sin
    turn = (-(wn + en) * dt, -ee * dt, -(wd + ed) * dt)

    half = 0.5 * dt
    x, y, z = half * rate[0], half * rate[1], half * rate[2]
    rotate(R, x, y, z)
    # the attitude in the middle of the interval turns the mean force
    an, ae, ad = turned(R, f[0] - aux[3], f[1] - aux[4], f[2] - aux[5])
    # half of the turn of the level frame belongs to the middle too
    hn, he, hd = 0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2]
    an, ae, ad = an + he * ad - hd * ae, ae + hd * an - hn * ad, ad + hn * ae - he * an
    _transition(A, R, rate, (an, ae, ad), turn, dt)
    rotate(R, x, y, z)
    turn_left(R, turn[0], turn[1], turn[2])

    # 2 w_ie + w_en
    on, oe, od = 2.0 * wn + en, ee, 2.0 * wd + ed
    nvn = vn + dt * (an - (oe * vd - od * ve))
    nve = ve + dt * (ae - (od * vn - on * vd))
    nvd = vd + dt * (ad + gravity(lat, h) - (on * ve - oe * vn))
    nav[0] = lat + half * (vn + nvn) / rm
    nav[1] += half * (ve + nve) / (rn * cos)
    nav[2] = h - half * (vd + nvd)
    nav[3], nav[4], nav[5] = nvn, nve, nvd


@compiled
def _transition(
    A: Array, c: Array, rate: tuple[float, float, float], force: tuple[float, float, float],
    turn: tuple[float, float, float], dt: float,
) -> None:  # fmt: skip
    """Transition of `advance` over an interval with attitude `c` in its middle, in place."""
    w0, w1, w2 = rate
    an, ae, ad = force
    tn, te, td = turn
    for j in range(A.shape[1]):
        # the axis of the body an error belongs to, and what it adds to rate (x s) and force
        i, w, b = j % 3, 0.0, 0.0
        if j >= 9:
            w = dt * (w0 if i == 0 else w1 if i == 1 else w2)
            i = (j - 9) // 3
        elif j >= 6:
            b = dt
        elif j >= 3:
            w = dt
        c0, c1, c2 = c[i], c[3 + i], c[6 + i]
        p0, p1, p2 = A[6, j], A[7, j], A[8, j]
        # phi' = phi x w_in - C dbg - C dM w
        t0 = te * p2 - td * p1 - w * c0
        t1 = td * p0 - tn * p2 - w * c1
        t2 = tn * p1 - te * p0 - w * c2
        # dv' = phi x f_n - C dba, with phi in the middle of the step
        m0, m1, m2 = p0 + 0.5 * t0, p1 + 0.5 * t1, p2 + 0.5 * t2
        d0 = dt * (m1 * ad - m2 * ae) - b * c0
        d1 = dt * (m2 * an - m0 * ad) - b * c1
        d2 = dt * (m0 * ae - m1 * an) - b * c2
        A[0, j] += dt * (A[3, j] + 0.5 * d0)
        A[1, j] += dt * (A[4, j] + 0.5 * d1)
        A[2, j] += dt * (A[5, j] + 0.5 * d2)
        A[3, j] += d0
        A[4, j] += d1
        A[5, j] += d2
        A[6, j] = p0 + t0
        A[7, j] = p1 + t1
        A[8, j] = p2 + t2


@compiled
def reset_transition(A: Array) -> None:
    """Identity: nothing has moved since the node."""
    for i in range(9):
        for j in range(A.shape[1]):
            A[i, j] = 1.0 if i == 6 + j else 0.0


@compiled
def sample_of(imu: Array, i: int, time: float, out: Array) -> None:
    """Rate and force (6,) at a time on the line from sample `i` to the next, into `out`."""
    u = (time - imu[i, 0]) / (imu[i + 1, 0] - imu[i, 0])
    for k in range(6):
        out[k] = imu[i, 1 + k] + u * (imu[i + 1, 1 + k] - imu[i, 1 + k])


@compiled
def propagate(
    imu: Array, index: int, start: float, end: float, nav: Array, aux: Array, A: Array
) -> int:
    """Move a state from one time to another through the samples between, in place.

    Parameters
    ----------
    imu : shape (n, 7)
        Time s, angular rate rad/s, specific force m/s2; linear between samples.
    index
        Of the last sample at or before `start`; a hint that may lie a little off.
    start, end : s; `end` may lie before `start`
    nav, aux, A : as of `advance`

    Returns
    -------
    int
        Index of the last sample at or before `end`.
    """
    last = len(imu) - 2
    i = min(max(index, 0), last)
    while i < last and imu[i + 1, 0] <= start:
        i += 1
    while i > 0 and imu[i, 0] > start:
        i -= 1
    now = start
    sample = np.empty(6)
    w, f = sample[:3], sample[3:]
    forward = end >= start
    while now != end:
        to = end
        if forward and i < last and imu[i + 1, 0] < end:
            to = imu[i + 1, 0]
        elif not forward and i > 0 and imu[i, 0] > end:
            to = imu[i, 0]
        # the mean of a line over an interval is its value in the middle; it ends with the log
        sample_of(imu, i, min(max(0.5 * (now + to), imu[i, 0]), imu[i + 1, 0]), sample)
        if to != now:
            advance(nav, aux, w, f, to - now, A)
        now = to
        if forward and i < last and now >= imu[i + 1, 0]:
            i += 1
        elif not forward and now <= imu[i, 0] and i > 0:
            i -= 1
    return i


def nav_of(p_geo: Array, v_ned: Array, R_ned_from_body: Array) -> Array:
    """State vector of position (lat, lon, h), velocity and attitude; shape (15,)."""
    return np.concatenate([p_geo, v_ned, R_ned_from_body.ravel()]).astype(np.float64)
