"""Tiles of the full resolution become encoded tiles of all levels, by any number of threads."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from georef_gis.rasters.codecs import Encoder
from georef_gis.rasters.ledger import CLOSED, EMPTY, Place, Record, half_record, tile_record
from georef_gis.rasters.overviews import Overviews, Quarters
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Level, Tile, halve
from georef_gis.rasters.quarters import Kept, QuarterStore
from georef_gis.rasters.spool import Backing, LevelSpool, framed
from georef_gis.rasters.work_folder import Resumption, WorkFolder

# bytes of halved tiles kept in memory
_WAITING_LIMIT = 48 << 20
# From this level on a tile stands for 64 and more; it is on the disk before it is declared, so that
# a failure of the power costs no more than the last seconds.
_SYNCED_LEVEL = 3


@dataclass(slots=True, kw_only=True)
class Step:
    """What one tile brought about: records to commit, and halves that need not wait any more."""

    records: list[Record] = field(default_factory=list)
    done: list[Kept] = field(default_factory=list)


class PyramidBuilder:
    """Encodes tiles and every overview tile they complete; threads may share it.

    Parameters
    ----------
    profile, levels
        What the raster is; full resolution first.
    backing
        Where the tiles are kept.

    Attributes
    ----------
    spools
        Encoded tiles of each level.
    """

    def __init__(self, profile: RasterProfile, levels: Sequence[Level], backing: Backing) -> None:
        self._profile = profile
        self._levels = levels
        self._backing = backing
        self._encoder = Encoder(profile)
        self._lock = threading.Lock()
        self.spools: list[LevelSpool] = []
        self._quarters = QuarterStore(
            profile, backing.halves_file, limit=_WAITING_LIMIT, lasting=backing.lasting
        )
        self._overviews = Overviews(profile, levels, self._quarters)

    @property
    def jpeg_tables(self) -> bytes:
        """DQT and DHT of all tiles, for the tag JPEGTables."""
        return self._encoder.jpeg_tables

    @property
    def size(self) -> int:
        """Bytes the final file takes at least."""
        return sum(spool.size for spool in self.spools)

    def open(self) -> None:
        """Open the files of all levels."""
        for number, level in enumerate(self._levels):
            self.spools.append(LevelSpool(level, self._backing.level_file(number)))

    def recover(self, work: WorkFolder) -> Resumption:
        """Go on with what an earlier run kept."""
        return work.recover(self.spools, self._quarters, self._overviews)

    def finish(self, place: Place, tile: Tile | None, step: Step | None = None) -> None:
        """Encode a tile and every overview tile it completes; None = nothing in it is valid."""
        step = step or Step()
        if tile is None:
            step.records.append([EMPTY, *place[1:]])
        while True:
            half = None if tile is None else self._store(step, place, tile)
            level, key = place[0] + 1, (place[1] // 2, place[2] // 2)
            # an overview tile made by an earlier run does not wait for one that was damaged since
            if level == len(self._levels) or self.spools[level].has(*key):
                break
            with self._lock:
                found = self._overviews.arrived(place, half)
            if not isinstance(found, Quarters):
                self._declare_half(step, place, found)
                break
            step.done += found.kept
            tile = self._overviews.joined(level, key, found)
            place = level, *key
        self._commit(step)

    def no_more(self) -> None:
        """Declare tiles that never came empty."""
        self._commit(Step(records=[[CLOSED]]))

    def incomplete(self, level: int) -> list[tuple[int, int]]:
        """Overview tiles of a level that wait for tiles which never came."""
        with self._lock:
            return self._overviews.incomplete(level)

    def taken(self, level: int, key: tuple[int, int]) -> tuple[Step, Tile | None]:
        """An overview tile of the quarters that have come, to be finished."""
        with self._lock:
            quarters = self._overviews.take(level, key)
        return Step(done=quarters.kept), self._overviews.joined(level, key, quarters)

    def drop_halves(self) -> None:
        """Give back the space of halves, none of which waits any more."""
        self._quarters.drop()

    def close(self) -> None:
        """Close all files, and give their space back unless they outlive the process."""
        for spool in self.spools:
            spool.close()
        self._quarters.close()
        self._overviews.clear()

    def _store(self, step: Step, place: Place, tile: Tile) -> Tile | None:
        """Encode and keep a tile; its half if there is a coarser level."""
        level, row, col = place
        image, mask = self._encoder.image(tile), b""
        record = framed(image)
        if self._profile.validity == "mask":
            mask = self._encoder.mask(tile)
            record += framed(mask)
        spool, partial = self.spools[level], tile.mask is not None
        index, sizes = row * spool.level.across + col, (len(image), len(mask))
        with self._lock:
            start = spool.add(index, sizes, record, partial=partial)
        if self._backing.lasting:
            sums = zlib.crc32(record), partial
            step.records.append(tile_record(place, start, sizes, sums))
            if level >= _SYNCED_LEVEL:
                spool.sync()
        return halve(tile) if level + 1 < len(self._levels) else None

    def _declare_half(self, step: Step, place: Place, kept: Kept | None) -> None:
        if self._backing.lasting and kept is not None and kept.place is not None:
            step.records.append(half_record(place, kept.place))
            if place[0] >= _SYNCED_LEVEL:
                self._quarters.sync()

    def _commit(self, step: Step) -> None:
        """Declare what is written, and only then let it be written over."""
        with self._lock:
            self._backing.commit(step.records)
            for kept in step.done:
                self._quarters.release(kept)
