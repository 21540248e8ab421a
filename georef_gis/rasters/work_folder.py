"""Files of an unfinished raster that outlive the process, and what is left of them later."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from georef_gis.errors import ExportError
from georef_gis.rasters.files import lasting_file
from georef_gis.rasters.journal import Journal
from georef_gis.rasters.ledger import LOST, Ledger, Place, Record
from georef_gis.rasters.overviews import Overviews
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Level
from georef_gis.rasters.quarters import Kept, QuarterStore
from georef_gis.rasters.spool import LevelSpool, length_of

# Counts up when older journals can no longer be understood.
_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What was left of an earlier run.

    Parameters
    ----------
    tiles
        Tiles of the full resolution that need not be written again, empty ones not counted.
    lost
        Tiles of all levels that were damaged; what they were made of is to be written again.
    note
        One line for the user where the earlier run could not be taken over whole; else empty.
    """

    tiles: int = 0
    lost: int = 0
    note: str = ""


class WorkFolder:
    """Spools, halves and journal of one raster in a folder that others may share.

    Parameters
    ----------
    folder
        Made if there is none.
    target
        The raster; its name begins the names of the files.
    key
        Fingerprint of what is written.
    profile, levels
        What the raster is.

    Raises
    ------
    ExportError
        If another process writes the same raster.
    OSError
        If the disk refuses.
    """

    lasting = True

    def __init__(
        self,
        folder: Path,
        target: Path,
        key: str,
        *,
        profile: RasterProfile,
        levels: Sequence[Level],
    ) -> None:
        self.folder = folder
        self.ledger = Ledger(levels)
        self._prefix = f"{target.name}."
        folder.mkdir(parents=True, exist_ok=True)
        try:
            self._journal = Journal(folder / f"{self._prefix}journal")
        except BlockingIOError as error:
            raise ExportError(
                f"{target}: another run is writing it with {folder}; wait for it or stop it"
            ) from error
        try:
            self._afresh = self._replay([_VERSION, key, _fingerprint(profile, levels)])
        except BaseException:
            self._journal.close()
            raise

    def level_file(self, number: int) -> IO[bytes]:
        """File for the encoded tiles of a level."""
        return lasting_file(self.folder / f"{self._prefix}level-{number}")

    def halves_file(self) -> IO[bytes]:
        """File for the halved tiles in waiting."""
        return lasting_file(self.folder / f"{self._prefix}halves")

    def commit(self, records: Sequence[Record]) -> None:
        """Declare that what the records tell is written."""
        self._journal.append(records)

    def remove(self) -> None:
        """Remove all files; the lock is held until `close`."""
        # first, as a journal without its tiles would promise what is not there
        self._journal.remove()
        self._remove_data()

    def close(self) -> None:
        """Close the journal, so that another process may go on."""
        self._journal.close()

    def recover(
        self, spools: Sequence[LevelSpool], store: QuarterStore, overviews: Overviews
    ) -> Resumption:
        """Check all that was kept and give it to those who go on with it."""
        lost = [*_damaged_tiles(self.ledger, spools)]
        for place in lost:
            self.ledger.lose(place)
        provisional = int(np.count_nonzero(self.ledger.provisional))
        again = [*self.ledger.lose_provisional()]
        kept: dict[Place, Kept] = {}
        for level in range(len(spools) - 2, -1, -1):
            for place, half in self.ledger.waiting(level):
                rows, cols = spools[level].level.shape(*place[1:])
                shape = (-(-rows // 2), -(-cols // 2), store.bands)
                if half is not None and store.is_sound(shape, half):
                    kept[place] = Kept(level=level, shape=shape, tile=None, place=half)
                else:
                    lost.append(place)
                    self.ledger.lose(place)
        if lost or again:
            self.commit([[LOST, *place] for place in [*lost, *again]])
        for spool, tiles in zip(spools, self.ledger.stored, strict=True):
            spool.restore(*(tiles[name].reshape(-1) for name in ("start", "image", "mask")))
            spool.partial = bool(tiles["partial"].any())
        store.restore([half.place.slot for half in kept.values() if half.place is not None])
        overviews.restore(self.ledger, kept)
        # slots that are free now may be written over: this must not undo what frees them
        self._journal.sync()
        return self._resumption(len(lost), provisional)

    def _resumption(self, lost: int, provisional: int) -> Resumption:
        tiles = int(np.count_nonzero(self.ledger.stored[0]["image"]))
        self.ledger.stored.clear()
        self.ledger.halves.clear()
        note = self._afresh
        if lost:
            note = f"{lost} kept tiles in {self.folder} were damaged and are made again"
        elif self._journal.cut > 1 and not note:
            note = f"the journal in {self.folder} was damaged; work after that place is done again"
        elif provisional:
            why = "were made without all their photos and are made again"
            note = f"{provisional} kept tiles in {self.folder} {why}"
        return Resumption(tiles=tiles, lost=lost, note=note)

    def _replay(self, head: list[Any]) -> str:
        """Read the journal, or begin it; why an earlier one was of no use."""
        entries = self._journal.entries()
        found = next(entries, None)
        if found == head:
            for records in entries:
                self.ledger.apply(records)
            return ""
        why = "was made from other photos or settings"
        if found is None:
            why = "is damaged" if self._journal.cut > 1 else ""
        elif found[0] != _VERSION:
            why = "was made by another version"
        entries.close()
        self._journal.clear()
        self._remove_data()
        self._journal.append(head)
        return why and f"begun anew: the unfinished work in {self.folder} {why}"

    def _remove_data(self) -> None:
        # the user may have removed them, or the folder, before
        with suppress(OSError):
            for path in list(self.folder.iterdir()):
                name = path.name.removeprefix(self._prefix)
                if name != path.name and (name == "halves" or name.startswith("level-")):
                    path.unlink()


def _fingerprint(profile: RasterProfile, levels: Sequence[Level]) -> str:
    """What else the bytes of tiles depend on: the profile, the levels, the codecs."""
    import cv2

    what = {**asdict(profile), "metadata": list(profile.metadata.items())}
    parts = [what, len(levels), cv2.__version__, zlib.ZLIB_RUNTIME_VERSION]
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=16).hexdigest()


def _damaged_tiles(ledger: Ledger, spools: Sequence[LevelSpool]) -> Iterator[Place]:
    """Tiles whose bytes are not what was written."""
    for level, (tiles, spool) in enumerate(zip(ledger.stored, spools, strict=True)):
        places = np.argwhere(tiles["image"] > 0)
        # in the order of the file, which a disk reads fastest
        for row, col in places[np.argsort(tiles["start"][tiles["image"] > 0], kind="stable")]:
            _, image, mask, checksum, _ = tiles[row, col].item()
            start = int(tiles["start"][row, col])
            try:
                data = spool.read(start, start + length_of(image, mask))
            except OSError:
                data = b""
            if zlib.crc32(data) != checksum:
                yield level, int(row), int(col)
