"""Laplacian pyramid of a photo on the coarse grid, from half its resolution on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import Mask

# levels of the pyramid: the widest change takes some 2 ** LEVELS coarse px
LEVELS = 5
ALIGNED = 1 << LEVELS
# coarse px: so far the coarsest level's weights reach beyond a cell, 2 px on each level before it
REACH = 2 * ALIGNED
# share of a photo in a pixel below which its values are not what it shows
LEAST = 1e-6
Values = NDArray[np.float32]
Part = tuple[slice, slice]


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One level of a photo's pyramid: window, band-pass values, weights."""

    window: Window
    band: Values
    weight: Values


def aligned(window: Window) -> Window:
    """Window around a photo's whose corner lies on all levels' pixels.

    Pixels of the coarsest level lie around it: interpolation from there must not meet nothing.
    """
    left, top = (window.col // ALIGNED - 1) * ALIGNED, (window.row // ALIGNED - 1) * ALIGNED
    right = (-(-(window.col + window.width) // ALIGNED) + 2) * ALIGNED
    bottom = (-(-(window.row + window.height) // ALIGNED) + 2) * ALIGNED
    return Window(col=left, row=top, width=right - left, height=bottom - top)


def first_level(data: Values, valid: Mask, window: Window) -> tuple[Values, Values, Window]:
    """Level 1 of a photo on its aligned window: values, how much of them there was, window.

    Values go on where the photo has none.
    """
    at = _halved_window(aligned(window))
    ring = [_ring(window.row, window.height), _ring(window.col, window.width)]
    # of what is around the photo, the next level feels a ring alone
    rim = (*ring[0], *ring[1], cv2.BORDER_CONSTANT)
    inside = valid.astype(np.float32)
    data, valid = np.ascontiguousarray(data), np.ascontiguousarray(valid)
    known = cv2.copyTo(data, valid.view(np.uint8), np.zeros_like(data))
    total = cv2.pyrDown(cv2.copyMakeBorder(known, *rim, value=0))
    part = cv2.pyrDown(cv2.copyMakeBorder(inside, *rim, value=0))
    col, row = (window.col - ring[1][0]) // 2 - at.col, (window.row - ring[0][0]) // 2 - at.row
    rim = (
        row, at.height - part.shape[0] - row, col, at.width - part.shape[1] - col,
        cv2.BORDER_CONSTANT,
    )  # fmt: skip
    total = cv2.copyMakeBorder(total, *rim, value=0)
    share = np.asarray(cv2.copyMakeBorder(part, *rim, value=0), dtype=np.float32)
    return _filled(over(total, share, LEAST), share), share, at


def _ring(first: int, count: int) -> tuple[int, int]:
    """Zeros before and after pixels, to even places, that the next level feels."""
    return 3 + (first - 3) % 2, 2 + (first + count) % 2


def _halved_window(window: Window) -> Window:
    return Window(
        col=window.col // 2, row=window.row // 2, width=window.width // 2, height=window.height // 2
    )


def levels_of(values: Values, share: Values, at: Window, cell: Mask) -> list[Level]:
    """All levels of a photo from its first one, about the cell that it has; finest first.

    `cell` (rows, cols) covers the aligned window of the photo.
    """
    part = _cell_part(cell)
    own, shares = [values], [np.minimum(share, np.float32(1.0))]
    for _ in range(LEVELS - 1):
        smaller, share = _halved(own[-1], shares[-1])
        own.append(_filled(smaller, share))
        shares.append(np.minimum(share, np.float32(1.0)))
    weight = cell[part].astype(np.float32)
    found: list[Level] = []
    for k in range(LEVELS):
        weight, part = np.asarray(cv2.pyrDown(weight), dtype=np.float32), _halved_part(part)
        band = own[k][part] if k == LEVELS - 1 else _band(own[k], own[k + 1], part)
        where = Window(
            col=at.col + part[1].start, row=at.row + part[0].start,
            width=weight.shape[1], height=weight.shape[0],
        )  # fmt: skip
        # a photo has a say where it is, and hardly any beyond its rim
        say = np.asarray(weight * (shares[k][part] + np.float32(1e-3)), dtype=np.float32)
        found.append(Level(where, band, say))
        at = _halved_window(at)
    return found


def _cell_part(cell: Mask) -> Part:
    """Part of an aligned window that the weights of a cell reach on all levels."""
    part = []
    for axis in (1, 0):
        own = np.flatnonzero(cell.any(axis=axis))
        first = max((int(own[0]) - REACH) // ALIGNED * ALIGNED, 0)
        last = min(-(-(int(own[-1]) + 1 + REACH) // ALIGNED) * ALIGNED, cell.shape[1 - axis])
        part.append(slice(first, last))
    return part[0], part[1]


def _halved_part(part: Part) -> Part:
    rows, cols = (slice(s.start // 2, s.stop // 2) for s in part)
    return rows, cols


def _band(values: Values, coarser: Values, part: Part) -> Values:
    """What a part of a level has over the interpolation of the next."""
    # interpolation feels the neighbours
    about, inner = [], []
    for side, size in zip(part, coarser.shape, strict=False):
        first, last = max(side.start // 2 - 2, 0), min(side.stop // 2 + 2, size)
        about.append(slice(first, last))
        inner.append(slice(side.start - 2 * first, side.stop - 2 * first))
    near = np.ascontiguousarray(coarser[about[0], about[1]])
    up = doubled(near, (2 * near.shape[0], 2 * near.shape[1]))
    return np.asarray(values[part] - up[inner[0], inner[1]])


def _spread(weight: Values, bands: int) -> Values:
    """A weight for every band; shape (rows, cols, bands)."""
    return np.asarray(cv2.merge([weight] * bands)).reshape((*weight.shape, bands))


def times(values: Values, weight: Values) -> Values:
    """Values by weights (rows, cols); OpenCV is five times as fast at it as numpy."""
    values = np.ascontiguousarray(values)
    out = cv2.multiply(values, _spread(weight, values.shape[2]))
    return np.asarray(out, dtype=np.float32).reshape(values.shape)


def over(total: Any, share: Values, least: float) -> Values:
    """Totals over shares (rows, cols) of no less than `least`."""
    total = total.reshape((*share.shape, -1))
    divisor = _spread(np.maximum(share, np.float32(least)), total.shape[2])
    return np.asarray(cv2.divide(total, divisor), dtype=np.float32).reshape(total.shape)


def _halved(values: Values, weight: Values) -> tuple[Values, Values]:
    """Next level of values where there are any, and how much of it there was."""
    total = cv2.pyrDown(times(values, weight))
    share = np.asarray(cv2.pyrDown(weight), dtype=np.float32)
    return over(total, share, LEAST), share


def doubled(values: Values, shape: tuple[int, int]) -> Values:
    """Level above, by interpolation."""
    up = cv2.pyrUp(values, dstsize=(shape[1], shape[0]))
    return np.asarray(up.reshape((*shape, values.shape[2])), dtype=np.float32)


def _filled(values: Values, share: Values) -> Values:
    """Values continued where a photo has none, so that its rim makes no band of its own."""
    have = np.asarray(share > 1e-3)
    if have.all() or not have.any():
        return values
    out = cv2.copyTo(values, have.view(np.uint8), np.zeros_like(values)).reshape(values.shape)
    for size in (3, 5, 9, 17, 33):
        box = partial(cv2.boxFilter, ddepth=cv2.CV_32F, ksize=(size, size), normalize=False)
        total, count = box(out), np.asarray(box(have.view(np.uint8)), dtype=np.float32)
        # counts are whole numbers
        reached = (count > 0.5) & ~have
        fill = over(total, count, 1.0)
        out = cv2.copyTo(fill, reached.view(np.uint8), out).reshape(values.shape)
        have |= reached
        if have.all():
            break
    return np.asarray(out, dtype=np.float32)
