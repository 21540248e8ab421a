"""Checksums of products, by which metadata are known to be of them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from georef_gis.errors import ExportError

WHOLE, LISTED = "sha256", "sha256 of names and sizes"


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal.

    Raises
    ------
    ExportError
        If it cannot be read.
    """
    try:
        with path.open("rb", buffering=0) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ExportError(
            f"{path}: cannot be read ({error.strerror}); check its permission"
        ) from error


def checksum(path: Path) -> tuple[str, str, int]:
    """Checksum of a file or folder, of what it is, and the size in bytes.

    Of a folder, which may hold thousands of tiles, names and sizes of its files are taken.
    """
    if not path.is_dir():
        return sha256(path), WHOLE, path.stat().st_size
    total, digest = 0, hashlib.sha256()
    files = sorted(Path(parent, name) for parent, _, names in os.walk(path) for name in names)
    for file in files:
        size = file.lstat().st_size
        total += size
        name = file.relative_to(path).as_posix()
        digest.update(f"{size} {name}\n".encode("utf-8", "surrogatepass"))
    return digest.hexdigest(), LISTED, total
