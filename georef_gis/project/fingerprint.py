"""Fingerprints: whether a file is still the one that was read."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError

# bytes hashed at either end of a file
EDGE = 65_536
# files from which reading in threads pays
MANY_FILES = 64
# Path, size, mtime_ns and whether all of it was hashed -> fingerprint
Known = dict[tuple[str, int, int, bool], str]


def fingerprint(path: Path, *, whole: bool = False) -> str:
    """Fingerprint of a file: size, mtime_ns and a hash of its first and last 64 kB.

    Parameters
    ----------
    whole
        Hash all of it too, as a fourth part.

    Returns
    -------
    str
        Parts joined by ``-``; empty if there is no such file.

    Raises
    ------
    InputError
        If it may not be read.
    """
    try:
        with path.open("rb", buffering=0) as stream:
            status = os.fstat(stream.fileno())
            edge = hashlib.blake2b(stream.read(EDGE), digest_size=12)
            if status.st_size > EDGE:
                stream.seek(max(EDGE, status.st_size - EDGE))
                edge.update(stream.read(EDGE))
            parts = [str(status.st_size), str(status.st_mtime_ns), edge.hexdigest()]
            if whole:
                stream.seek(0)
                parts.append(hashlib.file_digest(stream, _blake).hexdigest())
            return "-".join(parts)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        return ""
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}; check its permission",
                         source=str(path)) from error  # fmt: skip


def is_same(recorded: str, current: str) -> bool:
    """Whether a file is still the recorded one.

    If `current` hashes the whole file, so must `recorded`; then the time does not matter.
    """
    before, now = recorded.split("-"), current.split("-")
    if len(now) == 4:
        return len(before) == 4 and (before[0], before[3]) == (now[0], now[3])
    return before[: len(now)] == now


def fingerprints(
    paths: Iterable[Path], folder: Path, *, whole: bool = False, known: Known | None = None
) -> dict[str, str]:
    """Fingerprints of files, by path relative to `folder` where they lie below it.

    A folder stands for the files directly in it.

    Parameters
    ----------
    known
        Fingerprints taken a moment ago, which is added to: several steps of a run read the same
        photos, and need not hash each as often as that.
    """
    files = sorted({file for path in paths for file in _files(path)})
    names = [portable_path(file, folder) for file in files]
    known = {} if known is None else known

    def one(file: Path) -> str:
        key = _state(file, whole)
        if key not in known:
            known[key] = fingerprint(file, whole=whole)
        return known[key]

    if len(files) < MANY_FILES:
        return dict(zip(names, map(one, files), strict=True))
    with ThreadPoolExecutor(4) as pool:
        return dict(zip(names, pool.map(one, files), strict=True))


def portable_path(path: Path, folder: Path) -> str:
    """Path relative to `folder` with forward slashes, absolute if it lies elsewhere."""
    absolute = Path(os.path.abspath(path))
    try:
        return absolute.relative_to(folder).as_posix()
    except ValueError:
        return absolute.as_posix()


def digest(value: Any) -> str:
    """Hash of a JSON-able value, whatever the order of its keys."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _state(path: Path, whole: bool) -> tuple[str, int, int, bool]:
    """What tells a file from what it was a moment ago."""
    try:
        status = path.stat()
    except OSError:
        return str(path), -1, -1, whole
    return str(path), status.st_size, status.st_mtime_ns, whole


def _blake() -> Any:
    return hashlib.blake2b(digest_size=16)


def _files(path: Path) -> list[Path]:
    return [entry for entry in path.iterdir() if entry.is_file()] if path.is_dir() else [path]
