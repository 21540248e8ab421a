"""The part of a step that moves the block as a whole, done exactly instead of to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array, exp_so3, skew


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WholeMove:
    """A similarity about `centre`: turn (rotation vector, rad), log of scale, shift (m)."""

    centre: Array
    turn: Array
    growth: float
    shift: Array

    def places(self, places: Array, steps: Array) -> Array:
        """Places, (n, 3) m, after steps to first order, of which the whole move is exact."""
        arm = places - self.centre
        linear = self.shift + np.cross(self.turn, arm) + self.growth * arm
        exact = self.shift + np.exp(self.growth) * arm @ exp_so3(self.turn).T - arm
        return np.asarray(places + steps + exact - linear)


def whole_move(origin: Array, step: Array) -> WholeMove:
    """Similarity that fits the steps of poses best.

    Parameters
    ----------
    origin : shape (n, 3), m
    step : shape (n, 6)
        Steps (dp_enu m, dtheta_enu rad).

    Notes
    -----
    Least squares of dp = shift + turn x arm + growth arm and dtheta = turn, angles weighted by
    the extent of the block.
    """
    n = len(origin)
    centre = origin.mean(axis=0)
    arm = origin - centre
    extent = max(float(np.sqrt(np.mean(np.sum(arm**2, axis=1)))), 1.0)
    A = np.zeros((n, 6, 7))
    A[:, :3, :3] = np.eye(3)
    A[:, :3, 3:6] = -skew(arm)
    A[:, :3, 6] = arm
    A[:, 3:, 3:6] = extent * np.eye(3)
    b = step.copy()
    b[:, 3:] *= extent
    x: Array = np.asarray(np.linalg.lstsq(A.reshape(-1, 7), b.ravel(), rcond=1e-9)[0])
    return WholeMove(centre=centre, turn=x[3:6], growth=float(x[6]), shift=x[:3])
