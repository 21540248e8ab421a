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
from georef_gis.mosaic.compiled import compiled
from georef_gis.mosaic.proxies import PhotoColour, place_in_photo
from georef_gis.rasters.warp import Image

Values = NDArray[np.float32]
# fine px between the places at which a photo's colour is computed; it changes over hundreds
COLOUR_STEP = 32


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


@dataclass(frozen=True, slots=True, eq=False)
class Knots:
    """Ground at the places at which colours are computed, and how samples follow from them.

    Parameters
    ----------
    p_enu : shape (k, l, 3), m
    down : shape (rows, k)
    across : shape (cols, l)
        Weights of the knots at the rows and columns of the lattice.
    """

    p_enu: Array
    down: Array
    across: Array

    @property
    def count(self) -> int:
        """Number of knots."""
        return int(self.p_enu.shape[0] * self.p_enu.shape[1])

    @classmethod
    def under(cls, lattice: Lattice, ground: Ground, grid: Grid) -> Knots:
        """Knots of a lattice."""
        half, spacing = lattice.half, lattice.spacing
        stride = max(1, COLOUR_STEP // spacing)
        cols, across = _knots(half.col, half.width, stride)
        rows, down = _knots(half.row, half.height, stride)
        # two coarse px make a sample, which lies in the centre of the first
        place = np.stack(np.meshgrid(cols, rows), axis=-1) * float(spacing) + 0.25 * spacing
        return cls(ground.enu_at(grid, place), down, across)

    def samples(self, knots: Array) -> Values:
        """Values at the lattice's samples from those at the knots; (k, l, b) -> (rows, cols, b)."""
        rows = np.tensordot(self.down, knots, axes=(1, 0))
        out = np.tensordot(rows, self.across, axes=(1, 1))
        return np.ascontiguousarray(np.moveaxis(out, 2, 1), dtype=np.float32)


def gain_at(
    photo: OrientedPhoto, colour: PhotoColour, index: int, knots: Knots, uv: Array
) -> Values:
    """Factor of a photo's colour at the samples of a lattice; (rows, cols, bands).

    Parameters
    ----------
    uv : shape (k, l, 2)
        Pixels of the knots.
    """
    xy, view = place_in_photo(photo, knots.p_enu, uv)
    return knots.samples(colour.factor(index, xy, np.nan_to_num(view)))


def _knots(first: int, count: int, stride: int) -> tuple[Array, Array]:
    """Every `stride`-th sample around a range, and weights of them at each; (k,), (count, k)."""
    low = first // stride
    high = -(-(first + count - 1) // stride)
    k = np.arange(low, max(high, low + 1) + 1)
    at = np.arange(first, first + count) / stride
    weights = np.clip(1.0 - np.abs(at[:, None] - k), 0.0, None)
    return np.asarray(k * float(stride), dtype=np.float64), np.asarray(weights)


def coloured(
    image: Image, gain: Values, add: Values, lattice: Lattice, at: tuple[int, int], out: Image
) -> None:
    """Pixels multiplied and shifted by a field, into `out` of the same shape.

    Parameters
    ----------
    at
        Row and column of the image's first pixel in the lattice's window, px.
    out
        Integer types are rounded and cut to their range.
    """
    low, high = value_range(out.dtype)
    half = 0.5 if np.isfinite(high) else 0.0
    step = 1.0 / lattice.spacing
    first = lattice.y0 + at[0] * step, lattice.x0 + at[1] * step
    _coloured(image, gain, add, first[0], first[1], step, low, high, half, out)


@compiled
def _coloured(  # type: ignore[no-untyped-def]
    image, gain, add, y0, x0, step, low, high, half, out
):
    """Bilinear gain and shift along the rows of an image."""
    rows, cols, bands = image.shape
    knots = gain.shape[1]
    g = np.zeros((knots, bands), np.float32)
    d = np.zeros((knots, bands), np.float32)
    for r in range(rows):
        y = y0 + r * step
        i = min(max(int(y), 0), gain.shape[0] - 2)
        f = np.float32(y - i)
        e = np.float32(1.0) - f
        for k in range(knots):
            for b in range(bands):
                g[k, b] = e * gain[i, k, b] + f * gain[i + 1, k, b]
                d[k, b] = e * add[i, k, b] + f * add[i + 1, k, b]
        for c in range(cols):
            x = x0 + c * step
            j = min(max(int(x), 0), knots - 2)
            f = np.float32(x - j)
            e = np.float32(1.0) - f
            for b in range(bands):
                value = image[r, c, b] * (e * g[j, b] + f * g[j + 1, b])
                value += e * d[j, b] + f * d[j + 1, b]
                value = min(max(value + half, low), high)
                out[r, c, b] = np.floor(value) if half > 0.0 else value
