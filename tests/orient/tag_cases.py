"""Photos with tags made by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from georef_gis.geodesy import Height, HeightKind, Origin
from georef_gis.model.photo import AttitudeTag, Geotag, Photo

SITE = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)


def geotag(
    east: float = 0.0,
    north: float = 0.0,
    height: float | None = 337.6,
    kind: HeightKind = HeightKind.ELLIPSOIDAL,
    **more: Any,
) -> Geotag:
    lat, lon, _ = SITE.geo_from_enu([east, north, 0.0])
    value = None if height is None else Height(value=height, kind=kind)
    return Geotag(lat=float(lat), lon=float(lon), height=value, **more)


def attitude(
    dialect: str,
    yaw: float | None = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
    **more: Any,
) -> AttitudeTag:
    """Angles in degrees."""
    return AttitudeTag(
        dialect=dialect,
        roll=math.radians(roll),
        pitch=math.radians(pitch),
        yaw=None if yaw is None else math.radians(yaw),
        **more,
    )


def photo(name: str = "A", **more: Any) -> Photo:
    more.setdefault("geotag", geotag())
    return Photo(id=name, path=Path(f"{name}.JPG"), width=1296, height=864, **more)
