"""Tool `match_clicks`: clicks of some photos found again in the photos beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK_TITLE
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.measure.click_match.match import Matched
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.model.control import Mark
    from processing_algorithms.measure.session import MeasureSession

MARK_COLUMNS = (
    "name", "photo", "u", "v", "sigma_px", "shared_px", "ground", "matched", "sigma_match_px",
    "quality",
)  # fmt: skip
_DEFAULT = "matched_marks.csv"


class MatchClicksParameters(p.Parameters):
    """Parameters of `match_clicks`."""

    pixel: tuple[p.PhotoPixel, ...] = p.photo_pixel(
        (), title="Pixel photo:u,v of an object; give it once per object"
    )
    photo: p.Text | None = p.text(None, title="Photo of pixels that name none")
    marks: p.File | None = p.file(
        None, title="CSV of marks: name, photo, u, v[, sigma_px]; marks of one name are one object"
    )
    click: p.Number | None = p.number(None, title=CLICK_TITLE, ge=0, le=100)
    into: tuple[p.Text, ...] = p.text((), title="Only into this photo; give it once per photo")
    most: p.Integer = p.integer(8, title="Photos to look in for each object", ge=1, le=100)
    conf: p.Number = p.number(0.3935, title="Confidence of the ellipses", gt=0, lt=1, advanced=True)
    points: p.File | None = p.file(
        None, title="CSV or JSON of the places to write", suffixes=TABLE_SUFFIXES, writes=True
    )
    target: p.File | None = p.file(
        None, title=f"CSV or JSON of the marks to write; else products/{_DEFAULT}",
        suffixes=TABLE_SUFFIXES, writes=True,
    )  # fmt: skip


class MatchClicks(Algorithm[MatchClicksParameters]):
    """Clicks found again in the photos beside them, to a fraction of a pixel, and their places.

    What cannot be told apart is refused, not guessed: no texture, an edge alone, a pattern that
    repeats itself, photos that do not show the spot. The click's own error is shared by all
    matches and counted once.
    """

    id, name, group = "match_clicks", "Match clicks into other photos", "measure"
    about = "points"
    needs = ("poses",)
    outputs = (
        Output(name="marks", title="Marks as CSV"),
        Output(name="points", title="Places as CSV or JSON"),
    )

    def run(
        self, context: Context, parameters: MatchClicksParameters, feedback: Feedback
    ) -> Result:
        """Match."""
        from processing_algorithms.measure.point_table import (
            COLUMNS,
            check_target,
            point_rows,
            write_rows,
        )
        from processing_algorithms.measure.session import MeasureSession

        for path in (parameters.target, parameters.points):
            check_target(path, parameters.marks)
        project = context.require_project()
        session = MeasureSession.open(project, quick=context.quick)
        objects = _objects(parameters, feedback)
        found = _match_all(session, objects, parameters, feedback)
        target = parameters.target or project.products / _DEFAULT
        target.parent.mkdir(parents=True, exist_ok=True)
        write_rows(target, [row for one in found.values() for row in _mark_rows(one)], MARK_COLUMNS)
        outputs = {"marks": target}
        rows = point_rows(_places(found), conf=parameters.conf)
        if parameters.points is not None:
            write_rows(parameters.points, rows, COLUMNS)
            outputs["points"] = parameters.points
        return Result(outputs=outputs, summary=_summary(found, len(objects), rows))


def _objects(parameters: MatchClicksParameters, feedback: Feedback) -> dict[str, list[Mark]]:
    """Marks of each object by its name."""
    from georef_gis.errors import InputError
    from processing_algorithms.measure.marks import marks_given

    marks = marks_given(
        parameters.pixel, parameters.photo, parameters.marks, feedback, sigma_px=parameters.click
    )
    if not marks:
        raise InputError("nothing to match: give --pixel photo:u,v or --marks", field="pixel")
    out: dict[str, list[Mark]] = {}
    for mark in marks:
        out.setdefault(mark.name, []).append(mark)
    return out


def _match_all(
    session: MeasureSession,
    objects: dict[str, list[Mark]],
    parameters: MatchClicksParameters,
    feedback: Feedback,
) -> dict[str, Matched]:
    """Matches of each object that has a place; what is wrong with it is told.

    Raises
    ------
    GeorefError
        If none has.
    """
    from georef_gis.errors import GeorefError
    from processing_algorithms.measure.matching import match_marks
    from processing_algorithms.measure.told_points import points_told

    into = [session.photo_id(name) for name in parameters.into] or None
    out: dict[str, Matched] = {}
    failed: list[GeorefError] = []
    told: list[tuple[str, str]] = []
    for i, (name, marks) in enumerate(objects.items()):
        feedback.progress(i / len(objects), name)
        try:
            out[name] = match_marks(session, marks, photos=into, most=parameters.most)
        except GeorefError as error:
            failed.append(error)
            told.append((name, str(error).removeprefix(f"{name}: ")))
            continue
        told += [(name, line) for line in _doubts(out[name])]
    for line in points_told(told):
        feedback.warn(line)
    if failed and not out:
        raise failed[0]
    return out


def _doubts(found: Matched) -> list[str]:
    of_place = found.place.doubts[0] if found.place else found.before.doubts[0]
    why_not = [f"not matched: {found.why_not}"] if found.why_not else []
    return [*why_not, *found.doubts, *of_place]


def _mark_rows(found: Matched) -> list[dict[str, Any]]:
    """The user's marks of an object, and those that were found."""
    own = [{**_mark_row(mark), "matched": 0, "sigma_match_px": "", "quality": ""}
           for mark in found.own or found.clicks]  # fmt: skip
    return own + [
        {
            **_mark_row(one.mark),
            "matched": 1,
            "sigma_match_px": round(one.sigma_px, 3),
            "quality": round(one.quality, 3),
        }
        for one in found.matches
    ]


def _mark_row(mark: Mark) -> dict[str, Any]:
    return {"name": mark.name, "photo": mark.photo, "u": round(mark.u, 3), "v": round(mark.v, 3),
            "sigma_px": round(mark.sigma_px, 3), "shared_px": round(mark.shared_px, 3),
            "ground": "on" if mark.on_ground else "free"}  # fmt: skip


def _places(found: dict[str, Matched]) -> MeasuredPoints:
    """Best place of each object."""
    from georef_gis.measure.measured import MeasuredPoints

    return MeasuredPoints.joined(*(one.place or one.before for one in found.values()))


def _summary(found: dict[str, Matched], objects: int, rows: list[dict[str, Any]]) -> dict[str, Any]:
    from processing_algorithms.measure.locate import MOST_SHOWN
    from processing_algorithms.measure.point_table import click_sigmas

    matched = [one for one in found.values() if one.matches]
    photos = sorted(len(one.matches) for one in matched)
    return {
        "objects": objects,
        "click_px": click_sigmas(_places(found)),
        "matched": len(matched),
        "matches": sum(photos),
        "photos_median": photos[len(photos) // 2] if photos else 0,
        "refused": sum(len(one.refused) for one in found.values()),
        "points": rows[:MOST_SHOWN],
    }
