"""Pass, fail, or cannot tell: what a measured length says of a requirement, by probability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import ndtr

from georef_gis.frames import Array

Verdict = Literal["pass", "fail", "cannot tell"]
# Probability from which there is an answer: that a requirement is met, or that a limit is missed.
CERTAIN = 0.95
_DRAWS = 20_000
_SEED = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What the screening says of one requirement; lengths in m.

    Parameters
    ----------
    check
        What is looked at, such as "taper length".
    subject
        Of what, such as "T1" or "T1: C03 to C04".
    low, high
        Limits, either may be infinite.
    sigma
        One sigma of `value` against the limits.
    probability
        That the requirement is met.
    sigma_needed
        The sigma with which `value` would have an answer; 0 = none would do.
    source
        Place in the manual.
    note
        What the answer depends on.
    part
        Whether it belongs to the finding on several before it.
    """

    check: str
    subject: str
    value: float
    sigma: float
    low: float
    high: float
    probability: float
    verdict: Verdict
    sigma_needed: float
    source: str = ""
    note: str = ""
    part: bool = False


def probability_within(value: float, sigma: float, low: float, high: float) -> float:
    """Probability that a length measured as `value` lies within limits, by a normal error."""
    if sigma == 0.0:
        return float(low <= value <= high)
    return float(ndtr((high - value) / sigma) - ndtr((low - value) / sigma))


def verdict_of(value: float, sigma: float, low: float, high: float) -> Verdict:
    """Answer that a length measured as `value` allows.

    Notes
    -----
    It fails if one of its limits is missed for certain: between two limits a length of poor
    accuracy is unlikely to lie, wherever it was measured, and that is no answer.
    """
    if probability_within(value, sigma, low, high) >= CERTAIN:
        return "pass"
    below = 1.0 - probability_within(value, sigma, low, math.inf)
    above = 1.0 - probability_within(value, sigma, -math.inf, high)
    return "fail" if max(below, above) >= CERTAIN else "cannot tell"


def verdict_of_all(probability: float, single: Sequence[float]) -> Verdict:
    """Answer on several requirements at once.

    Parameters
    ----------
    probability
        That all are met.
    single
        Of each.

    Notes
    -----
    It fails if one of them does, with the error rate shared among all (Bonferroni): of many that
    are each uncertain one is likely missed, but none is known to be.
    """
    if probability >= CERTAIN:
        return "pass"
    return "fail" if min(single) * len(single) <= 1.0 - CERTAIN else "cannot tell"


def sigma_needed(value: float, low: float, high: float) -> float:
    """Largest sigma with which `value` has an answer; infinite if any has, 0 if none has."""
    if low == -math.inf and high == math.inf:
        return math.inf
    distance = min(abs(value - low), abs(high - value))
    if distance == 0.0:
        return 0.0
    # P(one-sided) = 0.95 at 1.645 sigma; a second limit can only ask for less.
    bottom, top = 0.0, distance / 1.6
    for _ in range(60):
        middle = (bottom + top) / 2.0
        is_told = verdict_of(value, middle, low, high) != "cannot tell"
        bottom, top = (middle, top) if is_told else (bottom, middle)
    return bottom


def probability_of_all(values: Array, covariance: Array, low: Array, high: Array) -> float:
    """Probability that several lengths lie within their limits at once.

    Parameters
    ----------
    values, low, high : shape (n,), m
    covariance : shape (n, n), m^2

    Notes
    -----
    By draws from the joint normal, always the same ones, held within the bounds that the single
    probabilities set: the least of them, and one less the sum of their complements.
    """
    sigmas = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    single = [
        probability_within(*one) for one in zip(values, sigmas, low, high, strict=True)
    ]  # fmt: skip
    most = min(single, default=1.0)
    least = max(0.0, 1.0 - sum(1.0 - p for p in single))
    if most - least < 1e-6:
        return most
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.clip(eigenvalues, 0.0, None))
    draws = np.random.default_rng(_SEED).standard_normal((_DRAWS, len(values))) @ root.T + values
    met = np.mean(np.all((draws >= low) & (draws <= high), axis=1))
    return float(np.clip(met, least, most))
