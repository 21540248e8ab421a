"""Errors along one axis: mean and its t-test, RMSE, shape of the distribution, outliers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array

# Share of the target RMSE above which a mean error is to be investigated (7.2)
MEAN_SHARE = 0.25
# Times the target RMSE above which an error is a blunder (7.2)
BLUNDER = 3.0
# Modified z-score above which a value is an outlier (Iglewicz and Hoaglin 1993)
ROBUST_Z = 3.5
# Two-sided level of the tests
LEVEL = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisStatistics:
    """Errors along one axis, m.

    Parameters
    ----------
    sd
        About the mean, n - 1; NaN for one point.
    t, p
        Student's two-sided test of a mean of zero; NaN for one point.
    skewness
        Bias-corrected; NaN below three points.
    normality_p
        Of Shapiro and Wilk's test; NaN below three points.
    outliers, blunders
        Points beyond `ROBUST_Z`, and beyond `BLUNDER` times the target.
    target
        Declared RMSE of this axis, or None.
    """

    axis: str
    n: int
    mean: float
    median: float
    sd: float
    rmse: float
    minimum: float
    maximum: float
    t: float
    p: float
    skewness: float
    normality_p: float
    outliers: tuple[str, ...] = ()
    blunders: tuple[str, ...] = ()
    target: float | None = None

    @property
    def mean_share(self) -> float:
        """Mean error as a share of the target RMSE, or of the RMSE found if none was declared."""
        reference = self.rmse if self.target is None else self.target
        return abs(self.mean) / reference if reference > 0 else 0.0

    @property
    def is_biased(self) -> bool:
        """Whether the mean is to be investigated and reported (7.2)."""
        return self.mean_share > MEAN_SHARE

    @property
    def is_significant(self) -> bool:
        """Whether chance alone hardly gives this mean."""
        return self.p < LEVEL


def axis_statistics(
    names: Sequence[str], errors: Array, axis: str, *, target: float | None = None
) -> AxisStatistics:
    """Statistics of one named error or more along axis x, y or z; shape (n,), m."""
    t, p = t_test(errors)
    z = robust_z(errors)
    limit = math.inf if target is None else BLUNDER * target
    return AxisStatistics(
        axis=axis,
        n=len(errors),
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        sd=float(errors.std(ddof=1)) if len(errors) > 1 else math.nan,
        rmse=rms(errors),
        minimum=float(errors.min()),
        maximum=float(errors.max()),
        t=t,
        p=p,
        skewness=_skewness(errors),
        normality_p=_normality(errors),
        outliers=tuple(n for n, value in zip(names, z, strict=True) if abs(value) > ROBUST_Z),
        blunders=tuple(n for n, value in zip(names, errors, strict=True) if abs(value) > limit),
        target=target,
    )


def rms(errors: Array) -> float:
    """Root mean square; shape (n,); NaN for none."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else math.nan


def t_test(errors: Array) -> tuple[float, float]:
    """Student's t of a mean of zero and its two-sided p; shape (n,); NaN below two values."""
    from scipy.special import stdtr

    n = len(errors)
    if n < 2:
        return math.nan, math.nan
    mean, sd = float(errors.mean()), float(errors.std(ddof=1))
    # Values that are all the same, but for rounding.
    if sd <= 1e-12 * abs(mean):
        return (math.copysign(math.inf, mean), 0.0) if mean else (math.nan, math.nan)
    t = mean / (sd / math.sqrt(n))
    return t, float(2.0 * stdtr(n - 1, -abs(t)))


def robust_z(errors: Array) -> Array:
    """Modified z-scores by the median and the median absolute deviation; shape (n,).

    Zero where more than half of the values are the same.

    Notes
    -----
    Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993): 0.6745 (x - median) / MAD.
    """
    off = errors - np.median(errors)
    mad = float(np.median(np.abs(off)))
    return np.asarray(0.6745 * off / mad) if mad > 0 else np.zeros(len(errors))


def share_within(errors: Array, limit: float) -> float:
    """Share of the errors within +- limit, as Fig. 15 of the 2012 paper counts; shape (n,)."""
    return float(np.mean(np.abs(errors) <= limit))


def _skewness(errors: Array) -> float:
    n = len(errors)
    off = errors - errors.mean()
    m2 = float(np.mean(off**2))
    if n < 3 or m2 <= (1e-12 * float(np.abs(errors).max())) ** 2:
        return math.nan
    g = float(np.mean(off**3)) / m2**1.5
    return float(g * math.sqrt(n * (n - 1)) / (n - 2))


def _normality(errors: Array) -> float:
    if not 3 <= len(errors) <= 5000 or np.ptp(errors) <= 1e-12 * np.abs(errors).max():
        return math.nan
    from scipy.stats import shapiro

    return float(shapiro(errors).pvalue)
