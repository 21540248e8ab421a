"""Tools `screen_work_zone` and `wzdx` on clicks of the sample project."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_cases import SAMPLE, Site, georef
from work_zone_cases import clicks_csv, copied, posed_site, true_places

from georef_gis.measure.assets.asset import Draft, Quality
from georef_gis.measure.assets.store import AssetStore, Change
from georef_gis.measure.ellipses import on_map
from georef_gis.measure.workzone.wzdx_rules import check_feed
from georef_gis.project import Project
from georef_gis.project.records import load_frame
from georef_gis.units import INTERNATIONAL_FOOT as FOOT
from processing_algorithms.assets.asset_places import joint_places

TRUTH = SAMPLE / "truth"
CONES = [f"C{k:02d}" for k in range(1, 14)]
DRUMS = [f"D{k:02d}" for k in range(1, 12)]
ZONE = """
[zone]
speed_mph = {speed}
road_type = "urban_low"
travel = "NE"

[[taper]]
line = "T1"
kind = "{kind}"
offset_ft = {offset}

[[tangent]]
line = "G1"
"""
WZDX = """
[wzdx]
version = "4.2"
id = "0d2b7f0e-6a52-4a1c-9f2e-0c1f5d1f2a11"
publisher = "State DOT"
organization_name = "District 4"
data_source_id = "5b9b4b0a-8f0e-4a38-8a0f-0f5c3b2b6d11"
road_names = ["WV 20"]
direction = "eastbound"
start_date = "2026-03-31T06:00:00Z"
end_date = 2026-04-30T18:00:00-04:00
vehicle_impact = "some-lanes-closed-merge-left"
devices = ["T1", "G1"]
"""


@pytest.fixture(scope="module")
def all_clicked(tmp_path_factory: pytest.TempPathFactory) -> Site:
    site = posed_site(tmp_path_factory.mktemp("zone") / "site")
    names = [path.name for path in site.photos]
    path = site.folder / "clicks.csv"
    path.write_text(clicks_csv(TRUTH, [*CONES, *DRUMS], photos=names))
    assert georef("assets", "--project", site.folder, "--clicks", path).code == 0
    return site


@pytest.fixture
def clicked(all_clicked: Site, tmp_path: Path) -> Site:
    """Five photos with the poses of their tags; all cones and drums that they show clicked."""
    return copied(all_clicked, tmp_path / "site")


def zone(site: Site, *, speed: float = 25, kind: str = "shoulder", offset: float = 8,
         more: str = "") -> None:  # fmt: skip
    text = ZONE.format(speed=speed, kind=kind, offset=offset) + more
    (site.folder / "work_zone.toml").write_text(text, encoding="utf-8")


def screen(site: Site) -> tuple[Any, dict[str, dict[str, Any]]]:
    done = georef("screen-work-zone", "--project", site.folder)
    assert done.code == 0, done.text
    told = json.loads((site.products / "work_zone_screening.json").read_text())
    return done, {row["check"]: row for row in told["findings"] if ": " not in row["subject"]}


def true_length(names: list[str]) -> float:
    places = true_places(TRUTH)
    return float(np.linalg.norm(places[names[-1]] - places[names[0]])) / FOOT


def present(site: Site, names: list[str]) -> list[str]:
    with AssetStore.of_project(Project.open(site.folder)) as store:
        there = {asset.name for asset in store.assets()}
    return [name for name in names if name in there]


def test_lengths_are_sure_though_the_places_are_not(clicked: Site) -> None:
    zone(clicked)
    done, found = screen(clicked)
    cones = present(clicked, CONES)
    length = true_length(cones)
    taper = found["taper length"]
    along = np.sqrt(length**2 - 8.0**2)
    assert abs(taper["value_ft"] - along) < 4 * taper["sigma_ft"]
    # 8 ft at 25 mph on a shoulder: 8 * 625 / 60 / 3 = 27.8 ft
    assert taper["low_ft"] == pytest.approx(27.78, abs=0.01)
    assert taper["verdict"] == "pass"
    with AssetStore.of_project(Project.open(clicked.folder)) as store:
        qualities = [a.quality for a in store.assets() if a.name == cones[0]]
    assert qualities[0] is not None
    assert qualities[0].sigma_e is not None
    # the poses of tags: metres of place, far less of a length
    assert taper["sigma_ft"] * FOOT < 0.5 * qualities[0].sigma_e
    text = (clicked.products / "work_zone_screening.txt").read_text()
    assert "not a statement of compliance" in text
    assert "not a statement of compliance" in done.text
    with (clicked.products / "work_zone_screening.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert all("not a statement of compliance" in row["about"] for row in rows)


def test_zone_too_short_for_its_speed_fails(clicked: Site) -> None:
    zone(clicked, speed=55, kind="merging", offset=12)
    _, found = screen(clicked)
    assert found["taper length"]["verdict"] == "fail"
    assert found["taper length"]["low_ft"] == pytest.approx(660)


def test_lane_is_measured_to_an_edge_of_stated_accuracy(clicked: Site) -> None:
    drums = present(clicked, DRUMS)
    with AssetStore.of_project(Project.open(clicked.folder)) as store:
        assets = {a.name: a for a in store.assets()}
        a, b = (np.array(assets[name].vertices[0]) for name in (drums[0], drums[-1]))
        # 11 ft to the right of the drums, in a CRS of feet
        u = (b - a)[:2] / np.linalg.norm((b - a)[:2])
        right = np.array([u[1], -u[0], 0.0]) * 11.0
        quality = Quality(sigma_e=0.02, sigma_n=0.02, sigma_u=0.02, method="survey")
        vertices = tuple((float(p[0]), float(p[1]), float(p[2])) for p in (a + right, b + right))
        store.add(Draft(kind="lane_edge", name="edge", vertices=vertices, quality=quality))
    lane = '\n[[lane]]\nname = "open lane"\nline = "G1"\nedge = "edge"\nreduced_width = true\n'
    zone(clicked, more=lane + WZDX)
    done, found = screen(clicked)
    # 11 ft less half a drum of 0.58 m: 10.05 ft at the ends, others bend with the road
    at_end = next(row for row in json.loads(
        (clicked.products / "work_zone_screening.json").read_text()
    )["findings"] if row["subject"] == f"open lane: at {drums[0]}")  # fmt: skip
    assert at_end["value_ft"] == pytest.approx(11 - 0.58 / 2 / FOOT, abs=0.15)
    assert "without what they share for 1 of" in done.text
    # places of tags against a surveyed edge: metres
    assert found["lane width, all"]["verdict"] == "cannot tell"
    done = georef("wzdx", "--project", clicked.folder)
    assert done.code == 0
    feed = json.loads((clicked.products / "work_zone.geojson").read_text())
    # a width that may be nothing is told, not stated
    assert "restrictions" not in feed["features"][0]["properties"]
    assert "not stated" in done.line("open lane", "one sigma")


def test_stated_accuracy_of_unclicked_assets_is_turned_from_grid_to_enu(clicked: Site) -> None:
    # grid north is 0.6 degrees from true north: 1 m along grid east leaks 1 cm to true north
    project = Project.open(clicked.folder)
    quality = Quality(sigma_e=1.0, sigma_n=0.001, sigma_u=0.5, corr_en=0.0, method="survey")
    with AssetStore.of_project(project) as store:
        vertex = store.assets()[0].vertices[0]
        asset = store.add(Draft(kind="cone", vertices=(vertex,), quality=quality))
    frame = load_frame(project.database)
    found = joint_places(project, frame, [asset], sigma_px=0.5)
    spread = on_map(frame, found.p_enu, found.covariance[None])[0]
    assert np.sqrt(np.diag(spread)) == pytest.approx([1.0, 0.001, 0.5], rel=1e-6)
    assert np.sqrt(found.covariance[1, 1]) > 0.005
    assert "no clicks" in found.basis


def test_feed_runs_from_the_first_device_to_the_last(clicked: Site) -> None:
    zone(clicked, more=WZDX)
    done = georef("wzdx", "--project", clicked.folder)
    assert done.code == 0, done.text
    feed = json.loads((clicked.products / "work_zone.geojson").read_text())
    assert check_feed(feed, "4.2") == []
    assert feed["features"][0]["properties"]["end_date"] == "2026-04-30T22:00:00Z"
    coordinates = feed["features"][0]["geometry"]["coordinates"]
    beside = json.loads((clicked.products / "work_zone_accuracy.json").read_text())
    order = [device["name"] for device in beside["devices"]]
    assert order == present(clicked, CONES) + present(clicked, DRUMS)
    assert [[d["longitude"], d["latitude"]] for d in beside["devices"]] == coordinates
    # eastward all along, about WV
    assert np.all(np.diff([lon for lon, _ in coordinates]) > 0)
    assert coordinates[0] == pytest.approx([-80.4675, 39.0973], abs=1e-3)
    assert beside["devices"][0]["semi_major_95_m"] > 0.1


def test_feed_asks_for_all_that_is_missing_and_suggests_the_side(clicked: Site) -> None:
    zone(clicked, kind="merging", more='[wzdx]\ndevices = ["T1", "G1"]\nid = "x"\n')
    done = georef("wzdx", "--project", clicked.folder)
    assert done.code != 0
    told = done.line("fill in what is missing")
    for key in ("publisher", "road_names", "direction", "start_date", "end_date"):
        assert f"wzdx.{key}" in told
    assert re.search(r"the devices suggest some-lanes-closed-merge-(left|right)", told)
    assert not (clicked.products / "work_zone.geojson").exists()


def test_feed_of_an_untouched_file_asks_for_all_that_is_missing_at_once(clicked: Site) -> None:
    # once to write the file, once to read it as it was written
    georef("wzdx", "--project", clicked.folder)
    done = georef("wzdx", "--project", clicked.folder)
    told = done.line("fill in what is missing")
    for key in ("publisher", "road_names", "direction", "start_date", "devices"):
        assert f"wzdx.{key}" in told


def test_speed_without_a_formula_is_refused_with_the_file(clicked: Site) -> None:
    zone(clicked, speed=42, kind="merging")
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code == 2
    told = done.line("42 mph")
    assert "work_zone.toml" in told
    assert "0 to 40 mph, 45 mph and more" in told


def test_way_of_the_traffic_is_asked_for_where_nothing_tells_it(clicked: Site) -> None:
    zone(clicked, more=WZDX)
    path = clicked.folder / "work_zone.toml"
    path.write_text(path.read_text().replace('travel = "NE"', ""))
    done = georef("wzdx", "--project", clicked.folder)
    assert done.code != 0
    assert "drivers meet first is not known" in done.text
    # lengths do not depend on it
    assert georef("screen-work-zone", "--project", clicked.folder).code == 0


@pytest.mark.parametrize("stated", ["westbound", "northbound"])
def test_direction_against_the_devices_is_refused_and_askew_doubted(
    clicked: Site, stated: str
) -> None:
    # the road runs towards 66 degrees
    zone(clicked, more=WZDX.replace("eastbound", stated))
    done = georef("wzdx", "--project", clicked.folder)
    told = done.line(f"wzdx.direction: '{stated}'", "(eastbound)", "from C01 to D")
    assert re.search(r"towards 6[0-9] deg", told)
    assert (done.code, (clicked.products / "work_zone.geojson").exists()) == (
        (2, False) if stated == "westbound" else (0, True)
    )


def test_side_of_merging_that_the_taper_does_not_have_is_doubted(clicked: Site) -> None:
    zone(clicked, kind="merging", more=WZDX)
    assert "wzdx.vehicle_impact" not in georef("wzdx", "--project", clicked.folder).text
    zone(clicked, kind="merging", more=WZDX.replace("merge-left", "merge-right"))
    done = georef("wzdx", "--project", clicked.folder)
    done.line("wzdx.vehicle_impact: 'some-lanes-closed-merge-right'", "lead to the left")


def test_lines_the_wrong_way_round_are_doubted(clicked: Site) -> None:
    zone(clicked, more=WZDX.replace('["T1", "G1"]', '["G1", "T1"]'))
    done = georef("wzdx", "--project", clicked.folder)
    assert "T1 does not begin where G1 ends" in done.text


def add_signs(site: Site, **feet: float) -> None:
    """Signs of line S1 on the line of the cones: so many feet from the first one."""
    quality = Quality(sigma_e=0.02, sigma_n=0.02, sigma_u=0.02, method="survey")
    with AssetStore.of_project(Project.open(site.folder)) as store:
        cones = sorted((a for a in store.assets(["cone"])), key=lambda a: a.name)
        start, end = (np.array(cones[k].vertices[0]) for k in (0, -1))
        u = (end - start) / np.linalg.norm((end - start)[:2])
        for name, away in feet.items():
            e, n, _ = start + away * u
            draft = Draft(kind="sign", name=name, vertices=((e, n, start[2]),), quality=quality,
                          attributes={"line": "S1", "mutcd_code": "W20-1"})  # fmt: skip
            store.add(draft)


SIGNS = '\n[[signs]]\nline = "S1"\ntaper = "T1"\n'


def test_signs_are_taken_from_the_taper_outwards_and_others_refused(clicked: Site) -> None:
    add_signs(clicked, far=-330.0, near=-120.0)
    zone(clicked, more=SIGNS)
    assert georef("screen-work-zone", "--project", clicked.folder).code == 0
    told = json.loads((clicked.products / "work_zone_screening.json").read_text())["findings"]
    signs = {row["check"]: row for row in told if row["check"].startswith("sign")}
    assert signs["sign spacing A"]["value_ft"] == pytest.approx(120, abs=0.5)
    assert signs["sign spacing B"]["value_ft"] == pytest.approx(210, abs=0.1)
    add_signs(clicked, end=118.0)
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code != 0
    # no way of the traffic puts both before the taper: it is not called wrong
    assert "line S1 has signs behind the beginning of T1 (end)" in done.text
    assert "likely the wrong way" not in done.text


@pytest.mark.parametrize("tool", ["screen-work-zone", "wzdx"])
@pytest.mark.parametrize("travel", ['"W"', "250"])
def test_travel_that_puts_signs_behind_is_named_with_the_one_that_fits(
    clicked: Site, tool: str, travel: str
) -> None:
    add_signs(clicked, far=-330.0, near=-120.0)
    zone(clicked, more=SIGNS + WZDX)
    path = clicked.folder / "work_zone.toml"
    path.write_text(path.read_text().replace('travel = "NE"', f"travel = {travel}"))
    done = georef(tool, "--project", clicked.folder)
    assert done.code == 2
    written = travel.strip('"')
    told = done.line("work_zone.toml: zone.travel:", f'"{written}" is likely the wrong way')
    assert 'set travel = "NE"' in told
    assert not list(clicked.products.glob("work_zone*"))
    path.write_text(path.read_text().replace(f"travel = {travel}", 'travel = "NE"'))
    assert georef(tool, "--project", clicked.folder).code == 0


def test_order_against_the_traffic_is_named(clicked: Site) -> None:
    add_signs(clicked, far=-330.0, near=-120.0)
    with AssetStore.of_project(Project.open(clicked.folder)) as store:
        for cone in store.assets(["cone"]):
            last_first = {**cone.attributes, "order": 20 - int(cone.name[1:])}
            store.change(cone.id, cone.revision, Change(attributes=last_first))
    zone(clicked, more=SIGNS)
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code == 2
    done.line("all stand before its other end", "`order` of T1")


def test_travel_across_the_road_is_doubted(clicked: Site) -> None:
    zone(clicked, more=WZDX)
    path = clicked.folder / "work_zone.toml"
    path.write_text(path.read_text().replace('travel = "NE"', 'travel = "N"'))
    done = georef("wzdx", "--project", clicked.folder)
    assert done.code == 0, done.text
    done.line('zone.travel: "N" lies', "from line T1", '"NE" or "SW"')


@pytest.mark.parametrize("tool", ["screen-work-zone", "wzdx"])
def test_file_to_fill_in_is_the_first_step_and_names_the_lines(clicked: Site, tool: str) -> None:
    path = clicked.folder / "work_zone.toml"
    done = georef(tool, "--project", clicked.folder)
    assert done.code == 0, done.text
    done.line("next", "fill in work_zone.toml, then run this again")
    text = path.read_text()
    assert "T1 (" in text
    assert "G1 (" in text
    assert re.search(r'id = "[0-9a-f-]{36}"', text)
    # as it was written it is no zone yet, and stays as it is
    done = georef(tool, "--project", clicked.folder)
    assert done.code == 2
    done.line("fill in what is missing")
    assert path.read_text() == text
    assert not list(clicked.products.glob("work_zone*"))


def test_file_to_fill_in_of_a_site_without_devices_says_what_to_do_first(clicked: Site) -> None:
    (clicked.folder / "assets.gpkg").unlink()
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code == 0, done.text
    done.line("no device of the project belongs to a line yet", "georef assets --clicks")


def test_place_moved_by_hand_is_refused_until_it_is_measured(clicked: Site) -> None:
    zone(clicked)
    with AssetStore.of_project(Project.open(clicked.folder)) as store:
        asset = store.assets(["cone"])[0]
        e, n, h = asset.vertices[0]
        store.change(asset.id, asset.revision, Change(vertices=((e + 1, n, h),)))
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code != 0
    assert f"1 assets have no accuracy (cone {asset.name})" in done.text


def test_line_that_no_device_has_is_refused_with_those_there_are(clicked: Site) -> None:
    zone(clicked, more='[[tangent]]\nline = "G9"\n')
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert "no channelizing device belongs to line 'G9'; there are G1, T1" in done.text


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("urban_low", "city", ("zone.road_type: 'city' is no type of road", "urban_low")),
        ('"shoulder"', '"sholder"', ("taper.kind: 'sholder' is no kind of taper", "shoulder")),
        ("offset_ft = 8", "offset_ft = 800", ("taper T1: offset_ft: 800 ft", "ft apart")),
        ("offset_ft = 8", 'edge = "kerb"', ("no line asset is called 'kerb'", "there are none")),
        ("offset_ft = 8", "", ("T1: needs its offset", "offset_ft")),
        ("[zone]", '[zone]\nrules = "1988"', ("zone.rules: '1988' is neither an edition", "2009")),
    ],
)
def test_slip_in_the_file_is_told_with_the_file_and_the_cure(
    clicked: Site, old: str, new: str, parts: tuple[str, ...]
) -> None:
    add_signs(clicked, near=-120.0)
    zone(clicked, more=SIGNS)
    path = clicked.folder / "work_zone.toml"
    path.write_text(path.read_text().replace(old, new))
    done = georef("screen-work-zone", "--project", clicked.folder)
    assert done.code == 2
    done.line("work_zone.toml: ", *parts)
