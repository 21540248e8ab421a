"""Where the two dates differ all over, as trees in the wind do, and by how much.

Crowns lean another way from every place that they are photographed from, and waves never come
again: there high scores say little. A change is a place that stands out from what is about it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from georef_gis.measure.change.radiometry import BLOCK
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import MapHeader

# part of the cells of a block that lie below its score; that score on calm ground
_PART, _CALM = 0.85, 1.3
# quantile of the blocks about one that is its unrest
_USUAL = 0.4
# blocks about one that count, part of a block that must be shown
_AROUND, _LEAST_SHOWN = 2, 0.1
# part of a block that makes it a region's own
_OWN = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Unrest:
    """Scores of blocks.

    Parameters
    ----------
    blocks : shape (rows, cols)
        Score that most cells of a block lie below, NaN where little is shown.
    """

    blocks: NDArray[np.float32]

    @classmethod
    def over(cls, header: MapHeader) -> Self:
        """Nothing known yet."""
        shape = (-(-header.height // BLOCK), -(-header.width // BLOCK))
        return cls(blocks=np.full(shape, np.nan, np.float32))

    def note(self, scores: NDArray[np.float32], window: Window) -> None:
        """Take in the scores of a tile whose corner is that of a block."""
        for row in range(0, window[3], BLOCK):
            for col in range(0, window[2], BLOCK):
                part = scores[row : row + BLOCK, col : col + BLOCK]
                shown = part[np.isfinite(part)]
                if len(shown) >= _LEAST_SHOWN * BLOCK**2:
                    place = (window[1] + row) // BLOCK, (window[0] + col) // BLOCK
                    self.blocks[place] = np.quantile(shown, _PART)

    def about(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> float:
        """How many times higher scores are about a region's cells than on calm ground, at least 1.

        Blocks that the region itself fills do not count.
        """
        own = np.zeros(self.blocks.shape, np.int64)
        np.add.at(own, (rows // BLOCK, cols // BLOCK), 1)
        r0, r1 = rows.min() // BLOCK - _AROUND, rows.max() // BLOCK + _AROUND + 1
        c0, c1 = cols.min() // BLOCK - _AROUND, cols.max() // BLOCK + _AROUND + 1
        part = np.s_[max(0, r0) : r1, max(0, c0) : c1]
        around, filled = self.blocks[part], own[part] > _OWN * BLOCK**2
        known = around[np.isfinite(around) & ~filled]
        return max(1.0, float(np.quantile(known, _USUAL)) / _CALM) if len(known) else 1.0
