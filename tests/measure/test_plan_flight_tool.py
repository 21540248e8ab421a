"""`georef plan-flight`: figures, lines as KML, and what it warns of."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from lxml import etree

from georef_gis.app import cli

PAPER = ("--focal", "20.6478mm", "--sensor-width", "36mm", "--columns", 5616, "--rows", 3744)
# 345 x 333 m in West Virginia
CORNERS = ("-80.4700,39.1000", "-80.4660,39.1000", "-80.4660,39.1030", "-80.4700,39.1030")


def plan(*words: object) -> Result:
    return CliRunner().invoke(cli.georef, ["plan-flight", *map(str, words)])


def summary(*words: object) -> dict:  # type: ignore[type-arg]
    done = plan(*words, "--json")
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout.splitlines()[-1])["summary"])


def corners(*places: str) -> list[str]:
    return [word for place in places for word in ("--corner", place)]


@pytest.mark.slow
def test_flight_of_the_2012_paper() -> None:
    """300 m, 120 km/h, 80/40 %; its check points were 5.7 and 5.3 m off per axis."""
    words = ("--gnss", 1.5, "--roll-pitch", 0.75, "--boresight", 0.75, "--lever-arm", 0.075)
    found = summary("--height", 300, "--speed", 33.33, *PAPER, *words)
    assert found["gsd_m"] == pytest.approx(0.0931, abs=1e-4)
    assert found["footprint_m"] == pytest.approx([523.06, 348.71], abs=0.01)
    assert found["base_m"] == pytest.approx(69.74, abs=0.01)
    assert found["trigger_interval_s"] == pytest.approx(2.092, abs=2e-3)
    assert 5.0 < found["one_photo_middle_sigma_h_m"] < 7.0
    assert found["one_photo_sources_m"]["lever_arm"] < 0.1
    # a block is better than a photo, and distances in it far better
    assert found["adjusted_sigma_h_m"] < 0.5 * found["one_photo_sigma_h_m"]
    assert found["adjusted_distances_m"]["10 m"] < 0.1
    # without a place nothing is counted
    assert "photos" not in found


@pytest.mark.slow
def test_lines_over_an_area_are_written_and_drawn(tmp_path: Path) -> None:
    kml, png = tmp_path / "plan.kml", tmp_path / "plan.png"
    words = ("--height", 90, "--speed", 12, *PAPER, "--target", kml, "--picture", png)
    found = summary(*words, *corners(*CORNERS))
    folder = resources.files("fastkml") / "schema"
    schema = etree.XMLSchema(etree.parse(str(folder / "kml22gx.xsd")))
    root = etree.fromstring(kml.read_bytes())
    assert schema.validate(root), schema.error_log
    points = root.findall(".//{http://www.opengis.net/kml/2.2}Point")
    assert len(points) == found["photos"]
    assert found["lines"] == 4
    assert png.read_bytes()[:4] == b"\x89PNG"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plan.kml", "plan.png"]


@pytest.mark.slow
def test_what_lines_cannot_tell_is_said_and_a_crossing_helps() -> None:
    words = ("--height", 90, "--speed", 12, *PAPER)
    plain, crossed = summary(*words), summary(*words, "--crossed")
    lines = " ".join(plain["doubts"])
    assert "lever arm right and boresight roll cannot be told apart" in lines
    assert "--crossed" in lines
    assert len(crossed["doubts"]) < len(plain["doubts"])
    assert "vary the speed" in crossed["doubts"][-1]
    assert crossed["adjusted_sigma_u_m"] <= plain["adjusted_sigma_u_m"]


@pytest.mark.slow
def test_sensors_without_errors_leave_those_of_the_matches() -> None:
    names = ("gnss", "gnss-up", "roll-pitch", "yaw", "boresight", "lever-arm", "time",
             "focal-percent", "centre-px", "ground", "click")  # fmt: skip
    words = [word for name in names for word in (f"--{name}", 0)]
    found = summary("--height", 90, "--speed", 12, *PAPER, *words)
    assert found["one_photo_sigma_h_m"] == 0.0
    # m; pixels of 2.8 cm, half of one a tie point
    assert 0.0 < found["adjusted_sigma_h_m"] < 0.02


@pytest.mark.slow
def test_blur_overlap_and_relief_are_warned_of() -> None:
    words = ("--height", 60, "--speed", 30, *PAPER, "--overlap", 50, "--exposure", 0.01)
    found = summary(*words, "--relief", 30, *corners(*CORNERS))
    lines = " ".join(found["doubts"])
    assert "fewer than three photos" in lines
    assert "take 1" in lines or "ms or less" in lines
    assert "do not overlap" in lines
    assert found["overlap_over_high_ground_percent"] == pytest.approx([0.0, -20.0], abs=0.1)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--height", 90, "--speed", 12), "--photo"),
        (("--height", -5, "--speed", 12, *PAPER), "height"),
        (("--height", 90, "--speed", 12, *PAPER, "--target", "p.kml"), "needs an area"),
        (("--height", 90, "--speed", 12, *PAPER, "--area", "no.geojson"), "no such file"),
        (("--height", 90, "--speed", 12, *PAPER, *corners(*CORNERS[:2])), "3 or more"),
        (
            ("--height", 90, "--speed", 12, *PAPER, *corners("5e5,4e6", "5e5,5e6", "6e5,4e6")),
            "is no longitude and latitude",
        ),
    ],
    ids=["no camera", "height", "nowhere", "no file", "two corners", "places of a map"],
)  # fmt: skip
def test_slip_is_one_line(words: tuple[object, ...], line: str, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = plan(*words)
    assert done.exit_code == 2, done.output
    assert line in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
