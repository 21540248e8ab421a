"""Tool `intersect`: places of points that are marked in several photos."""

from __future__ import annotations

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK_TITLE, GROUND
from processing_algorithms.measure.point_table import TABLE_SUFFIXES


class IntersectParameters(p.Parameters):
    """Parameters of `intersect`."""

    marks: p.File = p.file(
        title="CSV of marks: name, photo, u, v[, sigma_px, ground]; marks of one name are one point"
    )
    click: p.Number | None = p.number(None, title=CLICK_TITLE, ge=0, le=100)
    ground: p.Choice | None = p.choice(
        None, choices=GROUND, title="Whether the points lie on the ground: on or free; else as the "
        "table's column ground says, or free", help="On the ground its height counts as one more "
        "observation, unless it contradicts the rays by three sigmas: then that is told.",
    )  # fmt: skip
    conf: p.Number = p.number(0.3935, title="Confidence of the ellipses", gt=0, lt=1, advanced=True)
    strict: p.Flag = p.flag(
        False, title="Stop at the first mark or point that cannot be used", advanced=True
    )
    target: p.File | None = p.file(
        None, title="CSV or JSON of the points to write", suffixes=TABLE_SUFFIXES, writes=True
    )


class Intersect(Algorithm[IntersectParameters]):
    """Places of points that are marked in two photos or more, with their full covariance.

    Of three marks or more a wrong one is found, told and left out; rays that run nearly parallel
    are refused. Where points lie on the ground, its height makes them surer.
    """

    id, name, group = "intersect", "Intersect marks", "measure"
    about = "points"
    needs = ("poses",)
    outputs = (Output(name="points", title="Points as CSV or JSON"),)

    def run(self, context: Context, parameters: IntersectParameters, feedback: Feedback) -> Result:
        """Intersect."""
        from processing_algorithms.measure.locate import points_result
        from processing_algorithms.measure.marks import on_ground, read_mark_table
        from processing_algorithms.measure.point_table import check_target
        from processing_algorithms.measure.session import MeasureSession

        check_target(parameters.target, parameters.marks)
        session = MeasureSession.open(context.require_project(), quick=context.quick)
        marks = read_mark_table(parameters.marks, feedback, sigma_px=parameters.click)
        marks = on_ground(marks, parameters.ground)
        found = session.intersect(marks, on_fail="raise" if parameters.strict else "skip")
        return points_result(found, parameters.target, parameters.conf, feedback)
