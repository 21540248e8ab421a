"""`georef batch`: several sites, one of them broken; what is said, written and done again."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pyogrio
import pytest
import shapely
from tool_cases import SAMPLE, Site, copy_site, georef

from georef_gis.app.batch.process import Outcome, SiteProcess
from georef_gis.app.batch.sites import Site as BatchSite
from georef_gis.app.batch.sites import common_folder, find_sites
from georef_gis.app.batch.table import Row, csv_text, html_text, write_tables
from georef_gis.errors import ExportError, InputError
from georef_gis.project.summary import SiteSummary

pytestmark = pytest.mark.skipif(not SAMPLE.is_dir(), reason="sample_project is not there")
HOSTILE = "=cmd & <b> 'x' ü🚧"


def rows_of(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "batch.csv").open(encoding="utf-8-sig", newline="") as stream:
        return {row["site"]: row for row in csv.DictReader(stream)}


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder `sites` after one quick batch: two good sites, one broken, one empty of photos."""
    folder = tmp_path_factory.mktemp("batch") / "sites"
    for name in ("north", HOSTILE, "broken", "empty"):
        copy_site(folder / name, 3)
    (folder / "broken" / "project.toml").write_text("[project\n")
    for photo in (folder / "empty" / "photos").iterdir():
        photo.unlink()
    (folder / "notes").mkdir()
    done = georef("batch", folder / "*" / "project.toml", "--quick", "--jobs", 2)
    (folder / "said.txt").write_text(done.text)
    (folder / "code.txt").write_text(str(done.code))
    return folder


def test_a_failing_site_does_not_stop_the_rest_and_the_exit_code_tells(sites: Path) -> None:
    assert (sites / "code.txt").read_text() == "2"
    states = {name: row["state"] for name, row in rows_of(sites / "batch").items()}
    assert states == {"north": "done", f"'{HOSTILE}": "done", "broken": "failed", "empty": "failed"}
    for name in ("north", HOSTILE):
        assert (sites / name / "products" / "mosaic.tif").is_file()


def test_the_table_tells_photos_gsd_accuracy_duration_and_what_is_wrong(sites: Path) -> None:
    rows = rows_of(sites / "batch")
    north = rows["north"]
    assert north["photos"] == north["posed"] == "3"
    # m; the copies are told to make products at 0.3 m
    assert float(north["gsd_m"]) == pytest.approx(0.3, abs=0.01)
    assert float(north["covered_m2"]) > 1000.0
    assert "not tested" in north["accuracy"] or "RMSE" in north["accuracy"]
    assert float(north["duration_s"]) > 0.0
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\+00:00", north["finished_utc"])
    assert "project.toml" in rows["broken"]["message"]
    assert "photos" in rows["empty"]["message"]


def test_the_layer_holds_the_outline_of_every_site_that_has_one(sites: Path) -> None:
    meta, _, geometry, fields = pyogrio.raw.read(sites / "batch" / "batch.gpkg", layer="sites")
    assert meta["crs"] == "EPSG:4326"
    column = list(meta["fields"]).index("site")
    outlines = dict(zip(fields[column], geometry, strict=True))
    assert outlines["broken"] is None
    assert HOSTILE in outlines
    outline = shapely.from_wkb(outlines["north"])
    # deg; the simulated road lies in West Virginia
    assert outline.is_valid
    assert outline.centroid.distance(shapely.Point(-80.467, 39.097)) < 0.01


def test_the_page_shows_hostile_names_as_text_and_leads_to_reports(sites: Path) -> None:
    page = (sites / "batch" / "batch.html").read_text(encoding="utf-8")
    assert "<b>" not in page
    assert "=cmd &amp; &lt;b&gt;" in page
    assert 'href="../north/products/report.html"' in page


