"""Likeliest path of a PWM index through its levels, and how sure every stretch of it is.

A hidden Markov model: the state is the level of a sample; it rises by one with a photo, by more
with photos that were not seen, and hardly ever otherwise; a sample is normal about its level, or a
glitch anywhere. The path is found by the algorithm of Viterbi (IEEE Trans. Inf. Theory 13, 1967).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from georef_gis.frames import Array

IntArray = NDArray[np.int64]

# A sample is a glitch with this probability.
_GLITCH = 0.01
# Probability per sample of a change that no photo makes: restart, or a level below.
_ODD_CHANGE = 1e-6
# Share of steps that hide another photo, two others, ...
_MISSED_SHARE = 0.01
# samples about a step within which its time is weighed
_NEAR = 6
# An excursion of at most so many samples that returns is a glitch.
_EXCURSION = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class PwmScale:
    """Levels of the index: `base + step * k`, k = 0..levels - 1, in the unit of the channel.

    Parameters
    ----------
    noise
        Sigma of a sample about its level, rounding included.
    quantum
        Unit of the last digit; 0 = none seen.
    wrap_known
        Whether `levels` was given, or seen at two wraps or more.
    """

    base: float
    step: float
    levels: int
    noise: float
    quantum: float
    wrap_known: bool


@njit(cache=True)
def _log_seen(value: float, level: int, base: float, step: float, noise: float) -> float:
    """Log density of a sample on a level but for a constant; a glitch may be anywhere."""
    deviation = (value - base - step * level) / noise
    inside = (1.0 - _GLITCH) / math.sqrt(2.0 * math.pi) * math.exp(-0.5 * deviation * deviation)
    # A glitch spreads over about a hundred steps.
    return math.log(inside + _GLITCH * noise / (100.0 * step))


@njit(cache=True)
def _viterbi(
    value: Array, form: Array, levels: int, tables: Array, reach: IntArray, which: IntArray
) -> IntArray:
    """Likeliest level of every sample; `form` is base, step, noise.

    Beyond `reach` all rises of a table are alike, so only the best source is tried there.
    """
    count = len(value)
    back = np.empty((count, levels), np.int16)
    best = np.empty(levels)
    for level in range(levels):
        best[level] = _log_seen(value[0], level, form[0], form[1], form[2])
    fresh = np.empty(levels)
    glitch = math.log(_GLITCH * form[2] / (100.0 * form[1]))
    for row in range(1, count):
        table, far = tables[which[row - 1]], reach[which[row - 1]]
        top = int(np.argmax(best))
        for level in range(levels):
            chosen, score = top, best[top] + table[(level - top) % levels]
            for rise in range(far):
                origin = level - rise
                if origin < 0:
                    origin += levels
                other = best[origin] + table[rise]
                if other > score:
                    chosen, score = origin, other
            back[row, level] = chosen
            seen = glitch
            if abs(value[row] - form[0] - form[1] * level) <= 12.0 * form[2]:
                seen = _log_seen(value[row], level, form[0], form[1], form[2])
            fresh[level] = score + seen
        best, fresh = fresh, best
    states = np.empty(count, np.int64)
    states[count - 1] = np.argmax(best)
    for row in range(count - 1, 0, -1):
        states[row - 1] = back[row, states[row]]
    return states


def _log_transition(gap: float, rate: float, levels: int) -> Array:
    """Log probability of rising by m levels, modulo `levels`, in a time without samples."""
    expected = min(rate * gap, 50.0)
    rise = np.arange(levels, dtype=float)
    factorials = np.array([math.lgamma(m + 1.0) for m in rise])
    with np.errstate(under="ignore"):
        several = np.exp(rise * math.log(expected) - expected - factorials)
        missed = np.where((rise > 1) & (rise < 5), expected * _MISSED_SHARE ** (rise - 1.0), 0.0)
    likely = np.where(several > 1e-12, several, 0.0) + missed + _ODD_CHANGE / levels
    return np.asarray(np.log(likely / likely.sum()))


def _transitions(time: Array, rate: float, levels: int) -> tuple[Array, IntArray]:
    """Tables of transitions by length of the gap, and which table every gap has."""
    gaps = np.maximum(np.diff(time), 1e-4)
    # A tenth of a gap's length changes no decision.
    keys = np.round(np.log(gaps) * 10.0).astype(np.int64)
    unique, which = np.unique(keys, return_inverse=True)
    tables = np.stack([_log_transition(math.exp(k / 10.0), rate, levels) for k in unique])
    return tables, np.asarray(which, dtype=np.int64)


def likeliest_path(time: Array, value: Array, scale: PwmScale, rate: float) -> IntArray:
    """Level of every sample on the likeliest path."""
    tables, which = _transitions(time, rate, scale.levels)
    uneven = np.abs(tables - tables[:, -1:]) > 1e-9
    reach = scale.levels - np.argmax(uneven[:, ::-1], axis=1)
    form = np.array([scale.base, scale.step, scale.noise])
    return np.asarray(_viterbi(value, form, scale.levels, tables, reach, which))


def changes_of(states: IntArray) -> IntArray:
    """Samples whose level is not that of the sample before."""
    return np.asarray(np.flatnonzero(np.diff(states)) + 1, dtype=np.int64)


def without_excursions(states: IntArray, levels: int) -> IntArray:
    """Path without short changes that go back: no board counts down."""
    if levels < 4:
        return states
    states = states.copy()
    changes = changes_of(states)
    for first, last in pairwise(changes):
        if last - first <= _EXCURSION and states[first - 1] == states[last]:
            states[first:last] = states[last]
    return states


def _log_emissions(value: Array, scale: PwmScale) -> Array:
    """Log density of samples on all levels, shape (n, levels), as `_log_seen`."""
    deviation = (value[:, None] - scale.base) / scale.step - np.arange(scale.levels)
    with np.errstate(under="ignore"):
        inside = np.exp(-0.5 * (deviation * scale.step / scale.noise) ** 2)
    glitch = _GLITCH * scale.noise / (100.0 * scale.step)
    return np.asarray(np.log((1.0 - _GLITCH) / math.sqrt(2.0 * math.pi) * inside + glitch))


def plateau_confidence(
    time: Array, value: Array, states: IntArray, edges: IntArray, scale: PwmScale, rate: float
) -> Array:
    """Probability of the level of every stretch between two changes, its neighbours given."""
    levels = np.arange(scale.levels)
    out = np.empty(len(edges) - 1)
    for number, (first, last) in enumerate(pairwise(edges)):
        # More samples make a sure level no surer.
        log_p = _log_emissions(value[first : min(last, first + 200)], scale).sum(axis=0)
        if first > 0:
            table = _log_transition(max(time[first] - time[first - 1], 1e-4), rate, scale.levels)
            log_p += table[(levels - states[first - 1]) % scale.levels]
        if last < len(value):
            table = _log_transition(max(time[last] - time[last - 1], 1e-4), rate, scale.levels)
            log_p += table[(states[last] - levels) % scale.levels]
        with np.errstate(under="ignore"):
            p = np.exp(log_p - log_p.max())
        out[number] = p[states[first]] / p.sum()
    return out


def when_changed(
    time: Array, value: Array, edges: IntArray, levels: tuple[int, int], scale: PwmScale
) -> tuple[float, float]:
    """Time of a change and its sigma, s, over all samples at which it may have been."""
    start, change, end = (int(edge) for edge in edges)
    first, last = max(start, change - _NEAR), min(end, change + _NEAR)
    seen = np.array(
        [
            [_log_seen(x, level, scale.base, scale.step, scale.noise) for level in levels]
            for x in value[first:last]
        ]
    )
    before = np.concatenate([[0.0], np.cumsum(seen[:, 0])])
    after = np.concatenate([np.cumsum(seen[::-1, 1])[::-1], [0.0]])
    # The change lies before sample i, first < i < last: both levels have a sample.
    gap = np.maximum(np.diff(time[first:last]), 1e-6)
    log_p = (before + after)[1:-1] + np.log(gap)
    with np.errstate(under="ignore"):
        p = np.exp(log_p - log_p.max())
    p /= p.sum()
    middle = time[first : last - 1] + 0.5 * gap
    at = float(p @ middle)
    return at, math.sqrt(float(p @ ((middle - at) ** 2 + gap**2 / 12.0)))
