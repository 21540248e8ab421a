"""Budget, assets, doubts and settings on the report page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from report_cases import Page, adjusted_facts, project_facts

from georef_gis.measure.assets.asset import EDITED, Asset, Click, Quality
from georef_gis.measure.budget.shares import PointBudget, remedies
from georef_gis.measure.report.assets_section import (
    MOST_PICTURES,
    MOST_ROWS,
    AssetFacts,
    asset_items,
    pictured,
)
from georef_gis.measure.report.budget_section import Budget, budget_items
from georef_gis.measure.report.build import Beside, report_page, report_pdf, report_sections
from georef_gis.measure.report.doubts_section import all_doubts, doubt_items
from georef_gis.measure.report.page import Gallery, Item, Letter, Picture, Table, Text, Verdict
from georef_gis.measure.report.runs_section import Made, runs_items

EVIL = ("<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "電柱 😀 Straße",
        "a" * 400, "cone\u202egpj.exe", "\ud800", "two\nlines\t&amp;")  # fmt: skip


def asset(number: int, *, sigma: float = 0.02, name: str = "", **changes: Any) -> Asset:
    quality = Quality(
        sigma_e=sigma, sigma_n=sigma, sigma_u=2 * sigma, semi_major=2.4 * sigma,
        semi_minor=2.4 * sigma, azimuth=30.0, conf=0.95, dof=3, n_rays=3, method="intersect",
        clicks=tuple(Click(photo_id=f"P{k:03d}", u=1.0, v=2.0) for k in range(3)),
    )  # fmt: skip
    made = Asset(
        id=f"id{number}", kind=("cone", "drum")[number % 2], shape="point",
        vertices=((500000.0 + number, 4.4e6, 200.0),), name=name or f"A{number}", quality=quality,
    )  # fmt: skip
    return replace(made, **changes)


def facts_of(assets: Sequence[Asset], **changes: Any) -> AssetFacts:
    return AssetFacts(assets=assets, titles={"cone": "Cone", "drum": "Drum"}, **changes)


def jpeg(side: int = 168) -> bytes:
    noise = np.random.default_rng(1).integers(0, 255, (side, side, 3)).astype(np.uint8)
    done, raw = cv2.imencode(".jpg", cv2.GaussianBlur(noise, (5, 5), 0))
    assert done
    return raw.tobytes()


def table(items: Sequence[Item], title: str) -> Table:
    (found,) = [item for item in items if isinstance(item, Table) and item.title == title]
    return found


def level(item: Table | Picture | Text) -> str:
    assert isinstance(item.verdict, Verdict)
    return item.verdict.level


# -- assets ----------------------------------------------------------------------------------------


def test_assets_are_listed_with_sigmas_method_and_photos() -> None:
    items = asset_items(facts_of([asset(i) for i in range(6)]))
    by_class, each = table(items, "Assets by class"), table(items, "Assets one by one")
    assert by_class.rows[0] == ("Cone", "point", "3", "2.0 cm", "2.0 cm", "3 intersect", "3")
    row = dict(zip(each.columns, each.rows[0], strict=True))
    assert row["Name"] == "A0"
    assert (row["σ east"], row["σ up"], row["Method"]) == ("2.0 cm", "4.0 cm", "intersect")
    assert row["Ellipse"] == "4.8 / 4.8 cm, 30°"
    assert row["Photos"] == "P000, P001 and 1 more"
    assert "95%" in each.look
    assert (level(by_class), level(each)) == ("fine", "fine")


def test_assets_far_from_their_class_moved_by_hand_or_wrong_ask_for_a_look() -> None:
    some = [asset(i) for i in range(6)]
    far = asset_items(facts_of([*some, asset(8, sigma=0.1)]))
    found = table(far, "Assets one by one")
    assert level(found) == "look"
    assert found.verdict is not None
    assert "Cone A8" in found.verdict.text
    for odd in (asset(8, quality=EDITED), asset(8, problems=("colour: no such value",))):
        items = asset_items(facts_of([*some, odd]))
        assert level(table(items, "Assets by class")) == "look"


def test_without_assets_the_page_says_how_to_map_some() -> None:
    for found in (None, facts_of([])):
        (item,) = asset_items(found)
        assert isinstance(item, Text)
        assert "georef assets" in item.lines[0]


def test_of_many_assets_the_least_certain_are_shown_and_the_rest_counted() -> None:
    many = [asset(i, sigma=0.02 + 1e-6 * i) for i in range(2000)]
    items = asset_items(facts_of(many, pictures={a.id: b"\xff\xd8" for a in many}))
    each = table(items, "Assets one by one")
    assert len(each.rows) == MOST_ROWS
    assert {row[0] for row in each.rows} == {f"A{i}" for i in range(1700, 2000)}
    assert each.verdict is not None
    assert "300 least certain of 2000" in each.verdict.text
    (gallery,) = [item for item in items if isinstance(item, Gallery)]
    assert len(gallery.pictures) == MOST_PICTURES
    assert "1940 more" in gallery.look


def test_pictures_are_of_every_class() -> None:
    crowd = [asset(2 * i) for i in range(500)]
    shown = pictured([*crowd, asset(1), asset(3)], 10)
    assert [a.kind for a in shown].count("drum") == 2
    assert len(shown) == 10


@pytest.mark.usefixtures("pictures_undrawn")
def test_evil_names_are_text_on_the_page_and_in_the_pdf() -> None:
    some = [asset(i, name=name) for i, name in enumerate(EVIL)]
    found = facts_of(some, pictures={a.id: jpeg(64) for a in some})
    facts = replace(project_facts(2), title=EVIL[0])
    sections = report_sections(facts, None, None, Beside(assets=found))
    text = report_page(facts, sections, made="today", versions="x 1")
    page = Page(text.encode("utf-8", "replace").decode())
    assert not page.tags & {"script", "iframe", "object"}
    assert all(image["src"] != "x" for image in page.images)
    assert "onerror" not in {key for image in page.images for key in image}
    assert "&lt;script&gt;alert(1)" in text
    # what turns the direction of writing would show gpj.exe as exe.jpg
    assert "\u202e" not in text
    assert report_pdf(facts, sections, made="today", versions="x 1").pages > 3


@pytest.mark.slow
def test_2000_assets_and_167_photos_stay_below_5_mb_and_15_s() -> None:
    some = [asset(i, name=f"asset {i}") for i in range(2000)]
    found = facts_of(some, pictures={a.id: jpeg() for a in pictured(some)})
    facts = adjusted_facts(167, each=1000)
    start = time.process_time()
    sections = report_sections(facts, None, None, Beside(assets=found))
    text = report_page(facts, sections, made="today", versions="x 1")
    pdf = report_pdf(facts, sections, made="today", versions="x 1")
    # s of the processor: 3 and 1.5
    assert time.process_time() - start < 15.0
    assert len(text.encode()) < 5e6
    assert len(pdf.content) < 5e6


# -- budget ----------------------------------------------------------------------------------------


def budget_of(gnss: float, datum: float = 0.0, *, far: int = 0) -> Budget:
    def one(name: str, more: float = 1.0) -> PointBudget:
        parts = {"gnss": more * gnss, "datum": datum, "click": 0.01}
        return PointBudget(
            name=name, by_source={k: v**2 * np.eye(3) for k, v in parts.items() if v},
            pose_kind="tags",
        )  # fmt: skip

    each = [one(f"P{i:03d}", 5.0 if i < far else 1.0) for i in range(10)]
    whole = one("usual")
    return Budget(whole=whole, each=each, found=remedies(whole), of=10)


@pytest.mark.usefixtures("pictures_undrawn")
def test_the_budget_tells_sources_remedies_and_far_photos() -> None:
    items = budget_items(budget_of(0.5))
    sources = table(items, "Error budget by source")
    assert [row[0] for row in sources.rows] == ["GNSS position", "click", "together"]
    assert sources.rows[0][-1] == "100%"
    first = table(items, "What to fix first")
    assert first.rows[0][0] == "GNSS position"
    # half of 0.5 m, beside a click of 1 cm
    assert first.rows[0][3] == "25.0 cm"
    photos = table(items, "Photos with the largest errors")
    assert level(photos) == "fine"
    worse = table(budget_items(budget_of(0.5, far=2)), "Photos with the largest errors")
    assert level(worse) == "look"
    assert worse.rows[0][0] in ("P000", "P001")


def test_an_unstated_datum_asks_for_a_look() -> None:
    (picture,) = [i for i in budget_items(budget_of(0.5)) if isinstance(i, Picture)]
    assert level(picture) == "told"
    (picture,) = [i for i in budget_items(budget_of(0.5, 2.0)) if isinstance(i, Picture)]
    assert level(picture) == "look"
    assert picture.verdict.text.count("datum") >= 1


@pytest.mark.parametrize("items_of", [budget_items, asset_items])
def test_what_cannot_be_shown_asks_for_a_look_with_its_reason(items_of: Any) -> None:
    (item,) = items_of(None, "The file cannot be read: locked.")
    assert isinstance(item, Text)
    assert level(item) == "look"
    assert item.verdict is not None
    assert item.verdict.text == "The file cannot be read: locked."


# -- doubts ----------------------------------------------------------------------------------------


def run(tool: str, warnings: list[str], **changes: Any) -> dict[str, Any]:
    return {
        "tool": f"georef:{tool}", "summary": {}, "outcome": "done", "warnings": warnings,
        "message": None, "fid": 7, "started": "2026-05-01 10:00:00", "duration_s": 1.0,
        "parameters": {}, "versions": {"tool": "2", "georef-gis": "0.1.0"}, **changes,
    }  # fmt: skip


def test_each_doubt_stands_once_with_what_it_is_of() -> None:
    runs = [
        run("read_photos", ["P000: blurred", "P001: edited, see P001", "P002: edited, see P002"]),
        run("report", ["of itself"]),
    ]
    facts = replace(project_facts(3), runs=runs, doubtful={"P000": ["blurred"]})
    assets = facts_of([asset(0), asset(2, quality=EDITED)])
    found = all_doubts(facts, assets)
    # what the tool says of P000 is that photo's own doubt
    assert [(d.kind, d.name) for d in found] == [
        ("tool", "read_photos"), ("tool", "read_photos"), ("photo", "P000"), ("asset", "Cone A2"),
    ]  # fmt: skip
    (item,) = doubt_items(facts, assets)
    assert isinstance(item, Table)
    assert item.rows[0] == ("tool", "read_photos", "P001: edited, see P001 (the same of P002)")
    assert len(item.rows) == 3
    assert level(item) == "look"
    (nothing,) = doubt_items(project_facts(3), None)
    assert isinstance(nothing, Table)
    assert level(nothing) == "fine"


@pytest.mark.parametrize(
    ("outcome", "told", "shown"),
    [("refused", "fine", 0), ("cancelled", "look", 1), ("failed", "bad", 1)],
)
def test_a_question_that_was_refused_is_no_doubt_about_the_project(
    outcome: str, told: str, shown: int
) -> None:
    asked = run("who_sees", ["a warning"]) | {"outcome": outcome, "message": "no such photo"}
    (item,) = doubt_items(replace(project_facts(3), runs=[asked]), None)
    assert isinstance(item, Table)
    assert level(item) == told
    assert len([row for row in item.rows if row[2].startswith(outcome)]) == shown


def test_assets_of_photos_that_are_gone_are_doubtful() -> None:
    found = facts_of([asset(0)], photos=frozenset({"P000", "P001"}))
    (doubt,) = all_doubts(project_facts(2), found)
    assert "no longer in the project" in doubt.text
    assert "P002" in doubt.text
    there = facts_of([asset(0)], photos=frozenset({"P000", "P001", "P002"}))
    assert all_doubts(project_facts(2), there) == []


# -- runs ------------------------------------------------------------------------------------------


def test_settings_are_shown_without_comments_and_changed_ones_told() -> None:
    text = '# a comment\n[project]\nname = "x"  # Name\n[camera]\n# focal_px = 1\n\n[mount]\n'
    facts = replace(project_facts(1), runs=[run("match", [])])
    made = Made(versions=(("georef-gis", "0.1.0"),), settings=text)
    items = runs_items(facts, "report", made)
    assert table(items, "Last runs").rows[0][:2] == ("match", "7")
    assert table(items, "Last runs").rows[0][-1] == "0.1.0\u00a0(tool\u00a02)"
    (letter,) = [item for item in items if isinstance(item, Letter)]
    assert letter.text == '[project]\nname = "x"  # Name'
    (settings,) = [item for item in items if isinstance(item, Text)]
    assert level(settings) == "fine"
    changed = runs_items(facts, "report", replace(made, changed={"match": ("ground",)}))
    (settings,) = [item for item in changed if isinstance(item, Text)]
    assert level(settings) == "look"
    assert settings.verdict is not None
    assert "match (ground)" in settings.verdict.text
