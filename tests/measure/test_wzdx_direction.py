"""The direction that a feed states, against the way its devices run."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest
from wzdx_cases import places, table

from georef_gis.errors import InputError
from georef_gis.measure.workzone.wzdx import build_feed
from georef_gis.measure.workzone.wzdx_direction import direction_doubts
from georef_gis.measure.workzone.wzdx_settings import DevicePlace, wzdx_settings

NOW = datetime(2026, 3, 30, 12, tzinfo=UTC)


def row(bearing: float, n: int = 5) -> list[DevicePlace]:
    """Devices 11 m apart towards a bearing, deg, at 39 degrees north, by small-angle figures."""
    step = 1e-4 * math.cos(math.radians(bearing)), 1e-4 * math.sin(math.radians(bearing))
    return [
        replace(place, lat=39.0 + k * step[0], lon=-80.0 + k * step[1] / math.cos(math.radians(39)))
        for k, place in enumerate(places(n))
    ]


def said_of(devices: list[DevicePlace], stated: str, **changes: Any) -> str:
    """Nothing, a doubt, or a refusal."""
    settings = wzdx_settings(table(direction=stated, **changes), "zone.toml")
    try:
        doubts = direction_doubts(settings, devices)
    except InputError as error:
        with pytest.raises(InputError, match="direction"):
            build_feed(settings, devices, now=NOW)
        return f"refused: {error}"
    build_feed(settings, devices, now=NOW)
    return "; ".join(doubts)


@pytest.mark.parametrize("heading", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_direction_is_a_name_that_bends_with_the_road_but_not_back(
    heading: float, side: float
) -> None:
    stated = ("northbound", "eastbound", "southbound", "westbound")[int(heading / 90.0)]
    for off, begins in (
        (0, ""),
        (58, ""),
        (62, "wzdx.direction: "),
        (118, "wzdx.direction: "),
        (122, "refused: zone.toml: wzdx.direction: "),
        (180, "refused: "),
    ):
        told = said_of(row((heading + side * off) % 360.0), stated)
        assert told.startswith(begins) if begins else told == "", (off, told)
        assert not begins or (f"'{stated}'" in told and f"{off} deg from it" in told)


def test_opposite_direction_is_refused_with_field_value_bearing_and_cure() -> None:
    told = said_of(row(85.0), "westbound")
    for part in (
        "zone.toml: wzdx.direction: 'westbound'",
        "from C0 to C4",
        "towards 85 deg",
        'set it to "eastbound"',
        "zone.travel",
        "wzdx.direction_as_signed = true",
    ):
        assert part in told
    assert "\n" not in told


@pytest.mark.parametrize("stated", ["inner-loop", "outer-loop", "undefined", "unknown"])
def test_direction_without_a_bearing_is_not_compared(stated: str) -> None:
    assert said_of(row(200.0), stated) == ""


def test_direction_that_the_user_confirms_is_taken() -> None:
    assert said_of(row(85.0), "westbound", direction_as_signed=True) == ""
    assert said_of(row(85.0), "northbound", direction_as_signed=True) == ""


def test_devices_that_turn_back_have_no_bearing_to_refuse_by() -> None:
    there = row(0.0, 9)
    # up and most of the way back again: the last lies south of nothing that was passed
    hairpin = [*there, *there[-2:0:-1]]
    assert said_of(hairpin, "southbound").startswith("wzdx.direction: ")
    # the last on the first: no bearing at all
    assert said_of([*there, there[0]], "southbound") == ""


def test_direction_across_the_date_line_is_that_of_the_devices() -> None:
    west, east = places(2)
    pair = [replace(west, lon=179.9999, lat=51.0), replace(east, lon=-179.9999, lat=51.0)]
    assert said_of(pair, "eastbound") == ""
    assert said_of(pair, "westbound").startswith("refused: ")
