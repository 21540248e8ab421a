"""When every photo was exposed, and which noted event belongs to it, with how sure that is.

With events, both sequences are aligned (`exposure_hypotheses`); without, the camera's clock tells,
once its offset is known from GPS times in tags, from positions (`position_clock`) or from the user.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.logs import EventLog
from georef_gis.navigate.clock_fit import ClockFit, OffsetPrior, clock_of_tag_times
from georef_gis.navigate.exposure_hypotheses import (
    Findings,
    Hypothesis,
    find_hypotheses,
    sequences,
    summed,
)
from georef_gis.navigate.exposure_values import (
    ExposureTimes,
    MatchOptions,
    PhotoClock,
    file_number,
)
from georef_gis.navigate.sequence_match import Columns, IntArray, PairModel, Rows

__all__ = ["ExposureTimes", "MatchOptions", "PhotoClock", "file_number", "match_exposures"]

# A hypothesis as probable as this is named.
_NAMED = 0.002
# Confidence of a pair that the device noted by name
_BY_NAME = 0.9999
# s; one sigma of an event that states none, and the least that is believed
_EVENT_SIGMA, _LEAST_SIGMA = 0.01, 1e-4
# s; a resolution finer than this says nothing beside the latency
_FINEST = 1e-3
# s; a stamp of the last fix is older than the exposure
_TAG_SIGMA = 0.6


def match_exposures(
    photos: Sequence[PhotoClock],
    events: EventLog | None = None,
    options: MatchOptions | None = None,
    *,
    clock: ClockFit | None = None,
) -> ExposureTimes:
    """Time of every photo, from its event where there are events.

    Parameters
    ----------
    photos
        In the order of exposure.
    events
        Of one kind; None: from the camera clock alone.
    options
    clock
        Offset found otherwise, e.g. from positions.

    Raises
    ------
    InputError
        If there are no photos, or neither events nor anything that tells the clock's offset.
    """
    if not photos:
        raise InputError("there are no photos to match; check the folder", source="photos")
    options = options or MatchOptions()
    table = _table(photos)
    known = _known_clock(table, options, clock)
    usable = None if events is None else _usable(events, options)
    if events is None or usable is None:
        result = _by_clock(table, known)
        if events is not None:
            doubt = f"{events.source or 'the log'} holds no usable event: times from the clock"
            result = replace(result, doubts=(doubt, *result.doubts))
        return result
    return _by_events(photos, table, events, usable, options, known)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Table:
    """Photos as arrays (n,), NaN where unknown; the clock as it is, and as far as in order."""

    clock: Array
    ordered: Array
    resolution: Array
    tag: Array
    tag_sigma: Array
    number: IntArray
    doubts: tuple[str, ...]


def _table(photos: Sequence[PhotoClock]) -> _Table:
    clock = np.array([np.nan if p.clock is None else p.clock for p in photos], np.float64)
    clock[~np.isfinite(clock)] = np.nan
    tag = np.array([np.nan if p.time_gps is None else p.time_gps for p in photos], np.float64)
    sigma = np.array([p.time_sigma or _TAG_SIGMA for p in photos], np.float64)
    keep = _in_order(clock)
    back = np.isfinite(clock) & ~keep
    doubts = []
    if np.any(back):
        first = photos[int(np.argmax(back))].name
        doubts.append(
            f"the camera clock of {int(back.sum())} photos (first {first}) is not in order with "
            "the others: set anew during the flight, or photos of two cameras?"
        )
    return _Table(
        clock=clock,
        ordered=np.where(keep, clock, np.nan),
        resolution=np.array([max(p.resolution, _FINEST) for p in photos], np.float64),
        tag=tag,
        tag_sigma=sigma,
        number=np.array([-1 if p.number is None else p.number for p in photos], np.int64),
        doubts=tuple(doubts),
    )


def _in_order(clock: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Longest part of the clocks that does not go back; NaN is left out."""
    tails: list[float] = []
    ends: list[int] = []
    before = np.full(len(clock), -1)
    for i, c in enumerate(clock):
        if np.isnan(c):
            continue
        k = bisect_right(tails, float(c))
        before[i] = ends[k - 1] if k else -1
        tails[k:k + 1], ends[k:k + 1] = [float(c)], [i]  # fmt: skip
    keep = np.zeros(len(clock), np.bool_)
    i = ends[-1] if ends else -1
    while i >= 0:
        keep[i] = True
        i = int(before[i])
    return keep


