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
    w = 1.0 - WGS84_E2 * math.sin(lat) ** 2
    n = WGS84_A / math.sqrt(w)
    return n * (1.0 - WGS84_E2) / w, n


@compiled
def gravity(lat: float, height: float) -> float:
    """Normal gravity, m/s2, positive down."""
    s2 = math.sin(lat) ** 2
    g = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * s2) / math.sqrt(1.0 - WGS84_E2 * s2)
    return g * (1.0 - 2.0 * height / WGS84_A * (1.0 + 0.00335281 + 0.00344979 - 0.00670562 * s2)
                + 3.0 * (height / WGS84_A) ** 2)  # fmt: skip


@compiled
def rotate(R: Array, vector: Array) -> None:
    """Replace R by R Exp(vector), in place; to the fourth order of the angle."""
    x, y, z = vector[0], vector[1], vector[2]
    a2 = x * x + y * y + z * z
    s = 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0)
    c = 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0)
    for i in range(3):
        r0, r1, r2 = R[i, 0], R[i, 1], R[i, 2]
        # rows times the skew matrix, once and twice
        k0, k1, k2 = r1 * z - r2 * y, r2 * x - r0 * z, r0 * y - r1 * x
        R[i, 0] = r0 + s * k0 + c * (k1 * z - k2 * y)
        R[i, 1] = r1 + s * k1 + c * (k2 * x - k0 * z)
        R[i, 2] = r2 + s * k2 + c * (k0 * y - k1 * x)


@compiled
def turn_left(R: Array, vector: Array) -> None:
    """Replace R by Exp(vector) R, in place, for any angle."""
    x, y, z = vector[0], vector[1], vector[2]
    a = math.sqrt(x * x + y * y + z * z)
    if a < 1e-8:
        s, c = 1.0, 0.5
    else:
        s, c = math.sin(a) / a, (1.0 - math.cos(a)) / (a * a)
    for j in range(3):
        r0, r1, r2 = R[0, j], R[1, j], R[2, j]
        k0, k1, k2 = y * r2 - z * r1, z * r0 - x * r2, x * r1 - y * r0
        R[0, j] = r0 + s * k0 + c * (y * k2 - z * k1)
        R[1, j] = r1 + s * k1 + c * (z * k0 - x * k2)
        R[2, j] = r2 + s * k2 + c * (x * k1 - y * k0)


@compiled
def orthonormalise(R: Array) -> None:
    """One step towards the nearest rotation, in place: R (3 - R'R) / 2."""
    old = R.copy()
    for i in range(3):
        for j in range(3):
            R[i, j] = 1.5 * old[i, j]
            for k in range(3):
                g = old[0, k] * old[0, j] + old[1, k] * old[1, j] + old[2, k] * old[2, j]
                R[i, j] -= 0.5 * old[i, k] * g


