"""Raw GPS measurements of an antenna with known path: code, carrier phase and Doppler.

Orbits, light time, the turn of the Earth, clocks and the atmosphere are written here for
themselves, so that a carrier-phase solution can be judged against a truth it shares no line with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import ellipsoid
from georef_gis.simulate.gnss_orbits import EARTH_RATE, LIGHT, Ephemeris, satellite_position

Array = NDArray[np.float64]
# Antenna in ECEF, (n, 3) m, at times, s since the start.
Track = Callable[[Array], Array]

FREQUENCIES = (1575.42e6, 1227.60e6)  # Hz, L1 and L2; IS-GPS-200, 3.3.1.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Slip:
    """A loss of lock: from a time on, s, a satellite's phase is off by whole cycles."""

    prn: int
    time: float
    cycles: int
    band: int = 0
    # Whether the receiver notices and sets the loss-of-lock flag.
    flagged: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class RawSettings:
    """Errors of a receiver and of the air; sigmas in m unless said.

    Multipath is Gauss-Markov, with `multipath_tau` s; it is what a real antenna adds, and what a
    solver that takes its measurements for white does not expect.
    """

    bands: int = 1
    elevation_mask_deg: float = 10.0
    code_noise: float = 0.4
    phase_noise: float = 0.003
    doppler_noise_hz: float = 0.1
    code_multipath: float = 0.4
    phase_multipath: float = 0.002
    multipath_tau: float = 60.0
    # s and s/s; the receiver's clock against GPS time
    clock_offset: float = 1.5e-4
    clock_drift: float = 4e-8
    # m at the zenith
    wet_delay: float = 0.12
    ionosphere: float = 3.0
    # m at the zenith per m to the north: what a baseline sees of the ionosphere
    ionosphere_gradient: float = 1e-6
    slips: Sequence[Slip] = field(default_factory=tuple)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawLog:
    """Measurements of one receiver; n epochs, s satellites, b bands; NaN where not tracked.

    Parameters
    ----------
    start_gps
        s on the GPS scale since 1980 at time 0.
    tag
        Time as the receiver's clock shows it, s since the start, shape (n,).
    time
        True time of reception, s since the start, shape (n,).
    p_ecef
        True place of the antenna at `time`, shape (n, 3), m.
    code, phase, doppler
        m, cycles, Hz (positive when coming nearer), shape (n, s, b).
    lost
        Whether the loss-of-lock flag is set, shape (n, s, b).
    cn0 : dB-Hz, shape (n, s, b)
    """

    start_gps: float
    tag: Array
    time: Array
    prns: tuple[int, ...]
    p_ecef: Array
    code: Array
    phase: Array
    doppler: Array
    lost: NDArray[np.bool_]
    cn0: Array


def simulate_raw(
    track: Track,
    tags: Array,
    satellites: Sequence[Ephemeris],
    settings: RawSettings,
    rng: np.random.Generator,
    *,
    start_gps: float,
) -> RawLog:
    """Measure from a track at receiver times `tags`, s since `start_gps`."""
    tag = np.asarray(tags, dtype=np.float64)
    offset = settings.clock_offset + settings.clock_drift * tag
    time = tag - offset
    shape = (len(tag), len(satellites), settings.bands)
    code, phase, doppler, cn0 = (np.full(shape, np.nan) for _ in range(4))
    lost = np.zeros(shape, dtype=np.bool_)
    p = track(time)
    for k, eph in enumerate(satellites):
        sight = _Sight(eph, track, settings, start_gps)
        elevation = sight.elevation(time)
        up = elevation > math.radians(settings.elevation_mask_deg)
        if not np.any(up):
            continue
        for b in range(settings.bands):
            wave = LIGHT / FREQUENCIES[b]
            geometry = sight.length(time, b) + LIGHT * offset
            later = sight.length(time + 0.05, b) - sight.length(time - 0.05, b)
            rate = later / 0.1 + LIGHT * settings.clock_drift
            white = rng.normal(size=(3, len(tag)))
            slow = gauss_markov(rng, tag, settings.multipath_tau, 2)
            air = sight.ionosphere(time, b)
            code[:, k, b] = geometry + air + settings.code_noise * white[0]
            code[:, k, b] += settings.code_multipath * slow[0]
            metres = geometry - air + settings.phase_noise * white[1]
            metres += settings.phase_multipath * slow[1]
            whole = int(rng.integers(-(10**6), 10**6))
            cycles = whole + _slipped(settings.slips, eph.prn, b, tag)
            phase[:, k, b] = metres / wave + cycles
            doppler[:, k, b] = -rate / wave + settings.doppler_noise_hz * white[2]
            cn0[:, k, b] = 34.0 + 16.0 * np.sin(np.maximum(elevation, 0.0)) - 4.0 * b
            lost[:, k, b] = _flags(settings.slips, eph.prn, b, tag, up)
        for values in (code, phase, doppler, cn0):
            values[~up, k] = np.nan
    return RawLog(
        start_gps=start_gps, tag=tag, time=time, prns=tuple(eph.prn for eph in satellites),
        p_ecef=p, code=code, phase=phase, doppler=doppler, lost=lost, cn0=cn0,
    )  # fmt: skip


