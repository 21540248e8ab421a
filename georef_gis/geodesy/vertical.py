"""The vertical part of a compound CRS: what its heights are measured from, and in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pyproj import CRS

from georef_gis.errors import CrsError
from georef_gis.geodesy.geoids import GEOIDS
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# EPSG codes of heights -> geoid by its name in `geoids`; Alaska's NAVD88 is by GEOID12B
_GEOID_OF = {
    5773: "egm96", 3855: "egm2008", 5703: "geoid18", 6360: "geoid18", 8228: "geoid18",
    6641: "geoid18", 6642: "geoid18", 6647: "cgvd2013",
}  # fmt: skip
# The same by datum, in the letters that EPSG, GDAL and ESRI have in common: a .prj of ESRI has no
# codes, and its systems names of their own, such as NAVD_1988_Foot_US.
_GEOID_OF_DATUM = {
    "northamericanverticaldatum1988": "geoid18", "navd88": "geoid18",
    "puertoricoverticaldatum2002": "geoid18", "virginislandsverticaldatum2009": "geoid18",
    "canadiangeodeticverticaldatum2013": "cgvd2013",
    "canadiangeodeticverticaldatum2013cgg2013": "cgvd2013", "cgvd2013": "cgvd2013",
    "egm96geoid": "egm96", "egm96": "egm96", "egm2008geoid": "egm2008", "egm2008": "egm2008",
}  # fmt: skip
# EPSG codes of heights by geoid and unit, m; of a unit that has none the name of the system
_NAVD88 = {1.0: 5703, US_SURVEY_FOOT: 6360, INTERNATIONAL_FOOT: 8228}
# relative; half of what parts the two feet
_ONE_FOOT = 1e-6
# names of units, without stops, hyphens and underscores
_UNITS = {
    "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0,
    "ft": INTERNATIONAL_FOOT, "foot": INTERNATIONAL_FOOT, "feet": INTERNATIONAL_FOOT,
    "international foot": INTERNATIONAL_FOOT, "international feet": INTERNATIONAL_FOOT,
    "foot international": INTERNATIONAL_FOOT, "ift": INTERNATIONAL_FOOT,
    "us survey foot": US_SURVEY_FOOT, "us survey feet": US_SURVEY_FOOT,
    "survey foot": US_SURVEY_FOOT, "survey feet": US_SURVEY_FOOT, "foot us": US_SURVEY_FOOT,
    "us foot": US_SURVEY_FOOT, "us feet": US_SURVEY_FOOT, "us ft": US_SURVEY_FOOT,
    "usft": US_SURVEY_FOOT, "ftus": US_SURVEY_FOOT, "sft": US_SURVEY_FOOT,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class VerticalPart:
    """Heights of a compound CRS: the geoid they are above, and their unit, m."""

    name: str
    code: int | None
    geoid: str
    unit: float
    unit_name: str


def vertical_part(crs: CRS) -> VerticalPart | None:
    """Vertical part of a CRS, None if it has none.

    Raises
    ------
    CrsError
        If it counts depths, or its heights are of no geoid that is known.
    """
    up = next((part for part in crs.sub_crs_list if part.is_vertical), None)
    if not crs.is_compound or up is None:
        return None
    axis = up.axis_info[0]
    if axis.direction != "up":
        raise CrsError(f"'{up.name}' counts downwards; use a system of heights", field="crs")
    code = up.to_epsg(min_confidence=70)
    geoid = _GEOID_OF.get(code or 0) or _geoid_of_datum(up)
    if geoid is None:
        raise CrsError(
            f"heights of '{up.name}' are of no geoid that is known (egm96, {', '.join(GEOIDS)}): "
            "use NAVD88, such as EPSG:6549+6360, or leave the vertical part away",
            field="crs",
        )
    return VerticalPart(
        name=str(up.name), code=code, geoid=geoid, unit=float(axis.unit_conversion_factor),
        unit_name=str(axis.unit_name),
    )  # fmt: skip


def _geoid_of_datum(up: CRS) -> str | None:
    """Geoid by the name of a vertical datum, such as 'North_American_Vertical_Datum_1988'."""
    name = "" if up.datum is None else up.datum.name.lower()
    return _GEOID_OF_DATUM.get(re.sub(r"[ _]of[ _]|[^a-z0-9]", "", name))


def height_unit(name: str) -> float | None:
    """Length of a unit of heights by its name in a file, m; None if the name is not known."""
    return _UNITS.get(" ".join(re.sub(r"[-_]", " ", name.replace(".", "")).lower().split()))


def navd88_code(unit: float) -> int | None:
    """EPSG code of NAVD88 heights in a unit, m; None if EPSG has none."""
    return next((code for u, code in _NAVD88.items() if abs(u / unit - 1.0) < _ONE_FOOT), None)
