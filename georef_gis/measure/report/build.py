"""The report page of a project, put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from georef_gis.measure.report.adjustment_section import adjustment_items, navigation_items
from georef_gis.measure.report.assets_section import AssetFacts, asset_items
from georef_gis.measure.report.budget_section import Budget, budget_items
from georef_gis.measure.report.camera_section import (
    camera_items,
    flight_items,
    observability_items,
)
from georef_gis.measure.report.control_section import accuracy_items, control_items
from georef_gis.measure.report.doubts_section import doubt_items
from georef_gis.measure.report.facts import Facts, Heights
from georef_gis.measure.report.flight_facts import Flown, flight_of_photos
from georef_gis.measure.report.flight_section import path_items
from georef_gis.measure.report.ground_section import ground_items
from georef_gis.measure.report.page import Section, Text, render
from georef_gis.measure.report.residual_pictures import residual_items
from georef_gis.measure.report.runs_section import Made, runs_items
from georef_gis.measure.report.site_section import facts_of, overlap_item, summary_section
from georef_gis.measure.report.tie_section import tie_items

if TYPE_CHECKING:
    from georef_gis.measure.report.pdf import Pdf

TOOL = "report"
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beside:
    """What the page tells besides the facts of the database.

    Parameters
    ----------
    flown
        None = by the poses of the photos.
    no_budget, no_assets
        Why there is no `budget` and there are no `assets`, in a sentence.
    """

    flown: Flown | None = None
    budget: Budget | None = None
    no_budget: str = ""
    assets: AssetFacts | None = None
    no_assets: str = ""
    made: Made | None = None


def report_sections(
    facts: Facts,
    heights: Heights | None,
    progress: Progress | None = None,
    beside: Beside | None = None,
) -> list[Section]:
    """All parts of the page; a part that has nothing to show says why.

    Parameters
    ----------
    heights
        Of the ground that the products lie on; None = level or not known.
    """
    parts = _parts(facts, heights, beside or Beside())
    sections = []
    for number, part in enumerate(parts):
        if progress is not None:
            progress(number / len(parts), "")
        sections.append(part())
    return sections


def _parts(facts: Facts, heights: Heights | None, given: Beside) -> Sequence[Callable[[], Section]]:
    """What makes each part of the page, in order."""
    flown = given.flown or flight_of_photos(facts)
    return (
        lambda: summary_section(facts),
        lambda: Section(id="flight", title="Flight", items=path_items(facts, flown)),
        lambda: Section(
            id="overlap", title="Overlap and ties",
            items=[overlap_item(facts), *tie_items(facts)],
        ),
        lambda: Section(
            id="adjustment", title="Adjustment",
            items=[*adjustment_items(facts), *navigation_items(facts)],
        ),
        lambda: _residuals(facts),
        lambda: _camera(facts),
        lambda: Section(id="ground", title="Ground", items=ground_items(facts, heights)),
        lambda: Section(id="control", title="Control and check points", items=control_items(facts)),
        lambda: Section(id="accuracy", title="Accuracy statement", items=accuracy_items(facts)),
        lambda: Section(
            id="budget", title="Error budget", items=budget_items(given.budget, given.no_budget)
        ),
        lambda: Section(
            id="assets", title="Assets", items=asset_items(given.assets, given.no_assets)
        ),
        lambda: Section(
            id="doubts", title="What was doubtful", items=doubt_items(facts, given.assets)
        ),
        lambda: Section(
            id="runs", title="Runs, versions and parameters",
            items=runs_items(facts, TOOL, given.made),
        ),
    )  # fmt: skip


def _residuals(facts: Facts) -> Section:
    items = residual_items(facts)
    if not items:
        why = "There is no adjustment, so there are no residuals."
        if facts.adjustment is not None:
            why = "The residuals of the adjustment are not there or hold nothing."
        items = [Text(lines=(why,))]
    return Section(id="residuals", title="Residuals", items=items)


def _camera(facts: Facts) -> Section:
    items = [*camera_items(facts), *observability_items(facts), *flight_items(facts)]
    return Section(id="camera", title="Camera, mount and clock", items=items)


def report_page(facts: Facts, sections: list[Section], *, made: str, versions: str) -> str:
    """The HTML of the page.

    Parameters
    ----------
    made, versions
        When and by what the page was made, in words.
    """
    return render(f"{facts.title}: report", facts_of(facts, made, versions), sections)


def report_pdf(facts: Facts, sections: list[Section], *, made: str, versions: str) -> Pdf:
    """The same as a PDF.

    Parameters
    ----------
    made, versions
        When and by what it was made, in words.
    """
    from georef_gis.measure.report.pdf import render_pdf

    return render_pdf(
        f"{facts.title}: report", facts_of(facts, made, versions), sections,
        program=versions.partition(",")[0],
    )  # fmt: skip
