"""How far the two dates differ at every cell, in deviations of what has not changed.

A difference counts only as far as no cell within the misregistration explains it: what one date
shows must lie outside of all that the other shows near by. It is averaged over squares of several
sizes, for large things of low contrast, and divided by the deviation that such averages have on
this site at places of the same texture, found robustly: most of a site has not changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.measure.change.pair import MapPair, Views
from georef_gis.measure.change.radiometry import Radiometry
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import MapHeader

Image = NDArray[Any]

# cells of the squares that differences are averaged over
SIZES = (3, 5, 9, 17)
# cells; takes the noise of single ones
_BLUR = 0.7
# cells of the square that texture is the deviation over, and classes of texture
_TEXTURE, _CLASSES = 9, 10
# cells about a tile that its scores depend on; cells of a tile
HALO, TILE = 16, 768
# windows that the deviations are learned from, their side, cells
_WINDOWS, _WINDOW = 36, 256
# part of the cells that are not looked at, bounds of the score beyond which they are
_RARE, _THRESHOLDS = 0.99, (3.5, 5.5)
# least deviation: a tenth of a grey value of a byte in mid grey
_LEAST = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviations:
    """Robust deviations of averaged differences.

    Parameters
    ----------
    edges : shape (classes - 1,)
        Bounds of the classes of texture, logarithms.
    sigma : shape (sizes, channels, classes)
        Deviations.
    threshold
        Score beyond which a cell is looked at.
    """

    edges: NDArray[np.float64]
    sigma: NDArray[np.float64]
    threshold: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Differ:
    """What makes the differences of a window.

    Parameters
    ----------
    reach
        Cells that the maps may still lie off each other.
    metres
        Side of a cell, m.
    """

    pair: MapPair
    radiometry: Radiometry
    reach: int
    metres: float

    def alike(self, window: Window) -> tuple[Image, Image, NDArray[np.bool_]]:
        """Later, earlier made like it, and where both show the ground."""
        views = self.pair.read(window)
        return *self.made_alike(views, window), views.valid

    def made_alike(self, views: Views, window: Window) -> tuple[Image, Image]:
        """Later, and earlier made like it, of what was read of a window."""
        later, earlier = self.radiometry.alike(views, window)
        return _calm(later, views), _calm(earlier, views)

    def beyond(self, later: Image, earlier: Image) -> Image:
        """Difference that no cell within reach explains, with its sign."""
        side = 2 * self.reach + 1
        kernel = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)
        up = np.maximum(later - _dilate(earlier, kernel), _erode(later, kernel) - earlier)
        down = np.maximum(earlier - _dilate(later, kernel), _erode(earlier, kernel) - later)
        return np.asarray(np.maximum(up, 0) - np.maximum(down, 0), np.float32)


def _calm(values: Image, views: Views) -> Image:
    """Less noise; what is not shown becomes the mean of what is, to have no edge of its own."""
    out = values.copy()
    if views.valid.any() and not views.valid.all():
        out[~views.valid] = values[views.valid].mean(axis=0)
    smooth = cv2.GaussianBlur(out, (0, 0), _BLUR)
    return np.asarray(smooth.reshape(values.shape), np.float32)


def _dilate(values: Image, kernel: NDArray[np.uint8]) -> Image:
    return np.asarray(cv2.dilate(values, kernel).reshape(values.shape), np.float32)


def _erode(values: Image, kernel: NDArray[np.uint8]) -> Image:
    return np.asarray(cv2.erode(values, kernel).reshape(values.shape), np.float32)


def _texture(later: Image, earlier: Image) -> Image:
    """Logarithm of the smaller of both local deviations of brightness, shape (rows, cols).

    A new thing makes a texture of its own, which must not excuse it.
    """
    found = []
    for one in (later[..., 0], earlier[..., 0]):
        mean = cv2.blur(one, (_TEXTURE, _TEXTURE))
        found.append(cv2.blur(one * one, (_TEXTURE, _TEXTURE)) - mean * mean)
    return np.asarray(0.5 * np.log(np.maximum(np.minimum(*found), 1e-8)), np.float32)


def _averages(values: Image, size: int) -> Image:
    return np.asarray(cv2.blur(values, (size, size)).reshape(values.shape), np.float32)


def sample_windows(header: MapHeader) -> list[Window]:
    """Windows spread over the site, in a random order."""
    side_c, side_r = min(_WINDOW, header.width), min(_WINDOW, header.height)
    across = max(1, min(10, header.width // side_c))
    down = max(1, min(10, header.height // side_r))
    places = [
        (int(col), int(row), side_c, side_r)
        for row in np.linspace(0, header.height - side_r, down)
        for col in np.linspace(0, header.width - side_c, across)
    ]
    return [places[i] for i in np.random.default_rng(1).permutation(len(places))]


def learn_deviations(differ: Differ) -> Deviations:
    """Deviations of unchanged ground, from some windows."""
    textures, averages, beyond = [], [], []
    for window in sample_windows(differ.pair.header):
        later, earlier, valid = differ.alike(window)
        inside = _inner(valid)
        if inside.mean() < 0.2:
            continue
        rows, cols = np.nonzero(inside)
        few = slice(None, None, max(1, len(rows) // 8000))
        part = (rows[few], cols[few])
        raw = later - earlier
        textures.append(_texture(later, earlier)[part])
        averages.append(np.stack([_averages(raw, size)[part] for size in SIZES]))
        field = differ.beyond(later, earlier)
        beyond.append(np.stack([_averages(field, size)[part] for size in SIZES]))
        if len(textures) == _WINDOWS:
            break
    channels = 3 if differ.pair.colour else 1
    if not textures:
        edges = np.zeros(_CLASSES - 1)
        sigma = np.full((len(SIZES), channels, _CLASSES), 0.1)
        return Deviations(edges=edges, sigma=sigma, threshold=4.0)
    texture, values = np.concatenate(textures), np.concatenate(averages, axis=1)
    edges = np.quantile(texture, np.linspace(0, 1, _CLASSES + 1)[1:-1])
    found = np.searchsorted(edges, texture)
    sigma = np.full((len(SIZES), channels, _CLASSES), np.nan)
    for number in range(_CLASSES):
        some = values[:, found == number]
        if some.shape[1] >= 50:
            sigma[:, :, number] = 1.4826 * np.median(np.abs(some), axis=1)
    usual = 1.4826 * np.median(np.abs(values), axis=1)
    sigma = np.where(np.isnan(sigma), usual[:, :, None], sigma)
    known = Deviations(edges=edges, sigma=np.maximum(sigma, _LEAST), threshold=0.0)
    scores = _scored(np.concatenate(beyond, axis=1), found, known)
    threshold = float(np.clip(np.quantile(scores, _RARE), *_THRESHOLDS))
    return Deviations(edges=edges, sigma=known.sigma, threshold=threshold)


def _scored(
    averages: Image, classes: NDArray[np.intp], deviations: Deviations
) -> NDArray[np.float32]:
    """Largest of all sizes and channels, in deviations; averages (sizes, n, channels)."""
    sigma = np.moveaxis(deviations.sigma[:, :, classes], 1, 2)
    return np.asarray((np.abs(averages) / sigma).max(axis=(0, 2)), np.float32)


def _inner(valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Less a rim that the shown ground's end would reach into; the window's own is none."""
    if valid.all():
        return valid
    kernel = np.ones((9, 9), np.uint8)
    return np.asarray(cv2.erode(valid.astype(np.uint8), kernel, borderValue=1) > 0)


