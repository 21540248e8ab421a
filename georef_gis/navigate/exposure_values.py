"""What photos say of their time, what is known beforehand, and the exposure times found."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import PurePath

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.navigate.clock_fit import DRIFT_SIGMA, ClockFit
from georef_gis.navigate.sequence_match import IntArray

# s, one sigma of a stated offset of a clock
_CLOCK_SIGMA = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoClock:
    """What a photo says of its time.

    Parameters
    ----------
    name
        File name or id.
    clock : s
        Camera clock as `clock_fit.clock_seconds` reads it, cut to `resolution` s; None: unknown.
    time_gps, time_sigma : s
        GPS time that the tags state.
    number
        The camera's own count, from the file name (`file_number`).
    """

    name: str
    clock: float | None = None
    resolution: float = 1.0
    time_gps: float | None = None
    time_sigma: float | None = None
    number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOptions:
    """What is known beforehand.

    Parameters
    ----------
    offset, offset_sigma : s
        Camera clock minus UTC (time zone included), from the user; None: unknown.
    missed, spurious
        Share of photos without event, and of events without photo.
    jitter, lag, lag_sigma : s
        One sigma of the shutter's latency; exposure after the event and its sigma.
    drift_sigma : s per s
    use_numbers
        Whether gaps in file numbers and event counters tell of exposures left out.
    """

    offset: float | None = None
    offset_sigma: float = _CLOCK_SIGMA
    missed: float = 0.05
    spurious: float = 0.02
    jitter: float = 0.03
    lag: float = 0.0
    lag_sigma: float = 0.0
    drift_sigma: float = DRIFT_SIGMA
    use_numbers: bool = True

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("missed", "spurious"):
            if not 0.0 < getattr(self, name) < 0.5:
                raise InputError(
                    f"{getattr(self, name)} is not between 0 and 0.5", source="options", field=name
                )
        for name in ("offset_sigma", "jitter", "drift_sigma"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(
                    f"{getattr(self, name)} is not above 0", source="options", field=name
                )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExposureTimes:
    """Time of every photo.

    Parameters
    ----------
    time, sigma : shape (n,), s
        On the scale of the events, else GPS; NaN where nothing tells. The sigma holds if the
        assignment is right.
    source
        "event", "event name", "clock", "tag", or "" where nothing tells.
    event : shape (n,)
        Index in the event log, -1 where the photo has none.
    confidence : shape (n,)
        Probability that `event` is right; without events, that the clock's offset is.
    clock
        Offset, drift and their covariance; None where no clock was solved.
    jitter : s
        One sigma of the latency that was found.
    missed, spurious
        Photos without event; events without photo (indices).
    alternatives
        What else fits, in words.
    """

    time: Array
    sigma: Array
    source: tuple[str, ...]
    event: IntArray
    confidence: Array
    clock: ClockFit | None
    jitter: float
    missed: tuple[int, ...] = ()
    spurious: tuple[int, ...] = ()
    alternatives: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def file_number(name: str) -> int | None:
    """Last run of digits of a file's stem: IMG_0474.JPG -> 474, DJI_2024_0012_V.JPG -> 12."""
    found = re.findall(r"\d+", PurePath(name).stem)
    return int(found[-1]) if found and len(found[-1]) <= 6 else None
