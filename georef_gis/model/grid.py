"""Grid: a north-up raster in a projected CRS; pixel to map and back."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Part of a grid: first column and row, size, px."""

    col: int
    row: int
    width: int
    height: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """North-up raster: outer corner of its first pixel, pixel size in CRS units, size in px.

    The CRS travels beside it as WKT, so that the value can be pickled and compared.
    """

    crs_wkt: str
    left: float
    top: float
    pixel: float
    width: int
    height: int

    def __post_init__(self) -> None:
        """Check ranges."""
        if not (self.pixel > 0 and math.isfinite(self.pixel)):
            raise ValueError(f"pixel size {self.pixel} must be positive")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"a grid of {self.width} x {self.height} px has no pixel")

    @classmethod
    def over(cls, bounds: tuple[float, float, float, float], *, pixel: float, crs_wkt: str) -> Grid:
        """Smallest grid over (left, bottom, right, top) whose pixels lie on multiples of `pixel`.

        Grids of one pixel size are then aligned with each other.
        """
        left, bottom, right, top = bounds
        if not all(map(math.isfinite, bounds)):
            raise ValueError(f"bounds {bounds} are not finite")
        c0, c1 = math.floor(left / pixel), math.ceil(right / pixel)
        r0, r1 = math.floor(bottom / pixel), math.ceil(top / pixel)
        return cls(
            crs_wkt=crs_wkt,
            left=c0 * pixel,
            top=r1 * pixel,
            pixel=pixel,
            width=max(1, c1 - c0),
            height=max(1, r1 - r0),
        )

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients a b c d e f: map from (col, row)."""
        return (self.pixel, 0.0, self.left, 0.0, -self.pixel, self.top)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(left, bottom, right, top), CRS units."""
        return (
            self.left,
            self.top - self.height * self.pixel,
            self.left + self.width * self.pixel,
            self.top,
        )

    def map_from_grid(self, colrow: ArrayLike) -> Array:
        """Map coordinates of (col, row), (0, 0) = outer corner; shape (..., 2)."""
        p = np.asarray(colrow, dtype=np.float64)
        return np.stack(
            [self.left + p[..., 0] * self.pixel, self.top - p[..., 1] * self.pixel], axis=-1
        )

    def grid_from_map(self, p_map: ArrayLike) -> Array:
        """(col, row), (0, 0) = outer corner, of map coordinates; shape (..., 2)."""
        p = np.asarray(p_map, dtype=np.float64)
        return np.stack(
            [(p[..., 0] - self.left) / self.pixel, (self.top - p[..., 1]) / self.pixel], axis=-1
        )

    def tiles(self, size: int) -> Iterator[tuple[int, int, Window]]:
        """(tile row, tile col, window) of square tiles, row by row; the last ones are cut."""
        for row in range(0, self.height, size):
            for col in range(0, self.width, size):
                window = Window(
                    col=col,
                    row=row,
                    width=min(size, self.width - col),
                    height=min(size, self.height - row),
                )
                yield row // size, col // size, window
