"""Which cells of a large grid were compared, a bit each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import MapHeader

_BITS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Bits of the cells, row by row; windows begin at multiples of 8 columns."""

    bits: NDArray[np.uint8]

    @classmethod
    def over(cls, header: MapHeader) -> Self:
        """None of a grid's cells."""
        return cls(bits=np.zeros((header.height, -(-header.width // _BITS)), np.uint8))

    def note(self, window: Window, shown: NDArray[np.bool_]) -> None:
        """Take in a window."""
        packed = np.packbits(shown, axis=1)
        col = window[0] // _BITS
        self.bits[window[1] : window[1] + window[3], col : col + packed.shape[1]] = packed

    def read(self, window: Window) -> NDArray[np.bool_]:
        """A window's cells."""
        col = window[0] // _BITS
        part = self.bits[window[1] : window[1] + window[3], col : col + -(-window[2] // _BITS)]
        return np.unpackbits(part, axis=1, count=window[2]).astype(np.bool_)
