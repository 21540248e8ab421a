"""The stream of a time-synchronisation board: frames out of bytes, its counter, its commands.

docs/sync_board.md has the protocol.
"""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

from georef_gis.errors import InputError
from georef_gis.ingest.tsb_line import TsbRecord, parse_tsb_line, tsb_checksum

# bytes between `$` and CS; the longest frame of the protocol has 60
LONGEST_FRAME = 120
# Counters wrap after 8, 16 or 32 bits, or after so many decimal digits.
_WRAPS = (100, 256, 1000, 10_000, 65_536, 100_000, 1_000_000, 2**32)
# A wrap may hide at most this many lost lines.
_MOST_LOST_IN_WRAP = 50
# Bytes since the last good frame, and their share that is no text, that name a wrong baud rate.
_SUSPECT_BYTES, _SUSPECT_SHARE = 24, 0.2
# Bytes of text without a good frame: read at half its rate, ASCII looks like text too.
_FOREIGN_BYTES = 120
# characters of the reason of a refusal
_LONGEST_REASON = 80

_FRAME = re.compile(rb"\$([^$*\r\n]{1,%d})\*([0-9A-Fa-f]{2})" % LONGEST_FRAME)
_BEGUN = re.compile(rb"\$(?:[^$*\r\n]{0,%d}|[^$*\r\n]{1,%d}\*[0-9A-Fa-f]?)\Z"
                    % (LONGEST_FRAME, LONGEST_FRAME))  # fmt: skip
_TEXT = frozenset(range(32, 127)) | {9, 10, 13}

