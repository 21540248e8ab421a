"""The camera clock's offset from where the photos were taken: tagged positions on a track."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.navigate.clock_fit import DRIFT_SIGMA, ClockFit

# s; step of the first search, and photos used in it
_STEP, _SEARCHED = 0.5, 150
# sigmas at which a distance counts as an outlier
_OUTLIER = 4.0
# m; one sigma of a constant difference between tags and track: another receiver, a lever arm
BIAS_SIGMA = 1.0
# s; errors of navigation solutions stay alike for about this long
_ALIKE = 30.0
# fits kept, and log odds to the best at which one is dropped
_MOST, _DROP = 8, 12.0
# share of photos that must lie on the track
_LEAST_SHARE = 0.5

# times on the GPS scale (k,) -> positions (k, d) m and velocities (k, d) m/s, NaN outside
Track = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaggedPositions:
    """Photos with camera clock s (middle of its last digit) and position (n, d) m, sigma (n,) m."""

    clock: Array
    resolution: Array
    position: Array
    sigma: Array


def clock_from_positions(
    photos: TaggedPositions, track: Track, start: float, end: float
) -> ClockFit:
    """Offset of the camera clock that lays the tagged positions on a track.

    Parameters
    ----------
    photos
        Positions in the frame of `track`, level axes.
    track
        Position and velocity at times; NaN outside the log and in gaps.
    start, end : s
        First and last time of the track, GPS scale. All offsets are searched at which at least
        half of the photos lie in between: hours and days wrong are found, too.

    Returns
    -------
    ClockFit
        With the other offsets that fit, named: a track flown twice has several.

    Raises
    ------
    NavigationError
        If the photos do not lie on the track.

    Notes
    -----
    A constant difference is estimated beside the offset with a prior of `BIAS_SIGMA`, and errors
    are taken as alike over half a minute. An error along the track that turns with the aircraft
    (a lever arm, a latency of the tags) cannot be told from the offset.
    """
    use = np.isfinite(photos.clock) & np.all(np.isfinite(photos.position), axis=1)
    if np.sum(use) < 3:
        raise NavigationError(
            f"only {int(np.sum(use))} photos have a clock and a position; 3 are needed"
        )
    one = TaggedPositions(
        clock=photos.clock[use],
        resolution=photos.resolution[use],
        position=photos.position[use],
        sigma=np.where(photos.sigma[use] > 0.0, photos.sigma[use], 3.0),
    )
    offsets, cost = _search(one, track, start, end)
    fits: list[tuple[float, float, float, float]] = []
    for k in _minima(offsets, cost):
        fit = _fitted(one, track, float(offsets[k]))
        if fit is not None and all(abs(fit[0] - other[0]) > _STEP for other in fits):
            fits.append(fit)
    if not fits:
        raise NavigationError(
            "the photos' positions lie nowhere on the track: wrong log, or wrong datum?"
        )
    return _summary(one, fits)


def _search(photos: TaggedPositions, track: Track, start: float, end: float) -> tuple[Array, Array]:
    """Robust cost of offsets in steps, bias left out; each (k,)."""
    pick = np.unique(np.linspace(0, len(photos.clock) - 1, _SEARCHED).astype(int))
    clock, p = photos.clock[pick], photos.position[pick]
    middle = float(np.median(clock))
    # Half of the photos lie within the track from here to there.
    low, high = middle - end, middle - start
    offsets = np.arange(low, high + _STEP, _STEP)
    cost = np.empty(len(offsets))
    for first in range(0, len(offsets), 2000):
        part = slice(first, first + 2000)
        t = clock - offsets[part, None]
        there, velocity = track(t.ravel())
        d2 = np.sum((there.reshape(*t.shape, -1) - p) ** 2, axis=-1)
        speed2 = np.sum(velocity.reshape(*t.shape, -1) ** 2, axis=-1)
        # The next step may be better by what is flown in half a step.
        sigma2 = photos.sigma[pick] ** 2 + BIAS_SIGMA**2 + speed2 * (_STEP**2 + 1.0) / 12.0
        x = np.where(np.isfinite(d2), d2 / sigma2, np.inf)
        cost[part] = np.minimum(x, 2.0 * _OUTLIER**2).mean(axis=1)
    return offsets, cost


def _minima(offsets: Array, cost: Array) -> list[int]:
    """Lowest local minima, best first."""
    padded = np.r_[np.inf, cost, np.inf]
    local = np.flatnonzero((cost <= padded[:-2]) & (cost < padded[2:]))
    order = local[np.argsort(cost[local], kind="stable")]
    return [int(k) for k in order[:_MOST]]


def _covariance(t: Array, sigma: Array, along2: Array) -> Array:
    """Covariance of one axis' errors: constant, slow and white part, and the cut of the clock."""
    slow = np.exp(-np.abs(t[:, None] - t) / _ALIKE)
    both = 0.5 * sigma[:, None] * sigma * slow
    return np.asarray(both + np.diag(0.5 * sigma**2 + along2) + BIAS_SIGMA**2)


