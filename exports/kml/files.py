"""The files inside a KMZ: kept on disk while they are made, then zipped with doc.kml first."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self, cast

from georef_gis.errors import ExportError

# A fixed date: the same site gives the same file.
_DATE = (1980, 1, 1, 0, 0, 0)
# zlib's effort; more takes twice as long and saves a tenth of the bytes
EFFORT = 1
# Of a ZIP without marks of ZIP64, which Python's library sets from 2 GB on, not from 4
MOST_FILES, MOST_BYTES = 65_534, 2**31 - 2**24
# bytes that ZIP adds per member, without its name
_OVERHEAD = 98


class Spool:
    """Files in the order they came, in one nameless file beside the target."""

    def __init__(self, folder: Path) -> None:
        self._stream = tempfile.TemporaryFile(dir=folder)
        self._members: list[tuple[str, int, int]] = []
        self.size = 0

    def __enter__(self) -> Self:
        """Give the spool."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Forget all files."""
        self._stream.close()

    def add(self, path: str, data: bytes) -> None:
        """Take one file."""
        self._members.append((path, self._stream.tell(), len(data)))
        self._stream.write(data)
        packed = len(data) // 3 if path.endswith(".kml") else len(data)
        self.size += packed + 2 * len(path) + _OVERHEAD

    def mark(self) -> tuple[int, int]:
        """Where the spool is now, for `rewind`."""
        return len(self._members), self.size

    def rewind(self, mark: tuple[int, int]) -> None:
        """Forget all files since a mark."""
        count, self.size = mark
        if count < len(self._members):
            self._stream.seek(self._members[count][1])
            self._stream.truncate()
            del self._members[count:]

    def __len__(self) -> int:
        """Number of files."""
        return len(self._members)

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Paths and contents, in order."""
        for path, offset, length in self._members:
            self._stream.seek(offset)
            yield path, self._stream.read(length)


class Counter:
    """Stream that only counts the bytes of what is written, as ZIP packs them."""

    def __init__(self) -> None:
        self._packer = zlib.compressobj(EFFORT, wbits=-15)
        self._bytes = _OVERHEAD + 2 * len("doc.kml")
        self.plain = 0

    def write(self, data: bytes) -> int:
        """Count some bytes."""
        self.plain += len(data)
        self._bytes += len(self._packer.compress(data))
        return len(data)

    @property
    def packed(self) -> int:
        """Bytes in a ZIP; nothing can be written any more."""
        self._bytes += len(self._packer.flush())
        return self._bytes


def write_zip(target: Path, write_document: Callable[[BinaryIO], None], spool: Spool) -> bool:
    """KMZ of a document and its files. Pictures are stored: they are packed already.

    Without the marks of ZIP64, as long as it can: Google's own library of KML reads no such file.

    Returns
    -------
    bool
        Whether it is surely without.

    Raises
    ------
    ExportError
        If the document alone has 2 GB or more.
    """
    with zipfile.ZipFile(target, "w", allowZip64=True) as archive:
        try:
            with archive.open(_member("doc.kml"), "w") as stream:
                write_document(cast(BinaryIO, stream))
        except RuntimeError as error:
            if "too large" not in str(error):
                raise
            raise ExportError(
                "doc.kml of the KMZ has 2 GB or more, which no viewer opens; export assets "
                "alone by geopackage, or fewer photos"
            ) from error
        for path, data in spool.files():
            archive.writestr(_member(path), data, compresslevel=EFFORT)
    return len(spool) < MOST_FILES and target.stat().st_size < MOST_BYTES


def _member(path: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(path, _DATE)
    info.external_attr = 0o644 << 16
    info.compress_type = zipfile.ZIP_DEFLATED if path.endswith(".kml") else zipfile.ZIP_STORED
    return info
