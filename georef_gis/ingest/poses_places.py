"""Latitude and longitude of the rows of a table of poses."""

from __future__ import annotations

import math
from collections.abc import Callable

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import CRS, MapFrame, Origin, horizontal_crs
from georef_gis.ingest.poses_table import PoseTable
from georef_gis.ingest.tables import Row
from georef_gis.units import wrap_angle

# rad; about 100 km
_FAR = math.radians(1.0)


def geo_of(
    crs: CRS, near: tuple[float, float] | None, table: PoseTable
) -> Callable[[Row], tuple[float, float]]:
    """Function from a row to latitude and longitude, rad."""
    plain = horizontal_crs(crs)
    if plain.is_projected:
        frame = MapFrame(Origin(lat=0.0, lon=0.0, height_ellipsoidal=0.0), plain)
        north_first = plain.axis_info[0].direction.lower() == "north"

        def from_map(row: Row) -> tuple[float, float]:
            order = north_first and (table.format == "pix4d" or "first" in row.columns)
            x, y = _xy(row, north_first=order)
            geo = frame.geo_from_map([x, y, 0.0])
            if order and near is not None and not _is_close(geo, near):
                # PIX4Dmatic follows the axes of the CRS, PIX4Dmapper writes x, y in any.
                other = frame.geo_from_map([y, x, 0.0])
                geo = other if _is_close(other, near) else geo
            if not all(math.isfinite(v) for v in geo):
                raise InputError(
                    f"{x:g}, {y:g} lies outside of '{plain.name}'; check the CRS and the order "
                    "of the columns",
                    source=row.source,
                    field="x, y",
                )
            return float(geo[0]), float(geo[1])

        return from_map

    def from_degrees(row: Row) -> tuple[float, float]:
        lon, lat = _xy(row, north_first=table.format == "pix4d" or "first" in row.columns)
        _check_degrees(row, lat, lon, near)
        return math.radians(lat), math.radians(lon)

    return from_degrees


def _xy(row: Row, *, north_first: bool) -> tuple[float, float]:
    """East or longitude, north or latitude, as written."""
    for east, north in (("x", "y"), ("lon", "lat")):
        if east in row.columns and north in row.columns:
            return row.required(east, east), row.required(north, north)
    first, second = row.required("first", "coordinate1"), row.required("second", "coordinate2")
    return (second, first) if north_first else (first, second)


def _check_degrees(row: Row, lat: float, lon: float, near: tuple[float, float] | None) -> None:
    """Refuse swapped or impossible coordinates and radians."""
    value = f"latitude {lat:g}, longitude {lon:g}"
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        if abs(lat) > 360.0 or abs(lon) > 360.0:
            cure = "these are no degrees; name the CRS of the file in [poses] crs"
        elif abs(lon) <= 90.0 and abs(lat) <= 180.0:
            cure = "latitude and longitude are swapped; exchange the two columns"
        else:
            cure = "check the columns"
        raise InputError(
            f"{value} is not on the Earth: {cure}", source=row.source, field="lat, lon"
        )
    if near is None or _close((math.radians(lat), math.radians(lon)), near):
        return
    if _close((math.radians(lon), math.radians(lat)), near):
        raise InputError(
            f"{value}: swapped, they lie where the photos are; exchange the two columns",
            source=row.source,
            field="lat, lon",
        )
    if _close((lat, lon), near):
        raise InputError(
            f"{value}: as radians they lie where the photos are; write degrees",
            source=row.source,
            field="lat, lon",
        )


def _is_close(geo: Array, near: tuple[float, float]) -> bool:
    place = float(geo[0]), float(geo[1])
    return all(math.isfinite(v) for v in place) and _close(place, near)


def _close(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return abs(a[0] - b[0]) < _FAR and abs(wrap_angle(a[1] - b[1])) * math.cos(b[0]) < _FAR
