"""Brightness of two dates made alike, by what most of the site says.

Logarithms are compared: exposure and sun make a factor, which is a difference there. The contrast
is one for the whole site, the level a smooth field: medians of blocks, and medians of those, so
that less than half of some 45 blocks may change without a trace in the level.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.measure.change.pair import MapPair, Views
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import MapHeader

Image = NDArray[Any]

# part of white added before the logarithm: dark pixels are mostly noise
_DARK = 0.06
# cells of a block, and of a coarse cell; blocks about one that its level is the median of
BLOCK, _COARSE, _AROUND = 64, 4, 3
# part of a block that must be shown, and coarse cells of a side read at once
_LEAST_SHOWN, _TILE = 0.2, 512
# quantiles between which contrasts are compared, bounds of their ratio
_LOW, _HIGH, _MOST_CONTRAST = 0.1, 0.9, 2.0
_SAMPLE = 400_000
# blocks that a slope needs, and rounds of its robust fit
_LEAST_BLOCKS, _ROUNDS = 6, 15
# weights of red, green, blue: brightness, red against blue, green against both
_OPPONENT = np.array(
    [[1 / 3, 1 / 3, 1 / 3], [0.5, 0.0, -0.5], [-0.25, 0.5, -0.25]], dtype=np.float32
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Radiometry:
    """How the earlier map is made like the later one.

    Parameters
    ----------
    contrast : shape (channels,)
        Factor of the earlier logarithms.
    level : shape (rows, cols, channels)
        Added to them, by block of cells.
    correlation
        Of both brightnesses over the site, of cells.
    """

    contrast: NDArray[np.float32]
    level: Image
    correlation: float

    def alike(self, views: Views, window: Window) -> tuple[Image, Image]:
        """Later and earlier in channels, brightness first: shape (rows, cols, channels)."""
        later, earlier = _log(views.later), _log(views.earlier) * self.contrast
        earlier = earlier + self._level(window)
        if later.shape[2] == 1:
            return later, earlier
        return later @ _OPPONENT.T, earlier @ _OPPONENT.T

    def _level(self, window: Window) -> Image:
        col, row, width, height = window
        x = ((np.arange(width, dtype=np.float32) + col + 0.5) / BLOCK - 0.5)[None]
        y = ((np.arange(height, dtype=np.float32) + row + 0.5) / BLOCK - 0.5)[:, None]
        x, y = np.broadcast_to(x, (height, width)), np.broadcast_to(y, (height, width))
        level = cv2.remap(
            self.level, np.ascontiguousarray(x), np.ascontiguousarray(y), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        return np.asarray(level.reshape(height, width, -1), np.float32)


def _log(values: Image) -> Image:
    return np.asarray(np.log(np.maximum(values, 0.0) + np.float32(_DARK)), np.float32)


def learn_radiometry(
    pair: MapPair, moved: Transform, *, step: Callable[[float], None] = lambda _: None
) -> Radiometry:
    """Read both once, coarsely, and compare.

    Parameters
    ----------
    moved
        Cell of the grid -> cell of the earlier map.
    step
        Called with the part done; may raise to cancel.

    Raises
    ------
    GeometryError
        If no block is shown by both.
    """
    a, b, c, d, e, f = moved
    pair = pair.seen(moved=(a, b, c / _COARSE, d, e, f / _COARSE), factor=_COARSE)
    header = pair.header
    sample: list[Image] = []
    medians: list[tuple[int, int, Image]] = []
    tiles = _tiles(header.width, header.height)
    for number, window in enumerate(tiles):
        views = pair.read(window)
        _take(views, sample, len(tiles))
        medians.append((window[0], window[1], _medians(views)))
        step((number + 1) / len(tiles))
    channels = 3 if pair.colour else 1
    values = np.concatenate(sample) if sample else np.zeros((0, 2, channels), np.float32)
    if len(values) < 100:
        raise GeometryError(
            f"{pair.names} show too little common ground after they were "
            "moved upon each other; check that they show the same place"
        )
    contrast = _contrast(values)
    bright = values.mean(axis=2)
    return Radiometry(
        contrast=contrast,
        level=_smooth(_levels(medians, contrast, header)),
        correlation=float(np.corrcoef(bright[:, 0], bright[:, 1])[0, 1]),
    )


def _levels(
    medians: list[tuple[int, int, Image]], contrast: NDArray[np.float32], header: MapHeader
) -> Image:
    """Level of every block, NaN where little is shown: shape (rows, cols, channels)."""
    side = BLOCK // _COARSE
    shape = (math.ceil(header.height / side), math.ceil(header.width / side), len(contrast))
    level = np.full(shape, np.nan, np.float32)
    for col, row, part in medians:
        r, k = row // side, col // side
        # medians of both dates: of their difference where the contrast is one
        level[r : r + part.shape[0], k : k + part.shape[1]] = part[..., 0, :] - (
            part[..., 1, :] * contrast
        )
    return level


def _tiles(width: int, height: int) -> list[Window]:
    return [
        (col, row, min(_TILE, width - col), min(_TILE, height - row))
        for row in range(0, height, _TILE)
        for col in range(0, width, _TILE)
    ]


def _take(views: Views, sample: list[Image], tiles: int) -> None:
    """Logarithms of some cells: shape (n, 2, channels)."""
    inside = np.flatnonzero(views.valid)
    if not len(inside):
        return
    few = inside[:: max(1, len(inside) * tiles // _SAMPLE)]
    both = [one.reshape(-1, one.shape[2])[few] for one in (views.later, views.earlier)]
    sample.append(_log(np.stack(both, axis=1)))


def _medians(views: Views) -> Image:
    """Medians of blocks, NaN where little is shown: shape (rows, cols, 2, channels)."""
    side = BLOCK // _COARSE
    rows, cols = views.valid.shape
    both = _log(np.stack([views.later, views.earlier], axis=2))
    both[~views.valid] = np.nan
    down, across = math.ceil(rows / side), math.ceil(cols / side)
    padded = np.full((down * side, across * side, *both.shape[2:]), np.nan, np.float32)
    padded[:rows, :cols] = both
    blocks = padded.reshape(down, side, across, side, *both.shape[2:]).swapaxes(1, 2)
    flat = blocks.reshape(down, across, side * side, *both.shape[2:])
    shown = np.isfinite(flat[..., 0, 0]).mean(axis=2)
    out = np.full((down, across, *both.shape[2:]), np.nan, np.float32)
    out[shown >= _LEAST_SHOWN] = np.nanmedian(flat[shown >= _LEAST_SHOWN], axis=1)
    return out


def _contrast(values: Image) -> NDArray[np.float32]:
    spread = np.quantile(values, _HIGH, axis=0) - np.quantile(values, _LOW, axis=0)
    ratio = spread[0] / np.maximum(spread[1], 1e-6)
    return np.asarray(np.clip(ratio, 1 / _MOST_CONTRAST, _MOST_CONTRAST), np.float32)


def _smooth(level: Image) -> Image:
    """A slope over the site, and the median of what the blocks around each add to it.

    Without the slope the median at the rim of a site would be that of one side only.
    """
    rows, cols, _ = level.shape
    slope = _slope(level)
    level = level - slope
    padded = np.pad(level, ((_AROUND,) * 2, (_AROUND,) * 2, (0, 0)), constant_values=np.nan)
    size = 2 * _AROUND + 1
    out = np.full_like(level, np.nan)
    for row in range(rows):
        strip = np.stack([padded[row + i, j : j + cols] for i in range(size) for j in range(size)])
        some = np.isfinite(strip[..., 0]).any(axis=0)
        out[row, some] = np.nanmedian(strip[:, some], axis=0)
    missing = ~np.isfinite(out[..., 0])
    if missing.all():
        return np.zeros_like(level)
    out[missing] = np.nanmedian(out[~missing], axis=0)
    smooth = cv2.blur(out, (3, 3), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(smooth.reshape(level.shape) + slope, np.float32)


def _slope(level: Image) -> Image:
    """Plane through the blocks, robust: absolute misfits count, not their squares."""
    rows, cols, channels = level.shape
    y, x = np.mgrid[:rows, :cols]
    design = np.column_stack([np.ones(rows * cols), x.ravel() - cols / 2, y.ravel() - rows / 2])
    plane = np.zeros((rows * cols, channels))
    for channel in range(channels):
        values = level[..., channel].ravel().astype(np.float64)
        known = np.isfinite(values)
        if known.sum() < _LEAST_BLOCKS:
            plane[:, channel] = np.median(values[known]) if known.any() else 0.0
            continue
        weight = np.ones(known.sum())
        for _ in range(_ROUNDS):
            rooted = np.sqrt(weight)[:, None]
            solution = np.linalg.lstsq(
                design[known] * rooted, values[known] * rooted[:, 0], rcond=None
            )[0]
            weight = 1.0 / np.maximum(np.abs(values[known] - design[known] @ solution), 1e-3)
        plane[:, channel] = design @ solution
    return np.asarray(plane.reshape(level.shape), np.float32)
