"""How a block lies: up in its own frame, by the attitudes of its photos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array

# rad, one sigma of what all attitudes of a flight share: how the camera hangs
SIGMA_LEVEL_SHARED = math.radians(4.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """Up in the frame that is to be placed: a unit vector (3,), and its one sigma, rad."""

    up_from: Array
    sigma: float


def mean_level(up_from: Array, sigma: Array, *, shared: float = SIGMA_LEVEL_SHARED) -> Level | None:
    """Level of many directions (n, 3) with sigmas (n,), rad, some of which are wrong.

    Parameters
    ----------
    shared : rad
        One sigma of the error that all have in common, which no number of them averages out.

    Notes
    -----
    Mean with the weights of a Cauchy loss, from the direction nearest to all others.
    """
    known = np.all(np.isfinite(up_from), axis=1)
    d, s = up_from[known], sigma[known]
    if not len(d):
        return None
    some = d[:: max(1, len(d) // 500)]
    angle = np.arccos(np.clip(some @ some.T, -1.0, 1.0))
    mean = some[np.argmin(np.median(angle, axis=1))]
    for _ in range(20):
        off = np.arccos(np.clip(d @ mean, -1.0, 1.0)) / s
        weight = 1.0 / (s**2 * (1.0 + (off / 2.0) ** 2))
        new = weight @ d
        mean = new / np.linalg.norm(new)
    return Level(up_from=mean, sigma=float(np.hypot(shared, np.sqrt(1.0 / np.sum(weight)))))
