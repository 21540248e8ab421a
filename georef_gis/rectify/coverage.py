"""How often each place is seen: overlap map, covered area, holes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.model.grid import Grid
from georef_gis.model.layers import Footprint

# px along the longer side of an overlap map
COVERAGE_PIXELS = 1500
# disc of one cell
_CELL = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.uint8)


def overlap_map(
    footprints: Sequence[Footprint], frame: MapFrame
) -> tuple[Grid, NDArray[np.uint16]]:
    """Number of photos that show each cell; grid and counts (rows, cols)."""
    ring = np.vstack([f.ring_map for f in footprints])
    left, bottom = ring.min(axis=0)
    right, top = ring.max(axis=0)
    pixel = max(right - left, top - bottom) / COVERAGE_PIXELS
    grid = Grid.over((left, bottom, right, top), pixel=pixel, crs_wkt=frame.horizontal.to_wkt())
    counts = np.zeros((grid.height, grid.width), dtype=np.uint16)
    for f in footprints:
        one = np.zeros(counts.shape, dtype=np.uint8)
        # fillPoly counts pixel centres from 0 and takes 4 binary digits of a pixel.
        points = np.round((grid.grid_from_map(f.ring_map) - 0.5) * 16).astype(np.int32)
        cv2.fillPoly(one, [points.reshape(-1, 1, 2)], 1, lineType=cv2.LINE_8, shift=4)
        counts += one
    return grid, counts


def covered_area(grid: Grid, counts: NDArray[np.uint16], frame: MapFrame) -> float:
    """Ground seen by at least one photo, m^2."""
    cell = grid.pixel * metres_per_unit(frame.horizontal)
    return float(np.count_nonzero(counts)) * cell**2


def holes(grid: Grid, counts: NDArray[np.uint16], *, footprint_cells: float) -> list[Array]:
    """Rings (n, 2) on the map of places amid the flown area that no photo shows.

    Places that are enclosed, and gaps between strips up to a third of a footprint wide even where
    they are open at their ends; the ragged rim of the survey is none, where a notch is less than
    half a footprint deep.

    Parameters
    ----------
    footprint_cells
        Root of the area of a usual footprint, in cells of the grid.
    """
    # as far as what is grown reaches, and a rim of background around it
    pad = int(footprint_cells / 3) + 3
    covered = np.pad((counts > 0).astype(np.uint8), pad)
    closed = _shrunk(_grown(covered, footprint_cells / 3), footprint_cells / 3)
    amid = _shrunk(closed, footprint_cells / 10)
    outside = covered.copy()
    cv2.floodFill(outside, np.zeros(np.add(covered.shape, 2), np.uint8), (0, 0), 2)
    gaps = _long((amid > 0) & (covered == 0), footprint_cells / 2)
    missing = ((outside == 0) | gaps).astype(np.uint8)
    # A sliver as thin as a cell is the drawing's, not the flight's.
    missing = cv2.morphologyEx(missing, cv2.MORPH_OPEN, _CELL)
    rings = []
    for contour in cv2.findContours(missing, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
        if len(contour) > 2:
            ring = grid.map_from_grid(contour[:, 0, :].astype(np.float64) - pad + 0.5)
            rings.append(np.vstack([ring, ring[:1]]))
    return rings


def footprint_side(footprints: Sequence[Footprint], grid: Grid, frame: MapFrame) -> float:
    """Root of the median area of footprints, in cells of a grid."""
    area = float(np.median([f.area_m2 for f in footprints]))
    return float(np.sqrt(area) / (grid.pixel * metres_per_unit(frame.horizontal)))


def _long(mask: NDArray[np.bool_], length: float) -> NDArray[np.bool_]:
    """The connected parts of a mask that are at least this long, cells."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    out = np.zeros(mask.shape, dtype=np.bool_)
    for contour in cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )[0]:
        if max(cv2.minAreaRect(contour)[1]) >= length:
            col, row = contour[0, 0]
            out |= labels == labels[row, col]
    return out


def _grown(mask: NDArray[np.uint8], radius: float) -> NDArray[np.uint8]:
    """Mask dilated by a disc; by distances, as a large kernel costs its area per cell."""
    far = cv2.distanceTransform(1 - mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(far <= radius, dtype=np.uint8)


def _shrunk(mask: NDArray[np.uint8], radius: float) -> NDArray[np.uint8]:
    """Mask eroded by a disc."""
    return np.asarray(1 - _grown(np.asarray(1 - mask, dtype=np.uint8), radius))
