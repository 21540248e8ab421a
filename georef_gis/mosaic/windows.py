"""Windows of a grid that grow, shrink around what is in them, and change their scale."""

from __future__ import annotations

import numpy as np

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import Mask


def grown(window: Window, by: int = 1) -> Window:
    """A window with a ring of some pixels."""
    return Window(
        col=window.col - by, row=window.row - by,
        width=window.width + 2 * by, height=window.height + 2 * by,
    )  # fmt: skip


def box_of(mask: Mask, window: Window) -> Window | None:
    """Smallest window around the true pixels of a mask over a window; None if there are none."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return None
    return Window(
        col=window.col + int(cols[0]), row=window.row + int(rows[0]),
        width=int(cols[-1] - cols[0]) + 1, height=int(rows[-1] - rows[0]) + 1,
    )  # fmt: skip


def whole_in(window: Window, factor: int) -> Window:
    """Pixels `factor` times as large that lie in a window as a whole, maybe none."""
    col, row = -(-window.col // factor), -(-window.row // factor)
    return Window(
        col=col, row=row,
        width=max((window.col + window.width) // factor - col, 0),
        height=max((window.row + window.height) // factor - row, 0),
    )  # fmt: skip


def finer(window: Window, factor: int) -> Window:
    """The same window on pixels `factor` times as small."""
    return Window(
        col=window.col * factor, row=window.row * factor,
        width=window.width * factor, height=window.height * factor,
    )  # fmt: skip
