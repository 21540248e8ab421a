"""Encoded tiles of one level and halved tiles in waiting, on disk rather than in memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.files import scratch_file
from georef_gis.rasters.pyramid import Level, Samples, Tile
from georef_gis.rasters.tiff import LEADER, TRAILER

# bytes copied at once
_CHUNK = 8 << 20
# bytes a block takes beside its data
FRAME = LEADER + TRAILER


def framed(data: bytes) -> bytes:
    """A tile as it stands in the file: its size, its data, its last four bytes again."""
    return b"".join([len(data).to_bytes(LEADER, "little"), data, data[-TRAILER:]])


class LevelSpool:
    """Encoded tiles of one level, in the order they came.

    Attributes
    ----------
    image_sizes, mask_sizes : shape (tiles,), bytes
        Length of each tile's data in row-major order; 0 = no tile.
    partial
        Whether some tile has missing pixels.
    """

    def __init__(self, level: Level, target: Path) -> None:
        tiles = level.across * level.down
        self.level = level
        self.image_sizes: NDArray[np.uint32] = np.zeros(tiles, np.uint32)
        self.mask_sizes: NDArray[np.uint32] = np.zeros(tiles, np.uint32)
        self.partial = False
        self.size = 0
        self._starts: NDArray[np.int64] = np.zeros(tiles, np.int64)
        self._file: IO[bytes] = scratch_file(target)

    def add(self, index: int, image: bytes, mask: bytes | None, *, partial: bool) -> None:
        """Keep the bytes of a tile and, if the file has masks, of its mask."""
        record = framed(image) if mask is None else framed(image) + framed(mask)
        self._file.write(record)
        self._starts[index] = self.size
        self.image_sizes[index] = len(image)
        self.mask_sizes[index] = 0 if mask is None else len(mask)
        self.partial |= partial
        self.size += len(record)

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
                yield self._read(start, end)
                start = at
            end = at + length
        yield self._read(start, end)

    def close(self) -> None:
        """Give the disk space back."""
        _close(self._file)

    def _read(self, start: int, end: int) -> bytes:
        self._file.seek(start)
        return self._file.read(end - start)


class QuarterStore:
    """Halved tiles that wait for their three neighbours; beyond a limit they wait on disk.

    Parameters
    ----------
    target
        File beside which the waiting tiles lie.
    limit
        Bytes kept in memory.
    """

    def __init__(self, target: Path, limit: int) -> None:
        self._target = target
        self._limit = limit
        self._used = 0
        self._file: IO[bytes] | None = None
        self._end = 0

    def put(self, tile: Tile) -> Tile | Spilled:
        """The tile, or where it lies on disk."""
        size = _bytes_of(tile)
        if self._used + size <= self._limit:
            self._used += size
            return tile
        if self._file is None:
            self._file = scratch_file(self._target)
        self._file.seek(self._end)
        self._file.write(tile.data.tobytes())
        if tile.mask is not None:
            self._file.write(tile.mask.tobytes())
        place = Spilled(self._end, tile.data, masked=tile.mask is not None)
        self._end += size
        return place

    def take(self, kept: Tile | Spilled) -> Tile:
        """The tile again; it no longer counts."""
        if isinstance(kept, Tile):
            self._used -= _bytes_of(kept)
            return kept
        if self._file is None:
            raise RuntimeError("a tile was spilled without a file")
        self._file.seek(kept.start)
        data = np.frombuffer(self._file.read(kept.size), kept.dtype).reshape(kept.shape)
        mask = None
        if kept.masked:
            rows, cols = kept.shape[:2]
            mask = np.frombuffer(self._file.read(rows * cols), np.uint8).reshape(rows, cols)
        return Tile(data=data, mask=mask)

    def close(self) -> None:
        """Give the disk space back."""
        if self._file is not None:
            _close(self._file)


class Spilled:
    """Where a halved tile lies on disk."""

    __slots__ = ("dtype", "masked", "shape", "size", "start")

    def __init__(self, start: int, data: Samples, *, masked: bool) -> None:
        self.start = start
        self.shape, self.dtype, self.size = data.shape, data.dtype, data.nbytes
        self.masked = masked


def _bytes_of(tile: Tile) -> int:
    return tile.data.nbytes + (0 if tile.mask is None else tile.mask.nbytes)


def _close(scratch: IO[bytes]) -> None:
    # a full disk refuses what is still buffered, which nobody needs any more
    with suppress(OSError):
        scratch.close()
