"""Integrals of heights over an area, and the variance that correlated errors give them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from georef_gis.errors import GeometryError
from georef_gis.frames import Array

# cells along the longer side of an area, at least and at most
LEAST_CELLS, MOST_CELLS = 60, 400
# places along each side of a cell at which it is asked whether it lies in the area
_FINE = 4
# lengths beyond which errors have nothing to do with each other
_REACH = 3.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Square cells of an area: their middles (n, 2) m, the part of each inside (n,) m^2, side m."""

    xy: Array
    area: Array
    side: float
    extent: float


def cells_of(area: Any, *, detail: float) -> Cells:
    """Cells of a polygon, m in enu, fine enough for a surface that is smooth over `detail`, m.

    Their areas add to that of the polygon.
    """
    x0, y0, x1, y1 = shapely.bounds(area)
    longer = max(x1 - x0, y1 - y0)
    side = float(np.clip(detail / 2.0, longer / MOST_CELLS, longer / LEAST_CELLS))
    cols, rows = math.ceil((x1 - x0) / side), math.ceil((y1 - y0) / side)
    x, y = x0 + (np.arange(cols) + 0.5) * side, y0 + (np.arange(rows) + 0.5) * side
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    off = ((np.arange(_FINE) + 0.5) / _FINE - 0.5) * side
    shapely.prepare(area)
    inside = np.zeros(len(xy))
    for dx in off:
        for dy in off:
            inside += shapely.contains_xy(area, xy[:, 0] + dx, xy[:, 1] + dy)
    kept = inside > 0
    if not np.any(kept):
        raise GeometryError(f"the area of {area.area:.3g} m2 is too thin to be measured")
    share = inside[kept]
    return Cells(
        xy=xy[kept], area=share * (area.area / share.sum()), side=side,
        extent=math.hypot(x1 - x0, y1 - y0),
    )  # fmt: skip


def correlated_variance(xy: Array, weighted: Array, length: float, side: float) -> float:
    """Variance of a sum of correlated errors.

    Parameters
    ----------
    xy : shape (n, 2), m
    weighted : shape (n,)
        Weight of each place times its sigma.
    length : m
        Errors of places d apart have the correlation exp(-(d / length)^2 / 2).
    side : m
        Of the grid on which places are laid; a place moves by half of it at most.

    Notes
    -----
    w^T C w on a regular grid is a convolution: n log n by the fast Fourier transform.
    """
    step = max(side, length / 8.0)
    low = xy.min(axis=0)
    at = np.floor((xy - low) / step + 0.5).astype(np.intp)
    shape = at.max(axis=0) + 1
    grid = np.zeros(shape)
    np.add.at(grid, (at[:, 0], at[:, 1]), weighted)
    reach = math.ceil(_REACH * length / step)
    size = [int(n) + reach for n in shape]
    spectrum = np.abs(np.fft.rfft2(grid, size)) ** 2
    d = [np.minimum(np.arange(n), n - np.arange(n)) * step for n in size]
    kernel = np.exp(-0.5 * (d[0][:, None] ** 2 + d[1][None, :] ** 2) / length**2)
    alike = np.fft.irfft2(spectrum, size)
    # neighbours beyond the rim of the padding are beyond the reach of the correlation
    near = (d[0][:, None] <= reach * step) & (d[1][None, :] <= reach * step)
    return max(float(np.sum(np.where(near, kernel * alike, 0.0))), 0.0)


def ring_of(area: Any, *, step: float) -> Array:
    """Places along the outer rim of a polygon, about `step` m apart, the last not the first."""
    line = shapely.get_exterior_ring(area)
    count = int(np.clip(math.ceil(line.length / step), 48, 2000))
    at = np.arange(count) / count * line.length
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(line, at)))
