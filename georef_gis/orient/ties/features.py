"""Features of one photo: SIFT points spread over the picture, in pixels of the full size.

The detector of OpenCV doubles the picture first. It is given the picture at half the size, so that
its finest octave is that of the picture itself, and the descriptors are taken from the latter: a
quarter of the work, and points that small are noise in most photos from the air.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.pixels import uv_after_resize
from georef_gis.rasters.reading import read_image

Grey = NDArray[np.uint8]
Descriptors = NDArray[np.uint8]

# SIFT's contrast threshold: low, as the best of every cell are kept however bland it is, and the
# detector's time does not depend on it
CONTRAST = 0.008
# cells of the grid over which features are spread, on the longer side
CELLS = 20
# share of the side asked for at which a picture is taken as it is decoded
SMALLER = 0.85
# of 255; an 8-bit photo of less is stretched
LEAST_RANGE = 60.0
# percent of pixels below black and above white
TAILS = (0.5, 99.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Features:
    """Features of one photo, those that stand out in their surroundings first.

    Parameters
    ----------
    uv : shape (n, 2), px
        At full size; (0, 0) is the centre of the first pixel.
    size : shape (n,), px
        One sigma of the blur at which the feature was found, in the reduced picture.
    angle : shape (n,), rad
        Direction of the feature, clockwise from the image's right.
    descriptors : shape (n, 128), uint8
        RootSIFT: square roots of the histogram's shares, times 512.
    scale
        Reduced size by full size.
    width, height : px
        Full size.
    """

    uv: Array
    size: NDArray[np.float32]
    angle: NDArray[np.float32]
    descriptors: Descriptors
    scale: float
    width: int
    height: int

    def __len__(self) -> int:
        """Number of features."""
        return len(self.uv)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """Brightness of a photo at the reduced size.

    Parameters
    ----------
    grey : shape (rows, cols)
    scales : shape (2,)
        Full width by the reduced one, and height alike.
    width, height : px
        Full size.
    """

    grey: Grey
    scales: Array
    width: int
    height: int


def read_picture(path: Path, *, width: int, height: int, max_side: int) -> Picture:
    """Brightness of a photo file that is `width` x `height` px in full.

    Raises
    ------
    InputError
        If the photo cannot be read or has another size.
    """
    # A JPEG is reduced while it is decoded, in half the time: so somewhat smaller is as good.
    longer = max(width, height)
    reduce = max(r for r in (1, 2, 4, 8) if r == 1 or longer / r >= SMALLER * max_side)
    ratio = max(longer / max_side, float(reduce))
    image = read_image(path, reduce=reduce)
    rows, cols = image.shape[:2]
    if (cols, rows) != (-(-width // reduce), -(-height // reduce)):
        raise InputError(
            f"has not the {width} x {height} px of its camera; run `georef run` anew",
            source=path.name,
        )
    grey = luminance(image)
    size = (max(round(width / ratio), 1), max(round(height / ratio), 1))
    if ratio == reduce:
        size = (cols, rows)
    if size != (cols, rows):
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    scales = reduce * np.array([cols / grey.shape[1], rows / grey.shape[0]])
    return Picture(grey=grey, scales=scales, width=width, height=height)


def no_features(width: int, height: int) -> Features:
    """Features of a photo that has none."""
    return Features(
        uv=np.zeros((0, 2)),
        size=np.zeros(0, dtype=np.float32),
        angle=np.zeros(0, dtype=np.float32),
        descriptors=np.zeros((0, 128), dtype=np.uint8),
        scale=1.0,
        width=width,
        height=height,
    )


def luminance(image: NDArray[Any]) -> Grey:
    """Eight bits of brightness of a photo, shape (rows, cols, bands) -> (rows, cols).

    More than eight bits, or a photo that fills but a part of its range, are stretched between
    their tails; alpha is left out.
    """
    bands = image.shape[2]
    if image.dtype == np.uint8 and bands in (3, 4):
        grey = cv2.cvtColor(np.ascontiguousarray(image[:, :, :3]), cv2.COLOR_RGB2GRAY)
    elif bands == 1:
        grey = image[:, :, 0]
    else:
        grey = image[:, :, : 3 if bands == 4 else bands].mean(axis=2, dtype=np.float32)
    sample = grey[::4, ::4]
    sample = sample[np.isfinite(sample)]
    low, high = np.percentile(sample, TAILS) if sample.size else (0.0, 0.0)
    if grey.dtype == np.uint8 and high - low > LEAST_RANGE:
        return np.ascontiguousarray(grey)
    if high <= low:
        return np.zeros(grey.shape, dtype=np.uint8)
    stretched = (grey.astype(np.float32) - low) * (255.0 / (high - low))
    return np.asarray(np.clip(np.nan_to_num(stretched), 0.0, 255.0), dtype=np.uint8)


def find_features(picture: Picture, *, max_features: int) -> Features:
    """Features of a picture.

    OpenCV's pyramid takes some 60 bytes a pixel, which every thread that makes one keeps: so one
    thread makes all, and OpenCV shares the work among its own.
    """
    grey, scales = picture.grey, picture.scales
    points: Sequence[cv2.KeyPoint] = _detected(grey, max_features)
    points, found = cv2.SIFT.create(enable_precise_upscale=True).compute(grey, points)
    if found is None:
        points, found = [], np.zeros((0, 128), dtype=np.float32)
    xy = np.array([p.pt for p in points], dtype=np.float64).reshape(-1, 2)
    return Features(
        uv=uv_after_resize(xy, scales),
        size=np.array([p.size for p in points], dtype=np.float32) / 2.0,
        angle=np.radians(np.array([p.angle for p in points], dtype=np.float32)),
        descriptors=_root_sift(np.asarray(found, dtype=np.float32)),
        scale=float(1.0 / scales.max()),
        width=picture.width,
        height=picture.height,
    )


def _detected(grey: Grey, max_features: int) -> list[cv2.KeyPoint]:
    """Points of the picture, in its pixels, with octaves to match."""
    rows, cols = grey.shape
    half = cv2.resize(grey, (max(cols // 2, 1), max(rows // 2, 1)), interpolation=cv2.INTER_AREA)
    scales = np.array([cols / half.shape[1], rows / half.shape[0]])
    sift = cv2.SIFT.create(contrastThreshold=CONTRAST, enable_precise_upscale=True)
    points = sift.detect(half, None)
    xy = uv_after_resize(np.array([p.pt for p in points], float).reshape(-1, 2), scales)
    cell = _cells(xy, (cols, rows))
    chosen = _spread(cell, np.array([p.response for p in points]), max_features)
    out = []
    for i in chosen:
        p = points[i]
        # The octave's number is a signed byte; that of the half picture is one finer.
        octave = (p.octave & ~0xFF) | (((p.octave & 0xFF) + 1) & 0xFF)
        x, y = (float(c) for c in xy[i])
        out.append(cv2.KeyPoint(x, y, 2.0 * p.size, p.angle, p.response, octave, -1))
    return out


def _cells(xy: Array, size: tuple[int, int]) -> NDArray[np.int64]:
    """Cell of a grid in which points lie; shape (n, 2) px -> (n,)."""
    side = max(size) / CELLS
    cols, rows = (max(round(s / side), 1) for s in size)
    col = np.clip((xy[:, 0] + 0.5) * cols / size[0], 0, cols - 1).astype(np.int64)
    row = np.clip((xy[:, 1] + 0.5) * rows / size[1], 0, rows - 1).astype(np.int64)
    return np.asarray(row * cols + col)


def _spread(cell: NDArray[np.int64], response: Array, count: int) -> NDArray[np.int64]:
    """Indices of the strongest of every cell, then the second strongest, and so on."""
    order = np.lexsort((-response, cell))
    ordered = cell[order]
    first = np.searchsorted(ordered, ordered, side="left")
    rank = np.arange(len(order)) - first
    return np.asarray(order[np.lexsort((-response[order], rank))][:count])


def _root_sift(descriptors: NDArray[np.float32]) -> Descriptors:
    """Square roots of the shares (Arandjelovic and Zisserman 2012), times 512, as bytes."""
    share = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(np.minimum(np.round(512.0 * np.sqrt(share)), 255.0), dtype=np.uint8)
