"""The surface at check points: its height against the surveyed one, and whether it is fit to test.

Checks of height belong on flat or evenly sloping ground, away from edges (7.12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.model.terrain import Terrain

# m; radius within which the ground should be even (7.12), and a fraction of it that is looked at
RADIUS = 3.0
_RINGS = (1.5, 3.0)
_DIRECTIONS = 8
# Slope above which a height says much of the place, and departure from an even slope, m
STEEP, UNEVEN = 0.10, 0.10


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceReading:
    """The surface at one check point.

    Parameters
    ----------
    dz
        Surface minus survey, m; NaN where the surface has no height.
    slope
        Of the ground within `RADIUS`, rise over run.
    unevenness
        Largest departure of that ground from one slope, m.
    """

    dz: float
    slope: float
    unevenness: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What stands against the point as a check of height."""
        out = []
        if self.slope > STEEP:
            out.append(f"ground slopes by {self.slope:.0%}")
        if self.unevenness > UNEVEN:
            out.append(f"ground uneven by {self.unevenness:.2f} m within {RADIUS:.0f} m")
        return tuple(out)


def surface_readings(p_enu: ArrayLike, terrain: Terrain) -> list[SurfaceReading]:
    """The surface at surveyed points; (n, 3) m in enu.

    A height that is not known gives NaN.
    """
    p = np.asarray(p_enu, float).reshape(-1, 3)
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    around = np.concatenate([np.zeros((1, 2)), *(r * ring for r in _RINGS)])
    z = terrain.z_at(p[:, None, :2] + around)
    return [_reading(heights, float(up), around) for heights, up in zip(z, p[:, 2], strict=True)]


def _reading(heights: Array, surveyed: float, around: Array) -> SurfaceReading:
    known = np.isfinite(heights)
    slope = unevenness = np.nan
    if known.sum() > 3:
        A = np.column_stack([np.ones(len(around)), around])[known]
        plane, *_ = np.linalg.lstsq(A, heights[known], rcond=None)
        slope = float(np.hypot(plane[1], plane[2]))
        unevenness = float(np.abs(heights[known] - A @ plane).max())
    return SurfaceReading(dz=float(heights[0]) - surveyed, slope=slope, unevenness=unevenness)
