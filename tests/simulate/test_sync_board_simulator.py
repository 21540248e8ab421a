"""The simulated sync board keeps the protocol of docs/sync_board.md."""

from __future__ import annotations

import os
import threading
import time
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.simulate.sync_board import (
    BoardSettings,
    PseudoTerminal,
    PwmSettings,
    SimulatedBoard,
    checksum,
    misread,
    serve,
    simulate_pwm_channel,
)

posix = pytest.mark.skipif(os.name != "posix", reason="needs pseudo-terminals")


def framed(body: bytes) -> bytes:
    return b"$%s*%02X\r\n" % (body, reduce(lambda a, b: a ^ b, body))


def test_checksum_is_that_of_a_published_nmea_sentence() -> None:
    # NMEA 0183 sentence with its checksum, as in the manuals of many receivers.
    body = b"GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    assert checksum(body) == b"47"


def test_lines_have_number_gps_time_pulse_and_flags() -> None:
    settings = BoardSettings(start_gps=1550 * 604800.0 + 604799.0, interval=1.5, first=99)
    data = SimulatedBoard(settings).advance(3.1)
    assert data == framed(b"TSB,99,1551,0.500000,1990,1") + framed(b"TSB,100,1551,2.000000,1000,1")


def test_board_without_a_fix_says_so_and_counts_from_power_up() -> None:
    data = SimulatedBoard(BoardSettings(fix_after=2.0)).advance(3.1)
    first, second = data.splitlines(keepends=True)
    assert first == framed(b"TSB,1,0,1.500000,1010,0")
    assert second.split(b",")[2] == b"1550"


def test_shares_of_missed_spurious_flipped_and_lost_are_those_asked_for() -> None:
    settings = BoardSettings(missed=0.1, spurious=0.05, jitter=0.02, flipped=0.01, lost=0.02)
    board = SimulatedBoard(settings, seed=1)
    data = board.advance(1.5 * 4000 + 0.1)
    count = len(board.triggers)
    assert count == pytest.approx(4200, abs=60)
    assert sum(not trigger.sent for trigger in board.triggers) == pytest.approx(400, abs=80)
    assert data.count(b"$TSB,") == sum(trigger.sent for trigger in board.triggers)
    assert [trigger.number for trigger in board.triggers] == list(range(1, count + 1))
    spoilt = board.spoil(data)
    assert 1.0 - len(spoilt) / len(data) == pytest.approx(0.02, abs=0.002)
    only_flipped = SimulatedBoard(BoardSettings(flipped=0.01)).spoil(data)
    both = np.frombuffer(data, np.uint8) ^ np.frombuffer(only_flipped, np.uint8)
    assert np.mean(both != 0) == pytest.approx(0.01, abs=0.0015)
    assert set(both[both != 0].tolist()) <= {1 << bit for bit in range(8)}


def test_same_seed_gives_the_same_bytes() -> None:
    settings = BoardSettings(missed=0.1, spurious=0.1, jitter=0.02, flipped=0.01)
    streams = [
        board.spoil(board.advance(300.0))
        for board in (SimulatedBoard(settings, seed) for seed in (5, 5, 6))
    ]
    assert streams[0] == streams[1] != streams[2]


def test_commands_are_answered_and_done_once() -> None:
    board = SimulatedBoard()
    half = framed(b"TSC,INTERVAL,2.5,7")
    assert board.hear(half[:9], 1.0) == b""
    assert board.hear(half[9:], 1.0) == framed(b"TSA,INTERVAL,7,OK")
    assert board.advance(3.4) == b""
    assert board.advance(3.6).startswith(b"$TSB,1,")
    shot = board.hear(framed(b"TSC,SHUTTER,8"), 4.0)
    answer, line = shot.splitlines(keepends=True)
    assert answer == framed(b"TSA,SHUTTER,8,OK")
    # flags 3: GPS time, and fired by a command
    assert line.split(b"*")[0].endswith(b",3")
    assert board.hear(framed(b"TSC,SHUTTER,8"), 4.1) == answer
    assert len(board.triggers) == 2


@pytest.mark.parametrize(
    ("body", "answer"),
    [
        (b"TSC,INTERVAL,0.2,1", b"TSA,INTERVAL,1,NO,interval must be 0 or 0.5 to 3600 s"),
        (b"TSC,INTERVAL,x,1", b"TSA,INTERVAL,1,NO,interval is no number"),
        (b"TSC,INTERVAL,nan,1", b"TSA,INTERVAL,1,NO,interval must be 0 or 0.5 to 3600 s"),
        (b"TSC,DANCE,1", b"TSA,DANCE,1,NO,unknown command"),
        (b"TSC,FOCUS,1", b"TSA,FOCUS,1,OK"),
    ],
)
def test_command_that_cannot_be_done_is_refused_with_a_reason(body: bytes, answer: bytes) -> None:
    assert SimulatedBoard().hear(framed(body), 1.0) == framed(answer)


@pytest.mark.parametrize("line", [b"$TSC,FOCUS,1*00\r\n", b"TSC,FOCUS,1\r\n", b"\xff\x00\r\n"])
def test_damaged_command_is_not_answered(line: bytes) -> None:
    assert SimulatedBoard().hear(line, 1.0) == b""


def test_interval_0_ends_the_triggers() -> None:
    board = SimulatedBoard()
    board.hear(framed(b"TSC,INTERVAL,0,1"), 1.0)
    assert board.advance(1000.0) == b""


def test_receiver_at_the_right_rate_misreads_nothing() -> None:
    data = bytes(range(256)) * 3
    assert misread(data, 9600, 9600) == data


@posix
def test_board_on_a_pseudo_terminal_runs_as_fast_as_asked(tmp_path: Path) -> None:
    link, stop = tmp_path / "board", threading.Event()
    terminal, board = PseudoTerminal(link), SimulatedBoard()
    assert os.path.realpath(link) == terminal.device
    handle = os.open(link, os.O_RDWR | os.O_NOCTTY)
    thread = threading.Thread(target=serve, args=(board, terminal, stop), kwargs={"speed": 300.0})
    thread.start()
    data, until = b"", time.monotonic() + 5.0
    while data.count(b"\n") < 50 and time.monotonic() < until:
        data += os.read(handle, 4096)
    stop.set()
    thread.join()
    os.close(handle)
    terminal.unplug()
    assert not link.is_symlink()
    assert data.startswith(b"$TSB,1,1550,")
    assert data.count(b"\n") >= 50


@posix
def test_link_does_not_replace_a_file(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("data")
    with pytest.raises(InputError, match="the link cannot be made"):
        PseudoTerminal(tmp_path / "precious")
    assert (tmp_path / "precious").read_text() == "data"


def test_without_pseudo_terminals_the_board_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pty", None)
    with pytest.raises(InputError, match="which Windows has not; use WSL, or a pair of virtual"):
        PseudoTerminal()


def test_pwm_channel_steps_at_the_photos_and_wraps() -> None:
    rng = np.random.default_rng(0)
    photos = np.array([1.0, 2.0, 3.0, 4.0])
    settings = PwmSettings(levels=3, noise=0.0, quantum=0.0)
    time_s, value = simulate_pwm_channel(photos, 5.0, settings, rng)
    for low, high, width in ((0, 1, 1000), (1, 2, 1010), (2, 3, 1020), (3, 4, 1000), (4, 5, 1010)):
        assert set(value[(time_s >= low) & (time_s < high)]) == {width}
