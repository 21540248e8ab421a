"""Map projections by the closed formulas of the textbooks, for comparison only; no PROJ in it.

Snyder, "Map Projections: A Working Manual", USGS Professional Paper 1395 (1987), eqs. 15-1 to
15-11 (Lambert conformal conic); Krueger, "Konforme Abbildung des Erdellipsoids in der Ebene"
(1912), in the series of Karney, "Transverse Mercator with an accuracy of a few nanometers",
J. Geodesy 85 (2011), eqs. 7 to 9 and 35, to the fourth order: under a micrometre within a zone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

US_FOOT = 1200.0 / 3937.0
FOOT = 0.3048


def dms(degrees: float, minutes: float = 0.0, seconds: float = 0.0) -> float:
    """Angle in rad from sexagesimal degrees, the sign being that of the degrees."""
    sign = math.copysign(1.0, degrees)
    return sign * math.radians(abs(degrees) + minutes / 60.0 + seconds / 3600.0)


@dataclass(frozen=True)
class Ellipsoid:
    """Semi-major axis, m, and inverse flattening."""

    a: float
    inverse_f: float

    @property
    def e2(self) -> float:
        f = 1.0 / self.inverse_f
        return f * (2.0 - f)


GRS80 = Ellipsoid(6378137.0, 298.257222101)
# Clarke 1866 by its two axes, Airy 1830
CLARKE = Ellipsoid(6378206.4, 6378206.4 / (6378206.4 - 6356583.8))
AIRY = Ellipsoid(6377563.396, 299.32496)


def _t(ellipsoid: Ellipsoid, lat: float) -> float:
    e = math.sqrt(ellipsoid.e2)
    s = e * math.sin(lat)
    return math.tan(math.pi / 4 - lat / 2) / ((1 - s) / (1 + s)) ** (e / 2)


def _m(ellipsoid: Ellipsoid, lat: float) -> float:
    return math.cos(lat) / math.sqrt(1 - ellipsoid.e2 * math.sin(lat) ** 2)


@dataclass(frozen=True)
class Lambert:
    """Lambert conformal conic with two standard parallels; rad and m."""

    south: float
    north: float
    lat0: float
    lon0: float
    false_easting: float
    false_northing: float = 0.0
    ellipsoid: Ellipsoid = GRS80

    def _cone(self) -> tuple[float, float]:
        m1, m2 = (_m(self.ellipsoid, lat) for lat in (self.south, self.north))
        t1, t2 = (_t(self.ellipsoid, lat) for lat in (self.south, self.north))
        n = math.log(m1 / m2) / math.log(t1 / t2)
        return n, m1 / (n * t1**n)

    def forward(self, lat: float, lon: float) -> tuple[float, float]:
        n, F = self._cone()
        rho = self.ellipsoid.a * F * _t(self.ellipsoid, lat) ** n
        rho0 = self.ellipsoid.a * F * _t(self.ellipsoid, self.lat0) ** n
        theta = n * (lon - self.lon0)
        return (
            self.false_easting + rho * math.sin(theta),
            self.false_northing + rho0 - rho * math.cos(theta),
        )

    def scale(self, lat: float) -> float:
        n, F = self._cone()
        return F * n * _t(self.ellipsoid, lat) ** n / _m(self.ellipsoid, lat)


@dataclass(frozen=True)
class Mercator:
    """Transverse Mercator; rad and m."""

    k0: float
    lat0: float
    lon0: float
    false_easting: float
    false_northing: float = 0.0
    ellipsoid: Ellipsoid = GRS80

    def _series(self, lat: float, lon: float) -> tuple[float, float]:
        """Easting and northing from the equator and the central meridian, before k0, m."""
        f = 1.0 / self.ellipsoid.inverse_f
        n = f / (2.0 - f)
        A = self.ellipsoid.a / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
        alpha = (
            n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16 + 41 * n**4 / 180,
            13 * n**2 / 48 - 3 * n**3 / 5 + 557 * n**4 / 1440,
            61 * n**3 / 240 - 103 * n**4 / 140,
            49561 * n**4 / 161280,
        )
        e = math.sqrt(self.ellipsoid.e2)
        tau = math.sinh(math.atanh(math.sin(lat)) - e * math.atanh(e * math.sin(lat)))
        away = lon - self.lon0
        xi = math.atan2(tau, math.cos(away))
        eta = math.asinh(math.sin(away) / math.hypot(tau, math.cos(away)))
        x = eta + sum(
            c * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, c in enumerate(alpha, 1)
        )
        y = xi + sum(
            c * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, c in enumerate(alpha, 1)
        )
        return A * x, A * y

    def forward(self, lat: float, lon: float) -> tuple[float, float]:
        x, y = self._series(lat, lon)
        _, y0 = self._series(self.lat0, self.lon0)
        return (
            self.false_easting + self.k0 * x,
            self.false_northing + self.k0 * (y - y0),
        )


# NOAA Manual NOS NGS 5, "State Plane Coordinate System of 1983" (1989), appendix A: constants of
# the zones, in metres; FE of zones legislated in feet as their laws have it.
ZONES: dict[str, Lambert | Mercator] = {
    "Ohio North": Lambert(dms(40, 26), dms(41, 42), dms(39, 40), dms(-82, 30), 600_000.0),
    "Ohio South": Lambert(dms(38, 44), dms(40, 2), dms(38), dms(-82, 30), 600_000.0),
    "Iowa North": Lambert(
        dms(42, 4), dms(43, 16), dms(41, 30), dms(-93, 30), 1_500_000.0, 1_000_000.0
    ),
    "Texas Central": Lambert(
        dms(30, 7), dms(31, 53), dms(29, 40), dms(-100, 20), 700_000.0, 3_000_000.0
    ),
    "South Carolina": Lambert(dms(32, 30), dms(34, 50), dms(31, 50), dms(-81), 609_600.0),
    "Michigan South": Lambert(dms(42, 6), dms(43, 40), dms(41, 30), dms(-84, 22), 4_000_000.0),
    "New Jersey": Mercator(1 - 1 / 10_000, dms(38, 50), dms(-74, 30), 150_000.0),
    "Illinois East": Mercator(1 - 1 / 40_000, dms(36, 40), dms(-88, 20), 300_000.0),
    "Arizona Central": Mercator(1 - 1 / 10_000, dms(31), dms(-111, 55), 213_360.0),
}
