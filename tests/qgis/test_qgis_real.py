"""The plug-in in the QGIS of the system: every tool run once on the sample project, and the rest.

One process of QGIS does all jobs; the tests look at what became of them.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from qgis_cases import (
    CONE,
    PROFILE,
    QGIS_PROCESS,
    cases,
    copy_sample,
    drive,
    environment,
    install,
    qgis_process,
    why_not,
    write_inputs,
)

from georef_gis.toolbox.registry import load_registry

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not())

TOOLS = [tool.id for tool in load_registry() if tool.provider == "georef"]
NAMES = [*TOOLS, "run", "show_project"]
# They write to something that is not there everywhere; their refusal is looked at too.
ELSEWHERE = ("export_postgis",)
Job = dict[str, Any]


@dataclass(frozen=True)
class Worked:
    """What became of all jobs: of a tool by its name, of others by what they are."""

    home: Path
    project: Path
    folder: Path
    told: dict[str, dict[str, Any]]
    expected: dict[str, dict[str, Any]]


def guess(parameters: dict[str, Any], project: Path) -> Job:
    """Something for every parameter that must be given, for a tool that has no case yet."""
    values = {"file": f"{project}/products/mosaic.tif", "number": 1.0, "string": "x",
              "raster": f"{project}/products/mosaic.tif", "distance": 1.0, "folder": str(project),
              "point": "1694010,219080 [EPSG:6601]", "extent": "0,1,0,1 [EPSG:4326]"}  # fmt: skip
    needed = {
        name: kind
        for name, (kind, flags, default) in parameters.items()
        if not flags & 8 and default is None and name != "PROJECT"
    }
    return {name: values.get(kind, "x") for name, kind in needed.items()}


def in_order(known: dict[str, Job]) -> list[str]:
    """Tools in the order of the work; what the table of cases does not know comes at the end."""
    listed = [name for name in known if name in NAMES]
    return listed + [name for name in NAMES if name not in known]


@pytest.fixture(scope="module")
def worked(tmp_path_factory: pytest.TempPathFactory) -> Worked:
    base = tmp_path_factory.mktemp("qgis")
    home, folder = base / "home", base / "files"
    install(home)
    project = copy_sample(base / "a site, é & 'x'")
    write_inputs(folder)
    known = cases(project, folder)
    (listed,) = drive(home, base / "list", [{"kind": "algorithms"}])
    jobs: list[tuple[str, Job]] = []
    for name in in_order(known):
        forms = listed["algorithms"].get(name, {"parameters": {}})["parameters"]
        given = dict(known[name]) if name in known else guess(forms, project)
        given.pop("error", None)
        if "PROJECT" in forms:
            given["PROJECT"] = str(project)
        jobs.append((name, {"kind": "run", "id": f"georef:{name}", "parameters": given}))
    jobs += other_jobs(project, base)
    results = drive(home, base / "work", [job for _, job in jobs])
    told = {name: result for (name, _), result in zip(jobs, results, strict=True)}
    return Worked(home, project, folder, {"list": listed, **told}, known)


def other_jobs(project: Path, base: Path) -> list[tuple[str, Job]]:
    def job(name: str, **parameters: Any) -> Job:
        return {"kind": "run", "id": f"georef:{name}", "parameters": parameters}

    p = str(project)
    return [
        ("places told only", job("locate", PROJECT=p, pixel=[CONE])),
        ("temporary file", job("locate", PROJECT=p, pixel=CONE, target="TEMPORARY_OUTPUT")),
        ("map of a layer", {"kind": "model", "project": p, "file": str(base / "two steps.model3"),
                            "target": str(base / "model.geojson")}),
        ("dialogs", {"kind": "dialogs"}),
        ("no project", job("footprints", PROJECT=str(base))),
        ("no folder", job("footprints", PROJECT=str(base / "nothing"))),
        ("no such photo", job("locate", PROJECT=p, pixel="NO.JPG:1,2")),
        ("no pixel", job("locate", PROJECT=p, pixel="nonsense")),
        ("no photos", job("check", folder=str(base / "list"), target=str(base / "x.kml"))),
        ("place not written to", job("export_geojson", PROJECT=p, target="/proc/no/x.geojson")),
        ("hostile text", job("export_xyz_tiles", PROJECT=p, target=str(base / "t"), max_zoom=17,
                             attribution="=cmd '; DROP TABLE x; -- é😀 <b>&\"")),
        ("cancelled", {**job("run", PROJECT=p, FORCE=True), "cancel_after": 2.5}),
        ("after the cancel", job("footprints", PROJECT=p)),
        ("reload", {"kind": "reload"}),
    ]  # fmt: skip


def test_provider_has_every_tool_and_says_what_it_is(worked: Worked) -> None:
    assert worked.told["list"]["problem"] == ""
    listed = worked.told["list"]["algorithms"]
    assert set(NAMES) <= set(listed)
    for name, told in listed.items():
        assert told["title"], name
        assert told["group"][0].isdigit(), name
        assert told["help"], name
        assert told["icon"], name
        assert name == "show_project" or told["url"].startswith("file://"), name


def test_parameters_have_the_types_of_qgis(worked: Worked) -> None:
    listed = worked.told["list"]["algorithms"]

    def kind(tool: str, name: str) -> str:
        return str(listed[tool]["parameters"][name][0])

    assert kind("init", "crs") == "crs"
    assert kind("band_index", "raster") == "raster"
    assert kind("profile", "line") == "source"
    assert kind("who_sees", "place") == "point"
    assert kind("orthos", "gsd") == "distance"
    assert kind("ppk", "nav") == "multilayer"
    assert kind("ppk", "mask") == "number"
    assert kind("mosaic", "blend") == "enum"
    assert kind("export_geopackage", "target") == "fileDestination"
    assert kind("export_xyz_tiles", "target") == "folderDestination"
    # 2 is advanced, 8 optional
    assert listed["ppk"]["parameters"]["ratio"][1] & 2
    assert not listed["ppk"]["parameters"]["mask"][1] & 2
    assert not listed["ppk"]["parameters"]["rover"][1] & 8
    assert listed["mosaic"]["parameters"]["gsd"][1] & 8
    assert listed["mosaic"]["outputs"]["mosaic"] == "outputRaster"


@pytest.mark.parametrize("name", NAMES)
def test_tool_runs_in_qgis(worked: Worked, name: str) -> None:
    result = worked.told[name]
    assert not result.get("crashed"), result["log"]
    assert "Traceback" not in result["log"]
    assert "this is a bug" not in result["log"], result["log"][-1500:]
    case = worked.expected.get(name)
    if case is not None and "error" in case:
        assert not result["ok"]
        assert case["error"] in result["log"]
    elif case is not None or (name.startswith("export_") and name not in ELSEWHERE):
        assert result["ok"], result["log"][-1500:]


@pytest.mark.parametrize(
    ("name", "layer", "renderer"),
    [
        ("footprints", "overlap", "singlebandpseudocolor"),
        ("mosaic", "mosaic", "multibandcolor"),
        ("mosaic", "seams", "singleSymbol"),
        ("run", "Photos", "RuleRenderer"),
        ("show_project", "Control and check points", "RuleRenderer"),
        ("assets", "asset_points", "categorizedSymbol"),
        ("surface", "surface", "hillshade"),
        ("locate", "places", "singleSymbol"),
        ("export_geojson", "photos", "RuleRenderer"),
        ("export_geopackage", "Assets", "categorizedSymbol"),
        ("band_index", "green", "singlebandpseudocolor"),
        ("places told only", "locate", "singleSymbol"),
        ("temporary file", "Locate pixels", "singleSymbol"),
    ],
)
def test_results_come_onto_the_map_with_their_style(
    worked: Worked, name: str, layer: str, renderer: str
) -> None:
    result = worked.told[name]
    assert result["loaded"], result["log"][-1500:]
    found = {told["name"]: told for told in result["layers"]}
    assert found[layer]["renderer"] == renderer
    assert all(told["valid"] for told in result["layers"])
    assert found[layer]["crs"] in ("EPSG:6601", "EPSG:4979")


def test_rasters_lie_below_points(worked: Worked) -> None:
    order = [layer["name"] for layer in worked.told["show_project"]["layers"]]
    assert order.index("Photos") < order.index("Footprints") < order.index("mosaic")


def test_measured_places_lie_where_georef_says(worked: Worked) -> None:
    result = worked.told["locate"]
    (told,) = [layer for layer in result["layers"] if layer["name"] == "places"]
    assert told["features"] == 2
    assert "semi_major_m" in (worked.folder / "places.csv").read_text("utf-8")


def test_progress_and_the_command_are_shown(worked: Worked) -> None:
    result = worked.told["run"]
    assert len(result["progress"]) > 5
    assert max(result["progress"]) <= 100.0
    assert "georef_gis.app run --quick" in result["log"]
    assert "wrote" in result["log"]


def test_what_was_up_to_date_still_has_its_outputs(worked: Worked) -> None:
    outputs = worked.told["mosaic"]["outputs"]
    assert Path(outputs["mosaic"]).is_file()
    assert outputs["project_folder"] == str(worked.project)


def test_model_hands_the_project_from_one_tool_to_the_next(worked: Worked) -> None:
    result = worked.told["map of a layer"]
    assert result["ok"], result["log"][-1500:]
    path = Path(result["outputs"]["second:written"])
    assert len(json.loads(path.read_text("utf-8"))["features"]) == 16


def test_every_tool_has_its_dialog_and_batch_dialog(worked: Worked) -> None:
    result = worked.told["dialogs"]
    assert not result.get("crashed"), result["log"]
    listed = worked.told["list"]["algorithms"]
    for name, (widgets, rows) in result["dialogs"].items():
        assert widgets == len(listed[name]["parameters"]), name
        assert rows == 1, name


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no project", "holds no project.toml"),
        ("no folder", "holds no project.toml"),
        ("no such photo", "NO.JPG"),
        ("no pixel", "is not of the form"),
        ("no photos", "photo"),
        ("place not written to", "/proc/no"),
    ],
)
def test_wrong_input_is_refused_in_one_line(worked: Worked, name: str, message: str) -> None:
    result = worked.told[name]
    assert not result["ok"]
    assert message in result["log"]
    lines = [line for line in result["log"].splitlines() if line.strip()]
    # the command, and the line
    assert len(lines) <= 2, result["log"]


def test_hostile_text_reaches_the_product_as_it_is(worked: Worked) -> None:
    result = worked.told["hostile text"]
    assert result["ok"], result["log"][-1500:]
    told = json.loads((Path(result["outputs"]["target"]) / "metadata.json").read_text("utf-8"))
    assert told["attribution"] == "=cmd '; DROP TABLE x; -- é😀 <b>&\""


def test_cancel_ends_it_and_leaves_whole_products(worked: Worked) -> None:
    result = worked.told["cancelled"]
    assert result["took"] is not None
    # 0.6 s on a machine of its own; what is asked of the run would take minutes
    assert result["took"] < 30.0
    assert "Cancelled" in result["log"]
    import rasterio

    maps = list((worked.project / "products").glob("*.tif"))
    assert len(maps) > 2
    for path in maps:
        with rasterio.open(path) as raster:
            assert raster.read(1).any(), path
    assert left_running(worked.project) == []
    assert worked.told["after the cancel"]["ok"], worked.told["after the cancel"]["log"][-1500:]


def left_running(project: Path) -> list[str]:
    """Processes that work on a project."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = path.read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
            if "georef_gis.app" in words and str(project) in words:
                found.append(words)
    return found


