"""Confidence of regions: how many of such a score chance makes, and how many there are.

Scores of regions beyond a threshold are taken for a mixture: of unchanged ground, whose number
falls off exponentially, and of changes, which spread far wider. Both rates and the share are
found from the site's own regions; priors worth a few regions keep a site without changes, or
with few regions, from being explained by changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# prior: mean excess of unchanged and of changed regions over the threshold, in deviations, the
# regions each is worth, and the share of changes with what it is worth
_NULL_MEAN, _NULL_WORTH = 1.0, 10.0
_CHANGE_MEAN, _CHANGE_WORTH = 12.0, 4.0
_SHARE, _SHARE_WORTH = 0.05, 10.0
# the excess of changes spreads at least so many times wider than that of the unchanged
_WIDER = 4.0
_ITERATIONS = 200
MOST = 0.99


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixture:
    """What the regions of a site are a mixture of.

    Parameters
    ----------
    threshold
        Least score of a region.
    null_mean, change_mean
        Mean excess over it of unchanged and of changed regions.
    share
        Of changed regions.
    """

    threshold: float
    null_mean: float
    change_mean: float
    share: float

    def confidence(self, scores: Array) -> Array:
        """Probability of each region to be a change."""
        excess = np.maximum(np.asarray(scores, np.float64) - self.threshold, 0.0)
        odds = np.log(self.share / (1.0 - self.share)) + np.log(self.null_mean / self.change_mean)
        odds = odds + excess * (1.0 / self.null_mean - 1.0 / self.change_mean)
        return np.asarray(np.minimum(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))), MOST))


def fit_mixture(scores: Array, threshold: float) -> Mixture:
    """Mixture of the scores of all regions.

    Parameters
    ----------
    scores : shape (n,)
        Of regions; those below the threshold are none.
    """
    excess = np.asarray(scores, np.float64) - threshold
    excess = excess[excess > 0.0]
    fitted = Mixture(
        threshold=threshold, null_mean=_NULL_MEAN, change_mean=_CHANGE_MEAN, share=_SHARE
    )
    for _ in range(_ITERATIONS):
        changed = fitted.confidence(excess + threshold)
        null = 1.0 - changed
        null_mean = (_NULL_WORTH * _NULL_MEAN + null @ excess) / (_NULL_WORTH + null.sum())
        change_mean = (_CHANGE_WORTH * _CHANGE_MEAN + changed @ excess) / (
            _CHANGE_WORTH + changed.sum()
        )
        share = (_SHARE_WORTH * _SHARE + changed.sum()) / (_SHARE_WORTH + len(excess))
        before, fitted = (
            fitted,
            Mixture(
                threshold=threshold, null_mean=float(null_mean),
                change_mean=float(max(change_mean, _WIDER * null_mean)),
                share=float(np.clip(share, 1e-4, 0.9)),
            ),
        )  # fmt: skip
        if abs(fitted.share - before.share) + abs(fitted.null_mean - before.null_mean) < 1e-6:
            break
    return fitted
