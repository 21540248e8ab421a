"""Which clock offsets bring photos and events together, and how probable each of them is.

Regular triggers fit nearly as well when all are shifted by one: every offset that fits is kept as
a hypothesis of its own, and the posterior of a pair is summed over all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.navigate.clock_fit import OffsetPrior, Posterior, integrate
from georef_gis.navigate.sequence_match import (
    Columns,
    IntArray,
    PairModel,
    Rows,
    log_null,
    vote,
)

# offsets looked at, looked at closely, and integrated over
_MOST_VOTED, _MOST_KEPT, _MOST_FITTED = 60, 14, 6
# log odds to the best at which a hypothesis is dropped, is not looked at closely
_DROP, _NEGLIGIBLE = 60.0, 40.0
# s, one sigma of the latency for a first look
_ROUGH_JITTER = 0.12
# log evidence that a vote is worth, for sorting only
_VOTE = 5.0
# Probability before that photos and events are not of one flight
_UNRELATED = 0.01
# factors of the latency's sigma that are tried, and one sigma of their logarithm before
_JITTERS, _LOG_JITTER_SIGMA = (0.5, 1.0, 2.0, 4.0), 0.5
# A gap in numbers wider than this is another day, not deleted photos.
_WIDEST_GAP = 200
# Largest value, and first value after it, of counters that wrap
_WRAPS = ((255, 0), (999, 1), (9999, 1), (65535, 0), (99999, 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """A clock, its probability, and the pairs under it: photo, event, posterior, each (k,).

    `share`, one a photo and one an event, says what each adds to the log evidence.
    """

    offset: float
    drift: float
    covariance: Array
    log_evidence: float
    # the part of it that was believed of the offset beforehand
    log_prior: float = 0.0
    probability: float = 1.0
    photo: IntArray
    event: IntArray
    posterior: Array
    share: Array

    def assignment(self, photos: int) -> IntArray:
        """Most probable event of each photo under this clock, -1 where none; shape (n,)."""
        event = np.full(photos, -1, np.int64)
        sure = self.posterior > 0.5
        event[self.photo[sure]] = self.event[sure]
        return event


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sequences:
    """Both sequences with the exposures that only the numbering tells of; index -1 is such."""

    model: PairModel
    row_of: IntArray
    column_of: IntArray


def steps_of(number: IntArray) -> IntArray:
    """How far a counter goes on from each entry to the next; shape (n,) -> (n - 1,).

    1 where it tells nothing: no number (-1), the same again, or a jump too wide. Wrapping is
    undone (9999 -> 1, 255 -> 0). All 1 where the numbers are not in order.
    """
    a, b = number[:-1], number[1:]
    step = b - a
    top = int(number.max(initial=-1))
    for largest, start in _WRAPS:
        if top <= largest:
            step = np.where(step < 0, step + largest - start + 1, step)
            break
    told = (a >= 0) & (b >= 0)
    plain = told & (step >= 1) & (step <= _WIDEST_GAP)
    if np.sum(plain) < 0.7 * np.sum(told):
        return np.ones(max(0, len(number) - 1), np.int64)
    return np.where(plain, step, 1).astype(np.int64)


def with_gaps(number: IntArray, most: int) -> IntArray:
    """Indices of entries, with -1 for every number left out; at most `most` of these."""
    step = steps_of(number)
    if np.sum(step - 1) > most:
        step = np.ones_like(step)
    out: list[int] = [0] if len(number) else []
    for i, s in enumerate(step, 1):
        out += [-1] * int(s - 1) + [i]
    return np.array(out, np.int64)


def sequences(
    photos: Rows, photo_number: IntArray, events: Columns, event_number: IntArray, base: PairModel
) -> Sequences:
    """Model of both sequences; numbers left out become exposures of unknown time."""
    n, m = len(photos.reading), len(events.time)
    row_of = with_gaps(photo_number, max(50, m))
    column_of = with_gaps(event_number, max(50, n))
    r, c = np.maximum(row_of, 0), np.maximum(column_of, 0)
    rows = Rows(
        reading=np.where(row_of >= 0, photos.reading[r], np.nan),
        resolution=photos.resolution[r],
        key=np.where(row_of >= 0, photos.key[r], -1),
    )
    columns = Columns(
        time=np.where(column_of >= 0, events.time[c], np.nan),
        sigma=events.sigma[c],
        key=np.where(column_of >= 0, events.key[c], -1),
    )
    model = replace(base, rows=rows, columns=columns)
    return Sequences(model=model, row_of=row_of, column_of=column_of)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Findings:
    """Hypotheses, most probable first; `unseen` is the probability of those not looked at closely.

    What lacks to 1 is the probability that photos and events are not of one flight. `jitter` is
    the latency's sigma, s.
    """

    hypotheses: tuple[Hypothesis, ...]
    unseen: float
    jitter: float


def find_hypotheses(seq: Sequences, prior: OffsetPrior, drift_sigma: float) -> Findings:
    """Clocks that bring the sequences together."""
    model = seq.model
    if not np.any(np.isfinite(model.rows.reading)):
        return Findings(hypotheses=(_by_order(seq),), unseen=0.0, jitter=model.jitter)
    ranges = _ranges(model, prior)
    rough = _first_look(replace(model, jitter=_ROUGH_JITTER), ranges, prior)
    order = np.argsort(-rough, kind="stable")
    model = _with_fitted_jitter(model, ranges[order[0]], prior)
    kept = [k for k in order[:_MOST_KEPT] if rough[k] > rough[order[0]] - _DROP]
    coarse = np.array([_row_evidence(model, ranges[k], prior) for k in kept])
    rank = np.argsort(-coarse, kind="stable")
    near = [k for k in rank[:_MOST_FITTED] if coarse[k] >= coarse[rank[0]] - _NEGLIGIBLE]
    found = [_fitted(seq, model, ranges[kept[k]], prior, drift_sigma) for k in near]
    behind = np.r_[
        coarse[rank[0]] - coarse[rank[len(near):]], rough[order[0]] - rough[order[len(kept):]]
    ]  # fmt: skip
    hypotheses, unseen = _with_probabilities(found, behind, model)
    return Findings(hypotheses=hypotheses, unseen=unseen, jitter=model.jitter)


def _by_order(seq: Sequences) -> Hypothesis:
    """The only hypothesis where no photo has a clock: order and numbers alone."""
    photo, event, p, _ = _real_pairs(seq, seq.model, 0.0, 0.0)
    return Hypothesis(
        offset=math.nan,
        drift=math.nan,
        covariance=np.full((2, 2), np.nan),
        log_evidence=0.0,
        photo=photo,
        event=event,
        posterior=p,
        share=np.zeros(0),
    )


def _real_pairs(
    seq: Sequences, model: PairModel, offset: float, drift: float
) -> tuple[IntArray, IntArray, Array, Array]:
    """Photo, event, posterior and log weight of pairs under a clock."""
    row, column, p, weight = model.posterior(offset, drift)
    photo, event = seq.row_of[row], seq.column_of[column]
    real = (photo >= 0) & (event >= 0)
    return photo[real], event[real], p[real], np.log(weight[real])


def _ranges(model: PairModel, prior: OffsetPrior) -> Array:
    """Ranges of offsets, s, that hold a fit each, apart from one another; shape (k, 2)."""
    reading, res = model.rows.reading, model.rows.resolution
    known = np.isfinite(reading)
    times = model.columns.time[np.isfinite(model.columns.time)]
    width = float(np.max(res[known])) + 8.0 * model.jitter
    middle, votes = vote(reading[known], times, width, 4 * _MOST_VOTED)
    middle = middle + 0.5 * float(np.median(res[known]))
    score = _VOTE * votes + prior.log_density(middle)
    middle = np.sort(middle[np.argsort(-score, kind="stable")[:_MOST_VOTED]])
    half = 0.5 * (middle[1:] + middle[:-1])
    reach = 0.75 * width
    low = np.maximum(middle - reach, np.r_[-np.inf, half])
    high = np.minimum(middle + reach, np.r_[half, np.inf])
    return np.stack([low, high], axis=1)


def _first_look(model: PairModel, ranges: Array, prior: OffsetPrior) -> Array:
    middle = ranges.mean(axis=1)
    return model.log_evidence(middle, np.zeros_like(middle)) + prior.log_density(middle)


def _row_evidence(model: PairModel, span: Array, prior: OffsetPrior) -> float:
    """Log evidence of a range of offsets without drift."""
    row = np.linspace(span[0], span[1], max(9, math.ceil((span[1] - span[0]) / model.jitter)))
    ll = model.log_evidence(row, np.zeros_like(row)) + prior.log_density(row)
    top = float(ll.max())
    if not np.isfinite(top):
        return -np.inf
    return top + math.log(float(np.exp(ll - top).sum()) * (row[1] - row[0]))


def _with_fitted_jitter(model: PairModel, span: Array, prior: OffsetPrior) -> PairModel:
    """Model with the latency's sigma that suits the best hypothesis."""
    tried = [replace(model, jitter=model.jitter * factor) for factor in _JITTERS]
    score = [
        _row_evidence(one, span, prior) - 0.5 * (math.log(factor) / _LOG_JITTER_SIGMA) ** 2
        for one, factor in zip(tried, _JITTERS, strict=True)
    ]
    return tried[int(np.argmax(score))]


