"""The shift between the clocks of two trajectories, from how they move."""

from __future__ import annotations

import math

import numpy as np

from georef_gis.errors import NavigationError
from georef_gis.frames import Array, R_ned_from_body, log_so3
from georef_gis.model.logs import TrajectoryLog
from georef_gis.model.trajectory_values import metres_per_radian
from georef_gis.navigate.resample import transposed

# Rows of the estimate that are looked at; more add nothing.
_ROWS = 20000
# s between the shifts tried first
_STEP = 0.05
_BLOCKS = 12


def find_shift(
    estimate: TrajectoryLog, reference: TrajectoryLog, window: float
) -> tuple[float, float, str]:
    """Seconds to add to the estimate's times, their sigma, and the quantity that told.

    Velocities are compared where both have them, else positions, else the size of the turn rate,
    which a mount does not change. A constant offset is of no account. The sigma comes from the
    scatter of the shifts of twelve parts of the flight.

    Raises
    ------
    NavigationError
        If the two have no such quantity in common, or nothing that moves.
    """
    for name in ("velocity", "position", "turn rate"):
        mine, other = _signal(estimate, name, reference), _signal(reference, name, reference)
        if min(len(mine[0]), len(other[0])) >= 20:
            return *_search(mine, other, window), name
    raise NavigationError(
        f"{estimate.source or 'estimate'}: no velocity, position or attitude in common with "
        "the reference to find the time shift by; give the shift"
    )


def _signal(log: TrajectoryLog, name: str, base: TrajectoryLog) -> tuple[Array, Array]:
    """Times and values (n, k) of a quantity where it is known."""
    if name == "velocity":
        values, time = log.v_ned, log.time
    elif name == "position":
        place = np.nanmean(base.lat, keepdims=True), np.nanmean(base.height, keepdims=True)
        north, east = metres_per_radian(*place)
        values, time = np.stack([log.lat * north, log.lon * east, -log.height], axis=-1), log.time
    else:
        R = R_ned_from_body(*log.rpy.T)
        turn = np.linalg.norm(log_so3(transposed(R[:-1]) @ R[1:]), axis=-1) / np.diff(log.time)
        values, time = turn[:, None], 0.5 * (log.time[1:] + log.time[:-1])
    known = np.all(np.isfinite(values), axis=1)
    return time[known], values[known]


def _search(
    mine: tuple[Array, Array], other: tuple[Array, Array], window: float
) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar

    time, y = mine
    inside = (time > other[0][0] + window) & (time < other[0][-1] - window)
    if inside.sum() < 20:
        raise NavigationError(
            f"the two overlap by {inside.sum()} rows within {window:g} s of search; too few to "
            "find the time shift: give it"
        )
    every = max(1, int(inside.sum()) // _ROWS)
    time, y = time[inside][::every], y[inside][::every]

    def residual(shift: float) -> Array:
        r = np.stack([np.interp(time + shift, other[0], c) for c in other[1].T], axis=-1) - y
        return np.asarray(r - r.mean(axis=0))

    def cost(shift: float) -> float:
        return float(np.mean(residual(shift) ** 2))

    tried = np.arange(-window, window + _STEP / 2, _STEP)
    costs = [cost(shift) for shift in tried]
    best = float(tried[int(np.argmin(costs))])
    if max(costs) <= 1.0001 * min(costs):
        raise NavigationError("nothing moves, so the time shift cannot be found; give it")
    found = minimize_scalar(
        cost, bounds=(best - _STEP, best + _STEP), method="bounded", options={"xatol": 1e-5}
    )
    shift = float(found.x)
    return shift, _scatter(residual(shift), residual(shift + 0.02), residual(shift - 0.02))


def _scatter(r: Array, ahead: Array, behind: Array) -> float:
    """Sigma of the shift from the Gauss-Newton step of each part by itself, s."""
    slope = (ahead - behind) / 0.04
    parts = np.array_split(np.arange(len(r)), _BLOCKS)
    weight = np.array([np.sum(slope[part] ** 2) for part in parts])
    pull = np.array([np.sum(slope[part] * r[part]) for part in parts])
    # Parts pull as their own residuals say; with one weight each, as in a weighted mean.
    variance = np.sum(pull**2) * _BLOCKS / (_BLOCKS - 1) / np.sum(weight) ** 2
    return math.sqrt(float(variance))
