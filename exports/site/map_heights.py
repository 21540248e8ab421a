"""Heights as the vertical part of the project's CRS promises them, such as NAVD88 in feet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from georef_gis.geodesy import geoid_undulation

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame, VerticalPart


def heights_above(part: VerticalPart, frame: MapFrame, lonlat: Array, height: Array) -> Array:
    """Heights above the datum of a vertical part, m, NaN if not known; shape (n,).

    Parameters
    ----------
    lonlat : shape (n, 2)
        deg, of the datum of the positions.
    height : shape (n,)
        Above the ellipsoid, m.

    Raises
    ------
    CrsError
        If the grid of the geoid is not there at the site. Beyond its rim, where only what was moved
        by mistake can be, heights are not known.
    """
    out = np.full(len(height), np.nan)
    known = np.isfinite(height) & np.isfinite(lonlat).all(axis=1)
    if known.any():
        geoid_undulation(frame.origin.lat, frame.origin.lon, geoid=part.geoid)
        lon, lat = np.radians(lonlat[known]).T
        undulation = geoid_undulation(
            lat, lon, geoid=part.geoid, datum=frame.gnss_datum, partly=True
        )
        out[known] = height[known] - undulation
    return out


def map_heights(frame: MapFrame, lonlat: Array, height: Array) -> Array:
    """Values of the column `height_map`, in the unit of the vertical part; NaN without one.

    Parameters are those of `heights_above`.
    """
    part = frame.vertical
    if part is None:
        return np.full(len(height), np.nan)
    return heights_above(part, frame, lonlat, height) / part.unit


def told_of_map_heights(frame: MapFrame) -> str:
    """What the column `height_map` holds, in words."""
    part = frame.vertical
    if part is None:
        return "height_map is empty, as the CRS of the project has no vertical part"
    return f"height_map is {part.name} by the geoid {part.geoid}, in {part.unit_name}"
