"""Tool `measure_lines`: distances, heights, bearings and areas between marked points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK_TITLE
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.measure.lengths import Leg, Lengths, Quantity
    from georef_gis.measure.measured import MeasuredPoints


class MeasureLinesParameters(p.Parameters):
    """Parameters of `measure_lines`."""

    pixel: tuple[p.PhotoPixel, ...] = p.photo_pixel(
        (), title="Pixel photo:u,v of the next point; give it once per point"
    )
    photo: p.Text | None = p.text(None, title="Photo of pixels that name none")
    marks: p.File | None = p.file(
        None, title="CSV of marks: name, photo, u, v[, sigma_px]; points in their first order"
    )
    points: tuple[p.Text, ...] = p.text(
        (), title="Only these points, in this order; give it once per point"
    )
    closed: p.Flag = p.flag(False, title="Back to the first point: perimeter and area")
    click: p.Number | None = p.number(None, title=CLICK_TITLE, ge=0, le=100)
    target: p.File | None = p.file(
        None, title="CSV or JSON of the lines to write", suffixes=TABLE_SUFFIXES, writes=True
    )


class MeasureLines(Algorithm[MeasureLinesParameters]):
    """Distances, height differences, bearings, perimeter and area, each with its sigma.

    On the ground and on the map. A point marked in one photo lies on the ground, one marked in
    several is intersected. Points share most of their errors, so that lengths are better than the
    places: how much better is said.
    """

    id, name, group = "measure_lines", "Measure lines and areas", "measure"
    about = "points"
    needs = ("poses",)
    outputs = (Output(name="lines", title="Lines as CSV or JSON"),)

    def run(
        self, context: Context, parameters: MeasureLinesParameters, feedback: Feedback
    ) -> Result:
        """Measure."""
        from processing_algorithms.measure.locate import warn_doubts
        from processing_algorithms.measure.marks import marks_given
        from processing_algorithms.measure.point_table import (
            check_target,
            click_sigmas,
            write_rows,
        )
        from processing_algorithms.measure.session import MeasureSession

        check_target(parameters.target, parameters.marks)
        session = MeasureSession.open(context.require_project(), quick=context.quick)
        marks = marks_given(
            parameters.pixel, parameters.photo, parameters.marks, feedback,
            sigma_px=parameters.click,
        )  # fmt: skip
        points = _chosen(session.measure(marks), parameters.points)
        warn_doubts(points, feedback)
        found = session.lines(points, closed=parameters.closed)
        for line in found.told():
            feedback.info(line)
        clicks = click_sigmas(points)
        feedback.info(f"clicks taken as good to {clicks} px (one sigma); --click says otherwise")
        rows = [line_row(leg) for leg in found.legs]
        outputs: dict[str, Path] = {}
        if parameters.target is not None:
            write_rows(parameters.target, rows, list(rows[0]))
            outputs["lines"] = parameters.target
        return Result(
            outputs=outputs, summary=summary_of(found) | {"click_px": clicks, "lines": rows}
        )


def _chosen(points: MeasuredPoints, names: Sequence[str]) -> MeasuredPoints:
    """Points of these names in their order; all where none is named."""
    from georef_gis.errors import InputError

    if not names:
        return points
    strange = [name for name in names if name not in points.names]
    if strange:
        known = ", ".join(points.names[:10])
        raise InputError(f"no point is called '{strange[0]}'; names are {known}", field="points")
    again = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if again is not None:
        # its click would count as two that err apart
        raise InputError(
            f"'{again}' comes twice; back to the first point is --closed", field="points"
        )
    return points.subset([points.names.index(name) for name in names])


def line_row(leg: Leg) -> dict[str, Any]:
    """Row of a table: from, to, lengths in m and bearings in deg, each with one sigma."""
    row: dict[str, Any] = {"from": leg.names[0], "to": leg.names[1]}
    lengths = {
        "slope": leg.slope, "ground": leg.ground, "grid": leg.grid,
        "height_difference": leg.height_difference,
    }  # fmt: skip
    for name, length in lengths.items():
        row |= {f"{name}_m": round(length.value, 4), f"sigma_{name}_m": round(length.sigma, 4)}
    row["sigma_by_places_m"] = round(leg.ground.sigma_apart, 4)
    for name, angle in (("bearing_true", leg.bearing_true), ("bearing_grid", leg.bearing_grid)):
        row |= {
            f"{name}_deg": round(math.degrees(angle.value), 4),
            f"sigma_{name}_deg": round(math.degrees(angle.sigma), 4),
        }
    return row


def summary_of(found: Lengths) -> dict[str, Any]:
    """Totals: lengths in m, areas in m2, each with one sigma; sentences for people."""
    totals: dict[str, tuple[Quantity | None, str]] = {
        "slope": (found.slope, "m"), "ground": (found.ground, "m"), "grid": (found.grid, "m"),
        "area_ground": (found.area_ground, "m2"), "area_grid": (found.area_grid, "m2"),
    }  # fmt: skip
    out: dict[str, Any] = {}
    for name, (value, unit) in totals.items():
        if value is not None:
            out[f"{name}_{unit}"] = round(value.value, 4)
            out[f"sigma_{name}_{unit}"] = round(value.sigma, 4)
            out[f"sigma_{name}_by_places_{unit}"] = round(value.sigma_apart, 4)
    return out | {"scale": round(found.scale, 7), "told": found.told(), "doubts": [*found.doubts]}
