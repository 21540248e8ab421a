"""The tools of the sync board on the command line."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from georef_gis.app import cli
from georef_gis.ingest import serial_port
from georef_gis.ingest.logs.tsb_file import read_tsb
from georef_gis.simulate.sync_board import (
    BoardSettings,
    PseudoTerminal,
    PwmSettings,
    SimulatedBoard,
    serve,
    simulate_pwm_channel,
)
from georef_gis.toolbox.registry import Registry
from processing_algorithms.ingest.sync_board import SYNC_BOARD_TOOLS

posix = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = Registry()
    found.add("georef", SYNC_BOARD_TOOLS, "georef-gis", "1")
    assert found.refused == []
    monkeypatch.setattr(cli, "_registry", lambda: found)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def board() -> Iterator[tuple[SimulatedBoard, str]]:
    stop, made = threading.Event(), SimulatedBoard(BoardSettings(jitter=0.001))
    terminal = PseudoTerminal()
    thread = threading.Thread(target=serve, args=(made, terminal, stop), kwargs={"speed": 50.0})
    thread.start()
    yield made, terminal.device
    stop.set()
    thread.join()
    terminal.unplug()


def call(*words: str) -> Result:
    return CliRunner().invoke(cli.georef, ["sync-board", *words])


@posix
def test_record_writes_log_and_raw_capture_and_counts(board, tmp_path: Path) -> None:
    simulated, port = board
    done = call("record", port, "--duration", "1", "--output", "logs/sync_board.log")
    assert done.exit_code == 0, done.output
    (events,) = read_tsb(tmp_path / "logs" / "sync_board.log").events
    assert f"triggers                     {len(events)}" in done.stdout
    assert len(events) > 15
    # Lines sent before the port was open are not there.
    assert list(np.diff(events.sequence)) == [1] * (len(events) - 1)
    times = np.array([t.time for t in simulated.triggers])[events.sequence - 1]
    assert np.abs(events.time - simulated.settings.start_gps - times).max() < 1e-6
    log = (tmp_path / "logs" / "sync_board.log").read_bytes()
    assert (tmp_path / "logs" / "sync_board.raw").read_bytes().startswith(log)
    assert "doubt" not in done.stdout


@posix
def test_record_in_json_gives_progress_with_count_and_last_time(board) -> None:
    _, port = board
    done = call("record", port, "--duration", "1", "--json")
    events = [json.loads(line) for line in done.stdout.splitlines()]
    progress = [event for event in events if event["event"] == "progress"]
    assert re.fullmatch(r"\d+ triggers, last 1[45]:\d\d:\d\d\.\d UTC", progress[-1]["message"])
    assert events[-1]["summary"]["lost_triggers"] == 0


@posix
def test_send_sets_interval_and_fires_and_says_that_it_was_acknowledged(board) -> None:
    simulated, port = board
    done = call("send", port, "--interval", "900", "--focus", "--shutter")
    assert done.exit_code == 0, done.output
    assert done.stdout.count("acknowledged") == 3
    assert simulated.interval == 900.0
    refused = call("send", port, "--interval", "0.1")
    assert refused.exit_code == 2
    assert refused.stderr == (
        "georef: the board refuses INTERVAL: interval must be 0 or 0.5 to 3600 s\n"
    )


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("send", "nowhere"), "nothing to send; give --interval S, --focus or --shutter"),
        (("send", "/dev/nowhere9", "--focus"), "there is no such port"),
        (("record", "/dev/nowhere9"), "there is no such port"),
        (("record",), "name a port; found: "),
        (("decode", "nothing.csv", "--channel", "a"), "nothing.csv"),
    ],
)
def test_error_is_one_line(words: tuple[str, ...], line: str) -> None:
    done = call(*words)
    assert done.exit_code == 2
    assert line in done.stderr
    assert done.stderr.count("\n") == 1


def test_failed_start_leaves_no_file(tmp_path: Path) -> None:
    call("record", "/dev/nowhere9")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("list-ports",), ("record", "--list-ports")])
def test_ports_are_listed_with_serial_numbers(words, monkeypatch: pytest.MonkeyPatch) -> None:
    port = serial_port.PortInfo(
        device="/dev/ttyUSB7", description="FT232R", vid=0x403, pid=0x6001, serial_number="A9"
    )
    monkeypatch.setattr(serial_port, "list_ports", lambda: (port,))
    shown = call(*words).stdout
    assert "/dev/ttyUSB7  FT232R USB 0403:6001 serial number A9" in shown
    assert "found: /dev/ttyUSB7 FT232R USB" in call("record").stderr


def test_missing_pyserial_is_one_line_with_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "serial", None)
    done = call("list-ports")
    assert done.exit_code == 2
    assert done.stderr == "georef: a serial port needs pyserial; pip install georef-gis[logs]\n"


@posix
def test_simulate_names_its_device_and_counts(tmp_path: Path) -> None:
    done = call("simulate", "--duration", "0.5", "--interval", "1", "--speed", "20",
                "--link", "board")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert done.stderr == "the board is at board; Ctrl-C ends\n"
    assert "lines_sent" in done.stdout
    assert not (tmp_path / "board").is_symlink()


def test_decode_finds_the_photos_of_a_channel(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    truth = np.cumsum(rng.uniform(1.6, 2.8, 40)) + 5.0
    time, value = simulate_pwm_channel(truth, truth[-1] + 5.0, PwmSettings(), rng)
    rows = [f"{1000 * t:.0f},{v:.0f}\n" for t, v in zip(time, value, strict=True)]
    (tmp_path / "recorder.csv").write_text("millis,Servo 3\n" + "".join(rows))
    done = call("decode", "recorder.csv", "--channel", "Servo 3")
    assert done.exit_code == 0, done.output
    assert "photos                       40" in done.stdout
    table = (tmp_path / "sync_board_index.csv").read_text().splitlines()
    assert table[0] == "boot_time_s,event,sigma_time_s,pulse_us,level,steps,confidence"
    found = np.array([float(line.split(",")[0]) for line in table[1:]])
    assert np.abs(found - truth).max() < 0.026
