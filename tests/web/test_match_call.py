"""Clicks matched into other photos as the page and `georef match-clicks` ask for it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from web_cases import true_pixels

from georef_gis.app import cli

pytestmark = pytest.mark.slow
TARGET = "P03"


def ask(client: Any, call: str, **content: Any) -> Any:
    answer = client.post(f"/api/measure/{call}", json=content)
    assert answer.status_code == 200, answer.text
    return answer.json()


def own(count: int = 1) -> list[dict[str, Any]]:
    """True pixels of a target in its first photos."""
    found = sorted(true_pixels(TARGET).items())[:count]
    return [{"photo": photo, "u": u, "v": v, "sigma_px": 0.3} for photo, (u, v) in found]


def away(click: dict[str, Any], name: str = TARGET) -> float:
    """Distance from the truth, px."""
    truth = true_pixels(name)[click["photo"]]
    return float(np.hypot(float(click["u"]) - truth[0], float(click["v"]) - truth[1]))


def georef(*words: object) -> Any:
    return CliRunner().invoke(cli.georef, [*map(str, words), "--force", "--json"])


def test_a_target_is_found_in_other_photos_to_a_tenth_of_a_pixel(
    page_of_site: tuple[Any, Any],
) -> None:
    client, _ = page_of_site
    found = ask(client, "match", clicks=own())
    assert found["why_not"] is None
    assert found["clicks"][0]["matched"] is False
    assert found["clicks"][0]["quality"] is None
    matches = found["clicks"][1:]
    assert len(matches) >= 5
    for one in matches:
        assert one["matched"] is True
        # px
        assert away(one) < 0.3
        assert one["sigma_match_px"] < 0.15
        assert one["sigma_px"] > 0.3
        assert 0.8 < one["quality"] <= 1.0
    photos = {one["photo"] for one in found["clicks"]}
    assert photos.isdisjoint(one["photo"] for one in found["refused"])
    assert found["template"]["photo"] == own()[0]["photo"]


def test_the_place_is_told_with_and_without_the_matches(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    found = ask(client, "match", clicks=own())
    before, place = found["before"], found["place"]
    assert before["method"] == "locate"
    assert place["method"] == "intersect"
    assert place["n_rays"] == len(found["clicks"])
    assert {ray["photo"] for ray in place["rays"]} == {one["photo"] for one in found["clicks"]}
    assert len(place["ellipse"]) > 20
    # m
    assert place["sigma_u_m"] < 0.15


def test_what_was_found_can_be_sent_on_as_clicks(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    found = ask(client, "match", clicks=own())
    names = ("photo", "u", "v", "sigma_px")
    clicks = [{name: one[name] for name in names} for one in found["clicks"]]
    told = ask(client, "figure", shape="point", vertices=[{"clicks": clicks}])["points"]["0"]
    # m: as unsure in the plan, and never surer
    for axis in ("sigma_e_m", "sigma_n_m", "sigma_u_m"):
        assert 0.8 < told[axis] / found["place"][axis] < 2.5
    # ft of the map; the same place
    assert told["easting"] == pytest.approx(found["place"]["easting"], abs=0.1)
    assert told["doubts"] == []


def test_only_the_photos_asked_for_are_matched(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    other = sorted(true_pixels(TARGET))[2]
    found = ask(client, "match", clicks=own(), photos=[other])
    assert [one["photo"] for one in found["clicks"][1:]] == [other]


def test_a_photo_that_is_not_known_is_refused_in_one_line(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    answer = client.post("/api/measure/match", json={"clicks": own(), "photos": ["nowhere"]})
    assert answer.status_code in (400, 422)
    assert "nowhere" in answer.text


def test_the_tool_writes_marks_that_intersect_takes(module_site: Path, tmp_path: Path) -> None:
    table = tmp_path / "clicks.csv"
    lines = [f"{TARGET},{c['photo']}.JPG,{c['u']},{c['v']},0.3" for c in own()]
    table.write_text("\n".join(["name,photo,u,v,sigma_px", *lines]) + "\n", encoding="utf-8")
    marks, places = tmp_path / "marks.csv", tmp_path / "places.json"
    done = georef("match-clicks", "--project", module_site, "--marks", table,
                  "--target", marks, "--points", places)  # fmt: skip
    assert done.exit_code == 0, done.output
    with marks.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows[0]["matched"] == "0"
    assert len(rows) >= 6
    assert all(away(row) < 0.3 for row in rows)
    (place,) = json.loads(places.read_text())
    assert place["n_rays"] == len(rows)
    again = georef("intersect", "--project", module_site, "--marks", marks)
    assert again.exit_code == 0, again.output
    (point,) = json.loads(again.stdout.splitlines()[-1])["summary"]["points"]
    assert point["n_rays"] == len(rows)
    assert point["easting"] == pytest.approx(place["easting"], abs=0.1)


def test_the_tool_goes_on_where_one_object_has_no_place(module_site: Path, tmp_path: Path) -> None:
    click = own()[0]
    done = georef(
        "match-clicks", "--project", module_site, "--target", tmp_path / "m.csv",
        "--pixel", f"{click['photo']}:{click['u']},{click['v']}",
        "--pixel", f"{click['photo']}:99999,5",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert events[-1]["summary"]["objects"] == 2
    assert events[-1]["summary"]["matched"] == 1
    assert any("outside" in str(event) for event in events)


def test_the_tool_without_clicks_says_what_to_give(module_site: Path) -> None:
    done = georef("match-clicks", "--project", module_site)
    assert done.exit_code != 0
    assert "--pixel" in done.output


def test_the_tool_does_not_write_over_the_marks_it_reads(module_site: Path, tmp_path: Path) -> None:
    table = tmp_path / "clicks.csv"
    click = own()[0]
    table.write_text(f"name,photo,u,v\nA,{click['photo']},{click['u']},{click['v']}\n")
    before = table.read_text()
    done = georef("match-clicks", "--project", module_site, "--marks", table, "--target", table)
    assert done.exit_code != 0
    assert table.read_text() == before
