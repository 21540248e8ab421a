"""Values of parameters that are more than one number, and quantities with a unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# m per unit
LENGTH_UNITS: dict[str, float] = {
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "km": 1e3,
    "in": INTERNATIONAL_FOOT / 12.0,
    "ft": INTERNATIONAL_FOOT,
    "usft": US_SURVEY_FOOT,
    "mi": 5280.0 * INTERNATIONAL_FOOT,
}
# rad per unit
ANGLE_UNITS: dict[str, float] = {
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": math.pi / 180.0,
    "arcmin": math.pi / 10_800.0,
    "arcsec": math.pi / 648_000.0,
    "gon": math.pi / 200.0,
}
SPELLINGS = {"°": "deg", "us-ft": "usft", "ftus": "usft", "us_ft": "usft", "px": "", "'": "arcmin"}
QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d\s].*)?$")


def unit_factor(kind: str, unit: str) -> float:
    """SI units per `unit`, of a parameter type; 1 for what is no length or angle.

    Raises
    ------
    ValueError
        If the unit is not one of that type.
    """
    table = {"Length": LENGTH_UNITS, "Angle": ANGLE_UNITS}.get(kind)
    if table is None:
        return 1.0
    if unit not in table:
        raise ValueError(f"no {kind.lower()} unit {unit!r}; use one of {', '.join(table)}")
    return table[unit]


def read_quantity(given: str | float, kind: str, declared: str) -> float:
    """Value in the declared unit of a number or of a text such as ``2.5cm``.

    Raises
    ------
    ValueError
        If it is no number, or carries a unit of another kind.
    """
    if not isinstance(given, str):
        return float(given)
    match = QUANTITY.match(given)
    if match is None:
        raise ValueError(f"{given!r} is no number with an optional unit")
    number, unit = float(match[1]), (match[2] or "").strip()
    unit = SPELLINGS.get(unit.lower(), unit)
    if unit in ("", declared):
        return number
    return number * unit_factor(kind, unit) / unit_factor(kind, declared)


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """A rectangle in a map CRS, in units of that CRS.

    Text form: ``west,south,east,north`` with an optional ``@EPSG:32617``; without it the
    project's CRS is meant.
    """

    west: float
    south: float
    east: float
    north: float
    crs: str | None = None

    def __post_init__(self) -> None:
        """Check the order of the sides."""
        if not (self.west < self.east and self.south < self.north):
            raise ValueError("an extent is west,south,east,north with west < east, south < north")

    @classmethod
    def parse(cls, text: str) -> Extent:
        """Extent of its text form."""
        (west, south, east, north), crs = _numbers(text, (4,), "west,south,east,north[@CRS]")
        return cls(west=west, south=south, east=east, north=north, crs=crs)

    def __str__(self) -> str:
        """Text form."""
        return _text((self.west, self.south, self.east, self.north), self.crs)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPoint:
    """A point in a map CRS, x/east first. Text form: ``x,y[,height][@EPSG:4326]``."""

    x: float
    y: float
    height: float | None = None
    crs: str | None = None

    @classmethod
    def parse(cls, text: str) -> MapPoint:
        """Point of its text form."""
        numbers, crs = _numbers(text, (2, 3), "x,y[,height][@CRS]")
        height = numbers[2] if len(numbers) == 3 else None
        return cls(x=numbers[0], y=numbers[1], height=height, crs=crs)

    def __str__(self) -> str:
        """Text form."""
        numbers = (self.x, self.y) if self.height is None else (self.x, self.y, self.height)
        return _text(numbers, self.crs)


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerFile:
    """A file of layers, and one of them where it is named.

    Text form: ``roads.gpkg`` or, as QGIS and GDAL write it, ``roads.gpkg|layername=centre``.
    """

    path: Path
    layer: str | None = None

    @classmethod
    def parse(cls, text: str) -> LayerFile:
        """File and layer of their text form.

        Raises
        ------
        ValueError
            If more is asked for, such as a part of the features: it would be ignored.
        """
        name, _, rest = text.partition("|")
        key, _, layer = rest.partition("=")
        if rest and (key != "layername" or not layer or "|" in layer):
            raise ValueError(f"{text!r} is not of the form file[|layername=name]")
        return cls(path=Path(name), layer=layer or None)

    def __str__(self) -> str:
        """Text form."""
        return f"{self.path}|layername={self.layer}" if self.layer else str(self.path)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoPixel:
    """A pixel of a photo, `uv` as stored: (0, 0) is the first pixel's centre.

    Text form: ``DJI_0042.JPG:1200.5,800``; the photo may be left out where the tool knows it.
    """

    photo: str
    u: float
    v: float

    @classmethod
    def parse(cls, text: str) -> PhotoPixel:
        """Pixel of its text form."""
        photo, _, pixel = text.rpartition(":")
        try:
            (u, v), _ = _numbers(pixel, (2,), "")
        except ValueError as error:
            raise ValueError(f"{text!r} is not of the form [photo:]u,v") from error
        return cls(photo=photo, u=u, v=v)

    def __str__(self) -> str:
        """Text form."""
        return f"{self.photo}:{self.u!r},{self.v!r}" if self.photo else f"{self.u!r},{self.v!r}"


def _numbers(text: str, counts: tuple[int, ...], form: str) -> tuple[tuple[float, ...], str | None]:
    body, _, crs = text.partition("@")
    try:
        numbers = tuple(float(part) for part in body.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{text!r} is not of the form {form}")
    return numbers, crs.strip() or None


def _text(numbers: tuple[float, ...], crs: str | None) -> str:
    return ",".join(map(repr, numbers)) + (f"@{crs}" if crs else "")
