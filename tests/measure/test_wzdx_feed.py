"""The WZDx feed: what is asked for, what is measured, what the rules of the standard take."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from wzdx_cases import OPTIONAL, places, table

from georef_gis.errors import ExportError, InputError
from georef_gis.measure.workzone.verdicts import Finding
from georef_gis.measure.workzone.wzdx import (
    accuracy_file,
    build_feed,
    stated_width,
    suggested_impact,
)
from georef_gis.measure.workzone.wzdx_rules import check_feed, versions, wzdx_rules
from georef_gis.measure.workzone.wzdx_settings import wzdx_settings
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

NOW = datetime(2026, 3, 30, 12, 0, 5, 700, tzinfo=timezone(timedelta(hours=-5)))
SCHEMAS = os.environ.get("GEOREF_WZDX_SCHEMAS", "")


def feed_of(widths: tuple[Finding, ...] = (), n: int = 3, **changes: Any) -> dict[str, Any]:
    settings = wzdx_settings(table(**changes), "zone.toml")
    return build_feed(settings, places(n), widths=widths, now=NOW)


def width(feet: float, sigma: float) -> Finding:
    return Finding(check="lane width", subject="right lane: at C1", value=feet * FOOT,
                   sigma=sigma * FOOT, low=0.0, high=1.0, probability=1.0, verdict="pass",
                   sigma_needed=0.0)  # fmt: skip


def properties(feed: dict[str, Any]) -> dict[str, Any]:
    return dict(feed["features"][0]["properties"])


# -- what is in it -------------------------------------------------------------------------------


def test_feed_states_what_was_given_and_measured_and_no_more() -> None:
    feed = feed_of()
    assert feed["feed_info"] == {
        "publisher": "State DOT",
        "version": "4.2",
        "update_date": "2026-03-30T17:00:05Z",
        "data_sources": [{"data_source_id": "5b9b4b0a-8f0e-4a38-8a0f-0f5c3b2b6d11",
                          "organization_name": "District 6"}],
    }  # fmt: skip
    assert properties(feed) == {
        "core_details": {
            "data_source_id": "5b9b4b0a-8f0e-4a38-8a0f-0f5c3b2b6d11",
            "event_type": "work-zone",
            "road_names": ["I-79", "Jennings Randolph Expressway"],
            "direction": "northbound",
        },
        "start_date": "2026-03-31T06:00:00Z",
        "end_date": "2026-04-30T18:00:00Z",
        "is_start_date_verified": False,
        "is_end_date_verified": False,
        "is_start_position_verified": False,
        "is_end_position_verified": False,
        "location_method": "channel-device-method",
        "vehicle_impact": "some-lanes-closed-merge-left",
    }


def test_positions_are_longitude_first_and_finer_than_a_centimetre() -> None:
    geometry = feed_of()["features"][0]["geometry"]
    assert geometry["type"] == "LineString"
    assert geometry["coordinates"][0] == [-80.467123457, 39.097123457]
    assert len(str(geometry["coordinates"][0][1]).split(".")[1]) >= 7


def test_two_devices_make_a_multipoint_and_one_makes_none() -> None:
    assert feed_of(n=2)["features"][0]["geometry"]["type"] == "MultiPoint"
    with pytest.raises(InputError, match="1 devices on the lines T1"):
        feed_of(n=1)


def test_all_optional_values_are_taken_over() -> None:
    feed = feed_of(**OPTIONAL)
    found = properties(feed)
    assert found["core_details"]["creation_date"] == "2026-03-01T17:00:00Z"
    assert found["core_details"]["name"] == "Bridge deck <b>"
    assert found["reduced_speed_limit_kph"] == pytest.approx(72.42)
    assert found["types_of_work"] == [{"type_name": "surface-work"}, {"type_name": "painting"}]
    assert [lane["order"] for lane in found["lanes"]] == [1, 2]
    assert found["ending_milepost"] == 118.4
    assert found["is_start_position_verified"] is True
    assert feed["feed_info"]["license"].startswith("https://creativecommons.org/publicdomain/zero")
    assert feed["feed_info"]["update_frequency"] == 300
    json.dumps(feed, allow_nan=False)


def test_times_are_stated_in_utc() -> None:
    found = properties(feed_of(start_date="2026-03-31T06:00:00-04:00"))
    assert found["start_date"] == "2026-03-31T10:00:00Z"


@pytest.mark.parametrize(
    ("feet", "sigma", "stated"),
    [(11.0, 0.0, 11.0), (10.99, 0.0, 10.9), (11.0, 0.1, 10.8), (0.1, 5.0, 0.0)],
)
def test_stated_width_is_one_that_the_lane_surely_has(
    feet: float, sigma: float, stated: float
) -> None:
    assert stated_width(width(feet, sigma)) == pytest.approx(stated)
    found = properties(feed_of(widths=(width(feet, sigma),)))
    one = {"type": "reduced-width", "value": stated, "unit": "feet"}
    assert found.get("restrictions", []) == ([one] if stated else [])


def test_accuracy_stands_beside_the_feed() -> None:
    settings = wzdx_settings(table(), "zone.toml")
    told = accuracy_file(
        places(), widths=[width(11.0, 0.1)], datum=("unknown", 2.0), assumption="joint",
        settings=settings,
    )  # fmt: skip
    assert [d["asset_id"] for d in told["devices"]] == ["id-0", "id-1", "id-2"]
    assert told["devices"][0]["semi_major_95_m"] == 0.08
    assert told["datum_sigma_m"] == 2.0
    assert told["lane_widths"][0]["stated_ft"] == 10.8
    assert "sigma" not in json.dumps(feed_of())


# -- what is missing or wrong --------------------------------------------------------------------


def test_all_that_is_missing_is_told_at_once_and_nothing_made_up() -> None:
    with pytest.raises(InputError) as refused:
        wzdx_settings({"version": "4.2", "road_names": [], "publisher": ""}, "zone.toml",
                      suggestion=suggested_impact(3.5))  # fmt: skip
    told = str(refused.value)
    for key in ("publisher", "organization_name", "data_source_id", "road_names", "direction",
                "start_date", "end_date", "vehicle_impact", "devices", "id"):  # fmt: skip
        assert f"wzdx.{key}" in told
    assert "the devices suggest some-lanes-closed-merge-left: confirm it" in told
    assert "\n" not in told


def test_devices_that_shift_to_the_right_suggest_to_merge_right() -> None:
    assert suggested_impact(-3.5) == "some-lanes-closed-merge-right"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"direction": "north"}, "direction: 'north' is not one of northbound"),
        ({"start_date": "31.3.2026"}, "start_date: '31.3.2026' is no UTC time"),
        ({"start_date": "2026-03-31T06:00:00"}, "start_date"),
        ({"end_date": "2026-03-01T06:00:00Z"}, "end_date: lies before start_date"),
        ({"vehicle_impact": "bad"}, "vehicle_impact"),
        ({"location_method": "gps"}, "location_method"),
        ({"publisher": 5}, "publisher"),
        ({"update_frequency": -1}, "update_frequency"),
        ({"update_frequency": "x"}, "update_frequency"),
        ({"contact_email": "nobody"}, "contact_email"),
        ({"is_end_date_verified": "no"}, "is_end_date_verified"),
        ({"reduced_speed_limit_mph": "slow"}, "reduced_speed_limit_kph"),
        ({"types_of_work": ["digging"]}, "types_of_work"),
        ({"ending_milepost": -1}, "ending_milepost"),
        ({"lane_count": 1, "lane": [{"order": 1, "type": "road", "status": "open"}]}, "lanes[0]"),
        ({"lane_count": 1, "lane": [{"order": 2, "type": "general", "status": "open"}]},
         "must be complete"),
        ({"lane_count": 1, "lane": [{"order": 1, "type": "general"}]}, "status: is missing"),
    ],
)  # fmt: skip
def test_feed_that_breaks_a_rule_is_not_made(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ExportError) as refused:
        feed_of(**changes)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"road_names": "I-79"}, "must be a list of texts"),
        ({"devices": [1]}, "must be a list of texts"),
        ({"lane": [{"order": 1}], "lane_count": 3}, "lane_count says 3"),
        ({"lane": 3}, r"must stand as \[\[wzdx.lane\]\]"),
        ({"roadname": "I-79"}, "is no key; use"),
        ({"version": "9.9"}, "zone.toml: version: '9.9' is no version of WZDx"),
        ({"devices": ["T1", "G1", "T1"]}, "wzdx.devices: names line T1 2 times"),
        ({"direction_as_signed": 1}, "1 is not true or false"),
    ],
)
def test_table_that_cannot_be_read_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        wzdx_settings(table(**changes), "zone.toml")


# -- the rules -----------------------------------------------------------------------------------


def test_rules_of_the_version_are_found_and_no_others() -> None:
    assert versions() == ["4.2"]
    assert wzdx_rules("4.2").version == "4.2"
    with pytest.raises(InputError, match=r"use one of 4\.2"):
        wzdx_rules("../4.2")


def full_feed() -> dict[str, Any]:
    """A feed with most that the rules know of."""
    feed = feed_of(widths=(width(11.0, 0.1),), **OPTIONAL)
    found = feed["features"][0]["properties"]
    found["worker_presence"] = {
        "are_workers_present": True, "method": "cones-present", "confidence": "low",
        "worker_presence_last_confirmed_date": "2026-03-31T06:00:00.5+01:00",
        "definition": ["humans-behind-barrier"],
    }  # fmt: skip
    found["core_details"]["related_road_events"] = [{"type": "next-in-sequence", "id": "z"}]
    del found["is_end_date_verified"]
    found["end_date_accuracy"] = "estimated"
    return feed


JUNK = [
    None, 1, -1, 0, 10**400, 1.5, 3.0, "x", "", [], {}, True, [1], ["x"], "2026-13-01T00:00:00Z",
    "2026-03-31", "4.1", "detour", "MultiPoint", float("nan"),
]  # fmt: skip
Path_ = tuple[str | int, ...]


def paths(value: Any, at: Path_ = ()) -> Iterator[Path_]:
    if at:
        yield at
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, one in items:
            yield from paths(one, (*at, key))


def spoiled(feed: dict[str, Any]) -> Iterator[tuple[Path_, Any, dict[str, Any]]]:
    """The feed with each value in turn taken away or put wrong."""
    for at in paths(feed):
        for junk in ("taken away", *JUNK):
            out = copy.deepcopy(feed)
            inner: Any = out
            for key in at[:-1]:
                inner = inner[key]
            if junk == "taken away":
                del inner[at[-1]]
            else:
                inner[at[-1]] = junk
            yield at, junk, out


def test_full_feed_breaks_no_rule() -> None:
    assert check_feed(full_feed(), "4.2") == []


def test_check_survives_whatever_stands_in_a_feed() -> None:
    for junk in JUNK:
        assert check_feed(junk, "4.2")
    told = [check_feed(out, "4.2") for _, _, out in spoiled(full_feed())]
    assert sum(bool(lines) for lines in told) > len(told) / 2
    assert all("\n" not in line for lines in told for line in lines)


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (("features", 0, "geometry", "type"), "Point", "only LineString and MultiPoint"),
        (("features", 0, "geometry", "type"), "MultiPoint", "use LineString"),
        (("features", 0, "geometry", "coordinates"), [[1, 2]], "fewer than 2"),
        (("features", 0, "geometry", "coordinates", 0), [39.1, -120.5], "longitude, latitude"),
        (("features", 0, "id"), "", "is missing or no text"),
        (("feed_info", "license"), "MIT", "is not https://creativecommons.org"),
        (("feed_info", "version"), "4.1", "is '4.1', not 4.2"),
        (("feed_info", "data_sources"), [], "is empty"),
        (("type",), "Feature", "is not FeatureCollection"),
    ],
)
def test_rule_by_hand(at: Path_, value: Any, words: str) -> None:
    feed = full_feed()
    inner: Any = feed
    for key in at[:-1]:
        inner = inner[key]
    inner[at[-1]] = value
    assert any(words in line for line in check_feed(feed, "4.2")), check_feed(feed, "4.2")


def test_two_events_of_one_id_are_found() -> None:
    feed = feed_of()
    feed["features"] *= 2
    assert check_feed(feed, "4.2") == ["features[1].id: stands twice"]


@pytest.mark.skipif(not SCHEMAS, reason="GEOREF_WZDX_SCHEMAS names no folder of schemas")
def test_no_feed_is_taken_that_the_published_schemas_refuse() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    validator = published_validator(jsonschema)
    assert list(validator.iter_errors(full_feed())) == []
    assert list(validator.iter_errors(feed_of(n=2))) == []
    loose = [
        (at, junk)
        for at, junk, out in spoiled(full_feed())
        if not check_feed(out, "4.2") and list(validator.iter_errors(out))
    ]
    assert loose == []


def published_validator(jsonschema: Any) -> Any:
    """Validator of WorkZoneFeed.json of the folder, its references within the folder."""
    from referencing import Registry
    from referencing.jsonschema import DRAFT7

    contents = [json.loads(path.read_text("utf-8")) for path in Path(SCHEMAS).glob("*.json")]
    # the files refer to each other by branches that they do not all name alike
    by_name = {str(c["$id"]).rsplit("/", 1)[-1]: c for c in contents}

    def retrieve(uri: str) -> Any:
        return DRAFT7.create_resource(by_name[uri.rsplit("/", 1)[-1]])

    registry: Any = Registry(retrieve=retrieve)
    kind = jsonschema.Draft7Validator
    return kind(by_name["WorkZoneFeed.json"], registry=registry, format_checker=kind.FORMAT_CHECKER)
