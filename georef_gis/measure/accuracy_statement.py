"""The accuracy statement: the standard's sentences, an account in text, JSON, product metadata."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.accuracy import AXES, Assessment, Component
from georef_gis.measure.accuracy_checks import (
    Extent,
    Flag,
    distance_to_control,
    distribution,
    flags_of,
    placement_flags,
)
from georef_gis.measure.accuracy_statistics import AxisStatistics

STANDARD = (
    "ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, Version 2 (2024)"
)
FORMAT = "georef_gis accuracy 1"
# px per RMSE_H that seams of a mosaic may mismatch (7.3)
SEAM = 2.0
_CLASS = {
    "H": "RMSE_H Horizontal Positional Accuracy Class",
    "V": "RMSE_V Vertical Accuracy Class",
    "3D": "RMSE_3D Three-Dimensional Positional Accuracy Class",
}
_PRODUCED = {"H": _CLASS["H"], "V": "RMSE_V Non-Vegetated Vertical Accuracy (NVA) Class"}
_FOUND = {
    "H": "The tested horizontal positional accuracy was found to be RMSE_H = {found} (cm)",
    "V": "The Non-Vegetated Vertical Accuracy (NVA) was found to be RMSE_V = {found} (cm)",
    "VVA": "The Vegetated Vertical Accuracy (VVA) was found to be RMSE_V = {found} (cm)",
    "3D": "The tested three-dimensional accuracy was found to be RMSE_3D = {found} (cm) within "
    "the NVA tested area",
}
_TITLES = {
    "products": "Products",
    "intersections": "Space intersections (points measured in several photos; no product)",
    "table": "Residuals given",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """What is known of the check points' survey and of the site.

    Parameters
    ----------
    datum, product_datum
        Realisation and epoch, as `NAD83(2011)@2010.0` or "unknown".
    heights
        Kind of the surveyed heights and geoid, in words.
    crs
        CRS in which residuals are east and north, in words.
    control_map : shape (k, 2), m
        Places of the control points used in processing.
    extent
        Of the site on the map, m; None = not known.
    """

    datum: str = "unknown"
    product_datum: str = "unknown"
    heights: str = "unknown"
    crs: str = "unknown"
    control_names: tuple[str, ...] = ()
    control_map: Array = field(default_factory=lambda: np.zeros((0, 2)))
    extent: Extent | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamFinding:
    """How far photos lie apart at the mosaic's seams, m, at places where that could be told."""

    places: int
    accepted: int
    median: float
    p90: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccuracyReport:
    """Assessments of one site with what the statement has to tell of their making.

    `untested` names check points that could not be read, with the reason. `distances` are lengths
    on the map and one sigma of a distance of that length by the adjustment, m. `seams` is what was
    measured of the mosaic's.
    """

    title: str
    assessments: tuple[Assessment, ...]
    survey: Survey = field(default_factory=Survey)
    untested: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    distances: tuple[tuple[float, float], ...] = ()
    seams: SeamFinding | None = None

    @property
    def main(self) -> Assessment:
        """Assessment that the statement is about: of the products, else of a table."""
        return next((a for a in self.assessments if a.kind != "intersections"), self.assessments[0])


# -- sentences -----------------------------------------------------------------------------------


def sentence(c: Component) -> str:
    """The standard's statement (7.16) for a component, or what can be said in its place."""
    what = "VVA" if c.vegetated else c.name
    if c.case == "none" or c.class_m is None:
        axis = {"H": "horizontal", "V": "vertical", "3D": "three-dimensional"}[c.name]
        why = "" if c.name == "3D" else " and no class was declared"
        return f"No {axis} accuracy statement: there are no check points{why}."
    cls = f"{_class_cm(c.class_m)} (cm)"
    if c.case == "produced":
        return f"This data set was produced to meet {STANDARD} for a {cls} {_PRODUCED[c.name]}."
    found = _FOUND[what].format(found=_cm(c.rmse))
    if c.case == "reduced":
        text = (
            f"This data set was tested as required by {STANDARD}. Although the Standards call for "
            f"a minimum of thirty (30) checkpoints, this test was performed using ONLY {c.n} "
            f"checkpoints. This data set was produced to meet a {cls} {_CLASS[c.name]}. {found} "
            "using the reduced number of checkpoints."
        )
    elif c.meets is False:
        return (
            f"This data set was tested as required by {STANDARD} and does NOT meet the declared "
            f"{cls} {_CLASS[c.name]}. {found}."
        )
    else:
        text = f"This data set was tested to meet {STANDARD} for a {cls} {_CLASS[c.name]}. {found}."
    if c.meets is False:
        text += " It does NOT meet the declared class."
    if c.target is None:
        text += " No class was declared before the test: the class is derived from its result."
    return text


