"""`georef plan-flight`: figures, lines as KML, and what it warns of."""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import piexif
import pytest
from click.testing import CliRunner, Result
from lxml import etree
from PIL import Image

from georef_gis.app import cli

ROOT = Path(__file__).parents[2]
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
    # 35 m between photos at 30 m/s
    assert "a photo every" not in lines
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
        (("--height", 90, "--speed", 12, *PAPER, "--photo", "P.JPG"), "is described twice"),
        (
            ("--height", 90, "--speed", 12, "--focal", "20m", *PAPER[2:]),
            "a sensor of 36 mm behind a focal length of 20000 mm",
        ),
        (("--height", 90, "--speed", 12, *PAPER[:5], 56, *PAPER[6:]), "56 x 3744 px is no photo"),
        (("--height", 90, "--speed", 12, *PAPER, "--second-height", 120), "add --crossed"),
        (("--height", 90, "--speed", 12, *PAPER, "--layer", "a"), "is of no file"),
        (("--height", 90, "--speed", 12, *PAPER, "--relief", 90), "fly higher"),
    ],
    ids=["no camera", "height", "nowhere", "no file", "two corners", "places of a map",
         "two cameras", "focal length", "columns", "second height", "layer", "relief"],
)  # fmt: skip
def test_slip_is_one_line(words: tuple[object, ...], line: str, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = plan(*words)
    assert done.exit_code == 2, done.output
    assert line in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


SITE = ("--height", 90, "--speed", 12)
# 110 x 95 m in West Virginia and in Berlin, latitude first
SWAPPED = ("39.1000,-80.4700", "39.1000,-80.4689", "39.1010,-80.4689")
BERLIN = ("52.5,13.4", "52.5,13.4014", "52.501,13.4014")


@pytest.mark.parametrize(
    ("places", "parts"),
    [
        (SWAPPED, ("39.1,-80.47", "Antarctica", "80.47 deg south", "-80.47,39.1?")),
        (("39.1,-95.4", "39.1,-95.3", "39.2,-95.3"), ("latitude of -95.4", "-95.4,39.1?")),
        ([f"{one}@EPSG:4269" for one in SWAPPED], ("Antarctica", "-80.47,39.1?")),
        # the area of use of CH1903 is Switzerland; of EPSG:6601 a part of West Virginia
        (
            ("47.4,8.5@EPSG:4149", "47.4,8.51@EPSG:4149", "47.41,8.51@EPSG:4149"),
            ("outside of where 'CH1903' holds", "8.5,47.4 inside"),
        ),
        (
            ("218968,1693971@EPSG:6601", "218968,1694971@EPSG:6601", "219968,1694971@EPSG:6601"),
            ("outside of where 'NAD83(2011) / West Virginia North", "1693971,218968 inside"),
        ),
    ],
    ids=["antarctica", "no latitude", "named CRS", "geographic CRS", "map CRS"],
)
def test_swapped_corners_are_refused_with_their_order(
    places: Sequence[str], parts: Sequence[str]
) -> None:
    done = plan(*SITE, *PAPER, *corners(*places))
    assert done.exit_code == 2, done.output
    assert done.stderr.count("\n") == 1
    for part in ("corner", "the order is ", *parts):
        assert part in done.stderr


@pytest.mark.slow
def test_photos_faster_than_cameras_are_doubted() -> None:
    found = summary(*SITE, *PAPER, "--overlap", 99)
    # 1 % of 105 m at 12 m/s
    assert found["trigger_interval_s"] == pytest.approx(0.087, abs=2e-3)
    assert "a photo every 0.087 s" in " ".join(found["doubts"])


@pytest.mark.slow
def test_corners_that_may_be_swapped_are_doubted_once_and_told_where() -> None:
    # Delhi, latitude first: the sea near Svalbard, where people do fly
    found = summary(*SITE, *PAPER, *corners("28.6,77.2", "28.6,77.2009", "28.601,77.2009"))
    told = [line for line in found["doubts"] if "corner" in line]
    assert len(told) == 1
    assert "77.2 deg north" in told[0]
    assert "77.2,28.6" in told[0]
    assert found["middle_lat_deg"] == pytest.approx(77.20045, abs=1e-5)
    assert found["middle_lon_deg"] == pytest.approx(28.6005, abs=1e-5)
    # a place far from where its CRS holds, either way round
    found = summary(*SITE, *PAPER, *corners(*(f"{x},{y}@EPSG:4149" for x, y in (
        ("10.0", "50.0"), ("10.001", "50.0"), ("10.001", "50.001")))))  # fmt: skip
    assert [line for line in found["doubts"] if "outside of where 'CH1903' holds" in line]


def photo_at(path: Path, lat: float, lon: float) -> Path:
    """A photo of a phone's camera, north and east of null island."""
    degrees = [((round(v * 1e6), 1_000_000), (0, 1), (0, 1)) for v in (lat, lon)]
    exif = {
        "0th": {piexif.ImageIFD.Model: b"Phone"},
        "Exif": {piexif.ExifIFD.FocalLengthIn35mmFilm: 27},
        "GPS": {
            piexif.GPSIFD.GPSLatitudeRef: b"N",
            piexif.GPSIFD.GPSLatitude: degrees[0],
            piexif.GPSIFD.GPSLongitudeRef: b"E",
            piexif.GPSIFD.GPSLongitude: degrees[1],
        },
    }
    Image.new("RGB", (4000, 3000)).save(path, exif=piexif.dump(exif))
    return path


@pytest.mark.slow
def test_place_of_the_photo_tells_that_coordinates_were_swapped(tmp_path: Path) -> None:
    """In Europe and Africa latitudes pass for longitudes: only other places tell."""
    camera = ("--photo", photo_at(tmp_path / "P.JPG", 52.5, 13.4))
    done = plan(*SITE, *camera, *corners(*BERLIN))
    assert done.exit_code == 2, done.output
    assert "from where P.JPG was taken" in done.stderr
    assert "the order is lon,lat" in done.stderr
    right = [",".join(reversed(one.split(","))) for one in BERLIN]
    assert not [line for line in summary(*SITE, *camera, *corners(*right))["doubts"]
                if "order" in line]  # fmt: skip


@pytest.mark.slow
def test_file_in_antarctica_is_doubted_but_taken(tmp_path: Path) -> None:
    ring = [[39.1, -80.47], [39.1, -80.469], [39.105, -80.469], [39.1, -80.47]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    told = " ".join(summary(*SITE, *PAPER, "--area", area)["doubts"])
    assert "the area lies in Antarctica" in told
    assert "lon,lat" in told


@pytest.mark.slow
def test_commands_of_the_docs_work_as_they_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sample = ROOT / "sample_project/photos/IMG_0001.JPG"
    if not sample.is_file():
        pytest.skip("sample_project is not there")
    (tmp_path / "photos").mkdir()
    shutil.copy(sample, tmp_path / "photos")
    text = (ROOT / "docs/plan_flight.md").read_text("utf-8")
    lines = [line.removeprefix("    ") for line in text.splitlines() if line.startswith("    ")]
    start, end = lines.index("cat > road.geojson <<'END'"), lines.index("END")
    (tmp_path / "road.geojson").write_text("\n".join(lines[start + 1 : end]))
    told = "\n".join(lines[:start] + lines[end + 1 :]).replace("\\\n", " ")
    calls = [shlex.split(line)[2:] for line in told.splitlines()]
    assert len(calls) == 2
    monkeypatch.chdir(tmp_path)
    for words in calls:
        assert summary(*words)["photos"] > 5
    assert {"plan.kml", "plan.png"} <= {path.name for path in tmp_path.iterdir()}
