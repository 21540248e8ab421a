"""The report page as HTML: nothing from elsewhere, readable without eyes and mouse."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from report_cases import Page, adjusted_facts, project_facts

from georef_gis.measure.report.build import report_page, report_sections
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.page import (
    Lines,
    Picture,
    Section,
    Table,
    Verdict,
    count_verdicts,
    judged,
    render,
)


def page_of(facts: Facts) -> str:
    return report_page(facts, report_sections(facts, None), made="2026-05-02", versions="0.1")


@pytest.fixture(scope="module")
def adjusted_page() -> str:
    return page_of(adjusted_facts())


def test_the_page_refers_to_nothing_outside_itself(adjusted_page: str) -> None:
    page = Page(adjusted_page)
    assert page.references
    assert all(r.startswith(("#", "data:image/")) for r in page.references)
    assert not page.tags & {"script", "link", "iframe", "object"}
    assert "@import" not in adjusted_page
    assert "url(" not in adjusted_page
    assert {r[1:] for r in page.references if r.startswith("#")} <= set(page.ids)


def test_every_picture_has_words_and_a_verdict(adjusted_page: str) -> None:
    page = Page(adjusted_page)
    assert len(page.images) >= 8
    assert all(len(image["alt"] or "") > 15 for image in page.images)
    captions = adjusted_page.split("<figcaption>")[1:]
    assert len(captions) == len(page.images)
    assert all('class="sign"' in caption.split("</figcaption>")[0] for caption in captions)


def test_headings_descend_one_step_at_a_time_and_ids_are_unique(adjusted_page: str) -> None:
    page = Page(adjusted_page)
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    steps = zip(page.headings, page.headings[1:], strict=False)
    assert all(after <= before + 1 for before, after in steps)
    assert len(page.ids) == len(set(page.ids))


def test_names_from_the_project_are_no_markup(adjusted_page: str) -> None:
    assert "A <site>" not in adjusted_page
    assert "A &lt;site&gt; &amp; more" in adjusted_page


@pytest.mark.usefixtures("pictures_undrawn")
def test_findings_come_worst_first_and_link_to_their_figures() -> None:
    def table(name: str, verdict: Verdict | None) -> Table:
        return Table(title=name, columns=("A", "B"), rows=[("a", "1")], verdict=verdict)

    sections = [
        Section(
            id="s", title="S",
            items=[
                table("one", judged("ok.", fine=True)),
                table("two", judged("hm.", fine=False)),
                table("three", judged("no.", fine=False, bad=True)),
                table("four", Verdict(level="told", text="so.")),
                table("five", None),
            ],
        )
    ]  # fmt: skip
    assert count_verdicts(sections) == {"fine": 1, "look": 1, "bad": 1}
    text = render("T", [], sections)
    findings = text.split('id="findings"')[1].split("</section>")[0]
    assert "1 of 3 figures" in findings
    assert findings.index('href="#s-3"') < findings.index('href="#s-2"')
    assert "#s-1" not in findings
    assert "#s-4" not in findings


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_refused_adjustment_heads_the_findings_with_its_reason() -> None:
    why = ["height above ground 61 m DOES NOT AGREE with 34 +- 3 m", "the direct result stays"]
    run = {"tool": "georef:adjust", "outcome": "done", "summary": {"used": False, "doubts": why},
           "message": None, "warnings": why, "fid": 1, "started": "2026", "duration_s": 1.0,
           "parameters": None, "versions": None}  # fmt: skip
    # a doubtful photo of two makes the summary "bad", which comes earlier on the page
    text = page_of(project_facts(2, runs=[run], doubtful={"P001": ["blurred"]}))
    findings = text.split('id="findings"')[1].split("</section>")[0]
    first = findings.split("<li")[1]
    assert 'class="bad"' in first
    assert "No adjustment" in first
    assert "61 m DOES NOT AGREE with 34 +- 3 m" in first
    assert "Summary" in findings.split("<li")[2]
    key = first.split('href="#')[1].split('"')[0]
    assert f'id="{key}"' in text


@pytest.mark.usefixtures("pictures_undrawn")
def test_long_lists_of_warnings_are_counted() -> None:
    lines = Lines(title="W", lines=tuple(f"w{i}" for i in range(100)), most=25)
    text = render("T", [], [Section(id="s", title="S", items=[lines])])
    assert "<li>w24</li>" in text
    assert "w25" not in text
    assert "75 more" in text


@pytest.mark.usefixtures("pictures_undrawn")
def test_what_is_not_there_is_said_plainly() -> None:
    text = page_of(project_facts())
    for said in (
        "The photos were not matched with each other",
        "The photos were not adjusted to each other",
        "there are no residuals",
        "No control or check points are used",
        "There is no accuracy statement",
        "no mosaic was made",
        "There is no overlap map",
        "There is no error budget",
        "Nothing was mapped yet",
        "nothing was doubtful",
        "poses of the photos: no log",
    ):
        assert said in text, said


@pytest.mark.parametrize("photos", [1, 2])
@pytest.mark.parametrize("facts_of", [project_facts, adjusted_facts])
def test_one_and_two_photos_give_a_page(facts_of: Callable[[int], Facts], photos: int) -> None:
    text = page_of(facts_of(photos))
    assert text.startswith("<!DOCTYPE html>")
    assert text.endswith("</html>\n")
    # Page itself fails on tags that do not match
    page = Page(text)
    assert {"html", "head", "body", "main", "section"} <= page.tags
    assert page.headings[0] == 1
    assert len(page.images) > 0
    assert f"{photos}, {photos} with a place on the ground" in text


@pytest.mark.slow
def test_167_photos_stay_below_5_mb_and_20_s() -> None:
    start = time.process_time()
    text = page_of(adjusted_facts(167, each=3000))
    # 20 s of the processor: twice what 18 photos may take
    assert time.process_time() - start < 20.0
    assert len(text.encode()) < 5e6
    assert len([s for s in report_sections(adjusted_facts(), None) if s.items]) == 13


def test_pictures_are_embedded_as_what_they_are() -> None:
    verdict = judged("ok.", fine=True)
    for data, mime in ((b"\x89PNG....", "image/png"), (b"\xff\xd8\xff....", "image/jpeg")):
        picture = Picture(title="t", data=data, alt="a", look="l", verdict=verdict)
        text = render("T", [], [Section(id="s", title="S", items=[picture])])
        assert f"data:{mime};base64," in text