def statement_components(assessment: Assessment) -> tuple[Component, ...]:
    """Components that a statement is due for; none of intersections, which are no data set."""
    if assessment.kind == "intersections":
        return ()
    return tuple(c for c in assessment.components if c.n or (c.name != "3D" and not c.vegetated))


def report_flags(report: AccuracyReport) -> dict[str, list[Flag]]:
    """What is to be investigated or known, by kind of assessment and of the survey."""
    out: dict[str, list[Flag]] = {a.kind: flags_of(a) for a in report.assessments}
    survey = report.survey
    general = placement_flags(report.main.residuals, survey.control_map, survey.extent)
    if report.main.residuals:
        for name, datum in (("check points", survey.datum), ("products", survey.product_datum)):
            if datum == "unknown":
                text = f"datum and epoch of the {name} are not stated, which may hide metres"
                general.append(Flag(code="datum_unknown", text=text))
    if report.untested:
        told = "; ".join(f"{name} ({why})" for name, why in report.untested.items())
        general.append(Flag(code="untested", text=f"check points not read are {told}"))
    return {**out, "survey": general}


# -- text ----------------------------------------------------------------------------------------


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
            survey = "not stated" if c.survey is None else f"{_cm(c.survey)} cm"
            where = " in vegetation" if c.vegetated else ""
            yield (
                f"RMSE_{c.name}{where} {_cm(c.rmse)} cm, n = {c.n} "
                f"(fit {_cm(c.fit)} cm, survey {survey})"
            )
    if not any(c.n for c in assessment.components):
        yield "Nothing was tested."


def _axis_line(a: AxisStatistics) -> str:
    line = f"{a.axis.upper()}: RMSE {_cm(a.rmse)} cm, mean {100 * a.mean:+.1f} cm"
    if a.n > 1:
        line += f" (t = {a.t:.2f}, p = {a.p:.2g}, {a.mean_share:.0%} of "
        line += "the RMSE found)" if a.target is None else "the target)"
        line += f", standard deviation {_cm(a.sd)} cm"
    return f"{line}, from {100 * a.minimum:+.1f} to {100 * a.maximum:+.1f} cm, n = {a.n}"


def _listed(title: str, flags: Sequence[Flag]) -> list[str]:
    return [f"{title}:", *(f"- {flag.text}" for flag in flags), ""] if flags else []


def _distribution_line(report: AccuracyReport) -> str:
    spread = _spread(report)
    if spread is None:
        return "Distribution of the check points: not known."
    counts = "/".join(str(n) for n in spread.quadrants)
    even = "even" if spread.is_even and spread.of_site else "not shown to be even"
    return f"Distribution of the check points by quadrant (NE/NW/SW/SE): {counts}, {even}."


def _control_line(report: AccuracyReport) -> str:
    control = report.survey.control_names
    if not control:
        return "Control points used in processing: none named."
    nearest = _nearest_control(report)
    apart = f"; nearest to a check point: {nearest:.1f} m" if math.isfinite(nearest) else ""
    return f"Control points used in processing, not counted as checks: {len(control)}{apart}."


def _seam_line(report: AccuracyReport) -> str:
    limit = _seam_limit(report)
    told = "not known" if limit is None else f"{_cm(limit)} cm"
    line = f"Seam mismatch of the mosaic: limit 2 x RMSE_H = {told}; found: "
    found = report.seams
    if found is None:
        return f"{line}____ (not measured)."
    meets = _seams_meet(report)
    verdict = "" if meets is None else ", met" if meets else ", NOT met"
    return (
        f"{line}{_cm(found.p90)} cm at the 90th percentile, {_cm(found.median)} cm in the median, "
        f"of {found.accepted} places where photos could be compared (of {found.places}){verdict}."
    )


def _distance_lines(report: AccuracyReport) -> Iterator[str]:
    """How well distances within the site are known, where an adjustment tells."""
    if report.distances:
        told = ", ".join(f"{_cm(sigma)} cm at {length:g} m" for length, sigma in report.distances)
        yield f"Distances within the site: one sigma {told} (by the adjustment, not tested)."


# -- JSON and metadata ---------------------------------------------------------------------------


