"""Finding the neighbourhood of a point of one picture in another, to a part of a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array

Grey = NDArray[np.float32]

# deg; turns of the neighbourhood that are tried where it does not fit as it lies
TURNS = (0.0, 3.0, -3.0, 6.0, -6.0, 9.0, -9.0, 13.0, -13.0)
# Normalised cross-correlation below which nothing was found, and by which the second best place
# must stay behind
LEAST_SCORE, LEAST_LEAD = 0.6, 0.06
# A fit as good as this ends the search for a turn.
GOOD_SCORE = 0.85
# Neighbouring pixels of resampled, compressed pictures share their noise: the matches err by this
# much more than independent pixels would (tests/measure/test_accuracy_matching.py).
NOISE_CORRELATION = 1.7
# px; no match is taken to be better than this
LEAST_SIGMA = 0.03
_ECC_STEPS, _ECC_EPS = 60, 1e-5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """Where the middle of a patch lies in a picture: (col, row) of pixel centres, px; one sigma."""

    xy: Array
    sigma: float
    score: float


def find_patch(patch: Grey, picture: Grey, valid: NDArray[np.bool_]) -> Match | str:
    """Find the middle third of a square patch in a picture, turned by up to 13 deg.

    Parameters
    ----------
    patch : shape (3 r + 1 or so, same)
        Odd side; its middle pixel shows the point.
    picture, valid : shape (rows, cols)
        Where to look; zero where not valid.

    Returns
    -------
    match or str
        Or why there is none.

    Notes
    -----
    Normalised cross-correlation over all places, then the affine refinement of Evangelidis and
    Psarakis (2008), "Parametric image alignment using enhanced correlation coefficient
    maximization". Sigma by Foerstner (1982): noise of the fit over the gradients.
    """
    radius = patch.shape[0] // 3
    best: tuple[float, Array, float] | None = None
    failures: list[_NoPeak] = []
    for turn in TURNS:
        template = _turned(patch, turn, radius)
        if float(template.std()) < 1e-3 * max(1.0, float(np.abs(template).max())):
            return "its neighbourhood is bland"
        peak = _peak(template, picture, valid)
        if isinstance(peak, _NoPeak):
            failures.append(peak)
            continue
        if best is None or peak[0] > best[0]:
            best = (*peak, turn)
        if best[0] >= GOOD_SCORE:
            break
    worst = max(failures, key=lambda one: one.score, default=None)
    # A turn that fits several places as well speaks against a single one.
    if worst is not None and (best is None or best[0] < worst.score + LEAST_LEAD):
        return worst.reason
    return "nothing like it in the mosaic" if best is None else _refined(patch, picture, best)


@dataclass(frozen=True, slots=True, kw_only=True)
class _NoPeak:
    score: float
    reason: str


def _turned(patch: Grey, degrees: float, radius: int) -> Grey:
    """Middle of a patch, turned about its middle pixel; side 2 radius + 1."""
    middle = patch.shape[0] // 2
    if degrees == 0.0:
        around = slice(middle - radius, middle + radius + 1)
        return np.ascontiguousarray(patch[around, around])
    # OpenCV's maps run from the result to the source.
    turn = _turn_matrix(degrees)
    offset = np.array([middle, middle]) - turn @ np.array([radius, radius])
    side = 2 * radius + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(patch, np.column_stack([turn, offset]), (side, side), flags=flags),
        dtype=np.float32,
    )


def _turn_matrix(degrees: float) -> Array:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s], [s, c]])


def _peak(template: Grey, picture: Grey, valid: NDArray[np.bool_]) -> tuple[float, Array] | _NoPeak:
    """Best score and the (col, row) of the template's middle, or why there is none."""
    side = template.shape[0]
    if min(picture.shape) < side:
        return _NoPeak(score=-1.0, reason="lies at the edge of the mosaic")
    scores = cv2.matchTemplate(picture, template, cv2.TM_CCOEFF_NORMED)
    whole = cv2.integral((~valid).astype(np.uint8))
    missing = whole[side:, side:] - whole[:-side, side:] - whole[side:, :-side]
    missing = missing + whole[:-side, :-side]
    scores = np.where((missing == 0) & np.isfinite(scores), scores, -1.0)
    row, col = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best = float(scores[row, col])
    if best < LEAST_SCORE:
        reason = f"nothing like it in the mosaic (best correlation {max(best, 0.0):.2f})"
        return _NoPeak(score=best, reason=reason)
    near = max(4, side // 6)
    scores[max(0, row - near) : row + near + 1, max(0, col - near) : col + near + 1] = -1.0
    second = float(scores.max())
    if best - second < LEAST_LEAD:
        reason = f"several places look like it (correlation {best:.2f} and {second:.2f})"
        return _NoPeak(score=best, reason=reason)
    return best, np.array([col, row]) + side // 2.0


def _refined(patch: Grey, picture: Grey, best: tuple[float, Array, float]) -> Match | str:
    """Match to a part of a pixel, from a peak: score, (col, row) and turn in deg."""
    radius = patch.shape[0] // 3
    score, at, degrees = best
    template = _turned(patch, 0.0, radius)
    # The turned template's row and column axes, as seen in the picture.
    turn = _turn_matrix(-degrees)
    middle = np.array([radius, radius], dtype=float)
    # A picture with a rim: the fit must not run out of it.
    reach = 2 * radius + 4
    low = np.maximum(np.floor(at).astype(int) - reach, 0)
    high = np.minimum(np.ceil(at).astype(int) + reach + 1, picture.shape[::-1])
    near = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
    start = np.column_stack([turn, at - low - turn @ middle]).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ECC_STEPS, _ECC_EPS)
    no_mask: Any = None
    try:
        fit, matrix = cv2.findTransformECC(
            template, near, start.copy(), cv2.MOTION_AFFINE, criteria, no_mask, 3
        )
    except cv2.error:
        return "its fit to the mosaic does not converge"
    warp: Array = np.asarray(matrix, dtype=np.float64)
    xy = warp[:, :2] @ middle + warp[:, 2] + low
    if float(np.linalg.norm(xy - at)) > 3.0 or not 0.7 < np.linalg.det(warp[:, :2]) < 1.4:
        return "its fit to the mosaic runs away"
    sigma = _sigma(template, near, warp)
    return Match(xy=xy, sigma=max(sigma, LEAST_SIGMA), score=max(float(fit), score))


def _sigma(template: Grey, picture: Grey, warp: Array) -> float:
    """One sigma of a match per axis, px, by what is left between the two."""
    side = template.shape[0]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpAffine(picture, warp, (side, side), flags=flags).astype(np.float64)
    A = np.column_stack([template.ravel(), np.ones(template.size)])
    levels, *_ = np.linalg.lstsq(A, seen.ravel(), rcond=None)
    left = seen.ravel() - A @ levels
    gy, gx = np.gradient(template.astype(np.float64))
    g = levels[0] * np.column_stack([gx.ravel(), gy.ravel()])
    noise = float(left @ left) / (template.size - 2)
    try:
        covariance = noise * np.linalg.inv(g.T @ g)
    except np.linalg.LinAlgError:
        return math.inf
    return NOISE_CORRELATION * math.sqrt(float(np.trace(covariance)) / 2.0)
