"""`georef locate`, `intersect`, `measure-lines` and `who-sees` on the sample project's targets."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from georef_gis.app import cli
from georef_gis.model.control import Mark
from georef_gis.project import Project
from georef_gis.toolbox import Feedback
from processing_algorithms.measure.locate import warn_doubts
from processing_algorithms.measure.point_table import COLUMNS
from processing_algorithms.measure.session import MeasureSession

SAMPLE = Path(__file__).parents[2] / "sample_project"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample with direct poses."""
    if not (SAMPLE / "photos").is_dir():
        pytest.skip("sample_project is not there")
    folder = tmp_path_factory.mktemp("measure") / "site"
    generated = shutil.ignore_patterns("products", "cache", "georef.gpkg*", "truth", "adjustment")
    shutil.copytree(SAMPLE, folder, ignore=generated)
    steps = ["run", str(folder), "--only", "read_photos,orient_direct"]
    assert CliRunner().invoke(cli.georef, steps).exit_code == 0
    return folder


@pytest.fixture(scope="module")
def surveyed(site: Path) -> dict[str, np.ndarray]:
    """Targets on the project's map: easting, northing, ellipsoidal height."""
    with (site / "control" / "control.csv").open() as stream:
        rows = list(csv.DictReader(line for line in stream if line[0] != "#"))
    return {
        r["name"]: np.array([float(r["easting"]), float(r["northing"]), float(r["height"])])
        for r in rows
    }


def marks(site: Path) -> list[dict[str, str]]:
    with (site / "control" / "marks.csv").open() as stream:
        return list(csv.DictReader(line for line in stream if line[0] != "#"))


def tool(site: Path, *words: object) -> Result:
    args = [*map(str, words), "--project", str(site), "--force", "--json"]
    return CliRunner().invoke(cli.georef, args)


def summary(site: Path, *words: object) -> dict[str, Any]:
    done = tool(site, *words)
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout.splitlines()[-1])["summary"])


def unit_of(site: Path) -> float:
    return MeasureSession.open(Project.open(site, read_only=True)).unit


def test_targets_are_located_within_what_is_said(
    site: Path, surveyed: dict[str, np.ndarray], tmp_path: Path
) -> None:
    target = tmp_path / "points.csv"
    found = summary(site, "locate", "--marks", site / "control" / "marks.csv", "--target", target)
    assert found["measured"] == len(marks(site))
    with target.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    unit = unit_of(site)
    off = []
    for row in rows:
        true = surveyed[row["name"]]
        de = (float(row["easting"]) - true[0]) * unit / float(row["sigma_e_m"])
        dn = (float(row["northing"]) - true[1]) * unit / float(row["sigma_n_m"])
        off.append([de, dn])
        assert float(row["semi_major_m"]) >= float(row["semi_minor_m"]) > 0.0
        assert 0.0 <= float(row["azimuth_deg"]) < 180.0
        assert row["method"] == "locate"
    # one flight, whose photos share its slow errors
    assert 0.2 < np.sqrt(np.mean(np.square(off))) < 2.5


def test_targets_are_intersected_within_what_is_said(
    site: Path, surveyed: dict[str, np.ndarray], tmp_path: Path
) -> None:
    target = tmp_path / "points.json"
    found = summary(
        site, "intersect", "--marks", site / "control" / "marks.csv", "--target", target
    )  # fmt: skip
    assert found["measured"] + found["refused"] == len({m["name"] for m in marks(site)})
    unit = unit_of(site)
    for row in json.loads(target.read_text()):
        true = surveyed[row["name"]]
        assert abs(row["easting"] - true[0]) * unit < 4.0 * row["sigma_e_m"]
        assert abs(row["northing"] - true[1]) * unit < 4.0 * row["sigma_n_m"]
        assert row["n_rays"] == len(row["photos"].split(";"))
        assert row["dof"] == 2 * row["n_rays"] - 3


