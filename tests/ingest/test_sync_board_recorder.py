"""Recording from a port: nothing lost, and every trouble named. The port is a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.ingest import sync_board_files
from georef_gis.ingest.logs.tsb_file import read_tsb
from georef_gis.ingest.serial_port import PortInfo, PortLostError, find_again, list_ports, open_port
from georef_gis.ingest.sync_board_files import GrowingFile, Spool, free_names
from georef_gis.ingest.sync_board_recorder import Recorder, RecorderSettings, Recording
from georef_gis.simulate.sync_board import (
    BoardSettings,
    PseudoTerminal,
    SimulatedBoard,
    misread,
    serve,
)

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")


@pytest.fixture
def terminal() -> Iterator[PseudoTerminal]:
    made = PseudoTerminal()
    yield made
    made.unplug()


class Desk:
    """A recorder, what it said, and ways to wait."""

    def __init__(self, folder: Path, port: str, **more) -> None:
        self.said: list[str] = []
        own = {key: more.pop(key) for key in ("opener", "finder") if key in more}
        self.log, self.raw = folder / "sync_board.log", folder / "sync_board.raw"
        self.settings = RecorderSettings(port=port, log=self.log, raw=self.raw, **more)
        self.recorder = Recorder(self.settings, self.said.append, **own)

    def wait(self, done: Callable[[Recording], bool], timeout: float = 5.0) -> Recording:
        until = time.monotonic() + timeout
        while time.monotonic() < until:
            state = self.recorder.poll()
            if done(state):
                return state
            time.sleep(0.01)
        raise AssertionError(f"not in {timeout} s: {state.line()}, {self.said}")


def lines_of(board: SimulatedBoard, first: int, count: int) -> bytes:
    return b"".join(board.line(n % 65536, 0.01 * n) for n in range(first, first + count))


@pytest.mark.slow
def test_hours_of_lines_arrive_whole_in_bounded_memory(tmp_path: Path, terminal) -> None:
    """2 MB: as much as 115 200 baud carry in 3 min, or one line a second in 14 h."""
    board = SimulatedBoard()
    desk = Desk(tmp_path, terminal.device)
    desk.recorder.start()
    blocks = [lines_of(board, first, 1000) for first in range(30_000, 80_000, 1000)]
    tracemalloc.start()
    try:
        for block in blocks:
            assert terminal.write(block) == len(block)
        desk.wait(lambda state: state.triggers == 50_000, 60.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    state = desk.recorder.stop()
    sent = b"".join(blocks)
    assert desk.raw.read_bytes() == sent
    assert desk.log.read_bytes() == sent
    assert (state.sequence.lost, state.framer.garbage, state.framer.frames["damaged"]) == (0, 0, 0)
    assert state.sequence.wraps == 1
    assert peak < 8e6


def test_writer_slower_than_the_port_loses_nothing(tmp_path: Path, terminal, monkeypatch) -> None:
    write = os.write

    def slow(handle: int, data: bytes) -> int:
        if threading.current_thread() is desk.recorder._writer:
            time.sleep(0.15)
            return write(handle, data[:20_000])
        return write(handle, data)

    desk = Desk(tmp_path, terminal.device)
    monkeypatch.setattr(sync_board_files.os, "write", slow)
    desk.recorder.start()
    sent = lines_of(SimulatedBoard(), 1, 3000)
    begun = time.monotonic()
    terminal.write(sent)
    taken_in = time.monotonic() - begun
    state = desk.recorder.stop()
    whole = time.monotonic() - begun
    assert desk.raw.read_bytes() == sent == desk.log.read_bytes()
    assert state.triggers == 3000
    # The port was read while the writer slept: the board did not have to wait for it.
    assert taken_in < 0.5 * whole
    assert desk.recorder.spool.peak > 20_000


def test_damaged_lines_stay_out_of_the_log_and_in_the_raw_capture(tmp_path: Path, terminal) -> None:
    board = SimulatedBoard(BoardSettings(flipped=0.003, lost=0.003), seed=4)
    desk = Desk(tmp_path, terminal.device)
    desk.recorder.start()
    lines = [board.line(n, 1.5 * n) for n in range(600)]
    spoilt = [board.spoil(line) for line in lines]
    terminal.write(b"".join(spoilt))
    desk.wait(lambda state: state.bytes_read == len(b"".join(spoilt)))
    state = desk.recorder.stop()
    assert desk.raw.read_bytes() == b"".join(spoilt)
    logged = desk.log.read_bytes().splitlines(keepends=True)
    intact = [line for line, got in zip(lines, spoilt, strict=True) if line == got]
    # Two flips may cancel in the exclusive or; more than one of 600 lines would be a fault.
    assert len(set(logged) - set(lines)) <= 1
    assert set(intact) <= set(logged)
    assert state.sequence.lost > 50
    told = "; ".join(state.doubts(115200))
    assert f"triggers missing by their counter: {state.sequence.lost}" in told
    assert "lines with a wrong checksum" in told
    assert any("a damaged line was left out" in sentence for sentence in desk.said)


@pytest.mark.parametrize(("sent", "read"), [(57600, 115200), (9600, 115200), (115200, 57600)])
def test_wrong_baud_rate_is_told_with_rates_to_try(
    tmp_path: Path, terminal, sent: int, read: int
) -> None:
    desk = Desk(tmp_path, terminal.device, baud=read)
    desk.recorder.start()
    terminal.write(misread(lines_of(SimulatedBoard(), 1, 20), sent, read))
    desk.wait(lambda state: state.wrong_baud)
    state = desk.recorder.stop()
    (said,) = [sentence for sentence in desk.said if "Bd" in sentence]
    assert f"{read} Bd seems wrong; try --baud " in said
    assert str(sent) in said
    assert [doubt for doubt in state.doubts(read) if f"{read} Bd seems wrong" in doubt]
    assert desk.log.read_bytes() == b""


def test_silence_is_told_once_and_its_end_too(tmp_path: Path, terminal) -> None:
    desk = Desk(tmp_path, terminal.device, silence=0.15)
    desk.recorder.start()
    desk.wait(lambda _: bool(desk.said))
    desk.wait(lambda _: True)
    assert len(desk.said) == 1
    assert f"nothing has come from {terminal.device}" in desk.said[0]
    assert "TX and RX" in desk.said[0]
    terminal.write(SimulatedBoard().line(1, 0.0))
    desk.wait(lambda _: "the board is heard again" in desk.said)
    assert desk.recorder.stop().triggers == 1


def test_other_device_on_the_port_is_named(tmp_path: Path, terminal) -> None:
    desk = Desk(tmp_path, terminal.device)
    desk.recorder.start()
    terminal.write(b"$GPGGA,1*4B\r\n" * 30)
    desk.wait(lambda state: state.framer.talkers["GPGGA"] == 30)
    doubts = desk.recorder.stop().doubts(115200)
    assert doubts == ["other devices talk on this port: 30 of GPGGA", "no trigger arrived"]


def test_unplugged_port_is_waited_for_and_the_gap_is_told(tmp_path: Path) -> None:
    link = tmp_path / "board"
    board = SimulatedBoard()
    first = PseudoTerminal(link)
    desk = Desk(tmp_path, str(link))
    desk.recorder.start()
    before = lines_of(board, 1, 5)
    first.write(before + b"$TSB,6,15")
    desk.wait(lambda state: state.bytes_read == len(before) + 9)
    first.unplug()
    desk.wait(lambda state: not state.connected)
    assert "waiting for it to come back" in desk.said[-1]
    assert desk.recorder.poll().line().startswith("PORT GONE, 5 triggers")
    second = PseudoTerminal(link)
    try:
        desk.wait(lambda state: state.connected)
        after = b"50,1.0,1000,1*33\r\n" + lines_of(board, 9, 5)
        second.write(after)
        desk.wait(lambda state: state.triggers == 10)
    finally:
        state = desk.recorder.stop()
        second.unplug()
    assert desk.raw.read_bytes() == before + b"$TSB,6,15" + after
    assert desk.log.read_bytes() == before + lines_of(board, 9, 5)
    assert (state.interruptions, state.sequence.lost) == (1, 3)
    assert 0.0 < state.away_s < 5.0
    assert any("the port is back after" in sentence for sentence in desk.said)


def test_port_that_comes_back_under_another_name_is_found_by_its_serial_number(
    tmp_path: Path,
) -> None:
    here = PortInfo(device="/dev/ttyUSB0", vid=0x403, pid=0x6001, serial_number="A7")
    twin = PortInfo(device="/dev/ttyUSB0", vid=0x403, pid=0x6001, serial_number="B8")
    back = PortInfo(device="/dev/ttyUSB3", vid=0x403, pid=0x6001, serial_number="A7")
    assert find_again(here, "/dev/ttyUSB0", [twin]) is None
    assert find_again(here, "/dev/ttyUSB0", [twin, back]) == "/dev/ttyUSB3"
    plain = PortInfo(device="/dev/ttyUSB0", vid=0x403, pid=0x6001, location="1-2")
    moved = PortInfo(device="/dev/ttyUSB1", vid=0x403, pid=0x6001, location="1-2")
    other = PortInfo(device="/dev/ttyUSB0", vid=0x403, pid=0x6001, location="1-9")
    assert find_again(plain, "/dev/ttyUSB0", [other, moved]) == "/dev/ttyUSB1"
    assert find_again(plain, "/dev/ttyUSB0", [moved, other]) == "/dev/ttyUSB1"
    assert find_again(plain, "/dev/ttyUSB0", []) is None
    file = tmp_path / "tty"
    assert find_again(PortInfo(device=str(file)), str(file), []) is None
    file.touch()
    assert find_again(PortInfo(device=str(file)), str(file), []) == str(file)


def test_interval_is_told_to_the_board_at_every_connection(tmp_path: Path) -> None:
    link, stop, boards = tmp_path / "board", threading.Event(), []

    def plug() -> tuple[PseudoTerminal, threading.Thread]:
        boards.append(SimulatedBoard(BoardSettings(interval=900.0)))
        terminal = PseudoTerminal(link)
        thread = threading.Thread(target=serve, args=(boards[-1], terminal, stop))
        thread.start()
        return terminal, thread

    terminal, thread = plug()
    desk = Desk(tmp_path, str(link), interval=2.0)
    desk.recorder.start()
    assert boards[0].interval == 2.0
    stop.set()
    thread.join()
    terminal.unplug()
    desk.wait(lambda state: not state.connected)
    stop.clear()
    terminal, thread = plug()
    try:
        desk.wait(lambda state: state.connected)
        assert boards[1].interval == 2.0
    finally:
        desk.recorder.stop()
        stop.set()
        thread.join()
        terminal.unplug()
    assert desk.raw.read_bytes().count(b"$TSA,INTERVAL,") == 2


def test_refused_bytes_of_a_full_disk_are_kept_and_written_later(tmp_path, monkeypatch) -> None:
    file = GrowingFile(tmp_path / "a.raw")
    write, full = os.write, True

    def on_full_disk(handle: int, data: bytes) -> int:
        if full:
            raise OSError(28, "No space left on device")
        return write(handle, data[:3])

    monkeypatch.setattr(sync_board_files.os, "write", on_full_disk)
    file.write(b"abc")
    file.write(b"defgh")
    assert (file.waiting, file.problem) == (8, "No space left on device")
    full = False
    file.write(b"i")
    file.close()
    assert (tmp_path / "a.raw").read_bytes() == b"abcdefghi"
    assert file.problem == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_disk_that_stays_full_is_told_and_is_an_error_at_the_end(tmp_path, terminal) -> None:
    desk = Desk(tmp_path, terminal.device)
    desk.log.symlink_to("/dev/full")
    desk.recorder.start()
    terminal.write(lines_of(SimulatedBoard(), 1, 3))
    desk.wait(lambda _: any("No space left" in sentence for sentence in desk.said))
    with pytest.raises(InputError, match=r"\d+ bytes could not be written \(No space left"):
        desk.recorder.stop()
    assert desk.raw.read_bytes() == lines_of(SimulatedBoard(), 1, 3)


def test_bug_in_the_writer_ends_the_recording_loudly(tmp_path, terminal, monkeypatch) -> None:
    desk = Desk(tmp_path, terminal.device)
    monkeypatch.setattr(Recorder, "_line_of", lambda self, frame: 1 / 0)
    desk.recorder.start()
    terminal.write(lines_of(SimulatedBoard(), 1, 3))
    with pytest.raises(ZeroDivisionError):
        desk.wait(lambda _: False)
    with pytest.raises(ZeroDivisionError):
        desk.recorder.stop()
    assert desk.raw.read_bytes() == lines_of(SimulatedBoard(), 1, 3)


def test_full_spool_makes_the_reader_wait_and_keeps_the_order() -> None:
    spool = Spool(largest=1000)
    data = [bytes([n % 251]) * 97 for n in range(200)]
    thread = threading.Thread(target=lambda: [spool.put(piece) for piece in data])
    thread.start()
    got = b""
    while len(got) < 97 * 200:
        got += b"".join(piece or b"" for piece in spool.take(0.5))
    thread.join()
    assert got == b"".join(data)
    assert spool.peak < 1000 + 97


def test_log_that_is_there_is_never_touched(tmp_path: Path) -> None:
    log = tmp_path / "sync_board.log"
    assert free_names(log) == (log, tmp_path / "sync_board.raw")
    log.touch()
    assert free_names(log)[0] == log
    (tmp_path / "sync_board.raw").write_bytes(b"x")
    assert [path.name for path in free_names(log)] == ["sync_board_2.log", "sync_board_2.raw"]
    with pytest.raises(InputError, match=r"ends in \.raw"):
        free_names(tmp_path / "a.raw")


def test_port_that_does_not_open_says_why(tmp_path: Path, terminal) -> None:
    with pytest.raises(InputError, match=r"nothing0: there is no such port; ports found: "):
        open_port("/dev/nothing0")
    plain = tmp_path / "file"
    plain.touch()
    with pytest.raises(InputError, match="is no serial port"):
        open_port(str(plain))
    first = open_port(terminal.device)
    with pytest.raises(InputError, match="is in use by another program"):
        open_port(terminal.device)
    terminal.unplug()
    with pytest.raises(PortLostError, match="the port is gone"):
        first.read()
    first.close()
    assert all(port.device for port in list_ports())


SCRIPT = """
import sys
from pathlib import Path
from processing_algorithms.ingest.sync_board import SYNC_BOARD_TOOLS
from georef_gis.app import cli
from georef_gis.toolbox.registry import Registry
registry = Registry()
registry.add("georef", SYNC_BOARD_TOOLS, "georef-gis", "1")
assert not registry.refused, registry.refused
cli._registry = lambda: registry
cli.main()
"""


@contextlib.contextmanager
def recording(folder: Path, port: str, *words: str) -> Iterator[subprocess.Popen[str]]:
    """`georef sync-board record` in a process of its own, when it has begun."""
    command = [sys.executable, "-c", SCRIPT, "sync-board", "record", port, *words]
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        assert process.stderr.readline().startswith(f"recording {port} at 115200 Bd")
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for(path: Path, size: int) -> None:
    until = time.monotonic() + 10.0
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < until, "nothing arrives"
        time.sleep(0.02)


@pytest.mark.slow
def test_ctrl_c_ends_with_a_summary_and_kill_9_loses_no_line(tmp_path: Path, terminal) -> None:
    sent = lines_of(SimulatedBoard(), 1, 40)
    with recording(tmp_path, terminal.device) as process:
        terminal.write(sent)
        wait_for(tmp_path / "sync_board.log", len(sent))
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=10)
        assert process.returncode == 0
    assert "wrote  sync_board.log" in out
    assert "triggers                     40" in out
    assert "last_trigger                 14:59:45.4 UTC" in out
    with recording(tmp_path, terminal.device) as process:
        terminal.write(sent + b"$TSB,41,1")
        wait_for(tmp_path / "sync_board_2.raw", len(sent) + 9)
        wait_for(tmp_path / "sync_board_2.log", len(sent))
        process.kill()
        process.wait()
    for name in ("sync_board.log", "sync_board_2.log"):
        assert (tmp_path / name).read_bytes() == sent
    assert (tmp_path / "sync_board_2.raw").read_bytes() == sent + b"$TSB,41,1"
    (events,) = read_tsb(tmp_path / "sync_board_2.log").events
    assert list(events.sequence) == list(range(1, 41))
