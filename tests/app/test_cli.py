"""The command line: what it says, and its exit codes."""

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from georef_gis.app import cli
from georef_gis.app.feedback import BarFeedback, JsonFeedback, Stop
from georef_gis.toolbox.registry import Registry


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """The toy plug-in instead of what is installed."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "toolbox" / "toy_plugin"))
    import toy_georef

    found = Registry()
    found.add("toy", (*toy_georef.ALGORITHMS, *toy_georef.EXPORTERS), "toy-georef", "0.3")
    monkeypatch.setattr(cli, "_registry", lambda: found)
    return found


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "P0.JPG").write_bytes(b"photo")
    (tmp_path / "project.toml").touch()
    return tmp_path


def call(*words: Any) -> Result:
    return CliRunner().invoke(cli.georef, [str(word) for word in words])


def test_help_lists_the_tools_by_group() -> None:
    page = call("--help").output
    assert page.index("Tools: ingest") < page.index("Tools: orient") < page.index("Tools: export")
    assert "count  Count the photos" in page
    assert call().output == page


def test_run_says_what_ran_and_then_that_nothing_changed(site: Path) -> None:
    first = call("run", site)
    assert first.exit_code == 0
    assert "(it never ran)" in first.output
    assert "georef.gpkg" in first.output
    again = call("run", site / "project.toml")
    assert again.exit_code == 0
    assert "2 of 2 steps were unchanged" in again.output
    assert "GSD    2.13 cm" in again.output


def test_set_overrides_a_parameter(site: Path) -> None:
    assert call("run", site, "--set", "count.step=7cm").exit_code == 0
    assert "at 0.07 m" in (site / "products" / "count.txt").read_text()


def test_json_gives_one_event_a_line(site: Path) -> None:
    done = call("run", site, "--json")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert {"progress", "result"} == {event["event"] for event in events}
    assert events[-1]["summary"]["double"] == 2
    failed = call("look-at", "--json", "--mode", "fail", "x.jpg")
    (event,) = [json.loads(line) for line in failed.stdout.splitlines()]
    assert event == {"event": "error", "message": "x.jpg: is empty; give another", "exit_code": 2}


def test_units_and_positional_parameter() -> None:
    done = call("look-at", "some/x.jpg", "--tilt", "0.25rad")
    assert done.exit_code == 0, done.output
    assert "tilt_rad                     0.25" in done.output
    assert "name                         x.jpg" in done.output
    assert done.stderr == "looking\n"


@pytest.mark.parametrize(
    ("words", "code", "line"),
    [
        (("look-at", "x.jpg", "--mode", "fail"), 2, "x.jpg: is empty; give another"),
        (("look-at", "x.jpg", "--mode", "bug"), 1, "this is a bug in georef: ZeroDivisionError: 1"),
        (("look-at", "x.jpg", "--tilt", "100"), 2, "tool look_at: tilt: 100 deg is not allowed; g"),
        (("look-at",), 2, "Missing argument 'FILE'; see `georef look-at --help`"),
        (("lok-at", "x.jpg"), 2, "there is no tool 'lok-at'; did you mean look-at?; see `georef t"),
        (("run", "nowhere"), 2, "nowhere: no such folder"),
        (("run", "--nix"), 2, "No such option '--nix'; see `georef run --help`"),
        (("run", "--set", "step=5"), 2, "--set: 'step=5' is not of the form ID.NAME=VALUE"),
        (("count", "--project", "nowhere"), 2, "nowhere: no such folder"),
    ],
)
def test_error_is_one_line_and_an_exit_code(words: tuple[str, ...], code: int, line: str) -> None:
    done = call(*words)
    assert done.exit_code == code
    assert done.stderr.startswith(f"georef: {line}")
    assert done.stderr.count("\n") == 1


def test_bug_shows_where_it_is_when_asked() -> None:
    done = call("look-at", "x.jpg", "--mode", "bug", "-v")
    assert done.exit_code == 1
    assert "Traceback" in done.stderr


def test_folder_of_photos_only_is_told_of_init(site: Path) -> None:
    done = call("run", site / "photos")
    assert done.exit_code == 2
    assert "make one with `georef init`" in done.stderr


def test_tools_json_is_the_manifest() -> None:
    manifest = json.loads(call("tools", "--json").stdout)
    assert [tool["id"] for tool in manifest["tools"]] == [
        "count", "double", "look_at", "export_list",
    ]  # fmt: skip


def test_doctor_finds_this_installation_well(tmp_path: Path) -> None:
    done = call("doctor", tmp_path)
    assert done.exit_code == 0, done.output
    assert "4 tools from toy-georef 0.3" in done.output
    assert "BAD" not in done.output
    (tmp_path / "file").touch()
    findings = json.loads(call("doctor", "--json", tmp_path).stdout)
    assert {"subject", "state", "message"} == set(findings[0])


def test_bar_shows_progress_and_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with BarFeedback(Stop()) as feedback:
        feedback.warn("before [the] bar")
        feedback.progress(0.5, "P0.JPG [half]")
        feedback.warn("dark [photo]")
    shown = stream.getvalue()
    assert "warning: before [the] bar" in shown
    assert "warning: dark [photo]" in shown
    assert "P0.JPG [half]" in shown


def test_json_event_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    feedback = JsonFeedback(Stop())
    feedback.event("result", gsd=float("nan"), path=Path("a"), numbers=(1, np.int64(2)))
    line = capsys.readouterr().out
    assert json.loads(line) == {"event": "result", "gsd": None, "path": "a", "numbers": [1, 2]}


def test_script_answers() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "georef_gis.app", "--version"], capture_output=True, text=True
    )
    assert done.returncode == 0
    assert done.stdout.startswith("georef, version ")