def statement_json(report: AccuracyReport) -> dict[str, Any]:
    """Everything, JSON-able; m, what is not known is None."""
    flags = report_flags(report)
    survey, spread = report.survey, _spread(report)
    assessments = {a.kind: _assessment_json(a, flags[a.kind]) for a in report.assessments}
    out = {
        "format": FORMAT,
        "standard": STANDARD,
        "title": report.title,
        "statement": [sentence(c) for c in statement_components(report.main)],
        "assessments": assessments,
        "survey": {
            "datum": survey.datum,
            "product_datum": survey.product_datum,
            "heights": survey.heights,
            "crs": survey.crs,
            "control_points": list(survey.control_names),
            "nearest_control_m": _nearest_control(report),
            "extent_m": None if survey.extent is None else list(survey.extent),
            "distribution": None
            if spread is None
            else {**asdict(spread), "even": spread.is_even, "spaced": spread.is_spaced},
            "flags": [asdict(flag) for flag in flags["survey"]],
        },
        "seam_mismatch": {
            "limit_m": _seam_limit(report),
            "found_m": report.seams.p90 if report.seams else None,
            "median_m": report.seams.median if report.seams else None,
            "places": report.seams.accepted if report.seams else 0,
            "meets": _seams_meet(report),
        },
        "distances": [{"length_m": a, "sigma_m": sigma} for a, sigma in report.distances],
        "untested": dict(report.untested),
        "notes": list(report.notes),
    }
    return dict(_plain(out))


def _assessment_json(a: Assessment, flags: Sequence[Flag]) -> dict[str, Any]:
    axes = {**a.axes, **({"z_vegetated": a.vegetated} if a.vegetated else {})}
    return {
        "measured_on": a.measured_on,
        "class_h_m": a.targets.horizontal,
        "class_v_m": a.targets.vertical,
        "axes": {
            key: {
                **asdict(axis),
                "mean_share": axis.mean_share,
                "biased": axis.is_biased,
                "significant": axis.is_significant,
            }
            for key, axis in axes.items()
        },
        "components": [
            {
                **asdict(c),
                "rmse": c.rmse,
                "class_m": c.class_m,
                "class_declared": c.target is not None,
                "meets": c.meets,
                "case": c.case,
                **({} if a.kind == "intersections" else {"statement": sentence(c)}),
            }
            for c in a.components
        ],
        "flags": [asdict(flag) for flag in flags],
        "residuals": [asdict(r) for r in a.residuals],
    }


def statement_metadata(report: AccuracyReport) -> dict[str, str]:
    """Short keys and values of one line for the metadata of products, such as GeoTIFF items.

    A mean above 25 % of the target is in there, as the standard wants (7.2).
    """
    main = report.main
    out = {"ACCURACY_STANDARD": STANDARD}
    for c in statement_components(main):
        key = f"{c.name}_VEGETATED" if c.vegetated else c.name
        out[f"ACCURACY_STATEMENT_{key}"] = sentence(c)
        if not c.n:
            continue
        out[f"ACCURACY_RMSE_{key}_CM"] = _cm(c.rmse)
        out[f"ACCURACY_CHECK_POINTS_{key}"] = str(c.n)
        declared = "declared before the test" if c.target is not None else "derived from the test"
        out[f"ACCURACY_CLASS_{key}_CM"] = f"{_class_cm(c.class_m or math.nan)} ({declared})"
    for key, axis in main.axes.items():
        out[f"ACCURACY_RMSE_{key.upper()}_CM"] = _cm(axis.rmse)
        out[f"ACCURACY_MEAN_{key.upper()}_CM"] = f"{100 * axis.mean:+.1f}"
    flags = report_flags(report)
    told = [flag.text for flag in (*flags[main.kind], *flags["survey"])]
    if told:
        out["ACCURACY_NOTES"] = "; ".join(told)
    if any(c.n for c in main.components):
        out["ACCURACY_DATUM"] = (
            f"check points {report.survey.datum}, products {report.survey.product_datum}"
        )
    return out


def _spread(report: AccuracyReport) -> Any:
    xy = np.array([[r.x, r.y] for r in report.main.residuals]).reshape(-1, 2)
    return distribution(xy, report.survey.extent)


def _nearest_control(report: AccuracyReport) -> float:
    xy = np.array([[r.x, r.y] for r in report.main.residuals]).reshape(-1, 2)
    away = distance_to_control(xy[np.all(np.isfinite(xy), axis=1)], report.survey.control_map)
    return float(np.min(away, initial=math.inf))


def _seam_limit(report: AccuracyReport) -> float | None:
    """Twice the horizontal class, m; None where there is none."""
    class_m = report.main.component("H").class_m
    return None if class_m is None else SEAM * class_m


def _seams_meet(report: AccuracyReport) -> bool | None:
    """Whether nine of ten places lie within the limit; None where one of the two is not known."""
    limit = _seam_limit(report)
    return None if limit is None or report.seams is None else report.seams.p90 <= limit


def _cm(metres: float) -> str:
    """Length in cm: a tenth of one, a hundredth below 1 cm."""
    cm = 100.0 * metres
    return f"{cm:.2f}" if abs(cm) < 1.0 else f"{cm:.1f}"


def _class_cm(metres: float) -> str:
    """Class in cm, without zeros that nobody declared."""
    return f"{100.0 * metres:.10g}"


def _plain(value: Any) -> Any:
    """Value with lists for tuples and None for what is no finite number."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
