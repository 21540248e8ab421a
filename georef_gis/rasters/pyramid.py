"""Halving of tiles for overviews, so that missing pixels never darken their neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Samples = NDArray[Any]  # (rows, cols, bands)
Mask = NDArray[np.uint8]  # (rows, cols), 1 = valid, 0 = missing


@dataclass(frozen=True, slots=True, kw_only=True)
class Tile:
    """Pixels of a tile; without a mask all are valid.

    Parameters
    ----------
    data : shape (rows, cols, bands)
        Samples; of no meaning where the mask is 0.
    mask : shape (rows, cols)
        1 = valid, 0 = missing.
    """

    data: Samples
    mask: Mask | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """Grid of tiles of one resolution: 0 is the full one, each next half as fine."""

    width: int
    height: int
    tile_size: int

    @property
    def across(self) -> int:
        """Columns of tiles."""
        return -(-self.width // self.tile_size)

    @property
    def down(self) -> int:
        """Rows of tiles."""
        return -(-self.height // self.tile_size)

    def shape(self, row: int, col: int) -> tuple[int, int]:
        """Rows and columns of pixels of a tile, fewer at the right and bottom edge."""
        size = self.tile_size
        return min(size, self.height - row * size), min(size, self.width - col * size)


# px; the coarsest overview fits a square of this side whatever the tiles.
_COARSEST = 512


def levels(width: int, height: int, tile_size: int, *, overviews: bool) -> list[Level]:
    """Full resolution and its overviews, down to the first that fits 512 px and one tile."""
    result = [Level(width=width, height=height, tile_size=tile_size)]
    while overviews and max(width, height) > min(tile_size, _COARSEST):
        width, height = -(-width // 2), -(-height // 2)
        result.append(Level(width=width, height=height, tile_size=tile_size))
    return result


def halve(tile: Tile) -> Tile:
    """Mean of the valid pixels of each 2 x 2 cell; valid where any of the four is.

    An odd last row or column counts twice, which leaves the mean of what is there.
    """
    data, mask = _even(tile.data), tile.mask
    rows, cols, bands = data.shape
    size = (cols // 2, rows // 2)
    half = cv2.resize(data, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0], bands)
    if mask is None:
        return Tile(data=half, mask=None)
    mask = _even(mask)
    # 0, 4: their rounded mean is the count of valid pixels
    count = cv2.resize(mask << 2, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0])
    row, col = np.nonzero((count > 0) & (count < 4))
    if row.size:
        half[row, col] = _weighted(data, mask, row, col)
    valid = np.minimum(count, 1)
    return Tile(data=half, mask=None if valid.all() else valid)


def _weighted(data: Samples, mask: Mask, row: NDArray[np.intp], col: NDArray[np.intp]) -> Samples:
    """Mean of the valid pixels of the cells named, shape (cells, bands)."""
    whole = np.issubdtype(data.dtype, np.integer)
    total: NDArray[Any] = np.zeros((row.size, data.shape[2]), np.int64 if whole else np.float64)
    count = np.zeros((row.size, 1), np.int64)
    for down in (0, 1):
        for right in (0, 1):
            at = (2 * row + down, 2 * col + right)
            weight = mask[at][:, None]
            # where, not a product: missing floats may be NaN
            total += np.where(weight != 0, data[at], 0)
            count += weight
    mean = (2 * total + count) // (2 * count) if whole else total / count
    return mean.astype(data.dtype)


def _even(values: NDArray[Any]) -> NDArray[Any]:
    """The array with its last row and column repeated if their number is odd."""
    rows, cols = values.shape[:2]
    return extended(values, rows + rows % 2, cols + cols % 2)


def extended(values: NDArray[Any], rows: int, cols: int) -> NDArray[Any]:
    """The array filled up to a size by repeating its last row and column."""
    bottom, right = rows - values.shape[0], cols - values.shape[1]
    if not bottom and not right:
        return values
    larger = cv2.copyMakeBorder(values, 0, bottom, 0, right, cv2.BORDER_REPLICATE)
    return larger.reshape(rows, cols, *values.shape[2:])


def join(quarters: list[Tile | None], shape: tuple[int, int], half: int, like: Samples) -> Tile:
    """One tile of four halved ones: upper left, upper right, lower left, lower right.

    Parameters
    ----------
    quarters
        None where there is nothing.
    shape
        Rows and columns of the tile.
    half
        Side of a whole quarter, px.
    like
        Samples that tell bands and dtype.
    """
    rows, cols = shape
    data = np.zeros((rows, cols, like.shape[2]), like.dtype)
    mask = np.zeros((rows, cols), np.uint8)
    for index, quarter in enumerate(quarters):
        if quarter is not None:
            top, left = half * (index // 2), half * (index % 2)
            at = np.s_[top : top + quarter.data.shape[0], left : left + quarter.data.shape[1]]
            data[at] = quarter.data
            mask[at] = 1 if quarter.mask is None else quarter.mask
    return Tile(data=data, mask=None if mask.all() else mask)
