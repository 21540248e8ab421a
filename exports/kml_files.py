"""The files inside a KMZ: kept on disk while they are made, then zipped with doc.kml first."""

from __future__ import annotations

import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self, cast

import cv2
import numpy as np

from georef_gis.model.photo import Photo

# A fixed date: the same site gives the same file.
_DATE = (1980, 1, 1, 0, 0, 0)
# bytes that ZIP adds per member, without its name
_OVERHEAD = 98
_WORKERS = 2
_REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4,
            8: cv2.IMREAD_REDUCED_COLOR_8}  # fmt: skip
THUMBNAIL_QUALITY = 75


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

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Paths and contents, in order."""
        for path, offset, length in self._members:
            self._stream.seek(offset)
            yield path, self._stream.read(length)


class Counter:
    """Stream that only counts the bytes of text, as ZIP will pack them."""

    def __init__(self) -> None:
        self._bytes = 0

    def write(self, data: bytes) -> int:
        """Count some bytes."""
        self._bytes += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing."""

    @property
    def packed(self) -> int:
        """Bytes in a ZIP, seldom more."""
        return self._bytes // 3


def write_zip(target: Path, write_document: Callable[[BinaryIO], None], spool: Spool) -> None:
    """KMZ of a document and its files. Pictures are stored: they are packed already."""
    with zipfile.ZipFile(target, "w", allowZip64=True) as archive:
        with archive.open(_member("doc.kml"), "w", force_zip64=True) as stream:
            write_document(cast(BinaryIO, stream))
        for path, data in spool.files():
            archive.writestr(_member(path), data)


def _member(path: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(path, _DATE)
    info.external_attr = 0o644 << 16
    info.compress_type = zipfile.ZIP_DEFLATED if path.endswith(".kml") else zipfile.ZIP_STORED
    return info


# -- thumbnails ---------------------------------------------------------------------------------


def add_thumbnails(
    spool: Spool, photos: Sequence[Photo], side: int, tick: Callable[[int], None]
) -> dict[str, str]:
    """Small pictures of photos; gives photo id -> path. A photo that cannot be read is left out.

    Parameters
    ----------
    side
        Of the longer side, px.
    tick
        Called with the number of photos done; may raise to stop.
    """
    paths: dict[str, str] = {}
    waiting: deque[tuple[int, Future[bytes | None]]] = deque()
    with ThreadPoolExecutor(_WORKERS) as pool:
        try:
            for number, photo in enumerate(photos, start=1):
                waiting.append((number, pool.submit(thumbnail, photo, side)))
                if len(waiting) > 4 * _WORKERS:
                    _take(spool, photos, waiting, paths, tick)
            while waiting:
                _take(spool, photos, waiting, paths, tick)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return paths


def _take(
    spool: Spool,
    photos: Sequence[Photo],
    waiting: deque[tuple[int, Future[bytes | None]]],
    paths: dict[str, str],
    tick: Callable[[int], None],
) -> None:
    number, future = waiting.popleft()
    data = future.result()
    if data is not None:
        # Numbered: a photo's own name may hold what a link cannot.
        path = f"thumbnails/{number:05d}.jpg"
        spool.add(path, data)
        paths[photos[number - 1].id] = path
    tick(number)


def thumbnail(photo: Photo, side: int) -> bytes | None:
    """JPEG of a photo as stored, `side` px along its longer side; None if it cannot be read."""
    longer = max(photo.width, photo.height)
    factor = max((f for f in _REDUCED if longer / f >= side), default=1)
    flags = _REDUCED.get(factor, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        data = np.fromfile(photo.path, dtype=np.uint8)
        image = cv2.imdecode(data, flags) if data.size else None
        if image is None:
            return None
        scale = side / max(image.shape[:2])
        if scale < 1.0:
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, THUMBNAIL_QUALITY])
    except (OSError, cv2.error):
        return None
    return jpeg.tobytes() if done else None


def camera_icon() -> bytes:
    """PNG of the icon for photos: a white ring with a point, readable on any ground."""
    side, fine = 32, 8
    big = np.zeros((side * fine, side * fine, 4), dtype=np.uint8)
    centre = (side * fine // 2, side * fine // 2)
    cv2.circle(big, centre, 13 * fine, (60, 60, 60, 255), -1)
    cv2.circle(big, centre, 11 * fine, (255, 255, 255, 255), -1)
    cv2.circle(big, centre, 6 * fine, (60, 60, 60, 255), -1)
    cv2.circle(big, centre, 4 * fine, (255, 255, 255, 255), -1)
    icon = cv2.resize(big, (side, side), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".png", icon)[1].tobytes())
