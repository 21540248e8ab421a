"""What the search for tie points is asked and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.tie_points import TiePoints

# share of the work done (0 to 1) and what is being done; may raise to stop the search
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class TieSettings:
    """How tie points are sought.

    Parameters
    ----------
    max_side : px
        Longer side of the picture in which features are found; a larger photo is reduced to it.
    max_features
        Features kept per photo, spread over the picture.
    neighbours
        Photos with which each one is matched, those of largest predicted overlap.
    relief
        Height of what stands on the ground as a share of the height of flight: how far a point
        may lie off the plane through its surroundings.
    min_inliers
        Verified matches below which a pair is not believed.
    observations
        Tie points kept per photo, about.
    workers
        Threads.
    seed
        Of every random choice.
    """

    max_side: int = 2000
    max_features: int = 5000
    neighbours: int = 14
    relief: float = 0.35
    min_inliers: int = 20
    observations: int = 800
    workers: int = 2
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TiePair:
    """Two photos that were compared.

    Parameters
    ----------
    ids
        The photos.
    overlap
        Predicted share of the smaller footprint that both show.
    candidates
        Matches of the coarse search.
    matches
        Matches of the guided search.
    inliers
        Matches that the geometry of the pair verified; 0 where the pair is not believed.
    geometry
        ``"plane"`` where one homography explains nearly all, ``"parallax"`` where the epipolar
        geometry was needed, ``""`` where there is none.
    residual : px of the reduced picture
        Median distance from the epipolar line (or from the homography, for ``"plane"``).
    turn : rad
        Clockwise turn about the vertical that lays the second photo's ground on that of the first,
        beyond what the poses predict.
    scale
        Size of the second photo's ground by that of the first, 1 where the poses agree.
    shift : m
        Distance between the places of the middle of the matches by the two poses.
    why
        Why the pair is not believed; empty if it is.
    """

    ids: tuple[str, str]
    overlap: float
    candidates: int = 0
    matches: int = 0
    inliers: int = 0
    geometry: str = ""
    residual: float = float("nan")
    turn: float = float("nan")
    scale: float = float("nan")
    shift: float = float("nan")
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """What the pixels say of a photo's heading.

    Parameters
    ----------
    quarter_deg
        Degrees clockwise by which the stored pixels were turned after the exposure: 0, 90, 180,
        270, as in `[attitude] rotate_photos`.
    yaw, sigma : rad
        Correction of the heading about the vertical, clockwise seen from above, what is left after
        the quarter turn; and its one standard deviation.
    correct
        Whether the correction is called for: the tags have no heading, or differ by more than
        they should.
    absolute
        Whether the directions between the photos' positions carry it; if not, it rests on the
        headings of most photos.
    pairs
        Verified pairs it comes from.
    evidence
        In words.
    """

    quarter_deg: int
    yaw: float
    sigma: float
    correct: bool
    absolute: bool
    pairs: int
    evidence: str

    @property
    def is_change(self) -> bool:
        """Whether anything is to be changed."""
        return self.quarter_deg != 0 or self.correct


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TieResult:
    """Tie points, and how they were come by.

    Parameters
    ----------
    ties
        Observations; `photo_ids` are all photos asked for, in their order.
    pairs
        All pairs that were compared, also those not believed.
    turns
        By photo; photos without verified pairs have none.
    components
        Groups of photos that tie points connect, largest first; photos alone are not in any.
    doubts
        One line each, for people.
    seconds
        CPU time of each step, s.
    """

    ties: TiePoints
    pairs: tuple[TiePair, ...] = ()
    turns: dict[str, Turn] = field(default_factory=dict)
    components: tuple[tuple[str, ...], ...] = ()
    doubts: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)


def no_ties(photo_ids: tuple[str, ...]) -> TiePoints:
    """Tie points of photos that share none."""
    none: NDArray[np.int32] = np.zeros(0, dtype=np.int32)
    return TiePoints(
        photo_ids=photo_ids, photo=none, point=none, uv=np.zeros((0, 2)), sigma=np.zeros(0)
    )
