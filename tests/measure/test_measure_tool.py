"""`georef measure-photo` on a photo of the sample project."""

from __future__ import annotations

import csv
import json
import math
import shutil
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pyproj import Geod

from georef_gis.app import cli

SAMPLE = Path(__file__).parents[2] / "sample_project"
PHOTO = SAMPLE / "photos" / "IMG_0004.JPG"


def measure(*words: object) -> Result:
    if not PHOTO.is_file():
        pytest.skip("sample_project is not there")
    return CliRunner().invoke(cli.georef, ["measure-photo", *map(str, words)])


def summary(*words: object) -> dict:  # type: ignore[type-arg]
    done = measure(*words, "--json")
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout.splitlines()[-1])["summary"])


def test_worked_example_by_the_tool() -> None:
    """The report's height with the sample's camera: the report's, its photos at a third."""
    found = summary(PHOTO, "--height", "52.1208", "--level")
    width, height = found["field_of_view_m"]
    assert (width, height) == (pytest.approx(64.2823, rel=1e-4), pytest.approx(42.8549, rel=1e-4))
    assert found["gsd_m"] == pytest.approx(64.2823 / 1296, rel=1e-4)


def test_height_may_be_given_in_feet() -> None:
    assert summary(PHOTO, "--height", "171ft")["height_above_ground_m"] == pytest.approx(52.121)


def test_without_a_height_the_cure_is_named() -> None:
    done = measure(PHOTO)
    assert done.exit_code == 2
    assert done.stderr.startswith("georef: IMG_0004.JPG: height: ")
    assert "--height" in done.stderr


def test_lines_agree_with_the_places() -> None:
    pixels = [("--pixel", f"{u},{v}") for u, v in ((100, 100), (1200, 200), (600, 800))]
    found = summary(PHOTO, "--height", 55, *(word for pair in pixels for word in pair))
    places = found["points"]
    for line, (a, b) in zip(found["lines"], pairwise(places), strict=True):
        azimuth, _, distance = Geod(ellps="WGS84").inv(
            a["lon_deg"], a["lat_deg"], b["lon_deg"], b["lat_deg"]
        )
        assert line["distance_m"] == pytest.approx(distance, rel=1e-4)
        assert line["azimuth_deg"] == pytest.approx(azimuth % 360, abs=0.01)
        assert line["sigma_m"] < math.hypot(a["sigma_e_m"], a["sigma_n_m"])


def test_heading_turns_the_lines() -> None:
    words = (PHOTO, "--height", 55, "--level", "--pixel", "648,432", "--pixel", "648,100")
    for heading in (0.0, 90.0, 225.0):
        (line,) = summary(*words, "--heading", heading)["lines"]
        assert line["azimuth_deg"] == pytest.approx(heading, abs=0.5)


def test_csv_holds_the_points(tmp_path: Path) -> None:
    target = tmp_path / "points.csv"
    done = measure(
        PHOTO, "--height", 55, "--pixel", "10,20", "--pixel", "30,40", "--target", target
    )
    assert done.exit_code == 0, done.output
    with target.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(float(r["u"]), float(r["v"])) for r in rows] == [(10, 20), (30, 40)]
    assert [p.name for p in tmp_path.iterdir()] == ["points.csv"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((PHOTO, "--height", 55, "--pixel", "100,1000"), "lies outside 1296 x 864 px"),
        ((PHOTO, "--height", 55, "--pixel", "ten,20"), "pixel"),
        ((PHOTO, "--height", 55, "--pixel", "OTHER.JPG:9,9"), "is of another photo than IMG_"),
        ((PHOTO, "--height", -5), "height"),
        (("nix.jpg", "--height", 55), "nix.jpg"),
        ((PHOTO, "--height", 55, "--pixel", "9,9", "--target", "nowhere/p.csv"), "p.csv"),
    ],
    ids=["outside", "no number", "other photo", "negative height", "no photo", "no folder"],
)
def test_slip_is_one_line(words: tuple[object, ...], line: str) -> None:
    done = measure(*words)
    assert done.exit_code == 2, done.output
    assert line in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_with_the_poses_of_a_project(tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "photos").mkdir(parents=True)
    for i in (3, 4, 5):
        shutil.copy2(SAMPLE / "photos" / f"IMG_000{i}.JPG", site / "photos")
    for name in ("dem.asc", "dem.prj", "project.toml"):
        shutil.copy(SAMPLE / name, site)
    shutil.copytree(SAMPLE / "control", site / "control")
    steps = ["run", str(site), "--only", "read_photos,orient_direct"]
    assert CliRunner().invoke(cli.georef, steps).exit_code == 0
    photo = site / "photos" / "IMG_0004.JPG"
    found = summary(photo, "--site", site, "--pixel", "648,432", "--pixel", "900,432")
    assert 45.0 < found["height_above_ground_m"] < 65.0
    with (SAMPLE / "truth" / "poses.csv").open() as stream:
        (true,) = [r for r in csv.DictReader(stream) if r["photo"] == "IMG_0004.JPG"]
    (one, _), off = found["points"], 55.0 * math.tan(math.radians(found["tilt_deg"]))
    _, _, apart = Geod(ellps="WGS84").inv(
        one["lon_deg"], one["lat_deg"], float(true["lon_deg"]), float(true["lat_deg"])
    )
    assert apart < off + 4.0 * one["sigma_e_m"]
    mixed = measure(photo, "--site", site, "--height", 55)
    assert mixed.exit_code == 2
    absent = measure(SAMPLE / "photos" / "IMG_0001.JPG", "--site", site)
    assert absent.exit_code == 2
    assert "IMG_0001.JPG" in absent.stderr
