"""Tool `locate`: places of pixels, each by one photo and the ground."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK_TITLE
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.measure.measured import MeasuredPoints

# points that the summary holds
MOST_SHOWN = 50


class LocateParameters(p.Parameters):
    """Parameters of `locate`."""

    pixel: tuple[p.PhotoPixel, ...] = p.photo_pixel(
        (), title="Pixel photo:u,v; give it once per point"
    )
    photo: p.Text | None = p.text(None, title="Photo of pixels that name none")
    marks: p.File | None = p.file(None, title="CSV of marks: name, photo, u, v[, sigma_px]")
    click: p.Number | None = p.number(None, title=CLICK_TITLE, ge=0, le=100)
    conf: p.Number = p.number(0.3935, title="Confidence of the ellipses", gt=0, lt=1, advanced=True)
    skip: p.Flag = p.flag(False, title="Go on without pixels that cannot be located")
    target: p.File | None = p.file(
        None, title="CSV or JSON of the points to write", suffixes=TABLE_SUFFIXES, writes=True
    )


class Locate(Algorithm[LocateParameters]):
    """Places of pixels, each by one photo and the ground below it, with their full covariance.

    Pose, camera, time, ground and click count, and how they hang together. A pixel at the sky,
    beyond the terrain or outside of its photo is refused.
    """

    id, name, group = "locate", "Locate pixels", "measure"
    about = "points"
    needs = ("poses",)
    outputs = (Output(name="points", title="Points as CSV or JSON"),)

    def run(self, context: Context, parameters: LocateParameters, feedback: Feedback) -> Result:
        """Locate."""
        from georef_gis.errors import InputError
        from processing_algorithms.measure.marks import marks_given
        from processing_algorithms.measure.point_table import check_target
        from processing_algorithms.measure.session import MeasureSession

        check_target(parameters.target, parameters.marks)
        session = MeasureSession.open(context.require_project(), quick=context.quick)
        marks = marks_given(
            parameters.pixel, parameters.photo, parameters.marks, feedback,
            sigma_px=parameters.click,
        )  # fmt: skip
        if not marks:
            raise InputError("nothing to locate: give --pixel photo:u,v or --marks", field="pixel")
        found = session.locate(marks, on_fail="skip" if parameters.skip else "raise")
        return points_result(found, parameters.target, parameters.conf, feedback)


def warn_doubts(points: MeasuredPoints, feedback: Feedback) -> None:
    """Tell what is doubtful about points; what is said of several, such as of their photo, once."""
    from georef_gis.ingest.control_photos import some_names
    from georef_gis.measure.on_ground import SURER

    of: dict[str, list[str]] = {}
    for name, lines in zip(points.names, points.doubts, strict=True):
        for line in lines:
            # each says it with figures of its own
            known = next((k for k in of if line.startswith(SURER) and k.startswith(SURER)), line)
            of.setdefault(known, []).append(name)
    for line, names in of.items():
        more = f"{names[0]}: " if line.startswith(SURER) and len(names) > 1 else ""
        feedback.warn(f"{some_names(names)}: {more}{line}")


def points_result(
    points: MeasuredPoints, target: Path | None, conf: float, feedback: Feedback
) -> Result:
    """Table of points written, what is doubtful told, and a summary.

    Raises
    ------
    GeometryError
        If all were refused.
    """
    from georef_gis.errors import GeometryError
    from processing_algorithms.measure.point_table import (
        COLUMNS,
        click_sigmas,
        point_rows,
        write_rows,
    )

    if points.refused and not len(points):
        first = next(iter(points.refused.values()))
        raise GeometryError(f"none of {len(points.refused)} points could be measured: {first}")
    for line in points.refused.values():
        feedback.warn(line)
    warn_doubts(points, feedback)
    rows = point_rows(points, conf=conf)
    summary: dict[str, Any] = {"measured": len(points), "refused": len(points.refused)}
    if rows:
        largest = sorted(row["semi_major_m"] for row in rows)
        summary["semi_major_m_median"] = largest[len(largest) // 2]
        summary["semi_major_m_most"] = largest[-1]
    summary["click_px"] = click_sigmas(points)
    summary["points"] = rows[:MOST_SHOWN]
    outputs: dict[str, Path] = {}
    if target is not None:
        write_rows(target, rows, COLUMNS)
        outputs["points"] = target
    return Result(outputs=outputs, summary=summary)
