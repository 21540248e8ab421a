"""Encoded tiles of one level, on disk rather than in memory."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.files import scratch_file, write_all
from georef_gis.rasters.pyramid import Level
from georef_gis.rasters.tiff import LEADER, TRAILER

# bytes copied at once
_CHUNK = 8 << 20
# bytes a block takes beside its data
FRAME = LEADER + TRAILER


class Backing(Protocol):
    """Where the files of an unfinished raster lie.

    Attributes
    ----------
    lasting
        Whether they outlive the process.
    """

    lasting: bool

    def level_file(self, number: int) -> IO[bytes]:
        """File for the encoded tiles of a level."""

    def halves_file(self) -> IO[bytes]:
        """File for the halved tiles in waiting."""

    def commit(self, records: Sequence[Any]) -> None:
        """Declare that what the records tell is written."""

    def remove(self) -> None:
        """Remove what outlived the process."""

    def close(self) -> None:
        """Close the files that are not the callers'."""


class Scratch:
    """Nameless files beside the target, gone with the process."""

    lasting = False

    def __init__(self, target: Path) -> None:
        self._target = target

    def level_file(self, number: int) -> IO[bytes]:
        """File for the encoded tiles of a level."""
        return scratch_file(self._target)

    def halves_file(self) -> IO[bytes]:
        """File for the halved tiles in waiting."""
        return scratch_file(self._target)

    def commit(self, records: Sequence[Any]) -> None:
        """Nothing is kept, so nothing is declared."""

    def remove(self) -> None:
        """Nothing outlives the process."""

    def close(self) -> None:
        """All files are their users'."""


def framed(data: bytes) -> bytes:
    """A tile as it stands in the file: its size, its data, its last four bytes again."""
    return b"".join([len(data).to_bytes(LEADER, "little"), data, data[-TRAILER:]])


def length_of(image: int, mask: int) -> int:
    """Bytes that a tile and, unless its size is 0, its mask take with their frames."""
    return image + FRAME + (mask + FRAME if mask else 0)


class LevelSpool:
    """Encoded tiles of one level, in the order they came.

    Attributes
    ----------
    image_sizes, mask_sizes : shape (tiles,), bytes
        Length of each tile's data in row-major order; 0 = no tile.
    partial
        Whether some tile has missing pixels.
    size
        Bytes in the file.
    """

    def __init__(self, level: Level, stream: IO[bytes]) -> None:
        tiles = level.across * level.down
        self.level = level
        self.image_sizes: NDArray[np.uint32] = np.zeros(tiles, np.uint32)
        self.mask_sizes: NDArray[np.uint32] = np.zeros(tiles, np.uint32)
        self.partial = False
        self.size = 0
        self._starts: NDArray[np.int64] = np.zeros(tiles, np.int64)
        self._file = stream

    def add(self, index: int, sizes: tuple[int, int], record: bytes, *, partial: bool) -> int:
        """Keep a tile: the sizes of image and mask (0 = none), both framed; where it starts."""
        start = self.size
        write_all(self._file, record)
        self._starts[index] = start
        self.image_sizes[index], self.mask_sizes[index] = sizes
        self.partial |= partial
        self.size += len(record)
        return start

    def restore(
        self, starts: NDArray[np.int64], images: NDArray[np.uint32], masks: NDArray[np.uint32]
    ) -> None:
        """Go on after these tiles, each array of shape (tiles,); what follows them is dropped."""
        self._starts[:], self.image_sizes[:], self.mask_sizes[:] = starts, images, masks
        ends = np.where(images > 0, starts + self.lengths(masks=True), 0)
        self.size = int(ends.max(initial=0))
        self._file.truncate(self.size)
        self._file.seek(self.size)

    def has(self, row: int, col: int) -> bool:
        """Whether a tile is here."""
        return bool(self.image_sizes[row * self.level.across + col])

    def lengths(self, *, masks: bool) -> NDArray[np.int64]:
        """Bytes each tile takes in the file, shape (tiles,)."""
        lengths = np.where(self.image_sizes > 0, self.image_sizes.astype(np.int64) + FRAME, 0)
        if masks:
            lengths += np.where(self.mask_sizes > 0, self.mask_sizes.astype(np.int64) + FRAME, 0)
        return lengths

    def chunks(self, *, masks: bool) -> Iterator[bytes]:
        """All tiles in row-major order, neighbours in the spool read at once."""
        self._file.flush()
        lengths = self.lengths(masks=masks)
        start = end = 0
        for index in np.flatnonzero(lengths):
            at, length = int(self._starts[index]), int(lengths[index])
            if at != end or end - start + length > _CHUNK:
                yield self.read(start, end)
                start = at
            end = at + length
        yield self.read(start, end)

    def read(self, start: int, end: int) -> bytes:
        """Bytes of the file; the next tile must not be added before `restore`."""
        return read_exactly(self._file, start, end - start)

    def sync(self) -> None:
        """Have the disk hold what was added."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Give the disk space back, unless the file outlives the process."""
        close_quietly(self._file)


def read_exactly(stream: IO[bytes], start: int, length: int) -> bytes:
    """Bytes from a place, or an OSError where the file ends before."""
    stream.seek(start)
    data = stream.read(length)
    if len(data) != length:
        raise OSError(errno.EIO, "a file of finished tiles became shorter")
    return data


def close_quietly(stream: IO[bytes]) -> None:
    """Close; a full disk refuses what is still buffered, which nobody needs any more."""
    with suppress(OSError):
        stream.close()
