"""What the command line says at the end of a run, in plain text."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from georef_gis.app.grouping import grouped
from georef_gis.toolbox.runner import products_of
from georef_gis.toolbox.steps import StepReport

# Lines of doubts shown; all are in the database.
MOST_DOUBTS = 20
MERGED_KEYS = ("gsd_m", "covered_m2", "sigma_horizontal_m")
STANDARD_KEYS = ("products", "gsd_m", "covered_m2", "doubts")
# m2 in a hectare; areas from there on are given in it
HECTARE = 1e4


def run_lines(reports: Sequence[StepReport], database: Path) -> list[str]:
    """Where the products are, GSD, covered area, accuracy and doubts, after `georef run`."""
    ran = [report for report in reports if not report.skipped]
    lines = [
        f"{report.tool.id:<20} {report.duration_s:7.1f} s  ({report.reason})" for report in ran
    ]
    if len(ran) < len(reports):
        lines.append(f"{len(reports) - len(ran)} of {len(reports)} steps were unchanged")
    merged: dict[str, Any] = {}
    for report in reports:
        merged |= {key: report.result.summary[key] for key in MERGED_KEYS
                   if report.result.summary.get(key) is not None}  # fmt: skip
    products = [database, *products_of(reports)] if database.exists() else products_of(reports)
    lines += [f"wrote  {short_path(path)}" for path in products]
    if "gsd_m" in merged:
        lines.append(f"GSD    {length_text(merged['gsd_m'])}")
    if "covered_m2" in merged:
        lines.append(f"area   {area_text(merged['covered_m2'])}")
    if "sigma_horizontal_m" in merged:
        lines.append(
            f"trust  a photo's place to {length_text(merged['sigma_horizontal_m'])} "
            "(one sigma east and north, median); neighbours err alike"
        )
    lines += [line for report in reports for line in _distance_lines(report.result.summary)]
    lines += [line for report in reports for line in _control_lines(report.result.summary)]
    return lines + _doubt_lines(reports)


def tool_lines(report: StepReport) -> list[str]:
    """Products and figures of a single tool."""
    summary = report.result.summary
    lines = ["unchanged since its last run; --force runs it"] if report.skipped else []
    written = [str(path) for path in report.result.outputs.values()]
    names = dict.fromkeys([*map(str, summary.get("products", ())), *written])
    lines += [f"wrote  {short_path(Path(name))}" for name in names]
    if summary.get("gsd_m") is not None:
        lines.append(f"GSD    {length_text(summary['gsd_m'])}")
    if summary.get("covered_m2") is not None:
        lines.append(f"area   {area_text(summary['covered_m2'])}")
    rest = {key: value for key, value in summary.items() if key not in STANDARD_KEYS}
    lines += [line for key, value in rest.items() for line in _figure(key, value)]
    return lines + _doubt_lines([report])


def report_event(report: StepReport) -> dict[str, Any]:
    """JSON-able content of a step's report."""
    return {
        "tool": report.tool.full_id,
        "skipped": report.skipped,
        "reason": report.reason,
        "duration_s": round(report.duration_s, 3),
        "outputs": {name: str(path) for name, path in report.result.outputs.items()},
        "summary": dict(report.result.summary),
        "warnings": list(report.result.warnings),
    }


def length_text(length_m: float) -> str:
    """Length in the unit that suits it."""
    return f"{100.0 * length_m:.2f} cm" if length_m < 1.0 else f"{length_m:.2f} m"


def area_text(area_m2: float) -> str:
    """Area in the unit that suits it."""
    return f"{area_m2 / HECTARE:.2f} ha" if area_m2 >= HECTARE else f"{area_m2:.0f} m2"


def _distance_lines(summary: Mapping[str, Any]) -> list[str]:
    """How well distances within the site are known, if an adjustment tells."""
    told = [f"{length_text(v)} at {k}" for k, v in summary.get("sigma_of_distances_m", {}).items()]
    return [f"trust  distances within the site to {', '.join(told)} (one sigma)"] if told else []


def _control_lines(summary: Mapping[str, Any]) -> list[str]:
    """How the poses agree with surveyed points, if there are any."""
    if "compared" not in summary:
        return []
    east, north = length_text(summary["rms_east_m"]), length_text(summary["rms_north_m"])
    wrong = summary.get("wrong_marks")
    left_out = f"; {wrong} more are called wrong and do not count" if wrong else ""
    return [
        f"points {summary['compared']} marks lie off by {east} east, {north} north (rms); "
        f"{length_text(summary['expected_sigma_m'])} was to be expected of a mark that one photo "
        f"lays on the ground{_used(summary)}{left_out}"
    ]


def _used(summary: Mapping[str, Any]) -> str:
    """How many of the compared marks are of points that the photos were adjusted to."""
    used = summary.get("marks_adjusted_to")
    return f"; {used} of them held the photos when they were adjusted" if used else ""


def _doubt_lines(reports: Sequence[StepReport]) -> list[str]:
    doubts: dict[str, list[str]] = {}
    for report in reports:
        of_tool = doubts.setdefault(report.tool.algorithm.about, [])
        of_tool += report.result.summary.get("doubts", ())
    told = list(dict.fromkeys(line for about in doubts for line in grouped(doubts[about], about)))
    lines = [f"doubt  {doubt}" for doubt in told[:MOST_DOUBTS]]
    if len(told) > MOST_DOUBTS:
        lines.append(f"       and {len(told) - MOST_DOUBTS} more in the database, table run")
    return lines


def _figure(key: str, value: Any) -> list[str]:
    if value is None:
        return []
    if isinstance(value, Mapping):
        return [line for name, item in value.items() for line in _figure(f"{key}.{name}", item)]
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list) for item in value):
        return [line for n, item in enumerate(value, 1) for line in _figure(f"{key}.{n}", item)]
    if isinstance(value, list | tuple):
        return [f"{key:<28} {', '.join(map(_number, value))}"]
    return [f"{key:<28} {_number(value)}"]


def _number(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def short_path(path: Path) -> str:
    """Path from the working directory if it lies below it."""
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
