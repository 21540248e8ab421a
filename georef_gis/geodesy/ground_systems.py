"""Ground ("surface") systems: a State Plane grid, scaled to lengths as they are on the ground.

Written behind any CRS: `EPSG:6549 ground 1.0000987`, with `about EASTING,NORTHING` the point that
keeps its coordinates (else 0,0: all coordinates are multiplied), and `shift EAST,NORTH` what is
added after scaling, both in units of the CRS.

Notes
-----
The result is the same projection with another scale factor and false origin, an ordinary
projected CRS: a derived or engineering CRS would say more, but hardly a program reads one. A cone
of two standard parallels becomes that of its one central parallel, which is the same cone (Snyder,
USGS Professional Paper 1395 (1987), eqs. 15-1 to 15-8 and p. 108): the coordinates are those of
the grid times the factor to the last digit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from pyproj import CRS
from pyproj.crs import CompoundCRS

from georef_gis.errors import CrsError

_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_GROUND = re.compile(
    rf"(?P<base>.+?)\s+ground\s+(?P<factor>{_NUMBER})"
    rf"(?:\s+about\s+(?P<about>{_NUMBER}\s*,\s*{_NUMBER}))?"
    rf"(?:\s+shift\s+(?P<shift>{_NUMBER}\s*,\s*{_NUMBER}))?",
    re.IGNORECASE | re.DOTALL,
)
# Beyond, at 6400 m of height and 1000 ppm of scale, no factor is one of a road's site.
_LEAST, _MOST = 0.998, 1.002
# EPSG codes of methods and parameters: IOGP Guidance Note 7-2
_LAMBERT_2SP, _LAMBERT_1SP = 9802, 9801
_SCALED = {9801: 8805, 9807: 8805, 9812: 8815, 9815: 8815}
_FALSE = ((8806, 8807), (8816, 8817), (8826, 8827))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """How ground coordinates follow from those of a grid.

    `factor` is ground over grid distance (the combined adjustment factor); `about`, the point that
    keeps its coordinates, and `shift` in units of the grid.
    """

    factor: float
    about: tuple[float, float] = (0.0, 0.0)
    shift: tuple[float, float] = (0.0, 0.0)

    @property
    def told(self) -> str:
        """As it is written behind a CRS."""
        parts = [f"ground {self.factor!r}"]
        for word, pair in (("about", self.about), ("shift", self.shift)):
            if any(pair):
                parts.append(f"{word} {pair[0]:.12g},{pair[1]:.12g}")
        return " ".join(parts)


def split_ground(text: str) -> tuple[str, Ground | None]:
    """Text of a CRS without its words about the ground, and what they say.

    Raises
    ------
    CrsError
        If the factor is none of a ground system.
    """
    found = _GROUND.fullmatch(text.strip())
    if found is None:
        if re.search(r"\sground\b[^\"\]]*$", text, re.IGNORECASE):
            raise CrsError(
                f"'{text[-60:]}' is not understood; write e.g. EPSG:6549 ground 1.0000987, or "
                "... ground 1.0000987 about 2000000,700000 shift -1000000,0",
                field="crs",
            )
        return text, None
    factor = float(found["factor"])
    if not _LEAST < factor < _MOST or factor == 1.0:
        raise CrsError(
            f"ground factor {found['factor']} is none: give ground over grid distance, such as "
            f"1.0000987 (between {_LEAST} and {_MOST})",
            field="crs",
        )
    return found["base"], Ground(
        factor=factor, about=_pair(found["about"]), shift=_pair(found["shift"])
    )


def ground_factor(crs: CRS) -> float | None:
    """Factor of a ground system of ours by its name; None of any other CRS."""
    found = re.search(rf" ground ({_NUMBER})(?: (?:about|shift) .*)?$", crs.name)
    return float(found[1]) if found else None


def _pair(text: str | None) -> tuple[float, float]:
    if text is None:
        return 0.0, 0.0
    first, second = text.split(",")
    return float(first), float(second)


def ground_system(crs: CRS, ground: Ground) -> CRS:
    """Projected CRS whose coordinates are the scaled ones of another; compounds keep their heights.

    Raises
    ------
    CrsError
        If the projection is none that can be scaled.
    """
    if crs.is_compound:
        across, *up = crs.sub_crs_list
        scaled = ground_system(across, ground)
        return CompoundCRS(f"{scaled.name} + {up[0].name}", [scaled, *up])
    if not crs.is_projected or crs.coordinate_operation is None:
        raise CrsError(
            f"'{crs.name}' is not a projected CRS and cannot be scaled to the ground", field="crs"
        )
    content = crs.to_json_dict()
    content.pop("id", None)
    content["name"] = f"{crs.name} {ground.told}"
    content["conversion"] = _scaled(crs, content["conversion"], ground)
    return CRS.from_json_dict(content)


def _scaled(crs: CRS, conversion: dict[str, Any], ground: Ground) -> dict[str, Any]:
    """Conversion whose eastings and northings are the scaled ones, as PROJJSON."""
    code, values = _one_scale(crs)
    unit = crs.axis_info[0].unit_conversion_factor
    values[_SCALED[code]] *= ground.factor
    for pair in _FALSE:
        for key, about, shift in zip(pair, ground.about, ground.shift, strict=True):
            if key in values:
                kept = (about + shift) * unit
                values[key] = kept + ground.factor * (values[key] - about * unit)
    method = {"name": _METHODS[code], "id": {"authority": "EPSG", "code": code}}
    parameters = [_parameter(key, value, crs) for key, value in values.items()]
    return {"name": f"{conversion['name']} {ground.told}", "method": method,
            "parameters": parameters}  # fmt: skip


def _one_scale(crs: CRS) -> tuple[int, dict[int, float]]:
    """Code of a method that has a scale factor, and its parameters by code, rad and m.

    Raises
    ------
    CrsError
        If the projection is none that has one.
    """
    operation = crs.coordinate_operation
    assert operation is not None
    assert crs.ellipsoid is not None
    code = int(operation.method_code or 0)
    values = {
        int(p.code): float(p.value) * float(p.unit_conversion_factor)
        for p in operation.params
        if p.code.isdigit()
    }
    if code == _LAMBERT_2SP:
        inverse = crs.ellipsoid.inverse_flattening
        f = 1.0 / inverse if inverse else 0.0
        e2 = f * (2.0 - f)
        return _LAMBERT_1SP, _one_parallel(values, crs.ellipsoid.semi_major_metre, e2)
    if code not in _SCALED or _SCALED[code] not in values:
        raise CrsError(
            f"'{crs.name}' is a {operation.method_name}; only a Lambert conformal conic or a "
            "Mercator can be scaled to the ground",
            field="crs",
        )
    return code, values


_METHODS = {
    9801: "Lambert Conic Conformal (1SP)",
    9807: "Transverse Mercator",
    9812: "Hotine Oblique Mercator (variant A)",
    9815: "Hotine Oblique Mercator (variant B)",
}
_NAMES = {
    8801: "Latitude of natural origin", 8802: "Longitude of natural origin",
    8805: "Scale factor at natural origin", 8806: "False easting", 8807: "False northing",
    8811: "Latitude of projection centre", 8812: "Longitude of projection centre",
    8813: "Azimuth at projection centre", 8814: "Angle from Rectified to Skew Grid",
    8815: "Scale factor at projection centre", 8816: "Easting at projection centre",
    8817: "Northing at projection centre",
}  # fmt: skip
_ANGLES = {8801, 8802, 8811, 8812, 8813, 8814}


def _parameter(code: int, value: float, crs: CRS) -> dict[str, Any]:
    """One parameter of SI units as PROJJSON: angles in degrees, lengths in the CRS's unit."""
    axis = crs.axis_info[0]
    unit: Any
    if code in _ANGLES:
        # 13 digits: 1e-7 m; whole minutes do not come back as such from rad
        value, unit = round(math.degrees(value), 13), "degree"
    elif code in _SCALED.values():
        unit = "unity"
    else:
        value /= axis.unit_conversion_factor
        unit = "metre"
        if axis.unit_conversion_factor != 1.0:
            unit = {"type": "LinearUnit", "name": axis.unit_name,
                    "conversion_factor": axis.unit_conversion_factor}  # fmt: skip
    return {"name": _NAMES[code], "value": value, "unit": unit,
            "id": {"authority": "EPSG", "code": code}}  # fmt: skip


def _one_parallel(given: dict[int, float], a: float, e2: float) -> dict[int, float]:
    """Parameters of the same cone by its central parallel, from those by two; rad and m."""
    e = math.sqrt(e2)

    def m(lat: float) -> float:
        return math.cos(lat) / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)

    def t(lat: float) -> float:
        s = e * math.sin(lat)
        return math.tan(math.pi / 4.0 - lat / 2.0) * float(((1.0 + s) / (1.0 - s)) ** (e / 2.0))

    south, north, false_lat = given[8823], given[8824], given[8821]
    n = math.sin(south)
    if abs(north - south) > 1e-12:
        n = math.log(m(south) / m(north)) / math.log(t(south) / t(north))
    F = m(south) / (n * t(south) ** n)
    # Of the rounded angle that is written: the scale and the northing belong to it.
    middle = math.radians(round(math.degrees(math.asin(n)), 13))
    k0: float = n * F * t(middle) ** n / m(middle)
    return {
        8801: middle,
        8802: given[8822],
        8805: k0,
        8806: given[8826],
        8807: given[8827] + a * F * (t(false_lat) ** n - t(middle) ** n),
    }
