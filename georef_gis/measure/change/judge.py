"""What a region is: its outline, whether a small move explains it, whether it is a shadow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.measure.change.candidates import Region
from georef_gis.measure.change.outline import Outline, outline
from georef_gis.measure.change.score import SIZES, Deviations, Differ, padded
from georef_gis.rasters.reading import Window

Image = NDArray[Any]

# cells about a region that are read; cells of the largest window that is
_PAD, _MOST = 16, 4_000_000
# m; what stands up leans by as much from one flight to the next, cells that are looked at
_LEAN, _MOST_MOVE = 1.0, 24
# cells about a shape that a move must bring to agreement too
_RIM = 3
# brightness of a shadow against the lit ground, as a factor
_SHADOW_LEAST, _SHADOW_MOST = 0.12, 0.85
# logarithms of red against blue, and of green against both, that a shadow changes at most
_REDDER, _BLUER, _GREENER = 0.12, 0.6, 0.15
# correlation of texture inside that says the ground is the same, cells that tell
_SAME_TEXTURE, _LEAST_CELLS = 0.45, 30
# cells of a region that is small
_SMALL = 250
# part of the difference that brightness must be for it to be the kind
_MOSTLY = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A region as it is judged.

    Parameters
    ----------
    score
        What its confidence is made of: its peak, less what a small move explains.
    kind
        ``brighter``, ``darker``, ``other`` or ``shadow?``.
    difference
        Median of later against earlier brightness, as a part of the earlier.
    moved
        Part of the difference that a move of the region by some cells leaves, 0 to 1.
    unrest
        How much higher scores are about it than on ground that has not changed.
    """

    region: Region
    outline: Outline
    score: float
    kind: str
    difference: float
    moved: float
    unrest: float


def judge(differ: Differ, region: Region, deviations: Deviations, unrest: float) -> Judged | None:
    """Judge a region; None if nothing of it stands out.

    Parameters
    ----------
    unrest
        How much higher scores are about it than on ground that has not changed.
    """
    move, window = move_of(differ), window_about(differ, region)
    if window is None:
        return _vast(region, unrest)
    later, earlier, valid = differ.alike(window)
    cells = np.zeros(valid.shape, np.bool_)
    cells[region.rows - window[1], region.cols - window[0]] = True
    raw = later - earlier
    raw[~valid] = 0.0
    usual = np.median(deviations.sigma[0], axis=1).astype(np.float32)
    magnitude: Image = np.sqrt(((raw / usual) ** 2).sum(axis=2))
    # calmer, but a small thing would grow by it
    if len(region.rows) > _SMALL:
        magnitude = cv2.blur(magnitude, (3, 3))
    found = outline(np.asarray(magnitude, np.float32), cells, window[:2])
    if found is None:
        return None
    left = left_by_moves(later / usual, earlier / usual, found.mask, move)
    bright = float(np.median(raw[..., 0][found.mask]))
    kind = _kind(raw, found.mask)
    if _is_shadow(later, earlier, found.mask):
        kind = "shadow?"
    return Judged(
        region=region, outline=found, score=region.peak * left**2 / unrest, kind=kind,
        difference=float(np.expm1(bright)), moved=left, unrest=unrest,
    )  # fmt: skip


def move_of(differ: Differ) -> int:
    """Cells that what stands up may lean by from one flight to the next."""
    return int(np.clip(_LEAN / differ.metres, 2 * differ.reach + 2, _MOST_MOVE))


def window_about(differ: Differ, region: Region) -> Window | None:
    """Window that a region is judged in; None if it is too large to be read at once."""
    window = padded(region.window, _PAD + move_of(differ), differ.pair.header)
    return window if window[2] * window[3] <= _MOST else None


def _vast(region: Region, unrest: float) -> Judged | None:
    """A region too large to be read at once: its cells as they are."""
    col, row, width, height = region.window
    cells = np.zeros((height, width), np.float32)
    cells[region.rows - row, region.cols - col] = 1.0
    found = outline(cv2.blur(cells, (SIZES[0], SIZES[0])), cells > 0, (col, row))
    if found is None:
        return None
    return Judged(
        region=region, outline=found, score=region.peak / unrest, kind="other",
        difference=float("nan"), moved=1.0, unrest=unrest,
    )  # fmt: skip


def left_by_moves(later: Image, earlier: Image, mask: NDArray[np.bool_], reach: int) -> float:
    """Part of the squared difference that moves leave.

    What is there now must be found near by in the past, and what was there near by now: bare ground
    beside a new thing is found anywhere, the thing is not.
    """
    rows, cols = np.nonzero(mask)
    r0, r1 = rows.min() - _RIM, rows.max() + _RIM + 1
    c0, c1 = cols.min() - _RIM, cols.max() + _RIM + 1
    if r0 < reach or c0 < reach or r1 > mask.shape[0] - reach or c1 > mask.shape[1] - reach:
        grow = ((reach + _RIM,) * 2, (reach + _RIM,) * 2)
        mask = np.pad(mask, grow)
        later, earlier = (np.pad(one, (*grow, (0, 0)), mode="edge") for one in (later, earlier))
        by = reach + _RIM
        r0, r1, c0, c1 = r0 + by, r1 + by, c0 + by, c1 + by
    kernel = np.ones((2 * _RIM + 1,) * 2, np.uint8)
    weight = cv2.dilate(mask[r0:r1, c0:c1].astype(np.uint8), kernel).astype(np.float32)
    left = 0.0
    for still, moving in ((later, earlier), (earlier, later)):
        template = np.ascontiguousarray(still[r0:r1, c0:c1])
        around = np.ascontiguousarray(moving[r0 - reach : r1 + reach, c0 - reach : c1 + reach])
        weights = np.repeat(weight[:, :, None], template.shape[2], axis=2)
        misfit = cv2.matchTemplate(around, template, cv2.TM_SQDIFF, mask=weights)
        left = max(left, float(misfit.min()) / max(float(misfit[reach, reach]), 1e-9))
    return float(np.clip(left, 0.0, 1.0))


def _kind(raw: Image, mask: NDArray[np.bool_]) -> str:
    inside = raw[mask]
    mean = float(inside[:, 0].mean())
    if abs(mean) < _MOSTLY * float(np.sqrt((inside**2).sum(axis=1)).mean()):
        return "other"
    return "brighter" if mean > 0 else "darker"


def _is_shadow(later: Image, earlier: Image, mask: NDArray[np.bool_]) -> bool:
    """Whether the same ground is seen by sky light alone in one of the two.

    All colours dim by about one factor, blue least, and the texture stays.
    """
    core = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if core.sum() < _LEAST_CELLS:
        return False
    first, second = later[core], earlier[core]
    change = np.median(first - second, axis=0)
    # the darker of the two is the one in shadow
    change = change if change[0] < 0 else -change
    if not np.log(_SHADOW_LEAST) < change[0] < np.log(_SHADOW_MOST):
        return False
    if len(change) == 3:
        red, green = float(change[1]), float(change[2])
        if not (-_BLUER < red < _REDDER and abs(green) < _GREENER):
            return False
    fine = [one[..., 0] - cv2.blur(one[..., 0], (9, 9)) for one in (later, earlier)]
    fine = [one[core] for one in fine]
    if min(float(one.std()) for one in fine) < 1e-6:
        return False
    return float(np.corrcoef(fine[0], fine[1])[0, 1]) > _SAME_TEXTURE
