"""Frames out of a stream, the counter of triggers, and commands."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.sync_board import (
    LONGEST_FRAME,
    Command,
    Framer,
    SequenceWatch,
    send_command,
)
from georef_gis.ingest.tsb_line import TsbRecord
from georef_gis.simulate.sync_board import BoardSettings, SimulatedBoard, misread

RATES = (4800, 9600, 19200, 38400, 57600, 115200, 230400)


def stream(count: int, **settings: float) -> tuple[SimulatedBoard, bytes]:
    board = SimulatedBoard(BoardSettings(**settings))  # type: ignore[arg-type]
    return board, board.advance(count * board.interval + 0.1)


def seqs(framer: Framer, data: bytes) -> list[int]:
    return [frame.record.seq for frame in framer.feed(data) if frame.record]


@given(st.lists(st.integers(1, 50), min_size=1, max_size=40))
def test_frames_are_the_same_however_the_bytes_arrive(cuts: list[int]) -> None:
    _, data = stream(20)
    framer, found, at = Framer(), [], 0
    for cut in [*cuts, len(data)]:
        found += seqs(framer, data[at : at + cut])
        at += cut
    assert found == list(range(1, 21))
    assert (framer.garbage, framer.partial) == (0, 0)


def test_intact_lines_all_pass_and_no_damaged_one_does() -> None:
    intact_found = 0
    for seed in range(20):
        board = SimulatedBoard(BoardSettings(flipped=0.002, lost=0.002), seed)
        lines = [board.line(n, 1.5 * n) for n in range(500)]
        spoilt = [board.spoil(line) for line in lines]
        framer = Framer()
        found = [frame.line for frame in framer.feed(b"".join(spoilt)) if frame.record]
        whole = {line.strip() for line in lines}
        intact = {line.strip() for line, got in zip(lines, spoilt, strict=True) if line == got}
        # The exclusive or lets two equal flips through: a few in 10 000 lines, never more.
        assert len(set(found) - whole) <= 1
        assert intact <= set(found)
        intact_found += len(intact)
        assert framer.frames["damaged"] + framer.partial > 20
    assert intact_found > 8000


def test_two_frames_without_line_end_and_text_between_are_found() -> None:
    _, data = stream(3)
    first, second, third = data.split()
    framer = Framer()
    assert seqs(framer, b"MOD5213 v1\r\n" + first + second + b"$TSB,9,15" + third) == [1, 2, 3]
    assert framer.partial == 1
    assert framer.garbage == len(b"MOD5213 v1") + len(b"$TSB,9,15")


def test_endless_frame_is_given_up_and_memory_stays_bounded() -> None:
    framer = Framer()
    for _ in range(1000):
        assert list(framer.feed(b"$TSB" + b"1" * 2000)) == []
        assert len(framer._rest) <= LONGEST_FRAME + 4
    _, data = stream(1)
    assert seqs(framer, data) == [1]
    assert framer.partial == 1000
    assert framer.garbage == 1000 * 2004


def test_frame_is_not_continued_across_an_interruption() -> None:
    _, data = stream(1)
    framer = Framer()
    assert seqs(framer, data[:15]) == []
    framer.break_off()
    assert seqs(framer, data[15:]) == []
    assert framer.partial == 1


@pytest.mark.parametrize("sent", RATES)
@pytest.mark.parametrize("read", RATES)
def test_wrong_baud_rate_is_named_within_forty_triggers(sent: int, read: int) -> None:
    _, data = stream(40)
    arrived = misread(data, sent, read)
    framer = Framer()
    found = seqs(framer, arrived)
    if sent == read:
        assert arrived == data
        assert found == list(range(1, 41))
    else:
        assert found == []
    suspected = framer.wrong_baud_likely() or framer.foreign_text_likely()
    assert suspected == (sent != read)


def test_noise_between_good_lines_is_no_wrong_baud_rate() -> None:
    board, _ = stream(0, flipped=0.02)
    framer = Framer()
    for number in range(2000):
        list(framer.feed(board.spoil(board.line(number, 1.5 * number))))
        assert not framer.wrong_baud_likely()
    assert framer.frames["damaged"] > 500


def watch(*numbers: int) -> tuple[SequenceWatch, list[str]]:
    seen = SequenceWatch()
    said = [
        seen.see(TsbRecord(seq=n, gps_week=1550, tow_s=100.0 + i, pulse_us=1500, flags=1))
        for i, n in enumerate(numbers)
    ]
    return seen, [sentence for sentence in said if sentence]


@pytest.mark.parametrize(
    ("numbers", "lost", "wraps", "restarts", "repeated"),
    [
        ((5, 6, 7), 0, 0, 0, 0),
        ((5, 6, 9), 2, 0, 0, 0),
        ((254, 255, 0, 1), 0, 1, 0, 0),
        ((254, 255, 1, 2), 0, 1, 0, 0),
        ((65534, 65535, 0), 0, 1, 0, 0),
        ((65534, 2), 2, 1, 0, 0),
        ((99, 0), 0, 1, 0, 0),
        ((40, 41, 0, 1), 0, 0, 1, 0),
        ((40, 41, 1), 0, 0, 1, 0),
        ((7, 7, 8), 0, 0, 0, 1),
    ],
)
def test_counter(numbers, lost: int, wraps: int, restarts: int, repeated: int) -> None:
    seen, said = watch(*numbers)
    assert (seen.lost, seen.wraps, seen.restarts, seen.repeated) == (
        lost,
        wraps,
        restarts,
        repeated,
    )
    assert len(said) == bool(lost) + bool(wraps and not lost) + restarts + repeated


def test_time_that_goes_back_is_told() -> None:
    seen = SequenceWatch()
    for seq, tow in ((1, 10.0), (2, 9.0)):
        said = seen.see(TsbRecord(seq=seq, gps_week=1550, tow_s=tow, pulse_us=1500, flags=1))
    assert seen.backwards == 1
    assert said == "the time of trigger 2 lies before that of trigger 1"


class Wire:
    """A port whose other end is a board; answers may get lost, triggers come in between."""

    def __init__(self, board: SimulatedBoard, deaf: int = 0, mute: int = 0) -> None:
        self.board, self.deaf, self.mute = board, deaf, mute
        self.sent: list[bytes] = []
        self.waiting = b""

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if len(self.sent) <= self.deaf:
            return
        answer = self.board.hear(data, 10.0)
        self.waiting += b"" if len(self.sent) <= self.mute else answer

    def read(self) -> bytes:
        out, self.waiting = self.waiting[:7], self.waiting[7:]
        return out


def test_interval_command_is_sent_acknowledged_and_obeyed() -> None:
    board = SimulatedBoard()
    wire = Wire(board)
    answer = send_command(wire, Command(name="INTERVAL", number=17, value=2.5), timeout=0.05)
    assert wire.sent == [b"$TSC,INTERVAL,2.5,17*58\r\n"]
    assert (answer.accepted, answer.attempts) == (True, 1)
    assert board.interval == 2.5


def test_lost_answer_does_not_fire_the_shutter_twice() -> None:
    board = SimulatedBoard()
    wire = Wire(board, mute=2)
    heard: list[bytes] = []
    command = Command(name="SHUTTER", number=3)
    answer = send_command(wire, command, timeout=0.02, sink=heard.append)
    assert answer.attempts == 3
    assert len(board.triggers) == 1
    assert b"$TSA,SHUTTER,3,OK*" in b"".join(heard)


def test_refusal_has_the_reason_of_the_board() -> None:
    wire = Wire(SimulatedBoard())
    with pytest.raises(InputError, match=r"refuses INTERVAL: interval must be 0 or 0.5 to 3600 s"):
        send_command(wire, Command(name="INTERVAL", number=1, value=0.1), timeout=0.05)
    assert len(wire.sent) == 1


def test_answer_to_another_command_is_not_taken() -> None:
    wire = Wire(SimulatedBoard(), deaf=9)
    wire.waiting = b"$TSA,FOCUS,4,OK*%s\r\n" % b"00" + b"$TSA,FOCUS,5,OK*17\r\n"
    with pytest.raises(InputError, match=r"did not answer FOCUS in 0.06 s"):
        send_command(wire, Command(name="FOCUS", number=4), timeout=0.02)
    assert len(wire.sent) == 3


@pytest.mark.parametrize(
    ("waiting", "words"),
    [
        (b"", "look at power, port and baud rate"),
        (bytes(range(128, 200)), "the baud rate seems wrong"),
        (stream(1)[1], "look at the wire from TX here"),
        (b"$GPGGA,1*4B\r\n", r"no sync board \(GPGGA\)"),
    ],
)
def test_silence_after_a_command_names_its_likely_cause(waiting: bytes, words: str) -> None:
    wire = Wire(SimulatedBoard(), deaf=9)
    wire.waiting = waiting
    with pytest.raises(InputError, match=words):
        send_command(wire, Command(name="FOCUS", number=4), timeout=0.02)


def test_truth_of_the_simulated_board_is_what_is_read() -> None:
    board, data = stream(400, missed=0.05, spurious=0.02, jitter=0.01, wrap=256, first=200)
    framer, seen = Framer(), SequenceWatch()
    records = [frame.record for frame in framer.feed(data) if frame.record]
    for record in records:
        seen.see(record)
    assert [r.seq for r in records] == [t.number for t in board.triggers if t.sent]
    between = board.triggers[: 1 + max(i for i, t in enumerate(board.triggers) if t.sent)]
    assert seen.lost == Counter(t.sent for t in between)[False]
    assert seen.wraps == (200 + len(board.triggers) - 1) // 256
    tow = board.settings.start_gps % 604800
    times = np.array([t.time for t in board.triggers if t.sent])
    assert np.abs(np.array([r.tow_s for r in records]) - tow - times).max() < 1e-6


def test_lines_shown_in_the_docs_are_good() -> None:
    text = (Path(__file__).parents[2] / "docs" / "sync_board.md").read_text("utf-8")
    (shown,) = re.findall(r"\$TSB,\d\S+", text)
    (frame,) = Framer().feed(shown.encode())
    assert frame.record is not None
    assert (frame.record.seq, frame.record.pulse_us, frame.record.flags) == (412, 1120.0, 1)
    for bit in ("| 0 | 1 |", "| 1 | 2 |"):
        assert bit in text
    for name in ("INTERVAL,seconds,", "FOCUS,", "SHUTTER,"):
        assert f"$TSC,{name}number*CS" in text
