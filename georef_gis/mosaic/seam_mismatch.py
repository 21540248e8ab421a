"""How far neighbouring photos show the same ground apart at the seams of a mosaic."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.seam_steps import SeamPlaces

Values = NDArray[np.float32]
# px of the mosaic: side of the squares that are compared
SIDE = 128
# places measured at most; an even share of all seams
MOST = 120
# of the correlation's peak, below which two squares do not tell how they lie
LEAST_PEAK = 0.12
# of the square: a larger shift is a chance likeness
LARGEST = 0.25
# grey levels, of 255: less contrast is noise
LEAST_CONTRAST = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamMismatch:
    """Shifts between photos at seams, m on the ground.

    Parameters
    ----------
    places, accepted
        Looked at; told something.
    median, p90, rmse : m
        Of the lengths of the shifts; None where no place told.
    """

    places: int
    accepted: int
    median: float | None
    p90: float | None
    rmse: float | None

    def as_json(self) -> dict[str, Any]:
        """For the run's summary."""
        return {
            "places": self.places, "accepted": self.accepted, "median_m": self.median,
            "p90_m": self.p90, "rmse_m": self.rmse,
        }  # fmt: skip


class MismatchProbe:
    """Compares the two photos of a seam while both are at hand, tile by tile.

    Parameters
    ----------
    places
        On all seams, on the coarse grid of `factor` fine pixels.
    gsd : m
        Of the mosaic.
    """

    def __init__(self, places: SeamPlaces, *, factor: int, gsd: float) -> None:
        step = max(1, -(-len(places) // MOST))
        chosen = slice(step // 2, None, step)
        self._a, self._b = places.a[chosen], places.b[chosen]
        self._col = (places.col[chosen] + 1) * factor
        self._row = (places.row[chosen] * factor) + factor // 2
        self._gsd = gsd
        self._shifts: list[float] = []
        self._lock = threading.Lock()

    def measure(self, window: Window, paint: Callable[[int, Window], Values | None]) -> None:
        """Measure the places in a window; `paint` gives a photo's grey values, None off it."""
        w = window
        inside = (self._col >= w.col) & (self._col < w.col + w.width)
        inside &= (self._row >= w.row) & (self._row < w.row + w.height)
        for k in np.flatnonzero(inside):
            square = Window(
                col=int(self._col[k]) - SIDE // 2, row=int(self._row[k]) - SIDE // 2,
                width=SIDE, height=SIDE,
            )  # fmt: skip
            a, b = (paint(int(label), square) for label in (self._a[k], self._b[k]))
            shift = None if a is None or b is None else shift_between(a, b)
            if shift is not None:
                with self._lock:
                    self._shifts.append(float(np.hypot(*shift)) * self._gsd)

    def result(self) -> SeamMismatch:
        """What was found."""
        found = np.array(self._shifts)
        told = len(found) > 0
        return SeamMismatch(
            places=len(self._a),
            accepted=len(found),
            median=float(np.median(found)) if told else None,
            p90=float(np.percentile(found, 90)) if told else None,
            rmse=float(np.sqrt(np.mean(found**2))) if told else None,
        )


def shift_between(a: Values, b: Values) -> tuple[float, float] | None:
    """Shift (columns, rows), px, from one square of grey values to another; None if unclear.

    Phase correlation on the squares' detail: brightness that differs slowly does not count.
    """
    fine = [g - cv2.GaussianBlur(g, (0, 0), 8.0) for g in (a, b)]
    # NaN compares as false
    if not min(float(np.std(g)) for g in fine) >= LEAST_CONTRAST:
        return None
    hann = cv2.createHanningWindow((a.shape[1], a.shape[0]), cv2.CV_32F)
    (dx, dy), peak = cv2.phaseCorrelate(fine[0], fine[1], hann)
    if not (peak >= LEAST_PEAK and np.hypot(dx, dy) <= LARGEST * min(a.shape)):
        return None
    return float(dx), float(dy)


def grey(values: NDArray[Any], scale: float) -> Values:
    """Mean of the bands in 255ths of `scale`; (rows, cols, bands) -> (rows, cols)."""
    out: Sequence[Any] = np.asarray(values, dtype=np.float32).mean(axis=2) * (255.0 / scale)
    return np.ascontiguousarray(out, dtype=np.float32)
