"""Files of a live recording, and the buffer before them: nothing that came may be lost."""

from __future__ import annotations

import os
import threading
from collections import deque
from pathlib import Path

from georef_gis.errors import InputError

# bytes in memory from which on the reader waits; 1.5 h at 115 200 Bd
_LARGEST_SPOOL = 64_000_000
# bytes of one piece in the buffer
_PIECE = 1 << 16


class Spool:
    """Bytes on their way from the port to the disk, in order; None marks an interruption."""

    def __init__(self, largest: int = _LARGEST_SPOOL) -> None:
        self._pieces: deque[bytearray | None] = deque()
        self._changed = threading.Condition()
        self._size = 0
        self._largest = largest
        self._closed = False
        self.peak = 0

    def put(self, data: bytes) -> None:
        """Add bytes; waits only when memory would run out."""
        with self._changed:
            while self._size >= self._largest and not self._closed:
                self._changed.wait()
            last = self._pieces[-1] if self._pieces else None
            if last is not None and len(last) < _PIECE:
                last += data
            else:
                self._pieces.append(bytearray(data))
            self._size += len(data)
            self.peak = max(self.peak, self._size)
            self._changed.notify_all()

    def close(self) -> None:
        """Nobody takes any more: do not keep the reader waiting."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def put_break(self) -> None:
        """Mark an interruption: what comes does not continue what came."""
        with self._changed:
            self._pieces.append(None)
            self._changed.notify_all()

    def take(self, timeout: float) -> list[bytes | None]:
        """Everything that waits; empty after `timeout` s."""
        with self._changed:
            if not self._pieces:
                self._changed.wait(timeout)
            taken = [None if piece is None else bytes(piece) for piece in self._pieces]
            self._pieces.clear()
            self._size = 0
            self._changed.notify_all()
            return taken


class GrowingFile:
    """A file to whose end bytes are written at once; what a full disk refuses is kept and retried.

    Written bytes outlive a killed program; `sync` makes them outlive a power cut.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem = ""
        self._pending = bytearray()
        self._dirty = False
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(path, flags, 0o666)
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror}); choose another --output", source=str(path)
            ) from error

    @property
    def waiting(self) -> int:
        """Bytes that the disk refused so far."""
        return len(self._pending)

    def write(self, data: bytes) -> None:
        """Write bytes behind those that wait."""
        self._pending += data
        self.problem = ""
        while self._pending:
            try:
                written = os.write(self._handle, bytes(self._pending[:_PIECE]))
            except OSError as error:
                self.problem = error.strerror or str(error)
                return
            del self._pending[:written]
            self._dirty = True

    def sync(self) -> None:
        """Hand what was written to the disk."""
        if not self._dirty:
            return
        try:
            os.fsync(self._handle)
            self._dirty = False
        except OSError as error:
            self.problem = error.strerror or str(error)

    def close(self) -> None:
        """Write, sync and close."""
        self.write(b"")
        self.sync()
        os.close(self._handle)


def free_names(log: Path) -> tuple[Path, Path]:
    """Log and raw capture that do not exist yet: ``x.log``, ``x.raw``, else ``x_2.log``, ...

    Two flights must not end up in one log, and nothing may be overwritten.
    """
    if log.suffix == ".raw":
        raise InputError("ends in .raw, as the raw capture will; name it .log", source=str(log))
    for number in range(1, 100_000):
        name = log if number == 1 else log.with_name(f"{log.stem}_{number}{log.suffix}")
        raw = name.with_suffix(".raw")
        if not any(path.exists() and path.stat().st_size for path in (name, raw)):
            return name, raw
    raise InputError("100 000 logs of this name exist; choose another --output", source=str(log))
