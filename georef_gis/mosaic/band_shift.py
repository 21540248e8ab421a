"""Shift between two pictures of the same ground in different bands.

Near infrared and red differ in brightness, often in sign: grass is bright in one and dark in the
other. Edges stay, so what is compared is the direction of the gradient without its sign: its
square as a complex number, correlated over all shifts at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.rasters.profile import Transform

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
# windows that must agree, as a number and as a part of those that found a peak
_LEAST_AGREEING, _LEAST_PART = 4, 0.5
# px: windows within this of each other speak of one shift; the field varies slowly
_ONE_SHIFT = 3.0
# windows from which a slope of the shift can be told, and the part of the scatter it must explain
_LEAST_SLOPE, _SLOPE_GAIN = 12, 0.8
# px, deviations: least shift that is worth to be applied
_LEAST_SHIFT, _SIGNIFICANT = 0.05, 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowShift:
    """What one window says.

    Parameters
    ----------
    col, row
        Middle of the window, px of the first picture.
    d_col, d_row
        Where the second picture shows what the first shows at a pixel, less that pixel, px.
    score
        Correlation of the edges, 0 to 1.
    """

    col: float
    row: float
    d_col: float
    d_row: float
    score: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BandShift:
    """Shift between two pictures, and how well it is known.

    Parameters
    ----------
    moved
        Pixel of the first picture -> pixel where the second shows the same, as a transform.
    shift
        Columns and rows in the middle of the windows, px.
    sigma
        Of that shift, px.
    scatter
        Of single windows about the field, per axis, px: what moving by it leaves. Windows within
        3 px of the rest count.
    agreeing, peaked, tried
        Windows that agree, that found a shift at all, and all.
    sloped
        Whether the shift changes over the picture, by a scale, a turn or a shear.
    """

    moved: Transform
    shift: tuple[float, float]
    sigma: float
    scatter: float
    agreeing: int
    peaked: int
    tried: int
    sloped: bool

    @property
    def significant(self) -> bool:
        """Whether it is worth to be applied."""
        return self.sloped or bool(
            np.hypot(*self.shift) > max(_LEAST_SHIFT, _SIGNIFICANT * self.sigma)
        )


def window_shift(
    first: Image, second: Image, valid: NDArray[np.bool_], *, most: float
) -> tuple[float, float, float] | None:
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
    tuple or None
        Shift of columns and rows, px, as in `WindowShift`, and the score; None where the window
        is bland, too empty, repeats itself, or has edges of one direction only.
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
    return None if max(abs(d_row), abs(d_col)) > most else (d_col, d_row, peak[2])


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


def common_shift(windows: Sequence[WindowShift], *, tried: int, most: float) -> BandShift:
    """Shift that most windows agree on.

    Parameters
    ----------
    windows
        Those that found a shift.
    tried
        How many were looked at.
    most
        Largest shift that is believed, px.

    Raises
    ------
    GeometryError
        If too few windows found a shift, or they disagree.
    """
    if len(windows) < _LEAST_AGREEING:
        raise GeometryError(
            f"only {len(windows)} of {tried} windows show edges common to both, "
            f"{_LEAST_AGREEING} are needed"
        )
    places = np.array([(w.col, w.row) for w in windows])
    shifts = np.array([(w.d_col, w.d_row) for w in windows])
    near = np.hypot(*np.moveaxis(shifts[:, None] - shifts[None], 2, 0)) <= _ONE_SHIFT
    best = near[np.argmax(near.sum(axis=1))]
    if best.sum() < max(_LEAST_AGREEING, _LEAST_PART * len(windows)):
        raise GeometryError(
            f"{int(best.sum())} of the {len(windows)} windows that found a shift agree on "
            f"{_pair(np.median(shifts[best], axis=0))} px to {_ONE_SHIFT:g} px, at least half "
            f"must; all together scatter by {_pair(_deviation(shifts))} px"
        )
    return _fitted(places, shifts, best, (len(windows), tried), most)


def _fitted(
    places: Image, shifts: Image, first: NDArray[np.bool_], counts: tuple[int, int], most: float
) -> BandShift:
    """Constant, or sloped where that explains clearly more, from the windows that agree."""
    kept, sloped = first, False
    middle = np.median(places[first], axis=0)
    for _ in range(4):
        constant = np.vstack([np.median(shifts[kept], axis=0), np.zeros((2, 2))])
        sloped = bool(kept.sum() >= _LEAST_SLOPE)
        model = constant
        if sloped:
            basis = np.column_stack([np.ones(len(places)), places - middle])
            slope = np.linalg.lstsq(basis[kept], shifts[kept], rcond=None)[0]
            gain = _scatter(places, shifts, slope, middle, kept) / max(
                _scatter(places, shifts, constant, middle, kept), 1e-9
            )
            sloped = gain < _SLOPE_GAIN
            model = slope if sloped else constant
        scatter = max(_scatter(places, shifts, model, middle, kept), 0.02)
        off = np.hypot(*_left(places, shifts, model, middle).T)
        kept = first & (off <= 3.0 * np.sqrt(2.0) * scatter)
    # of all that are near, for a part of the map that lies otherwise would be an outlier too
    scatter = float(np.sqrt(np.mean(_left(places, shifts, model, middle)[first] ** 2)))
    reach = np.abs(shifts[kept] - _left(places, shifts, model, middle)[kept]).max()
    if reach > most:
        raise GeometryError(f"the shift reaches {reach:.1f} px, more than {most:g} px")
    (dx, dy), (xx, xy), (yx, yy) = model.tolist()
    x, y = middle.tolist()
    return BandShift(
        moved=(1 + xx, yx, dx - xx * x - yx * y, xy, 1 + yy, dy - xy * x - yy * y),
        shift=(dx, dy),
        # of a median
        sigma=1.25 * max(scatter, 0.01) / float(np.sqrt(kept.sum())),
        scatter=scatter,
        agreeing=int(kept.sum()),
        peaked=counts[0],
        tried=counts[1],
        sloped=sloped,
    )


def _left(places: Image, shifts: Image, model: Image, middle: Image) -> Image:
    """What a model leaves of the shifts, px."""
    basis = np.column_stack([np.ones(len(places)), places - middle])
    return np.asarray(shifts - basis @ model)


def _scatter(
    places: Image, shifts: Image, model: Image, middle: Image, kept: NDArray[np.bool_]
) -> float:
    """Robust deviation of what is left, per axis, px."""
    left = _left(places[kept], shifts[kept], model, middle)
    return float(np.sqrt(np.mean((1.4826 * np.median(np.abs(left), axis=0)) ** 2)))


def _deviation(shifts: Image) -> Image:
    return np.asarray(1.4826 * np.median(np.abs(shifts - np.median(shifts, axis=0)), axis=0))


def _pair(values: Image) -> str:
    return f"{values[0]:.2f}, {values[1]:.2f}"
