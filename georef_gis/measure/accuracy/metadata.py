"""The accuracy statement for machines: everything as JSON, short items for products."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from georef_gis.measure.accuracy.checks import Flag
from georef_gis.measure.accuracy.product import Assessment
from georef_gis.measure.accuracy.report import AccuracyReport, report_flags
from georef_gis.measure.accuracy.sentences import (
    STANDARD,
    class_in_cm,
    in_cm,
    sentence,
    statement_components,
)

FORMAT = "georef_gis accuracy 1"


def statement_json(report: AccuracyReport) -> dict[str, Any]:
    """Everything, JSON-able; m, what is not known is None."""
    flags = report_flags(report)
    survey, spread = report.survey, report.spread
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
            "nearest_control_m": report.nearest_control,
            "extent_m": None if survey.extent is None else list(survey.extent),
            "distribution": None
            if spread is None
            else {**asdict(spread), "even": spread.is_even, "spaced": spread.is_spaced},
            "flags": [asdict(flag) for flag in flags["survey"]],
        },
        "seam_mismatch": {
            "limit_m": report.seam_limit,
            "found_m": report.seams.p90 if report.seams else None,
            "median_m": report.seams.median if report.seams else None,
            "places": report.seams.accepted if report.seams else 0,
            "meets": report.seams_meet,
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
        out[f"ACCURACY_RMSE_{key}_CM"] = in_cm(c.rmse)
        out[f"ACCURACY_CHECK_POINTS_{key}"] = str(c.n)
        declared = "declared before the test" if c.target is not None else "derived from the test"
        out[f"ACCURACY_CLASS_{key}_CM"] = f"{class_in_cm(c.class_m or math.nan)} ({declared})"
    for key, axis in main.axes.items():
        out[f"ACCURACY_RMSE_{key.upper()}_CM"] = in_cm(axis.rmse)
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


def _plain(value: Any) -> Any:
    """Value with lists for tuples and None for what is no finite number."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
