"""The hot spot: where the sun is behind the camera nothing shows its shadow, and all is brighter.

It is a cone about the place of the aircraft's shadow, too narrow for a polynomial of few terms.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
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
# blocks looked at, at most
MOST = 12_000


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
    step = -(-len(overlaps) // MOST)
    if step == 0:
        return None
    views = overlaps.view_a[::step], overlaps.view_b[::step]
    apart, weights = apart[::step], weights[::step]
    spacing = INNER * reach / CANDIDATES
    line = np.arange(-CANDIDATES, CANDIDATES + 1) * spacing
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= INNER * reach]
    best, _, _ = _best(grid, views, apart, weights)
    line = np.arange(-REFINED, REFINED + 1) * spacing / REFINED
    fine = best + np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    best, explained, height = _best(fine, views, apart, weights)
    total = float(weights @ apart**2)
    if explained < SHARE * total or not HEIGHTS[0] <= height <= HEIGHTS[1]:
        return None
    return float(best[0]), float(best[1])


def _best(
    places: Array, views: tuple[Values, Values], apart: Array, weights: Array
) -> tuple[Array, float, float]:
    """Place of the spot that explains most, how much of the square, and the spot's height."""
    found: tuple[Array, float, float] = (places[0], 0.0, 0.0)
    for place in places:
        spot = (float(place[0]), float(place[1]))
        shape = spot_shape(views[0], spot) - spot_shape(views[1], spot)
        own = float(weights @ shape**2)
        with_it = float(weights @ (shape * apart))
        # darker than the rest is no hot spot
        if own > 0.0 and with_it > 0.0 and with_it**2 / own > found[1]:
            found = (place, with_it**2 / own, with_it / own)
    return found
