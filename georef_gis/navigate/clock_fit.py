"""The camera's clock against GPS time: what is believed of it before, and what GPS tags tell of it.

A camera clock is naive and local; here it is read as if it were UTC and put on the GPS scale
(`clock_seconds`), so that its offset is the time zone plus its own error:
``clock = t + offset + drift (t - epoch)`` with t on the GPS scale. Readings are cut to the
resolution, never rounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.units import gps_from_utc

# s; zones in use lie from UTC-12 to UTC+14 in steps of a quarter of an hour (IANA tz database)
ZONE_STEP = 900.0
ZONES = np.arange(-48, 57) * ZONE_STEP
# one sigma; quartz of cameras is specified to about 20 ppm
DRIFT_SIGMA = 20e-6
# share of the belief: a zone that is not whole, clock wrong by up to days, clock wrong by years
_SHARE_QUARTERS, _SHARE_DAYS, _SHARE_YEARS = 0.1, 0.04, 0.01
_DAYS, _YEARS = 4 * 86400.0, 60 * 3.156e7
# share of tags that tell nothing (stale, placeholder), and the range they spread over, s
_SHARE_STALE, _STALE_RANGE = 0.05, 3600.0
# s; noise of a stamp cut to whole seconds, beside the cutting
_STAMP_NOISE = 0.03


def clock_seconds(reading: datetime) -> float:
    """Seconds on the GPS scale of a naive camera clock read as if it were UTC."""
    return gps_from_utc(reading.replace(tzinfo=UTC))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockFit:
    """Camera clock, read as if it were UTC, minus the true time: camera clock minus UTC.

    Parameters
    ----------
    offset : s, at `epoch`
    drift : s per s
    epoch : s, GPS scale
    covariance : shape (2, 2), of (offset s, drift)
    confidence
        Probability that the offset is this one and not another that fits, too.
    alternatives
        The other offsets that fit, in words.
    """

    offset: float
    drift: float = 0.0
    epoch: float
    covariance: Array
    source: str
    confidence: float = 1.0
    alternatives: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def sigma(self) -> float:
        """One sigma of the offset at `epoch`, s."""
        return math.sqrt(float(self.covariance[0, 0]))

    def gps(self, clock: ArrayLike) -> Array:
        """GPS time of clock values (not cut), s."""
        passed = np.asarray(clock, np.float64) - self.offset - self.epoch
        return self.epoch + passed / (1.0 + self.drift)

    def sigma_at(self, t_gps: ArrayLike) -> Array:
        """One sigma of the clock's offset at times on the GPS scale, s."""
        dt = np.asarray(t_gps, np.float64) - self.epoch
        c = self.covariance
        return np.asarray(np.sqrt(c[0, 0] + 2.0 * dt * c[0, 1] + dt**2 * c[1, 1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetPrior:
    """What is believed of the offset before events are looked at.

    Parameters
    ----------
    value, sigma : s
        Offset known beforehand; None where not even the time zone is.
    trust
        Probability that `value` holds within its sigma.
    clock_sigma : s
        One sigma of the error of a clock that was set by hand, apart from the zone.
    """

    value: float | None = None
    sigma: float = 30.0
    trust: float = 0.99
    clock_sigma: float = 30.0

    def log_density(self, offset: ArrayLike) -> Array:
        """Log of the density, 1/s, of offsets, s; any shape."""
        o = np.asarray(offset, np.float64)
        free = self._free(o)
        if self.value is None:
            return np.asarray(np.log(free))
        known = _normal(o - self.value, self.sigma)
        return np.asarray(np.log(self.trust * known + (1.0 - self.trust) * free))

    def _free(self, o: Array) -> Array:
        nearest = np.clip(np.round(o / ZONE_STEP), -48, 56) * ZONE_STEP
        whole = np.mod(nearest, 3600.0) == 0.0
        hours = int(np.sum(np.mod(ZONES, 3600.0) == 0.0))
        share = np.where(
            whole, (1.0 - _SHARE_QUARTERS) / hours, _SHARE_QUARTERS / (len(ZONES) - hours)
        )
        set_by_hand = share * _normal(o - nearest, self.clock_sigma)
        days = _SHARE_DAYS * (np.abs(o) < _DAYS / 2) / _DAYS
        years = _SHARE_YEARS / _YEARS
        return np.asarray((1.0 - _SHARE_DAYS - _SHARE_YEARS) * set_by_hand + days + years)


def _normal(x: Array, sigma: float) -> Array:
    return np.asarray(np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posterior:
    """Offset and drift on a grid: nodes (k,), their weights (sum 1), log of the whole integral."""

    offset: Array
    drift: Array
    weight: Array
    log_evidence: float

    def mean(self) -> Array:
        """Mean of (offset, drift)."""
        return np.array([self.weight @ self.offset, self.weight @ self.drift])

    def covariance(self) -> Array:
        """Covariance of (offset, drift), shape (2, 2)."""
        d = np.stack([self.offset, self.drift]) - self.mean()[:, None]
        return np.asarray((self.weight * d) @ d.T)


LogDensity = Callable[[Array, Array], Array]


def integrate(
    log_density: LogDensity, low: float, high: float, *, drift_sigma: float, step: float
) -> Posterior:
    """Posterior of offset and drift between two offsets, on a grid that closes in on the mass.

    Parameters
    ----------
    log_density
        Log likelihood times the density of the offset, of arrays (k,) of offsets and drifts.
    low, high : s
    drift_sigma
        One sigma of the drift before.
    step : s
        Of the first, coarse row of offsets: no mode may hide between two of them.

    Notes
    -----
    Readings cut to whole seconds make the posterior nearly a box: moments of a grid are right
    where a quadratic approximation is not.
    """
    row = np.linspace(low, high, max(9, math.ceil((high - low) / step) + 1))
    ll = log_density(row, np.zeros_like(row))
    near = row[ll > ll.max() - 12.0]
    gap = row[1] - row[0]
    box = np.array([[max(low, near[0] - gap), min(high, near[-1] + gap)], [-4.0, 4.0]])
    box[1] *= drift_sigma
    for k in (9, 9, 9, 13, 13):
        found = _on_grid(log_density, box, drift_sigma, k)
        mean, sd = found.mean(), np.sqrt(np.diag(found.covariance()))
        cell = (box[:, 1] - box[:, 0]) / (k - 1)
        if k == 13 and np.all(sd > 0.7 * cell):
            break
        # A mode narrower than a cell may lie a cell beside the best node.
        reach = np.maximum(4.5 * sd, 1.2 * cell)
        box = np.stack([np.maximum(box[:, 0], mean - reach),
                        np.minimum(box[:, 1], mean + reach)], axis=1)  # fmt: skip
    return found


def _on_grid(log_density: LogDensity, box: Array, drift_sigma: float, k: int) -> Posterior:
    cell = (box[:, 1] - box[:, 0]) / k
    # Middles of cells: every node stands for the same area.
    axes = [box[i, 0] + (np.arange(k) + 0.5) * cell[i] for i in (0, 1)]
    o, d = (x.ravel() for x in np.meshgrid(*axes, indexing="ij"))
    ll = log_density(o, d) - 0.5 * (d / drift_sigma) ** 2
    ll -= math.log(drift_sigma * math.sqrt(2.0 * math.pi))
    top = float(ll.max())
    weight = np.exp(ll - top)
    total = float(weight.sum())
    return Posterior(
        offset=o,
        drift=d,
        weight=weight / total,
        log_evidence=top + math.log(total * cell[0] * cell[1]),
    )


def clock_of_tag_times(
    clock: Array, resolution: Array, time_gps: Array, sigma: Array
) -> ClockFit | None:
    """Offset and drift of a camera clock from the GPS times that the photos' tags state.

    Parameters
    ----------
    clock, resolution : shape (n,), s
        Readings (see `clock_seconds`), cut to their resolution; NaN where none.
    time_gps, sigma : shape (n,), s
        Tags' times on the GPS scale; NaN where none.

    Returns
    -------
    ClockFit or None
        None where no photo has both. The sigma keeps a part that all tags share.

    Notes
    -----
    Stamps of whole seconds are taken as cut like the clock's own. A part of the sigma is taken as
    common to all: the age of a fix, or rounding instead of cutting, is the same in all photos.
    """
    both = np.isfinite(clock) & np.isfinite(time_gps) & np.isfinite(sigma)
    if not np.any(both):
        return None
    c, res, g, s = clock[both], resolution[both], time_gps[both], sigma[both]
    epoch = float(np.median(g))
    whole = bool(np.all(np.abs(g - np.round(g)) < 1e-6)) and len(g) > 3
    cut = 1.0 if whole else 0.0
    noise = np.full_like(s, _STAMP_NOISE) if whole else s
    common = 1.0 / math.sqrt(12.0) if whole else 0.5 * float(np.median(s))
    difference = c - g
    width = float(np.max(res)) + cut + 4.0 * float(np.median(noise))
    start = _densest(difference, width)

    def log_density(o: Array, d: Array) -> Array:
        shift = difference - o[:, None] - d[:, None] * (g - epoch)
        p = _cut_difference(shift, res, cut, noise)
        p = (1.0 - _SHARE_STALE) * p + _SHARE_STALE / _STALE_RANGE
        return np.asarray(np.log(p).sum(axis=1))

    step = min(0.1, 0.5 * float(np.min(noise)) + 0.02)
    found = integrate(log_density, start - width, start + width, drift_sigma=DRIFT_SIGMA, step=step)
    mean = found.mean()
    covariance = found.covariance() + np.diag([common**2, 0.0])
    stale = int(np.sum(np.abs(difference - mean[0]) > width + 1.0))
    doubts = (f"{stale} of {len(g)} GPS times of tags do not fit the others",) if stale else ()
    return ClockFit(
        offset=float(mean[0]),
        drift=float(mean[1]),
        epoch=epoch,
        covariance=covariance,
        source=f"GPS times in the tags of {len(g)} photos",
        confidence=_agreement(len(g) - stale, len(g)),
        doubts=doubts,
    )


def _agreement(kept: int, total: int) -> float:
    """Probability that the tags that agree are the right ones (Laplace's rule, 1 % all wrong)."""
    return 0.99 * (kept + 1.0) / (total + 2.0) if 2 * kept <= total else 0.99


def _densest(values: Array, width: float) -> float:
    """Middle of the interval of a width that holds most values."""
    v = np.sort(values)
    last = np.searchsorted(v, v + width, side="right")
    best = int(np.argmax(last - np.arange(len(v))))
    return float(np.mean(v[best : last[best]]))


def _cut_difference(shift: Array, res: Array, cut: float, noise: Array) -> Array:
    """Density of (-u + v + noise) at `shift`, u and v uniform below `res` and `cut`, s."""
    from scipy.special import ndtr

    if cut == 0.0:
        return np.asarray((ndtr((shift + res) / noise) - ndtr(shift / noise)) / res)

    def ramp(x: Array) -> Array:
        z = x / noise
        return np.asarray(x * ndtr(z) + noise * np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))

    edges = ramp(shift + res) - ramp(shift) - ramp(shift + res - cut) + ramp(shift - cut)
    return np.asarray(np.maximum(edges, 0.0) / (res * cut))
