"""How two maps lie upon each other: a shift, similarity or affine map from many windows.

Every window says its own shift by its edges. Most of a site has not changed, so the shift that
most windows agree on is that of the maps; of the three models the simplest is taken whose
misfit the Bayesian information criterion does not reject. Misfit of windows beside each other is
alike, where the maps are bent, and the covariance is widened by as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.rasters.edge_shift import agreeing
from georef_gis.rasters.profile import Transform

Array = NDArray[np.float64]

# windows that must agree, as a number and as a part of those that found a peak
LEAST_AGREEING, LEAST_PART = 4, 0.3
# cells: windows within this of each other speak of one shift
_ONE_SHIFT = 3.0
# cells; what resampling and the interpolated peak of a window leave, common to all windows
_RESAMPLING = 0.0055
# windows for each parameter of a model
_PER_PARAMETER = 3
# deviations beyond which a window is left out, cells that count as the least scatter
_OUTLIER, _LEAST_SCATTER = 3.5, 0.01
_ITERATIONS = 10
# largest correlation of neighbours that the covariance is widened by
_MOST_CORRELATION = 0.8
MODELS = {"shift": 2, "similarity": 4, "affine": 6}


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowShift:
    """What one window says.

    Parameters
    ----------
    col, row
        Its middle, cells of the grid.
    d_col, d_row
        Where the earlier map shows what the later shows at a cell, less that cell, cells.
    score
        Correlation of the edges, 0 to 1.
    """

    col: float
    row: float
    d_col: float
    d_row: float
    score: float

    @property
    def spread(self) -> float:
        """Deviation of the shift as its correlation tells it, to a factor common to all."""
        return math.sqrt(max(1.0 - self.score**2, 1e-3)) / max(self.score, 1e-3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Registration:
    """The map from one to the other.

    Parameters
    ----------
    moved
        Cell of the grid, (0, 0) = outer corner -> cell where the earlier map shows the same.
    model
        ``shift``, ``similarity`` or ``affine``.
    shift
        Columns and rows in the middle of the windows, cells.
    covariance : shape (2, 2)
        Of that shift, cells^2.
    parameters, parameter_covariance : shape (k,), shape (k, k)
        Of the model on coordinates about `middle` in units of `reach`, cells.
    rmse
        Of windows near the model, per axis, cells: what moving by it leaves.
    agreeing, peaked, tried
        Windows that agree, that found a shift at all, and all.
    """

    moved: Transform
    model: str
    shift: tuple[float, float]
    covariance: Array
    parameters: Array
    parameter_covariance: Array
    middle: tuple[float, float]
    reach: float
    rmse: float
    agreeing: int
    peaked: int
    tried: int

    @property
    def sigma(self) -> float:
        """One sigma of the shift per axis, cells."""
        return float(np.sqrt(np.trace(self.covariance) / 2.0))

    def scaled(self, factor: float) -> Registration:
        """The same on a grid whose cells are so many times shorter."""
        from dataclasses import replace

        a, b, c, d, e, f = self.moved
        return replace(
            self, moved=(a, b, c * factor, d, e, f * factor),
            shift=(self.shift[0] * factor, self.shift[1] * factor),
            covariance=self.covariance * factor**2,
            parameters=self.parameters * factor,
            parameter_covariance=self.parameter_covariance * factor**2,
            middle=(self.middle[0] * factor, self.middle[1] * factor),
            reach=self.reach * factor, rmse=self.rmse * factor,
        )  # fmt: skip


def fit_registration(windows: Sequence[WindowShift], *, tried: int, most: float) -> Registration:
    """Model that most windows agree on.

    Parameters
    ----------
    windows
        Those that found a shift.
    tried
        How many were looked at.
    most
        Largest shift that is believed, cells.

    Raises
    ------
    GeometryError
        If too few windows found a shift, or they disagree.
    """
    if len(windows) < LEAST_AGREEING:
        raise GeometryError(
            f"only {len(windows)} of {tried} windows show edges common to both, {LEAST_AGREEING} "
            "are needed"
        )
    shifts = np.array([(w.d_col, w.d_row) for w in windows])
    best = agreeing(shifts, _ONE_SHIFT)
    if best.sum() < max(LEAST_AGREEING, LEAST_PART * len(windows)):
        raise GeometryError(
            f"{int(best.sum())} of the {len(windows)} windows that found a shift agree to "
            f"{_ONE_SHIFT:g} cells, {LEAST_PART:.0%} and {LEAST_AGREEING} must"
        )
    chosen = _choose(windows, best, tried)
    if np.hypot(*chosen.shift) > most:
        raise GeometryError(
            f"the shift is {np.hypot(*chosen.shift):.1f} cells, more than {most:.1f}"
        )
    return chosen


def _choose(windows: Sequence[WindowShift], near: NDArray[np.bool_], tried: int) -> Registration:
    places = np.array([(w.col, w.row) for w in windows])
    shifts = np.array([(w.d_col, w.d_row) for w in windows])
    spread = np.array([w.spread for w in windows])
    spread = spread / np.median(spread[near])
    middle = places[near].mean(axis=0)
    reach = max(float(np.abs(places[near] - middle).max()), 1.0)
    unit = (places - middle) / reach
    fits = []
    for name, count in MODELS.items():
        if name == "shift" or 2 * near.sum() >= _PER_PARAMETER * count:
            fits.append((name, *_robust(_design(name, unit), shifts, spread, near)))
    # one set of windows for all models: else a poor model that drops more would look better
    kept = np.logical_or.reduce([fit[3] for fit in fits])
    number = 2 * int(kept.sum())
    scores = []
    for name, solution, _, _ in fits:
        left = (shifts - np.einsum("nik,k->ni", _design(name, unit), solution)) / spread[:, None]
        misfit = max(float((left[kept] ** 2).sum()), number * _LEAST_SCATTER**2)
        scores.append(number * math.log(misfit / number) + MODELS[name] * math.log(number))
    name, solution, covariance, used = fits[int(np.argmin(scores))]
    left = shifts - np.einsum("nik,k->ni", _design(name, unit), solution)
    covariance = covariance * _alike(places[used], left[used])
    return Registration(
        moved=_moved(name, solution, middle, reach),
        model=name,
        shift=(float(solution[0]), float(solution[1])),
        covariance=covariance[:2, :2] + _RESAMPLING**2 * np.eye(2),
        parameters=solution,
        parameter_covariance=covariance,
        middle=(float(middle[0]), float(middle[1])),
        reach=reach,
        rmse=float(np.sqrt(np.mean(left[near] ** 2))),
        agreeing=int(used.sum()),
        peaked=len(windows),
        tried=tried,
    )


def _design(name: str, unit: Array) -> Array:
    """Design, shape (n, 2, k): the shift of both axes by parameter."""
    x, y = unit.T
    design = np.zeros((len(unit), 2, MODELS[name]))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    if name == "similarity":
        design[:, 0, 2], design[:, 0, 3] = x, -y
        design[:, 1, 2], design[:, 1, 3] = y, x
    elif name == "affine":
        design[:, 0, 2], design[:, 0, 3] = x, y
        design[:, 1, 4], design[:, 1, 5] = x, y
    return design


def _robust(
    design: Array, shifts: Array, spread: Array, near: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Weighted least squares with outliers left out: parameters, covariance, windows used."""
    used = near.copy()
    count = design.shape[2]
    for _ in range(_ITERATIONS):
        scaled = design[used] / spread[used, None, None]
        rows = scaled.reshape(-1, count)
        normal = np.linalg.pinv(rows.T @ rows)
        solution = normal @ rows.T @ (shifts[used] / spread[used, None]).ravel()
        left = (shifts - np.einsum("nik,k->ni", design, solution)) / spread[:, None]
        # two axes: the median of a Rayleigh distance is 1.1774 deviations
        off = np.hypot(*left.T)
        scatter = max(float(np.median(off[used])) / 1.1774, _LEAST_SCATTER)
        kept = near & (off <= _OUTLIER * scatter)
        if (kept == used).all():
            break
        used = kept
    freedom = max(2 * int(used.sum()) - count, 1)
    variance = max(float((left[used] ** 2).sum()) / freedom, _LEAST_SCATTER**2 / 4.0)
    return solution, normal * variance, used