def test_a_distance_in_one_photo_is_told_with_how_much_better_it_is(
    site: Path, surveyed: dict[str, np.ndarray]
) -> None:
    by_photo: dict[str, list[dict[str, str]]] = {}
    for mark in marks(site):
        by_photo.setdefault(mark["photo"], []).append(mark)
    photo, some = max(by_photo.items(), key=lambda item: len(item[1]))
    pixels = [w for m in some[:3] for w in ("--pixel", f"{m['u']},{m['v']}")]
    found = summary(site, "measure-lines", "--photo", photo, *pixels, "--closed")
    unit = unit_of(site)
    for line, (a, b) in zip(found["lines"], ((0, 1), (1, 2), (2, 0)), strict=True):
        true = (surveyed[some[b]["name"]] - surveyed[some[a]["name"]])[:2] * unit
        assert abs(line["grid_m"] - np.hypot(*true)) < 4.0 * line["sigma_grid_m"] + 0.05
        assert line["sigma_ground_m"] < line["sigma_by_places_m"]
        azimuth = math.degrees(math.atan2(*true)) % 360.0
        turn = (line["bearing_grid_deg"] - azimuth + 180.0) % 360.0 - 180.0
        assert abs(turn) < 4.0 * line["sigma_bearing_grid_deg"]
    assert any("times better than the places" in line for line in found["told"])
    assert found["area_ground_m2"] > 0.0
    assert found["scale"] == pytest.approx(found["grid_m"] / found["ground_m"], rel=1e-5)


def test_points_are_chosen_and_ordered_by_name(site: Path) -> None:
    names = list(dict.fromkeys(m["name"] for m in marks(site)))[:3]
    words = [w for name in reversed(names) for w in ("--points", name)]
    found = summary(site, "measure-lines", "--marks", site / "control" / "marks.csv", *words)
    assert [(line["from"], line["to"]) for line in found["lines"]] == [
        (names[2], names[1]), (names[1], names[0]),
    ]  # fmt: skip
    done = tool(site, "measure-lines", "--marks", site / "control" / "marks.csv", "--points", "No")
    assert done.exit_code == 2
    assert "no point is called 'No'" in done.output
    done = tool(
        site, "measure-lines", "--marks", site / "control" / "marks.csv", *words, *words[:2]
    )
    assert done.exit_code == 2
    assert f"'{names[2]}' comes twice; back to the first point is --closed" in done.output


