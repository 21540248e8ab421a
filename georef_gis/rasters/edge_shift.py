"""Shift between two windows of the same ground, from the directions of their edges.

What is compared is the direction of the gradient without its sign: its square as a complex
number, correlated over all shifts at once. So bands that differ in brightness, often in sign,
such as near infrared and red, can be compared, and so can two dates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[Any]

# px; takes the noise of pixels, and is enough for a smooth peak
_BLUR = 1.5
# px round the peak that are its own
_PEAK = 5
# the next best peak, and the least correlation, of a window that counts
_SECOND_BEST, _LEAST_SCORE = 0.75, 0.03
# part of a window that must show the ground in both, less the rim
_LEAST_VALID = 0.6
# parts of a pixel in which the peak is looked at
_FINE = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeShift:
    """Shift of one window.

    Parameters
    ----------
    d_col, d_row
        Where the second picture shows what the first shows at a pixel, less that pixel, px.
    score
        Correlation of the edges, 0 to 1.
    """

    d_col: float
    d_row: float
    score: float


def edge_shift(
    first: Image, second: Image, valid: NDArray[np.bool_], *, most: float
) -> EdgeShift | None:
    """Shift of one window.

    Parameters
    ----------
    first, second : shape (rows, cols, bands)
        The same window of both, any number of bands of any type.
    valid : shape (rows, cols)
        Where both show the ground.
    most
        Largest shift looked for, px.

    Returns
    -------
    EdgeShift or None
        None where the window is bland, too empty, repeats itself, or has edges of one direction
        only.
    """
    if valid.mean() < _LEAST_VALID:
        return None
    inside = cv2.erode(valid.astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=0)
    rows, cols = valid.shape
    taper = np.outer(np.hanning(rows), np.hanning(cols)) * inside
    fields = [
        edges for image in (first, second) if (edges := _edges(image, valid, taper)) is not None
    ]
    if len(fields) < 2:
        return None
    cross = np.conj(np.fft.fft2(fields[0])) * np.fft.fft2(fields[1])
    energy = float(np.sqrt(np.prod([np.sum(np.abs(field) ** 2) for field in fields])))
    peak = _clear_peak(np.fft.ifft2(cross).real / energy, most)
    if peak is None:
        return None
    d_row, d_col = _fine_peak(cross, peak[0], peak[1])
    if max(abs(d_row), abs(d_col)) > most:
        return None
    return EdgeShift(d_col=d_col, d_row=d_row, score=peak[2])


def agreeing(shifts: Image, most: float) -> NDArray[np.bool_]:
    """Which shifts, (n, 2), lie within `most` of the one that most others are near to; (n,)."""
    near = np.hypot(*np.moveaxis(shifts[:, None] - shifts[None], 2, 0)) <= most
    return np.asarray(near[np.argmax(near.sum(axis=1))])


def _clear_peak(surface: Image, most: float) -> tuple[int, int, float] | None:
    """Row, column and height of the highest peak near no shift, if no other comes near it."""
    reach = min(int(np.ceil(most)) + _PEAK, min(surface.shape) // 2 - 1)
    near = np.roll(surface, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1].copy()
    row, col = (int(i) for i in np.unravel_index(np.argmax(near), near.shape))
    best = float(near[row, col])
    near[max(row - _PEAK, 0) : row + _PEAK + 1, max(col - _PEAK, 0) : col + _PEAK + 1] = -np.inf
    if best < _LEAST_SCORE or near.max() > _SECOND_BEST * best:
        return None
    return row - reach, col - reach, best


def _edges(image: Image, valid: NDArray[np.bool_], taper: Image) -> Image | None:
    """Squared gradients, complex, tapered, summed over the bands; None if all are bland."""
    total: Image = np.zeros(valid.shape, np.complex128)
    some = False
    for band in np.moveaxis(image, 2, 0):
        values = band.astype(np.float64)
        values[~valid] = values[valid].mean()
        smooth = cv2.GaussianBlur(values, (0, 0), _BLUR)
        d_row, d_col = np.gradient(smooth)
        gradient = d_col + 1j * d_row
        size = np.abs(gradient)
        usual = float(np.sqrt(np.mean(size[taper > 0] ** 2))) if (taper > 0).any() else 0.0
        if usual < 1e-9 * max(1.0, float(np.abs(values).max())):
            continue
        some = True
        # a bright car must not outweigh the rest
        total += gradient**2 / np.maximum(size, 1e-12) * np.minimum(1.0, 3 * usual / (size + usual))
    if not some:
        return None
    weight = taper.sum()
    # edges of one direction all over would make a ridge of the whole surface
    return np.asarray((total - (total * taper).sum() / weight) * taper)


def _fine_peak(cross: Image, row: int, col: int) -> tuple[float, float]:
    """Place of the peak to a fraction of a pixel: its surroundings, finely, and a parabola."""
    steps = np.arange(-_FINE, _FINE + 1) / _FINE
    rows, cols = cross.shape
    along_rows = np.exp(2j * np.pi * np.outer(row + steps, np.fft.fftfreq(rows)))
    along_cols = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(cols), col + steps))
    fine = (along_rows @ cross @ along_cols).real
    i, j = (int(k) for k in np.unravel_index(np.argmax(fine), fine.shape))
    return row + _top(steps, fine[:, j], i), col + _top(steps, fine[i], j)


def _top(steps: Image, values: Image, at: int) -> float:
    if not 0 < at < len(values) - 1:
        return float(steps[at])
    low, mid, high = values[at - 1 : at + 2]
    return float(steps[at] + 0.5 * (low - high) / (low - 2 * mid + high) / _FINE)
