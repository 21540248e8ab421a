"""The accuracy statement as text: the standard's sentences and their account."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from georef_gis.measure.accuracy.checks import Flag
from georef_gis.measure.accuracy.product import AXES, Assessment
from georef_gis.measure.accuracy.report import AccuracyReport, report_flags
from georef_gis.measure.accuracy.sentences import in_cm, sentence, statement_components
from georef_gis.measure.accuracy.statistics import AxisStatistics

_TITLES = {
    "products": "Products",
    "intersections": "Space intersections (points measured in several photos; no product)",
    "table": "Residuals given",
}


def statement_text(report: AccuracyReport) -> str:
    """The statement and its account as plain text."""
    flags = report_flags(report)
    lines = [f"Accuracy statement: {report.title}", ""]
    for assessment in report.assessments:
        lines += [_heading(assessment), ""]
        for c in statement_components(assessment):
            lines += [sentence(c), ""]
        lines += [*_figures(assessment), ""]
        lines += _listed("To investigate and to know", flags[assessment.kind])
    survey = report.survey
    lines += [
        "Check points and survey",
        "",
        f"Datum of the check points: {survey.datum}; of the products: {survey.product_datum}. "
        f"Heights: {survey.heights}. Map: {survey.crs}.",
        _distribution_line(report),
        _control_line(report),
        _seam_line(report),
        *_distance_lines(report),
        "",
        *_listed("To investigate and to know", flags["survey"]),
        *(f"{note}" for note in report.notes),
        "RMSE contain the error of the survey where it is stated. Errors are product minus survey. "
        "No figure is at 95 % confidence.",
    ]
    return "\n".join(lines).rstrip() + "\n"


def _heading(assessment: Assessment) -> str:
    on = ", ".join(f"{what} from {where}" for what, where in assessment.measured_on.items())
    return _TITLES[assessment.kind] + (f": {on}" if on else "")


def _figures(assessment: Assessment) -> Iterator[str]:
    for name in AXES:
        if name in assessment.axes:
            yield _axis_line(assessment.axes[name])
    if assessment.vegetated is not None:
        yield _axis_line(assessment.vegetated) + " (in vegetation)"
    for c in assessment.components:
        if c.n:
            survey = "not stated" if c.survey is None else f"{in_cm(c.survey)} cm"
            where = " in vegetation" if c.vegetated else ""
            yield (
                f"RMSE_{c.name}{where} {in_cm(c.rmse)} cm, n = {c.n} "
                f"(fit {in_cm(c.fit)} cm, survey {survey})"
            )
    if not any(c.n for c in assessment.components):
        yield "Nothing was tested."


def _axis_line(a: AxisStatistics) -> str:
    line = f"{a.axis.upper()}: RMSE {in_cm(a.rmse)} cm, mean {100 * a.mean:+.1f} cm"
    if a.n > 1:
        line += f" (t = {a.t:.2f}, p = {a.p:.2g}, {a.mean_share:.0%} of "
        line += "the RMSE found)" if a.target is None else "the target)"
        line += f", standard deviation {in_cm(a.sd)} cm"
    return f"{line}, from {100 * a.minimum:+.1f} to {100 * a.maximum:+.1f} cm, n = {a.n}"


def _listed(title: str, flags: Sequence[Flag]) -> list[str]:
    return [f"{title}:", *(f"- {flag.text}" for flag in flags), ""] if flags else []


def _distribution_line(report: AccuracyReport) -> str:
    spread = report.spread
    if spread is None:
        return "Distribution of the check points: not known."
    counts = "/".join(str(n) for n in spread.quadrants)
    even = "even" if spread.is_even and spread.of_site else "not shown to be even"
    return f"Distribution of the check points by quadrant (NE/NW/SW/SE): {counts}, {even}."


def _control_line(report: AccuracyReport) -> str:
    control = report.survey.control_names
    if not control:
        return "Control points used in processing: none named."
    nearest = report.nearest_control
    apart = f"; nearest to a check point: {nearest:.1f} m" if math.isfinite(nearest) else ""
    return f"Control points used in processing, not counted as checks: {len(control)}{apart}."


def _seam_line(report: AccuracyReport) -> str:
    limit = report.seam_limit
    told = "not known" if limit is None else f"{in_cm(limit)} cm"
    line = f"Seam mismatch of the mosaic: limit 2 x RMSE_H = {told}; found: "
    found = report.seams
    if found is None:
        return f"{line}____ (not measured)."
    meets = report.seams_meet
    verdict = "" if meets is None else ", met" if meets else ", NOT met"
    return (
        f"{line}{in_cm(found.p90)} cm at the 90th percentile, {in_cm(found.median)} cm in the "
        f"median, of {found.accepted} places where photos could be compared "
        f"(of {found.places}){verdict}."
    )


def _distance_lines(report: AccuracyReport) -> Iterator[str]:
    """How well distances within the site are known, where an adjustment tells."""
    if report.distances:
        told = ", ".join(f"{in_cm(sigma)} cm at {length:g} m" for length, sigma in report.distances)
        yield f"Distances within the site: one sigma {told} (by the adjustment, not tested)."
