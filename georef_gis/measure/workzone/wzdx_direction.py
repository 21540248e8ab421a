"""Whether the direction that a feed states agrees with the way its devices run.

WZDx means the direction that the route is signed with, "regardless of the real heading angle": a
northbound route may run east for miles, and hardly ever runs south.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.ellipsoid import Origin
from georef_gis.errors import InputError

if TYPE_CHECKING:
    from georef_gis.measure.workzone.wzdx_settings import DevicePlace, WzdxSettings

# deg clockwise from north; loops and what is not known have none
HEADINGS = {"northbound": 0.0, "eastbound": 90.0, "southbound": 180.0, "westbound": 270.0}
# deg between name and bearing. Up to the first one a road bends; from the second one on the
# opposite name is nearer than the first one allows.
DOUBTED, OPPOSITE = 60.0, 120.0
# of the way along the devices, from the first to the last: below it they turn rather than run
_RUNS = 0.5
_CONFIRMED = "wzdx.direction_as_signed = true"


def direction_doubts(settings: WzdxSettings, places: Sequence[DevicePlace]) -> list[str]:
    """What is doubtful about the stated direction, one line each.

    Nothing is said of a direction that the user confirmed (`direction_as_signed`), or that is no
    point of the compass.

    Parameters
    ----------
    places
        Devices from the first to the last that drivers meet.

    Raises
    ------
    InputError
        If the devices run the opposite way.
    """
    stated = settings.values["direction"]
    heading = HEADINGS.get(stated) if isinstance(stated, str) else None
    if heading is None or settings.values.get("direction_as_signed", False):
        return []
    bearing, straightness = _bearing(places)
    off = _between(bearing, heading)
    # also true of no bearing at all
    if not off > DOUBTED:
        return []
    nearest = min(HEADINGS, key=lambda name: _between(bearing, HEADINGS[name]))
    found = (
        f"'{stated}', but from {places[0].name} to {places[-1].name} the devices run towards "
        f"{bearing:.0f} deg ({nearest}), {off:.0f} deg from it"
    )
    if off > OPPOSITE and straightness >= _RUNS:
        raise InputError(
            f'{found}; set it to "{nearest}", or correct zone.travel (or the devices\' order) if '
            f"traffic goes the other way; if the route is signed so here, set {_CONFIRMED}",
            source=settings.source,
            field="wzdx.direction",
        )
    return [
        f"wzdx.direction: {found}: right if the route is signed so here ({_CONFIRMED} says so), "
        f'else set it to "{nearest}" or correct zone.travel'
    ]


def _bearing(places: Sequence[DevicePlace]) -> tuple[float, float]:
    """Degrees from true north from the first to the last, and that way over the one along all.

    NaN where the last device stands on the first.
    """
    first = places[0]
    origin = Origin(
        lat=math.radians(first.lat), lon=math.radians(first.lon), height_ellipsoidal=0.0
    )
    geo = np.radians([[place.lat, place.lon, 0.0] for place in places])
    en = origin.enu_from_geo(geo)[:, :2]
    east, north = (float(v) for v in en[-1] - en[0])
    along = float(np.linalg.norm(np.diff(en, axis=0), axis=1).sum())
    straight = math.hypot(east, north)
    if straight <= 0.0:
        return math.nan, 0.0
    return math.degrees(math.atan2(east, north)) % 360.0, straight / along


def _between(first: float, second: float) -> float:
    """Angle between two bearings, deg, 0 to 180."""
    return abs((first - second + 180.0) % 360.0 - 180.0)
