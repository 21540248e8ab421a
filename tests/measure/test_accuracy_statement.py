"""Wording, JSON, metadata and pictures of the statement."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest

from georef_gis.measure.accuracy.metadata import statement_json, statement_metadata
from georef_gis.measure.accuracy.plots import accuracy_pictures, histogram_figure, picture
from georef_gis.measure.accuracy.product import CheckResidual, Targets, assess
from georef_gis.measure.accuracy.report import AccuracyReport, SeamFinding, Survey
from georef_gis.measure.accuracy.sentences import STANDARD, sentence
from georef_gis.measure.accuracy.statement import statement_text


def report(
    n: int, targets: Targets | None = None, *, error: float = 0.02, **more: Any
) -> AccuracyReport:
    rng = np.random.default_rng(7)
    rows = [
        CheckResidual(
            name=f"P{i}", dx=x, dy=y, dz=z, sigma_h=0.005, sigma_v=0.005,
            x=float(rng.uniform(0, 100)), y=float(rng.uniform(0, 100)),
        )
        for i, (x, y, z) in enumerate(rng.normal(0, error, (n, 3)))
    ]  # fmt: skip
    survey = Survey(datum="NAD83(2011)@2010.0", product_datum="NAD83(2011)@2010.0",
                    extent=(0.0, 0.0, 100.0, 100.0))  # fmt: skip
    return AccuracyReport(
        title="Site", assessments=(assess(rows, targets, kind="products"),), survey=survey, **more
    )


DECLARED = Targets(horizontal=0.05, vertical=0.06)


def test_thirty_points_give_the_statement_of_a_test() -> None:
    h = report(30, DECLARED).main.component("H")
    assert sentence(h) == (
        f"This data set was tested to meet {STANDARD} for a 5 (cm) RMSE_H Horizontal Positional "
        "Accuracy Class. The tested horizontal positional accuracy was found to be RMSE_H = "
        f"{100 * h.rmse:.1f} (cm)."
    )


def test_fewer_points_give_the_reduced_statement_with_their_number() -> None:
    h, v, space = (report(29, DECLARED).main.component(c) for c in ("H", "V", "3D"))
    for c in (h, v, space):
        text = sentence(c)
        assert "was tested as required by ASPRS" in text
        assert "minimum of thirty (30) checkpoints" in text
        assert "using ONLY 29 checkpoints" in text
        assert "tested to meet" not in text
        assert text.endswith("using the reduced number of checkpoints.")
    assert "Non-Vegetated Vertical Accuracy (NVA)" in sentence(v)
    assert "RMSE_3D Three-Dimensional Positional Accuracy Class" in sentence(space)


def test_without_check_points_nothing_is_called_tested() -> None:
    told = report(0, DECLARED)
    text = statement_text(told)
    assert f"This data set was produced to meet {STANDARD} for a 5 (cm) RMSE_H" in text
    assert "Nothing was tested." in text
    assert "was tested" not in text.replace("Nothing was tested", "")
    assert "3D" not in text
    assert "no check point tests the horizontal accuracy" in text


def test_without_check_points_and_class_no_statement_is_made() -> None:
    text = statement_text(report(0))
    assert "No horizontal accuracy statement" in text
    assert "meet" not in text


@pytest.mark.parametrize("n", [10, 40])
def test_a_class_derived_afterwards_says_so(n: int) -> None:
    told = sentence(report(n).main.component("H"))
    assert told.endswith("No class was declared before the test: the class is derived from its "
                         "result.")  # fmt: skip


@pytest.mark.parametrize("n", [10, 40])
def test_a_class_that_is_missed_is_never_called_met(n: int) -> None:
    told = sentence(report(n, DECLARED, error=0.5).main.component("H"))
    assert "does NOT meet the declared" in told
    assert "tested to meet" not in told


def numbers(value: object) -> list[float]:
    """All numbers within lists and dicts."""
    if isinstance(value, dict):
        return [x for one in value.values() for x in numbers(one)]
    if isinstance(value, list):
        return [x for one in value for x in numbers(one)]
    return [value] if isinstance(value, float) else []


def test_no_figure_is_blown_up_to_95_percent() -> None:
    told = report(40, DECLARED)
    h, v = told.main.component("H").rmse, told.main.component("V").rmse
    found = np.array(numbers(statement_json(told)))
    for factored in (1.7308 * h, 2.4477 * h, 1.96 * v):
        assert np.abs(found - factored).min() > 1e-5
    # The figures that such factors would be put on are among them.
    assert np.abs(found - h).min() == 0.0


def test_intersections_get_figures_but_no_statement_of_a_product() -> None:
    products = report(5, DECLARED)
    crossed = assess(products.main.residuals, DECLARED, kind="intersections")
    both = AccuracyReport(title="Site", assessments=(crossed, *products.assessments))
    assert both.main.kind == "products"
    told = statement_json(both)
    assert "statement" not in told["assessments"]["intersections"]["components"][0]
    assert "statement" in told["assessments"]["products"]["components"][0]
    assert "Space intersections" in statement_text(both)


def test_json_holds_everything_and_is_valid() -> None:
    rows = [CheckResidual(name="A", dx=0.1, dy=0.0), CheckResidual(name="B", dz=0.2)]
    told = statement_json(AccuracyReport(title="T", assessments=(assess(rows),)))
    again = json.loads(json.dumps(told, allow_nan=False))
    assert again["assessments"]["table"]["residuals"][0]["dz"] is None
    assert again["assessments"]["table"]["axes"]["x"]["n"] == 1
    assert again["seam_mismatch"] == {
        "limit_m": pytest.approx(0.2), "found_m": None, "median_m": None, "places": 0,
        "meets": None,
    }  # fmt: skip
    codes = {flag["code"] for flag in again["survey"]["flags"]}
    assert {"distribution_unknown", "datum_unknown"} <= codes


@pytest.mark.parametrize(("p90", "meets"), [(0.19, True), (0.21, False)])
def test_measured_seams_are_held_against_the_limit(p90: float, meets: bool) -> None:
    rows = [CheckResidual(name="A", dx=0.1, dy=0.0), CheckResidual(name="B", dz=0.2)]
    seams = SeamFinding(places=120, accepted=90, median=0.02, p90=p90)
    report = AccuracyReport(title="T", assessments=(assess(rows),), seams=seams)
    assert statement_json(report)["seam_mismatch"]["meets"] is meets
    line = next(row for row in statement_text(report).splitlines() if "Seam mismatch" in row)
    assert f"{100 * p90:.1f} cm" in line
    assert "90 places" in line
    assert ("NOT met" in line) is not meets


def test_metadata_is_short_lines_with_the_bias_in_them() -> None:
    rows = [CheckResidual(name=f"P{i}", dx=0.05 + 1e-3 * (i % 3), dy=0.0) for i in range(6)]
    told = statement_metadata(AccuracyReport(title="T", assessments=(assess(rows),)))
    assert told["ACCURACY_CHECK_POINTS_H"] == "6"
    assert told["ACCURACY_MEAN_X_CM"] == "+5.1"
    assert "mean error in X" in told["ACCURACY_NOTES"]
    assert all("\n" not in value and isinstance(value, str) for value in told.values())
    assert all(len(key) <= 40 for key in told)


def test_distances_within_the_site_are_one_line_where_an_adjustment_tells() -> None:
    told = report(5, distances=((10.0, 0.012), (50.0, 0.034)))
    (line,) = [line for line in statement_text(told).splitlines() if line.startswith("Distances")]
    assert line == (
        "Distances within the site: one sigma 1.2 cm at 10 m, 3.4 cm at 50 m (by the adjustment, "
        "not tested)."
    )
    assert statement_json(told)["distances"][1] == {"length_m": 50.0, "sigma_m": 0.034}
    assert "Distances" not in statement_text(report(5))


def test_points_that_could_not_be_read_are_named() -> None:
    text = statement_text(report(3, untested={"Z9": "in the mosaic its neighbourhood is bland"}))
    assert "Z9 (in the mosaic its neighbourhood is bland)" in text


def test_pictures_are_drawn_for_what_was_tested() -> None:
    files = accuracy_pictures(report(12, DECLARED))
    assert set(files) == {f"accuracy_{kind}_products.png" for kind in
                          ("histogram", "scatter", "vectors")}  # fmt: skip
    for name, content in files.items():
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None, name
        assert np.ptp(image) == 255
    assert accuracy_pictures(report(0)) == {}


def test_histogram_counts_every_point_once() -> None:
    figure = histogram_figure(report(25).main)
    for panel in figure.axes:
        assert sum(patch.get_height() for patch in panel.patches) == 25


def test_a_picture_can_be_had_as_svg_without_a_date() -> None:
    drawn = picture(histogram_figure(report(5).main), "svg")
    assert b"<svg" in drawn
    assert b"<dc:date>" not in drawn
