"""Stamps of a log: garbled, out of order, repeated, jittering, with gaps.

Each function takes a log or its times and gives back what is sound and what was found, in words.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.ingest.logs.gnss_values import take
from georef_gis.model.logs import ImuLog, TimedLog

Log = TypeVar("Log", bound=TimedLog)
Mask = NDArray[np.bool_]

# s: a stamp out of order by more is garbled, a fall by more is a clock that starts anew
_FAR = 10.0
_RESET = 1.0
# s on any scale: GPS time of the year 2106
_LATEST = 4e9
# s: a first or last row this far from the rest is garbled
_LONE = 3600.0
# of the interval: scatter of intervals from which stamps are made regular
_JITTER = 0.10
# Noise of the stamps does not grow with the number of intervals: ten of them have the variance of
# one (a tenth of ten times as much); a sensor that really samples unevenly has ten times it.
_TOGETHER, _NOISE_SHARE = 10, 0.5
# s: half of the window of the line through jittering stamps
_HALF_WINDOW = 1.0
# rows: shorter pieces are left as they are
_SHORTEST_PIECE = 20


def place(time: Array, row: int) -> str:
    """Where a row is, for people."""
    return f"{time[row] - time[0]:.2f} s after the first row"


def keep(log: Log, rows: Mask, what: str) -> Log:
    """Rows of a log; the lost ones are counted and the first is placed in the doubts."""
    lost = np.flatnonzero(~rows)
    if not len(lost):
        return log
    doubt = f"{len(lost)} row(s) left out: {what}, first row {lost[0] + 1}"
    kept = take(log, np.flatnonzero(rows))
    return replace(kept, doubts=(*log.doubts, doubt))


def with_time(log: Log) -> Log:
    """Rows whose time can be one."""
    log = keep(log, np.isfinite(log.time), "no time")
    return keep(log, np.abs(log.time) < _LATEST, "impossible time")


def in_order(log: Log) -> Log:
    """Rows whose times rise: garbled stamps and overlapping runs out, small disorder sorted."""
    return sorted_rows(of_one_clock(log))


def of_one_clock(log: Log) -> Log:
    """Rows in the order of the file, without garbled stamps and overlapping runs of a clock."""
    log = with_time(log)
    if len(log) < 2:
        return log
    return _one_run(keep(log, ~_garbled(log.time), "garbled stamp"))


def sorted_rows(log: Log) -> Log:
    """Rows in the order of time; disorder is counted."""
    falls = np.flatnonzero(np.diff(log.time) < 0.0)
    if not len(falls):
        return log
    order = np.argsort(log.time, kind="stable")
    worst = float(-np.min(np.diff(log.time)))
    doubt = (
        f"{len(falls)} stamp(s) out of order by up to {worst * 1e3:.1f} ms, first at row "
        f"{falls[0] + 2}: sorted"
    )
    return replace(take(log, order), doubts=(*log.doubts, doubt))


def _garbled(time: Array) -> Mask:
    """Single stamps that break the order of their neighbours by far."""
    out = np.zeros(len(time), dtype=bool)
    if len(time) < 7:
        return out
    middle = np.median(np.lib.stride_tricks.sliding_window_view(time, 5), axis=1)
    steady = np.concatenate([middle[:1], middle[:1], middle, middle[-1:], middle[-1:]])
    step = np.diff(time)
    breaks = np.concatenate([[False], step < 0.0]) | np.concatenate([step < 0.0, [False]])
    out |= breaks & (np.abs(time - steady) > _FAR)
    out[0] |= abs(step[0]) > _LONE and abs(step[1]) < _LONE
    out[-1] |= abs(step[-1]) > _LONE and abs(step[-2]) < _LONE
    return out


def _one_run(log: Log) -> Log:
    """Where the clock starts anew: the longest run, and those that it does not overlap."""
    time = log.time
    cuts = np.flatnonzero(np.diff(time) < -_RESET) + 1
    if not len(cuts):
        return log
    runs = np.split(np.arange(len(time)), cuts)
    longest = max(runs, key=len)
    low, high = float(np.min(time[longest])), float(np.max(time[longest]))
    rows = np.zeros(len(time), dtype=bool)
    for run in runs:
        if run is longest or np.max(time[run]) < low or np.min(time[run]) > high:
            rows[run] = True
    fall = float(time[cuts[0] - 1] - time[cuts[0]])
    doubt = f"clock reset: time falls by {fall:.1f} s at row {cuts[0] + 1} ({len(cuts)} in all)"
    log = replace(log, doubts=(*log.doubts, doubt))
    return keep(log, rows, "other run of a clock that was reset")


def without_repeats(log: Log, *values: Array) -> Log:
    """Without rows that repeat time and values of the row before."""
    same = np.concatenate([[False], np.diff(log.time) == 0.0]) if len(log) else np.zeros(0, bool)
    for value in values:
        flat = value[:, None] if value.ndim == 1 else value
        equal = (flat[1:] == flat[:-1]) | (np.isnan(flat[1:]) & np.isnan(flat[:-1]))
        same[1:] &= equal.all(axis=1)
    return keep(log, ~same, "time and values of the row before")


def rising(log: Log) -> Log:
    """One row per time: the first of rows with equal stamps."""
    if len(log) < 2:
        return log
    rows = np.concatenate([[True], np.diff(log.time) > 0.0])
    return keep(log, rows, "stamp of the row before, with other values")


def named_gaps(log: Log, least: float) -> Log:
    """Gaps longer than `least`, s, and than three usual intervals, in the doubts."""
    if len(log) < 3:
        return log
    step = np.diff(log.time)
    gaps = np.flatnonzero(step > max(least, 3.0 * float(np.median(step))))
    if not len(gaps):
        return log
    longest = int(gaps[np.argmax(step[gaps])])
    doubt = (
        f"{len(gaps)} gap(s) over {least:g} s, {np.sum(step[gaps]):.2f} s in all, longest "
        f"{step[longest]:.2f} s, {place(log.time, longest)}"
    )
    if len(gaps) > 1:
        doubt += f", first {place(log.time, int(gaps[0]))}"
    return replace(log, doubts=(*log.doubts, doubt))


def regular(log: ImuLog) -> ImuLog:
    """Stamps that the logger made jitter, put back on the steady rate of the sensor.

    Notes
    -----
    Logger's jitter is what both scatters the intervals by over 10 % of their mean and does not add
    up: a late stamp lengthens one interval and shortens the next, so that ten intervals together
    have less than half of ten times the variance of one. Pieces between gaps and lost samples are
    treated apart: each stamp is replaced by the line through the stamps of 1 s on either side,
    those off the line by more than three scatters drawn in. A piece whose line would move a stamp
    by more than a quarter of a second is left as it is.
    """
    mean = _jittering(log.time)
    if mean <= 0.0:
        return log
    time = log.time.copy()
    for piece in _pieces(log.time, mean):
        if len(piece) >= _SHORTEST_PIECE:
            moved = _line(log.time[piece], mean)
            if np.max(np.abs(moved - log.time[piece])) < 0.25 and np.all(np.diff(moved) > 0.0):
                time[piece] = moved
    shift = time - log.time
    if not np.any(shift):
        return log
    doubt = (
        f"stamps jitter by {np.std(shift) * 1e3:.2f} ms (worst {np.max(np.abs(shift)) * 1e3:.1f} "
        f"ms) about a steady {1.0 / mean:.1f} Hz: made regular"
    )
    return replace(log, time=time, doubts=(*log.doubts, doubt))


def steady_in_file_order(log: ImuLog) -> ImuLog:
    """Samples in order of time, with regular stamps.

    A stamp that comes late may stand after its neighbour's: then the file has the order of the
    samples and sorting would swap them. Where the sorted stamps are steady, they are believed.
    """
    in_time = sorted_rows(log)
    if in_time is log or _jittering(in_time.time) <= 0.0:
        return regular(in_time)
    return sorted_rows(regular(log))


def _jittering(time: Array) -> float:
    """Mean interval, s, of stamps that a logger made jitter; 0 where it did not."""
    if len(time) < _SHORTEST_PIECE:
        return 0.0
    step = np.diff(time)
    usual = float(np.median(step[step > 0.0])) if np.any(step > 0.0) else 0.0
    mean = _mean_interval(step, usual)
    return mean if mean > 0.0 and _is_noise(step, mean) else 0.0


def _mean_interval(step: Array, usual: float) -> float:
    """Mean of the intervals that are no gaps: bursts have a median far from it."""
    near = step[step < max(0.1, 10.0 * usual)]
    return float(np.mean(near)) if len(near) else 0.0


def _is_noise(step: Array, mean: float) -> bool:
    near = step < max(0.1, 10.0 * mean)
    off = np.where(near, step - mean, 0.0)
    variance = float(np.mean(off[near] ** 2))
    if np.sqrt(variance) < _JITTER * mean or len(step) <= _TOGETHER:
        return False
    sums, holes = np.cumsum(off), np.cumsum(~near)
    whole = holes[_TOGETHER:] == holes[:-_TOGETHER]
    spread = (sums[_TOGETHER:] - sums[:-_TOGETHER])[whole]
    return len(spread) > 0 and float(np.var(spread)) < _NOISE_SHARE * _TOGETHER * variance


def _pieces(time: Array, mean: float) -> list[NDArray[np.intp]]:
    """Rows between gaps and lost samples.

    A lost sample shifts all later stamps by one interval; noise does not: medians of ten rows on
    either side tell them apart.
    """
    ahead = time - mean * np.arange(len(time))
    step = np.diff(time)
    cuts = np.flatnonzero(step > max(0.1, 10.0 * mean)) + 1
    if len(time) > 30:
        level = np.median(np.lib.stride_tricks.sliding_window_view(ahead, 10), axis=1)
        jump = level[10:] - level[:-10]
        usual = 1.4826 * float(np.median(np.abs(jump - np.median(jump))))
        rows = np.flatnonzero(jump > max(0.7 * mean, 5.0 * usual)) + 10
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
            # the longest interval nearby is where the samples are missing
            first = max(0, int(run[0]) - 5)
            cuts = np.append(cuts, first + int(np.argmax(step[first : int(run[-1]) + 5])) + 1)
    return np.split(np.arange(len(time)), np.unique(cuts))


def _line(time: Array, mean: float) -> Array:
    """Moving line through stamps at steady index."""
    count = len(time)
    index = np.arange(count, dtype=np.float64)
    rate = float(np.polyfit(index, time - time[0], 1)[0])
    ahead = time - time[0] - rate * index
    half = int(min(count // 2 - 1, max(10, round(_HALF_WINDOW / mean))))
    level = _moving(ahead, half)
    off = ahead - level
    scatter = 1.4826 * float(np.median(np.abs(off - np.median(off))))
    if scatter > 0.0:
        ahead = level + np.clip(off, -3.0 * scatter, 3.0 * scatter)
        level = _moving(ahead, half)
    return np.asarray(time[0] + rate * index + level)


def _moving(values: Array, half: int) -> Array:
    """Mean over windows of 2 half + 1, narrower and still centred towards the ends."""
    count = len(values)
    total = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(count)
    reach = np.asarray(np.minimum(half, np.minimum(at, count - 1 - at)), dtype=np.int64)
    # a window of a few rows at an end would keep the jitter: the line of the first window instead
    out = np.asarray((total[at + reach + 1] - total[at - reach]) / (2 * reach + 1))
    for ends in (slice(0, half), slice(count - half, count)):
        x = at[ends] - float(np.mean(at[ends]))
        slope = float(x @ values[ends]) / max(1e-12, float(x @ x))
        out[ends] = np.mean(values[ends]) + slope * x
    return np.asarray(out)