def score(differ: Differ, window: Window, deviations: Deviations) -> Image:
    """Scores of a window, NaN where not both show the ground."""
    later, earlier, valid = differ.alike(window)
    best = scores_of(differ, later, earlier, deviations)
    best[~_inner(valid)] = np.nan
    return best


def scores_of(differ: Differ, later: Image, earlier: Image, deviations: Deviations) -> Image:
    """Scores of what was made alike, shape (rows, cols)."""
    field = differ.beyond(later, earlier)
    classes = np.searchsorted(deviations.edges, _texture(later, earlier))
    best = np.zeros(field.shape[:2], np.float32)
    for i, size in enumerate(SIZES):
        averages = np.abs(_averages(field, size))
        for channel in range(field.shape[2]):
            sigma = deviations.sigma[i, channel].astype(np.float32)[classes]
            np.maximum(best, averages[..., channel] / sigma, out=best)
    return best


def tiles_of(header: MapHeader) -> Iterator[tuple[Window, Window]]:
    """Tiles of the grid, and the window each needs."""
    for row in range(0, header.height, TILE):
        for col in range(0, header.width, TILE):
            width, height = min(TILE, header.width - col), min(TILE, header.height - row)
            yield (col, row, width, height), padded((col, row, width, height), HALO, header)


def padded(window: Window, by: int, header: MapHeader) -> Window:
    """A window with more cells about it, as far as there are."""
    col, row, width, height = window
    c0, r0 = max(0, col - by), max(0, row - by)
    c1, r1 = min(header.width, col + width + by), min(header.height, row + height + by)
    return c0, r0, c1 - c0, r1 - r0


def inside(values: Image, outer: Window, inner: Window) -> Image:
    """The part of an array over one window that lies in another."""
    col, row = inner[0] - outer[0], inner[1] - outer[1]
    return values[row : row + inner[3], col : col + inner[2]]
