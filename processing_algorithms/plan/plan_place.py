"""Where `plan_flight` plans: the area or line given, and whether its coordinates were swapped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from georef_gis.ellipsoid import Origin
    from georef_gis.frames import Array
    from georef_gis.geodesy import CRS
    from georef_gis.toolbox.values import MapPoint
    from processing_algorithms.plan.parameters import PlanFlightParameters

LonLat = tuple[float, float]

# deg; Antarctica, where the longitudes of North America come to lie as latitudes
_SOUTHMOST = -60.0
# deg; few fly north of it, and the longitudes of India and central Asia come to lie there
_NORTHMOST = 75.0
# km from the place of the photo: what is elsewhere, and what is at the same site or nearly
_ELSEWHERE, _NEAR = 1000.0, 200.0
# deg beyond the area of use of a CRS: it is drawn roughly
_MARGIN = 0.5
_EARTH_KM = 6371.0
_ORDER = "the order is lon,lat"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Corners of the area or places of the line, (n, 2) m on the plane of an origin amid them."""

    xy: Array
    origin: Origin
    doubts: tuple[str, ...] = ()


def planned_place(parameters: PlanFlightParameters) -> Place | None:
    """Place that the parameters give; None for a plan of nowhere.

    Raises
    ------
    InputError
        If more than one is given, it cannot be used, or its coordinates were swapped.
    """
    import numpy as np

    from georef_gis.ellipsoid import Origin
    from georef_gis.errors import InputError
    from georef_gis.geodesy import parse_crs
    from processing_algorithms.drawn import drawn

    given = [name for name in ("area", "line", "corner") if getattr(parameters, name)]
    if not given:
        return None
    if len(given) > 1:
        raise InputError(f"give one of {' and '.join(given)}", source="tool plan_flight")
    # one corner says it for all
    doubts = [line for corner in parameters.corner for line in _corner_doubts(corner)][:1]
    kind: Literal["area", "line"] = "line" if given == ["line"] else "area"
    shapes = drawn(
        kind, parameters.line or parameters.area, parameters.corner, parse_crs("EPSG:4326"),
        layer=parameters.layer,
    )  # fmt: skip
    if len(shapes) > 1:
        raise InputError(f"holds {len(shapes)} {kind}s; plan them one by one", source=given[0])
    vertices = shapes[0].vertices
    doubts += _shape_doubts(parameters, given[0], vertices)
    lon_lat = np.radians(vertices)
    middle = (lon_lat.min(axis=0) + lon_lat.max(axis=0)) / 2.0
    origin = Origin(lat=float(middle[1]), lon=float(middle[0]), height_ellipsoidal=0.0)
    geo = np.column_stack([lon_lat[:, 1], lon_lat[:, 0], np.zeros(len(lon_lat))])
    return Place(xy=origin.enu_from_geo(geo)[:, :2], origin=origin, doubts=tuple(doubts))


# -- swapped coordinates -----------------------------------------------------------------------


def _corner_doubts(corner: MapPoint) -> list[str]:
    """What is doubtful about the order of a corner's numbers.

    Raises
    ------
    InputError
        If they were swapped.
    """
    from georef_gis.errors import InputError
    from georef_gis.geodesy import horizontal_crs, parse_crs

    crs = horizontal_crs(parse_crs(corner.crs or "EPSG:4326"))
    if not crs.is_projected:
        swapped = f"{corner.y:.10g},{corner.x:.10g}"
        if abs(corner.y) > 90.0 >= abs(corner.x) and abs(corner.y) <= 360.0:
            raise InputError(
                f"{corner}: a latitude of {corner.y:g} deg is beyond 90 deg; {_ORDER}: {swapped}?",
                field="corner",
            )
        if -90.0 <= corner.y < _SOUTHMOST:
            raise InputError(
                f"{corner} lies in Antarctica, at {-corner.y:g} deg south; {_ORDER}: {swapped}? "
                "For a place there give --area, or x,y@CRS of a map",
                field="corner",
            )
        if _NORTHMOST < corner.y <= 90.0 and abs(corner.x) <= 90.0:
            return [
                f"corner {corner} lies at {corner.y:g} deg north; {_ORDER}, was {swapped} meant?"
            ]
    return [] if corner.crs is None else _beyond_use(corner, crs)


