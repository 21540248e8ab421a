"""What a user says of a work zone: read, refused with the cure, or asked for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.measure.workzone.wzdx_settings import wzdx_settings
from georef_gis.measure.workzone.zone_settings import ZONE_FILE, read_zone, zone_template
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

TEXT = """
[zone]
speed_mph = 55
road_type = "rural"
travel = "ne"

[[taper]]
line = "T1"
kind = "merging"
offset_ft = 12

[[taper]]
line = "T2"
kind = "shoulder"
edge = "right edge"

[[tangent]]
line = "G1"

[[lane]]
line = "G1"
edge = "right edge"
min_ft = 11.5
reduced_width = true

[[signs]]
line = "S1"
taper = "T1"

[wzdx]
version = "4.2"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / ZONE_FILE
    path.write_text(text)
    return path


def test_settings_are_read_in_metres(tmp_path: Path) -> None:
    zone = read_zone(write(tmp_path, TEXT))
    assert zone.speed_mph == 55
    assert zone.travel == 45.0
    assert zone.rules == "2009"
    assert zone.tapers[0].offset == pytest.approx(12 * FOOT)
    assert (zone.tapers[1].offset, zone.tapers[1].edge) == (None, "right edge")
    assert zone.tangents == ("G1",)
    assert (zone.lanes[0].name, zone.lanes[0].reduced_width) == ("G1", True)
    assert zone.lanes[0].least == pytest.approx(11.5 * FOOT)
    assert zone.signs == (("S1", "T1"),)
    zone.check_screening()


@pytest.mark.parametrize(("text", "degrees"), [('"W"', 270.0), ("123.5", 123.5), ('"10"', 10.0)])
def test_travel_is_a_word_or_degrees(tmp_path: Path, text: str, degrees: float) -> None:
    assert read_zone(write(tmp_path, f"[zone]\ntravel = {text}")).travel == degrees


def test_template_is_toml_that_asks_for_everything(tmp_path: Path) -> None:
    evil = 'T1"\n[zone]\nspeed_mph = 1'
    text = zone_template(
        event_id="an-id", devices={evil: 13, "G1": 2}, signs={evil: 1, "S1": 3}, edges=[evil, "E1"]
    )
    read = tomllib.loads(text)
    assert read["wzdx"]["id"] == "an-id"
    # no date, name or direction is there before somebody wrote it
    for key in ("publisher", "organization_name", "data_source_id", "direction", "start_date",
                "end_date", "vehicle_impact", "road_names", "devices"):  # fmt: skip
        assert not read["wzdx"][key], key
    assert "G1 (2)" in text
    assert "There are signs:" in text
    assert "S1 (3)." in text
    assert "E1." in text
    zone = read_zone(write(tmp_path, text))
    assert zone.speed_mph is None
    with pytest.raises(InputError) as refused:
        zone.check_screening()
    told = str(refused.value)
    assert "zone.speed_mph" in told
    assert "one [[taper]]" in told


def test_examples_of_the_template_can_be_used_as_they_stand(tmp_path: Path) -> None:
    lines = zone_template(event_id="x").splitlines()
    keys = ("# line =", "# kind =", "# offset_ft =", "# edge =", "# name =", "# taper =", "# [[")
    text = "\n".join(
        line[2:] if line.startswith(keys) and "[[wzdx" not in line else line for line in lines
    )
    zone = read_zone(write(tmp_path, text.replace("speed_mph = 0", "speed_mph = 55")))
    assert [t.kind for t in zone.tapers] == ["merging"]
    assert zone.lanes[0].name == "right lane"


def test_example_of_the_docs_can_be_used_as_it_stands(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/work_zone.md").read_text("utf-8")
    (text,) = re.findall("```toml\n(.*?)```", page, flags=re.DOTALL)
    path = write(tmp_path, text)
    zone = read_zone(path)
    zone.check_screening()
    assert wzdx_settings(zone.wzdx, zone.source).lines == ["T1"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[zone]\nspeed = 5", "zone.speed: is no key; use speed_mph"),
        ("[zone]\nspeed_mph = '55'", "zone.speed_mph: '55' is not a number"),
        ("[zone]\nspeed_mph = true", "is not a number"),
        ("[zone]\nspeed_mph = -5", "-5 is no possible value"),
        ("[zone]\nspeed_mph = nan", "nan is no possible value"),
        ("[zone]\nspeed_mph = 250", "zone.speed_mph: 250 mph is no speed of a road; give 5 to 100"),
        ("[zone]\nspeed_mph = 0.1", "0.1 mph is no speed of a road"),
        ("[zone]\ntravel = 'up'", "'up' is no direction; use N, NE"),
        ("[zone]\ntravel = 400", "is no direction"),
        # float() takes it for 1 degree
        ("[zone]\ntravel = true", "'True' is no direction"),
        ("[zones]\n", "zones: is no table; use"),
        ("[taper]\nline = 'T1'", r"must stand as [[taper]]"),
        ("[[taper]]\nline = 'T1'", "taper.kind: is missing"),
        ("[[lane]]\nline = 'T1'", "lane.edge: is missing"),
        ("[[tangent]]\nline = 3", "'3' is not a text"),
        ("zone = 3", "zone: must be a table"),
        ("wzdx = 3", "wzdx: must be a table"),
        ("[zone", "is not TOML"),
    ],
)
def test_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as refused:
        read_zone(path)
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_signs_need_the_type_of_the_road(tmp_path: Path) -> None:
    zone = read_zone(write(tmp_path, TEXT.replace('road_type = "rural"', "")))
    with pytest.raises(InputError, match=r"zone\.road_type"):
        zone.check_screening()
