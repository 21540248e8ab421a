"""What a journal of tiles tells: which are finished and where they lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.pyramid import Level

# level, row, col
Place = tuple[int, int, int]
# Kinds of records: a tile is stored; its half waits; a tile of level 0 is empty; no more tiles
# come; a tile and all below it are damaged and have to be made again; what is to be known of a
# tile of level 0; such a tile is not for a later run.
TILE, HALF, EMPTY, CLOSED, LOST, NOTE, PROVISIONAL = "t", "h", "e", "c", "l", "n", "p"
Record = Sequence[Any]

_STORED = np.dtype(
    [("start", "i8"), ("image", "u4"), ("mask", "u4"), ("checksum", "u4"), ("partial", "?")]
)


class HalfPlace(NamedTuple):
    """Where the half of a tile lies, whether it has a mask, and the CRC-32 of its bytes."""

    slot: int
    masked: bool
    checksum: int


def tile_record(place: Place, start: int, sizes: tuple[int, int], sums: tuple[int, bool]) -> Record:
    """A tile is stored: where, the bytes of image and mask, their checksum, whether partial."""
    return [TILE, *place, start, *sizes, *sums]


def remarks(row: int, col: int, note: Any, *, provisional: bool) -> list[Record]:
    """What is told of a tile of level 0 beside where it lies; a `note` of None is none."""
    told: list[Record] = [] if note is None else [[NOTE, row, col, note]]
    return [*told, [PROVISIONAL, row, col]] if provisional else told


def half_record(place: Place, half: HalfPlace) -> Record:
    """The half of a tile waits for its neighbours."""
    return [HALF, *place, *half]


class Ledger:
    """Finished tiles of all levels.

    Attributes
    ----------
    resolved : shape (rows, cols)
        Tiles of the full resolution that need not be written again.
    stored : one array of shape (rows, cols) a level
        Where each tile lies and its checksum; `image` is 0 where there is none.
    halves
        Halves that were written, by the tile they were made of.
    notes
        What is to be known of tiles of the full resolution, by row and column.
    provisional : shape (rows, cols)
        Tiles of the full resolution that a later run has to make again.
    """

    def __init__(self, levels: Sequence[Level]) -> None:
        self.stored: list[NDArray[Any]] = [np.zeros((at.down, at.across), _STORED) for at in levels]
        self.resolved: NDArray[np.bool_] = np.zeros(self.stored[0].shape, np.bool_)
        self.halves: dict[Place, HalfPlace] = {}
        self.notes: dict[tuple[int, int], Any] = {}
        self.provisional: NDArray[np.bool_] = np.zeros_like(self.resolved)

    def apply(self, records: Sequence[Record]) -> None:
        """Take over one entry of the journal."""
        for kind, *values in records:
            if kind == TILE:
                level, row, col, start, image, mask, checksum, partial = values
                self.stored[level][row, col] = (start, image, mask, checksum, partial)
                if level == 0:
                    self.resolved[row, col] = True
                for quarter in range(4) if level else ():
                    below = level - 1, 2 * row + quarter // 2, 2 * col + quarter % 2
                    self.halves.pop(below, None)
            elif kind == HALF:
                level, row, col, *rest = values
                self.halves[level, row, col] = HalfPlace(*rest)
            elif kind == EMPTY:
                self.resolved[values[0], values[1]] = True
            elif kind == CLOSED:
                self.resolved[:] = True
            elif kind == LOST:
                self.lose((values[0], values[1], values[2]))
            elif kind == NOTE:
                self.notes[values[0], values[1]] = values[2]
            elif kind == PROVISIONAL:
                self.provisional[values[0], values[1]] = True

    def has(self, place: Place) -> bool:
        """Whether a tile is stored."""
        level, row, col = place
        return bool(self.stored[level]["image"][row, col])

    def lose(self, place: Place) -> None:
        """Drop a tile and all it was made of: only their raw pixels can make it again."""
        top, row, col = place
        for level in range(top, -1, -1):
            side = 1 << (top - level)
            part = np.s_[row * side : (row + 1) * side, col * side : (col + 1) * side]
            tiles = self.stored[level][part]
            for down, right in np.argwhere(tiles["image"] > 0):
                self.halves.pop((level, row * side + int(down), col * side + int(right)), None)
            if level == 0:
                # empty ones stay as they are
                self.resolved[part] &= (tiles["image"] == 0) & ~self.provisional[part]
                self.provisional[part] = False
                for at in [at for at in self.notes if (at[0] >> top, at[1] >> top) == (row, col)]:
                    del self.notes[at]
            tiles[:] = 0

    def lose_provisional(self) -> Iterator[Place]:
        """Drop the provisional tiles with all overviews of them, which are given."""
        for row, col in np.argwhere(self.provisional).tolist():
            # an overview that was dropped may have taken it along
            if self.provisional[row, col]:
                above = [(n, row >> n, col >> n) for n in range(len(self.stored))]
                place = max(filter(self.has, above), default=above[0])
                self.lose(place)
                yield place

    def waiting(self, level: int) -> list[tuple[Place, HalfPlace | None]]:
        """Tiles of a level whose overview tile is not made yet, with their halves if known."""
        content = self.stored[level]["image"] > 0
        above = self.stored[level + 1]["image"] > 0
        covered = above.repeat(2, axis=0).repeat(2, axis=1)[: content.shape[0], : content.shape[1]]
        places = [(level, int(row), int(col)) for row, col in np.argwhere(content & ~covered)]
        return [(place, self.halves.get(place)) for place in places]


def sums_of_quarters(values: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many of the up to four tiles below each overview tile are set."""
    rows, cols = values.shape
    even = np.zeros((rows + rows % 2, cols + cols % 2), np.int64)
    even[:rows, :cols] = values
    quarters = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2)
    return np.asarray(quarters.sum(axis=(1, 3)))