def _beyond_use(corner: MapPoint, crs: CRS) -> list[str]:
    """Whether a corner lies where its CRS is not for; refused if it would with x and y swapped."""
    from georef_gis.errors import InputError

    area = crs.area_of_use
    if area is None or _is_used(crs, corner.x, corner.y):
        return []
    told = (
        f"{corner} lies outside of where '{crs.name}' holds ({area.west:g} to {area.east:g} E, "
        f"{area.south:g} to {area.north:g} N)"
    )
    if _is_used(crs, corner.y, corner.x):
        order = "x,y, east first" if crs.is_projected else "lon,lat"
        raise InputError(
            f"{told}, {corner.y:.10g},{corner.x:.10g} inside; the order is {order}", field="corner"
        )
    return [f"corner {told}; check it and its CRS"]


def _is_used(crs: CRS, x: float, y: float) -> bool:
    """Whether a place lies in the area of use of its CRS."""
    import numpy as np

    from georef_gis.geodesy import parse_crs
    from georef_gis.geodesy.reference_systems import transformer_between

    if crs.is_projected:
        to_degrees = transformer_between(crs, parse_crs("EPSG:4326"))
        x, y = (float(v[0]) for v in to_degrees.transform(np.array([x]), np.array([y])))
    area = crs.area_of_use
    if area is None or not (math.isfinite(x) and math.isfinite(y)):
        return False
    # an area across the date line ends west of where it begins
    width = (area.east - area.west) % 360.0 or 360.0
    from_west = (x - area.west + _MARGIN) % 360.0
    is_in_width = from_west <= width + 2.0 * _MARGIN
    return is_in_width and area.south - _MARGIN <= y <= area.north + _MARGIN


def _shape_doubts(parameters: PlanFlightParameters, given: str, lon_lat: Array) -> list[str]:
    """Whether a shape lies in Antarctica, or far from the photo while swapped it does not.

    Raises
    ------
    InputError
        If the photo tells that the coordinates were swapped.
    """
    from georef_gis.errors import InputError

    lon, lat = (float(v) for v in lon_lat.mean(axis=0))
    taken = _taken_at(parameters)
    if taken is not None and abs(lon) <= 90.0:
        away, swapped = _distance((lon, lat), taken), _distance((lat, lon), taken)
        if away > _ELSEWHERE and swapped < _NEAR:
            assert parameters.photo is not None
            raise InputError(
                f"lies {away:.0f} km from where {parameters.photo.name} was taken, and with "
                f"latitude and longitude swapped {swapped:.0f} km; {_ORDER}",
                source=given,
            )
    if given != "corner" and lat < _SOUTHMOST:
        return [f"the {given} lies in Antarctica, at {-lat:.4g} deg south; {_ORDER} in files too"]
    return []


def _taken_at(parameters: PlanFlightParameters) -> LonLat | None:
    """Longitude and latitude of the photo of the camera, deg, if it tells them."""
    if parameters.photo is None:
        return None
    from georef_gis.ingest.photos import read_photo

    tag = read_photo(parameters.photo).geotag
    return None if tag is None else (math.degrees(tag.lon), math.degrees(tag.lat))


def _distance(first: LonLat, second: LonLat) -> float:
    """Distance on a sphere, km."""
    (lon1, lat1), (lon2, lat2) = ([math.radians(v) for v in one] for one in (first, second))
    half = (
        math.sin((lat2 - lat1) / 2.0) ** 2
        + math.cos(lat1) * math.cos(lat2) * math.sin((lon2 - lon1) / 2.0) ** 2
    )
    return 2.0 * _EARTH_KM * math.asin(math.sqrt(min(max(half, 0.0), 1.0)))
