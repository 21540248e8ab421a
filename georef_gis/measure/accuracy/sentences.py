"""The standard's sentences about a tested component, and how lengths are written in them."""

from __future__ import annotations

from georef_gis.measure.accuracy.product import Assessment, Component

STANDARD = (
    "ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, Version 2 (2024)"
)
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


def sentence(c: Component) -> str:
    """The standard's statement (7.16) for a component, or what can be said in its place."""
    what = "VVA" if c.vegetated else c.name
    if c.case == "none" or c.class_m is None:
        axis = {"H": "horizontal", "V": "vertical", "3D": "three-dimensional"}[c.name]
        why = "" if c.name == "3D" else " and no class was declared"
        return f"No {axis} accuracy statement: there are no check points{why}."
    cls = f"{class_in_cm(c.class_m)} (cm)"
    if c.case == "produced":
        return f"This data set was produced to meet {STANDARD} for a {cls} {_PRODUCED[c.name]}."
    found = _FOUND[what].format(found=in_cm(c.rmse))
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


def in_cm(metres: float) -> str:
    """Length in cm: a tenth of one, a hundredth below 1 cm."""
    cm = 100.0 * metres
    return f"{cm:.2f}" if abs(cm) < 1.0 else f"{cm:.1f}"


def class_in_cm(metres: float) -> str:
    """Class in cm, without zeros that nobody declared."""
    return f"{100.0 * metres:.10g}"
