"""What a user says of a work zone in ``work_zone.toml``: what is measured cannot tell it.

Nothing is made up: what is empty counts as missing, and all that is missing is told at once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError
from georef_gis.measure.workzone.rules import DEFAULT_EDITION
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

ZONE_FILE = "work_zone.toml"
_TABLES = {"zone", "taper", "tangent", "lane", "signs", "wzdx"}
_ZONE = {"speed_mph": float, "road_type": str, "rules": str, "travel": object}
_TAPER = {"line": str, "kind": str, "offset_ft": float, "edge": str}
_TANGENT = {"line": str}
_LANE = {"name": str, "line": str, "edge": str, "min_ft": float, "reduced_width": bool}
_SIGNS = {"line": str, "taper": str}
# Edges that the template lists
_MOST_EDGES = 20
# mph; beyond it is a slip of the hand, or km/h
SPEEDS = (5.0, 100.0)
# Degrees clockwise from north
COMPASS = {word: 45.0 * k for k, word in enumerate(("N", "NE", "E", "SE", "S", "SW", "W", "NW"))}


@dataclass(frozen=True, slots=True, kw_only=True)
class TaperSettings:
    """A taper; `line` is the word that its devices carry, `edge` the name of a line asset."""

    line: str
    kind: str
    offset: float | None = None
    edge: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneSettings:
    """A lane between the devices of a line and an edge; `least` in m."""

    name: str
    line: str
    edge: str
    least: float | None = None
    reduced_width: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneSettings:
    """A work zone as its file tells it; lengths in m, `travel` in degrees clockwise from north.

    Parameters
    ----------
    speed_mph
        None if it is not stated.
    travel_written
        `travel` as it stands in the file.
    signs
        (line of the signs, line of the taper behind them).
    wzdx
        Table [wzdx] as it stands, read by `wzdx`.
    """

    source: str
    speed_mph: float | None = None
    road_type: str = ""
    rules: str = DEFAULT_EDITION
    travel: float | None = None
    travel_written: str = ""
    tapers: tuple[TaperSettings, ...] = ()
    tangents: tuple[str, ...] = ()
    lanes: tuple[LaneSettings, ...] = ()
    signs: tuple[tuple[str, str], ...] = ()
    wzdx: Mapping[str, Any] = field(default_factory=dict)

    def check_screening(self) -> None:
        """Refuse settings from which nothing can be screened.

        Raises
        ------
        InputError
            Naming all that is missing.
        """
        missing = [] if self.speed_mph else ["zone.speed_mph"]
        if self.signs and not self.road_type:
            missing.append("zone.road_type (for the signs)")
        if not (self.tapers or self.tangents or self.lanes or self.signs):
            missing.append("one [[taper]], [[tangent]], [[lane]] or [[signs]] at least")
        refuse_missing(missing, self.source)


def refuse_missing(missing: Iterable[str], source: str) -> None:
    """Raise one `InputError` that names all of what is missing, if anything is."""
    names = list(missing)
    if names:
        raise InputError(f"fill in what is missing, it is not made up: {', '.join(names)}",
                         source=source)  # fmt: skip


def read_zone(path: Path) -> ZoneSettings:
    """Settings of a work zone.

    Raises
    ------
    InputError
        Naming file, table, value and cure.
    """
    source = str(path)
    try:
        read = tomllib.loads(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({error})", source=source) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML ({error}); correct the line", source=source) from error
    for name in read.keys() - _TABLES:
        raise InputError(f"is no table; use {', '.join(sorted(_TABLES))}", source=source,
                         field=name)  # fmt: skip
    zone = _values(read.get("zone", {}), _ZONE, source, "zone")
    wzdx = read.get("wzdx", {})
    if not isinstance(wzdx, dict):
        raise InputError("must be a table", source=source, field="wzdx")
    return ZoneSettings(
        source=source,
        speed_mph=_speed(zone.get("speed_mph"), source),
        road_type=zone.get("road_type", ""),
        rules=zone.get("rules") or DEFAULT_EDITION,
        travel=_travel(zone.get("travel"), source),
        travel_written=str(zone.get("travel", "")),
        tapers=tuple(_taper(t, source) for t in _list(read, "taper", _TAPER, source)),
        tangents=tuple(
            _must(t, "line", source, "tangent") for t in _list(read, "tangent", _TANGENT, source)
        ),
        lanes=tuple(_lane(t, source) for t in _list(read, "lane", _LANE, source)),
        signs=tuple(
            (_must(t, "line", source, "signs"), _must(t, "taper", source, "signs"))
            for t in _list(read, "signs", _SIGNS, source)
        ),
        wzdx=wzdx,
    )


def _taper(table: Mapping[str, Any], source: str) -> TaperSettings:
    offset = _positive(table.get("offset_ft"), source, "taper.offset_ft")
    return TaperSettings(
        line=_must(table, "line", source, "taper"),
        kind=_must(table, "kind", source, "taper"),
        offset=None if offset is None else offset * FOOT,
        edge=table.get("edge", ""),
    )


def _lane(table: Mapping[str, Any], source: str) -> LaneSettings:
    least = _positive(table.get("min_ft"), source, "lane.min_ft")
    line = _must(table, "line", source, "lane")
    return LaneSettings(
        name=table.get("name") or line,
        line=line,
        edge=_must(table, "edge", source, "lane"),
        least=None if least is None else least * FOOT,
        reduced_width=table.get("reduced_width", False),
    )


def _list(
    read: Mapping[str, Any], name: str, known: Mapping[str, type], source: str
) -> list[dict[str, Any]]:
    tables = read.get(name, [])
    if not isinstance(tables, list):
        raise InputError(f"must stand as [[{name}]]", source=source, field=name)
    return [_values(table, known, source, name) for table in tables]


def _values(table: Any, known: Mapping[str, type], source: str, name: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError("must be a table", source=source, field=name)
    out = {}
    for key, value in table.items():
        kind = known.get(key)
        if kind is None:
            raise InputError(f"is no key; use {', '.join(known)}", source=source,
                             field=f"{name}.{key}")  # fmt: skip
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (is_number if kind is float else isinstance(value, kind)):
            wanted = {float: "a number", str: 'a text in "quotes"', bool: "true or false"}[kind]
            raise InputError(f"{str(value)[:40]!r} is not {wanted}", source=source,
                             field=f"{name}.{key}")  # fmt: skip
        out[key] = value
    return out


def _must(table: Mapping[str, Any], key: str, source: str, name: str) -> str:
    value = str(table.get(key, ""))
    if not value:
        raise InputError("is missing", source=source, field=f"{name}.{key}")
    return value


def _positive(value: Any, source: str, name: str) -> float | None:
    """A number; 0 counts as not filled in."""
    if not value:
        return None
    if not 0 < value < 1e6:
        raise InputError(f"{value} is no possible value", source=source, field=name)
    return float(value)


def _speed(value: Any, source: str) -> float | None:
    """Speed, mph; one of a road."""
    speed = _positive(value, source, "zone.speed_mph")
    if speed is not None and not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(
            f"{speed:g} mph is no speed of a road; give {SPEEDS[0]:g} to {SPEEDS[1]:g} mph",
            source=source,
            field="zone.speed_mph",
        )
    return speed


def _travel(value: Any, source: str) -> float | None:
    if value in (None, ""):
        return None
    degrees = COMPASS.get(str(value).strip().upper())
    if degrees is None and not isinstance(value, bool):
        try:
            degrees = float(value)
        except (TypeError, ValueError):
            degrees = None
    if degrees is None or not 0.0 <= degrees <= 360.0:
        raise InputError(f"{str(value)[:20]!r} is no direction; use {', '.join(COMPASS)} or "
                         "degrees clockwise from north", source=source,
                         field="zone.travel")  # fmt: skip
    return degrees


# -- the template --------------------------------------------------------------------------------

_TEMPLATE = """\
# A work zone: what photos cannot tell of it. `georef screen-work-zone` reads all but [wzdx],
# `georef wzdx` reads all. What is empty is asked for, not made up.
#
# Devices and signs belong to a line by their attribute `line`.{found}

