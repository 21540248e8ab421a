"""Lengths in rows of devices and between devices and lines, with their joint covariance.

Positions are horizontal, m in enu; a site is small enough for a plane. Every quantity is a function
of all positions at once, so that what points share in error drops out of their differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array

# m; far below any length here, far above rounding
_STEP = 1e-3
# Above so many devices only the outermost are tried as the first of a row.
_MOST_STARTS = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Positions with their joint covariance.

    Parameters
    ----------
    names
        One per position.
    xy : shape (n, 2), m in enu
    covariance : shape (2 n, 2 n), m^2
    """

    names: tuple[str, ...]
    xy: Array
    covariance: Array

    @classmethod
    def of(cls, names: tuple[str, ...], p_enu: Array, covariance: Array) -> Measured:
        """From places (n, 3) and their joint covariance (3 n, 3 n) in enu."""
        level = np.flatnonzero(np.arange(3 * len(p_enu)) % 3 != 2)
        return cls(names=names, xy=p_enu[:, :2], covariance=covariance[np.ix_(level, level)])

    def propagate(self, function: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Values (m,) of a function of the positions, and their covariance (m, m)."""
        values = np.atleast_1d(function(self.xy))
        jacobian = np.empty((len(values), self.xy.size))
        for k in range(self.xy.size):
            step = np.zeros(self.xy.size)
            step[k] = _STEP
            d = step.reshape(self.xy.shape)
            jacobian[:, k] = (function(self.xy + d) - function(self.xy - d)) / (2.0 * _STEP)
        return values, jacobian @ self.covariance @ jacobian.T

    def subset(self, indices: list[int]) -> Measured:
        """Some of the positions, in that order."""
        columns = np.array([2 * i + k for i in indices for k in (0, 1)], dtype=int)
        return Measured(
            names=tuple(self.names[i] for i in indices),
            xy=self.xy[indices],
            covariance=self.covariance[np.ix_(columns, columns)],
        )


def order_along(xy: Array) -> list[int]:
    """Order of devices in a row, from one of its ends: the shortest way through all of them.

    Which end is the first is not told by the positions.
    """
    n = len(xy)
    if n < 3:
        return list(range(n))
    distances = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    axis = np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)[2][0]
    along = np.argsort(xy @ axis, kind="stable")
    starts = range(n) if n <= _MOST_STARTS else (int(along[0]), int(along[-1]))
    ways = [[int(i) for i in along], *(_nearest_way(distances, start) for start in starts)]
    best = min(ways, key=lambda way: _length(distances, way))
    return _uncrossed(distances, best)


def _nearest_way(distances: Array, start: int) -> list[int]:
    left = np.ones(len(distances), dtype=bool)
    way = [start]
    left[start] = False
    while left.any():
        rest = np.flatnonzero(left)
        way.append(int(rest[np.argmin(distances[way[-1], rest])]))
        left[way[-1]] = False
    return way


def _length(distances: Array, way: list[int]) -> float:
    return float(distances[way[:-1], way[1:]].sum())


def _uncrossed(distances: Array, way: list[int]) -> list[int]:
    """Way made shorter by turning parts of it round, as long as that helps."""
    n, helped = len(way), True
    while helped:
        helped = False
        for i in range(n - 1):
            w = np.array(way)
            j = np.arange(i + 1, n)
            # Only the steps into and out of the part that is turned change.
            gain = np.zeros(len(j))
            if i > 0:
                gain += distances[w[i - 1], w[i]] - distances[w[i - 1], w[j]]
            after = w[np.minimum(j + 1, n - 1)]
            gain += np.where(j < n - 1, distances[w[j], after] - distances[w[i], after], 0.0)
            best = int(np.argmax(gain))
            if gain[best] > 1e-9:
                end = int(j[best])
                way = [*way[:i], *way[i : end + 1][::-1], *way[end + 1 :]]
                helped = True
    return way


def spacings(xy: Array) -> Array:
    """Distances from each position to the next; shape (n - 1,), m."""
    out: Array = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    return out


def along_and_offset(first: Array, last: Array, direction: Array) -> tuple[float, float]:
    """Way from one position to another along a direction, and to the left of it; m."""
    d = last - first
    u = direction / np.linalg.norm(direction)
    return float(d @ u), float(u[0] * d[1] - u[1] * d[0])


def distances_to_line(xy: Array, line: Array) -> Array:
    """Distances of positions from a polyline, beyond its ends from the line through the last two.

    Parameters
    ----------
    xy : shape (n, 2)
    line : shape (m, 2), m >= 2

    Returns
    -------
    distances : shape (n,), m
        Positive on the left of the line.
    """
    start, way = line[:-1], np.diff(line, axis=0)
    lengths = np.linalg.norm(way, axis=1)
    unit = way / lengths[:, None]
    from_start = xy[:, None] - start[None]
    along = np.einsum("nmk,mk->nm", from_start, unit)
    low = np.where(np.arange(len(way)) == 0, -np.inf, 0.0)
    high = np.where(np.arange(len(way)) == len(way) - 1, np.inf, lengths)
    foot = np.clip(along, low, high)
    gap = from_start - foot[..., None] * unit
    nearest = np.argmin(np.linalg.norm(gap, axis=2), axis=1)
    rows = np.arange(len(xy))
    side = unit[nearest, 0] * from_start[rows, nearest, 1] - (
        unit[nearest, 1] * from_start[rows, nearest, 0]
    )
    out: Array = np.copysign(np.linalg.norm(gap[rows, nearest], axis=1), side)
    return out
