"""Grids of the products: pixel size, extent, and a refusal before a disk is filled."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from georef_gis.errors import InputError
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.model.grid import Grid
from georef_gis.model.layers import Footprint

# px; more than this is a slip of the user (a GSD in the wrong unit), not a wish
LARGEST_GRID = 2e11


def nice_pixel(gsd: float) -> float:
    """Pixel size of two significant digits, not above `gsd`."""
    exponent = math.floor(math.log10(gsd)) - 1
    return float(f"{math.floor(gsd / 10**exponent + 1e-9)}e{exponent}")


def plan_grid(
    footprints: Sequence[Footprint], frame: MapFrame, *, gsd: float | None = None
) -> Grid:
    """Grid over footprints.

    Parameters
    ----------
    gsd
        Pixel size on the ground, m; by default the median of the photos', rounded down to two
        digits in units of the CRS.

    Raises
    ------
    InputError
        If there is no footprint, or the grid would be absurdly large.
    """
    if not footprints:
        raise InputError("no photo has a footprint, so there is nothing to map")
    ring = np.vstack([f.ring_map for f in footprints])
    unit = metres_per_unit(frame.horizontal)
    wanted = gsd if gsd is not None else float(np.median([f.gsd for f in footprints]))
    pixel = wanted / unit if gsd is not None else nice_pixel(wanted / unit)
    left, bottom = ring.min(axis=0)
    right, top = ring.max(axis=0)
    count = (right - left) / pixel * (top - bottom) / pixel
    if count > LARGEST_GRID:
        raise InputError(
            f"{wanted:g} m over {(right - left) * unit:.0f} x {(top - bottom) * unit:.0f} m makes "
            f"{count:.1e} px; use a coarser one, or check the photos' positions",
            field="gsd",
        )
    return Grid.over((left, bottom, right, top), pixel=pixel, crs_wkt=frame.horizontal.to_wkt())
