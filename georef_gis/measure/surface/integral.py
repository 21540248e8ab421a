"""Integrals of heights over an area, and the variance that correlated errors give them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from georef_gis.errors import GeometryError
from georef_gis.frames import Array

# cells of an area, at least and at most
LEAST_CELLS, MOST_CELLS = 3_000, 1_000_000
# lines across a cell along which it is measured how much of it lies in the area
_FINE = 4
# of an area's longer side: no cell is smaller
_FINEST = 1e-4
# m; the mean width of an area that is none
_THIN = 1e-3
# lengths beyond which errors have nothing to do with each other
_REACH = 3.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Square cells of an area: their middles (n, 2) m, the part of each inside (n,) m^2, side m."""

    xy: Array
    area: Array
    side: float
    extent: float


def cells_of(area: Any, *, detail: float, most: int = MOST_CELLS) -> Cells:
    """Cells of a polygon, m in enu, fine enough for a surface that is smooth over `detail`, m.

    Their areas add to that of the polygon. There are no more than about `most`.

    Raises
    ------
    GeometryError
        If the polygon is a line, as good as.
    """
    x0, y0, x1, y1 = shapely.bounds(area)
    longer = max(x1 - x0, y1 - y0)
    if area.area < _THIN * longer:
        raise GeometryError(f"the area of {area.area:.3g} m2 is too thin to be measured")
    side = min(detail / 2.0, math.sqrt(area.area / LEAST_CELLS))
    side = max(side, math.sqrt(area.area / most), _FINEST * longer)
    edges = x0 + side * np.arange(math.ceil((x1 - x0) / side) + 1)
    xy, shares = [], []
    sides = _sides_of(area)
    for row in range(math.ceil((y1 - y0) / side)):
        low = y0 + row * side
        inside = np.zeros(len(edges) - 1)
        for k in range(_FINE):
            for a, b in _crossings(sides, low + (k + 0.5) / _FINE * side):
                inside += np.diff(np.clip(edges, a, b))
        at = np.flatnonzero(inside > 0.0)
        xy.append(np.column_stack([edges[at] + side / 2.0, np.full(len(at), low + side / 2.0)]))
        shares.append(inside[at])
    share = np.concatenate(shares)
    return Cells(
        xy=np.concatenate(xy), area=share * (area.area / share.sum()), side=side,
        extent=math.hypot(x1 - x0, y1 - y0),
    )  # fmt: skip


def _sides_of(area: Any) -> Array:
    """Sides of all rims of a polygon that rise or fall, the lower end first: x, y, x, y; (n, 4)."""
    out = []
    for ring in shapely.get_rings(area):
        xy = shapely.get_coordinates(ring)
        out.append(np.hstack([xy[:-1], xy[1:]]))
    sides = np.vstack(out)
    sides = np.where(sides[:, 1:2] <= sides[:, 3:], sides, sides[:, [2, 3, 0, 1]])
    return np.asarray(sides[sides[:, 1] < sides[:, 3]])


def _crossings(sides: Array, y: float) -> Array:
    """Where a line of one y enters and leaves a polygon; (k, 2)."""
    x0, y0, x1, y1 = sides[(sides[:, 1] <= y) & (y < sides[:, 3])].T
    return np.sort(x0 + (y - y0) / (y1 - y0) * (x1 - x0)).reshape(-1, 2)


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
