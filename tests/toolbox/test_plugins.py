"""Third parties' tools and exporters, really installed; broken ones are shown and do no harm."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

Georef = Callable[..., subprocess.CompletedProcess[str]]


def ok(done: subprocess.CompletedProcess[str]) -> str:
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_tools_of_a_plugin_are_commands(georef: Georef) -> None:
    listed = ok(georef("tools"))
    assert "* count " in listed
    assert "  look-at " in listed
    assert "  export-list " in listed


def test_manifest_has_the_plugins_parameters(georef: Georef) -> None:
    manifest = json.loads(ok(georef("tools", "--json")))
    count = next(tool for tool in manifest["tools"] if tool["full_id"] == "toy:count")
    assert manifest["manifest"] == 1
    assert count["parameters"][0] == {
        "name": "step", "type": "Length", "title": "Step", "required": False, "default": 1.0,
        "unit": "m", "minimum": 0.01, "maximum": 10,
    }  # fmt: skip
    assert count["schema"]["properties"]["step"]["maximum"] == 10


def test_help_of_a_tool_comes_from_its_declaration(georef: Georef) -> None:
    page = ok(georef("look-at", "--help"))
    assert "Look at a file, without a project." in page
    assert "--tilt ANGLE" in page
    assert "0 to 90 deg; default 30.0 deg" in " ".join(page.split())
    assert "fast|fail|bug" in page


def test_doctor_shows_what_was_refused_and_why(georef: Georef) -> None:
    findings = json.loads(ok(georef("doctor", "--json")))
    refused = [f["message"] for f in findings if f["subject"] == "plug-in refused"]
    assert len(refused) == 6
    reasons = "\n".join(refused)
    for words in (
        "broken-georef: broken_georef:ALGORITHMS cannot be imported (ModuleNotFoundError",
        "clashing-georef: provider 'toy' is taken by toy-georef",
        "clashing-georef: id clashing:good is taken by clashing-georef",
        "clashing-georef: id 'run' is reserved",
        "clashing-georef: silent has no docstring",
        "clashing-georef: 7 is neither an Algorithm nor an Exporter",
    ):
        assert words in reasons


def test_the_rest_works_beside_a_broken_plugin(georef: Georef, site: Path) -> None:
    out = ok(georef("run", site, "--only", "count,double"))
    assert (site / "products" / "count.txt").read_text().startswith("3 at 1.0 m")
    assert "GSD    2.13 cm" in out
    assert "area   1.23 ha" in out
    assert "doubt  the sun" in out
    assert "count.txt" in out
    assert ok(georef("good")) == ""


def test_exporter_of_a_plugin_is_a_tool(georef: Georef, site: Path) -> None:
    ok(georef("run", site, "--only", "count,double"))
    ok(georef("export-list", "--project", site, "--sep", ";", "--target", "names.txt", cwd=site))
    assert (site / "names.txt").read_text() == "P0.JPG;P1.JPG;P2.JPG"
    assert sorted(path.name for path in site.iterdir() if "part" in path.name) == []


def test_exporter_cannot_change_the_layer_nor_leave_half_a_file(georef: Georef, site: Path) -> None:
    ok(georef("run", site, "--only", "count,double"))
    changing = georef("export-list", "--project", site, "--sep", "change")
    assert changing.returncode == 2
    assert "readonly" in changing.stderr
    full = georef("export-list", "--project", site, "--sep", "boom")
    assert full.returncode == 2
    assert "No space left on device" in full.stderr
    assert [path.name for path in (site / "products").iterdir()] == ["count.txt"]