class _Sight:
    """Line from one satellite to the antenna, without the receiver's clock."""

    def __init__(
        self, eph: Ephemeris, track: Track, settings: RawSettings, start_gps: float
    ) -> None:
        self.eph, self.track, self.settings = eph, track, settings
        # Both are some 1e9 s: their difference is small before anything is added to it.
        self.after_toe = start_gps - eph.toe

    def _satellite(self, time: Array, p: Array) -> tuple[Array, Array]:
        """Satellite at emission, in the axes of reception (n, 3), and its clock (n,)."""
        travel = np.full(len(time), 0.075)
        for _ in range(4):
            s, clock = satellite_position(self.eph, self.after_toe + time - travel)
            turn = EARTH_RATE * travel
            c, n = np.cos(turn), np.sin(turn)
            turned = np.stack(
                [c * s[:, 0] + n * s[:, 1], c * s[:, 1] - n * s[:, 0], s[:, 2]], axis=-1
            )
            travel = np.linalg.norm(turned - p, axis=-1) / LIGHT
        return turned, clock

    def _up_and_north(self, p: Array) -> tuple[Array, Array, Array]:
        lat, lon, h = ellipsoid.geodetic_from_ecef(p)
        return ellipsoid.rotation_ecef_from_enu(lat, lon)[..., 2], lat, h

    def elevation(self, time: Array) -> Array:
        """Elevation over the horizon, rad."""
        p = self.track(time)
        d = self._satellite(time, p)[0] - p
        up = self._up_and_north(p)[0]
        return np.asarray(np.arcsin(np.sum(d * up, axis=-1) / np.linalg.norm(d, axis=-1)))

    def length(self, time: Array, band: int) -> Array:
        """Range, minus the satellite's clock, plus the troposphere, m."""
        p = self.track(time)
        s, clock = self._satellite(time, p)
        squared = (FREQUENCIES[0] / FREQUENCIES[band]) ** 2
        clock = clock - squared * self.eph.tgd
        up, lat, h = self._up_and_north(p)
        d = s - p
        distance = np.linalg.norm(d, axis=-1)
        sine = np.sum(d * up, axis=-1) / distance
        air = hydrostatic_delay(lat, h) + self.settings.wet_delay * np.exp(-h / 2000.0)
        # Black and Eisner (1984)
        slant = 1.001 / np.sqrt(0.002001 + sine**2)
        return np.asarray(distance - LIGHT * clock + air * slant)

    def ionosphere(self, time: Array, band: int) -> Array:
        """Delay of the code, advance of the phase, m; a thin shell at 350 km."""
        p = self.track(time)
        cosine = np.cos(self.elevation(time)) * 6371.0 / (6371.0 + 350.0)
        lat = self._up_and_north(p)[1]
        zenith = self.settings.ionosphere + self.settings.ionosphere_gradient * (
            (lat - math.radians(39.0)) * 6371e3
        )
        factor = (FREQUENCIES[0] / FREQUENCIES[band]) ** 2
        return np.asarray(factor * zenith / np.sqrt(1.0 - cosine**2))


def hydrostatic_delay(lat: Array, h: Array) -> Array:
    """Delay of dry air at the zenith, m, in a standard atmosphere; lat rad, h m.

    Notes
    -----
    Saastamoinen (1972) in the form of Davis et al. (1985).
    """
    pressure = 1013.25 * (1.0 - 2.25577e-5 * h) ** 5.25588
    return np.asarray(0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * lat) - 2.8e-7 * h))


def gauss_markov(rng: np.random.Generator, time: Array, tau: float, rows: int) -> Array:
    """Stationary Gauss-Markov rows of unit sigma at increasing times, shape (rows, n)."""
    out = rng.normal(size=(rows, len(time)))
    decay = np.exp(-np.diff(time) / tau)
    for i, d in enumerate(decay, start=1):
        out[:, i] = d * out[:, i - 1] + math.sqrt(1.0 - d**2) * out[:, i]
    return out


def _slipped(slips: Sequence[Slip], prn: int, band: int, tag: Array) -> Array:
    total = np.zeros(len(tag))
    for slip in slips:
        if slip.prn == prn and slip.band == band:
            total += np.where(tag >= slip.time, slip.cycles, 0)
    return total


def _flags(
    slips: Sequence[Slip], prn: int, band: int, tag: Array, up: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Flag at the first epoch after a slip that the receiver noticed, and where a pass begins."""
    flags = np.zeros(len(tag), dtype=np.bool_)
    flags[1:] = up[1:] & ~up[:-1]
    for slip in slips:
        after = np.flatnonzero(tag >= slip.time)
        if slip.prn == prn and slip.band == band and slip.flagged and len(after):
            flags[after[0]] = True
    return flags


def orbiting_track(
    p_ecef: Array, *, wait: float = 60.0, radius: float = 150.0, speed: float = 18.0,
    height: float = 100.0,
) -> Track:  # fmt: skip
    """Track that stands at a place for `wait` s, then climbs and circles: smooth, and no straight.

    Beyond the wait the speed and the climb grow over 20 s; the circle swings in height by 5 m.
    """
    lat, lon, _ = ellipsoid.geodetic_from_ecef(np.asarray(p_ecef))
    R = ellipsoid.rotation_ecef_from_enu(lat, lon)

    def track(time: Array) -> Array:
        t = np.maximum(np.asarray(time, dtype=np.float64) - wait, 0.0)
        grown = np.clip(t / 20.0, 0.0, 1.0)
        # Integral of the smooth step 3 s^2 - 2 s^3, then full speed.
        along = speed * np.where(t < 20.0, 20.0 * (grown**3 - grown**4 / 2.0), t - 10.0)
        angle = along / radius
        up = height * (3.0 * grown**2 - 2.0 * grown**3) + 5.0 * np.sin(0.2 * angle) ** 2
        enu = np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), up], axis=-1)
        return np.asarray(np.asarray(p_ecef) + enu @ R.T)

    return track


def fixed_track(p_ecef: Array) -> Track:
    """Track of an antenna that does not move."""

    def track(time: Array) -> Array:
        return np.broadcast_to(np.asarray(p_ecef, dtype=np.float64), (len(time), 3))

    return track
