"""The vertical part of a compound CRS: what its heights are measured from, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass

from pyproj import CRS

from georef_gis.errors import CrsError
from georef_gis.geodesy.geoids import GEOIDS

# EPSG codes of heights -> geoid by its name in `geoids`; Alaska's NAVD88 is by GEOID12B
_GEOID_OF = {
    5773: "egm96", 3855: "egm2008", 5703: "geoid18", 6360: "geoid18", 8228: "geoid18",
    6641: "geoid18", 6642: "geoid18", 6647: "cgvd2013",
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
    geoid = _GEOID_OF.get(code or 0)
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