def _fitted(
    seq: Sequences, model: PairModel, span: Array, prior: OffsetPrior, drift_sigma: float
) -> Hypothesis:
    def log_density(o: Array, d: Array) -> Array:
        return model.log_evidence(o, d) + prior.log_density(o)

    found = integrate(
        log_density, span[0], span[1], drift_sigma=drift_sigma, step=0.7 * model.jitter
    )
    mean = found.mean()
    photo, event, p = _averaged_pairs(seq, model, found)
    share = _shares(seq, _real_pairs(seq, model, float(mean[0]), float(mean[1])))
    return Hypothesis(
        offset=float(mean[0]),
        drift=float(mean[1]),
        covariance=found.covariance(),
        log_evidence=found.log_evidence,
        log_prior=float(prior.log_density(mean[0])),
        photo=photo,
        event=event,
        posterior=p,
        share=share,
    )


def _averaged_pairs(
    seq: Sequences, model: PairModel, clock: Posterior
) -> tuple[IntArray, IntArray, Array]:
    """Pairs at three offsets that stand for the posterior (Gauss-Hermite), averaged."""
    mean, sd = clock.mean(), math.sqrt(float(clock.covariance()[0, 0]))
    parts = []
    for k, weight in ((-1, 1.0 / 6.0), (0, 2.0 / 3.0), (1, 1.0 / 6.0)):
        offset = float(mean[0] + k * math.sqrt(3.0) * sd)
        photo, event, p, _ = _real_pairs(seq, model, offset, float(mean[1]))
        parts.append((photo, event, weight * p))
    photo, event, p = (np.concatenate(x) for x in zip(*parts, strict=True))
    return summed(photo, event, p)


