"""A time-synchronisation board that does not exist: its lines, its mistakes, its PWM channel.

Written from docs/sync_board.md and sharing no code with the readers.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.units import gps_from_utc, week_from_gps

Array = NDArray[np.float64]

# 2009-09-22 15:00 on the GPS scale
START_GPS = 937926000.0
# s; the camera of the report cannot fire faster
SHORTEST_INTERVAL = 0.5
_GPS_TIME, _COMMANDED = 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSettings:
    """How the board works, and how badly.

    Parameters
    ----------
    interval, jitter : s
        Between triggers, and the sigma of a trigger about its due time; interval 0 = none.
    start_gps : s
        GPS time at power-up.
    missed, spurious
        Share of triggers whose line is not sent though the counter counts, and of extra ones.
    flipped, lost
        Probability that a byte on the wire has a flipped bit, or is lost.
    first, wrap
        First number, and count after which the counter begins with 0.
    pulse_base, pulse_step : us, levels
        The PWM index: width `pulse_base + pulse_step * (number % levels)`.
    fix_after : s
        Time from power-up to the first GPS fix; before, week is 0 and time counts from power-up.
    """

    interval: float = 1.5
    jitter: float = 0.0
    start_gps: float = START_GPS
    missed: float = 0.0
    spurious: float = 0.0
    flipped: float = 0.0
    lost: float = 0.0
    first: int = 1
    wrap: int = 65536
    pulse_base: float = 1000.0
    pulse_step: float = 10.0
    levels: int = 100
    fix_after: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger:
    """One firing: number, time since power-up s, and whether its line was sent."""

    number: int
    time: float
    sent: bool


def checksum(body: bytes) -> bytes:
    """Two hexadecimal digits: exclusive or of the characters between ``$`` and ``*``."""
    value = 0
    for byte in body:
        value ^= byte
    return b"%02X" % value


@dataclass(slots=True)
class SimulatedBoard:
    """The board's program: it is told the time since power-up and gives the bytes it sends.

    Attributes
    ----------
    triggers
        Every firing, the truth.
    """

    settings: BoardSettings = field(default_factory=BoardSettings)
    seed: int = 0
    triggers: list[Trigger] = field(default_factory=list)
    interval: float = field(init=False)
    _due: float = field(init=False)
    _number: int = field(init=False)
    _inbox: bytes = b""
    _last_command: tuple[str, bytes] = ("", b"")
    _random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        """Power up."""
        self._random = np.random.default_rng([self.seed, 3])
        self.interval = self.settings.interval
        self._due = self.interval
        self._number = self.settings.first

    def advance(self, now: float) -> bytes:
        """Bytes sent up to `now`, s since power-up, before the wire spoils them."""
        sent = b""
        while self.interval > 0.0 and self._due <= now:
            settings = self.settings
            at = self._due + settings.jitter * float(self._random.normal())
            if self._random.random() < settings.spurious:
                sent += self.fire(at - self.interval * float(self._random.uniform(0.2, 0.8)))
            sent += self.fire(at, missed=bool(self._random.random() < settings.missed))
            self._due += self.interval
        return sent

    def fire(self, at: float, *, missed: bool = False, commanded: bool = False) -> bytes:
        """Fire the shutter at a time since power-up, s; gives the line."""
        number = self._number
        self._number = (number + 1) % self.settings.wrap
        self.triggers.append(Trigger(number=number, time=at, sent=not missed))
        return b"" if missed else self.line(number, at, commanded=commanded)

    def line(self, number: int, at: float, *, commanded: bool = False) -> bytes:
        """Line of a trigger."""
        settings = self.settings
        fixed = at >= settings.fix_after
        week, tow = week_from_gps(settings.start_gps + at) if fixed else (0, max(at, 0.0))
        pulse = settings.pulse_base + settings.pulse_step * (number % settings.levels)
        flags = (_GPS_TIME if fixed else 0) | (_COMMANDED if commanded else 0)
        body = b"TSB,%d,%d,%.6f,%g,%d" % (number, week, tow, pulse, flags)
        return b"$" + body + b"*" + checksum(body) + b"\r\n"

    def hear(self, data: bytes, now: float) -> bytes:
        """Take bytes from the wire; gives the answers and the lines they cause."""
        self._inbox += data
        *lines, self._inbox = self._inbox.split(b"\n")
        return b"".join(self._obey(line.strip(), now) for line in lines)

    def spoil(self, data: bytes) -> bytes:
        """What the wire makes of bytes."""
        settings = self.settings
        if not (settings.flipped or settings.lost) or not data:
            return data
        raw = np.frombuffer(data, dtype=np.uint8).copy()
        flip = self._random.random(len(raw)) < settings.flipped
        bits = self._random.integers(0, 8, int(flip.sum()))
        raw[flip] ^= np.left_shift(1, bits).astype(np.uint8)
        return raw[self._random.random(len(raw)) >= settings.lost].tobytes()

    def _obey(self, line: bytes, now: float) -> bytes:
        body, star, given = line.rpartition(b"*")
        if not (star and body.startswith(b"$TSC,")) or checksum(body[1:]) != given.upper():
            return b""
        words = body.decode("ascii", "replace").split(",")[1:]
        name, number = words[0], words[-1]
        if self._last_command[0] == f"{name},{number}":
            return self._last_command[1]
        refused, sent = self._do(name, words[1:-1], now)
        said = "NO," + refused if refused else "OK"
        body = f"TSA,{name},{number},{said}".encode("ascii")
        answer = b"$" + body + b"*" + checksum(body) + b"\r\n"
        self._last_command = (f"{name},{number}", answer)
        return answer + sent

    def _do(self, name: str, values: list[str], now: float) -> tuple[str, bytes]:
        """Do a command: reason of a refusal, and the lines it causes."""
        if name == "FOCUS":
            return "", b""
        if name == "SHUTTER":
            return "", self.fire(now, commanded=True)
        if name != "INTERVAL":
            return "unknown command", b""
        try:
            interval = float(values[0])
        except (IndexError, ValueError):
            return "interval is no number", b""
        if interval and not SHORTEST_INTERVAL <= interval <= 3600.0:
            return f"interval must be 0 or {SHORTEST_INTERVAL} to 3600 s", b""
        self.interval, self._due = interval, now + interval
        return "", b""


class PseudoTerminal:
    """A serial port that is no hardware: the board's end, and a device name for the reader."""

    def __init__(self, link: Path | None = None) -> None:
        try:
            import pty  # noqa: F401  (not on Windows)
            import tty
        except ImportError as error:
            raise InputError(
                "the simulated board needs a pseudo-terminal, which Windows has not; use WSL, or "
                "a pair of virtual COM ports"
            ) from error
        self._board, self._device_end = os.openpty()
        tty.setraw(self._device_end)
        os.set_blocking(self._board, False)
        self.device = os.ttyname(self._device_end)
        self._open = True
        self._link = link
        if link is not None:
            self._point(link)

    def _point(self, link: Path) -> None:
        """Make the device known by a second name, in place of an older link only."""
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.device)
        except OSError as error:
            self._link = None
            self.unplug()
            raise InputError(
                f"the link cannot be made ({error.strerror}); name a file that is not there",
                source=str(link),
            ) from error

    def read(self) -> bytes:
        """Bytes that the reader's side sent; empty if none."""
        try:
            return os.read(self._board, 4096)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes, stopped: Callable[[], bool] = lambda: False) -> int:
        """Send bytes, waiting while the reader's side is full; gives how many went."""
        sent = 0
        while sent < len(data) and not stopped():
            try:
                sent += os.write(self._board, data[sent : sent + 4096])
            except BlockingIOError:
                time.sleep(0.001)
        return sent

    def unplug(self) -> None:
        """Pull the plug: the device vanishes."""
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        if self._open:
            os.close(self._board)
            os.close(self._device_end)
            self._open = False


