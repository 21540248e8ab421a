"""`georef control` on the sample project: points in the database, and poses compared with them."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from georef_gis.app import cli
from georef_gis.project import Project

SAMPLE = Path(__file__).parents[2] / "sample_project"
STEPS = "read_photos,orient_direct,footprints,control"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("control") / "site"
    generated = shutil.ignore_patterns("products", "cache", "georef.gpkg*", "truth")
    shutil.copytree(SAMPLE, folder, ignore=generated)
    return folder


def run(folder: Path) -> dict:  # type: ignore[type-arg]
    done = CliRunner().invoke(cli.georef, ["run", str(folder), "--only", STEPS, "--json"])
    assert done.exit_code == 0, done.output
    with Project.open(folder).database as database:
        row = database.rows("run", {"tool": "georef:control"})[-1]
    return dict(row["summary"])


@pytest.mark.slow
def test_marks_lie_off_by_what_the_poses_let_expect(site: Path) -> None:
    found = run(site)
    assert found["compared"] == found["marks"] == 78
    for key in ("rms_east_m", "rms_north_m"):
        # 16 photos share one flight's slow errors: wider than the 0.7 to 1.4 of many flights.
        assert 0.3 < found[key] / found["expected_sigma_m"] < 2.0


@pytest.mark.slow
def test_points_are_in_the_database_in_the_map_crs(site: Path) -> None:
    run(site)
    with (site / "control/control.csv").open() as stream:
        written = {r["name"]: r for r in csv.DictReader(line for line in stream if line[0] != "#")}
    with Project.open(site).database as database:
        rows = database.rows("control")
        assert database.count("mark") == 78
    assert {row["name"] for row in rows} == set(written)
    for row in rows:
        assert row["easting"] == pytest.approx(float(written[row["name"]]["easting"]))
        assert row["datum"] == "NAD83(2011)@2010.0"


@pytest.mark.slow
def test_a_mark_of_an_unknown_point_is_told_in_one_line_and_the_rest_goes_on(site: Path) -> None:
    marks = site / "control/marks.csv"
    text = marks.read_text()
    try:
        marks.write_text(text + "NOBODY,IMG_0001.JPG,10,10,0.5\n")
        done = CliRunner().invoke(cli.georef, ["run", str(site), "--only", "control"])
    finally:
        marks.write_text(text)
    assert done.exit_code == 0
    (line,) = [line for line in done.output.splitlines() if line.startswith("doubt")]
    assert "marks.csv, line 80: name: point 'NOBODY' is not among the control points" in line
    with Project.open(site).database as database:
        assert database.count("mark") == 78


def test_summary_of_the_comparison_reads_well() -> None:
    from georef_gis.app.report import _control_lines

    summary = {
        "compared": 3, "rms_east_m": 1.234, "rms_north_m": 0.5, "expected_sigma_m": 2.0
    }  # fmt: skip
    (line,) = _control_lines(json.loads(json.dumps(summary)))
    assert line.startswith("points 3 marks lie off by 1.23 m east, 50.00 cm north (rms)")
    assert "2.00 m was to be expected of a mark that one photo lays on the ground" in line
    assert "wrong" not in line
    assert "held the photos" not in line
    (line,) = _control_lines({**summary, "marks_adjusted_to": 2})
    assert line.endswith("; 2 of them held the photos when they were adjusted")
    (line,) = _control_lines({**summary, "wrong_marks": 2})
    assert line.endswith("; 2 more are called wrong and do not count")
