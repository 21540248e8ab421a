"""Shift between two pictures of the same ground in different bands.

A window is compared by its edges (`rasters.edge_shift`); here many of them are made one shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.rasters.edge_shift import agreeing
from georef_gis.rasters.profile import Transform

Image = NDArray[Any]

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
    best = agreeing(shifts, _ONE_SHIFT)
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