@pytest.mark.parametrize("surveyed_place", [True, False])
def test_photos_that_show_a_target_are_those_in_which_it_is_marked(
    site: Path, surveyed: dict[str, np.ndarray], surveyed_place: bool
) -> None:
    name = max(surveyed, key=lambda key: sum(m["name"] == key for m in marks(site)))
    e, n, _ = (float(v) for v in surveyed[name])
    more = ["--surveyed"] if surveyed_place else []
    found = summary(site, "who-sees", "--place", f"{e!r},{n!r}", *more)
    by_photo = {row["photo"]: row for row in found["sightings"]}
    ranks = [row["rank"] for row in found["sightings"]]
    assert ranks == list(range(1, len(ranks) + 1))
    marked = [m for m in marks(site) if m["name"] == name]
    seen = [m for m in marked if Path(m["photo"]).stem in by_photo or m["photo"] in by_photo]
    assert len(seen) >= len(marked) - 2
    if not surveyed_place:
        # who states how well a place was surveyed says that it was
        some = summary(site, "who-sees", "--place", f"{e!r},{n!r}", "--sigma-h", "3")
        least = min(row["sigma_minor_px"] for row in some["sightings"])
        assert least > min(row["sigma_minor_px"] for row in found["sightings"])
        return
    for m in seen:
        row = by_photo.get(m["photo"]) or by_photo[Path(m["photo"]).stem]
        off = math.hypot(float(m["u"]) - row["u"], float(m["v"]) - row["v"])
        assert off < 4.5 * row["sigma_major_px"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("locate",), "pixel: nothing to locate"),
        (("locate", "--pixel", "10,10"), "of which photo? write photo:u,v"),
        (("locate", "--pixel", "IMG_0004:10,9999"), "lies outside 1296 x 864 px"),
        (("locate", "--pixel", "nix.jpg:10,10"), "no photo with a pose is called 'nix.jpg'"),
        (("locate", "--pixel", "IMG_0004:10,10", "--target", "/nowhere/p.csv"), "/nowhere"),
        (("intersect", "--marks", "nix.csv"), "nix.csv"),
        (("measure-lines", "--photo", "IMG_0004", "--pixel", "1,1"), "needs two points"),
        (
            ("locate", "--pixel", "IMG_0004:10,10", "--target", "p.jpg"),
            "target: p.jpg has the name of another kind of file; end it in .csv or .json",
        ),
        (("who-sees", "--place", "1,2"), "km from the nearest photo; check its CRS and the order"),
        (("who-sees", "--place", "1,2@EPSG:0"), "EPSG:0"),
        (("who-sees", "--place", "1,2", "--sigma-v", "0.1"), "sigma_v: 0.1 m is of no height"),
        (("who-sees", "--place", "north"), "place"),
    ],
)
def test_a_slip_is_one_line(site: Path, words: tuple[str, ...], line: str) -> None:
    done = CliRunner().invoke(cli.georef, [*words, "--project", str(site), "--force"])
    assert done.exit_code == 2, done.output
    assert line in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_table_with_bad_lines_goes_on_and_tells_them(site: Path, tmp_path: Path) -> None:
    table = tmp_path / "m.csv"
    good = marks(site)[0]
    table.write_text(
        "name,photo,u,v,sigma_px\n"
        f"a,{good['photo']},{good['u']},{good['v']},0.5\n"
        f"a,{good['photo']},ten,20,0.5\n"
        f"b,{good['photo']},10,20000,0.5\n"
    )
    done = tool(site, "locate", "--marks", table, "--skip")
    assert done.exit_code == 0, done.output
    events = [json.loads(line) for line in done.stdout.splitlines()]
    result = events[-1]
    assert result["summary"]["measured"] == 1
    assert result["summary"]["refused"] == 1
    told = " ".join(event.get("message", "") for event in events)
    assert "m.csv, line 3" in told
    assert "lies outside" in told


def test_points_that_are_left_out_are_not_called_photos(site: Path) -> None:
    pixels = [f"--pixel=IMG_0004:{pixel}" for pixel in ("600,400", "10,20000", "10,30000")]
    words = ["locate", *pixels, "--skip", "--project", str(site), "--force"]
    done = CliRunner().invoke(cli.georef, words)
    assert done.exit_code == 0, done.output
    assert "2 points (2, 3): photo IMG_0004: pixel (10, 20000 to 30000) lies" in done.stderr
    assert "photos (" not in done.stderr


def test_what_is_doubtful_about_a_photo_is_told_once(site: Path) -> None:
    """Not once for each of its points."""
    session = MeasureSession.open(Project.open(site, read_only=True))
    told: list[str] = []

    class Heard(Feedback):
        def warn(self, message: str) -> None:
            told.append(message)

    (photo,) = list(session.site.photos)[:1]
    some = [Mark(name=f"p{i}", photo=photo, u=100.0 * i, v=300.0) for i in range(1, 6)]
    points = session.locate(some)
    doubts = tuple(("photo A: blurred", *(["far"] if i == 2 else [])) for i in range(5))
    warn_doubts(points.with_doubts(doubts), Heard())
    assert told == ["p1, p2, p3 and 2 more: photo A: blurred", "p3: far"]


