"""What a planned flight cannot tell apart: mount, clock, receiver and camera.

A linear model of photos that look straight down on known ground: each unknown shifts the picture
on the ground, and unknowns whose shifts are the same in all photos are one signal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array

UNKNOWNS = (
    "receiver bias east", "receiver bias north", "lever arm forward", "lever arm right",
    "boresight pitch", "boresight roll", "boresight yaw", "time offset", "focal length or height",
)  # fmt: skip
# m, m/s; only to give the columns like lengths
_HEIGHT, _SPEED = 100.0, 10.0
# of the height: how far off the middle places are seen
_OFF = ((0.0, 0.0), (0.3, 0.4), (0.3, -0.4), (-0.3, 0.4), (-0.3, -0.4))
# of the largest singular value
_NOTHING = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """Photos of one heading, rad clockwise from north, height, m, and velocity, m/s.

    Parameters
    ----------
    velocity_en
        Over the ground, east and north; with wind not along the heading.
    """

    heading: float
    height: float
    velocity_en: tuple[float, float]

    @classmethod
    def still(cls, heading: float, height: float, speed: float) -> Leg:
        """Leg without wind."""
        return cls(
            heading=heading, height=height,
            velocity_en=(speed * float(np.sin(heading)), speed * float(np.cos(heading))),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Observable:
    """What legs tell of the nine `UNKNOWNS`, were the ground known.

    Parameters
    ----------
    rank
        Of 9.
    mixed
        Groups of unknowns that are one signal, or several that no photo tells apart.
    """

    rank: int
    mixed: tuple[tuple[str, ...], ...]

    def told(self) -> list[str]:
        """In words, a line for each group."""
        return [f"{_listed(group)} cannot be told apart" for group in self.mixed]


def observable(legs: Sequence[Leg]) -> Observable:
    """What can be told of mount, clock, receiver and camera from legs over known ground."""
    if not legs:
        raise ValueError("no legs")
    A = np.vstack([_shifts(leg) for leg in legs])
    _, values, rows = np.linalg.svd(A, full_matrices=True)
    rank = int(np.sum(values > _NOTHING * values[0]))
    null = rows[rank:]
    # unknowns are of one group where a change of one can be undone by the other
    together = np.abs(null.T @ null) > 1e-6
    return Observable(rank=rank, mixed=_groups(together))


def _shifts(leg: Leg) -> Array:
    """Shift of pictures on the ground, m, by each unknown; (2 k, 9)."""
    ahead = np.array([np.sin(leg.heading), np.cos(leg.heading)])
    right = np.array([ahead[1], -ahead[0]])
    scale = leg.height / _HEIGHT
    out = []
    for forward, aside in _OFF:
        place = scale * (forward * ahead + aside * right)
        turned = scale * (forward * right - aside * ahead)
        columns = [
            [1.0, 0.0], [0.0, 1.0], ahead, right, scale * ahead, scale * right, turned,
            np.array(leg.velocity_en) / _SPEED, place,
        ]  # fmt: skip
        out.append(np.array(columns).T)
    return np.vstack(out)


def _groups(
    together: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> tuple[tuple[str, ...], ...]:
    """Connected unknowns, larger groups first; those that stand alone are told."""
    left = set(range(len(together)))
    out = []
    while left:
        group, new = set(), {left.pop()}
        while new:
            i = new.pop()
            group.add(i)
            new |= {j for j in left if together[i, j]}
            left -= new
        if len(group) > 1:
            out.append(tuple(UNKNOWNS[i] for i in sorted(group)))
    return tuple(sorted(out, key=lambda names: (-len(names), names)))


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
