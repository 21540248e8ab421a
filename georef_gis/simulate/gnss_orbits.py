"""GPS satellites of a plausible constellation: orbit and clock from broadcast elements.

The orbit is IS-GPS-200, table 20-IV, written here for itself: what is tested against it has its
own lines for the same document.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.units import GPS_WEEK

Array = NDArray[np.float64]

MU = 3.986005e14  # m3/s2; IS-GPS-200, 20.3.3.4.3
EARTH_RATE = 7.2921151467e-5  # rad/s; IS-GPS-200, 20.3.3.4.3
LIGHT = 299792458.0  # m/s; IS-GPS-200, 20.3.4.3
RELATIVITY = -4.442807633e-10  # s/m^0.5; IS-GPS-200, 20.3.3.3.3.1
TOE_STEP = 7200.0  # s between data sets; IS-GPS-200, table 20-XIII

# deg; nodes of planes A to F and slots in them at 1993-07-01, GPS SPS performance standard (2008)
# table 3.2-1; the fifth slot of each plane is our own, as some thirty satellites fly.
NODES = (272.847, 332.847, 32.847, 92.847, 152.847, 212.847)
SLOTS = (
    (268.126, 161.786, 11.676, 41.806, 215.0),
    (80.956, 173.336, 309.976, 204.376, 20.0),
    (111.876, 11.796, 339.666, 241.556, 175.0),
    (135.226, 265.446, 35.156, 167.356, 320.0),
    (197.046, 302.596, 66.066, 333.686, 130.0),
    (238.886, 345.226, 105.206, 135.346, 45.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ephemeris:
    """Broadcast elements of one satellite, names and units of IS-GPS-200 in rad, m and s."""

    prn: int
    # s on the GPS scale since 1980; also the time of the clock's terms
    toe: float
    sqrt_a: float
    e: float
    i0: float
    omega0: float
    omega: float
    m0: float
    delta_n: float = 0.0
    omega_dot: float = 0.0
    idot: float = 0.0
    cuc: float = 0.0
    cus: float = 0.0
    crc: float = 0.0
    crs: float = 0.0
    cic: float = 0.0
    cis: float = 0.0
    af0: float = 0.0
    af1: float = 0.0
    af2: float = 0.0
    tgd: float = 0.0
    iode: int = 0

    @property
    def week(self) -> int:
        """GPS week of the elements, not rolled over."""
        return math.floor(self.toe / GPS_WEEK)

    @property
    def toe_tow(self) -> float:
        """Seconds of the week of the elements."""
        return self.toe - self.week * GPS_WEEK


def constellation(time_gps: float, *, seed: int = 0) -> tuple[Ephemeris, ...]:
    """Thirty satellites with elements for a time, s on the GPS scale since 1980.

    The small terms (eccentricity, harmonics, clocks) are drawn from `seed` in the sizes that
    broadcast messages show.
    """
    rng = np.random.default_rng([seed, 77])
    toe = round(time_gps / TOE_STEP) * TOE_STEP
    week_start = math.floor(toe / GPS_WEEK) * GPS_WEEK
    out: list[Ephemeris] = []
    for plane, slots in enumerate(SLOTS):
        for slot in slots:
            out.append(_drawn(len(out) + 1, toe, week_start, (NODES[plane], slot), rng))
    return tuple(out)


def _drawn(
    prn: int, toe: float, week_start: float, place: tuple[float, float], rng: np.random.Generator
) -> Ephemeris:
    omega_dot = -8.2e-9 + 3e-10 * rng.normal()
    omega = rng.uniform(-math.pi, math.pi)
    # The node is given against Greenwich at the start of the week (a rough sidereal time does).
    sidereal = (week_start - 425520000.0) * EARTH_RATE + math.radians(280.0)
    turn = math.radians(place[1]) + 2.0 * math.pi * (toe - week_start) / 43082.0
    return Ephemeris(
        prn=prn, toe=toe, sqrt_a=5153.65 + 0.05 * rng.normal(), e=abs(rng.normal(0.006, 0.004)),
        i0=math.radians(55.0 + 0.6 * rng.normal()),
        omega0=_wrap(math.radians(place[0]) - sidereal), omega=omega, m0=_wrap(turn - omega),
        delta_n=4.5e-9 + 3e-10 * rng.normal(), omega_dot=omega_dot, idot=2e-10 * rng.normal(),
        cuc=3e-6 * rng.normal(), cus=6e-6 * rng.normal(), crc=200.0 + 60.0 * rng.normal(),
        crs=60.0 * rng.normal(), cic=8e-8 * rng.normal(), cis=8e-8 * rng.normal(),
        af0=2e-4 * rng.normal(), af1=3e-12 * rng.normal(), tgd=-5e-9 + 4e-9 * rng.normal(),
        iode=20 + prn,
    )  # fmt: skip


def _wrap(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def with_broadcast_error(truth: Ephemeris, rng: np.random.Generator, sigma: float) -> Ephemeris:
    """Elements off by `sigma` m along the track, across it and in the clock (each one sigma)."""
    along, across, clock = sigma * rng.normal(size=3)
    radius = truth.sqrt_a**2
    return replace(
        truth,
        m0=truth.m0 + along / radius,
        i0=truth.i0 + across / radius,
        af0=truth.af0 + clock / LIGHT,
    )


def satellite_position(eph: Ephemeris, since_toe: Array) -> tuple[Array, Array]:
    """ECEF at the time itself (n, 3), m, and clock against GPS time (n,), s; time from toe, s.

    The clock is that of the ionosphere-free pair of signals: the group delay is not in it.
    """
    t = np.asarray(since_toe, dtype=np.float64)
    a = eph.sqrt_a**2
    mean = eph.m0 + (math.sqrt(MU / a**3) + eph.delta_n) * t
    ecc = mean
    for _ in range(12):
        ecc = ecc - (ecc - eph.e * np.sin(ecc) - mean) / (1.0 - eph.e * np.cos(ecc))
    true = np.arctan2(math.sqrt(1.0 - eph.e**2) * np.sin(ecc), np.cos(ecc) - eph.e)
    phi = true + eph.omega
    s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u = phi + eph.cus * s2 + eph.cuc * c2
    r = a * (1.0 - eph.e * np.cos(ecc)) + eph.crs * s2 + eph.crc * c2
    i = eph.i0 + eph.idot * t + eph.cis * s2 + eph.cic * c2
    node = eph.omega0 + (eph.omega_dot - EARTH_RATE) * t - EARTH_RATE * eph.toe_tow
    x, y = r * np.cos(u), r * np.sin(u)
    p = np.stack(
        [
            x * np.cos(node) - y * np.cos(i) * np.sin(node),
            x * np.sin(node) + y * np.cos(i) * np.cos(node),
            y * np.sin(i),
        ],
        axis=-1,
    )
    clock = eph.af0 + eph.af1 * t + eph.af2 * t**2
    return p, clock + RELATIVITY * eph.e * eph.sqrt_a * np.sin(ecc)