[zone]
# Posted speed, off-peak 85th-percentile speed before the work, or anticipated operating speed.
speed_mph = 0
# {roads}; for the spacing of signs
road_type = ""
# Edition of the MUTCD ({editions}), or a TOML file of the same form.
rules = "{edition}"
# Which way the traffic beside the devices goes: N, NE, E ... or degrees clockwise from north.
# Needed where devices have no attribute `order`.
travel = ""

# A taper. kind: {kinds}.
# Offset: offset_ft as planned, or `edge`, the name of a line asset that runs with the road.
# [[taper]]
# line = "T1"
# kind = "merging"
# offset_ft = 12

# A row of devices along a lane.
# [[tangent]]
# line = "G1"

# A lane between a row of devices and an edge line (name of a line asset). `min_ft` instead of the
# manual's; `reduced_width = true` states its width in the WZDx feed.
# [[lane]]
# name = "right lane"
# line = "G1"
# edge = "right edge"

# Advance warning signs of a line before a taper.
# [[signs]]
# line = "S1"
# taper = "T1"

[wzdx]
version = "{version}"
# Of this work zone, for as long as it lives.
id = "{id}"
# Who publishes the feed; who the data come from, and their id (a UUID is advised).
publisher = ""
organization_name = ""
data_source_id = ""
road_names = []
# {directions}: as the route is
# signed. It is compared with the way the devices run; `direction_as_signed = true` says that it is
# right where the road runs otherwise.
direction = ""
# UTC, such as 2026-03-31T06:00:00Z
start_date = ""
end_date = ""
# {impacts}
vehicle_impact = ""
# channel-device-method: the feed starts at the first device and ends at the last.
location_method = "channel-device-method"
# Lines of devices in the order that drivers meet them.
devices = []
# An agency may verify; a measurement in photos does not.
is_start_date_verified = false
is_end_date_verified = false
is_start_position_verified = false
is_end_position_verified = false
# Optional: name, description, contact_name, contact_email, update_frequency (s), creation_date,
# beginning_cross_street, ending_cross_street, beginning_milepost, ending_milepost,
# reduced_speed_limit_mph, types_of_work = ["surface-work"], cc0_license = true
#
# Lanes: none, or all of them, 1 = left-most.
# lane_count = 2
# [[wzdx.lane]]
# order = 1
# type = "general"
# status = "open"
"""


def zone_template(
    *,
    event_id: str,
    devices: Mapping[str, int] | None = None,
    signs: Mapping[str, int] | None = None,
    edges: Sequence[str] = (),
) -> str:
    """Text of a ``work_zone.toml`` to fill in.

    Parameters
    ----------
    event_id
        Id that the work zone gets in feeds.
    devices, signs
        Lines that there are, with the count of their assets.
    edges
        Names of line assets.
    """
    from georef_gis.measure.workzone.rules import editions, load_rules
    from georef_gis.measure.workzone.wzdx_rules import versions, wzdx_rules

    rules, version = load_rules(), versions()[-1]
    words = wzdx_rules(version).words
    there = {
        "devices": ", ".join(f"{_comment(name)} ({n})" for name, n in (devices or {}).items()),
        "signs": ", ".join(f"{_comment(name)} ({n})" for name, n in (signs or {}).items()),
        "edges": ", ".join(map(_comment, edges[:_MOST_EDGES])),
    }
    return _TEMPLATE.format(
        found="".join(f"\n# There are {what}: {names}." for what, names in there.items() if names),
        roads=", ".join(rules.signs),
        editions=", ".join(editions()),
        edition=DEFAULT_EDITION,
        kinds=", ".join(rules.tapers),
        version=version,
        id=event_id,
        directions=", ".join(words["direction"]),
        impacts="\n# ".join(", ".join(words["vehicle_impact"][k : k + 4]) for k in range(0, 12, 4)),
    )


def _comment(name: str) -> str:
    """A name as it may stand in a comment."""
    return " ".join(name.split())[:40]
