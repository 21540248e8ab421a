"""Systems to draw maps in: from the texts that users write, with what is refused and why."""

from __future__ import annotations

import functools
import math
import re

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError as _PyprojCrsError
from pyproj.exceptions import ProjError

from georef_gis.errors import CrsError
from georef_gis.geodesy.ground_systems import ground_factor, ground_system, split_ground
from georef_gis.geodesy.reference_systems import horizontal_crs, metres_per_unit
from georef_gis.geodesy.vertical import vertical_part
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

_COMPOUND = re.compile(r"\s*EPSG:(\d+)\s*\+\s*(?:EPSG:)?(\d+)\s*", re.IGNORECASE)
# deg; beyond its area by more a system is that of another state
_FAR_OUTSIDE = 3.0
# m; within it two systems give the same coordinates
_SAME = 1e-4
# likeness, of 100, from which PROJ's name for a WKT is taken
_LIKENESS = 70
# relative; a foot is told from the other (2e-6) and from its own rounding in old files (3e-8)
_ONE_FOOT = 2e-7


def parse_crs(text: str) -> CRS:
    """CRS from 'EPSG:6602', 'EPSG:6527+6360', WKT or PROJ text, each with its words of the ground.

    Raises
    ------
    CrsError
        If PROJ does not know it.
    """
    # Notepad puts a byte order mark before a .prj.
    base, ground = split_ground(text.removeprefix("\ufeff"))
    try:
        crs = CRS.from_user_input(base.strip())
    except _PyprojCrsError as error:
        raise _unknown(base) from error
    return crs if ground is None else ground_system(crs, ground)


def _unknown(text: str) -> CrsError:
    parts = _COMPOUND.fullmatch(text)
    if parts:
        first, second = parts.groups()
        try:
            CRS.from_user_input(f"EPSG:{second}+{first}")
        except _PyprojCrsError:
            pass
        else:
            words = "has the heights first; the map stands first"
            return CrsError(f"'{text.strip()}' {words}: EPSG:{second}+{first}", field="crs")
    return CrsError(
        f"'{' '.join(text.split())[:60]}' is not a CRS that PROJ knows; give EPSG:code, "
        "EPSG:horizontal+vertical or WKT",
        field="crs",
    )


def map_crs(text: str) -> CRS:
    """Like `parse_crs`, for a projected CRS to draw a map in (compound allowed).

    A WKT without a code that is one of EPSG's but for its names, such as an ESRI .prj, becomes
    that of EPSG.

    Raises
    ------
    CrsError
        If the CRS is not projected (degrees are no unit for pixels), its axes are not east and
        north, its unit contradicts itself, or its heights are of no geoid that is known.
    """
    crs = parse_crs(text)
    if not crs.is_projected:
        raise CrsError(_no_map(crs), field="crs")
    across = horizontal_crs(crs)
    if {axis.direction for axis in across.axis_info[:2]} != {"east", "north"}:
        ways = " and ".join(axis.direction for axis in across.axis_info[:2])
        raise CrsError(
            f"the axes of '{crs.name}' run {ways}; use a system of east and north", field="crs"
        )
    _check_foot(across)
    vertical_part(crs)
    return _with_code(crs)


def _no_map(crs: CRS) -> str:
    code = crs.to_epsg()
    if "derived" in horizontal_crs(crs).type_name.lower():
        return (
            f"'{crs.name}' is a derived CRS, which hardly a program reads; a grid scaled to the "
            "ground is written as e.g. EPSG:6549 ground 1.0000987"
        )
    if crs.is_vertical and not crs.is_compound:
        with_map = f"EPSG:6549+{code}" if code else "EPSG:horizontal+vertical"
        return f"'{crs.name}' is a height system and no map; put it behind one, such as {with_map}"
    return f"'{crs.name}' is not a projected CRS; use 'auto' (UTM) or e.g. a State Plane code"


def _check_foot(crs: CRS) -> None:
    """Refuse a unit whose name says one foot and whose length is the other."""
    axis = crs.axis_info[0]
    name = axis.unit_name.lower().replace("_", " ")
    is_us = any(word in name for word in ("us", "u.s.", "survey"))
    if "f" not in name or "fathom" in name or not (is_us or name in {"foot", "feet", "ft"}):
        return
    said, other = US_SURVEY_FOOT, INTERNATIONAL_FOOT
    if not is_us:
        said, other = other, said
    if abs(axis.unit_conversion_factor / other - 1.0) < _ONE_FOOT:
        raise CrsError(
            f"the unit of '{crs.name}' is called '{axis.unit_name}' and is {other:.9g} m long, "
            f"which is the other foot ({said:.9g} m): mend the WKT; 2 ppm are a metre at 500 km",
            field="crs",
        )


