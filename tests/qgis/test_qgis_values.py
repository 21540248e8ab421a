"""What is given in QGIS as georef gets it: a program in its place writes it down."""

from __future__ import annotations

import json
import shutil
import sqlite3
import sys
from pathlib import Path
from typing import Any

import pytest
from qgis_cases import SAMPLE, drive, install, why_not

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not())

CUSTOM = (
    'PROJCRS["Site 7",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",'
    '6378137,298.257223563]]],CONVERSION["own",METHOD["Transverse Mercator"],PARAMETER['
    '"Latitude of natural origin",39.1,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER['
    '"Longitude of natural origin",-80.4,ANGLEUNIT["degree",0.0174532925199433]],PARAMETER['
    '"Scale factor at natural origin",1.00005,SCALEUNIT["unity",1]],PARAMETER["False easting",'
    '5000,LENGTHUNIT["metre",1]],PARAMETER["False northing",1000,LENGTHUNIT["metre",1]]],'
    'CS[Cartesian,2],AXIS["e",east],AXIS["n",north],LENGTHUNIT["metre",1]]'
)


def entry(name: str, kind: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": kind, "title": name, "required": False, "default": None, **more}


PARAMETERS = [
    entry("photo", "File", positional=True),
    entry("crs", "Crs", default="auto"),
    entry("box", "Extent"),
    entry("place", "MapPoint"),
    entry("corner", "MapPoint", multiple=True, default=[]),
    entry("pixel", "PhotoPixel", multiple=True, default=[]),
    entry("photos", "PhotoSet", default=[]),
    entry("points", "VectorLayer"),
    entry("size", "TableField", of="points"),
    entry("raster", "RasterLayer"),
    entry("gsd", "Length", unit="cm", default=5.0),
    entry("span", "Length", unit="usft"),
    entry("tilt", "Angle", unit="deg", default=30.0),
    entry("share", "Number", minimum=0, maximum=1),
    entry("most", "Integer", default=8),
    entry("note", "Text", default=""),
    entry("plots", "Flag", default=True),
    entry("way", "Choice", choices=["a", "b"], default="a"),
    entry("nav", "File", multiple=True, default=[]),
    entry("target", "File", writes=True, suffixes=[".csv"]),
]


EVENTS = [
    {"event": "warning", "message": "told at once"},
    {"event": "result", "tool": "toy:all", "duration_s": 1.0,
     "warnings": ["told at once", "told at the end"], "summary": {"next": "georef run ../x"}},
]  # fmt: skip


@pytest.fixture(scope="module")
def echoed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    base = tmp_path_factory.mktemp("echo")
    install(base / "home")
    written, stub = base / "words.json", base / "stub.py"
    stub.write_text(
        f"import json, sys\nopen({str(written)!r}, 'w').write(json.dumps(sys.argv[1:]))\n"
        f"for event in {EVENTS!r}:\n    print(json.dumps(event))\n",
        encoding="utf-8",
    )
    tool = {"provider": "toy", "full_id": "toy:all", "id": "all", "name": "all", "group": "own",
            "help": "All.", "needs_project": False, "in_run": False, "parameters": PARAMETERS,
            "outputs": []}  # fmt: skip
    pack = base / "a b.gpkg"
    geopackage(pack)
    # QGIS leaves statistics beside a raster
    shutil.copy(SAMPLE / "dem.asc", base)
    given: dict[str, dict[str, Any]] = {
        "nothing": {},
        "defaults": {"gsd": 5.0, "tilt": 30.0, "most": 8, "plots": True, "way": "a", "note": ""},
        "all": {
            "photo": "-odd name.jpg", "crs": "EPSG:6601", "box": "1,3,2,4.5 [EPSG:32617]",
            "place": "10.5,20.25 [EPSG:32617]", "place_height": 7.5,
            "corner": "1,2; 3,4,5@EPSG:6601", "pixel": "a.JPG:1,2\nb.JPG:3,4",
            "photos": "IMG_00*\nIMG_0001.JPG", "points": "memory", "size": "size",
            "raster": str(base / "dem.asc"), "gsd": 2.5, "span": 10.0, "tilt": 12.0, "share": 0.5,
            "most": 3, "note": "=cmd \"x\" 'y' é😀", "plots": False, "way": "b",
            "nav": ["/a.nav", "/b.nav"], "target": str(base / "out.csv"),
        },
        "own crs": {"crs": CUSTOM},
        "selected": {"points": "selected"},
        "filtered": {"points": f"{pack}|layername=two|subset=n = 2"},
        "layer of a package": {"points": f"{pack}|layername=two"},
        "layer by its number": {"points": f"{pack}|layerid=1"},
        "empty texts": {"share": "", "place": "1,2 [EPSG:32617]", "place_height": "",
                        "WORKERS": "", "crs": ""},
        "no crs": {"crs": "nonsense"},
        "no layer": {"points": "/no/such.gpkg"},
        "out of range": {"share": 2.0},
        "no choice": {"way": "c"},
        "no number": {"gsd": "wide"},
    }  # fmt: skip
    jobs = [
        {"kind": "echo", "tool": tool, "command": [sys.executable, str(stub)],
         "written": str(written), "parameters": parameters}
        for parameters in given.values()
    ]  # fmt: skip
    return dict(zip(given, drive(base / "home", base / "work", jobs), strict=True))


def geopackage(path: Path) -> None:
    """Two layers of points."""
    import geopandas
    from shapely.geometry import Point

    for name in ("one", "two"):
        points = [Point(0, 0), Point(1, 1)]
        frame = geopandas.GeoDataFrame({"n": [1, 2]}, geometry=points, crs="EPSG:32617")
        frame.to_file(path, layer=name, driver="GPKG", engine="pyogrio", VERSION="1.3")
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT count(*) FROM gpkg_contents").fetchone() == (2,)


def words(result: dict[str, Any]) -> dict[str, list[str]]:
    """Values of the options that were given, by name."""
    assert result["ok"], result["log"] + result.get("message", "")
    found: dict[str, list[str]] = {}
    for word in result["words"]:
        name, _, value = word.partition("=")
        found.setdefault(name, []).append(value)
    return found


@pytest.mark.parametrize("name", ["nothing", "defaults"])
def test_what_is_left_alone_is_left_to_georef(echoed: dict[str, Any], name: str) -> None:
    assert echoed[name]["words"] == ["toy:all", "--json"]


def test_every_type_reaches_georef_as_it_reads_it(echoed: dict[str, Any]) -> None:
    told = words(echoed["all"])
    assert told["--crs"] == ["EPSG:6601"]
    # QGIS: west, east, south, north
    assert told["--box"] == ["1.0,2.0,3.0,4.5@EPSG:32617"]
    assert told["--place"] == ["10.5,20.25,7.5@EPSG:32617"]
    assert told["--corner"] == ["1,2", "3,4,5@EPSG:6601"]
    assert told["--pixel"] == ["a.JPG:1,2", "b.JPG:3,4"]
    assert told["--photos"] == ["IMG_00*", "IMG_0001.JPG"]
    assert told["--size"] == ["size"]
    assert [Path(name).name for name in told["--raster"]] == ["dem.asc"]
    assert [told[f"--{n}"] for n in ("gsd", "span", "tilt", "share", "most")] == [
        ["2.5"], ["10.0"], ["12.0"], ["0.5"], ["3"],
    ]  # fmt: skip
    assert told["--note"] == ["=cmd \"x\" 'y' é😀"]
    assert told["--no-plots"] == [""]
    assert told["--way"] == ["b"]
    assert told["--nav"] == ["/a.nav", "/b.nav"]
    # a name that begins with a dash is no option
    assert echoed["all"]["words"][-2] == "--"
    assert echoed["all"]["words"][-1].endswith("/-odd name.jpg")


def test_layer_in_memory_is_saved_with_its_crs(echoed: dict[str, Any]) -> None:
    (path,) = words(echoed["all"])["--points"]
    assert ".gpkg" in path
    assert echoed["all"]["saved"] == [3, "EPSG:32617"]
    listed = echoed["all"]["types"]
    # QgsProcessingParameterFeatureSource: its dialog offers the selected features only
    assert listed["points"] == "source"


def test_warning_is_told_once_and_the_next_step_in_words_of_the_toolbox(
    echoed: dict[str, Any],
) -> None:
    log = echoed["nothing"]["log"]
    assert (log.count("told at once"), log.count("told at the end")) == (1, 1)
    assert "next: Make the products of a project" in log


@pytest.mark.parametrize("name", ["selected", "filtered"])
def test_only_features_that_were_chosen_are_saved(echoed: dict[str, Any], name: str) -> None:
    (path,) = words(echoed[name])["--points"]
    assert path.endswith(".gpkg")
    assert echoed[name]["saved"] == [1, "EPSG:32617"]


def test_empty_text_is_no_zero(echoed: dict[str, Any]) -> None:
    assert words(echoed["empty texts"]) == {
        "toy:all": [""], "--place": ["1.0,2.0@EPSG:32617"], "--json": [""],
    }  # fmt: skip


@pytest.mark.parametrize("name", ["layer of a package", "layer by its number"])
def test_layer_of_a_package_is_named_with_it(echoed: dict[str, Any], name: str) -> None:
    (path,) = words(echoed[name])["--points"]
    assert path.endswith("a b.gpkg|layername=two")
    assert echoed[name]["saved"] == [2, "EPSG:32617"]


def test_crs_that_no_authority_knows_goes_as_wkt(echoed: dict[str, Any]) -> None:
    (told,) = words(echoed["own crs"])["--crs"]
    assert told.startswith("PROJCRS[")
    assert "Site 7" in told
    assert json.dumps(told).count("\\n") == 0


def test_crs_that_qgis_does_not_know_is_refused(echoed: dict[str, Any]) -> None:
    assert not echoed["no crs"]["ok"]
    assert "QGIS knows no CRS nonsense; give one such as" in echoed["no crs"]["log"]


@pytest.mark.parametrize("name", ["no layer", "out of range", "no choice", "no number"])
def test_value_that_cannot_be_is_refused_before_georef_runs(
    echoed: dict[str, Any], name: str
) -> None:
    result = echoed[name]
    assert not result["ok"]
    assert result["message"] or result["log"]
    if name in ("out of range", "no choice"):
        expected = {"out of range": "give at least 0, at most 1", "no choice": "give one of a, b"}
        assert expected[name] in result["message"]
    assert "Traceback" not in result["log"]
