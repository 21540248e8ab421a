"""The process of georef as the plug-in runs it: events, errors, cancel."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from qgis_cases import ROOT  # noqa: F401 (puts the plug-in's folder on the path)

from georef_qgis import child, manifest  # isort: skip
from georef_qgis.tools import ManifestError  # isort: skip

posix = pytest.mark.skipif(sys.platform == "win32", reason="processes of POSIX")


def program(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "stub.py"
    path.write_text("import json, os, signal, subprocess, sys, time\n" + text, encoding="utf-8")
    return [sys.executable, "-u", str(path)]


def run(
    command: list[str], after: float = 60.0
) -> tuple[child.Outcome, list[dict[str, Any]], float]:
    told: list[dict[str, Any]] = []
    started = time.monotonic()
    outcome = child.run(command, told.append, lambda: time.monotonic() - started > after)
    return outcome, told, time.monotonic() - started


def alive(number: int) -> bool:
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_events_are_handed_on_and_results_kept(tmp_path: Path) -> None:
    code = """
for event in ({"event": "progress", "fraction": 0.5, "message": "half"},
              {"event": "warning", "message": "é"}, {"event": "result", "tool": "georef:x"}):
    print(json.dumps(event))
print("a library speaks"); print(["no", "event"]); print("to the side", file=sys.stderr)
"""
    outcome, told, _ = run(program(tmp_path, code))
    assert (outcome.error, outcome.cancelled) == ("", False)
    assert outcome.results == [{"event": "result", "tool": "georef:x"}]
    assert [event["event"] for event in told].count("text") == 3
    assert {"event": "warning", "message": "é"} in told


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            'print(json.dumps({"event": "error", "message": "a:\\n b"})); sys.exit(2)',
            "a: b",
        ),
        ('print("georef: no such thing", file=sys.stderr); sys.exit(2)', "code 2: no such thing"),
        ("sys.exit(3)", "code 3: it said nothing"),
        ('raise ModuleNotFoundError("No module named georef_gis")', "georef qgis install"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "signal 9"),
    ],
)
@posix
def test_failure_is_one_line(tmp_path: Path, code: str, message: str) -> None:
    outcome, _, _ = run(program(tmp_path, code))
    assert message in outcome.error
    assert "\n" not in outcome.error


def test_program_that_is_not_there_is_named_with_a_cure() -> None:
    outcome, _, _ = run(["/no/such/georef"])
    assert "/no/such/georef" in outcome.error
    assert "georef qgis install" in outcome.error


@posix
@pytest.mark.parametrize("stubborn", [False, True], ids=["obeys", "ignores SIGINT"])
def test_cancel_ends_the_process_and_its_children_within_a_second(
    tmp_path: Path, stubborn: bool
) -> None:
    code = f"""
if {stubborn}:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
print(json.dumps({{"event": "info", "message": f"{{os.getpid()}} {{other.pid}}"}}))
time.sleep(60)
"""
    outcome, told, took = run(program(tmp_path, code), after=1.0)
    assert outcome.cancelled
    numbers = [int(word) for event in told if event["event"] == "info"
               for word in event["message"].split()]  # fmt: skip
    assert len(numbers) == 2
    while any(map(alive, numbers)):
        took += 0.02
        time.sleep(0.02)
        # 1 s until it is cancelled; by themselves they would end after 60
        assert took < 30.0
    assert took < 30.0


@posix
def test_end_is_seen_though_a_child_keeps_the_streams_open(tmp_path: Path) -> None:
    code = 'subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])'
    outcome, _, took = run(program(tmp_path, code))
    assert outcome.error == ""
    # the other one keeps them open for 60 s
    assert took < 30.0


def test_giant_lines_and_broken_bytes_do_not_stop_it(tmp_path: Path) -> None:
    code = """
