"""The WGS 84 ellipsoid: geodetic and earth-centred coordinates, the project's topocentric frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array, R_ecef_from_enu

# m; WGS 84 semi-major axis (NGA.STND.0036)
WGS84_A = 6378137.0
WGS84_F = 1.0 / 298.257223563
WGS84_E2 = WGS84_F * (2.0 - WGS84_F)


def prime_vertical_radius(lat: ArrayLike) -> Array:
    """Radius of curvature across the meridian, N, m; lat in rad."""
    return np.asarray(WGS84_A / np.sqrt(1.0 - WGS84_E2 * np.sin(np.asarray(lat, float)) ** 2))


def meridian_radius(lat: ArrayLike) -> Array:
    """Radius of curvature along the meridian, M, m; lat in rad."""
    n = prime_vertical_radius(lat)
    return np.asarray(n**3 * (1.0 - WGS84_E2) / WGS84_A**2)


def ecef_from_geo(p_geo: ArrayLike) -> Array:
    """Ecef m from (lat rad, lon rad, ellipsoidal height m); shape (..., 3)."""
    p = np.asarray(p_geo, dtype=np.float64)
    lat, lon, h = p[..., 0], p[..., 1], p[..., 2]
    n = prime_vertical_radius(lat)
    r = (n + h) * np.cos(lat)
    z = (n * (1.0 - WGS84_E2) + h) * np.sin(lat)
    return np.stack([r * np.cos(lon), r * np.sin(lon), z], axis=-1)


def geo_from_ecef(p_ecef: ArrayLike) -> Array:
    """(lat rad, lon rad, ellipsoidal height m) from ecef m; shape (..., 3).

    Notes
    -----
    Bowring (1985), three iterations: below 1e-9 m from -10 to +100 km of height.
    """
    p = np.asarray(p_ecef, dtype=np.float64)
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    b = WGS84_A * (1.0 - WGS84_F)
    ep2 = WGS84_E2 / (1.0 - WGS84_E2)
    r = np.hypot(x, y)
    beta = np.arctan2(z * WGS84_A, r * b)
    lat = beta
    for _ in range(3):
        lat = np.arctan2(
            z + ep2 * b * np.sin(beta) ** 3, r - WGS84_E2 * WGS84_A * np.cos(beta) ** 3
        )
        beta = np.arctan2((1.0 - WGS84_F) * np.sin(lat), np.cos(lat))
    s, c = np.sin(lat), np.cos(lat)
    # Projection on the normal: well conditioned at the equator and at the poles.
    h = r * c + z * s - WGS84_A * np.sqrt(1.0 - WGS84_E2 * s**2)
    return np.stack([lat, np.arctan2(y, x), h], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Origin of the project's topocentric frame: lat, lon in rad, ellipsoidal height in m."""

    lat: float
    lon: float
    height_ellipsoidal: float

    def __post_init__(self) -> None:
        """Refuse degrees given for radians."""
        if not (abs(self.lat) <= math.pi / 2 and abs(self.lon) <= 2 * math.pi):
            raise ValueError(f"origin ({self.lat}, {self.lon}) is not in radians")

    @property
    def p_ecef(self) -> Array:
        """The origin in ecef, m; shape (3,)."""
        return ecef_from_geo([self.lat, self.lon, self.height_ellipsoidal])

    @property
    def R_ecef_from_enu(self) -> Array:
        """Axes of the frame in ecef; shape (3, 3)."""
        return R_ecef_from_enu(self.lat, self.lon)

    def enu_from_ecef(self, p_ecef: ArrayLike) -> Array:
        """Enu m from ecef m; shape (..., 3)."""
        return np.asarray((np.asarray(p_ecef, float) - self.p_ecef) @ self.R_ecef_from_enu)

    def ecef_from_enu(self, p_enu: ArrayLike) -> Array:
        """Ecef m from enu m; shape (..., 3)."""
        return np.asarray(np.asarray(p_enu, float) @ self.R_ecef_from_enu.T + self.p_ecef)

    def enu_from_geo(self, p_geo: ArrayLike) -> Array:
        """Enu m from (lat, lon rad, ellipsoidal height m); shape (..., 3)."""
        return self.enu_from_ecef(ecef_from_geo(p_geo))

    def geo_from_enu(self, p_enu: ArrayLike) -> Array:
        """(lat, lon rad, ellipsoidal height m) from enu m; shape (..., 3)."""
        return geo_from_ecef(self.ecef_from_enu(p_enu))