# -- WKT without a code ------------------------------------------------------------------------


def _with_code(crs: CRS) -> CRS:
    """CRS of EPSG that a WKT without a code is, else the WKT's own."""
    # One of ours has no code, and looking for it takes 0.3 s.
    if crs.is_compound or ground_factor(crs) is not None or "id" in crs.to_json_dict():
        return crs
    code = _code_of(crs.to_wkt())
    return crs if code is None else CRS.from_epsg(code)


@functools.lru_cache(maxsize=8)
def _code_of(wkt: str) -> int | None:
    """EPSG code of a projected CRS by its parameters and the name of its datum, if it has one."""
    crs = CRS.from_wkt(wkt)
    code = crs.to_epsg(min_confidence=_LIKENESS)
    if code is None:
        return None
    known = CRS.from_epsg(code)
    return code if same_coordinates(crs, known) else None


def same_coordinates(first: CRS, second: CRS) -> bool:
    """Whether two projected CRSs give one coordinate to one latitude and longitude, to 0.1 mm."""
    area = second.area_of_use or first.area_of_use
    if area is None or first.geodetic_crs is None or second.geodetic_crs is None:
        return False
    east = area.east if area.east > area.west else area.east + 360.0
    lon, lat = np.meshgrid(np.linspace(area.west, east, 4), np.linspace(area.south, area.north, 4))
    try:
        a, b = (
            np.array(Transformer.from_crs(base, crs, always_xy=True).transform(lon, lat))
            for base, crs in ((first.geodetic_crs, first), (second.geodetic_crs, second))
        )
    except ProjError:
        return False
    return bool(np.all(np.abs(a - b) * metres_per_unit(second) < _SAME))


# -- doubts ------------------------------------------------------------------------------------


def differ_only_in_foot(first: CRS, second: CRS) -> bool:
    """Whether two maps are one but for US survey and international feet: 2 ppm of the coordinates.

    Sites with control in one of them and products in the other lie 1 m apart per 500 km of
    easting, which looks like a wrong datum.
    """
    maps = horizontal_crs(first), horizontal_crs(second)
    if not all(crs.is_projected and crs.coordinate_operation for crs in maps):
        return False
    feet = {metres_per_unit(crs) for crs in maps}
    wanted = (INTERNATIONAL_FOOT, US_SURVEY_FOOT)
    if len(feet) != 2 or not all(
        any(abs(foot / known - 1.0) < _ONE_FOOT for known in wanted) for foot in feet
    ):
        return False
    a, b = (_parameters(crs) for crs in maps)
    # False origins are told in either foot: 2 ppm of them is what is asked about.
    return set(a) == set(b) and all(
        math.isclose(a[key], b[key], rel_tol=3e-6, abs_tol=1e-9) for key in a
    )


def _parameters(crs: CRS) -> dict[str, float]:
    assert crs.coordinate_operation is not None
    params = crs.coordinate_operation.params
    return {p.name: float(p.value) * float(p.unit_conversion_factor) for p in params}


def outside_area(crs: CRS, lat: float, lon: float) -> float:
    """How far a place (rad) lies outside a CRS's area of use, deg; 0 within or if unknown."""
    area = horizontal_crs(crs).area_of_use
    if area is None:
        return 0.0
    y, x = math.degrees(lat), math.degrees(lon)
    down = max(area.south - y, y - area.north, 0.0)
    width = (area.east - area.west) % 360.0 or 360.0
    into = (x - area.west) % 360.0
    across = 0.0 if into <= width else min(into - width, 360.0 - into)
    return math.hypot(down, across * math.cos(lat))


def check_area(crs: CRS, lat: float, lon: float) -> None:
    """Refuse a CRS of another part of the Earth than a place (rad).

    Raises
    ------
    CrsError
        With both places.
    """
    away = outside_area(crs, lat, lon)
    if away <= _FAR_OUTSIDE:
        return
    area = horizontal_crs(crs).area_of_use
    assert area is not None
    raise CrsError(
        f"'{crs.name}' does not fit the photos' place, {math.degrees(lat):.4f}, "
        f"{math.degrees(lon):.4f} deg: it is made for lat {area.south:.1f} to {area.north:.1f}, "
        f"lon {area.west:.1f} to {area.east:.1f} deg, {away * 111.0:.0f} km away; "
        'use crs = "auto" or the zone of the site',
        field="crs",
    )
