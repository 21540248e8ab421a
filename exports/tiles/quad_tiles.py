"""A tile and its four children, all premultiplied BGRA."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from exports.tiles.raster_colour import Pixels


def quarter(block: Pixels, i: int, j: int, half: int) -> Pixels:
    """Part of a block under child column `i` and row `j`, each `half` px wide where whole."""
    return block[j * half : (j + 1) * half, i * half : (i + 1) * half]


def mean_of_children(
    children: Mapping[tuple[int, int], Pixels], side: int, size: tuple[int, int]
) -> Pixels:
    """Tile made of its children at half their scale.

    Parameters
    ----------
    children
        By column and row; missing ones are empty.
    side : px
        Of a whole child.
    size : px
        Width and height of the tile.
    """
    width, height = size
    four = np.zeros((2 * height, 2 * width, 4), dtype=np.uint8)
    for (i, j), child in children.items():
        quarter(four, i, j, side)[:] = child
    # Colour is premultiplied, so missing pixels weigh nothing in the mean.
    return np.asarray(cv2.resize(four, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
