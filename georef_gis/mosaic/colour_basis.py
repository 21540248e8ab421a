"""Shapes that vignetting, the trend of view direction and a photo's own surface are made from."""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.hot_spot import Spot, Values, spot_shape

# powers of the radius: even, as the shape is smooth in the middle; none constant
RADIAL_POWERS = (2, 4, 6)
# highest power of the view direction; more would swing where there is little overlap
TREND_ORDER = 4
TREND_POWERS = tuple(
    (order - n, n) for order in range(1, TREND_ORDER + 1) for n in range(order + 1)
)
# the last one is the hot spot
TREND_TERMS = len(TREND_POWERS) + 1
SURFACE_TERMS = 5
# mean squares of both coordinates over a photo of 4:3: without them a surface has no level
MEAN_SQUARES = (0.21, 0.12)


def radial_basis(xy: Values) -> Array:
    """Even powers of the radius; places (..., 2) in half diagonals -> (..., 3)."""
    p = np.asarray(xy, dtype=np.float64)
    r2 = p[..., 0] ** 2 + p[..., 1] ** 2
    return np.stack([r2 ** (power // 2) for power in RADIAL_POWERS], axis=-1)


def surface_basis(xy: Values) -> Array:
    """Plane and quadratic over a photo; places (..., 2) in half diagonals -> (..., 5)."""
    p = np.asarray(xy, dtype=np.float64)
    x, y = p[..., 0], p[..., 1]
    return np.stack([x, y, x * x - MEAN_SQUARES[0], x * y, y * y - MEAN_SQUARES[1]], axis=-1)


def trend_basis(view: Values, reach: float, spot: Spot | None) -> Array:
    """Powers of the view direction over the most oblique one, and hot spot; (..., 2) -> (..., 15).

    Beyond `reach`, the most oblique view that took part, the powers stay as at the rim: a
    polynomial must not be asked for what it has not seen.
    """
    v = np.asarray(view, dtype=np.float64) / reach
    v = v / np.maximum(np.hypot(v[..., 0], v[..., 1]), 1.0)[..., None]
    east = [np.ones_like(v[..., 0]), v[..., 0]]
    north = [np.ones_like(v[..., 1]), v[..., 1]]
    for _ in range(2, TREND_ORDER + 1):
        east.append(east[-1] * v[..., 0])
        north.append(north[-1] * v[..., 1])
    last = np.zeros_like(east[0]) if spot is None else spot_shape(view, spot)
    return np.stack([*(east[i] * north[j] for i, j in TREND_POWERS), last], axis=-1)
