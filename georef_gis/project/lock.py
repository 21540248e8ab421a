"""One run at a time per project, by a lock that dies with its process."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from georef_gis.errors import InputError

LOCK_FILE = ".georef.lock"
_guard = threading.Lock()
# A POSIX lock belongs to the process, so two threads are kept apart here.
_held: set[Path] = set()


@contextlib.contextmanager
def project_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a project.

    The system drops it with the process, whatever kills that, and forked workers do not inherit
    it: a lock is never stale. Without such locks (Windows) nothing is held.

    Raises
    ------
    InputError
        If another run holds it.
    """
    path = folder / LOCK_FILE
    with _guard:
        if path in _held:
            raise _in_use(path)
        _held.add(path)
    try:
        try:
            stream = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", source=str(folder)) from error
        try:
            _lock(stream, path)
            note = {"process": os.getpid(), "since": datetime.now(UTC).isoformat(" ", "seconds")}
            os.ftruncate(stream, 0)
            os.write(stream, json.dumps(note).encode())
            yield
            os.ftruncate(stream, 0)
        finally:
            os.close(stream)
    finally:
        with _guard:
            _held.discard(path)


def _lock(stream: int, path: Path) -> None:
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.lockf(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise _in_use(path) from error


def _in_use(path: Path) -> InputError:
    try:
        note = json.loads(path.read_text())
        who = f" (process {note['process']}, since {note['since']})"
    except (OSError, ValueError, KeyError, TypeError):
        who = ""
    return InputError(
        f"another run works on this project{who}; wait for it or stop it", source=str(path.parent)
    )
