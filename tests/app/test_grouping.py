"""Doubts about many photos become one line, on the terminal once."""

import re
from pathlib import Path

import pytest

from georef_gis.app.feedback import PlainFeedback, Stop
from georef_gis.app.grouping import grouped
from georef_gis.app.report import run_lines, tool_lines
from georef_gis.toolbox import Result
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.steps import StepReport

TURNED = 'may be turned; set [attitude] rotate_photos = {{"{0}" = 180}}'


def test_lines_that_differ_in_the_name_are_one() -> None:
    names = [f"DJI_{i:04d}.JPG" for i in range(24, 30)]
    lines = grouped([f"{name}: {TURNED.format(name)}" for name in names])
    assert lines == ["6 photos (DJI_0024.JPG ... DJI_0029.JPG): " + TURNED.format("DJI_0024.JPG")]


def test_single_line_is_left_as_it_is() -> None:
    line = "photo IMG_1: taken -2.1 m above the ground: left out"
    assert grouped([line, line]) == [line]


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (("a.jpg", "b.jpg"), "2 photos (a.jpg, b.jpg)"),
        (("a.jpg", "b.jpg", "c.jpg", "d.jpg"), "4 photos (a.jpg, b.jpg, c.jpg and 1 more)"),
        (("I_1", "I_2", "I_4", "I_9"), "4 photos (I_1, I_2, I_4 and 1 more)"),
        (("I_09", "I_10", "I_11", "I_12"), "4 photos (I_09 ... I_12)"),
        (("/x/a.jpg", "/x/b.jpg"), "2 photos (a.jpg, b.jpg)"),
    ],
)
def test_names_are_few_or_a_span(names: tuple[str, ...], shown: str) -> None:
    assert grouped([f"{name}: no heading" for name in names]) == [f"{shown}: no heading"]


def test_figures_become_a_range() -> None:
    lines = grouped(
        ["a: course 71 deg, -3.5 m", "b: course 9 deg, -3.5 m", "c: course 80 deg, 1.0 m"]
    )
    assert lines == ["3 photos (a, b, c): course 9 to 80 deg, -3.5 to 1.0 m"]


def test_other_things_than_photos_are_not_called_photos() -> None:
    lines = ["camera A: focal length assumed", "camera B: focal length assumed", "3 places unseen"]
    lines += ["c.csv, line 2: cone is not measured", "c.csv, line 9: cone is not measured"]
    assert grouped(lines) == lines


def test_names_are_counted_as_what_the_tool_is_about() -> None:
    lines = ["a: seen once", "b: seen once"]
    assert grouped(lines, "points") == ["2 points (a, b): seen once"]


def test_doubts_of_a_run_are_counted_as_what_each_tool_is_about() -> None:
    def report(tool: str) -> StepReport:
        doubts = [f"{tool[0]}{n}: is odd" for n in (1, 2)]
        return StepReport(tool=load_registry().find(tool), skipped=False, reason="", duration_s=0.0,
                          result=Result(summary={"doubts": doubts}))  # fmt: skip

    reports = [report("mosaic"), report("volume")]
    lines = run_lines(reports, Path("none.gpkg"))
    assert lines[-2:] == [
        "doubt  2 photos (m1, m2): is odd",
        "doubt  2 areas (v1, v2): is odd",
    ]
    assert tool_lines(reports[1])[-1] == "doubt  2 areas (v1, v2): is odd"


def test_warnings_are_counted_as_what_the_tool_is_about(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with PlainFeedback(Stop(), "areas") as feedback:
        feedback.warn("a: is odd")
        feedback.warn("b: is odd")
    assert capsys.readouterr().err == "warning: 2 areas (a, b): is odd\n"


def test_order_is_that_of_the_first_of_each() -> None:
    assert grouped(["a: x", "no name", "b: y", "c: x"]) == ["2 photos (a, c): x", "no name", "b: y"]


def test_warning_told_in_the_report_is_not_told_twice(capsys: pytest.CaptureFixture[str]) -> None:
    with PlainFeedback(Stop()) as feedback:
        feedback.warn("a: blurred")
        feedback.warn("b: dark")
        assert capsys.readouterr().err == ""
        feedback.say_warnings(told=["a: blurred"])
        assert capsys.readouterr().err == "warning: b: dark\n"
    assert capsys.readouterr().err == ""


def test_warnings_before_an_error_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    feedback = PlainFeedback(Stop())
    feedback.warn("a: blurred")
    feedback.__exit__(RuntimeError, RuntimeError(), None)
    assert capsys.readouterr().err == "warning: a: blurred\n"


def test_run_tells_a_doubt_once(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from georef_gis.app import cli

    photos = tmp_path / "photos"
    photos.mkdir()
    for i in range(3):
        (photos / f"P{i}.JPG").write_bytes(b"no photo")
    done = CliRunner().invoke(cli.georef, ["init", str(photos), "--into", str(tmp_path)])
    assert done.exit_code == 2
    assert len(re.findall("P0.JPG", done.output)) == 1
