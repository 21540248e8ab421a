"""Figures of a manual, such as the MUTCD, from a table file: what a work zone is screened against.

Feet and miles per hour stand in the file; lengths that come out are in m.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

DEFAULT_EDITION = "2009"
_PREFIX = "mutcd_"


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirement:
    """What a length must be; m.

    Parameters
    ----------
    low, high
        Limits, either may be infinite.
    per_offset
        What is added to `low` per m of a measured offset.
    source
        Place in the manual.
    """

    low: float = -math.inf
    high: float = math.inf
    per_offset: float = 0.0
    source: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _LengthFormula:
    from_mph: float
    to_mph: float
    power: float
    divisor: float
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class _TaperKind:
    share: float | None
    low: float
    high: float
    spacing: float | None
    tolerance: float
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """Figures of one edition."""

    edition: str
    title: str
    note: str
    formulas: tuple[_LengthFormula, ...]
    tapers: Mapping[str, _TaperKind]
    spacing: Mapping[str, float]
    spacing_source: str
    lane: Requirement
    signs: Mapping[str, tuple[float, ...]]
    signs_source: Mapping[str, str]

    def taper_length(self, kind: str, speed_mph: float) -> Requirement:
        """Length that a taper must have: limits plus so much per m of its offset.

        Raises
        ------
        InputError
            If the manual knows no such taper, or has no formula for the speed.
        """
        taper = self._taper(kind)
        if taper.share is None:
            return Requirement(low=taper.low, high=taper.high, source=taper.source)
        formula = next((f for f in self.formulas if f.from_mph <= speed_mph <= f.to_mph), None)
        if formula is None:
            spans = ", ".join(_span(f) for f in self.formulas)
            raise InputError(
                f"{speed_mph:g} mph: the manual has taper lengths for {spans}; give the speed it "
                "is posted with",
                field="zone.speed_mph",
            )
        per_offset = taper.share * speed_mph**formula.power / formula.divisor
        return Requirement(low=0.0, per_offset=per_offset,
                           source=f"{formula.source}; {taper.source}")  # fmt: skip

    def taper_spacing(self, kind: str, speed_mph: float) -> Requirement:
        """Distance that devices of a taper may have from each other."""
        taper = self._taper(kind)
        if taper.spacing is not None:
            return Requirement(high=taper.spacing + taper.tolerance, source=taper.source)
        return Requirement(high=self.spacing["taper"] * speed_mph, source=self.spacing_source)

    def tangent_spacing(self, speed_mph: float) -> Requirement:
        """Distance that devices along a lane may have from each other."""
        return Requirement(high=self.spacing["tangent"] * speed_mph, source=self.spacing_source)

    def sign_spacing(self, road_type: str) -> list[Requirement]:
        """Distances A, B and C of advance warning signs.

        Raises
        ------
        InputError
            If the manual knows no such road.
        """
        if road_type not in self.signs:
            raise InputError(f"{road_type!r} is no type of road; use one of "
                             f"{', '.join(self.signs)}", field="zone.road_type")  # fmt: skip
        source = self.signs_source[road_type]
        return [Requirement(low=low, source=source) for low in self.signs[road_type]]

    def _taper(self, kind: str) -> _TaperKind:
        if kind not in self.tapers:
            raise InputError(f"{kind!r} is no kind of taper; use one of {', '.join(self.tapers)}",
                             field="taper.kind")  # fmt: skip
        return self.tapers[kind]


def _span(formula: _LengthFormula) -> str:
    if math.isinf(formula.to_mph):
        return f"{formula.from_mph:g} mph and more"
    return f"{formula.from_mph:g} to {formula.to_mph:g} mph"


def editions() -> list[str]:
    """Editions that come with the package."""
    names = (one.name for one in resources.files("georef_gis.data").iterdir())
    return sorted(name[len(_PREFIX) : -5] for name in names
                  if name.startswith(_PREFIX) and name.endswith(".toml"))  # fmt: skip


def load_rules(edition: str = DEFAULT_EDITION, *, folder: Path = Path()) -> Rules:
    """Figures of an edition of the package, or of a file, relative to `folder`.

    Raises
    ------
    InputError
        If there is none, or the file lacks something.
    """
    if edition in editions():
        source = f"{_PREFIX}{edition}.toml"
        text = resources.files("georef_gis.data").joinpath(source).read_text("utf-8")
    else:
        path = folder / edition
        source = str(path)
        if not re.search(r"\.toml$", edition) or not path.is_file():
            raise InputError(f"{edition!r} is neither an edition ({', '.join(editions())}) nor a "
                             "TOML file; give one of them", field="zone.rules")  # fmt: skip
        text = path.read_text("utf-8", "replace")
    try:
        return _rules(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML ({error})", source=source) from error
    except KeyError as error:
        raise InputError(f"lacks {error}; copy it from mutcd_{DEFAULT_EDITION}.toml",
                         source=source) from error  # fmt: skip
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"has a value that does not fit ({error})", source=source) from error


def _rules(table: Mapping[str, Any]) -> Rules:
    edition, spacing, lane = table["edition"], table["spacing"], table["lane"]
    return Rules(
        edition=str(edition["id"]),
        title=str(edition["title"]),
        note=str(edition.get("note", "")),
        formulas=tuple(_formula(one) for one in table["taper_length"]),
        tapers={name: _taper_kind(one) for name, one in table["taper"].items()},
        spacing={
            name: _positive(spacing[f"{name}_ft_per_mph"]) * FOOT for name in ("taper", "tangent")
        },
        spacing_source=str(spacing["source"]),
        lane=Requirement(low=_positive(lane["min_ft"]) * FOOT, source=str(lane["source"])),
        signs={
            name: tuple(_positive(one[f"{letter}_ft"]) * FOOT for letter in "abc")
            for name, one in table["signs"].items()
        },
        signs_source={name: str(one["source"]) for name, one in table["signs"].items()},
    )


def _formula(one: Mapping[str, Any]) -> _LengthFormula:
    return _LengthFormula(
        from_mph=float(one.get("from_mph", 0.0)),
        to_mph=float(one.get("to_mph", math.inf)),
        power=_positive(one["power"]),
        divisor=_positive(one["divisor"]),
        source=str(one["source"]),
    )


def _taper_kind(one: Mapping[str, Any]) -> _TaperKind:
    spacing, share = one.get("spacing_ft"), one.get("share")
    return _TaperKind(
        share=None if share is None else _positive(share),
        low=0.0 if share is not None else _positive(one["min_ft"]) * FOOT,
        high=float(one.get("max_ft", math.inf)) * FOOT,
        spacing=None if spacing is None else _positive(spacing) * FOOT,
        tolerance=float(one.get("spacing_tolerance_ft", 0.0)) * FOOT,
        source=str(one["source"]),
    )


def _positive(value: Any) -> float:
    number = float(value)
    if not (math.isfinite(number) and number > 0):
        raise ValueError(f"{value}: must be positive")
    return number
