"""Photos whose position is nowhere near that of the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.model.photo import Photo

# m; photos that keep together within this are never taken for strays
SITE_REACH = 20_000.0
# a stray is this many times as far from the middle as half of the photos are
STRAY_FACTOR = 10.0


def without_strays(photos: Sequence[Photo]) -> tuple[list[Photo], list[str]]:
    """Photos near the others, and why each of the rest is left out.

    One position on another continent would stretch every map over both.
    """
    import numpy as np

    from georef_gis.geodesy import ecef_from_geo

    placed = [(photo.id, photo.geotag) for photo in photos if photo.geotag is not None]
    if len(placed) < 3:
        return list(photos), []
    p = ecef_from_geo(np.array([[tag.lat, tag.lon, 0.0] for _, tag in placed]))
    far = np.linalg.norm(p - np.median(p, axis=0), axis=1)
    limit = max(SITE_REACH, STRAY_FACTOR * float(np.median(far)))
    strays = {key: float(d) for (key, _), d in zip(placed, far, strict=True) if d > limit}
    refused = [
        f"{photo.path.name}: GPS: {math.degrees(tag.lat):.4f}, {math.degrees(tag.lon):.4f} deg "
        f"lies {strays[photo.id] / 1000:.0f} km from the other photos: left out; check it for "
        "swapped latitude and longitude, or give the position in a file ([poses] file)"
        for photo in photos
        if photo.id in strays and (tag := photo.geotag) is not None
    ]
    return [photo for photo in photos if photo.id not in strays], refused
