"""Halved tiles that wait for their three neighbours, in memory and on disk."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import IO

import numpy as np

from georef_gis.rasters.files import write_all
from georef_gis.rasters.ledger import HalfPlace
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Tile
from georef_gis.rasters.spool import close_quietly, read_exactly

# Slots of halves below this level are used again. One above stands for 16 tiles and more, too many
# to lose when the power fails between the new half and the line of the journal that freed its slot.
REUSED_LEVELS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """A halved tile in waiting.

    Parameters
    ----------
    level
        Level of the tile it is the half of.
    shape : (rows, cols, bands)
        Of its samples.
    tile
        The pixels; None if they are on disk only.
    place
        Where it is on disk; None if it is not.
    """

    level: int
    shape: tuple[int, int, int]
    tile: Tile | None
    place: HalfPlace | None


class QuarterStore:
    """Pixels of halved tiles; beyond a limit of memory they are on disk, or all if that lasts.

    Parameters
    ----------
    profile
        Tells the size of halves.
    open_file
        Makes the file, at the first half that goes there.
    limit
        Bytes kept in memory.
    lasting
        Write all to disk.
    """

    def __init__(
        self,
        profile: RasterProfile,
        open_file: Callable[[], IO[bytes]],
        *,
        limit: int,
        lasting: bool,
    ) -> None:
        half = profile.tile_size // 2
        self._dtype = np.dtype(profile.dtype)
        self.bands = profile.bands
        self._slot = half * half * self.bands * self._dtype.itemsize + -(-half * half // 8)
        self._open_file = open_file
        self._limit = limit
        self._lasting = lasting
        self._used = 0
        self._file: IO[bytes] | None = None
        self._free: list[int] = []
        self._slots = 0

    def put(self, level: int, tile: Tile) -> Kept:
        """Keep the half of a tile of this level."""
        rows, cols = tile.data.shape[:2]
        shape = (rows, cols, self.bands)
        size = _bytes_of(tile)
        fits = self._used + size <= self._limit
        place = self._write(tile) if self._lasting or not fits else None
        if fits:
            self._used += size
        return Kept(level=level, shape=shape, tile=tile if fits else None, place=place)

    def take(self, kept: Kept) -> Tile:
        """The pixels again; its slot stays taken until `release`."""
        if kept.tile is not None:
            self._used -= _bytes_of(kept.tile)
            return kept.tile
        if kept.place is None:
            raise RuntimeError("a halved tile is neither in memory nor on disk")
        raw = self._read(kept.shape, kept.place)
        rows, cols, bands = kept.shape
        data = np.frombuffer(raw, self._dtype, rows * cols * bands).reshape(kept.shape)
        if not kept.place.masked:
            return Tile(data=data, mask=None)
        packed = np.frombuffer(raw, np.uint8, offset=data.nbytes)
        return Tile(data=data, mask=np.unpackbits(packed, count=rows * cols).reshape(rows, cols))

    def release(self, kept: Kept) -> None:
        """Let another half have the slot."""
        if kept.place is not None and (kept.level < REUSED_LEVELS or not self._lasting):
            self._free.append(kept.place.slot)

    def is_sound(self, shape: tuple[int, int, int], place: HalfPlace) -> bool:
        """Whether the half on disk is still what was written."""
        try:
            return zlib.crc32(self._read(shape, place)) == place.checksum
        except OSError:
            return False

    def restore(self, taken: Sequence[int]) -> None:
        """Go on with these slots taken and all others free."""
        self._slots = 1 + max(taken, default=-1)
        self._free = sorted(set(range(self._slots)) - set(taken), reverse=True)
        self._stream().truncate(self._slots * self._slot)

    def sync(self) -> None:
        """Have the disk hold what was put."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def drop(self) -> None:
        """Give the disk space back for good."""
        if self._file is not None:
            self._file.truncate(0)

    def close(self) -> None:
        """Give the disk space back, unless the file outlives the process."""
        if self._file is not None:
            close_quietly(self._file)

    def _stream(self) -> IO[bytes]:
        if self._file is None:
            self._file = self._open_file()
        return self._file

    def _write(self, tile: Tile) -> HalfPlace:
        data = np.ascontiguousarray(tile.data).reshape(-1).view(np.uint8).data
        packed = b"" if tile.mask is None else np.packbits(tile.mask).tobytes()
        checksum = zlib.crc32(packed, zlib.crc32(data)) if self._lasting else 0
        if self._free:
            slot = self._free.pop()
        else:
            slot, self._slots = self._slots, self._slots + 1
        stream = self._stream()
        stream.seek(slot * self._slot)
        write_all(stream, data)
        write_all(stream, packed)
        return HalfPlace(slot=slot, masked=bool(packed), checksum=checksum)

    def _read(self, shape: tuple[int, int, int], place: HalfPlace) -> bytes:
        rows, cols, bands = shape
        size = rows * cols * bands * self._dtype.itemsize
        size += -(-rows * cols // 8) if place.masked else 0
        return read_exactly(self._stream(), place.slot * self._slot, size)


def _bytes_of(tile: Tile) -> int:
    return tile.data.nbytes + (0 if tile.mask is None else tile.mask.nbytes)
