"""Overview tiles in the making: which of their quarters have come."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.rasters.ledger import Ledger, Place, sums_of_quarters
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Level, Tile, join
from georef_gis.rasters.quarters import Kept, QuarterStore


@dataclass(slots=True, kw_only=True)
class Quarters:
    """The four quarters of an overview tile: upper left, upper right, lower left, lower right.

    Parameters
    ----------
    tiles
        Their pixels; None where nothing is valid.
    kept
        Where they waited; to be released once the overview tile is written.
    """

    tiles: list[Tile | None]
    kept: list[Kept] = field(default_factory=list)


class Overviews:
    """Quarters in waiting; the caller keeps other threads out.

    Parameters
    ----------
    profile
        Tells the size of tiles.
    levels
        Full resolution first.
    store
        Where the quarters are.
    """

    def __init__(
        self, profile: RasterProfile, levels: Sequence[Level], store: QuarterStore
    ) -> None:
        self._levels = levels
        self._store = store
        self._half = profile.tile_size // 2
        self._like = np.empty((0, 0, profile.bands), profile.dtype)
        self._waiting: list[dict[tuple[int, int], list[Kept | None]]] = [{} for _ in levels]
        self._missing: list[dict[tuple[int, int], int]] = [{} for _ in levels]

    def arrived(self, place: Place, half: Tile | None) -> Quarters | Kept | None:
        """Note that a tile is done, with its half if anything in it is valid.

        Returns
        -------
        Quarters, Kept or None
            The quarters of the overview tile if this was the last of them; else where the half
            waits.
        """
        level, row, col = place
        key = row // 2, col // 2
        missing = self._missing[level + 1]
        left = missing.get(key) or self._below(level, key)
        if left == 1:
            missing.pop(key, None)
            quarters = self.take(level + 1, key)
            quarters.tiles[_quarter(row, col)] = half
            return quarters
        missing[key] = left - 1
        if half is None:
            return None
        kept = self._store.put(level, half)
        self._waiting[level + 1].setdefault(key, [None] * 4)[_quarter(row, col)] = kept
        return kept

    def incomplete(self, level: int) -> list[tuple[int, int]]:
        """Overview tiles of a level that hold something and wait for tiles that never came."""
        self._missing[level].clear()
        return sorted(self._waiting[level])

    def take(self, level: int, key: tuple[int, int]) -> Quarters:
        """What has come of an overview tile; it no longer waits."""
        waiting = self._waiting[level].pop(key, [None] * 4)
        return Quarters(
            tiles=[None if kept is None else self._store.take(kept) for kept in waiting],
            kept=[kept for kept in waiting if kept is not None],
        )

    def joined(self, level: int, key: tuple[int, int], quarters: Quarters) -> Tile | None:
        """The overview tile; None if nothing in it is valid."""
        if not any(quarters.tiles):
            return None
        return join(quarters.tiles, self._levels[level].shape(*key), self._half, self._like)

    def restore(self, ledger: Ledger, kept: Mapping[Place, Kept]) -> None:
        """Wait for what an earlier run waited for, with the halves it kept."""
        resolved = ledger.resolved
        for level in range(1, len(self._levels)):
            content = ledger.stored[level]["image"] > 0
            total = sums_of_quarters(np.ones_like(resolved))
            known = sums_of_quarters(resolved)
            filled = sums_of_quarters(ledger.stored[level - 1]["image"] > 0)
            some = ~content & (known > 0) & (known < total)
            left = (total - known)[some]
            keys = np.argwhere(some).tolist()
            self._missing[level] = {
                (row, col): count for (row, col), count in zip(keys, left.tolist(), strict=True)
            }
            resolved = content | ((known == total) & (filled == 0))
        for (level, row, col), half in kept.items():
            quarters = self._waiting[level + 1].setdefault((row // 2, col // 2), [None] * 4)
            quarters[_quarter(row, col)] = half

    def clear(self) -> None:
        """Forget everything."""
        self._waiting.clear()

    def _below(self, level: int, key: tuple[int, int]) -> int:
        """Number of tiles below an overview tile, fewer than 4 at the edges."""
        below = self._levels[level]
        return min(2, below.down - 2 * key[0]) * min(2, below.across - 2 * key[1])


def _quarter(row: int, col: int) -> int:
    return 2 * (row % 2) + col % 2
