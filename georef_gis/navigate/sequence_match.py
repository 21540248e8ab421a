"""Two noted sequences of the same exposures, aligned: a pair hidden Markov model on a band.

Rows are photos, columns are events, both in order. A path through the lattice pairs a row with a
column, or passes over a row (photo without event) or a column (event without photo), singly or in
a block (test shots, deleted photos, a log that runs on). Forward and backward sums over all paths
(Durbin et al., Biological Sequence Analysis, 1998, ch. 4) give the evidence of a clock offset
and the posterior of every pair. Exposures are taken as a Poisson process, so that a pair weighs
f / rate, f being the density of the photo's reading given the event's time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from georef_gis.frames import Array

IntArray = NDArray[np.int64]
Kernel = TypeVar("Kernel", bound=Callable[..., Any])

if TYPE_CHECKING:

    def _compiled(function: Kernel) -> Kernel:
        """numba's decorator keeps the signature."""
        return function

else:
    _compiled = njit(cache=True)

# States: pair; photo passed over singly, in a short, in a long block; events likewise; start.
PAIR, START, STATES = 0, 7, 8
# Probability that a short (test shots) or a long block (another flight in the log) goes on.
_STAY_SHORT, _STAY_LONG = 0.75, 0.995
# Probability that a sequence begins or ends with a block of each kind: test shots are common.
_EDGE_SHORT, _EDGE_LONG = 0.25, 0.05
# Probability that a block opens at any exposure in between
_OPEN_SHORT, _OPEN_LONG = 0.001, 0.001
# Readings outside the latency's normal distribution: their share and one sigma, s
TAIL_SHARE, TAIL_SIGMA = 0.005, 0.15
# s; a reading further than this from an event is not of it
REACH = 0.6
# Log weight of an exposure outside the time that photos and events share. Two sequences end to end
# are twice as long as two of the same flight, which costs exp(-1) per exposure of the one process.
_OUTSIDE = 0.5
# Weight of a pair that the device noted by name
_NAMED = 1e9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Photos in order: readings s (NaN: unknown, ghost), resolution s, name keys (-1: none)."""

    reading: Array
    resolution: Array
    key: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """Events in order: time s on the GPS scale (NaN: lost, ghost), sigma s, name keys."""

    time: Array
    sigma: Array
    key: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairModel:
    """Both sequences, how often each fails, and how the reading scatters.

    `rate` is in exposures per s, `jitter` s one sigma of the latency, `epoch` s of the drift.
    """

    rows: Rows
    columns: Columns
    missed: float
    spurious: float
    rate: float
    jitter: float
    epoch: float

    def log_evidence(self, offset: Array, drift: Array) -> Array:
        """Log of the summed weight of all paths, shape (k,), for clocks (k,) s and s/s."""
        tables = self._tables()
        found = np.array(
            [_forward_only(*tables, self._clock(o, d)) for o, d in zip(offset, drift, strict=True)]
        )
        return found - _OUTSIDE * self._outside(np.asarray(offset))

    def posterior(self, offset: float, drift: float) -> tuple[IntArray, IntArray, Array, Array]:
        """Rows, columns, posterior and weight of all pairs that are not negligible."""
        row, column, p, weight = _pairs(*self._tables(), self._clock(offset, drift))
        return row, column, p, weight

    def _outside(self, offset: Array) -> Array:
        """How many photos lie outside the events' time and events outside the photos'; (k,)."""
        t = self.columns.time[np.isfinite(self.columns.time)]
        c = self.rows.reading[np.isfinite(self.rows.reading)]
        inside = np.zeros(len(offset))
        for mine, other, shift in ((c, t, offset), (t, c, -offset)):
            low = np.searchsorted(mine, other[0] + shift - REACH)
            inside += np.searchsorted(mine, other[-1] + shift + REACH) - low
        return len(t) + len(c) - inside

    def _clock(self, offset: float, drift: float) -> Array:
        return np.array([offset, drift, self.epoch, self.jitter, self.rate])

    def _tables(self) -> tuple[Array, IntArray, Array, IntArray, Array, Array]:
        step, end = _transitions(self.missed, self.spurious)
        first, last = _surroundings(self.rows.reading, self.rows.resolution)
        before, after = _surroundings(self.columns.time, np.zeros(len(self.columns.time)))
        rows = np.stack([self.rows.reading, self.rows.resolution, first, last])
        columns = np.stack([self.columns.time, self.columns.sigma, before, after])
        return rows, self.rows.key, columns, self.columns.key, step, end


def log_null(model: PairModel) -> float:
    """Log weight of no pair at all: the photos are not of these events."""
    count = len(model.rows.reading) + len(model.columns.time)
    return 2.0 * math.log(_EDGE_LONG) + count * (math.log(_STAY_LONG) - _OUTSIDE)


def _transitions(missed: float, spurious: float) -> tuple[Array, Array]:
    """Weights of going from state to state, shape (8, 8), and of ending in a state."""
    after = np.zeros(STATES)
    after[1], after[2], after[3] = missed, _OPEN_SHORT, _OPEN_LONG
    after[4], after[5], after[6] = spurious, _OPEN_SHORT, _OPEN_LONG
    after[PAIR] = 1.0 - after.sum()
    step = np.tile(after, (STATES, 1))
    start = np.array([0.0, 0.0, _EDGE_SHORT, _EDGE_LONG, 0.0, _EDGE_SHORT, _EDGE_LONG, 0.0])
    within = after * np.array([1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    step[START] = start + (1.0 - start.sum()) * within / within.sum()
    for k, stay in ((2, _STAY_SHORT), (3, _STAY_LONG), (5, _STAY_SHORT), (6, _STAY_LONG)):
        step[k] *= 1.0 - stay
        step[k, k] += stay
    end = np.full(STATES, 1.0 - start.sum())
    # A block at the end is as likely as one at the start, though it is opened like any other.
    for k, stay, opened in ((2, _STAY_SHORT, _OPEN_SHORT), (3, _STAY_LONG, _OPEN_LONG)):
        end[[k, k + 3]] = start[k] / opened * (1.0 - stay)
    return step, end


def _surroundings(value: Array, width: Array) -> tuple[Array, Array]:
    """Earliest and latest that each value can be: itself, or between its known neighbours."""
    known = np.isfinite(value)
    low = np.maximum.accumulate(np.where(known, value, -np.inf))
    high = np.minimum.accumulate(np.where(known, value + width, np.inf)[::-1])[::-1]
    return low, high


@_compiled
def _band(
    rows: Array, columns: Array, clock: Array
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """First and last column that may pair with each row, and the nodes that each row needs."""
    n, m = rows.shape[1], columns.shape[1]
    first, last = np.empty(n, np.int64), np.empty(n, np.int64)
    a = b = 0
    offset, drift, epoch = clock[0], clock[1], clock[2]
    for i in range(n):
        low = rows[2, i] - offset - REACH
        high = rows[3, i] - offset + REACH
        if np.isfinite(low):
            low -= drift * (low - epoch)
        if np.isfinite(high):
            high -= drift * (high - epoch)
        while a < m and columns[3, a] < low:
            a += 1
        b = max(a, b)
        while b < m and columns[2, b] <= high:
            b += 1
        first[i], last[i] = a, b - 1
    left, right = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    left[0], right[0] = 0, max(0, last[0])
    for i in range(1, n + 1):
        right[i] = m if i == n else max(last[i], last[i - 1] + 1)
        right[i] = min(m, max(right[i], right[i - 1]))
        left[i] = max(left[i - 1], min(right[i - 1], first[i] if i < n else first[n - 1]))
    return first, last, left, right


@_compiled
def _weight(
    i: int, j: int, rows: Array, row_key: IntArray, columns: Array, column_key: IntArray,
    clock: Array,
) -> float:  # fmt: skip
    """Weight of a pair against that of both passed over, without the transitions."""
    factor = 1.0
    if row_key[i] >= 0 or column_key[j] >= 0:
        factor = _NAMED if row_key[i] == column_key[j] else 1.0 / _NAMED
    reading, t = rows[0, i], columns[0, j]
    if not (np.isfinite(reading) and np.isfinite(t)):
        return factor
    resolution = rows[1, i]
    sigma = math.sqrt(clock[3] ** 2 + columns[1, j] ** 2)
    x = t + clock[0] + clock[1] * (t - clock[2]) - reading
    r2 = 1.0 / (math.sqrt(2.0) * sigma)
    p = 0.5 * (math.erf(x * r2) - math.erf((x - resolution) * r2))
    if x < -4.0 * sigma or x > resolution + 4.0 * sigma or p < 0.1:
        r2 = 1.0 / (math.sqrt(2.0) * (TAIL_SIGMA + 3.0 * sigma))
        wide = 0.5 * (math.erf(x * r2) - math.erf((x - resolution) * r2))
        p += TAIL_SHARE * wide
    return float(factor * max(p, 1e-12) / (resolution * clock[4]))


@_compiled
def _forward(
    rows: Array, row_key: IntArray, columns: Array, column_key: IntArray, step: Array,
    end: Array, clock: Array,
) -> tuple[float, Array, IntArray, IntArray, IntArray]:  # fmt: skip
    """Log evidence, scaled forward weights of the nodes (by the state of arrival), the band."""
    n, m = rows.shape[1], columns.shape[1]
    first, last, left, right = _band(rows, columns, clock)
    at = np.zeros(n + 2, np.int64)
    for i in range(n + 1):
        at[i + 1] = at[i] + right[i] - left[i] + 1
    f = np.zeros((at[n + 1], STATES))
    total = 0.0
    for i in range(n + 1):
        top = 0.0
        for j in range(left[i], right[i] + 1):
            here = f[at[i] + j - left[i]]
            if i == 0 and j == 0:
                here[START] = 1.0
            if i > 0:
                up = j - left[i - 1]
                if up >= 1 and j - 1 <= right[i - 1] and first[i - 1] <= j - 1 <= last[i - 1]:
                    there = f[at[i - 1] + up - 1]
                    s = 0.0
                    for k in range(STATES):
                        s += there[k] * step[k, PAIR]
                    w = _weight(i - 1, j - 1, rows, row_key, columns, column_key, clock)
                    here[PAIR] = s * w
                if up >= 0 and j <= right[i - 1]:
                    there = f[at[i - 1] + up]
                    for q in range(1, 4):
                        for k in range(STATES):
                            here[q] += there[k] * step[k, q]
            if j > left[i]:
                there = f[at[i] + j - left[i] - 1]
                for q in range(4, 7):
                    for k in range(STATES):
                        here[q] += there[k] * step[k, q]
            for k in range(STATES):
                top = max(top, here[k])
        if top == 0.0:
            return -np.inf, f, at, left, right
        f[at[i] : at[i + 1]] /= top
        total += math.log(top)
    s = 0.0
    for k in range(STATES - 1):
        s += f[at[n] + m - left[n], k] * end[k]
    return total + (math.log(s) if s > 0.0 else -np.inf), f, at, left, right


@_compiled
def _forward_only(
    rows: Array, row_key: IntArray, columns: Array, column_key: IntArray, step: Array,
    end: Array, clock: Array,
) -> float:  # fmt: skip
    return _forward(rows, row_key, columns, column_key, step, end, clock)[0]


@_compiled
def _room(first: IntArray, last: IntArray) -> int:
    """Number of pairs within the band."""
    count = 0
    for i in range(len(first)):
        count += max(0, last[i] - first[i] + 1)
    return count


@_compiled
def _passed_over(step: Array, ahead: Array, kind: int, here: Array, arrived: Array) -> float:
    """Weight of leaving a node by passing over a row or column; added to its backward sums.

    `kind` is the first state of its kind, `ahead` holds the backward sums of the next node,
    `arrived` the forward weights of this one.
    """
    through = 0.0
    for k in range(STATES):
        s = 0.0
        for q in range(kind, kind + 3):
            s += step[k, q] * ahead[q]
        here[k] += s
        through += arrived[k] * s
    return through


@_compiled
def _paired(step: Array, pair: float, here: Array, arrived: Array) -> float:
    """Weight of leaving a node by a pair, whose sums ahead are `pair`; added to its own."""
    direct = 0.0
    for k in range(STATES):
        here[k] += step[k, PAIR] * pair
        direct += arrived[k] * step[k, PAIR] * pair
    return direct


@_compiled
def _pairs(
    rows: Array, row_key: IntArray, columns: Array, column_key: IntArray, step: Array,
    end: Array, clock: Array,
) -> tuple[IntArray, IntArray, Array, Array]:  # fmt: skip
    """Rows, columns, posterior and weight of the pairs: backward sums beside the forward."""
    n, m = rows.shape[1], columns.shape[1]
    first, last, _, _ = _band(rows, columns, clock)
    evidence, f, at, left, right = _forward(
        rows, row_key, columns, column_key, step, end, clock
    )  # fmt: skip
    count = _room(first, last)
    row, column = np.empty(count, np.int64), np.empty(count, np.int64)
    found, weight = np.zeros(count), np.zeros(count)
    k_out = 0
    if not np.isfinite(evidence):
        return row[:0], column[:0], found[:0], weight[:0]
    below = np.zeros((1, STATES))
    for i in range(n, -1, -1):
        b = np.zeros((right[i] - left[i] + 1, STATES))
        start_out, passed = k_out, 0.0
        for j in range(right[i], left[i] - 1, -1):
            here, arrived = b[j - left[i]], f[at[i] + j - left[i]]
            if i == n and j == m:
                here[:7] = end[:7]
                continue
            pair = w = 0.0
            if i < n:
                ahead = j - left[i + 1]
                if first[i] <= j <= last[i] and left[i + 1] <= j + 1 <= right[i + 1]:
                    w = _weight(i, j, rows, row_key, columns, column_key, clock)
                    pair = w * below[ahead + 1, PAIR]
                if left[i + 1] <= j <= right[i + 1]:
                    passed += _passed_over(step, below[ahead], 1, here, arrived)
            direct = _paired(step, pair, here, arrived)
            if j < right[i]:
                _passed_over(step, b[j + 1 - left[i]], 4, here, arrived)
            if direct > 0.0:
                row[k_out], column[k_out] = i, j
                found[k_out], weight[k_out] = direct, w
                k_out += 1
        if i < n:
            # Every path leaves a row once: by a pair or by passing over.
            passed += found[start_out:k_out].sum()
            found[start_out:k_out] /= max(passed, 1e-300)
        below = b / max(b.max(), 1e-300)
    return row[:k_out], column[:k_out], found[:k_out], weight[:k_out]


def vote(readings: Array, times: Array, width: float, most: int) -> tuple[Array, Array]:
    """Offsets at which most readings lie within `width` s of an event, best first.

    Returns
    -------
    offset, votes : shape (k,), k <= `most`
        Mean difference of reading and event, and how many pairs agree to it.
    """
    # 2e6 differences are sorted in 0.2 s; a part of the photos votes like all.
    stride = max(1, math.ceil(len(readings) * len(times) / 2e6))
    d = np.sort((readings[::stride, None] - times).ravel())
    last = np.searchsorted(d, d + width, side="right")
    votes = last - np.arange(len(d))
    # The best of each half width stands for it, so that few are left to sort.
    cell = np.floor((d - d[0]) / (0.5 * width)).astype(np.int64)
    order = np.lexsort((-votes, cell))
    best = order[np.r_[True, np.diff(cell[order]) > 0]]
    best = best[np.argsort(-votes[best], kind="stable")][: 8 * most]
    kept: list[int] = []
    for k in best:
        if all(abs(d[k] - d[other]) >= width for other in kept):
            kept.append(int(k))
        if len(kept) == most:
            break
    total = np.r_[0.0, np.cumsum(d - d[0])]
    middle = [d[0] + (total[last[k]] - total[k]) / votes[k] for k in kept]
    return np.array(middle, np.float64), np.asarray(votes[kept] * stride, np.float64)