sys.stdout.buffer.write(b"\\xff\\xfe broken\\n" + b"x" * 3_000_000 + b"\\n")
print(json.dumps({"event": "result"}))
"""
    outcome, told, _ = run(program(tmp_path, code))
    assert outcome.results
    assert max(len(event["message"]) for event in told) == 3_000_000


def test_environment_of_qgis_does_not_reach_georef() -> None:
    given = {"PYTHONHOME": "/q", "PYTHONPATH": "/q", "GDAL_DATA": "/q", "PROJ_LIB": "/q",
             "LD_LIBRARY_PATH": "/q", "QT_PLUGIN_PATH": "/q", "Path": "/bin", "GEOREF_DATA": "/d",
             "__PYVENV_LAUNCHER__": "/q", "HOME": "/h"}  # fmt: skip
    kept = child.clean_environment(given)
    assert set(kept) == {"Path", "GEOREF_DATA", "HOME", "PYTHONUTF8"}


@pytest.mark.parametrize(
    "line",
    [
        "no JSON", "[1]", '{"event": 3}', '{"event": "progress", "fraction": null}', "[" * 100_000,
        '{"event": "result", "summary": null}', '{"event": "result", "outputs": ["a"]}',
        '{"event": "result", "warnings": "w"}',
    ],
    ids=lambda line: line[:40],
)  # fmt: skip
def test_line_that_is_no_event_of_georef_is_shown_as_it_is(line: str) -> None:
    assert child.read_event(line) == {"event": "text", "message": line}


def test_command_is_told_as_it_is_typed_on_each_system() -> None:
    words = ["C:\\Program Files\\python.exe", "--note=it's", "a;b"]
    assert child.typed(words, "win32") == '"C:\\Program Files\\python.exe" --note=it\'s a;b'
    assert shlex.split(child.typed(words, "linux")) == words


def test_windows_shows_no_console_and_posix_makes_a_group_to_be_ended() -> None:
    # CREATE_NO_WINDOW of Windows' CreateProcess
    assert child.start_options("win32") == {"creationflags": 0x08000000}
    assert child.start_options("linux") == {"start_new_session": True}


def test_program_named_with_the_quotes_of_windows_is_found() -> None:
    assert manifest.find_command({}, f' "{sys.executable}" ')[0] == sys.executable


def stub_georef(tmp_path: Path, version: int = 1) -> Path:
    """A program that counts how often it is asked for its tools."""
    path = tmp_path / "georef"
    path.write_text(
        f"#!{sys.executable}\nimport json, pathlib\n"
        f"p = pathlib.Path({str(tmp_path / 'asked')!r})\n"
        "p.write_text(p.read_text() + 'x' if p.exists() else 'x')\n"
        f"print(json.dumps({{'manifest': {version}, 'tools': []}}))\n",
        encoding="utf-8",
    )
    path.chmod(0o755)
    return path


@posix
def test_manifest_is_asked_for_once_until_something_changes(tmp_path: Path) -> None:
    watched = tmp_path / "tool.py"
    watched.write_text("a")
    config = {"watch": [str(watched)]}
    command = manifest.find_command(config, str(stub_georef(tmp_path)))
    cache = tmp_path / "cache" / "manifest.json"
    for _ in range(3):
        assert manifest.load_manifest(command, config, cache)["manifest"] == 1
    assert (tmp_path / "asked").read_text() == "x"
    os.utime(watched, ns=(1, 1))
    manifest.load_manifest(command, config, cache)
    assert (tmp_path / "asked").read_text() == "xx"
    cache.write_text("half of a fi", encoding="utf-8")
    manifest.load_manifest(command, config, cache)
    assert (tmp_path / "asked").read_text() == "xxx"


@posix
def test_manifest_is_read_though_nothing_can_be_kept(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    command = [str(stub_georef(tmp_path))]
    assert manifest.load_manifest(command, {}, tmp_path / "file" / "manifest.json")["tools"] == []


@pytest.mark.parametrize(
    ("config", "chosen", "message"),
    [
        ({}, "", "not known to this plug-in"),
        ({"python": "/gone/python"}, "", "/gone/python: is not there"),
        ({"python": sys.executable}, "/gone/georef", "/gone/georef: is not there"),
    ],
)
def test_georef_that_is_not_there_is_told_with_the_cure(
    config: dict[str, str], chosen: str, message: str
) -> None:
    with pytest.raises(ManifestError, match=message) as told:
        manifest.find_command(config, chosen)
    assert "Settings > Options > Processing" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("code", ["print('no JSON')", "raise SystemExit('oh')", "print('[]')"])
def test_program_that_is_no_georef_is_refused_in_one_line(tmp_path: Path, code: str) -> None:
    with pytest.raises(ManifestError, match="gives no list of tools") as told:
        manifest.load_manifest(program(tmp_path, code), {}, tmp_path / "cache.json")
    assert "\n" not in str(told.value)


def test_own_python_is_run_without_the_folder_it_is_started_in(tmp_path: Path) -> None:
    command = manifest.find_command({"python": sys.executable}, "")
    (tmp_path / "georef_gis").mkdir()
    (tmp_path / "georef_gis/__init__.py").write_text("raise SystemExit('the wrong one')")
    done = subprocess.run([*command, "--version"], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_events_are_those_that_georef_writes(tmp_path: Path) -> None:
    command = manifest.find_command({"python": sys.executable}, "")
    outcome, _, _ = run([*command, "georef:sync_board_list_ports", "--json"])
    assert outcome.error == ""
    assert outcome.results[0]["tool"] == "georef:sync_board_list_ports"
    outcome, _, _ = run([*command, "georef:footprints", f"--project={tmp_path}", "--json"])
    assert "project.toml" in outcome.error
    assert json.dumps(outcome.error).count("\\n") == 0
