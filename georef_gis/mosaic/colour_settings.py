"""What is solved for in a mosaic's colour, and how far from nothing it is expected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Mode = Literal["full", "gain", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourSettings:
    """What to solve for, and how far from nothing it is expected; sigmas are one deviation.

    What the overlaps do not tell stays at nothing, as the sigmas are finite.

    Parameters
    ----------
    mode
        "full"; "gain": the photos' gains and offsets only; "none": grey values stay.
    knee
        One over the grey value that gains leave as it is, see `tone.py`; 0 = plain gains, for
        linear radiometry.
    sigma_gain
        Of the logarithm of a photo's gain. The larger, the longer a chain of photos may drift;
        the smaller, the less a lasting change of exposure is followed.
    sigma_offset
        Of a photo's offset, relative to the typical grey value. 0 = none, for linear radiometry.
    sigma_vignetting
        Of each coefficient of the logarithm, at the photo's corners.
    sigma_trend
        Of a coefficient of the first order of the logarithm, at the most oblique view; that of
        order n is an n-th of it.
    sigma_spot
        Of the logarithm of the hot spot's height; 0 = none is looked for.
    sigma_surface
        Of each coefficient of the logarithm's surface over a photo, at half a diagonal from its
        middle; 0 = none is looked for.
    blocks_per_pair
        Independent blocks that a pair is worth at most.
    iterations
        At most.
    """

    mode: Mode = "full"
    knee: float = 0.0
    sigma_gain: float = 0.5
    sigma_offset: float = 0.01
    sigma_vignetting: float = 0.3
    sigma_trend: float = 0.3
    sigma_spot: float = 0.1
    sigma_surface: float = 0.1
    blocks_per_pair: float = 25.0
    iterations: int = 20