def test_a_photo_that_is_not_there_stops_its_own_marks_only(site: Path, tmp_path: Path) -> None:
    """Of a point with two good marks it is told, of one with none left it is the reason."""
    name, table = marks(site)[0]["name"], tmp_path / "m.csv"
    some = [m for m in marks(site) if m["name"] == name]
    lines = [f"a,{m['photo']},{m['u']},{m['v']}" for m in some[:2]]
    table.write_text("\n".join(["name,photo,u,v", *lines, "a,nix.jpg,1,2", "b,nix.jpg,3,4", ""]))
    done = tool(site, "intersect", "--marks", table)
    assert done.exit_code == 0, done.output
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert events[-1]["summary"]["measured"] == events[-1]["summary"]["refused"] == 1
    told = [event["message"] for event in events if "nix.jpg" in event.get("message", "")]
    assert "a: left out: " in told[1]
    assert "m.csv, line 4: photo: no photo with a pose is called 'nix.jpg'" in told[1]
    assert "m.csv, line 5: photo: no photo with a pose is called 'nix.jpg'" in told[0]


@pytest.mark.parametrize(
    ("rows", "words", "line"),
    [
        ("a,nix.jpg,1,2\nb,nix.jpg,3,4", ("intersect",), "none of 2 points could be measured: "),
        ("a,IMG_0004.JPG,936,2,479,3", ("locate",), "m.csv, line 2: '479' stands in column 5 of 4"),
        ("IMG_0004.JPG,a,936,2,479,3", ("locate",), "m.csv, line 1: '3' stands in column 6 of 5"),
        ("a,IMG_0004.JPG,9,9999", ("locate",), "line 2: a: photo IMG_0004: pixel (9, 9999) lies"),
        ("1,IMG_0004.JPG,9,9", ("locate", "--pixel", "IMG_0004:5,5"), "the name of pixel number 1"),
        ("a,IMG_0004.JPG,9,9", ("locate", "--target"), "m.csv: target: is the table of marks"),
    ],
    ids=[
        "no photo",
        "decimal commas",
        "without a header",
        "outside",
        "two names",
        "marks as target",
    ],
)
def test_what_a_table_of_marks_does_wrong_is_told_with_file_and_line(
    site: Path, tmp_path: Path, rows: str, words: tuple[str, ...], line: str
) -> None:
    table = tmp_path / "m.csv"
    header = "" if rows.startswith("IMG") else "name,photo,u,v\n"
    table.write_text(f"{header}{rows}\n")
    more = [table] if words[-1] == "--target" else []
    done = CliRunner().invoke(
        cli.georef, [*words, *map(str, more), "--marks", str(table), "--project", str(site)]
    )
    assert done.exit_code == 2, done.output
    assert line in done.stderr
    assert done.stderr.count("\n") == 1
    assert rows in table.read_text()


def test_a_session_measures_marks_of_one_name_by_their_number(site: Path) -> None:
    session = MeasureSession.open(Project.open(site, read_only=True))
    some = [
        Mark(name=m["name"], photo=m["photo"], u=float(m["u"]), v=float(m["v"]))
        for m in marks(site)
    ]
    name = max({m.name for m in some}, key=lambda key: sum(m.name == key for m in some))
    lone = next(m for m in some if m.name != name)
    points = session.measure([lone, *(m for m in some if m.name == name)])
    assert points.names == (lone.name, name)
    assert points.methods == ("locate", "intersect")
    C = points.covariance()
    # tags of one flight share errors: the places know of each other
    assert abs(C[0, 3]) > 0.05 * math.sqrt(C[0, 0] * C[3, 3])
    window = session.window(session.photo_id(lone.photo), (lone.u, lone.v), half=20)
    assert window.pixels.shape[0] <= 41
    assert window.u <= lone.u <= window.u + window.pixels.shape[1]
    assert session.image(session.photo_id(lone.photo), reduce=8).shape[1] == 162
    guides = session.guide(lone)
    assert guides
    assert all(np.all(guide.sigma_across > 0.0) for guide in guides)
