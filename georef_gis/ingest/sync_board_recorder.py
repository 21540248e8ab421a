"""Live recording of a time-synchronisation board: every byte to disk, every good line to the log.

One thread reads the port and does nothing else; one writes. Between them lies a buffer in memory,
so that a slow disk delays the log and loses nothing.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from georef_gis.errors import InputError
from georef_gis.ingest.serial_port import (
    BAUD_RATES,
    PortInfo,
    PortLostError,
    find_again,
    list_ports,
    open_port,
    port_info,
)
from georef_gis.ingest.sync_board import (
    Command,
    Frame,
    new_number,
    send_command,
)
from georef_gis.ingest.sync_board_files import GrowingFile, Spool
from georef_gis.ingest.sync_board_state import Recording, baud_advice

__all__ = ["OpenPort", "Recorder", "RecorderSettings", "Recording", "baud_advice"]

# s between two fsync, between two looks for a lost port, between two notices of one kind
_SYNC_EVERY, _LOOK_EVERY, _NOTICE_EVERY = 2.0, 0.5, 10.0
# s that the end of a recording may take
_LAST_READ = 1.0
# so many intervals without a trigger are a silence
_SILENT_INTERVALS = 3.0

Notice = Callable[[str], None]


class OpenPort(Protocol):
    """An open port."""

    device: str

    def read(self) -> bytes:
        """Bytes that came, after a short wait."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def close(self) -> None:
        """Close it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """What to record from where.

    Parameters
    ----------
    port
        Name of the port.
    baud : Bd
    log, raw
        Files to append to.
    silence : s
        So long without a byte is told.
    interval : s
        If given, the board is told this interval at every connection.
    """

    port: str
    log: Path
    raw: Path
    baud: int = BAUD_RATES[0]
    silence: float = 10.0
    interval: float | None = None


class Recorder:
    """Records a port until it is stopped.

    Parameters
    ----------
    settings
        What from where.
    notice
        Is given sentences for people, from the thread that calls `poll` and `stop`.
    opener, finder
        Ways to open a port, and to list those there are; others in tests.
    """

    def __init__(
        self,
        settings: RecorderSettings,
        notice: Notice,
        *,
        opener: Callable[[str, int], OpenPort] = open_port,
        finder: Callable[[], Sequence[PortInfo]] = list_ports,
    ) -> None:
        self.settings = settings
        self.state = Recording()
        self.spool = Spool()
        self._tell = notice
        self._open, self._find = opener, finder
        self._notices: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._told: dict[str, float] = {}
        self._stop = threading.Event()
        self._failure: BaseException | None = None
        self._heard = self._trigger_at = time.monotonic()
        self._silent, self._interval = False, 0.0
        self._reader = threading.Thread(target=self._guard, args=(self._read,), daemon=True)
        # Not a daemon: it must empty the buffer before the program ends.
        self._writer = threading.Thread(target=self._guard, args=(self._write,))

    def start(self) -> None:
        """Open port and files and begin.

        Raises
        ------
        InputError
            If the port cannot be opened, refuses the interval, or a file cannot be written.
        """
        self._info = port_info(self.settings.port)
        port = self._opened(self.settings.port)
        try:
            self._files = [GrowingFile(self.settings.raw), GrowingFile(self.settings.log)]
        except InputError:
            port.close()
            raise
        self._port: OpenPort | None = port
        self.state.connected = True
        self._heard = time.monotonic()
        self._reader.start()
        self._writer.start()

    def poll(self) -> Recording:
        """Hand on the notices and give the state; to be called a few times a second.

        Raises
        ------
        BaseException
            What ended a thread.
        """
        self._watch_silence()
        while not self._notices.empty():
            self._tell(self._notices.get())
        if self._failure is not None:
            raise self._failure
        return self.state

    def stop(self) -> Recording:
        """End: all that was read is on disk when this returns.

        Raises
        ------
        InputError
            If the disk still refuses bytes.
        """
        self._stop.set()
        self._reader.join()
        self._writer.join()
        for file in self._files:
            file.close()
        self.poll()
        lost = next((file for file in self._files if file.waiting), None)
        if lost is not None:
            raise InputError(
                f"{lost.waiting} bytes could not be written ({lost.problem}) and are lost; "
                "free space and record again",
                source=str(lost.path),
            )
        return self.state

    def _guard(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # handed on by poll()
            self._failure = error
            self._stop.set()
            self.spool.close()

    def _note(self, kind: str, sentence: str) -> None:
        """Queue a sentence, of each kind one in a while: a bad line would fill the screen."""
        now = time.monotonic()
        if now - self._told.get(kind, -_NOTICE_EVERY) >= _NOTICE_EVERY:
            self._told[kind] = now
            self._notices.put(sentence)

    # -- the reader's thread

    def _opened(self, device: str) -> OpenPort:
        port = self._open(device, self.settings.baud)
        if self.settings.interval is None:
            return port
        command = Command(name="INTERVAL", number=new_number(), value=self.settings.interval)
        try:
            send_command(port, command, sink=self.spool.put)
        except InputError:
            port.close()
            raise
        return port

    def _read(self) -> None:
        while not self._stop.is_set():
            if self._port is None:
                self._port = self._wait_for_port()
                continue
            try:
                data = self._port.read()
            except PortLostError as error:
                self._lose_port(error)
                continue
            if data:
                self._heard = time.monotonic()
                self.spool.put(data)
        if self._port is not None:
            self._read_what_waits(self._port)
            self._port.close()
        else:
            self.state.away_s += time.monotonic() - self._lost_at

    def _read_what_waits(self, port: OpenPort) -> None:
        """Empty the driver's buffer at the end; a stream without a pause is cut after a second."""
        until = time.monotonic() + _LAST_READ
        with contextlib.suppress(PortLostError):
            while time.monotonic() < until and (data := port.read()):
                self.spool.put(data)

    def _lose_port(self, error: PortLostError) -> None:
        assert self._port is not None
        self._port.close()
        self._port = None
        self._lost_at = time.monotonic()
        self.state.connected = False
        self.state.interruptions += 1
        self.spool.put_break()
        self._notices.put(f"{error}; waiting for it to come back, Ctrl-C ends")

    def _wait_for_port(self) -> OpenPort | None:
        self._stop.wait(_LOOK_EVERY)
        if self._stop.is_set():
            return None
        device = find_again(self._info, self.settings.port, self._find())
        if device is None:
            return None
        try:
            port = self._opened(device)
        except (InputError, PortLostError) as error:
            self._note("reopen", f"{error}; trying again")
            return None
        away = time.monotonic() - self._lost_at
        self.state.away_s += away
        self.state.connected = True
        self._heard = time.monotonic()
        renamed = "" if device == self.settings.port else f" as {device}"
        self._notices.put(f"the port is back{renamed} after {away:.1f} s")
        return port

    # -- the writer's thread

    def _write(self) -> None:
        raw, log = self._files
        synced = time.monotonic()
        while True:
            ending = self._stop.is_set() and not self._reader.is_alive()
            taken = self.spool.take(0.0 if ending else 0.2)
            for piece in taken:
                if piece is None:
                    self.state.framer.break_off()
                    continue
                raw.write(piece)
                self.state.bytes_read += len(piece)
                log.write(b"".join(map(self._line_of, self.state.framer.feed(piece))))
            self._look_at(raw, log)
            if time.monotonic() - synced > _SYNC_EVERY:
                raw.sync()
                log.sync()
                synced = time.monotonic()
            if ending and not taken:
                return

    def _line_of(self, frame: Frame) -> bytes:
        """Line for the log, empty if the frame is no trigger."""
        state = self.state
        if frame.kind == "damaged":
            self._note("damaged", f"a damaged line was left out: {frame.line[:60]!r}")
        if frame.kind == "answer":
            self._note("answer", f"the board says {','.join(frame.fields[1:])}")
        if frame.record is None:
            return b""
        state.triggers += 1
        state.last = frame.record
        state.without_gps_time += not frame.record.has_gps_time
        now = time.monotonic()
        self._interval, self._trigger_at = now - self._trigger_at, now
        sentence = state.sequence.see(frame.record)
        if sentence:
            self._note("sequence", sentence)
        return frame.line + b"\r\n"

    def _look_at(self, raw: GrowingFile, log: GrowingFile) -> None:
        if self.state.framer.wrong_baud_likely():
            self.state.wrong_baud = True
            self._note("baud", baud_advice(self.settings.baud))
        elif self.state.framer.foreign_text_likely() and not self.state.triggers:
            self.state.wrong_baud = True
            self._note("baud", f"{baud_advice(self.settings.baud)}, or another port")
        for file in (raw, log):
            if file.waiting:
                self._note(
                    f"disk {file.path}",
                    f"{file.path} cannot be written ({file.problem}); {file.waiting} bytes wait "
                    "in memory; free space",
                )
                file.write(b"")

    # -- the caller's thread

    def _watch_silence(self) -> None:
        if not self.state.connected:
            self._silent = False
            return
        quiet = time.monotonic() - self._heard
        if quiet > max(self.settings.silence, _SILENT_INTERVALS * self._interval):
            if not self._silent:
                self._tell(self._why_silent(quiet))
            self._silent = True
        elif self._silent:
            self._silent = False
            self._tell("the board is heard again")

    def _why_silent(self, quiet: float) -> str:
        if self.state.bytes_read:
            return f"nothing has come for {quiet:.0f} s; {self.state.line()}"
        return (
            f"nothing has come from {self.settings.port} in {quiet:.0f} s; look at power, port "
            "and whether TX and RX are crossed"
        )
