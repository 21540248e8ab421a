"""Photos of a made-up ground for the tests of seams; a pixel is 1 m."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import Proxy

SIZE = (400, 260)
GRID = Grid(crs_wkt="", left=0.0, top=260.0, pixel=1.0, width=SIZE[0], height=SIZE[1])
ALL = Window(col=0, row=0, width=SIZE[0], height=SIZE[1])
# two photos side by side, and the column at which their nadirs are equally near
LEFT = Window(col=10, row=10, width=260, height=200)
RIGHT = Window(col=130, row=10, width=260, height=200)
MIDDLE = 200

Image = NDArray[np.float32]


def meadow(seed: int = 1, bands: int = 3) -> Image:
    """Ground with patches of some px, 0..255; shape (rows, cols, bands)."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(SIZE[1], SIZE[0], bands)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 4.0)
    return np.asarray(110.0 + 150.0 * smooth, dtype=np.float32).reshape(SIZE[1], SIZE[0], bands)


def painted(ground: Image, top: int, left: int, height: int, width: int, grey: float) -> Image:
    """Ground with a rectangle on it."""
    out = ground.copy()
    out[top : top + height, left : left + width] = grey
    return out


def photo(
    ground: Image,
    window: Window,
    *,
    nadir: tuple[float, float] | None = None,
    noise: int | None = None,
    further: float = 0.0,
) -> Proxy:
    """Photo of a part of the ground, by default from above its middle.

    Parameters
    ----------
    nadir
        (col, row), m.
    noise
        Seed of grey noise with a sigma of 3; none by default.
    further
        Added to the distance, m, as for a doubtful photo.
    """
    col, row = nadir or (window.col + window.width / 2, window.row + window.height / 2)
    rows, cols = np.mgrid[: window.height, : window.width]
    distance = np.hypot(cols + 0.5 + window.col - col, rows + 0.5 + window.row - row) + further
    inside = (slice(window.row, window.row + window.height),)
    data = ground[*inside, window.col : window.col + window.width].copy()
    if noise is not None:
        data += np.random.default_rng(noise).normal(0.0, 3.0, data.shape).astype(np.float32)
    return Proxy(
        photo_id=f"{window.col}-{window.row}", window=window, data=data,
        valid=np.ones(data.shape[:2], np.bool_), distance=distance.astype(np.float32),
    )  # fmt: skip


@dataclass
class Flight:
    """Photos in memory; counts what is asked for and what is still held."""

    photos: Sequence[Proxy]
    loads: int = 0
    most_held: int = 0
    _held: list[weakref.ref[Image]] = field(default_factory=list)

    @property
    def ids(self) -> list[str]:
        return [p.photo_id for p in self.photos]

    @property
    def windows(self) -> list[Window]:
        return [p.window for p in self.photos]

    def load(self, index: int) -> Proxy:
        p = self.photos[index]
        data = p.data.copy()
        self.loads += 1
        self._held = [r for r in self._held if r() is not None] + [weakref.ref(data)]
        self.most_held = max(self.most_held, len(self._held))
        return Proxy(
            photo_id=p.photo_id, window=p.window, data=data, valid=p.valid, distance=p.distance
        )