def _known_clock(table: _Table, options: MatchOptions, clock: ClockFit | None) -> ClockFit | None:
    """Clock that is known before events are looked at: the user's, the given, or the tags'."""
    if options.offset is not None:
        readings = table.clock[np.isfinite(table.clock)]
        middle = float(np.median(readings)) - options.offset if len(readings) else 0.0
        return ClockFit(
            offset=options.offset,
            epoch=middle,
            covariance=np.diag([options.offset_sigma**2, options.drift_sigma**2]),
            source="the user",
        )
    if clock is not None:
        return clock
    return clock_of_tag_times(table.clock, table.resolution, table.tag, table.tag_sigma)


def _by_clock(table: _Table, clock: ClockFit | None) -> ExposureTimes:
    if clock is None and not np.any(np.isfinite(table.tag)):
        raise InputError(
            "no events, no GPS time in the tags and no clock offset: nothing tells when the "
            "photos were taken; give a log with events, or the camera clock's offset",
            source="photos",
        )
    time, sigma, source = _clock_times(table, clock, 0.0)
    known = np.isfinite(time)
    surely = 1.0 if clock is None else clock.confidence
    return ExposureTimes(
        time=time,
        sigma=sigma,
        source=source,
        event=np.full(len(time), -1, np.int64),
        confidence=np.where(known, surely, 0.0),
        clock=clock,
        jitter=0.0,
        alternatives=clock.alternatives if clock else (),
        doubts=(*table.doubts, *(clock.doubts if clock else ())),
    )


def _clock_times(
    table: _Table, clock: ClockFit | None, jitter: float
) -> tuple[Array, Array, tuple[str, ...]]:
    """Times by the clock, or by a photo's own GPS tag where that is better."""
    n = len(table.clock)
    time, sigma = np.full(n, np.nan), np.full(n, np.nan)
    if clock is not None:
        time = clock.gps(table.clock + 0.5 * table.resolution)
        sigma = np.sqrt(
            clock.sigma_at(time) ** 2 + table.resolution**2 / 12.0 + jitter**2
        )  # fmt: skip
    tag = np.isfinite(table.tag) & ~(table.tag_sigma >= sigma)
    source = tuple(
        "tag" if by_tag else "clock" if np.isfinite(t) else ""
        for by_tag, t in zip(tag, time, strict=True)
    )
    return np.where(tag, table.tag, time), np.where(tag, table.tag_sigma, sigma), source


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Usable:
    """Events in order of time, the lag added, with their indices in the log."""

    index: IntArray
    time: Array
    sigma: Array
    doubts: tuple[str, ...]


def _usable(events: EventLog, options: MatchOptions) -> _Usable | None:
    finite = np.flatnonzero(np.isfinite(events.time))
    index = finite[np.argsort(events.time[finite], kind="stable")]
    t, seq = events.time[index], events.sequence[index]
    again = np.r_[False, (np.diff(t) < 1e-6) & (np.diff(seq) == 0)] if len(t) else t > 0
    doubts = []
    if len(finite) < len(events.time):
        doubts.append(f"{len(events.time) - len(finite)} events have no time: left out")
    if np.any(again):
        doubts.append(f"{int(again.sum())} events are noted twice: counted once")
    if events.scale != "gps":
        doubts.append("the events have no GPS time: exposures stay on the logger's own scale")
    index = index[~again]
    if not len(index):
        return None
    sigma = np.where(np.isfinite(events.sigma[index]), events.sigma[index], _EVENT_SIGMA)
    return _Usable(
        index=index,
        time=events.time[index] + options.lag,
        sigma=np.maximum(sigma, _LEAST_SIGMA),
        doubts=tuple(doubts),
    )


def _prior(known: ClockFit | None, options: MatchOptions) -> OffsetPrior:
    if known is None:
        return OffsetPrior()
    if options.offset is not None:
        return OffsetPrior(value=options.offset, sigma=options.offset_sigma, trust=0.999)
    return OffsetPrior(
        value=known.offset, sigma=max(known.sigma, 0.05), trust=0.99 * known.confidence
    )


def _keys(names: Sequence[str], others: Sequence[str]) -> IntArray:
    """A number for every name that both sides hold once, -1 for the others."""
    mine, theirs = ([PurePath(x).stem.casefold() for x in side] for side in (names, others))
    common = sorted(
        x for x in set(mine) & set(theirs) if x and mine.count(x) == 1 == theirs.count(x)
    )
    number = {x: k for k, x in enumerate(common)}
    return np.array([number.get(x, -1) for x in mine], np.int64)


