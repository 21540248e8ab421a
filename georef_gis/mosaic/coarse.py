"""The mosaic at a coarse scale, where colour and seams are decided: grid, photos on it, rasters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from georef_gis.model.grid import Grid, Window

# px of the coarse grid; side of the blocks in which a sparse raster is kept
BLOCK = 256
# coarse px along the longer side of a photo, about
PHOTO_SIDE = 400
# fine px in a coarse one at most; tiles are a multiple of it
COARSEST = 64

Mask = NDArray[np.bool_]


def coarse_factor(photo_px: float) -> int:
    """Fine pixels along a coarse one, a power of 2, for photos so many fine pixels long."""
    factor = 1
    while factor < COARSEST and photo_px / factor > PHOTO_SIDE * 1.5:
        factor *= 2
    return factor


def coarse_grid(grid: Grid, factor: int) -> Grid:
    """Grid of pixels `factor` times as large, from the same corner, that covers all of `grid`."""
    return Grid(
        crs_wkt=grid.crs_wkt,
        left=grid.left,
        top=grid.top,
        pixel=grid.pixel * factor,
        width=-(-grid.width // factor),
        height=-(-grid.height // factor),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proxy:
    """A photo on the coarse grid.

    Parameters
    ----------
    window
        Of the coarse grid; all arrays have its shape.
    data : shape (rows, cols, bands), float32
        Grey values of the photo, averaged over a coarse pixel.
    valid : shape (rows, cols)
        Where the photo shows the ground over the whole coarse pixel.
    distance : shape (rows, cols), float32, m
        From the photo's nadir, grown towards the rim and for doubtful photos; inf where not valid.
    """

    photo_id: str
    window: Window
    data: NDArray[np.float32]
    valid: Mask
    distance: NDArray[np.float32]


class ProxySource(Protocol):
    """Photos on the coarse grid; loading one costs a read from disk at most."""

    @property
    def ids(self) -> Sequence[str]:
        """Photos, in the order that labels count."""
        ...

    @property
    def windows(self) -> Sequence[Window]:
        """Part of the coarse grid that each photo covers, in the order of `ids`."""
        ...

    def load(self, index: int) -> Proxy:
        """One photo."""
        ...


class SparseRaster:
    """A raster of which only blocks that were written exist; the rest has the value `fill`.

    A diagonal corridor costs what it covers, not its bounding box.

    Parameters
    ----------
    bands
        None for shape (rows, cols), else (rows, cols, bands).
    """

    def __init__(
        self, *, width: int, height: int, dtype: DTypeLike, fill: float, bands: int | None = None
    ) -> None:
        self.width, self.height = width, height
        self._dtype, self._fill, self._bands = np.dtype(dtype), fill, bands
        self._blocks: dict[tuple[int, int], NDArray[Any]] = {}

    def _shape(self, rows: int, cols: int) -> tuple[int, ...]:
        return (rows, cols) if self._bands is None else (rows, cols, self._bands)

    def __iter__(self) -> Iterator[Window]:
        """Windows of the blocks that exist, in rows."""
        for r, c in sorted(self._blocks):
            yield Window(
                col=c * BLOCK,
                row=r * BLOCK,
                width=min(BLOCK, self.width - c * BLOCK),
                height=min(BLOCK, self.height - r * BLOCK),
            )

    def read(self, window: Window) -> NDArray[Any]:
        """Values of a window, which may reach over the rim."""
        out = np.full(self._shape(window.height, window.width), self._fill, dtype=self._dtype)
        for key, inside, own in self._parts(window):
            block = self._blocks.get(key)
            if block is not None:
                out[own] = block[inside]
        return out

    def write(self, window: Window, values: NDArray[Any], where: Mask | None = None) -> None:
        """Set values of a window, or of some of its pixels; what lies over the rim is dropped."""
        for key, inside, own in self._parts(window):
            chosen = None if where is None else where[own]
            if chosen is not None and not chosen.any():
                continue
            block = self._blocks.get(key)
            if block is None:
                block = np.full(self._shape(BLOCK, BLOCK), self._fill, dtype=self._dtype)
                self._blocks[key] = block
            if chosen is None:
                block[inside] = values[own]
            else:
                block[inside][chosen] = values[own][chosen]

    def _parts(
        self, window: Window
    ) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
        """Blocks that a window meets: key, part of the block, part of the window."""
        top, left = max(window.row, 0), max(window.col, 0)
        bottom = min(window.row + window.height, self.height)
        right = min(window.col + window.width, self.width)
        if bottom <= top or right <= left:
            return
        for r in range(top // BLOCK, (bottom - 1) // BLOCK + 1):
            for c in range(left // BLOCK, (right - 1) // BLOCK + 1):
                r0, r1 = max(top, r * BLOCK), min(bottom, (r + 1) * BLOCK)
                c0, c1 = max(left, c * BLOCK), min(right, (c + 1) * BLOCK)
                inside = (
                    slice(r0 - r * BLOCK, r1 - r * BLOCK),
                    slice(c0 - c * BLOCK, c1 - c * BLOCK),
                )
                own = (
                    slice(r0 - window.row, r1 - window.row),
                    slice(c0 - window.col, c1 - window.col),
                )
                yield (r, c), inside, own


def common(a: Window, b: Window) -> Window | None:
    """Part that two windows share; None where they do not meet."""
    col, row = max(a.col, b.col), max(a.row, b.row)
    width = min(a.col + a.width, b.col + b.width) - col
    height = min(a.row + a.height, b.row + b.height) - row
    if width <= 0 or height <= 0:
        return None
    return Window(col=col, row=row, width=width, height=height)


def part_of(window: Window, inner: Window) -> tuple[slice, slice]:
    """Slices of arrays over `window` that cover `inner`, which lies in it."""
    top, left = inner.row - window.row, inner.col - window.col
    return slice(top, top + inner.height), slice(left, left + inner.width)


def nearest_labels(source: ProxySource, coarse: Grid) -> SparseRaster:
    """Index of the photo whose nadir is nearest, -1 where no photo shows the ground; int32."""
    labels = SparseRaster(width=coarse.width, height=coarse.height, dtype=np.int32, fill=-1)
    best = SparseRaster(width=coarse.width, height=coarse.height, dtype=np.float32, fill=np.inf)
    for index, window in enumerate(source.windows):
        distance = source.load(index).distance
        wins = distance < best.read(window)
        best.write(window, distance, wins)
        labels.write(window, np.full(distance.shape, index, np.int32), wins)
    return labels
