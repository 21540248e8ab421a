"""Check of a WZDx work zone feed against the published rules of its version, without a network.

The rules stand in a table per version, `georef_gis/data/wzdx_*.toml`; what no table can say is
below: the geometry, the order of times, whether a list of lanes is complete.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from importlib import resources
from typing import Any

from georef_gis.errors import InputError

_PREFIX = "wzdx_"
# RFC 3339, section 5.6
_DATE_TIME = re.compile(
    r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII
)  # fmt: skip
_EMAIL = re.compile(r"[^@\s]+@[^@\s]+")
_TYPE = re.compile(r"(\[?)(@?[A-Za-z_-]+)(\]?)(\+?)(?: (\d+))?( !)?")

Problem = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Field:
    name: str
    is_list: bool
    least: float | None
    not_empty: bool
    must: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class WzdxRules:
    """Rules of one version.

    Parameters
    ----------
    words
        Allowed words by the name of their list.
    objects
        Field -> what it must be, by the name of the object.
    """

    version: str
    licence: str
    words: Mapping[str, tuple[str, ...]]
    objects: Mapping[str, Mapping[str, _Field]]
    either: Mapping[str, tuple[tuple[str, str], ...]]
    together: Mapping[str, tuple[tuple[str, str], ...]]


def versions() -> list[str]:
    """Versions there are rules for."""
    names = (one.name for one in resources.files("georef_gis.data").iterdir())
    return sorted(
        name[len(_PREFIX) : -5].replace("_", ".")
        for name in names
        if name.startswith(_PREFIX) and name.endswith(".toml")
    )


@cache
def wzdx_rules(version: str) -> WzdxRules:
    """Rules of a version.

    Raises
    ------
    InputError
        If there are none.
    """
    if version not in versions():
        raise InputError(f"{version!r} is no version of WZDx that is known here; use one of "
                         f"{', '.join(versions())}", field="version")  # fmt: skip
    name = f"{_PREFIX}{version.replace('.', '_')}.toml"
    table = tomllib.loads(resources.files("georef_gis.data").joinpath(name).read_text("utf-8"))
    return WzdxRules(
        version=table["version"],
        licence=table["licence"],
        words={key: tuple(words) for key, words in table["words"].items()},
        objects={
            key: {field: _field_of(text) for field, text in fields.items()}
            for key, fields in table["objects"].items()
        },
        either=_pairs(table["either"]),
        together=_pairs(table["with"]),
    )


def _pairs(table: Mapping[str, Any]) -> dict[str, tuple[tuple[str, str], ...]]:
    return {key: tuple((a, b) for a, b in pairs) for key, pairs in table.items()}


def _field_of(text: str) -> _Field:
    found = _TYPE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r} is no type")
    opened, name, _, plus, least, must = found.groups()
    return _Field(name=name, is_list=bool(opened), not_empty=bool(plus), must=bool(must),
                  least=None if least is None else float(least))  # fmt: skip


def check_feed(feed: object, version: str) -> list[str]:
    """What breaks the rules of a version, a line each: where, and what; empty = nothing."""
    rules = wzdx_rules(version)
    return [f"{where or 'feed'}: {what}" for where, what in _feed_problems(feed, rules)]


def _feed_problems(feed: object, rules: WzdxRules) -> Iterator[Problem]:
    if not isinstance(feed, dict):
        yield "", "is no JSON object"
        return
    if feed.get("type") != "FeatureCollection":
        yield "type", "is not FeatureCollection"
    if "feed_info" not in feed:
        yield "feed_info", "is missing"
    else:
        yield from _object(feed["feed_info"], "FeedInfo", "feed_info", rules)
        yield from _feed_info(feed["feed_info"], rules)
    features = feed.get("features")
    if not isinstance(features, list):
        yield "features", "is no list"
        return
    seen: set[object] = set()
    for k, feature in enumerate(features):
        where = f"features[{k}]"
        yield from _feature(feature, where, rules)
        key = feature.get("id") if isinstance(feature, dict) else None
        if isinstance(key, str):
            if key in seen:
                yield f"{where}.id", "stands twice"
            seen.add(key)


def _feed_info(info: object, rules: WzdxRules) -> Iterator[Problem]:
    if not isinstance(info, dict):
        return
    if isinstance(info.get("version"), str) and info["version"] != rules.version:
        yield "feed_info.version", f"is {info['version'][:20]!r}, not {rules.version}"
    if "license" in info and info["license"] != rules.licence:
        yield "feed_info.license", f"is not {rules.licence}"


def _feature(feature: object, where: str, rules: WzdxRules) -> Iterator[Problem]:
    if not isinstance(feature, dict):
        yield where, "is no JSON object"
        return
    if feature.get("type") != "Feature":
        yield f"{where}.type", "is not Feature"
    if not isinstance(feature.get("id"), str) or not feature["id"]:
        yield f"{where}.id", "is missing or no text"
    yield from _geometry(feature.get("geometry"), f"{where}.geometry")
    properties = feature.get("properties")
    yield from _object(properties, "WorkZone", f"{where}.properties", rules)
    if isinstance(properties, dict):
        yield from _work_zone(properties, f"{where}.properties")


def _work_zone(properties: dict[str, Any], where: str) -> Iterator[Problem]:
    core = properties.get("core_details")
    if isinstance(core, dict) and core.get("event_type") != "work-zone":
        yield f"{where}.core_details.event_type", "is not work-zone, which is all that is made here"
    start, end = (_time(properties.get(key)) for key in ("start_date", "end_date"))
    if start and end and end < start:
        yield f"{where}.end_date", "lies before start_date"
    lanes = properties.get("lanes")
    if isinstance(lanes, list) and lanes:
        orders = [lane.get("order") if isinstance(lane, dict) else None for lane in lanes]
        if sorted(map(repr, orders)) != sorted(map(repr, range(1, len(lanes) + 1))):
            yield (
                f"{where}.lanes",
                ("are not numbered 1 to their count: a list of lanes must be complete"),
            )


def _geometry(geometry: object, where: str) -> Iterator[Problem]:
    if not isinstance(geometry, dict):
        yield where, "is missing"
        return
    kind, points = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("LineString", "MultiPoint"):
        yield f"{where}.type", f"is {str(kind)[:30]!r}; only LineString and MultiPoint are allowed"
    if not isinstance(points, list) or len(points) < 2:
        yield f"{where}.coordinates", "are fewer than 2 positions"
        return
    if kind == "MultiPoint" and len(points) > 2:
        yield f"{where}.type", "is MultiPoint with 3 or more positions; use LineString"
    for k, point in enumerate(points):
        if not _is_position(point):
            yield f"{where}.coordinates[{k}]", "is no [longitude, latitude] in degrees"


def _is_position(point: object) -> bool:
    if not isinstance(point, list) or len(point) not in (2, 3) or not all(map(_is_number, point)):
        return False
    return bool(abs(point[0]) <= 180.0 and abs(point[1]) <= 90.0)


# -- objects and values --------------------------------------------------------------------------


def _object(value: object, name: str, where: str, rules: WzdxRules) -> Iterator[Problem]:
    if not isinstance(value, dict):
        yield where, "is no JSON object"
        return
    for key, field in rules.objects[name].items():
        if key in value:
            yield from _field(value[key], field, f"{where}.{key}", rules)
        elif field.must:
            yield f"{where}.{key}", "is missing"
    for first, second in rules.either.get(name, ()):
        if first not in value and second not in value:
            yield f"{where}.{first}", "is missing"
    for first, second in rules.together.get(name, ()):
        if first in value and second not in value:
            yield f"{where}.{second}", f"is missing beside {first}"


def _field(value: object, field: _Field, where: str, rules: WzdxRules) -> Iterator[Problem]:
    if not field.is_list:
        yield from _single(value, field, where, rules)
    elif not isinstance(value, list):
        yield where, "is no list"
    else:
        if field.not_empty and not value:
            yield where, "is empty"
        for k, one in enumerate(value):
            yield from _single(one, field, f"{where}[{k}]", rules)


def _single(value: object, field: _Field, where: str, rules: WzdxRules) -> Iterator[Problem]:
    if field.name.startswith("@"):
        words = rules.words[field.name[1:]]
        if value not in words:
            yield where, f"{str(value)[:40]!r} is not one of {', '.join(words)}"
    elif field.name in rules.objects:
        yield from _object(value, field.name, where, rules)
    else:
        is_one, wanted = _PLAIN[field.name]
        if not is_one(value):
            yield where, f"{str(value)[:40]!r} is no {wanted}"
        elif field.least is not None and isinstance(value, int | float) and value < field.least:
            yield where, f"{value} is less than {field.least:g}"


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, int) or math.isfinite(value)


def _time(value: object) -> datetime | None:
    """Instant of an RFC 3339 text; a leap second counts as the one before it."""
    if not isinstance(value, str) or not _DATE_TIME.fullmatch(value):
        return None
    leap = value[17:19] == "60"
    text = (value[:17] + "59" + value[19:] if leap else value).upper()
    try:
        return datetime.fromisoformat(text) + timedelta(seconds=leap)
    except ValueError:
        return None


_PLAIN: dict[str, tuple[Callable[[Any], bool], str]] = {
    "text": (lambda value: isinstance(value, str), "text"),
    "number": (_is_number, "number"),
    "integer": (lambda value: _is_number(value) and value == value // 1, "whole number"),
    "flag": (lambda value: isinstance(value, bool), "true or false"),
    "date-time": (lambda value: _time(value) is not None, "UTC time such as 2026-03-31T06:00:00Z"),
    "email": (lambda value: isinstance(value, str) and bool(_EMAIL.fullmatch(value)), "address"),
}
