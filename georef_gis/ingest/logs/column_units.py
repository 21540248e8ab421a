"""Units as they are written in headers and mappings of text logs, and their factors to SI."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

Dimension = Literal[
    "angle", "rate", "acceleration", "length", "speed", "time", "count", "text", "field"
]

# m/s2; the standard acceleration of gravity, exact (3rd CGPM 1901)
STANDARD_GRAVITY = 9.80665
# m/s; international mile and nautical mile per hour, exact
MILE_PER_HOUR = 1609.344 / 3600.0
KNOT = 1852.0 / 3600.0
_DEG = math.pi / 180.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A unit: how it is written, what it measures, and its size in SI."""

    name: str
    dimension: Dimension
    factor: float


# dimension -> (name, factor to SI, other spellings)
_TABLE: dict[Dimension, tuple[tuple[str, float, str], ...]] = {
    "angle": (
        ("deg", _DEG, "degs degree degrees decdeg decimaldegrees ddeg"),
        ("rad", 1.0, "rads radian radians"),
        ("deg*1e7", _DEG * 1e-7, "dege7 1e-7deg deg1e7 e7 1e7 1e-7 degx1e7 deg*10^7 deg*107"),
        ("mrad", 1e-3, ""),
        ("cdeg", _DEG * 1e-2, "centideg centidegrees"),
    ),
    "rate": (
        ("deg/s", _DEG, "dps degs degps deg/sec degree/s degrees/s degpersec degrees/sec"),
        ("rad/s", 1.0, "rads radps rps rad/sec radian/s radians/s radpersec"),
        ("mrad/s", 1e-3, "mrads"),
        ("mdeg/s", _DEG * 1e-3, "mdps mdegs"),
        ("deg/h", _DEG / 3600.0, "degh deg/hr"),
    ),
    "acceleration": (
        ("m/s2", 1.0, "ms2 mss m/s/s mps2 m/sec2 m/ss ms-2 m/s**2 mpss"),
        ("g", STANDARD_GRAVITY, "gs gravity g0 gn"),
        ("mg", STANDARD_GRAVITY * 1e-3, "milli-g millig"),
        ("ft/s2", INTERNATIONAL_FOOT, "fts2 fps2"),
    ),
    "length": (
        ("m", 1.0, "metre metres meter meters mtr"),
        ("ft", INTERNATIONAL_FOOT, "feet foot"),
        ("ftus", US_SURVEY_FOOT, "ussurveyfoot ussurveyfeet usft sft"),
        ("km", 1e3, "kilometre kilometer"),
        ("cm", 1e-2, ""),
        ("mm", 1e-3, ""),
    ),
    "speed": (
        ("m/s", 1.0, "mps ms m/sec metres/s meters/s"),
        ("km/h", 1.0 / 3.6, "kmh kph kmph km/hr"),
        ("kn", KNOT, "kt kts knot knots"),
        ("mph", MILE_PER_HOUR, "mi/h mi/hr miles/h"),
        ("ft/s", INTERNATIONAL_FOOT, "fps fts ft/sec"),
        ("cm/s", 1e-2, "cms"),
        ("mm/s", 1e-3, "mms"),
    ),
    "time": (
        ("s", 1.0, "sec secs second seconds"),
        ("ms", 1e-3, "msec millisecond milliseconds millis milli"),
        ("us", 1e-6, "usec microsecond microseconds micros micro"),
        ("ns", 1e-9, "nsec nanosecond nanoseconds nanos nano"),
        ("min", 60.0, "minute minutes"),
    ),
}


def _plain(text: str) -> str:
    """Spelling without case, blanks, bars and powers."""
    text = text.strip().lower()
    for old, new in (("²", "2"), ("⁻", "-"), ("°", "deg"), ("µ", "u"), ("μ", "u"), (" per ", "/")):
        text = text.replace(old, new)
    return re.sub(r"[\s_^.·]", "", text)


def _spellings() -> dict[str, tuple[Unit, ...]]:
    """Units by spelling; one spelling may be of several dimensions (`ms`, `degs`, `rads`)."""
    found: dict[str, tuple[Unit, ...]] = {}
    for dimension, rows in _TABLE.items():
        for name, factor, others in rows:
            unit = Unit(name=name, dimension=dimension, factor=factor)
            for text in dict.fromkeys((name, name.replace("/", ""), *others.split())):
                if all(u.dimension != dimension for u in found.get(text, ())):
                    found[text] = (*found.get(text, ()), unit)
    return found


_SPELLINGS = _spellings()


def units_of(text: str) -> tuple[Unit, ...]:
    """Units that a text may mean; none if it is no unit."""
    return _SPELLINGS.get(_plain(text), ())


def unit_of(text: str, dimension: Dimension) -> Unit | None:
    """Unit of a dimension by any of its spellings, or None."""
    return next((u for u in units_of(text) if u.dimension == dimension), None)


def names_of(dimension: Dimension) -> str:
    """Units of a dimension for a message."""
    return ", ".join(row[0] for row in _TABLE.get(dimension, ()))
