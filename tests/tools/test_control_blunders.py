"""`control` and `where_to_click` on a few photos of the sample project, with spoilt files."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_cases import SAMPLE, Site, copy_site, georef

from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback, Context
from processing_algorithms.measure.control import examine_control
from processing_algorithms.measure.where_to_click import WhereToClick, WhereToClickParameters
from processing_algorithms.orient.control_input import project_control
from processing_algorithms.site import load_site

STEPS = "read_photos,orient_direct,footprints,control"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def oriented(tmp_path_factory: pytest.TempPathFactory) -> Site:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("control") / "site", 5)
    assert site.run("--only", STEPS).code == 0
    return site


@pytest.fixture
def site(oriented: Site) -> Iterator[Site]:
    """The oriented site; files are put back after the test."""
    kept = {p: p.read_bytes() for p in (*(oriented.folder / "control").glob("*.csv"),
                                        oriented.folder / "project.toml")}  # fmt: skip
    yield oriented
    for path, content in kept.items():
        path.write_bytes(content)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def doubts(site: Site) -> list[str]:
    done = georef("run", site.folder, "--only", "control")
    assert done.code == 0, done.text
    return [line for line in done.text.splitlines() if line.startswith("doubt")]


def swap_columns(path: Path) -> None:
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines]
    path.write_text(
        "\n".join(
            line if line.startswith(("#", "name")) else ",".join([r[0], r[2], r[1], *r[3:]])
            for line, r in zip(lines, rows, strict=True)
        )
    )


def test_good_control_says_no_doubt_beyond_photos_left_out(site: Site) -> None:
    (line,) = doubts(site)
    assert "photos that have no pose in the project" in line


def test_swapped_columns_keep_the_run_and_name_the_cure(site: Site) -> None:
    swap_columns(site.folder / "control/control.csv")
    lines = [line for line in doubts(site) if "easting, northing" in line]
    assert len(lines) == 1
    assert "exchange the two columns" in lines[0]
    assert {row[0] for row in site.row("SELECT role FROM control")} == {"off"}


def test_a_file_without_crs_keeps_the_run(site: Site) -> None:
    edit(site.folder / "control/control.csv", "# crs: EPSG:6601\n", "# crs: EPSG:77\n")
    (line,) = doubts(site)
    assert "is not a CRS that PROJ knows" in line
    assert "no control is used" in line
    assert site.row("SELECT count(*) FROM control") == [(0,)]


def test_an_exchanged_mark_is_told_and_not_given_to_the_adjustment(site: Site) -> None:
    marks = site.folder / "control/marks.csv"
    lines = marks.read_text().splitlines()
    own = [i for i, line in enumerate(lines) if ",IMG_0004.JPG," in line]
    a, b = (lines[i].split(",")[0] for i in (own[0], own[-1]))
    lines[own[0]] = lines[own[0]].replace(a, b, 1)
    lines[own[-1]] = lines[own[-1]].replace(b, a, 1)
    marks.write_text("\n".join(lines))
    found = [line for line in doubts(site) if "exchanged" in line]
    assert len(found) == 1
    assert f"{a} and {b}" in found[0] or f"{b} and {a}" in found[0]
    project = Project.open(site.folder, read_only=True)
    loaded = examine_control(project, load_site(project))
    assert loaded is not None
    o = loaded.usable
    assert o is not None
    used = {(o.names[j], k) for j, k in zip(o.point, o.photo_ids, strict=True)}
    assert not any(name in (a, b) and "IMG_0004" in photo for name, photo in used)


def test_roles_of_project_toml_reach_the_database(site: Site) -> None:
    site.set("control", check=["P01"], off=["P03"])
    doubts(site)
    roles = dict(site.row("SELECT name, role FROM control"))
    assert (roles["P01"], roles["P03"], roles["P05"]) == ("check", "off", "control")


def test_where_to_click_lists_the_best_photo_first_and_near_the_marks(site: Site) -> None:
    project = Project.open(site.folder, read_only=True)
    feedback = CollectingFeedback()
    result = WhereToClick().run(Context(project=project), WhereToClickParameters(), feedback)
    with Path(result.outputs["pixels"]).open() as stream:
        rows = list(csv.DictReader(stream))
    marked = [row for row in rows if row["marked_u"]]
    # of those marked; the others lie outside of the image by their pose
    assert len(marked) >= 10
    off = [
        max(abs(float(r["u"]) - float(r["marked_u"])), abs(float(r["v"]) - float(r["marked_v"])))
        / float(r["sigma_major_px"])
        for r in marked
    ]
    # one flight: its errors are correlated
    assert max(off) < 4.0
    for name in {row["name"] for row in rows}:
        own = [row for row in rows if row["name"] == name]
        assert [int(row["rank"]) for row in own] == list(range(1, len(own) + 1))
    one = WhereToClickParameters(point=("P02",), best=1)
    WhereToClick().run(Context(project=project), one, feedback)
    with Path(result.outputs["pixels"]).open() as stream:
        assert [row["name"] for row in csv.DictReader(stream)] == ["P02"]


def summary(site: Site) -> dict[str, Any]:
    done = georef("run", site.folder, "--only", "control", "--force")
    assert done.code == 0, done.text
    with Project.open(site.folder, read_only=True).database as database:
        return dict(database.rows("run", {"tool": "georef:control"})[-1]["summary"])


def test_a_check_mark_called_wrong_does_not_count_in_the_rms(site: Site) -> None:
    before = summary(site)
    marks = site.folder / "control/marks.csv"
    lines = marks.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if ",IMG_0004.JPG," in line)
    name, photo, u, *rest = lines[at].split(",")
    # 300 px are some 13 m on the ground: among good marks it would show in the rms
    lines[at] = ",".join([name, photo, f"{float(u) + 300.0:.2f}", *rest])
    marks.write_text("\n".join(lines))
    site.set("control", check=[name])
    after = summary(site)
    assert (before["wrong_marks"], after["wrong_marks"]) == (0, 1)
    assert after["compared"] == before["compared"] - 1
    # m; one of some twenty good marks less
    assert after["rms_east_m"] == pytest.approx(before["rms_east_m"], abs=0.3)
    assert after["rms_north_m"] == pytest.approx(before["rms_north_m"], abs=0.3)


def test_what_was_to_be_expected_is_told_by_axis_east_before_north(site: Site) -> None:
    found = summary(site)
    keys = [key for key in found if key.endswith(("east_m", "north_m"))]
    assert keys == [
        "rms_east_m", "rms_north_m", "expected_sigma_east_m", "expected_sigma_north_m"
    ]  # fmt: skip
    both = [found["expected_sigma_east_m"], found["expected_sigma_north_m"]]
    # rounded to mm
    assert found["expected_sigma_m"] == pytest.approx(np.sqrt(np.mean(np.square(both))), abs=0.002)


def adjusted_without(site: Site) -> list[str]:
    """Lines about control that an adjustment which cannot use it gives."""
    feedback = CollectingFeedback()
    project = Project.open(site.folder, read_only=True)
    assert project_control(project, load_site(project), feedback) is None
    return feedback.warnings


def test_an_adjustment_says_once_that_a_refused_file_is_left_out_and_why(site: Site) -> None:
    edit(site.folder / "control/control.csv", "# crs: EPSG:6601\n", "# crs: EPSG:77\n")
    (line,) = adjusted_without(site)
    assert "control.csv" in line
    assert "is not a CRS that PROJ knows" in line
    assert "no control is used" in line
    # the words of the tool `control`, so that a run tells them once
    assert any(line in doubt for doubt in doubts(site))


def test_an_adjustment_says_that_control_of_another_place_is_left_out(site: Site) -> None:
    swap_columns(site.folder / "control/control.csv")
    (line,) = adjusted_without(site)
    assert "adjusted without control" in line
    assert "exchange the two columns" in line


def test_an_adjustment_says_that_control_has_no_marks(site: Site) -> None:
    site.set("control", marks=None)
    (line,) = adjusted_without(site)
    assert "control.csv: adjusted without control: no point has a mark in a photo" in line


def test_an_adjustment_says_nothing_of_good_control(site: Site) -> None:
    feedback = CollectingFeedback()
    project = Project.open(site.folder, read_only=True)
    assert project_control(project, load_site(project), feedback) is not None
    assert feedback.warnings == []
