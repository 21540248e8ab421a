"""Clicks matched into other photos as the page and `georef match-clicks` ask for it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from page_pictures import told_click
from web_cases import true_pixels

from georef_gis.app import cli
from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Project

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
        # the match alone; the click of 0.3 px, in a photo that may show the target smaller
        assert one["sigma_px"] < 0.5
        assert 0.15 < one["shared_px"] < 0.45
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


SENT = ("photo", "u", "v", "sigma_px", "shared_px", "on_ground")
SIGMAS = ("sigma_e_m", "sigma_n_m", "sigma_u_m", "corr_en")


def sent(found: dict[str, Any]) -> list[dict[str, Any]]:
    return [{name: one[name] for name in SENT} for one in found["clicks"]]


def test_what_was_found_can_be_sent_on_as_clicks(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    found = ask(client, "match", clicks=own())
    told = ask(client, "figure", shape="point", vertices=[{"clicks": sent(found)}])["points"]["0"]
    for name in (*SIGMAS, "easting", "northing", "sigma0"):
        # rounding of the table: 0.1 mm, and 1e-4 ft of the map
        assert told[name] == pytest.approx(found["place"][name], abs=2e-4), name
    assert told["doubts"] == []


def test_of_clicks_in_two_photos_the_place_is_that_of_what_is_sent_on(
    page_of_site: tuple[Any, Any],
) -> None:
    """Both own clicks show the target found again: they mean one spot between them."""
    client, _ = page_of_site
    clicks = own(2)
    clicks[1]["u"] += 0.4
    found = ask(client, "match", clicks=clicks)
    assert found["why_not"] is None
    told = ask(client, "figure", shape="point", vertices=[{"clicks": sent(found)}])["points"]["0"]
    for name in (*SIGMAS, "easting", "northing"):
        assert told[name] == pytest.approx(found["place"][name], abs=2e-4), name


def test_matched_clicks_are_stored_and_measured_again_as_they_were(client: Any, site: Path) -> None:
    found = ask(client, "match", clicks=own())
    added = ask(client, "add_asset", kind="point", vertices=[{"clicks": sent(found)}])
    stored = added["asset"]
    assert {c["shared_px"] > 0.15 for c in stored["clicks"]} == {True}
    names = ("sigma_e", "sigma_n", "sigma_u")
    for name in names:
        assert stored["quality"][name] == pytest.approx(found["place"][f"{name}_m"], abs=1e-4)
    client.close()
    done = georef("assets", "--project", site, "--remeasure")
    assert done.exit_code == 0, done.output
    with AssetStore.of_project(Project.open(site)) as store:
        (again,) = [one for one in store.assets() if one.id == stored["id"]]
    assert again.quality is not None
    assert again.vertices[0] == pytest.approx(tuple(stored["vertices"][0]), abs=1e-4)
    for name in names:
        assert getattr(again.quality, name) == pytest.approx(stored["quality"][name], rel=1e-6)


def test_the_click_that_the_docs_tell_is_found(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    photo, u, v = told_click()
    found = ask(client, "match", clicks=[{"photo": photo, "u": u, "v": v}])
    assert len(found["clicks"]) >= 5
    assert min(one["quality"] for one in found["clicks"][1:]) > 0.9


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
    # ft, m: marks are written to 0.001 px
    assert point["easting"] == pytest.approx(place["easting"], abs=0.002)
    for name in ("sigma_e_m", "sigma_n_m", "sigma_u_m"):
        assert point[name] == pytest.approx(place[name], rel=0.01)


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
