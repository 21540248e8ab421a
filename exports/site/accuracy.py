"""The accuracy statement of a project as short items for the metadata of exported files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from georef_gis.errors import ExportError

# As the tool `accuracy` writes it among the products.
STATEMENT = "accuracy.json"
FORMAT = "georef_gis accuracy 1"

T = TypeVar("T")


def items_of_file(path: Path) -> dict[str, str]:
    """Items of the statement in a file.

    Raises
    ------
    ExportError
        If it cannot be read.
    """
    return read_statement(path, accuracy_items)


def read_statement(path: Path, take: Callable[[Mapping[str, Any]], T]) -> T:
    """What is taken from the statement in a file.

    Raises
    ------
    ExportError
        If it cannot be read, or lacks what is taken.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ExportError(f"{path}: is of format {data['format']!r}; run `georef accuracy`")
        return take(data)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ExportError(f"{path}: cannot be read ({error}); run `georef accuracy`") from error


def main_assessment(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The assessment that speaks for the products: space intersections alone are no data set."""
    assessments: Mapping[str, Any] = data["assessments"]
    kinds = [kind for kind in assessments if kind != "intersections"] or list(assessments)
    main: Mapping[str, Any] = assessments[kinds[0]]
    return main


def accuracy_items(data: Mapping[str, Any]) -> dict[str, str]:
    """Short keys and values of one line, as the statement of the products has them."""
    main = main_assessment(data)
    out = {"ACCURACY_STANDARD": str(data["standard"])}
    for c in main["components"]:
        # space intersections are no data set: no statement is made of them
        if "statement" not in c or not (c["n"] or (c["name"] != "3D" and not c["vegetated"])):
            continue
        key = f"{c['name']}_VEGETATED" if c["vegetated"] else c["name"]
        out[f"ACCURACY_STATEMENT_{key}"] = c["statement"]
        if c["n"]:
            declared = (
                "declared before the test" if c["class_declared"] else "derived from the test"
            )
            out[f"ACCURACY_RMSE_{key}_CM"] = _cm(c["rmse"])
            out[f"ACCURACY_CHECK_POINTS_{key}"] = str(c["n"])
            out[f"ACCURACY_CLASS_{key}_CM"] = f"{100.0 * c['class_m']:.10g} ({declared})"
    for key, axis in main["axes"].items():
        if key != "z_vegetated":
            out[f"ACCURACY_RMSE_{key.upper()}_CM"] = _cm(axis["rmse"])
            out[f"ACCURACY_MEAN_{key.upper()}_CM"] = f"{100 * axis['mean']:+.1f}"
    survey = data["survey"]
    told = [flag["text"] for flag in (*main["flags"], *survey["flags"])]
    if told:
        out["ACCURACY_NOTES"] = "; ".join(told)
    if any(c["n"] for c in main["components"]):
        out["ACCURACY_DATUM"] = (
            f"check points {survey['datum']}, products {survey['product_datum']}"
        )
    return out


def _cm(metres: float) -> str:
    """Length in cm: a tenth of one, a hundredth below 1 cm."""
    cm = 100.0 * metres
    return f"{cm:.2f}" if abs(cm) < 1.0 else f"{cm:.1f}"