def test_a_second_batch_finds_good_sites_unchanged(sites: Path) -> None:
    before = (sites / "north" / "georef.gpkg").read_bytes()
    done = georef("batch", sites / "north", sites / HOSTILE, "--quick", "--summary", sites / "b2")
    assert done.code == 0
    assert {row["state"] for row in rows_of(sites / "b2").values()} == {"unchanged"}
    assert (sites / "north" / "georef.gpkg").read_bytes() == before
    assert rows_of(sites / "b2")["north"]["photos"] == "3"


def test_a_changed_site_is_made_again(sites: Path, tmp_path: Path) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(sites / "north", folder)
    Site(folder).set("products", gsd_m=0.4)
    done = georef("batch", folder, "--quick")
    assert done.code == 0, done.text
    row = rows_of(tmp_path / "batch")["changed"]
    assert row["state"] == "done"
    assert float(row["gsd_m"]) == pytest.approx(0.4, abs=0.01)


def test_events_for_other_programs_hold_the_rows(sites: Path) -> None:
    done = georef("batch", sites / "north", "--quick", "--json", "--summary", sites / "b3")
    events = [json.loads(line) for line in done.text.splitlines() if line.startswith("{")]
    last = events[-1]
    assert last["event"] == "batch"
    assert last["exit_code"] == 0
    assert last["sites"][0]["site"] == "north"


def test_a_stopped_batch_tells_so_and_goes_on_later(tmp_path: Path) -> None:
    folder = tmp_path / "sites"
    for name in ("one", "two"):
        copy_site(folder / name, 4)
    words = [sys.executable, "-m", "georef_gis.app", "batch", str(folder), "--quick", "--jobs", "1"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    database = folder / "one" / "georef.gpkg"
    patience = time.monotonic() + 120.0
    while not database.is_file() and time.monotonic() < patience:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=120)
    assert process.returncode == 130
    states = {name: row["state"] for name, row in rows_of(folder / "batch").items()}
    assert states == {"one": "cancelled", "two": "cancelled"}
    again = georef("batch", folder, "--quick")
    assert again.code == 0, again.text
    assert {row["state"] for row in rows_of(folder / "batch").values()} == {"done"}


def test_a_site_that_takes_too_long_is_stopped_and_the_rest_is_done(tmp_path: Path) -> None:
    copy_site(tmp_path / "slow", 3)
    done = georef("batch", tmp_path / "slow", "--quick", "--limit", "0.001")
    assert done.code == 2
    row = rows_of(tmp_path / "batch")["slow"]
    assert row["state"] == "failed"
    assert "--limit" in row["message"]


def test_a_process_that_dies_is_told_with_its_signal(tmp_path: Path) -> None:
    copy_site(tmp_path / "dies", 3)
    site = BatchSite(name="dies", folder=tmp_path / "dies")
    process = SiteProcess(site, ("--quick",), tmp_path / "log.jsonl", limit_s=0.0)
    os.kill(process.pid, signal.SIGKILL)
    while (outcome := process.poll()) is None:
        time.sleep(0.01)
    assert outcome.state == "bug"
    assert "SIGKILL" in outcome.message
    assert "fewer --jobs" in outcome.message


def test_a_site_that_another_run_works_on_is_named_busy(sites: Path, tmp_path: Path) -> None:
    from georef_gis.project.lock import project_lock

    copy_site(tmp_path / "busy", 3)
    with project_lock(tmp_path / "busy"):
        done = georef("batch", tmp_path / "busy", "--quick")
    assert done.code == 2
    assert "another run works on this project" in rows_of(tmp_path / "batch")["busy"]["message"]


