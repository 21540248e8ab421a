"""Tool `plan_flight`: lines to fly, and the accuracy that may be promised before the flight."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from processing_algorithms.plan.parameters import PlanFlightParameters

if TYPE_CHECKING:
    from georef_gis.measure.budget.forecast import Forecast
    from georef_gis.measure.preflight.layout import Plan
    from georef_gis.model.camera import Camera
    from processing_algorithms.plan.plan_block import BlockPromise
    from processing_algorithms.plan.plan_lines import PlannedLines

# px of blur that a sharp picture may have
SHARP = 0.7
# s between two photos that most cameras can keep up
QUICK = 0.5
# of the overlap that all photos need so that each place is in three of one line
LEAST_OVERLAP = 0.6


class PlanFlight(Algorithm[PlanFlightParameters]):
    """Lines to fly over an area or along a road, and what accuracy may be promised.

    Ground sample distance, footprint, base, trigger interval, blur, lines as KML; what a point
    from one photo will be worth, and what one of an adjusted block: part of the plan goes through
    the adjustment itself. Told too is what the lines cannot tell of mount, clock and camera.
    """

    id, name, group = "plan_flight", "Plan a flight", "measure"
    needs_project = False
    outputs = (
        Output(name="plan", title="Lines to fly as KML"),
        Output(name="picture", title="Map of the lines, and the error budget"),
    )

    def run(self, context: Context, parameters: PlanFlightParameters, feedback: Feedback) -> Result:
        """Plan."""
        from georef_gis.errors import InputError
        from georef_gis.measure.budget.forecast import Forecast, Motion
        from georef_gis.measure.budget.shares import remedies
        from georef_gis.measure.budget.table import advice_line
        from processing_algorithms.plan.plan_block import promise
        from processing_algorithms.plan.plan_lines import (
            PlannedLines,
            planned_camera,
            planned_sensors,
        )

        camera = planned_camera(parameters)
        sensors = planned_sensors(parameters, camera)
        lines = PlannedLines.of(parameters, camera)
        if lines.origin is None and parameters.target is not None:
            raise InputError("a plan needs an area or a line to lie somewhere", field="target")
        feedback.progress(0.3, "block")
        motion = Motion(speed=parameters.speed, rate=parameters.rate)
        forecast = Forecast.of(camera, parameters.height, sensors, motion)
        block = promise(
            lines.plan, camera, sensors, tie_px=parameters.tie_px, control=parameters.control
        )
        summary = _where(lines) | _figures(parameters, lines.plan, camera)
        summary |= _promises(forecast, block)
        warnings = [*lines.doubts, *_doubts(parameters, lines.plan, camera), *_unseen(lines.plan)]
        for line in warnings:
            feedback.warn(line)
        if line := advice_line(remedies(forecast.photo())):
            feedback.info(f"a point from one photo: {line}")
        outputs = _write(parameters, lines, forecast, summary)
        return Result(outputs=outputs, summary={**summary, "doubts": warnings})


# -- figures -----------------------------------------------------------------------------------


def _where(lines: PlannedLines) -> dict[str, Any]:
    """Middle of the plan, deg: coordinates that were swapped show there."""
    if lines.origin is None:
        return {}
    lat, lon = math.degrees(lines.origin.lat), math.degrees(lines.origin.lon)
    return {"middle_lat_deg": round(lat, 5), "middle_lon_deg": round(lon, 5)}


def _figures(parameters: PlanFlightParameters, plan: Plan, camera: Camera) -> dict[str, Any]:
    layout = plan.layouts[0]
    blur = layout.blur(parameters.exposure, rate=parameters.rate, focal=camera.fx)
    over = layout.overlaps_over(parameters.relief)
    out: dict[str, Any] = {
        "gsd_m": round(layout.gsd, 4),
        "footprint_m": [round(layout.across, 2), round(layout.along, 2)],
        "base_m": round(layout.base, 2),
        "line_spacing_m": round(layout.spacing, 2),
        "trigger_interval_s": round(layout.interval, 3),
        "blur_px": round(blur, 2),
        "lines": len(plan.lines),
        "photos": plan.photos,
        "way_km": round(plan.length / 1000.0, 3),
        "minutes_without_turns": round(plan.length / layout.speed / 60.0, 1),
    }
    if parameters.relief > 0.0:
        out["overlap_over_high_ground_percent"] = [round(100.0 * share, 1) for share in over]
    if not (parameters.area or parameters.line or parameters.corner):
        # a plan of nowhere has no number of lines
        for name in ("lines", "photos", "way_km", "minutes_without_turns"):
            del out[name]
    return out


def _promises(forecast: Forecast, block: BlockPromise | None) -> dict[str, Any]:
    photo, middle = forecast.photo(), forecast.middle()
    out: dict[str, Any] = {
        "one_photo_sigma_h_m": round(photo.horizontal(), 4),
        "one_photo_middle_sigma_h_m": round(middle.horizontal(), 4),
        "one_photo_sources_m": {
            source: round(photo.horizontal(source), 4) for source in photo.by_source
        },
    }
    if block is not None:
        out |= {
            "adjusted_sigma_h_m": round(block.horizontal, 4),
            "adjusted_sigma_u_m": round(block.up, 4),
            "adjusted_distances_m": {
                f"{length:g} m": round(sigma, 4) for length, sigma in block.distances
            },
            "adjusted_with_control": block.control,
        }
    return out


def _doubts(parameters: PlanFlightParameters, plan: Plan, camera: Camera) -> list[str]:
    layout = plan.layouts[0]
    out = []
    over, side = layout.overlaps_over(parameters.relief)
    if over < LEAST_OVERLAP:
        out.append(
            f"an overlap of {100 * over:.0f} % along lines leaves places that fewer than three "
            "photos see: no adjustment finds its own mistakes there; take 60 % or more"
        )
    if len(plan.lines) > 1 and side <= 0.0:
        out.append(f"neighbouring lines do not overlap ({100 * side:.0f} %): the block falls apart")
    if layout.interval < QUICK:
        out.append(
            f"a photo every {layout.interval:.2g} s, faster than most cameras ({QUICK} s): fly "
            "slower or higher, or with less overlap along lines"
        )
    blur = layout.blur(parameters.exposure, rate=parameters.rate, focal=camera.fx)
    if blur > SHARP:
        best = parameters.exposure * SHARP / blur
        out.append(
            f"the picture moves by {blur:.2f} px during an exposure of "
            f"{1000 * parameters.exposure:.3g} ms; {SHARP} px take {1000 * best:.2g} ms or less"
        )
    return out


def _unseen(plan: Plan) -> list[str]:
    """What the planned lines cannot tell of mount, clock and camera, and what would."""
    from georef_gis.measure.preflight.layout import headings_of
    from georef_gis.measure.preflight.observable import Leg, observable

    speed = plan.layouts[0].speed
    courses = headings_of(plan.lines)
    legs = [
        Leg.still(course, line.height, speed)
        for course, line in zip(courses, plan.lines, strict=True)
    ]
    found = observable(legs)
    told = [f"with points known on the ground still: {line}" for line in found.told()]
    if not told:
        return []
    crossed = any(abs(math.sin(course - courses[0])) > 0.3 for course in courses)
    heights = len({line.height for line in plan.lines}) > 1
    cure = "vary the speed on some lines" if crossed and heights else \
        "fly crossed lines at two heights (--crossed), some of them at another speed"  # fmt: skip
    return [*told, f"to tell them apart {cure}"]


# -- files -------------------------------------------------------------------------------------


def _write(
    parameters: PlanFlightParameters,
    lines: PlannedLines,
    forecast: Forecast,
    summary: dict[str, Any],
) -> dict[str, Path]:  # fmt: skip
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    contents: dict[str, tuple[Path, bytes]] = {}
    words = (
        f"{parameters.height:g} m, GSD {100 * summary['gsd_m']:.1f} cm, "
        f"{parameters.overlap:g}/{parameters.sidelap:g} %, base {summary['base_m']:g} m, "
        f"every {summary['trigger_interval_s']:g} s at {parameters.speed:g} m/s"
    )
    if parameters.target is not None:
        from georef_gis.measure.preflight.kml import flight_kml

        if lines.origin is None:
            raise ValueError("a plan of nowhere has no file")
        data = flight_kml(
            lines.plan.lines, lines.origin, name="flight plan", description=words, area=lines.ring
        )
        contents["plan"] = (parameters.target, data)
    if parameters.picture is not None:
        from georef_gis.measure.preflight.plot import plan_figure
        from georef_gis.measure.report.draw import png

        figure = plan_figure(lines.plan, forecast.photo(), ring=lines.ring, title=words)
        contents["picture"] = (parameters.picture, png(figure))
    for path, data in contents.values():
        with export_errors(path, lambda: 0), whole_file(resolve_target(path)) as stream:
            stream.write(data)
    return {name: path for name, (path, _) in contents.items()}
