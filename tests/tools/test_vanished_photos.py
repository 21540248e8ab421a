"""Photos that are deleted after a run: told with the assets clicked in them, which stay."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from tool_cases import SAMPLE, Done, Site, georef
from work_zone_cases import clicks_csv, copied, posed_site

from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Project
from georef_gis.project.records import load_frame
from processing_algorithms.assets.asset_places import joint_places

NAMES = ["C01", "C05", "D02"]
STEPS = "read_photos,orient_direct"


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Five photos with poses, assets clicked in all that show them, and one in the last only."""
    site = posed_site(tmp_path_factory.mktemp("vanished") / "site")
    last = site.photos[-1].name
    text = clicks_csv(SAMPLE / "truth", NAMES, photos=[path.name for path in site.photos[:-1]])
    (site.folder / "clicks.csv").write_text(f"{text}lonely,cone,{last},600,400,,,\n")
    done = georef("assets", "--project", site.folder, "--clicks", site.folder / "clicks.csv")
    assert done.code == 0, done.text
    return site


@pytest.fixture
def site(mapped: Site, tmp_path: Path) -> Site:
    return copied(mapped, tmp_path / "site")


def rows(site: Site) -> dict[str, dict[str, str]]:
    with (site.products / "assets.csv").open(encoding="utf-8", newline="") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def without_last(site: Site) -> tuple[Path, Done]:
    gone = site.photos[-1]
    gone.unlink()
    return gone, site.run("--only", STEPS)


def test_a_run_tells_photos_that_are_gone_and_the_assets_clicked_in_them(site: Site) -> None:
    before = rows(site)
    gone, done = without_last(site)
    assert done.code == 0, done.text
    assert f"1 photo is gone from the folder since the last run: {gone.name}" in done.line("doubt")
    told = done.line(f"no longer has ({gone.stem})")
    assert "1 asset was clicked" in told
    assert "cone lonely" in told
    assert "cone C01" not in told
    # it is a doubt of the last run, which is told again until something changes
    assert f"no longer has ({gone.stem})" in site.run("--only", STEPS).text
    assert georef("assets", "--project", site.folder).code == 0
    assert rows(site).keys() == before.keys()
    assert {n: row["easting"] for n, row in rows(site).items()} == {
        n: row["easting"] for n, row in before.items()
    }


def test_photos_that_are_excluded_or_moved_with_the_project_are_not_gone(
    site: Site, tmp_path: Path
) -> None:
    site.set("photos", exclude=[site.photos[-1].name])
    done = site.run("--only", STEPS)
    assert "gone from the folder" not in done.text
    assert "no longer has" in done.text
    site.folder.rename(tmp_path / "moved")
    moved = Site(tmp_path / "moved")
    assert "gone from the folder" not in moved.run("--only", STEPS, "--force").text


def test_a_photo_deleted_in_a_copy_is_gone_though_the_first_project_has_it(
    site: Site, tmp_path: Path
) -> None:
    copy = copied(site, tmp_path / "copy")
    gone, done = without_last(copy)
    assert (site.folder / "photos" / gone.name).is_file()
    assert f"since the last run: {gone.name}" in done.text


def test_the_other_assets_are_measured_again_and_those_of_gone_photos_are_told(site: Site) -> None:
    before = rows(site)
    gone, _ = without_last(site)
    done = georef("assets", "--project", site.folder, "--remeasure")
    assert done.code == 0, done.text
    assert "1 of 4 clicked assets stays as it is" in done.text
    after = rows(site)
    assert {name: row["revision"] for name, row in after.items()} == {
        "C01": "2", "C05": "2", "D02": "2", "lonely": "1",
    }  # fmt: skip
    assert after["lonely"]["easting"] == before["lonely"]["easting"]
    assert after["lonely"]["problems"] == f"was clicked in {gone.stem}, no longer in the project"
    assert after["C01"]["problems"] == ""


def test_one_unknown_photo_does_not_stop_a_table_of_clicks(site: Site) -> None:
    name = site.photos[0].name
    path = site.folder / "more.csv"
    path.write_text(f"asset,class,photo,u,v\nbad,drum,NONE.JPG,600,400\ngood,drum,{name},600,400\n")
    done = georef("assets", "--project", site.folder, "--clicks", path)
    assert done.code == 0, done.text
    assert "line 2: drum bad is not measured" in done.text
    assert "NONE.JPG" in done.text
    assert {"good", "bad"} & rows(site).keys() == {"good"}


def test_places_with_joint_covariance_take_what_is_stored_of_gone_photos(site: Site) -> None:
    without_last(site)
    project = Project.open(site.folder)
    with AssetStore.of_project(project) as store:
        assets = store.assets()
    found = joint_places(project, load_frame(project.database), assets, sigma_px=0.5)
    (at,) = found.indices[next(asset.id for asset in assets if asset.name == "lonely")]
    (lonely,) = (asset for asset in assets if asset.name == "lonely")
    assert lonely.quality is not None
    assert lonely.quality.sigma_u is not None
    # the axes of grid and enu differ by the convergence only, up is the same to 1e-6
    assert math.sqrt(found.covariance[3 * at + 2, 3 * at + 2]) == pytest.approx(
        lonely.quality.sigma_u, rel=1e-3
    )
    assert "1 of 4 assets" in found.basis


def test_nothing_to_undo_is_said_plainly(site: Site) -> None:
    done = georef("assets", "--project", site.folder, "--undo", 3)
    assert "there was only 1 step to undo" in done.text
    done = georef("assets", "--project", site.folder, "--undo", 1)
    assert done.code == 0
    assert "nothing to undo" in done.text
    assert "0 steps" not in done.text
