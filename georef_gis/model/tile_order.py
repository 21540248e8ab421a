"""In which order to render tiles so that each photo is decoded about once."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence

# units (blocks of tiles) at most for trying orders out; larger plans are tried in coarser blocks
TRIAL_UNITS = 1200
DIRECTIONS = 8
# the order of a Z-curve is kept unless another saves more than this part of the decodes
WORTH = 0.03

Cell = tuple[int, int]
Key = Callable[[Cell], tuple[float, ...]]


def best_order(
    cells: Sequence[Cell], photos: Sequence[Sequence[str]], *, capacity: int
) -> list[int]:
    """Indices of tiles in the order that decodes least, found by trying orders out.

    A Z-curve, and sweeps in eight directions over swaths of several widths; decodes are counted as
    a cache that drops the photo needed last would do.

    Parameters
    ----------
    cells
        (row, col) of the tiles.
    photos
        Photos that each tile may need.
    capacity
        Photos that the cache holds.
    """
    size = max(1, math.ceil(math.sqrt(len(cells) / TRIAL_UNITS)))
    blocks: dict[Cell, set[str]] = {}
    for (row, col), names in zip(cells, photos, strict=True):
        blocks.setdefault((row // size, col // size), set()).update(names)
    units = list(blocks)
    best: Key = _z_key
    fewest = math.inf
    for i, key in enumerate(_keys(units)):
        order = sorted(units, key=key)
        decodes = _decodes([sorted(blocks[unit]) for unit in order], capacity)
        if decodes < fewest * (1.0 - WORTH if i else 1.0):
            best, fewest = key, decodes
        if decodes == len({name for names in blocks.values() for name in names}):
            break
    return sorted(
        range(len(cells)),
        key=lambda i: (best((cells[i][0] // size, cells[i][1] // size)), _z_key(cells[i])),
    )


def _keys(units: Sequence[Cell]) -> Iterator[Key]:
    yield _z_key
    rows, cols = [row for row, _ in units], [col for _, col in units]
    span = max(max(rows) - min(rows), max(cols) - min(cols)) + 1
    for width in (span * 2, *(w for w in (32, 16, 8, 4) if w < span)):
        for step in range(DIRECTIONS):
            yield _Sweep(math.pi * step / DIRECTIONS, width)


class _Sweep:
    """Sort key: swath by swath, to and fro along a direction."""

    def __init__(self, angle: float, width: int) -> None:
        self._cos, self._sin = math.cos(angle), math.sin(angle)
        self._width = width

    def __call__(self, cell: Cell) -> tuple[float, ...]:
        row, col = cell
        along = col * self._cos + row * self._sin
        across = -col * self._sin + row * self._cos
        swath = math.floor(across / self._width)
        return (swath, along if swath % 2 == 0 else -along, across)


def _z_key(cell: Cell) -> tuple[float, ...]:
    """Position on a Z-curve: interleaved bits of row and column."""
    row, col = cell
    out = 0
    for bit in range(max(row, col, 1).bit_length()):
        out |= ((col >> bit) & 1) << (2 * bit) | ((row >> bit) & 1) << (2 * bit + 1)
    return (out,)


def _decodes(jobs: Sequence[Sequence[str]], capacity: int) -> int:
    """Decodes of a cache that drops the photo whose next use is farthest off (Belady 1966)."""
    uses: dict[str, list[int]] = {}
    for number, names in enumerate(jobs):
        for name in names:
            uses.setdefault(name, []).append(number)

    def next_use(name: str, number: int) -> float:
        at = uses[name]
        i = bisect_left(at, number)
        return at[i] if i < len(at) else math.inf

    held: set[str] = set()
    decodes = 0
    for number, names in enumerate(jobs):
        for name in names:
            if name in held:
                continue
            decodes += 1
            if len(held) >= capacity:
                held.remove(max(sorted(held), key=lambda n: next_use(n, number)))
            held.add(name)
    return decodes
