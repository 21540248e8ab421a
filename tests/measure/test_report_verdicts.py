"""The verdicts of the report page notice what was planted, and pass what is sound."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from report_cases import CAMERA, adjusted_facts, matches, pose, project_facts, unknown

from georef_gis.measure.report.adjustment_section import (
    adjustment_items,
    navigation_items,
    turns_of,
)
from georef_gis.measure.report.camera_section import (
    camera_items,
    displacement,
    distortion,
    flight_items,
    observability_items,
)
from georef_gis.measure.report.control_section import accuracy_items, control_items, normalised
from georef_gis.measure.report.doubts_section import doubt_items
from georef_gis.measure.report.draw import metres, number, round_length
from georef_gis.measure.report.facts import Accuracy, Facts, Heights
from georef_gis.measure.report.ground_section import ground_items, hillshade
from georef_gis.measure.report.page import Item, Picture, Table, Text, Verdict
from georef_gis.measure.report.residual_pictures import (
    by_photo,
    by_place,
    cell_means,
    histogram,
    image_grid,
    systematic_part,
)
from georef_gis.measure.report.runs_section import runs_items
from georef_gis.measure.report.site_section import overlap_item, picture_of, summary_section
from georef_gis.measure.report.tie_section import tie_items
from georef_gis.project.geometry import point_wkb
from georef_gis.rasters.preview import Preview

# verdicts, not pictures
pytestmark = pytest.mark.usefixtures("pictures_undrawn")


def verdict(items: list[Item], title: str) -> Verdict:
    """Verdict of the item whose title begins so."""
    found = [
        i for i in items if isinstance(i, Picture | Table | Text) and i.title.startswith(title)
    ]
    assert found, title
    assert found[0].verdict is not None
    return found[0].verdict


def changed(facts: Facts, **report: Any) -> Facts:
    assert facts.adjustment is not None
    adjustment = replace(facts.adjustment, report={**facts.adjustment.report, **report})
    return replace(facts, adjustment=adjustment)


# -- residuals -----------------------------------------------------------------------------------


def test_noise_alone_has_no_systematic_part() -> None:
    facts = adjusted_facts(8, each=2000)
    r = facts.adjustment.residuals if facts.adjustment else None
    assert r is not None
    mean, error, count, _ = cell_means(r.uv, r.residual, (4000.0, 3000.0))
    assert count.sum() == 16000
    # 0.5 px over 148 observations a cell: 0.04 px of scatter, of which less than half may stay
    assert systematic_part(mean, error) < 0.02
    assert image_grid(r.uv, r.residual, (4000.0, 3000.0), "cam").verdict.level == "fine"


def test_a_wrong_lens_shows_as_systematic() -> None:
    facts = adjusted_facts(8, each=2000)
    r = facts.adjustment.residuals if facts.adjustment else None
    assert r is not None
    away = (r.uv - [1999.5, 1499.5]) / 2500.0
    planted = 2.0 * away * np.sum(away**2, axis=1, keepdims=True)
    mean, error, _, _ = cell_means(r.uv, r.residual + planted, (4000.0, 3000.0))
    truth = float(np.sqrt(np.mean(planted**2)))
    # cells are 333 px wide, over which the planted pattern changes by some 10 %
    assert systematic_part(mean, error) == pytest.approx(truth, rel=0.1)
    found = image_grid(r.uv, r.residual + planted, (4000.0, 3000.0), "cam").verdict
    assert found.level in ("look", "bad")


def test_cells_are_where_their_pixels_are() -> None:
    uv = np.array([[0.0, 0.0], [3999.0, 2999.0]])
    _, _, count, centre = cell_means(np.repeat(uv, 9, axis=0), np.ones((18, 2)), (4000.0, 3000.0))
    assert count[0] == count[-1] == 9
    assert centre[0] == pytest.approx([4000 / 24 - 0.5, 3000 / 18 - 0.5])


def test_wild_residuals_are_told() -> None:
    r = adjusted_facts().adjustment.residuals  # type: ignore[union-attr]
    assert r is not None
    assert histogram(r).verdict.level == "fine"
    wild = r.residual.copy()
    wild[::8] *= 30.0
    assert histogram(replace(r, residual=wild)).verdict.level == "look"
    assert histogram(replace(r, residual=r.residual + 0.4)).verdict.level == "look"


def test_a_photo_that_does_not_fit_and_one_without_ties_are_named() -> None:
    facts = adjusted_facts(6)
    assert facts.adjustment is not None
    assert by_photo(facts.adjustment).verdict.level == "fine"
    rows = [dict(row) for row in facts.adjustment.report["photos"]]
    rows[2]["rms_px"], rows[4]["rms_px"], rows[4]["observations"] = 1.6, None, 0
    there = changed(facts, photos=rows).adjustment
    assert there is not None
    found = by_photo(there).verdict
    assert found.level == "look"
    assert "P002" in found.text
    assert "P004" in found.text


def test_a_bad_part_of_the_site_is_told() -> None:
    facts = adjusted_facts(6)
    assert facts.adjustment is not None
    assert by_place(facts, facts.adjustment).verdict.level == "fine"
    px = facts.adjustment.points_px.copy()
    px[facts.adjustment.points_enu[:, 0] > 60.0] *= 4.0
    there = replace(facts.adjustment, points_px=px)
    assert by_place(facts, there).verdict.level != "fine"


# -- ties and overlap ------------------------------------------------------------------------------


def test_a_photo_that_shares_nothing_is_marked() -> None:
    facts = adjusted_facts(6)
    assert verdict(tie_items(facts), "Tie map").level == "fine"
    alone = replace(facts, matches=matches(list(facts.direct), broken=["P003"]))
    found = verdict(tie_items(alone), "Tie map")
    assert found.level == "look"
    assert "not tied: P003" in found.text


def test_two_groups_are_told() -> None:
    facts = adjusted_facts(6)
    ids = list(facts.direct)
    two = {**matches(ids), "components": [ids[:3], ids[3:]]}
    found = verdict(tie_items(replace(facts, matches=two)), "Tie map")
    assert found.level == "look"
    assert "2 groups" in found.text


def test_turned_photos_are_listed_with_their_evidence() -> None:
    facts = adjusted_facts(4)
    turns = {
        "P001": {"quarter_deg": 180, "correct": False, "yaw": 0.0, "evidence": "8 pairs"},
        "P002": {"quarter_deg": 0, "correct": True, "yaw": math.radians(12.0), "evidence": "x"},
        "P003": {"quarter_deg": 0, "correct": False, "yaw": 0.1, "evidence": "small"},
    }
    items = tie_items(replace(facts, matches={**facts.matches, "turns": turns}))  # type: ignore[dict-item]
    (table,) = [i for i in items if isinstance(i, Table)]
    assert [row[0] for row in table.rows] == ["P001", "P002"]
    assert table.rows[0][1:] == ("picture turned by 180 deg", "8 pairs")
    assert table.rows[1][1] == "heading +12.0 deg"


def overlap(counts: np.ndarray[Any, Any]) -> Preview:
    values = counts.astype(np.uint16)[..., None]
    transform = (1.0, 0.0, 300000.0, 0.0, -1.0, 4400000.0)
    return Preview(values=values, valid=counts > 0, transform=transform)


@pytest.mark.parametrize(("times", "level"), [(4, "fine"), (2, "look")])
def test_overlap_is_judged_by_what_three_photos_show(times: int, level: str) -> None:
    item = overlap_item(project_facts(overlap=overlap(np.full((40, 60), times))))
    assert isinstance(item, Picture)
    assert item.verdict.level == level


def test_holes_amid_the_flight_are_told() -> None:
    run = {"tool": "georef:footprints", "summary": {"holes": 2}, "outcome": "done",
           "warnings": []}  # fmt: skip
    item = overlap_item(project_facts(overlap=overlap(np.full((40, 60), 5)), runs=[run]))
    assert isinstance(item, Picture)
    assert item.verdict.level == "look"
    assert "2 holes" in item.verdict.text


def test_other_depths_than_8_bits_are_stretched_and_missing_pixels_clear() -> None:
    values = np.linspace(1000, 3000, 400).reshape(20, 20, 1).astype(np.uint16)
    valid = np.ones((20, 20), bool)
    valid[:5] = False
    rgba = picture_of(Preview(values=values, valid=valid, transform=(1, 0, 0, 0, -1, 0)))
    assert rgba.shape == (20, 20, 4)
    assert rgba[:5, :, 3].max() == 0
    assert rgba[19, 19, 0] == 255
    assert rgba[5, 0, 0] < 5


# -- summary, warnings, runs -----------------------------------------------------------------------


def test_doubtful_photos_and_failed_runs_are_told() -> None:
    runs = [
        {"tool": "georef:adjust", "summary": {"doubts": ["a doubt"]}, "outcome": "done",
         "warnings": ["a doubt", "a warning"], "message": None, "fid": 1, "started": "2026",
         "duration_s": 1.0, "parameters": {"calibrate": True, "x": None}, "versions": {}},
        {"tool": "georef:mosaic", "summary": None, "outcome": "failed", "warnings": None,
         "message": "disk full", "fid": 2, "started": "2026", "duration_s": None,
         "parameters": None, "versions": None},
    ]  # fmt: skip
    facts = project_facts(runs=runs, doubtful={"P001": ["blurred"]})
    section = summary_section(facts)
    assert verdict(section.items, "Summary").level == "bad"
    (doubts,) = doubt_items(facts, None)
    assert isinstance(doubts, Table)
    assert list(doubts.rows) == [
        ("tool", "adjust", "a doubt"),
        ("tool", "adjust", "a warning"),
        ("tool", "mosaic", "failed: disk full"),
        ("photo", "P001", "blurred"),
    ]
    assert verdict([doubts], "All doubts").level == "bad"
    (table,) = runs_items(facts, "report")
    assert isinstance(table, Table)
    assert table.rows[0][1] == "1"
    assert table.rows[0][5] == "calibrate = true"
    assert verdict([table], "Last runs").level == "look"


# -- adjustment and navigation ---------------------------------------------------------------------


def test_a_failed_check_is_not_good_and_a_far_one_asks_for_a_look() -> None:
    facts = adjusted_facts()
    assert verdict(adjustment_items(facts), "Checks").level == "fine"
    check = {"name": "scale", "value": 1.04, "expected": 1.0, "sigma": 0.01, "unit": "",
             "passed": True}  # fmt: skip
    far = verdict(adjustment_items(changed(facts, checks=[check])), "Checks")
    assert far.level == "look"
    failed = verdict(
        adjustment_items(changed(facts, checks=[{**check, "passed": False}])), "Checks"
    )
    assert failed.level == "bad"


@pytest.mark.parametrize(
    ("sigma0", "converged", "level"),
    [(0.4, True, "fine"), (1.2, True, "fine"), (2.5, True, "look"), (1.0, False, "look"),
     (9.0, True, "bad")],
)  # fmt: skip
def test_sigma0_and_the_search_are_judged(sigma0: float, converged: bool, level: str) -> None:
    facts = changed(adjusted_facts(), sigma0=sigma0, converged=converged)
    assert verdict(adjustment_items(facts), "Adjustment").level == level


def test_an_adjustment_that_was_not_used_says_so() -> None:
    run = {"tool": "georef:adjust", "outcome": "done", "summary": {"used": False}, "message": ""}
    (text,) = adjustment_items(project_facts(runs=[run]))
    assert "was not used" in str(text)
    assert verdict([text], "No adjustment").level == "bad"


def test_photos_that_are_not_adjusted_ask_for_a_look_and_quick_ones_do_not() -> None:
    (never,) = adjustment_items(project_facts())
    assert verdict([never], "No adjustment").level == "look"
    assert "1.41 m" in verdict([never], "No adjustment").text
    (match,) = adjustment_items(
        project_facts(runs=[{"tool": "georef:match", "outcome": "failed", "message": "no disk"}])
    )
    assert "no disk" in verdict([match], "No adjustment").text
    for facts in (project_facts(quick=True), project_facts(1)):
        assert verdict(adjustment_items(facts), "No adjustment").level == "told"


def test_a_whole_mosaic_of_photos_that_are_not_adjusted_is_not_fine() -> None:
    mosaic = Preview(
        values=np.full((60, 140, 3), 200, np.uint8), valid=np.ones((60, 140), bool),
        transform=(1.0, 0.0, 300000.0, 0.0, -1.0, 4400000.0),
    )  # fmt: skip
    covered: dict[str, Any] = {
        "tool": "georef:footprints", "summary": {"covered_m2": 8400.0}, "outcome": "done",
        "warnings": [], "message": None, "fid": 1,
    }  # fmt: skip
    alone = replace(project_facts(runs=[covered]), mosaic=mosaic)
    told = verdict(summary_section(alone).items, "Map")
    assert told.level == "look"
    assert "at the seams" in told.text
    joined = replace(adjusted_facts(), runs=[covered], mosaic=mosaic)
    assert verdict(summary_section(joined).items, "Map").level == "fine"


def test_turns_leave_out_what_an_editor_turned() -> None:
    facts = project_facts(2)
    small = [0.0, 0.0, math.radians(3.0)]
    adjusted = {
        "P000": pose(0.0, 0.0, turn=small, kind="adjusted"),
        "P001": pose(20.0, 0.0, turn=[0.0, 0.0, math.radians(183.0)], kind="adjusted"),
    }
    turned = {"direct": {}, "adjusted": {"P001": 180}}
    found = turns_of(replace(facts, adjusted=adjusted, turned=turned))
    assert found["P000"] == pytest.approx(small, abs=1e-12)
    assert found["P001"] == pytest.approx(small, abs=1e-9)


@pytest.mark.parametrize("side", [1, -1])
def test_quarter_turns_of_either_side_are_left_out(side: int) -> None:
    facts = project_facts(1)
    adjusted = {"P000": pose(0.0, 0.0, turn=[0.0, 0.0, side * math.pi / 2], kind="adjusted")}
    turned = {"direct": {}, "adjusted": {"P000": 90}}
    found = turns_of(replace(facts, adjusted=adjusted, turned=turned))
    assert np.linalg.norm(found["P000"]) < 1e-9


def test_poses_far_from_their_direct_ones_are_told() -> None:
    facts = adjusted_facts(6)
    assert verdict(navigation_items(facts), "Adjusted less").level == "fine"
    moved = {
        key: pose(20.0 * i + 4.0, 4.0, turn=[0.06, 0.06, 0.06], kind="adjusted")
        for i, key in enumerate(facts.direct)
    }
    found = verdict(navigation_items(replace(facts, adjusted=moved)), "Adjusted less")
    assert found.level == "bad"


# -- cameras -------------------------------------------------------------------------------------


def test_displacement_is_brown_conrady_s() -> None:
    camera = replace(CAMERA, k1=-0.1, k2=0.02, k3=-0.003)
    radius = np.array([100.0, 1000.0, 2400.0])
    x = radius / 2500.0
    # written out anew: x (1 + k1 r2 + k2 r4 + k3 r6), in px
    truth = radius * (-0.1 * x**2 + 0.02 * x**4 - 0.003 * x**6)
    assert displacement(camera, radius) == pytest.approx(truth, abs=1e-9)


def test_a_lens_that_turns_back_is_not_good() -> None:
    assert distortion(CAMERA, replace(CAMERA, k1=-0.05)).verdict.level == "fine"
    assert distortion(CAMERA, replace(CAMERA, k1=-0.6)).verdict.level == "bad"
    # r (1 - 0.25 x2) is largest at x = 1.15, 1925 px: the corner at 2500 px is not reached
    assert distortion(CAMERA, replace(CAMERA, k1=-0.25)).verdict.level == "bad"
    assert distortion(CAMERA, replace(CAMERA, k1=0.3)).verdict.level == "fine"


def test_a_camera_far_from_its_prior_is_told() -> None:
    facts = adjusted_facts()
    new = replace(CAMERA, id="cam adjusted", fx=2600.0, fy=2600.0)
    row = {
        "camera_id": "cam adjusted", "parameters": new.parameters.tolist(), "readout_s": 0.0,
        "covariance": np.diag(np.full(11, 0.25)).tolist(), "source": "", "extra":
        {"adjusted_of": "cam"},
    }  # fmt: skip
    facts = replace(
        facts, cameras={**facts.cameras, "cam adjusted": new},
        camera_rows=[*facts.camera_rows, row],
    )  # fmt: skip
    seen = facts.adjustment.report["observability"]  # type: ignore[union-attr]
    far = {**seen, "unknowns": [unknown("cam f", 100.0, 0.5, 25.0), seen["unknowns"][1]]}
    table = camera_items(changed(facts, observability=far))[0]
    assert isinstance(table, Table)
    assert verdict([table], "Camera").level == "look"
    assert table.rows[0][:6] == ("fx", "2500.00", "25.00", "2600.00", "0.50", "+4.0")


def test_what_cannot_be_told_apart_between_camera_and_flight_is_told() -> None:
    facts = adjusted_facts()
    assert verdict(observability_items(facts), "Correlations").level == "fine"
    seen = facts.adjustment.report["observability"]  # type: ignore[union-attr]
    mixed = {**seen, "correlation": [[1.0, -0.97], [-0.97, 1.0]],
             "badly_separated": [["cam f", "flight clock", -0.97]]}  # fmt: skip
    found = verdict(observability_items(changed(facts, observability=mixed)), "Correlations")
    assert found.level == "look"
    assert "camera f and flight clock (-0.97)" in found.text
    inside = {**mixed, "badly_separated": [["cam k1", "cam k2", -0.97]]}
    same = verdict(observability_items(changed(facts, observability=inside)), "Correlations")
    assert same.level == "fine"


def test_values_of_a_flight_come_in_degrees_and_milliseconds() -> None:
    names = ["lever_x", "lever_y", "lever_z", "boresight_x", "boresight_y", "boresight_z",
             "bias_e", "bias_n", "bias_u", "clock"]  # fmt: skip
    flight = {
        "flight_id": "flight", "boresight": [math.radians(0.5), 0.0, 0.0],
        "bias_enu": [0.0, 0.0, 1.5], "clock_offset_s": 0.0125,
        "extra": {"names": names, "lever_arm_step_m": [0.0] * 3,
                  "covariance": np.diag([1e-4] * 3 + [1e-6] * 3 + [1.0] * 3 + [1e-6]).tolist()},
    }  # fmt: skip
    facts = adjusted_facts()
    seen = {**facts.adjustment.report["observability"]}  # type: ignore[union-attr]
    seen["unknowns"] = [
        unknown("flight clock", 0.0125, 0.001, 0.003),
        unknown("flight boresight_x", 0.0087, 0.001, 0.02),
    ]
    (table,) = flight_items(replace(changed(facts, observability=seen), flights=[flight]))
    assert isinstance(table, Table)
    rows = {row[0]: row for row in table.rows}
    assert rows["flight boresight_x"][1] == "+0.500 deg"
    assert rows["flight clock"][1:3] == ("+12.5 ms", "1.0 ms")
    # 12.5 ms of 3 ms
    assert verdict([table], "Mount").level == "look"


# -- ground ----------------------------------------------------------------------------------------


def test_light_comes_from_the_north_west() -> None:
    y, x = np.mgrid[0:20, 0:20].astype(float)
    to_north_west, to_south_east = y + x, -(y + x)
    assert hillshade(to_north_west, (1.0, 1.0))[10, 10] > 0.95
    assert hillshade(to_south_east, (1.0, 1.0))[10, 10] < 0.3
    level = hillshade(np.zeros((20, 20)), (1.0, 1.0))
    assert level[10, 10] == pytest.approx(math.sin(math.radians(45.0)))


def heights(z: np.ndarray[Any, Any]) -> Heights:
    rows, cols = z.shape
    return Heights(z=z, seen=np.ones(z.shape, bool), sigma=None, extent=(0, cols, 0, rows))


def test_pits_in_the_ground_are_told() -> None:
    y, x = np.mgrid[0:60, 0:80].astype(float)
    smooth = 100.0 + 0.05 * x + np.sin(y / 10.0)
    assert verdict(ground_items(project_facts(), heights(smooth)), "Relief").level == "fine"
    pits = smooth.copy()
    pits[10:60:10, 10:80:10] -= 12.0
    assert verdict(ground_items(project_facts(), heights(pits)), "Relief").level != "fine"


def test_level_ground_has_no_picture() -> None:
    items = ground_items(project_facts(), heights(np.full((30, 40), 5.0)))
    assert not [item for item in items if isinstance(item, Picture)]
    assert "level" in str(items[-1])


@pytest.mark.parametrize(("miss", "level"), [(0.05, "fine"), (0.5, "look"), (None, "look")])
def test_the_surface_is_judged_by_points_held_out(miss: float | None, level: str) -> None:
    ground: dict[str, Any] = {"used": 95, "points": 100, "blunders": 5, "rms_held_out_m": miss,
              "rms_tin_m": miss, "rms_plane_m": 1.0, "notes": []}  # fmt: skip
    facts = changed(adjusted_facts(), ground=ground)
    assert verdict(ground_items(facts, None), "Ground").level == level


# -- control and accuracy --------------------------------------------------------------------------


def with_points(off: list[list[float]], role: str = "check") -> Facts:
    facts = adjusted_facts(6)
    rows, control = [], []
    for i, one in enumerate(off):
        x, y = facts.corner + np.array([20.0 + 15.0 * i, 20.0 + 5.0 * (i % 3)])
        control.append({"name": f"C{i}", "role": role, "sigma_h_m": 0.02, "sigma_v_m": 0.02,
                        "geom": point_wkb(float(x), float(y), 100.0)})  # fmt: skip
        rows.append({"name": f"C{i}", "role": role, "off_m": one, "sigma_m": [0.02] * 3,
                     "survey_sigma_m": [0.02] * 3, "rays": 5, "rms_px": 0.4})  # fmt: skip
    return replace(changed(facts, control=rows), control=control)


def test_points_are_judged_by_their_sigmas() -> None:
    good = [[0.02, -0.02, 0.01], [-0.03, 0.01, 0.0], [0.01, 0.02, -0.02], [0.0, -0.01, 0.01]]
    items = control_items(with_points(good))
    assert verdict(items, "Points").level == "fine"
    assert verdict(items, "Points: adjusted").level == "fine"
    items = control_items(with_points([*good[:3], [0.5, 0.0, 0.0]]))
    assert verdict(items, "Points").level == "look"
    assert "C3" in verdict(items, "Points").text


def test_points_that_lean_one_way_are_told() -> None:
    lean = [[0.030, 0.0, 0.0], [0.032, 0.001, 0.0], [0.028, -0.001, 0.0], [0.031, 0.0, 0.0]]
    found = verdict(control_items(with_points(lean)), "Points: adjusted")
    assert found.level == "look"
    assert "more than chance" in found.text


def test_sigmas_of_a_point_without_height_are_those_of_the_plane() -> None:
    row = {"off_m": [0.03, 0.0, None], "sigma_m": [0.03, 0.03, 0.1],
           "survey_sigma_m": [0.04, 0.04, None]}  # fmt: skip
    assert normalised(row) == pytest.approx(0.6)


def test_control_points_alone_test_nothing() -> None:
    items = control_items(with_points([[0.01, 0.0, 0.0], [0.0, 0.01, 0.0]], role="control"))
    found = verdict(items, "Points: adjusted")
    assert found.level == "told"
    assert "no check point" in found.text


def test_remarks_of_the_statement_ask_for_a_look() -> None:
    def judged_by(**component: Any) -> list[Item]:
        base = {"name": "H", "n": 30, "rmse": 0.03, "fit": 0.03, "survey": 0.01, "target": 0.05,
                "meets": True}  # fmt: skip
        values = {"assessments": {"products": {
            "components": [{**base, **component}], "flags": [], "axes": {}}}}  # fmt: skip
        return accuracy_items(
            project_facts(accuracy=Accuracy(text="The statement", values=values, pictures={}))
        )

    assert verdict(judged_by(), "RMSE of the products").level == "fine"
    assert verdict(judged_by(meets=False), "RMSE of the products").level == "bad"
    assert "The statement" in str(judged_by()[-1])


# -- numbers ---------------------------------------------------------------------------------------


def test_numbers_read_well() -> None:
    assert [metres(v) for v in (0.0123, 0.9949, 1.2, 12345.6)] == [
        "1.2 cm", "99.5 cm", "1.20 m", "12346 m",
    ]  # fmt: skip
    assert metres(-0.00001, sign=True) == "+0.0 cm"
    assert metres(None) == metres(math.nan) == number(None) == "-"
    assert number(-0.0001) == "0.00"
    assert [round_length(v) for v in (37.0, 0.9, 0.0, 2.5)] == [25.0, 0.5, 1.0, 2.5]
