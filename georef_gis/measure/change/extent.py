"""Cells of a grid, and some about it, that a map can have anything to show in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.measure.change.cell_map import part_of
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import MapHeader, coarse_valid, open_bands

Corner = NDArray[np.int_]

# cells about a map that its resampled rim may reach
_RIM = 4


def cells_of(path: Path, header: MapHeader, *, margin: int) -> Window:
    """Cells of a grid and so many about it, as far as a map reaches.

    Parameters
    ----------
    path
        Of the map.
    header
        Of the grid, north up.
    margin
        Cells about the grid: most of them would be empty where the map ends with the grid.

    Returns
    -------
    Column, row, width and height; the first two are negative outside of the grid.

    Raises
    ------
    InputError, CrsError
        If the map cannot be read, has no place, or there is no way to the grid.
    """
    with open_bands(path) as bands:
        own = bands.header
    size = np.array([header.width, header.height])
    most = np.full(2, -margin), size + margin
    same = own.crs_wkt == header.crs_wkt
    found = _box(own, header) if same else _shown_box(path, header, margin)
    low, high = np.maximum(found[0] - _RIM, most[0]), np.minimum(found[1] + _RIM, most[1])
    if not (low < high).all():
        low, high = most
    (col, row), (width, height) = low.tolist(), (high - low).tolist()
    return col, row, width, height


def _box(own: MapHeader, header: MapHeader) -> tuple[Corner, Corner]:
    """Least and largest column and row of a map on a grid of the same CRS."""
    a, b, c, d, e, f = own.transform
    across, _, left, _, down, top = header.transform
    cols, rows = np.array([0, own.width, 0, own.width]), np.array([0, 0, own.height, own.height])
    x, y = a * cols + b * rows + c, d * cols + e * rows + f
    places = np.stack([(x - left) / across, (y - top) / down], axis=-1)
    return np.floor(places.min(axis=0)).astype(int), np.ceil(places.max(axis=0)).astype(int)


def _shown_box(path: Path, header: MapHeader, margin: int) -> tuple[Corner, Corner]:
    """The same of what it shows on a grid and so many cells about it, by the way of its pixels."""
    wide = part_of(
        header, (-margin, -margin, header.width + 2 * margin, header.height + 2 * margin)
    )
    shown = coarse_valid(path, wide)
    rows, cols = np.nonzero(shown)
    if not len(rows):
        return np.zeros(2, int), np.zeros(2, int)
    step = np.array([wide.width, wide.height]) / shown.shape[::-1]
    # the rim lies anywhere in a coarse cell
    low = (np.array([cols.min(), rows.min()]) - 1) * step - margin
    high = (np.array([cols.max(), rows.max()]) + 2) * step - margin
    return np.floor(low).astype(int), np.ceil(high).astype(int)
