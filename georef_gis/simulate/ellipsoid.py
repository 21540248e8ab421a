"""The simulator's own lines for the ellipsoid: ECEF, NED, gravity and two map projections.

Written apart from `frames` and `geodesy` on purpose: a sign slip in a shared line would cancel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from georef_gis.units import US_SURVEY_FOOT

Array = NDArray[np.float64]

SEMI_MAJOR = 6378137.0  # m; NIMA TR8350.2
FLATTENING = 1.0 / 298.257223563  # NIMA TR8350.2
FLATTENING_GRS80 = 1.0 / 298.257222101  # Moritz (1980)
E2 = FLATTENING * (2.0 - FLATTENING)
EARTH_RATE = 7.292115e-5  # rad/s; NIMA TR8350.2
GRAVITY_EQUATOR = 9.7803253359  # m/s2; NIMA TR8350.2
SOMIGLIANA_K = 0.00193185265241  # NIMA TR8350.2
GM = 3.986004418e14  # m3/s2; NIMA TR8350.2


def ecef_from_geodetic(lat: Array, lon: Array, h: Array) -> Array:
    """ECEF of geodetic latitude, longitude (rad) and ellipsoidal height (m), shape (..., 3), m."""
    lat, lon, h = np.asarray(lat), np.asarray(lon), np.asarray(h)
    n = SEMI_MAJOR / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    x = (n + h) * np.cos(lat) * np.cos(lon)
    y = (n + h) * np.cos(lat) * np.sin(lon)
    z = (n * (1.0 - E2) + h) * np.sin(lat)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(np.float64)


def geodetic_from_ecef(p_ecef: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude (rad) and ellipsoidal height (m) of ECEF points, shape (...,) each.

    Notes
    -----
    Bowring (1976) with three turns; below a nanometre near the surface, away from the poles.
    """
    x, y, z = np.moveaxis(np.asarray(p_ecef, dtype=np.float64), -1, 0)
    p = np.hypot(x, y)
    b = SEMI_MAJOR * (1.0 - FLATTENING)
    beta = np.arctan2(z * SEMI_MAJOR, p * b)
    lat = beta
    for _ in range(3):
        lat = np.arctan2(
            z + E2 / (1.0 - E2) * b * np.sin(beta) ** 3,
            p - E2 * SEMI_MAJOR * np.cos(beta) ** 3,
        )
        beta = np.arctan((1.0 - FLATTENING) * np.tan(lat))
    n = SEMI_MAJOR / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    h = p * np.cos(lat) + z * np.sin(lat) - SEMI_MAJOR**2 / n
    return lat, np.arctan2(y, x), h


def rotation_ecef_from_enu(lat: Array, lon: Array) -> Array:
    """Columns east, north, up in ECEF at latitude, longitude (rad), shape (..., 3, 3)."""
    sa, ca, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(sa)
    east = np.stack([-so, co, zero], axis=-1)
    north = np.stack([-sa * co, -sa * so, ca], axis=-1)
    up = np.stack([ca * co, ca * so, sa], axis=-1)
    return np.asarray(np.stack([east, north, up], axis=-1))


def rotation_ecef_from_ned(lat: Array, lon: Array) -> Array:
    """Columns north, east, down in ECEF at latitude, longitude (rad), shape (..., 3, 3)."""
    enu = rotation_ecef_from_enu(lat, lon)
    return np.stack([enu[..., 1], enu[..., 0], -enu[..., 2]], axis=-1)


def radii(lat: Array) -> tuple[Array, Array]:
    """Radii of curvature in the meridian and the prime vertical, m."""
    w2 = 1.0 - E2 * np.sin(lat) ** 2
    return SEMI_MAJOR * (1.0 - E2) / w2**1.5, SEMI_MAJOR / np.sqrt(w2)


def gravity(lat: Array, h: Array) -> Array:
    """Magnitude of normal gravity at latitude (rad) and height (m), m/s2; NIMA TR8350.2 eq. 4-3."""
    s2 = np.sin(lat) ** 2
    surface = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / np.sqrt(1.0 - E2 * s2)
    m = EARTH_RATE**2 * SEMI_MAJOR**3 * (1.0 - FLATTENING) / GM
    linear = 2.0 / SEMI_MAJOR * (1.0 + FLATTENING + m - 2.0 * FLATTENING * s2) * h
    return np.asarray(surface * (1.0 - linear + 3.0 * h**2 / SEMI_MAJOR**2))


def _clenshaw_free_tm(lat: Array, dlon: Array) -> tuple[Array, Array, float]:
    """Krüger's northing and easting over the rectifying radius, and that radius, m."""
    n = FLATTENING / (2.0 - FLATTENING)
    radius = SEMI_MAJOR / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alpha = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16,
        13 * n**2 / 48 - 3 * n**3 / 5,
        61 * n**3 / 240,
    )
    e = math.sqrt(E2)
    tau = np.sinh(np.arctanh(np.sin(lat)) - e * np.arctanh(e * np.sin(lat)))
    xi = np.arctan2(tau, np.cos(dlon))
    eta = np.arcsinh(np.sin(dlon) / np.hypot(tau, np.cos(dlon)))
    north, east = xi.copy(), eta.copy()
    for k, a in enumerate(alpha, start=1):
        north = north + a * np.sin(2 * k * xi) * np.cosh(2 * k * eta)
        east = east + a * np.cos(2 * k * xi) * np.sinh(2 * k * eta)
    return north, east, radius


def utm17_from_geodetic(lat: Array, lon: Array) -> Array:
    """Easting and northing in UTM zone 17 N (EPSG:32617), shape (..., 2), m; lat, lon in rad."""
    dlon = np.asarray(lon) - math.radians(-81.0)
    north, east, radius = _clenshaw_free_tm(np.asarray(lat), dlon)
    return np.stack([500000.0 + 0.9996 * radius * east, 0.9996 * radius * north], axis=-1)


def _isometric(lat: Array, e: float) -> Array:
    """Snyder's t, eq. 15-9."""
    s = np.sin(lat)
    return np.asarray(np.tan(np.pi / 4 - lat / 2) / ((1 - e * s) / (1 + e * s)) ** (e / 2))


def state_plane_from_geodetic(lat: Array, lon: Array) -> Array:
    """Easting and northing in West Virginia North (EPSG:6601), shape (..., 2), US survey feet.

    Notes
    -----
    Lambert conformal conic with two parallels, Snyder (1987) eqs. 15-1 to 15-8, on GRS 80.
    """
    e = math.sqrt(FLATTENING_GRS80 * (2.0 - FLATTENING_GRS80))
    phi0, phi1, phi2 = (np.radians(d) for d in (38.5, 40.25, 39.0))
    m1, m2 = (np.cos(p) / np.sqrt(1 - (e * np.sin(p)) ** 2) for p in (phi1, phi2))
    t0, t1, t2 = (_isometric(np.asarray(p), e) for p in (phi0, phi1, phi2))
    n = np.log(m1 / m2) / np.log(t1 / t2)
    big_f = m1 / (n * t1**n)
    rho0 = SEMI_MAJOR * big_f * t0**n
    rho = SEMI_MAJOR * big_f * _isometric(np.asarray(lat), e) ** n
    theta = n * (np.asarray(lon) - math.radians(-79.5))
    east, north = rho * np.sin(theta), rho0 - rho * np.cos(theta)
    feet = np.stack([east, north], axis=-1) / US_SURVEY_FOOT
    return np.asarray(feet + np.array([1968500.0, 0.0]))