def test_plug_in_can_be_switched_off_and_on(worked: Worked) -> None:
    result = worked.told["reload"]
    assert result["gone"]
    assert result["problem"] == ""
    assert result["count"] == len(worked.told["list"]["algorithms"])


def test_qgis_process_runs_a_tool_and_tells_json(worked: Worked) -> None:
    words = (
        f"PROJECT={worked.project}",
        f"pixel={CONE}",
        f"target={worked.folder}/by_process.json",
    )
    done = qgis_process(worked.home, "run", "georef:locate", "--json", "--", *words)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout[done.stdout.index("{") :])
    assert told["results"]["points"].endswith("by_process.json")
    assert Path(told["results"]["points"]).is_file()


def test_qgis_process_fails_with_the_one_line(worked: Worked) -> None:
    done = qgis_process(
        worked.home, "run", "georef:locate", "--", f"PROJECT={worked.project}", "pixel=NO.JPG:1,2"
    )
    assert done.returncode == 1
    assert "NO.JPG" in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr


def test_qgis_process_tells_the_help(worked: Worked) -> None:
    done = qgis_process(worked.home, "help", "georef:mosaic")
    assert done.returncode == 0
    assert "PROJECT" in done.stdout
    assert "blend" in done.stdout


@pytest.fixture
def going(worked: Worked) -> Iterator[subprocess.Popen[str]]:
    """`qgis_process` at work on all steps."""
    words = ["run", "georef:run", "--", f"PROJECT={worked.project}", "FORCE=1"]
    process = subprocess.Popen(
        [QGIS_PROCESS, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment(worked.home),
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not left_running(worked.project) and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1.0)
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def test_interrupted_qgis_process_leaves_nothing_running(
    worked: Worked, going: subprocess.Popen[str]
) -> None:
    os.kill(going.pid, signal.SIGINT)
    # how soon (0.6 s on a machine of its own) is no matter of a test
    patience = time.monotonic() + 60.0
    while (left := left_running(worked.project)) and time.monotonic() < patience:
        time.sleep(0.02)
    assert not left
    going.wait(timeout=60)


@pytest.fixture(scope="module")
def lost(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Home of a user whose georef is gone since the plug-in was installed."""
    home = tmp_path_factory.mktemp("lost")
    record = install(home) / "georef.json"
    told = json.loads(record.read_text("utf-8"))
    record.write_text(json.dumps({**told, "python": "/gone/bin/python"}), encoding="utf-8")
    return home


def test_without_georef_the_provider_says_so_and_qgis_works(lost: Path, tmp_path: Path) -> None:
    (listed,) = drive(lost, tmp_path, [{"kind": "algorithms"}])
    assert "/gone/bin/python: is not there" in listed["problem"]
    assert "georef qgis install" in listed["problem"]
    assert "Settings > Options > Processing" in listed["problem"]
    assert "\n" not in listed["problem"]
    assert set(listed["algorithms"]) == {"show_project"}
    done = qgis_process(lost, "list")
    assert done.returncode == 0
    assert "native:buffer" in done.stdout


def test_georef_named_in_the_settings_is_used(lost: Path, tmp_path: Path) -> None:
    import sys

    settings = lost / PROFILE / "QGIS/QGIS3.ini"
    with settings.open("a", encoding="utf-8") as stream:
        stream.write(f"\n[Processing]\nConfiguration\\GEOREF_PROGRAM={sys.executable}\n")
    (listed,) = drive(lost, tmp_path, [{"kind": "algorithms"}])
    assert listed["problem"] == ""
    assert set(NAMES) <= set(listed["algorithms"])