def _alike(places: Array, left: Array) -> float:
    """Factor of the variance, as neighbours' misfits are alike: that of a field of such a memory.

    The correlation counts from where chance would not give it.
    """
    if len(places) < 8:
        return 1.0
    apart = np.hypot(*np.moveaxis(places[:, None] - places[None], 2, 0))
    np.fill_diagonal(apart, np.inf)
    step = float(np.median(apart.min(axis=1)))
    first, second = np.nonzero(np.triu(apart <= 1.1 * step))
    if len(first) < 8:
        return 1.0
    centred = left - left.mean(axis=0)
    power = float((centred**2).mean())
    alike = float((centred[first] * centred[second]).mean()) / max(power, 1e-12)
    if alike < 2.0 / math.sqrt(2.0 * len(first)):
        return 1.0
    alike = min(alike, _MOST_CORRELATION)
    return ((1.0 + alike) / (1.0 - alike)) ** 2


def _moved(name: str, solution: Array, middle: Array, reach: float) -> Transform:
    slope = np.zeros((2, 2))
    if name == "similarity":
        slope = np.array([[solution[2], -solution[3]], [solution[3], solution[2]]])
    elif name == "affine":
        slope = solution[2:].reshape(2, 2)
    slope = slope / reach
    offset = solution[:2] - slope @ middle
    matrix = np.eye(2) + slope
    return (
        float(matrix[0, 0]), float(matrix[0, 1]), float(offset[0]),
        float(matrix[1, 0]), float(matrix[1, 1]), float(offset[1]),
    )  # fmt: skip
