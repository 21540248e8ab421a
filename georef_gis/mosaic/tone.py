"""How grey values of a picture answer to more light: a gain that spares what is near white.

A camera that makes pictures bends its response near the top of the range. What a longer exposure
does to a value v is then about a gain k of its odds, v / (1 - knee v) with knee = 1 / top::

    v' = k v / (1 + (k - 1) knee v)

Black and white stay where they are, dark values gain by k, and two gains one after the other are
their product, as for plain gains, which are those of knee = 0.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Values = TypeVar("Values", bound=NDArray[np.floating[Any]])

# part of the range below its top at which the odds, which have no end, are cut
LAST = 0.004


def toned(value: Values, factor: Values, knee: float | np.floating[Any]) -> Values:
    """Grey values after a gain of `factor`; both of shape (..., bands).

    Parameters
    ----------
    knee
        One over the grey value that stays, 0 = none does: a plain product.
    """
    out: Any = value * factor
    if knee > 0.0:
        out = out / (1.0 + (factor - 1.0) * (knee * value))
    return out  # type: ignore[no-any-return]


def tone_of(value: Values, darkest: float, knee: float) -> Values:
    """Logarithm of the odds of grey values, to which logarithms of gains are added."""
    top = np.inf if knee == 0.0 else (1.0 - LAST) / knee
    v = np.clip(value, darkest, top)
    out: Any = np.log(v)
    if knee > 0.0:
        out = out - np.log1p(-knee * v)
    return out  # type: ignore[no-any-return]


def grown(tone: Values, knee: float) -> Values:
    """How fast a grey value grows with its logarithm of odds."""
    value: Any = np.exp(tone)
    if knee > 0.0:
        value = value / (1.0 + knee * value) ** 2
    return value  # type: ignore[no-any-return]