def _by_events(
    photos: Sequence[PhotoClock], table: _Table, events: EventLog, usable: _Usable,
    options: MatchOptions, known: ClockFit | None,
) -> ExposureTimes:  # fmt: skip
    names = [p.name for p in photos]
    noted = [events.names[i] for i in usable.index] if events.names else []
    row_key = _keys(names, noted)
    column_key = _keys(noted, names) if noted else np.full(len(usable.time), -1, np.int64)
    off = np.full(1, -1, np.int64)
    use = options.use_numbers
    interval = float(np.median(np.diff(usable.time))) if len(usable.time) > 1 else 10.0
    rows = Rows(reading=table.ordered, resolution=table.resolution, key=row_key)
    columns = Columns(time=usable.time, sigma=usable.sigma, key=column_key)
    seq = sequences(
        rows,
        table.number if use else np.repeat(off, len(photos)),
        columns,
        events.sequence[usable.index] if use else np.repeat(off, len(usable.time)),
        PairModel(
            rows=rows,
            columns=columns,
            missed=options.missed,
            spurious=options.spurious,
            rate=1.0 / max(interval, 0.05),
            jitter=options.jitter,
            epoch=float(np.median(usable.time)),
        ),
    )
    found = find_hypotheses(seq, _prior(known, options), options.drift_sigma)
    return _assembled(table, usable, row_key, found, seq.model.epoch, options)


def _assembled(
    table: _Table, usable: _Usable, row_key: IntArray, found: Findings, epoch: float,
    options: MatchOptions,
) -> ExposureTimes:  # fmt: skip
    n, m = len(table.clock), len(usable.time)
    likely, jitter = found.hypotheses, found.jitter
    photo, event, p = summed(
        np.concatenate([h.photo for h in likely]),
        np.concatenate([h.event for h in likely]),
        np.concatenate([h.probability * h.posterior for h in likely]),
    )
    paired = np.bincount(photo, weights=p, minlength=n)
    none = np.clip(1.0 - found.unseen - paired, 0.0, 1.0)
    best, chosen = none.copy(), np.full(n, -1, np.int64)
    for i, j, q in zip(photo, event, p, strict=True):
        if q > best[i]:
            best[i], chosen[i] = q, j
    clock = _clock_fit(likely[0], epoch, options)
    time, sigma, source = _clock_times(table, clock, jitter)
    hit = chosen >= 0
    time[hit] = usable.time[chosen[hit]]
    sigma[hit] = np.hypot(usable.sigma[chosen[hit]], options.lag_sigma)
    by_name = hit & (row_key >= 0)
    taken = np.bincount(event, weights=p, minlength=m)
    words = _alternatives(found, n)
    doubts = [*table.doubts, *usable.doubts]
    if 2 * np.sum(hit) < n:
        doubts.append(f"only {int(hit.sum())} of {n} photos have an event: is it their log?")
    return ExposureTimes(
        time=time,
        sigma=sigma,
        source=tuple(
            "event name" if a else "event" if b else s
            for a, b, s in zip(by_name, hit, source, strict=True)
        ),
        event=np.where(hit, usable.index[np.maximum(chosen, 0)], -1),
        confidence=np.where(by_name, np.minimum(best, _BY_NAME), best),
        clock=clock,
        jitter=jitter,
        missed=tuple(int(i) for i in np.flatnonzero(~hit)),
        spurious=tuple(int(i) for i in np.sort(usable.index[taken < 0.5])),
        alternatives=words,
        doubts=tuple(doubts),
    )


def _clock_fit(best: Hypothesis, epoch: float, options: MatchOptions) -> ClockFit | None:
    if not math.isfinite(best.offset):
        return None
    covariance = best.covariance + np.diag([options.lag_sigma**2, 0.0])
    return ClockFit(
        offset=best.offset,
        drift=best.drift,
        epoch=epoch,
        covariance=covariance,
        source="events",
        confidence=best.probability,
    )


def _alternatives(findings: Findings, n: int) -> tuple[str, ...]:
    """Other hypotheses worth naming, in words."""
    found = findings.hypotheses
    first = found[0].assignment(n)
    words = []
    for h in found[1:]:
        if h.probability < _NAMED:
            continue
        other = h.assignment(n)
        both = (first >= 0) & (other >= 0)
        shift = int(np.round(np.median(other[both] - first[both]))) if np.any(both) else 0
        what = f"a shift by {shift:+d} event{'s' * (abs(shift) != 1)}" if shift else "another clock"
        well = "nearly as well" if h.probability > 0.1 else "too"
        words.append(
            f"{what} (clock offset {h.offset:.2f} s instead of {found[0].offset:.2f} s) fits "
            f"{well}, with a confidence of {h.probability:.3f}"
        )
    if findings.unseen > _NAMED:
        words.append(f"other clocks fit, too, with a confidence of {findings.unseen:.3f} together")
    unrelated = 1.0 - findings.unseen - sum(h.probability for h in found)
    if unrelated > _NAMED:
        words.append(f"photos and events may be of different flights (confidence {unrelated:.3f})")
    return tuple(words)
