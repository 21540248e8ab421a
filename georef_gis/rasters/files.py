"""Files that appear whole or not at all, and what to say when the disk will not have them."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from georef_gis.errors import ExportError

if sys.platform != "win32":
    import fcntl

# Files GDAL reads beside a raster; those of the one replaced would be taken for the new one's.
_COMPANIONS = (".ovr", ".msk", ".aux.xml")
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


def resolve_target(path: str | os.PathLike[str]) -> Path:
    """The file to write, behind links, or a refusal when its folder cannot take it."""
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise ExportError(f"{target}: is a folder; name a file")
    if not target.parent.is_dir():
        raise ExportError(f"{target}: folder {target.parent} does not exist; create it first")
    return target


def scratch_file(target: Path) -> IO[bytes]:
    """A nameless file on the target's disk, gone when closed or when the process dies."""
    return tempfile.TemporaryFile(dir=target.parent, prefix=f".{target.name}.", suffix=".part")


def write_all(stream: IO[bytes], data: bytes | memoryview) -> None:
    """Write every byte; a file without a buffer may take fewer at once."""
    view = memoryview(data)
    while len(view):
        view = view[stream.write(view) :]


def lasting_file(path: Path) -> IO[bytes]:
    """A file to read and append to, made if there is none, each write at once with the system.

    What was written survives the death of the process, which a buffer of its own would not.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
    return open(descriptor, "r+b", buffering=0)


@contextmanager
def whole_file(target: Path) -> Iterator[IO[bytes]]:
    """A file to write that takes the target's name at the end, and leaves nothing on failure."""
    part = target.with_name(f".{target.name}.{os.getpid()}-{os.urandom(4).hex()}.part")
    try:
        with open(part, "xb") as stream:
            lock(stream)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, target)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise
    for ending in _COMPANIONS:
        with suppress(OSError):
            target.with_name(target.name + ending).unlink()


def remove_stale(target: Path) -> None:
    """Remove what killed runs left beside the target; files of living ones are locked."""
    prefix = f".{target.name}."
    with os.scandir(target.parent) as entries:
        names = [e.name for e in entries if e.name.startswith(prefix) and e.name.endswith(".part")]
    for name in names:
        part = target.with_name(name)
        with suppress(OSError), open(part, "rb") as stream:
            lock(stream)
            if sys.platform != "win32":
                part.unlink()
        if sys.platform == "win32":
            # an open file cannot be removed there, which is lock enough
            with suppress(OSError):
                part.unlink()


def lock(stream: IO[bytes]) -> None:
    """Take the file's lock or raise OSError; the system frees it when the process ends."""
    if sys.platform != "win32":
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def export_errors(
    target: Path, needed: Callable[[], int], *, folder: Path | None = None, kept: bool = False
) -> Iterator[None]:
    """Turn the system's refusals to write into an `ExportError` of one line.

    Parameters
    ----------
    target
        The file named in the message.
    needed
        Bytes that are still to be written to its disk, at least; 0 = not known.
    folder
        What is written to; None = the target's own.
    kept
        Whether finished tiles outlive the failure.
    """
    try:
        yield
    except OSError as error:
        raise ExportError(_reason(target, error, needed(), folder, kept)) from error


def check_space(target: Path, needed: int) -> None:
    """Refuse at once what the disk has no room for."""
    if shutil.disk_usage(target.parent).free < needed:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def same_disk(first: Path, second: Path) -> bool:
    """Whether two folders share their free space; not if one is gone."""
    with suppress(OSError):
        return os.stat(first).st_dev == os.stat(second).st_dev
    return False


def _reason(target: Path, error: OSError, needed: int, folder: Path | None, kept: bool) -> str:
    named = "" if folder is None else f" of {folder}"
    folder = folder or target.parent
    if error.errno in _DISK_FULL:
        with suppress(OSError):
            free = shutil.disk_usage(folder).free
            more = f"at least {needed / 1e6:.1f} MB more are needed, " if needed else ""
            cure = (
                "and start again, finished tiles are kept" if kept else "or write to another disk"
            )
            return (
                f"{target}: the disk{named} is full: {more}{free / 1e6:.1f} MB are free; "
                f"free some space {cure}"
            )
    if error.errno == errno.EFBIG:
        return (
            f"{target}: a file in {folder} grows larger than this disk or this user may have "
            "(FAT holds 4 GB, see `ulimit -f`); use another disk or lift the limit"
        )
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"{target}: folder {folder} cannot be written to; choose another"
    return f"{target}: cannot be written ({error.strerror or error}); check the disk"