def gps_now() -> float:
    """Now on the GPS scale, s, by the clock of this computer."""
    return gps_from_utc(datetime.now(UTC))


def serve(
    board: SimulatedBoard,
    terminal: PseudoTerminal,
    stop: threading.Event,
    *,
    speed: float = 1.0,
    told: Callable[[SimulatedBoard], None] = lambda board: None,
) -> None:
    """Run a board on a terminal until stopped; `speed` times as fast as in truth."""
    started = time.monotonic()
    while not stop.is_set():
        now = (time.monotonic() - started) * speed
        before = len(board.triggers)
        data = board.hear(terminal.read(), now) + board.advance(now)
        terminal.write(board.spoil(data), stop.is_set)
        if len(board.triggers) != before:
            told(board)
        stop.wait(0.01)


def misread(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """What a receiver set to another baud rate makes of bytes, 8N1.

    Notes
    -----
    The receiver waits for a falling edge, samples the middle of its own bits, and takes the byte
    as it is; a stop bit that is low gives a zero byte, as Linux does by default.
    """
    bits = np.ones((len(data), 10), dtype=np.uint8)
    bits[:, 0] = 0
    bits[:, 1:9] = np.unpackbits(
        np.frombuffer(data, dtype=np.uint8)[:, None], axis=1, bitorder="little"
    )
    wire = np.concatenate([bits.ravel(), np.ones(20, dtype=np.uint8)])
    ratio = sent_baud / read_baud
    out, at = bytearray(), 0.0
    while True:
        falling = np.flatnonzero(wire[math.ceil(at) :] == 0)
        if not len(falling):
            return bytes(out)
        start = max(at, math.ceil(at) + float(falling[0]))
        middles = (start + (np.arange(10) + 0.5) * ratio).astype(int)
        if middles[-1] >= len(wire):
            return bytes(out)
        got = wire[middles]
        value = int(np.packbits(got[1:9], bitorder="little")[0])
        out.append(value if got[9] else 0)
        at = start + 9.5 * ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class PwmSettings:
    """How a recorder samples the PWM index.

    Parameters
    ----------
    rate : Hz
        Of the recorder.
    base, step
        Level 0 and the step, in the recorder's unit.
    levels
        Number of levels before the wrap.
    noise, quantum
        Sigma of the noise, and the unit of the last digit; 0 = none.
    stamp_jitter : s
        Sigma of the time stamp about the instant of sampling.
    dropped, glitches
        Share of samples that are missing, and that have any value.
    """

    rate: float = 20.0
    base: float = 1000.0
    step: float = 10.0
    levels: int = 100
    noise: float = 1.0
    quantum: float = 1.0
    stamp_jitter: float = 0.0
    dropped: float = 0.0
    glitches: float = 0.0


def simulate_pwm_channel(
    photo_times: Array, duration: float, settings: PwmSettings, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Samples of the recorder's channel on which the index steps up at every photo.

    Parameters
    ----------
    photo_times : shape (n,), s
    duration : s

    Returns
    -------
    time, value : shape (m,)
    """
    time_s = np.arange(0.0, duration, 1.0 / settings.rate) + rng.uniform(0.0, 1.0 / settings.rate)
    count = np.searchsorted(photo_times, time_s, side="right")
    value = settings.base + settings.step * (count % settings.levels)
    value = value + settings.noise * rng.normal(size=len(value))
    odd = rng.random(len(value)) < settings.glitches
    top = settings.base + settings.step * settings.levels
    value[odd] = rng.uniform(settings.base * 0.8, top * 1.1, int(odd.sum()))
    if settings.quantum:
        value = np.round(value / settings.quantum) * settings.quantum
    stamps = time_s + settings.stamp_jitter * rng.normal(size=len(time_s))
    kept = rng.random(len(value)) >= settings.dropped
    return np.sort(stamps)[kept], value[kept]
