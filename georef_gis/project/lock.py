"""One run at a time per project, by a lock that dies with its process."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError

logger = logging.getLogger(__name__)

LOCK_FILE = ".georef.lock"
# Windows keeps others from reading what is locked: a byte far behind the note.
_LOCKED_BYTE = 1 << 20
_guard = threading.Lock()
# Device and number of a folder -> (open lock file, note): the runs of this process. The file must
# not be opened once more here: on network disks flock is a POSIX lock, which any close drops.
_held: dict[tuple[int, int], tuple[int, dict[str, Any]]] = {}


@contextlib.contextmanager
def project_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a project.

    The system drops it with the process, whatever kills that, and forked workers give it up: a
    lock is never stale.

    Raises
    ------
    InputError
        If another run holds it, of this process or any other.
    """
    note = {"process": os.getpid(), "since": datetime.now(UTC).isoformat(" ", "seconds")}
    try:
        status = folder.stat()
        key = (status.st_dev, status.st_ino)
        with _guard:
            if key in _held:
                raise _in_use(folder, _held[key][1])
            stream = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT, 0o666)
            _held[key] = (stream, note)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", source=str(folder)) from error
    try:
        if not _lock(stream):
            raise _in_use(folder, _read_note(stream))
        _write_note(stream, json.dumps(note).encode())
        yield
        _write_note(stream, b"")
    finally:
        with _guard:
            # A forked worker that unwinds has given it up before.
            if _held.pop(key, None) is not None:
                os.close(stream)


def _lock(stream: int) -> bool:
    """Take the lock; False if another process holds it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(stream, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(stream, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL):
            raise InputError(f"cannot be locked ({error.strerror})", source=LOCK_FILE) from error
        logger.warning("this disk knows no locks: start only one run at a time")
    return True


def _write_note(stream: int, text: bytes) -> None:
    os.ftruncate(stream, 0)
    os.lseek(stream, 0, os.SEEK_SET)
    os.write(stream, text)


def _read_note(stream: int) -> dict[str, Any]:
    try:
        os.lseek(stream, 0, os.SEEK_SET)
        note = json.loads(os.read(stream, 4096))
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}


def _in_use(folder: Path, note: dict[str, Any]) -> InputError:
    who = ""
    if {"process", "since"} <= note.keys():
        who = f" (process {note['process']}, since {note['since']})"
    return InputError(
        f"another run works on this project{who}; wait for it or stop it", source=str(folder)
    )


def _give_up() -> None:
    """Close the locks in a forked worker, which would hold them on after its parent."""
    for stream, _ in _held.values():
        with contextlib.suppress(OSError):
            os.close(stream)
    _held.clear()
    global _guard
    _guard = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_give_up)