@compiled
def corrected_rate(w: Array, aux: Array, scaled: bool, out: Array) -> None:
    """True angular rate of a measured one, rad/s."""
    for i in range(3):
        out[i] = w[i] - aux[i]
    if scaled:
        u0, u1, u2 = out[0], out[1], out[2]
        m = aux[6 : 6 + SCALE]
        # (1 + M)^-1 u to the second order
        a0 = u0 - (m[0] * u0 + m[1] * u1 + m[2] * u2)
        a1 = u1 - (m[3] * u0 + m[4] * u1 + m[5] * u2)
        a2 = u2 - (m[6] * u0 + m[7] * u1 + m[8] * u2)
        out[0] = u0 - (m[0] * a0 + m[1] * a1 + m[2] * a2)
        out[1] = u1 - (m[3] * a0 + m[4] * a1 + m[5] * a2)
        out[2] = u2 - (m[6] * a0 + m[7] * a1 + m[8] * a2)


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
    scaled = len(aux) >= 6 + SCALE
    rate = np.empty(3)
    corrected_rate(w, aux, scaled, rate)
    f0, f1, f2 = f[0] - aux[3], f[1] - aux[4], f[2] - aux[5]
    R = nav[6:15].reshape(3, 3)
    lat, h = nav[0], nav[2]
    vn, ve, vd = nav[3], nav[4], nav[5]
    rm, rn = radii(lat)
    cos, sin = math.cos(lat), math.sin(lat)
    en, ee, ed = ve / (rn + h), -vn / (rm + h), -ve * math.tan(lat) / (rn + h)
    wn, wd = EARTH_RATE * cos, -EARTH_RATE * sin

    half = 0.5 * dt * rate
    rotate(R, half)
    # the attitude in the middle of the interval turns the mean force
    c = R.copy()
    rotate(R, half)
    earth = np.array([-(wn + en) * dt, -ee * dt, -(wd + ed) * dt])
    turn_left(R, earth)

    an = c[0, 0] * f0 + c[0, 1] * f1 + c[0, 2] * f2
    ae = c[1, 0] * f0 + c[1, 1] * f1 + c[1, 2] * f2
    ad = c[2, 0] * f0 + c[2, 1] * f1 + c[2, 2] * f2
    # half of the turn of the level frame belongs to the middle too
    hn, he, hd = 0.5 * earth[0], 0.5 * earth[1], 0.5 * earth[2]
    an, ae, ad = an + he * ad - hd * ae, ae + hd * an - hn * ad, ad + hn * ae - he * an
    # 2 w_ie + w_en
    on, oe, od = 2.0 * wn + en, ee, 2.0 * wd + ed
    nvn = vn + dt * (an - (oe * vd - od * ve))
    nve = ve + dt * (ae - (od * vn - on * vd))
    nvd = vd + dt * (ad + gravity(lat, h) - (on * ve - oe * vn))
    nav[0] = lat + 0.5 * dt * (vn + nvn) / (rm + h)
    nav[1] += 0.5 * dt * (ve + nve) / ((rn + h) * cos)
    nav[2] = h - 0.5 * dt * (vd + nvd)
    nav[3], nav[4], nav[5] = nvn, nve, nvd
    if A.shape[1] > 0:
        _transition(A, c, rate, (an, ae, ad), earth, dt)


@compiled
def _transition(
    A: Array, c: Array, rate: Array, force: tuple[float, float, float], earth: Array, dt: float
) -> None:
    an, ae, ad = force
    for j in range(A.shape[1]):
        p0, p1, p2 = A[6, j], A[7, j], A[8, j]
        # phi' = phi x w_in - C dbg - C dM w
        t0 = earth[1] * p2 - earth[2] * p1
        t1 = earth[2] * p0 - earth[0] * p2
        t2 = earth[0] * p1 - earth[1] * p0
        if j >= 9 or 3 <= j < 6:
            i, w = (j - 3, 1.0) if j < 6 else ((j - 9) // 3, rate[(j - 9) % 3])
            t0 -= dt * c[0, i] * w
            t1 -= dt * c[1, i] * w
            t2 -= dt * c[2, i] * w
        # dv' = phi x f_n - C dba, with phi in the middle of the step
        m0, m1, m2 = p0 + 0.5 * t0, p1 + 0.5 * t1, p2 + 0.5 * t2
        d0 = dt * (m1 * ad - m2 * ae)
        d1 = dt * (m2 * an - m0 * ad)
        d2 = dt * (m0 * ae - m1 * an)
        if 6 <= j < 9:
            d0 -= dt * c[0, j - 6]
            d1 -= dt * c[1, j - 6]
            d2 -= dt * c[2, j - 6]
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
    A[:, :] = 0.0
    for i in range(min(3, A.shape[1])):
        A[6 + i, i] = 1.0


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
    w, f = np.empty(3), np.empty(3)
    forward = end >= start
    while now != end:
        if forward:
            stop = imu[i + 1, 0] if i < last else end
            to = min(stop, end)
        else:
            stop = imu[i, 0] if i > 0 else end
            to = max(stop, end)
        width = imu[i + 1, 0] - imu[i, 0]
        # the mean of a line over an interval is its value in the middle
        u = (0.5 * (now + to) - imu[i, 0]) / width
        u = min(max(u, 0.0), 1.0)
        for k in range(3):
            w[k] = imu[i, 1 + k] + u * (imu[i + 1, 1 + k] - imu[i, 1 + k])
            f[k] = imu[i, 4 + k] + u * (imu[i + 1, 4 + k] - imu[i, 4 + k])
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
