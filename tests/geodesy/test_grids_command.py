"""`georef grids` and what `georef doctor` says of grids, as users see them."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from grid_cases import write_gtx, write_tiff

from georef_gis.app import cli
from georef_gis.geodesy import geoid_undulation
from georef_gis.toolbox.health import geodesy_findings

GEOID18 = "us_noaa_g2018u0.tif"
SYSTEM_EGM96 = Path("/usr/share/proj/egm96_15.gtx")


def georef(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli.georef, ["grids", *map(str, words)])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A project in Ohio that promises NAVD88 and has no photos yet."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "project.toml").write_text(
        '[project]\ncrs = "EPSG:6549+6360"\n[gnss]\ndatum = "NAD83(2011)@2010.0"\n'
        '[control]\ngeoid = "egm2008"\n'
    )
    return folder


def test_the_grids_that_a_project_needs_are_told_with_what_for(grids: Path, site: Path) -> None:
    code, text, _ = georef("list", "--project", site)
    assert code == 0
    assert f"folder: {grids}" in text
    (line,) = [line for line in text.splitlines() if GEOID18 in line]
    assert "LACKING" in line
    assert "NAVD88 height (ftUS)" in line
    assert f"georef grids download {GEOID18}" in line
    (line,) = [line for line in text.splitlines() if "us_nga_egm08_25.tif" in line]
    assert "[control] geoid" in line
    write_tiff(grids / GEOID18)
    told = json.loads(georef("list", "--project", site, "--json")[1])
    assert {need["name"]: need["is_there"] for need in told["needed"]} == {
        GEOID18: True, "us_nga_egm08_25.tif": False,
    }  # fmt: skip
    assert [grid["name"] for grid in told["installed"] if grid["path"].startswith(str(grids))] == [
        GEOID18
    ]


@pytest.mark.parametrize("head", ["# crs = EPSG:6549+6360\n", "# height: orthometric geoid18\n"])
def test_what_the_head_of_a_control_file_says_is_needed(grids: Path, site: Path, head: str) -> None:
    (site / "project.toml").write_text('[project]\ncrs = "EPSG:6549"\n[control]\nfile = "c.csv"\n')
    (site / "c.csv").write_text(f"{head}name,easting,northing,height\n")
    _, text, _ = georef("list", "--project", site)
    assert any(GEOID18 in line and "LACKING" in line for line in text.splitlines())


def test_datums_that_a_grid_parts_are_needs_too(grids: Path, site: Path) -> None:
    text = (site / "project.toml").read_text().replace("6549+6360", "3728")  # NSRS2007
    (site / "project.toml").write_text(text)
    told = json.loads(georef("list", "--project", site, "--json")[1])
    reasons = {need["name"]: need["reason"] for need in told["needed"]}
    assert reasons["us_noaa_nadcon5_nad83_2007_nad83_2011_conus.tif"] == (
        "from NAD83(2011)@2010.0 to NAD83(NSRS2007)"
    )


def test_what_the_control_is_in_is_a_need_too(grids: Path, site: Path) -> None:
    """By the head of its file; [control] datum goes before."""
    (site / "project.toml").write_text(
        '[project]\ncrs = "EPSG:6549"\n[gnss]\ndatum = "NAD83(2011)@2010.0"\n'
        '[control]\nfile = "c.csv"\n'
    )
    (site / "c.csv").write_text("# crs: EPSG:3753+6360\n# geoid: GEOID12B\nname,easting\n")
    told = json.loads(georef("list", "--project", site, "--json")[1])
    reasons = {need["name"]: need["reason"] for need in told["needed"]}
    assert reasons[GEOID18] == "[control] crs: NAVD88 height (ftUS), geoid geoid18"
    assert reasons["us_noaa_g2012bu0.tif"] == "[control] geoid, geoid geoid12b"
    assert "from NAD83(2011)@2010.0 to NAD83(HARN)" in reasons.values()
    with (site / "project.toml").open("a") as stream:
        stream.write('datum = "NAD83(2011)@2010.0"\n')
    told = json.loads(georef("list", "--project", site, "--json")[1])
    assert not [need for need in told["needed"] if need["reason"].startswith("from ")]


def test_a_project_that_needs_none_says_so(grids: Path, site: Path) -> None:
    (site / "project.toml").write_text("")
    code, text, _ = georef("list", "--project", site)
    assert (code, "needed by the project: none" in text) == (0, True)


def test_grids_are_added_from_a_stick_and_removed(grids: Path, tmp_path: Path) -> None:
    stick = [write_tiff(tmp_path / GEOID18), write_gtx(tmp_path / "county.gtx")]
    code, text, _ = georef("add", *stick)
    assert code == 0
    assert f"added {GEOID18}: heights, lat 38 to 42, lon -85 to -81 deg" in text
    assert sorted(path.name for path in grids.iterdir()) == ["county.gtx", GEOID18]
    assert georef("remove", "county.gtx")[1] == f"removed {grids / 'county.gtx'}\n"
    code, _, line = georef("remove", "county.gtx")
    assert (code, line) == (2, f"georef: {grids}: no grid county.gtx\n")


def test_a_damaged_grid_is_told_in_the_list(grids: Path) -> None:
    whole = write_tiff(grids / GEOID18).read_bytes()
    (grids / GEOID18).write_bytes(whole[:400])
    code, text, _ = georef("list")
    assert code == 0
    (line,) = [line for line in text.splitlines() if GEOID18 in line]
    assert "BAD" in line
    assert "cut off" in line


def test_words_that_make_no_sense_are_one_line(grids: Path, tmp_path: Path) -> None:
    for words, told in (
        (("add", tmp_path / "none.tif"), "no such file"),
        (("add",), "Missing argument"),
        (("list", "--project", tmp_path / "none"), "no such folder"),
        (("fetch",), "No such command"),
    ):
        code, _, line = georef(*words)
        assert (code, told in line, line.count("\n")) == (2, True, 1), line


def test_a_download_without_names_or_project_asks_for_one(
    grids: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, line = georef("download")
    assert (code, "name the grids, or give the project" in line) == (2, True)


def test_doctor_tells_the_grids_and_what_a_project_lacks(grids: Path, site: Path) -> None:
    write_gtx(grids / "county.gtx")
    (grids / "bad.tif").write_bytes(b"no grid")
    found = geodesy_findings(site)
    told = {subject: message for subject, _, message in found if subject == "grids"}
    assert str(grids) in told["grids"]
    assert "county.gtx" in told["grids"]
    lacking = [
        message for subject, fine, message in found if subject == "grid lacking" and not fine
    ]
    assert any(
        message.startswith(GEOID18) and "georef grids download" in message for message in lacking
    )
    assert any(subject == "grid" and "bad.tif" in message for subject, _, message in found)


def test_doctor_goes_on_where_project_toml_is_broken(grids: Path, site: Path) -> None:
    (site / "project.toml").write_text("[project\n")
    found = geodesy_findings(site)
    assert found[0][0] == "PROJ"
    assert [fine for subject, fine, _ in found if subject == "grids"] == [False]


@pytest.mark.skipif(not SYSTEM_EGM96.is_file(), reason="no egm96_15.gtx of a system's PROJ")
def test_our_egm96_is_projs_grid(grids: Path) -> None:
    shutil.copy(SYSTEM_EGM96, grids)
    rng = np.random.default_rng(96)
    lat, lon = np.radians(rng.uniform(-89, 89, 300)), np.radians(rng.uniform(-179, 179, 300))
    ours, theirs = geoid_undulation(lat, lon), geoid_undulation(lat, lon, geoid=SYSTEM_EGM96.name)
    # m; ours is kept in centimetres
    assert ours == pytest.approx(theirs, abs=0.0051)
    assert os.environ["PROJ_USER_WRITABLE_DIRECTORY"] == str(grids)
