"""Journal of an unfinished raster: lines that a kill can cut short but not garble."""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from georef_gis.rasters.files import lasting_file, lock, write_all

# bytes of the checksum in hex and the blank after it
_SUM = 9


class Journal:
    """Entries in the order they were made, each on a line with its checksum.

    An entry counts once its line is complete. What it declares has to be written before it, so
    that the journal never tells of data that a killed process did not come to write.

    Parameters
    ----------
    path
        File; made if there is none, and locked until `close`.

    Attributes
    ----------
    cut
        Lines dropped by `entries`, a torn last one included.

    Raises
    ------
    BlockingIOError
        If another process holds it.
    OSError
        If it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cut = 0
        self._end = 0
        self._file = lasting_file(path)
        try:
            lock(self._file)
        except OSError:
            self._file.close()
            raise

    def entries(self) -> Generator[Any, None, None]:
        """Entries up to the first damaged line; that and what follows is dropped for good."""
        self._end = self.cut = 0
        with open(self.path, "rb") as stream:
            for line in stream:
                if not _sound(line):
                    self.cut = 1 + sum(1 for _ in stream)
                    break
                self._end += len(line)
                yield json.loads(line[_SUM:])
        self._file.truncate(self._end)

    def append(self, entry: Sequence[Any]) -> None:
        """Add an entry."""
        payload = json.dumps(entry, separators=(",", ":")).encode()
        line = b"%08x %s\n" % (zlib.crc32(payload), payload)
        self._file.seek(self._end)
        try:
            write_all(self._file, line)
        except OSError:
            # else the next line would be joined to a part of this one
            with suppress(OSError):
                self._file.truncate(self._end)
            raise
        self._end += len(line)

    def clear(self) -> None:
        """Drop all entries."""
        self._file.truncate(0)
        self._end = 0

    def sync(self) -> None:
        """Have the disk hold all entries."""
        os.fsync(self._file.fileno())

    def remove(self) -> None:
        """Remove the file; the lock is held until `close`."""
        with suppress(OSError):
            self.path.unlink()

    def close(self) -> None:
        """Close the file and free its lock."""
        with suppress(OSError):
            self._file.close()


def _sound(line: bytes) -> bool:
    """Whether a line is complete and as it was written."""
    if not line.endswith(b"\n") or len(line) <= _SUM:
        return False
    return line[: _SUM - 1] == b"%08x" % zlib.crc32(line[_SUM:-1])