def summed(photo: IntArray, event: IntArray, p: Array) -> tuple[IntArray, IntArray, Array]:
    """Every pair once, with the sum of its parts."""
    span = int(event.max(initial=0)) + 1
    key, place = np.unique(photo * span + event, return_inverse=True)
    total = np.asarray(np.bincount(place, weights=p, minlength=len(key)), np.float64)
    return np.asarray(key // span), np.asarray(key % span), total


def _shares(seq: Sequences, pairs: tuple[IntArray, IntArray, Array, Array]) -> Array:
    """What every photo and then every event adds to the log evidence; shape (n + m,)."""
    photo, event, p, log_weight = pairs
    n, m = int(seq.row_of.max()) + 1, int(seq.column_of.max()) + 1
    paired = np.bincount(photo, weights=p, minlength=n)
    seen = np.bincount(event, weights=p, minlength=m)
    of_photos = np.bincount(photo, weights=p * log_weight, minlength=n)
    of_photos = of_photos + (1.0 - paired) * math.log(seq.model.missed)
    return np.asarray(np.r_[of_photos, (1.0 - seen) * math.log(seq.model.spurious)])


def _with_probabilities(
    found: Sequence[Hypothesis], others: Array, model: PairModel
) -> tuple[tuple[Hypothesis, ...], float]:
    """Hypotheses with their probabilities beside that of no relation, and that of the others.

    `others` says how far, in log evidence, those that were not fitted are behind the best.

    Notes
    -----
    The model takes exposures as a Poisson process; triggers are more regular. In a regular
    sequence the difference of two shifted fits is a sum of chance terms, or of one stray event
    that falls into the gap of a missed one. As in Vuong's test (Econometrica 57, 1989) a
    difference counts only as far as it exceeds the scatter of the single terms. What is known
    of the clock beforehand is no chance term and counts in full.
    """
    null = math.log(_UNRELATED) + log_null(model)
    logs = np.array([h.log_evidence for h in found])
    best = found[int(np.argmax(logs))]
    scatter = np.array([math.sqrt(float(np.sum((best.share - h.share) ** 2))) for h in found])
    usual = float(np.median(scatter[scatter > 0.0])) if np.any(scatter > 0.0) else 0.0
    top = float(logs.max())
    known = best.log_prior - np.array([h.log_prior for h in found])
    matched = best.log_evidence - logs - known
    near = np.r_[np.maximum(0.0, matched - scatter) + known, np.maximum(0.0, others - usual)]
    log_p = np.r_[-near, null - top]
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    out = [replace(h, probability=float(q)) for h, q in zip(found, p, strict=False)]
    return tuple(sorted(out, key=lambda h: -h.probability)), float(p[len(found) : -1].sum())