def test_a_sites_folder_of_grids_is_not_that_of_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GEOREF_GRIDS", str(tmp_path))
    for name, text in (("a", '[project]\ngrids = "own"\n'), ("b", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "project.toml").write_text(text)
    given = []
    monkeypatch.setattr(
        "georef_gis.app.batch.schedule.SiteProcess",
        lambda site, *_: given.append(os.environ["GEOREF_GRIDS"]) or Ended(site),
    )
    assert georef("batch", tmp_path / "a", tmp_path / "b", "--jobs", 1).code == 0
    assert given == [str(tmp_path)] * 2


class Ended:
    """A process that has done its site."""

    fraction = 1.0

    def __init__(self, site: BatchSite) -> None:
        self.site = site

    def poll(self) -> Outcome:
        return Outcome(site=self.site, state="done", duration_s=0.0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nowhere/*/project.toml",), "no project.toml is there"),
        ((".", "--set", "gsd=2"), "ID.NAME=VALUE"),
        ((".", "--set", "mosiac.gsd=2"), "mosiac"),
    ],
)
def test_wrong_words_are_refused_before_any_site_is_run(
    words: tuple[str, ...], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_site(tmp_path / "site", 1)
    monkeypatch.chdir(tmp_path)
    done = georef("batch", *words)
    assert done.code == 2
    done.line("georef:", told)
    assert not (tmp_path / "site" / "georef.gpkg").exists()


def test_a_summary_that_cannot_be_written_is_told_before_any_site_is_run(tmp_path: Path) -> None:
    copy_site(tmp_path / "site", 1)
    (tmp_path / "batch").write_text("a file, whoever runs this")
    done = georef("batch", tmp_path / "site", "--quick")
    assert done.code == 2
    done.line("georef:", "batch/logs: cannot be written", "--summary FOLDER")
    assert not (tmp_path / "site" / "georef.gpkg").exists()


def test_alike_names_are_told_apart_and_a_site_is_taken_once(tmp_path: Path) -> None:
    for name in ("a/zone", "b/zone", "c/road"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "project.toml").write_text("")
    found = find_sites([str(tmp_path / "*" / "*"), str(tmp_path / "a" / "zone" / "project.toml")])
    assert [site.name for site in found] == ["a/zone", "b/zone", "road"]
    assert common_folder(found) == tmp_path
    with pytest.raises(InputError, match=r"no project\.toml"):
        find_sites([str(tmp_path / "a" / "zone" / "photos")])


def row_named(name: str, **facts: object) -> Row:
    site = BatchSite(name=name, folder=Path("/nowhere"))
    outcome = Outcome(site=site, state="done", duration_s=1.0)
    return Row(outcome=outcome, summary=SiteSummary(**facts))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["=1+1", "+x", "-x", "@x", "\tx"])
def test_formulas_are_text_in_the_csv(name: str) -> None:
    assert f"'{name}" in csv_text([row_named(name)])


def test_tested_accuracy_goes_before_the_expected_one() -> None:
    both = SiteSummary(rmse_h_m=0.042, check_points_h=6, sigma_horizontal_m=0.5)
    assert both.accuracy == "tested: RMSE H 0.042 m at 6 check points"
    assert SiteSummary(sigma_horizontal_m=0.5).accuracy.startswith("expected: 0.500 m")
    assert SiteSummary().accuracy == ""


def test_long_lists_of_doubts_are_cut_with_their_number(tmp_path: Path) -> None:
    text = html_text([row_named("a", doubts=tuple(f"doubt {n}" for n in range(9)))], tmp_path)
    assert "<summary>9</summary>" in text
    assert "and 4 more" in text


def test_a_layer_that_cannot_be_written_leaves_the_other_two(tmp_path: Path) -> None:
    # a folder of that name cannot be replaced by a file, whoever runs this
    (tmp_path / "batch.gpkg" / "x").mkdir(parents=True)
    with pytest.raises(ExportError, match=r"batch\.gpkg: cannot be written"):
        write_tables([row_named("a")], tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"batch.csv", "batch.html", "batch.gpkg"}


def test_the_layer_is_a_geopackage_of_version_1_3(tmp_path: Path) -> None:
    write_tables([row_named("a")], tmp_path)
    with sqlite3.connect(tmp_path / "batch.gpkg") as database:
        assert database.execute("PRAGMA user_version").fetchone()[0] == 10300
        assert database.execute("SELECT count(*) FROM sites").fetchone()[0] == 1
