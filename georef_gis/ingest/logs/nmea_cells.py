"""Cells of NMEA 0183 sentences: numbers, clock, date and angles, each of which may be empty."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from georef_gis.ingest.logs.gnss_values import day_of

# A receiver without an almanac starts in 1980 or 1999.
_FIRST_YEAR = 2000


def number(cells: Sequence[str] | None, at: int) -> float:
    """Finite number of a cell, NaN where it has none."""
    if cells is None or at >= len(cells):
        return math.nan
    try:
        value = float(cells[at])
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def integer(cells: Sequence[str] | None, at: int) -> int:
    """Whole number of a cell, -1 where it has none."""
    value = number(cells, at)
    return int(value) if value == value else -1


def text_of(cells: Sequence[str] | None, at: int) -> str:
    """Text of a cell in capitals, empty where there is none."""
    return cells[at].strip().upper() if cells is not None and at < len(cells) else ""


def second_of_day(text: str) -> float | None:
    """Seconds of day of hhmmss.sss; 60 s in a leap second."""
    match = re.fullmatch(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", text.strip())
    if not match:
        return None
    hour, minute, second = int(match[1]), int(match[2]), float(match[3])
    if hour > 23 or minute > 59 or second >= 61.0:
        return None
    return hour * 3600.0 + minute * 60.0 + second


def date_of(name: str, cells: list[str]) -> int | None:
    """Days since 1980-01-06 of RMC's or ZDA's date; None where it is not yet known."""
    if name == "ZDA":
        day, month, year = (integer(cells, i) for i in (1, 2, 3))
    elif name == "RMC" and text_of(cells, 1) == "A" and re.fullmatch(r"\d{6}", text_of(cells, 8)):
        text = text_of(cells, 8)
        day, month, year = int(text[:2]), int(text[2:4]), int(text[4:])
        year += 2000 if year < 80 else 1900
    else:
        return None
    return day_of(year, month, day) if year >= _FIRST_YEAR else None


def angle(cells: Sequence[str] | None, at: int, letters: str) -> float:
    """Degrees of dddmm.mmmm and the letter behind it, NaN where it is none."""
    value, letter = number(cells, at), text_of(cells, at + 1)
    if not value >= 0.0 or letter not in {letters[0], letters[1]}:
        return math.nan
    degrees, minutes = divmod(value, 100.0)
    if minutes >= 60.0:
        return math.nan
    return (degrees + minutes / 60.0) * (1.0 if letter == letters[0] else -1.0)