def _fitted(
    photos: TaggedPositions, track: Track, offset: float
) -> tuple[float, float, float, float] | None:
    """Offset, sigma s, cost (chi square), and share used, by Gauss-Newton; None where it fails."""
    scale = 1.0
    for _ in range(12):
        t = photos.clock - offset
        there, velocity = track(t)
        r = photos.position - there
        speed2 = np.sum(velocity**2, axis=1)
        tolerance = photos.sigma**2 * scale**2 + BIAS_SIGMA**2
        tolerance = tolerance + speed2 * photos.resolution**2 / 12.0
        with np.errstate(invalid="ignore"):
            good = np.sum(r**2, axis=1) < r.shape[1] * _OUTLIER**2 * tolerance
        if np.sum(good) < max(3.0, _LEAST_SHARE * len(r)):
            return None
        t, r, v = t[good], r[good], velocity[good]
        information = gradient = chi2 = 0.0
        cut = photos.resolution[good] ** 2 / 12.0
        for axis in range(r.shape[1]):
            c = _covariance(t, photos.sigma[good] * scale, v[:, axis] ** 2 * cut)
            # p = track(clock - offset): a later offset goes back along the track
            solved = np.linalg.solve(c, np.stack([v[:, axis], r[:, axis]], axis=1))
            information += float(v[:, axis] @ solved[:, 0])
            gradient += float(v[:, axis] @ solved[:, 1])
            chi2 += float(r[:, axis] @ solved[:, 1])
        if information <= 0.0:
            return None
        step = -gradient / information
        offset += step
        freedom = max(1, r.size - r.shape[1] - 1)
        if abs(step) < 1e-4:
            break
        # Tags often state too small a sigma, never too large a one for long.
        scale = min(max(1.0, scale * math.sqrt(chi2 / freedom)), 10.0)
    worst = 2.0 * _OUTLIER**2
    lost = (len(photos.clock) - len(r)) * worst
    return offset, math.sqrt(1.0 / information), chi2 + lost + r.size * 2.0 * math.log(scale), (
        len(r) / len(photos.clock)
    )  # fmt: skip


def _summary(photos: TaggedPositions, fits: list[tuple[float, float, float, float]]) -> ClockFit:
    cost = np.array([f[2] for f in fits])
    behind = 0.5 * (cost - cost.min())
    p = np.where(behind < _DROP, np.exp(-np.minimum(behind, _DROP)), 0.0)
    p /= p.sum()
    order = np.argsort(-p, kind="stable")
    best = fits[order[0]]
    words = tuple(
        f"a clock offset of {fits[k][0]:.1f} s instead of {best[0]:.1f} s fits, too (a track flown "
        f"twice?), with a confidence of {p[k]:.3f}"
        for k in order[1:]
        if p[k] > 0.002
    )
    doubts: tuple[str, ...] = ()
    if best[3] < 1.0:
        away = round((1.0 - best[3]) * len(photos.clock))
        doubts = (f"{away} of {len(photos.clock)} tagged positions do not lie on the track",)
    return ClockFit(
        offset=best[0],
        epoch=float(np.median(photos.clock)) - best[0],
        covariance=np.diag([best[1] ** 2, DRIFT_SIGMA**2]),
        source="tagged positions on the track",
        confidence=0.99 * float(p[order[0]]),
        alternatives=words,
        doubts=doubts,
    )


def middle_of_reading(clock: ArrayLike, resolution: ArrayLike) -> Array:
    """Most probable clock value of a reading cut to its resolution, s."""
    return np.asarray(clock, np.float64) + 0.5 * np.asarray(resolution, np.float64)
