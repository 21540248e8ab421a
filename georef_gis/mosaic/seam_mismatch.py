"""How far neighbouring photos show the same ground apart at the seams of a mosaic."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.mosaic.nadir import MosaicSource
from georef_gis.mosaic.seam_steps import SeamPlaces
from georef_gis.rasters.warp import Image, all_inside, sample, upsample

Values = NDArray[np.float32]
# number of a place, and how far two photos lie apart there, m; None if they do not tell
Shift = tuple[int, float | None]
# px of the mosaic: side of the squares that are compared
SIDE = 128
# px between the nodes through which photos are sampled over ground with relief: what lies between
# moves both photos, so that shifts are those of every pixel to 0.02 px of the mosaic
RELIEF_STEP = 4
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
    """Compares the two photos of a seam at places of it, tile by tile; can be pickled.

    What a place tells does not depend on who makes the tiles, nor in which order.

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

    def measure(
        self, window: Window, paint: Callable[[int, Window], Values | None]
    ) -> tuple[Shift, ...]:
        """Measure the places in a window; `paint` gives a photo's grey values, None off it."""
        w = window
        inside = (self._col >= w.col) & (self._col < w.col + w.width)
        inside &= (self._row >= w.row) & (self._row < w.row + w.height)
        return tuple((int(k), self._shift(int(k), paint)) for k in np.flatnonzero(inside))

    def _shift(self, k: int, paint: Callable[[int, Window], Values | None]) -> float | None:
        square = Window(
            col=int(self._col[k]) - SIDE // 2, row=int(self._row[k]) - SIDE // 2,
            width=SIDE, height=SIDE,
        )  # fmt: skip
        a = paint(int(self._a[k]), square)
        b = None if a is None else paint(int(self._b[k]), square)
        shift = None if a is None or b is None else shift_between(a, b)
        return None if shift is None else float(np.hypot(*shift)) * self._gsd

    def result(self, shifts: Mapping[int, float | None]) -> SeamMismatch:
        """What the places of all tiles tell, by their numbers."""
        found = np.array([shift for _, shift in sorted(shifts.items()) if shift is not None])
        told = len(found) > 0
        return SeamMismatch(
            places=len(self._a),
            accepted=len(found),
            median=float(np.median(found)) if told else None,
            p90=float(np.percentile(found, 90)) if told else None,
            rmse=float(np.sqrt(np.mean(found**2))) if told else None,
        )


class Squares:
    """Squares of ground as photos show them, their colours as they are.

    Parameters
    ----------
    sources
        The photos, in the order that labels count.
    read
        `read(path, reduce) -> image` (rows, cols, bands).
    """

    def __init__(
        self,
        sources: Sequence[MosaicSource],
        ground: Ground,
        grid: Grid,
        read: Callable[[Path, int], Image],
    ) -> None:
        self._sources, self._ground, self._grid, self._read = sources, ground, grid, read
        # the ground of a square is the same for both its photos
        self._nodes: dict[tuple[Window, int], Array] = {}

    def of(self, label: int, window: Window) -> Values | None:
        """Grey values of a photo over a square, in 255ths; None where it does not show all of it.

        Raises
        ------
        InputError
            If the photo cannot be read.
        """
        source = self._sources[label]
        photo, step = source.photo, self._step(source)
        uv = photo.project(self._ground_at(window, step))
        # first, so that no photo is read in vain
        if not all_inside(uv, photo.camera.width, photo.camera.height):
            return None
        image = self._read(photo.photo.path, source.reduce)
        places = upsample(uv, step, (window.height, window.width))
        values = sample(image, places, reduce=source.reduce)
        # sensors fill 10 to 14 of 16 bits
        whole_range = image.dtype == np.uint8
        return grey(values, 255.0 if whole_range else float(np.max(np.abs(values), initial=1e-6)))

    def _step(self, source: MosaicSource) -> int:
        return min(source.step, RELIEF_STEP) if self._ground.has_relief else source.step

    def _ground_at(self, window: Window, step: int) -> Array:
        found = self._nodes.get((window, step))
        if found is None:
            found = self._ground.enu_at(self._grid, node_positions(window, step))
            self._nodes[window, step] = found
        return found


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
    weights = np.full(values.shape[2], 255.0 / (scale * values.shape[2]), np.float32)
    return np.asarray(values.astype(np.float32) @ weights, dtype=np.float32)
