"""The way from one date's map to the other's, found once."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import CrsError

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import CRS

# (..., 2) in units of one map -> (..., 2) of the other
Way = Callable[["Array"], "Array"]
# realisations whose latitudes and longitudes differ by a metre or so
_ALIKE = "NAD83"


@functools.lru_cache(maxsize=8)
def way_between(wkt: str, own: CRS) -> tuple[Way, str]:
    """Way from a map to another one, and a doubt where two datums are taken as one.

    Maps are warped onto each other by PROJ's best guess. Where grids are missing between two
    realisations of NAD83 that takes them as one, and photos are to lie where their map does.

    Parameters
    ----------
    wkt
        CRS of the map that places are given on.

    Raises
    ------
    CrsError
        If there is no way, as without a grid between other datums.
    """
    from georef_gis.geodesy import CRS
    from georef_gis.geodesy.reference_systems import horizontal_crs

    theirs = horizontal_crs(CRS.from_wkt(wkt))
    if theirs == own:
        return lambda xy: xy, ""
    try:
        return _steps((theirs, own)), ""
    except CrsError:
        bases = [crs.geodetic_crs for crs in (theirs, own)]
        alike = [base for base in bases if base is not None and base.name.startswith(_ALIKE)]
        if len(alike) < len(bases):
            raise
    return _steps((theirs, alike[0]), (alike[1], own)), (
        f"{alike[0].name} and {alike[1].name} are taken as one, within a metre or so, as the grids "
        "that part them are not installed (`georef grids`)"
    )


def _steps(*ends: tuple[CRS, CRS]) -> Way:
    from georef_gis.geodesy.reference_systems import transformer_between

    found = [transformer_between(*pair) for pair in ends]

    def way(xy: Array) -> Array:
        for one in found:
            xy = np.stack(one.transform(xy[..., 0], xy[..., 1])[:2], axis=-1)
        return xy

    return way
