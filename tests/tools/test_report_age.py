"""Whether the page finds that its report is older than what the report shows."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tool_cases import Site, georef
from work_zone_cases import copied, posed_site

from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Project
from georef_gis.project.fingerprint import fingerprint
from processing_algorithms.view.report_age import older_than

ASSETS = "your last edits of assets"


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return posed_site(tmp_path_factory.mktemp("age") / "site", photos=2)


@pytest.fixture
def site(posed: Site, tmp_path: Path) -> Site:
    return copied(posed, tmp_path / "site")


@pytest.fixture
def project(site: Site) -> Iterator[Project]:
    found = Project.open(site.folder)
    yield found
    found.close()


def put_cone(site: Site, name: str) -> None:
    path = site.folder / "clicks.csv"
    path.write_text(f"asset,class,photo,u,v\n{name},cone,{site.photos[0].name},600,400\n")
    done = georef("assets", "--project", site.folder, "--clicks", path)
    assert done.code == 0, done.text


def record(project: Project, tool: str = "report", **columns: Any) -> None:
    """What the runner writes down after a run of now."""
    file = project.folder / "assets.gpkg"
    rows = project.database.last_rows("run", "tool")
    content = {
        "tool": f"georef:{tool}", "outcome": "done",
        "inputs": {"assets.gpkg": fingerprint(file)} if file.is_file() else {},
        "upstream": {r["tool"]: r["fid"] for r in rows if r["tool"] == "georef:read_photos"},
    }  # fmt: skip
    project.database.insert("run", content | columns)


def test_a_report_of_now_is_not_older_in_a_copy_or_after_a_look_either(
    site: Site, project: Project, tmp_path: Path
) -> None:
    assert older_than(project) == []
    record(project)
    assert older_than(project) == []
    with AssetStore.of_project(project) as store:
        # a look makes the file
        assert store.assets() == []
    assert (site.folder / "assets.gpkg").is_file()
    assert older_than(project) == []
    put_cone(site, "C1")
    record(project)
    os.utime(site.folder / "assets.gpkg", ns=(1, 1))
    assert older_than(project) == []


def test_edits_of_assets_make_the_report_older(site: Site, project: Project) -> None:
    record(project)
    put_cone(site, "C1")
    assert older_than(project) == [ASSETS]
    record(project)
    assert older_than(project) == []
    assert georef("assets", "--project", site.folder, "--undo", 1).code == 0
    assert older_than(project) == [ASSETS]


def test_marks_and_later_runs_make_the_report_older(site: Site, project: Project) -> None:
    marks = site.folder / "control" / "marks.csv"
    marks.parent.mkdir(exist_ok=True)
    marks.write_text("name,photo,u,v\n")
    record(project, "control", inputs={"control/marks.csv": fingerprint(marks)})
    record(project)
    assert older_than(project) == []
    marks.write_text("name,photo,u,v\nP1,a,1,2\n")
    assert older_than(project) == ["your last marks of control points"]
    record(project, "read_photos", inputs={})
    assert older_than(project)[1:] == ["the last run of read_photos"]
    record(project, "read_photos", inputs={}, outcome="failed")
    assert older_than(project)[1:] == []


def test_a_report_that_was_stopped_is_not_trusted_to_be_of_now(project: Project) -> None:
    record(project)
    record(project, outcome="cancelled")
    assert older_than(project) == ["its last run, which was not finished"]
