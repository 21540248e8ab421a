"""Tool `error_budget`: what the errors of this flight are made of, and what to fix first."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK

if TYPE_CHECKING:
    from georef_gis.measure.budget.parts import SourcedErrors
    from georef_gis.measure.budget.shares import PointBudget, Remedy
    from georef_gis.model.control import Mark
    from georef_gis.project import Project
    from processing_algorithms.measure.session import MeasureSession

NAME = "error_budget"
# photos beyond which an even choice stands for all
MOST_PHOTOS = 600
# times the usual sigma from which a photo is told apart
FAR = 3.0
# photos that are told one by one
MOST_TOLD = 8


class ErrorBudgetParameters(p.Parameters):
    """Parameters of `error_budget`."""

    photos: p.PhotoSet = p.photo_set()
    pixel: tuple[p.PhotoPixel, ...] = p.photo_pixel(
        (), title="Pixel photo:u,v of a point; give it once per point"
    )
    photo: p.Text | None = p.text(None, title="Photo of pixels that name none")
    marks: p.File | None = p.file(
        None, title="CSV of marks: name, photo, u, v[, sigma_px]; several of a name: one point"
    )
    assets: p.Flag = p.flag(False, title="The assets of the project that were clicked")
    click: p.Number = p.number(CLICK, title="One sigma of a click", unit="px", ge=0, le=100)
    reduce_to: p.Number = p.number(
        50.0, title="Told: what a source reduced to so much of it brings", unit="%", ge=0, lt=100
    )


class ErrorBudget(Algorithm[ErrorBudgetParameters]):
    """Error budget of the photos, or of points: GNSS, attitude, mount, time, camera, ground, click.

    One sigma of each source on every axis; their squares add to the square of the whole. Where
    poses came from an adjustment, its covariance is taken apart by what went into it. What to fix
    first is told: by how much the whole falls when a source is reduced.
    """

    id, name, group = NAME, "Error budget", "measure"
    needs = ("poses",)
    wants = ("adjusted",)
    uses_quick = True
    outputs = (
        Output(name="table", title="Budget of every photo or point as CSV"),
        Output(name="budget", title="The same and what to fix first as JSON"),
        Output(name="picture", title="Plot of the budget"),
        Output(name="tilt", title="Angle errors against position errors from this height"),
    )

    def run(
        self, context: Context, parameters: ErrorBudgetParameters, feedback: Feedback
    ) -> Result:
        """Take the errors apart."""
        from georef_gis.measure.budget.shares import remedies, usual_budget
        from georef_gis.measure.budget.table import advice_line, height_line
        from processing_algorithms.measure.budget_sources import error_sources
        from processing_algorithms.measure.session import MeasureSession

        project = context.require_project()
        session = MeasureSession.open(project, quick=context.quick)
        notes: list[str] = []
        errors = error_sources(project, session.site, session.scene.errors, notes)
        for note in notes:
            feedback.warn(note)
        feedback.progress(0.3, "sources")
        marks = _marks(parameters, session, feedback)
        if marks:
            each = _of_marks(session, errors, marks, feedback)
        else:
            each = _of_photos(parameters, session, errors, feedback)
        whole = usual_budget(each, "usual")
        found = remedies(whole, factor=parameters.reduce_to / 100.0)
        if line := advice_line(found):
            feedback.info(line)
        feedback.info(height_line(whole))
        warnings = _far(each, whole)
        for line in warnings:
            feedback.warn(line)
        outputs = _write(project, session, each, whole, found)
        return Result(
            outputs=outputs, summary=_summary(each, whole, found, [*notes, *warnings], outputs)
        )


# -- points --------------------------------------------------------------------------------------


def _marks(
    parameters: ErrorBudgetParameters, session: MeasureSession, feedback: Feedback
) -> list[Mark]:
    from georef_gis.errors import InputError
    from processing_algorithms.measure.marks import marks_of_pixels, read_mark_table

    if parameters.photo is not None and not parameters.pixel:
        raise InputError(
            "is that of --pixel u,v, and no pixel is given; the table has every photo",
            field="photo",
        )
    out = marks_of_pixels(parameters.pixel, parameters.photo, sigma_px=parameters.click)
    if parameters.marks is not None:
        out += read_mark_table(parameters.marks, feedback)
    if parameters.assets:
        out += _asset_marks(session.project, parameters.click)
    return out


def _asset_marks(project: Project, click: float) -> list[Mark]:
    """Clicks of the assets that have some; a vertex is a point.

    Raises
    ------
    InputError
        If none has.
    """
    from georef_gis.errors import InputError
    from georef_gis.measure.assets.store import AssetStore
    from processing_algorithms.assets.asset_clicks import mark_of

    with AssetStore.of_project(project) as store:
        assets = store.assets()
    out = []
    for asset in assets:
        name = asset.name or f"{asset.kind} {asset.id[:8]}"
        for one in asset.quality.clicks if asset.quality is not None else ():
            label = name if len(asset.vertices) == 1 else f"{name}/{one.vertex + 1}"
            out.append(mark_of(label, one, click))
    if not out:
        raise InputError(
            "no asset of the project was clicked in a photo; `georef assets --clicks` takes clicks",
            field="assets",
        )
    return out


def _of_marks(
    session: MeasureSession, errors: SourcedErrors, marks: list[Mark], feedback: Feedback
) -> list[PointBudget]:
    from georef_gis.errors import GeometryError
    from georef_gis.measure.budget.shares import point_budgets
    from processing_algorithms.measure.told_points import points_told

    points = session.measure(marks, on_fail="skip")
    refused = [(name, line.removeprefix(f"{name}: ")) for name, line in points.refused.items()]
    told = points_told(refused)
    if told and not len(points):
        raise GeometryError(f"no point has a place: {told[0]}")
    for line in told:
        feedback.warn(line)
    return point_budgets(points, errors)


def _of_photos(
    parameters: ErrorBudgetParameters, session: MeasureSession, errors: SourcedErrors,
    feedback: Feedback,
) -> list[PointBudget]:  # fmt: skip
    from georef_gis.measure.budget.shares import photo_budgets

    chosen = _chosen(parameters, session)
    if len(chosen) > MOST_PHOTOS:
        feedback.info(f"{MOST_PHOTOS} of {len(chosen)} photos, evenly chosen, stand for all")
        step = len(chosen) / MOST_PHOTOS
        chosen = [chosen[int(k * step)] for k in range(MOST_PHOTOS)]
    out: list[PointBudget] = []
    for first in range(0, len(chosen), 20):
        check_cancelled(feedback)
        part = chosen[first : first + 20]
        found, refused = photo_budgets(session.scene, part, errors, click=parameters.click)
        out += found
        for line in refused.values():
            feedback.warn(line)
        feedback.progress(0.3 + 0.6 * first / len(chosen), f"{len(out)} photos")
    return out


def _chosen(parameters: ErrorBudgetParameters, session: MeasureSession) -> list[str]:
    if not parameters.photos:
        return list(session.site.photos)
    return [session.photo_id(written) for written in parameters.photos]


# -- results -------------------------------------------------------------------------------------


def _far(each: Sequence[PointBudget], whole: PointBudget) -> list[str]:
    """Photos or points that are far worse than usual, and by which source."""
    from georef_gis.measure.budget.shares import COUPLED, SOURCES

    usual = whole.horizontal()
    lines = []
    for budget in sorted(each, key=lambda one: -one.horizontal()):
        if budget.horizontal() <= FAR * usual:
            break
        source = max(
            (s for s in budget.by_source if s not in COUPLED), key=lambda s: budget.horizontal(s)
        )
        lines.append(
            f"{budget.name}: {budget.horizontal():.3g} m against {usual:.3g} m usually, most of "
            f"it by {SOURCES[source]} ({budget.horizontal(source):.3g} m)"
        )
    more = len(lines) - MOST_TOLD
    return lines if more <= 0 else [*lines[:MOST_TOLD], f"... and {more} more"]


def _summary(
    each: Sequence[PointBudget], whole: PointBudget, found: Sequence[Remedy], doubts: list[str],
    outputs: dict[str, Path],
) -> dict[str, Any]:  # fmt: skip
    from georef_gis.measure.budget.table import remedy_line

    return {
        "products": [str(path) for path in outputs.values()],
        "places": len(each),
        "pose_kind": whole.pose_kind,
        "sigma_h_m": round(whole.horizontal(), 4),
        "sigma_u_m": round(float(whole.sigma()[2]), 4),
        "sources_h_m": {s: round(whole.horizontal(s), 4) for s in whole.by_source},
        "fix_first": {remedy.source: remedy_line(remedy) for remedy in found[:3]},
        "doubts": doubts,
    }


def _write(
    project: Project, session: MeasureSession, each: Sequence[PointBudget], whole: PointBudget,
    found: Sequence[Remedy],
) -> dict[str, Path]:  # fmt: skip
    from georef_gis.measure.budget.plots import budget_figure, tilt_figure
    from georef_gis.measure.budget.table import budget_row, remedy_rows, sources_of
    from georef_gis.measure.report.draw import png
    from georef_gis.rasters.files import export_errors, whole_file
    from processing_algorithms.measure.point_table import write_rows

    project.products.mkdir(parents=True, exist_ok=True)
    sources = sources_of(each)
    rows = [budget_row(budget, sources=sources) for budget in (whole, *each)]
    paths = {"table": project.products / f"{NAME}.csv", "budget": project.products / f"{NAME}.json"}
    write_rows(paths["table"], rows, list(rows[0]))
    content = {"usual": rows[0], "fix_first": remedy_rows(found), "places": rows[1:]}
    pictures = {"picture": png(budget_figure(whole, found, each, title=_title(each, whole)))}
    height = _height(session)
    if height is not None:
        pictures["tilt"] = png(tilt_figure(height))
    files = {"budget": json.dumps(content, indent=1).encode()} | pictures
    paths |= {key: project.products / f"{NAME}_{key}.png" for key in pictures}
    paths["picture"] = project.products / f"{NAME}.png"
    for key, data in files.items():
        path = paths[key]
        with export_errors(path, lambda: 0), whole_file(path) as stream:
            stream.write(data)
    return paths


def _title(each: Sequence[PointBudget], whole: PointBudget) -> str:
    what = "photos" if all(budget.name in budget.photo_ids for budget in each) else "points"
    return f"Error budget of {len(each)} {what}, poses: {whole.pose_kind}"


def _height(session: MeasureSession) -> float | None:
    """Usual height of the cameras above the ground, m; None where no ground is known below."""
    import numpy as np

    places = session.scene.photos.origin_enu
    above = places[:, 2] - session.scene.terrain.z_at(places[:, :2])
    known = above[np.isfinite(above)]
    return float(np.median(known)) if len(known) else None
