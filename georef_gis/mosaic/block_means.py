"""Means of a photo over the blocks of a lattice that all photos of a mosaic share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.coarse import Mask, Proxy

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]
# place(photo, cols, rows) -> (xy, view): see `gather_overlaps`
Place = Callable[[int, Array, Array], tuple[Array, Array]]

# two irrational steps (the plastic number): what they choose of a lattice is spread evenly
STEPS = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Pixels of photos, evenly spread, clipped or not: how bright photos are, and the whole.

    Parameters
    ----------
    photo : shape (s,)
        Index of the photo; sorted.
    value : shape (s, bands)
        Grey values of coarse pixels.
    xy, view : shape (s, 2)
        See `Place`.
    place : shape (s, 2), px
        Column and row of the coarse grid.
    nadir : shape (s, 2), px
        Where on the coarse grid the photo looks straight down, about.
    """

    photo: Indices
    value: Floats
    xy: Floats
    view: Floats
    place: Floats
    nadir: Floats

    @classmethod
    def joined(cls, parts: Sequence[Samples], bands: int) -> Samples:
        """Those of several photos; with none of them `bands` tells the shape."""
        none = np.zeros((0, 2), np.float32)
        start = cls(
            photo=np.zeros(0, np.int64), value=np.zeros((0, bands), np.float32), xy=none,
            view=none, place=none, nadir=none,
        )  # fmt: skip
        names = (field.name for field in fields(cls))
        return cls(**{n: np.concatenate([getattr(p, n) for p in (start, *parts)]) for n in names})

    def nearest(self) -> Mask:
        """Which of them a mosaic of the nearest nadirs would show; (s,)."""
        from shapely import STRtree, points

        photos, first = np.unique(self.photo, return_index=True)
        if not photos.size:
            return np.zeros(0, np.bool_)
        tree = STRtree(points(self.nadir[first].astype(np.float64)))
        sample, found = tree.query_nearest(points(self.place.astype(np.float64)), all_matches=False)
        out = np.zeros(self.photo.size, np.bool_)
        out[sample] = photos[found] == self.photo[sample]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """A photo on the lattice of blocks.

    Parameters
    ----------
    row, col
        Of the first block, counted in blocks from the corner of the coarse grid.
    mean : shape (rows, cols, bands)
        Grey values.
    spread : shape (rows, cols)
        Deviation of grey values within a block, mean of the bands.
    good : shape (rows, cols, bands)
        Blocks that the photo shows wholly and in which a band is nowhere clipped.
    xy, view : shape (rows, cols, 2)
        See `Place`; 0 where the photo does not show a block.
    samples
        Some of the photo's pixels.
    """

    row: int
    col: int
    mean: Floats
    spread: Floats
    good: Mask
    xy: Floats
    view: Floats
    samples: Samples

    def part(self, top: int, left: int, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Slices of the arrays that cover `shape` blocks from a row and column of the lattice."""
        r, c = top - self.row, left - self.col
        return slice(r, r + shape[0]), slice(c, c + shape[1])


def evenly(rows: Indices, cols: Indices, limit: int) -> slice | Indices:
    """Which of the blocks at places of the lattice to take: `limit` at most, spread evenly."""
    if rows.size <= limit:
        return slice(None)
    key = (rows * STEPS[0] + cols * STEPS[1]) % 1.0
    return np.asarray(np.sort(np.argsort(key, kind="stable")[:limit]))


def block_means(
    index: int,
    proxy: Proxy,
    place: Place,
    *,
    size: int,
    ends: tuple[float, float] | None,
    samples: int,
) -> Blocks:
    """Means over the blocks that a photo shows wholly.

    Parameters
    ----------
    size : px
        Side of a block.
    ends
        Grey values beyond which a pixel counts as clipped; None if none does.
    samples
        Pixels to keep, at most.
    """
    window = proxy.window
    row, col = -(-window.row // size), -(-window.col // size)
    rows = max(0, (window.row + window.height) // size - row)
    cols = max(0, (window.col + window.width) // size - col)
    top, left = row * size - window.row, col * size - window.col
    inner = (slice(top, top + rows * size), slice(left, left + cols * size))
    data, valid = proxy.data[inner], proxy.valid[inner]
    shown = _all_of(valid[..., None], size)[..., 0]
    known = np.isfinite(_reduced(data, size)).all(axis=2)
    if not known.all():
        shown &= known
        data = np.nan_to_num(data, nan=0.0, posinf=0.0, neginf=0.0)
    r, c = np.nonzero(shown)
    xy, view = np.zeros((rows, cols, 2), np.float32), np.zeros((rows, cols, 2), np.float32)
    if r.size:
        p: Array = np.stack([col + c + 0.5, row + r + 0.5]) * size
        xy[r, c], view[r, c] = place(index, p[0], p[1])
        shown &= np.isfinite(xy).all(axis=2) & np.isfinite(view).all(axis=2)
    mean, spread = _mean_and_spread(data, size)
    good = np.repeat(shown[..., None], mean.shape[2], axis=2)
    if ends is not None:
        good &= _all_of((data >= ends[0]) & (data <= ends[1]), size)
    r, c = np.nonzero(shown)
    which = evenly(r, c, samples)
    r, c = r[which], c[which]
    some = Samples(
        photo=np.full(r.size, index, np.int64),
        value=data[size // 2 :: size, size // 2 :: size][r, c], xy=xy[r, c], view=view[r, c],
        place=np.asarray(np.stack([col + c + 0.5, row + r + 0.5], axis=-1) * size, np.float32),
        nadir=np.broadcast_to(_nadir(proxy), (r.size, 2)),
    )  # fmt: skip
    return Blocks(row, col, mean, spread, good, xy, view, some)


def _nadir(proxy: Proxy) -> Floats:
    """Column and row of the coarse grid at which a photo is nearest to its nadir; (2,)."""
    if not proxy.distance.size:
        return np.zeros(2, np.float32)
    row, col = divmod(int(proxy.distance.argmin()), proxy.window.width)
    return np.array([proxy.window.col + col + 0.5, proxy.window.row + row + 0.5], np.float32)


def _mean_and_spread(data: Floats, size: int) -> tuple[Floats, Floats]:
    """Mean of blocks (rows, cols, bands) and deviation in them, the mean of all bands."""
    mean = _reduced(data, size)
    # from a grey value near by, as the squares of float32 have seven digits only
    level = np.median(mean) if mean.size else np.float32(0.0)
    near = data - level
    variance = _reduced(np.multiply(near, near, out=near), size) - (mean - level) ** 2
    return mean, np.asarray(np.sqrt(np.maximum(variance, 0.0)).mean(axis=2), dtype=np.float32)


def _all_of(flags: Mask, size: int) -> Mask:
    """Where all pixels of a block are true; (rows, cols, bands)."""
    # of 255 one missing pixel is more than rounding brings back
    full = np.multiply(flags, np.uint8(255), dtype=np.uint8)
    return np.asarray(_reduced(full, size) == 255)


def _reduced(values: NDArray[Any], size: int) -> NDArray[Any]:
    """Means over blocks of `size`, which must fit; (rows, cols, bands), of the values' type."""
    height, width, bands = values.shape
    rows, cols = height // size, width // size
    if not rows or not cols:
        return np.zeros((rows, cols, bands), values.dtype)
    small = cv2.resize(values, (cols, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(small).reshape(rows, cols, bands)
