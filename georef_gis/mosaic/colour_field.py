"""Colour of a photo as a smooth field over the mosaic: what its pixels are multiplied by and gain.

The field is known at the samples of the half grid, two coarse pixels apart, and bilinear between
them: the same at a pixel whoever makes the tile that it lies in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto
from georef_gis.mosaic.low_blend import LowBlend
from georef_gis.mosaic.proxies import PhotoColour, place_in_photo

Values = NDArray[np.float32]
# fine px between the places at which a photo's colour is computed; it changes over hundreds
COLOUR_STEP = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """Samples of the half grid around a window of the fine grid.

    Parameters
    ----------
    half
        Window of the half grid.
    spacing : px
        Fine pixels from sample to sample.
    x0, y0
        Where the centre of the window's first pixel lies, counted in samples from the first.
    """

    half: Window
    spacing: int
    x0: float
    y0: float

    @classmethod
    def around(cls, window: Window, factor: int) -> Lattice:
        """Of a window, for a coarse grid of `factor` fine pixels."""
        spacing = 2 * factor
        # sample k lies at (2 k + 0.5) factor, outer corners counted from 0
        first = [(c + 0.5 - 0.5 * factor) / spacing for c in (window.col, window.row)]
        corner = [int(np.floor(v)) for v in first]
        size = [
            int(np.floor(v + (n - 1) / spacing)) - k + 2
            for v, n, k in zip(first, (window.width, window.height), corner, strict=True)
        ]
        return cls(
            half=Window(col=corner[0], row=corner[1], width=size[0], height=size[1]),
            spacing=spacing,
            x0=first[0] - corner[0],
            y0=first[1] - corner[1],
        )


def value_range(dtype: np.dtype[Any]) -> tuple[float, float]:
    """Least and largest grey value of a type; infinite for floats."""
    if dtype.kind not in "iu":
        return -np.inf, np.inf
    bits = 8 * dtype.itemsize
    low = -(2.0 ** (bits - 1)) if dtype.kind == "i" else 0.0
    return low, low + 2.0**bits - 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tint:
    """What grey values are multiplied by and then gain, at the samples of a lattice.

    Parameters
    ----------
    gain, add : shape (rows, cols, bands)
    knee
        One over the grey value that gains leave as it is, see `tone.py`; 0 = none.
    """

    lattice: Lattice
    gain: Values
    add: Values
    knee: float = 0.0

    @classmethod
    def none(cls, lattice: Lattice, bands: int) -> Tint:
        """Leaves values as they are."""
        ones = np.ones((2, 2, bands), np.float32)
        return cls(lattice=lattice, gain=ones, add=np.zeros_like(ones))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotoTint:
    """What is done to a photo's grey values, over all that it shows.

    Parameters
    ----------
    half
        Window of the half grid.
    gain : shape (rows, cols, bands)
    offset : shape (bands,)
        Added to what `gain` gives.
    base : shape (rows, cols, bands)
        Low frequencies of the corrected photo, over `base_half`; None where they stay.
    knee
        One over the grey value that gains leave as it is; 0 = none.
    """

    half: Window
    gain: Values
    offset: Values
    base: Values | None = None
    base_half: Window | None = None
    knee: float = 0.0

    def over(self, lattice: Lattice, blend: LowBlend | None) -> Tint:
        """The part over a lattice; what lies beyond the photo repeats its rim."""
        gain = _part(self.gain, self.half, lattice.half)
        add = np.broadcast_to(self.offset, gain.shape)
        if blend is not None and self.base is not None and self.base_half is not None:
            add = add + blend.correction(lattice.half, self.base, self.base_half)
        add = np.ascontiguousarray(add, dtype=np.float32)
        return Tint(lattice=lattice, gain=gain, add=add, knee=self.knee)

    @property
    def nbytes(self) -> int:
        """Memory it takes."""
        return self.gain.nbytes + (0 if self.base is None else self.base.nbytes)


def _part(values: Values, own: Window, wanted: Window) -> Values:
    rows = np.clip(np.arange(wanted.height) + wanted.row - own.row, 0, own.height - 1)
    cols = np.clip(np.arange(wanted.width) + wanted.col - own.col, 0, own.width - 1)
    return np.ascontiguousarray(values[rows[:, None], cols[None, :]])


def gain_over(
    photo: OrientedPhoto,
    colour: PhotoColour,
    index: int,
    lattice: Lattice,
    ground: Ground,
    grid: Grid,
) -> Values:
    """Factor of a photo's colour at the samples of a lattice; (rows, cols, bands).

    It is computed every `COLOUR_STEP` px, and bilinear between.
    """
    half, spacing = lattice.half, lattice.spacing
    stride = max(1, COLOUR_STEP // spacing)
    cols, across = _knots(half.col, half.width, stride)
    rows, down = _knots(half.row, half.height, stride)
    # two coarse px make a sample, which lies in the centre of the first
    place = np.stack(np.meshgrid(cols, rows), axis=-1) * float(spacing) + 0.25 * spacing
    xy, view = place_in_photo(photo, ground.enu_at(grid, place))
    knots = colour.factor(index, xy, np.nan_to_num(view))
    out = np.tensordot(np.tensordot(down, knots, axes=(1, 0)), across, axes=(1, 1))
    return np.ascontiguousarray(np.moveaxis(out, 2, 1), dtype=np.float32)


def _knots(first: int, count: int, stride: int) -> tuple[Array, Array]:
    """Every `stride`-th sample around a range, and weights of them at each; (k,), (count, k)."""
    low = first // stride
    high = -(-(first + count - 1) // stride)
    k = np.arange(low, max(high, low + 1) + 1)
    at = np.arange(first, first + count) / stride
    weights = np.clip(1.0 - np.abs(at[:, None] - k), 0.0, None)
    return np.asarray(k * float(stride), dtype=np.float64), np.asarray(weights)