FrameKind = Literal["trigger", "answer", "other", "damaged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame `$...*CS`.

    Parameters
    ----------
    kind
        "damaged": the checksum or the content is wrong; "other": a good frame of another talker.
    line
        The frame without its line end.
    record
        Of a trigger.
    """

    kind: FrameKind
    line: bytes
    record: TsbRecord | None = None

    @property
    def talker(self) -> str:
        """First field, e.g. ``TSB`` or ``GPGGA``."""
        return self.line[1:].split(b",")[0].split(b"*")[0].decode("ascii", "replace")

    @property
    def fields(self) -> tuple[str, ...]:
        """All fields, the first included."""
        body = self.line[1:].rpartition(b"*")[0]
        return tuple(body.decode("ascii", "replace").split(","))


@dataclass(slots=True)
class Framer:
    """Cuts a stream of bytes into frames; needs no line ends, keeps no more than one frame.

    Attributes
    ----------
    frames
        Good and damaged frames by kind.
    talkers
        Good frames of others, by their first field.
    garbage
        Bytes that belong to no frame.
    partial
        Frames that were begun and never ended.
    unfit
        Bytes that are no text since the last good frame, of `since_good` garbage bytes.
    """

    frames: Counter[str] = field(default_factory=Counter)
    talkers: Counter[str] = field(default_factory=Counter)
    garbage: int = 0
    partial: int = 0
    since_good: int = 0
    unfit: int = 0
    _rest: bytes = b""

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Frames that end in the bytes so far."""
        data = self._rest + data
        self._rest = b""
        at = 0
        for match in _FRAME.finditer(data):
            self._drop(data[at : match.start()])
            at = match.end()
            frame = _frame(match)
            self.frames[frame.kind] += 1
            if frame.kind == "damaged":
                self._count_unfit(frame.line)
            else:
                self.since_good = self.unfit = 0
            if frame.kind == "other":
                self.talkers[frame.talker] += 1
            yield frame
        begun = _BEGUN.search(data, at)
        end = begun.start() if begun else len(data)
        self._drop(data[at:end])
        self._rest = data[end:]

    def break_off(self) -> None:
        """Give up what is begun: the stream was interrupted."""
        self._drop(self._rest)
        self._rest = b""

    def wrong_baud_likely(self) -> bool:
        """Whether what came since the last good frame looks like another baud rate."""
        return self.since_good >= _SUSPECT_BYTES and self.unfit > _SUSPECT_SHARE * self.since_good

    def foreign_text_likely(self) -> bool:
        """Whether text comes that has no good frame: half the baud rate, or another device."""
        return self.since_good >= _FOREIGN_BYTES and not self.wrong_baud_likely()

    def _drop(self, data: bytes) -> None:
        rubbish = data.strip(b"\r\n")
        if not rubbish:
            return
        self.garbage += len(rubbish)
        self.partial += rubbish.count(b"$")
        self._count_unfit(rubbish)

    def _count_unfit(self, data: bytes) -> None:
        self.since_good += len(data)
        self.unfit += sum(byte not in _TEXT for byte in data)


def _frame(match: re.Match[bytes]) -> Frame:
    line, body = match[0], match[1]
    if tsb_checksum(body) != int(match[2], 16):
        return Frame(kind="damaged", line=line)
    talker = body.split(b",")[0]
    if talker == b"TSB":
        record = parse_tsb_line(line)
        return Frame(kind="trigger" if record else "damaged", line=line, record=record)
    return Frame(kind="answer" if talker == b"TSA" else "other", line=line)


@dataclass(slots=True)
class SequenceWatch:
    """Follows the counter of triggers and says what is wrong with it.

    Attributes
    ----------
    lost
        Lines that are missing by the counter.
    restarts
        Times the counter began anew: the board had no power, or was reset.
    repeated
        Lines with the number of the line before.
    wraps
        Times the counter came to its end and went on.
    backwards
        Lines whose GPS time lies before that of the line before.
    """

    lost: int = 0
    restarts: int = 0
    repeated: int = 0
    wraps: int = 0
    backwards: int = 0
    last: TsbRecord | None = None

    def see(self, record: TsbRecord) -> str:
        """Take the next line; gives a sentence if something is wrong, else ''."""
        before, self.last = self.last, record
        if before is None or record.seq == before.seq + 1:
            return self._check_time(before, record)
        if record.seq == before.seq:
            self.repeated += 1
            return f"trigger {record.seq} came twice"
        if record.seq > before.seq:
            lost = record.seq - before.seq - 1
            self.lost += lost
            return f"{_lines(lost)} lost between triggers {before.seq} and {record.seq}"
        wrap_lost = _lost_in_wrap(before.seq, record.seq)
        if wrap_lost is not None:
            self.wraps += 1
            self.lost += wrap_lost
            lost_text = f", {_lines(wrap_lost)} lost" if wrap_lost else ""
            return f"the counter wrapped from {before.seq} to {record.seq}{lost_text}"
        self.restarts += 1
        return (
            f"the counter fell from {before.seq} to {record.seq}: the board restarted, so test "
            "shots and lost lines in between are unknown"
        )

    def _check_time(self, before: TsbRecord | None, record: TsbRecord) -> str:
        if before is None or not (before.has_gps_time and record.has_gps_time):
            return ""
        if (record.gps_week, record.tow_s) >= (before.gps_week, before.tow_s):
            return ""
        self.backwards += 1
        return f"the time of trigger {record.seq} lies before that of trigger {before.seq}"


def _lines(count: int) -> str:
    return f"{count} line{'s' if count != 1 else ''}"


def _lost_in_wrap(before: int, after: int) -> int | None:
    """Lines lost between two counts across a wrap, to 0 or to 1; None if it is no wrap."""
    if after > _MOST_LOST_IN_WRAP:
        return None
    for modulus in _WRAPS:
        missing = modulus - 1 - before
        if 0 <= missing <= min(_MOST_LOST_IN_WRAP, modulus // 50):
            # A counter that begins with 1 skips 0.
            return missing + max(after - 1, 0)
    return None


CommandName = Literal["INTERVAL", "FOCUS", "SHUTTER"]


class Port(Protocol):
    """What sending needs of a port."""

    def read(self) -> bytes:
        """Bytes that came."""

    def write(self, data: bytes) -> None:
        """Send bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A command to the board.

    Parameters
    ----------
    number
        0..9999; a board that gets the same number again answers again and does nothing: a lost
        answer must not fire the shutter twice.
    value
        Of INTERVAL: s between triggers, 0 = none.
    """

    name: CommandName
    number: int
    value: float | None = None

    def line(self) -> bytes:
        """Frame with its line end."""
        value = "" if self.value is None else f"{self.value:.3f}".rstrip("0").rstrip(".") + ","
        body = f"TSC,{self.name},{value}{self.number}".encode("ascii")
        return b"$" + body + b"*%02X\r\n" % tsb_checksum(body)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """Answer of the board: done, or the reason why not."""

    accepted: bool
    reason: str = ""
    attempts: int = 1


def new_number() -> int:
    """Number for a command that the last ones are unlikely to have had."""
    return int.from_bytes(os.urandom(4), "big") % 10_000


def send_command(
    port: Port,
    command: Command,
    *,
    timeout: float = 1.0,
    attempts: int = 3,
    sink: Callable[[bytes], None] | None = None,
) -> Answer:
    """Send a command and wait for its answer.

    Parameters
    ----------
    timeout : s
        For one attempt.
    attempts
        How often it is sent, each time with the same number.
    sink
        Is given every byte that comes meanwhile: triggers must not be lost.

    Raises
    ------
    InputError
        If the board refuses, with its reason, or does not answer.
    """
    framer = Framer()
    for attempt in range(1, attempts + 1):
        port.write(command.line())
        until = time.monotonic() + timeout
        while time.monotonic() < until:
            data = port.read()
            if sink is not None and data:
                sink(data)
            for frame in framer.feed(data):
                answer = _answer(frame, command, attempt)
                if answer is not None and answer.accepted:
                    return answer
                if answer is not None:
                    raise InputError(
                        f"the board refuses {command.name}: {answer.reason or 'no reason given'}"
                    )
    raise InputError(_no_answer(framer, command, timeout * attempts))


def _answer(frame: Frame, command: Command, attempt: int) -> Answer | None:
    """Answer that a frame holds, if it is of this command: `$TSA,name,number,OK|NO[,reason]`."""
    words = frame.fields
    if frame.kind != "answer" or words[1:3] != (command.name, str(command.number)):
        return None
    if len(words) < 4 or words[3] not in ("OK", "NO"):
        return None
    reason = ",".join(words[4:])[:_LONGEST_REASON]
    return Answer(accepted=words[3] == "OK", reason=reason, attempts=attempt)


def _no_answer(framer: Framer, command: Command, waited: float) -> str:
    said = f"the board did not answer {command.name} in {waited:g} s"
    if framer.wrong_baud_likely() or framer.foreign_text_likely():
        return f"{said} and sends no line of ours: the baud rate seems wrong; try another --baud"
    if framer.frames["trigger"]:
        return f"{said}, though its triggers arrive: look at the wire from TX here to RX there"
    if framer.frames["other"]:
        names = ", ".join(sorted(framer.talkers))
        return f"{said}; what talks there is no sync board ({names}); name another port"
    return f"{said}; look at power, port and baud rate, and whether TX and RX are crossed"
