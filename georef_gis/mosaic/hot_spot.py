"""The hot spot: where the sun is behind the camera nothing shows its shadow, and all is brighter.

It is a cone about the place of the aircraft's shadow, too narrow for a polynomial of few terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Floats
from georef_gis.mosaic.overlaps import Overlaps

Values = NDArray[np.floating[Any]]
# horizontal part (east, north) of the unit vector to the sun
Spot = tuple[float, float]

# how far from its top, as a part of the unit vector, a spot has fallen to a third; 5 degrees
WIDTH = 0.08
# part of the reach of views within which a spot is looked for: at the rim few blocks would tell
INNER = 0.85
# candidates along a radius, and the part of their spacing that the place is refined to
CANDIDATES = 12
REFINED = 4
# share of the residuals' square that a spot must explain to be one
SHARE = 0.03
# logarithm at its top; below it nobody sees it, above it is something else that shines
HEIGHTS = (0.01, 0.4)
# blocks looked at, at most: for every candidate, and once the place is about known
FEW, MOST = 4_000, 12_000


def spot_shape(view: Values, spot: Spot) -> Array:
    """Height of the cone, nothing at the nadir; views (..., 2) -> (...)."""
    v = np.asarray(view, dtype=np.float64)
    away = np.hypot(v[..., 0] - spot[0], v[..., 1] - spot[1])
    return np.asarray(np.exp(-away / WIDTH) - np.exp(-np.hypot(*spot) / WIDTH))


def find_spot(overlaps: Overlaps, apart: Array, weights: Array, reach: float) -> Spot | None:
    """Place of the hot spot of a flight; None if there is none to be seen.

    Parameters
    ----------
    overlaps
        Of photos of the flight.
    apart : shape (k,)
        Difference of the logarithms that is left without a spot, a less b.
    weights : shape (k,)
    reach
        Most oblique view.
    """
    if not len(overlaps):
        return None
    spacing = INNER * reach / CANDIDATES
    line = np.arange(-CANDIDATES, CANDIDATES + 1) * spacing
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= INNER * reach]
    best, _, _ = _Blocks.few(overlaps, apart, weights, FEW).best(grid)
    line = np.arange(-REFINED, REFINED + 1) * spacing / REFINED
    fine = best + np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    blocks = _Blocks.few(overlaps, apart, weights, MOST)
    best, explained, height = blocks.best(fine)
    if explained < SHARE * blocks.total or not HEIGHTS[0] <= height <= HEIGHTS[1]:
        return None
    return float(best[0]), float(best[1])


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Some blocks in single precision, which is twice as fast and far finer than a spot's place.

    `views` (2, k) of both ends, east and north apart; `apart`, `weights` (k,).
    """

    views: tuple[Floats, Floats]
    apart: Floats
    weights: Floats

    @classmethod
    def few(cls, overlaps: Overlaps, apart: Array, weights: Array, most: int) -> _Blocks:
        """Every so many of the blocks."""
        every = slice(None, None, -(-len(overlaps) // most))
        ends = (overlaps.view_a[every], overlaps.view_b[every])
        views = tuple(np.ascontiguousarray(end.T, dtype=np.float32) for end in ends)
        # of any unit: sums of squares must stay in the range of float32
        scale = max(float(weights[every].max()), 1e-300)
        values = (np.asarray(v[every], dtype=np.float32) for v in (apart, weights / scale))
        return cls((views[0], views[1]), *values)

    @property
    def total(self) -> float:
        """Weighted square of what is left."""
        return float(self.weights @ self.apart**2)

    def best(self, places: Array) -> tuple[Array, float, float]:
        """Place of the spot that explains most, how much of the square, and the spot's height."""
        found: tuple[Array, float, float] = (places[0], 0.0, 0.0)
        with_weight = self.weights * self.apart
        for place in places:
            shape = self._height(0, place) - self._height(1, place)
            own = float(self.weights @ (shape * shape))
            with_it = float(with_weight @ shape)
            # darker than the rest is no hot spot
            if own > 0.0 and with_it > 0.0 and with_it**2 / own > found[1]:
                found = (place, with_it**2 / own, with_it / own)
        return found

    def _height(self, end: int, place: Array) -> Floats:
        """Height of a cone at `place` less that at the nadir, which both ends share."""
        east, north = self.views[end]
        dx, dy = east - np.float32(place[0]), north - np.float32(place[1])
        away = np.sqrt(dx * dx + dy * dy)
        return np.asarray(np.exp(away * np.float32(-1.0 / WIDTH)), dtype=np.float32)
