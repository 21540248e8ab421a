"""Error ellipses on the map.

Notes
-----
Of a normal error in the plane the ellipse of confidence p is that of `x^T C^-1 x = k^2` with k^2
the p-quantile of chi-square with 2 degrees of freedom, -2 ln(1 - p): 39.3 % for k = 1. Where the
variance itself was estimated with few degrees of freedom, k^2 = 2 F(p; 2, dof) (Mikhail and
Gracie, Analysis and Adjustment of Survey Measurements (1981), chapter 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import InputError
from georef_gis.frames import Array, R_ecef_from_enu
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.measure.measured import MeasuredPoint, MeasuredPoints

# the probability within one sigma in the plane
STANDARD = 1.0 - math.exp(-0.5)
# m; no axis is told shorter
_LEAST = 1e-12
# m; half the base over which the map's north is taken
_STEP = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ellipse:
    """Error ellipse; half axes in m, azimuth of the longer one clockwise from grid north, rad.

    `conf` is the probability that it holds the truth; `dof` the degrees of freedom with which the
    variance was estimated, None where it is known beforehand. The azimuth is in [0, pi).
    """

    semi_major: float
    semi_minor: float
    azimuth: float
    conf: float = STANDARD
    dof: int | None = None

    def polygon(self, centre: ArrayLike, *, n: int = 64, unit: float = 1.0) -> Array:
        """Closed ring about a place of the map, counter-clockwise; shape (n + 1, 2).

        Parameters
        ----------
        centre : shape (2,)
            In units of the map, as the result.
        unit : m
            Of one unit of the map.
        """
        t = np.linspace(0.0, 2.0 * math.pi, n + 1)
        along, across = self.semi_major * np.cos(t), self.semi_minor * np.sin(t)
        s, c = math.sin(self.azimuth), math.cos(self.azimuth)
        # the longer axis points to (s, c), the shorter one to its left
        ring = np.stack([s * along - c * across, c * along + s * across], axis=1)
        ring[-1] = ring[0]
        return np.asarray(np.asarray(centre, float)[:2] + ring / unit)

    def holds(self, offset_en: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether offsets from the centre, (..., 2) m along grid east and north, lie inside."""
        d = np.asarray(offset_en, float)
        s, c = math.sin(self.azimuth), math.cos(self.azimuth)
        along = d[..., 0] * s + d[..., 1] * c
        across = d[..., 0] * c - d[..., 1] * s
        # of axes without length only the centre itself
        a, b = max(self.semi_major, _LEAST), max(self.semi_minor, _LEAST)
        return np.asarray((along / a) ** 2 + (across / b) ** 2 <= 1.0)


def ellipse_scale(conf: float, dof: int | None = None) -> float:
    """By how much the ellipse of a confidence is larger than that of one sigma.

    Raises
    ------
    InputError
        If the confidence is not between 0 and 1.
    """
    if not 0.0 < conf < 1.0:
        raise InputError(f"{conf:g} is no confidence; give a number between 0 and 1", field="conf")
    if dof is None:
        return math.sqrt(-2.0 * math.log1p(-conf))
    # the F distribution with 2 degrees of freedom above has a closed form
    return math.sqrt(dof * ((1.0 - conf) ** (-2.0 / dof) - 1.0))


def axis_azimuth(right: float, ahead: float) -> float:
    """Azimuth of an axis, which has no sense, clockwise from ahead, in [0, pi); rad."""
    azimuth = math.atan2(right, ahead) % math.pi
    # a hair to the left is rounded to half a turn
    return azimuth if azimuth < math.pi else 0.0


def error_ellipse(
    covariance_en: ArrayLike, *, conf: float = STANDARD, dof: int | None = None
) -> Ellipse:
    """Ellipse of a covariance along grid east and grid north, (2, 2) m^2."""
    c = np.asarray(covariance_en, dtype=np.float64)[:2, :2]
    values, vectors = np.linalg.eigh((c + c.T) / 2)
    scale = ellipse_scale(conf, dof)
    minor, major = (scale * math.sqrt(max(float(v), 0.0)) for v in values)
    return Ellipse(
        semi_major=major,
        semi_minor=minor,
        azimuth=axis_azimuth(*vectors[:, 1]),
        conf=conf,
        dof=dof,
    )


def on_map(frame: MapFrame, p_enu: ArrayLike, covariances: ArrayLike) -> Array:
    """Covariances along grid east, grid north and up at the places, m^2.

    Parameters
    ----------
    p_enu : shape (n, 3), m
    covariances : shape (n, 3, 3), m^2 in enu

    Notes
    -----
    Lengths stay those on the ground: the map's scale, a few 1e-4 of a sigma, is left out.
    """
    R = grid_axes(frame, np.asarray(p_enu, float).reshape(-1, 3))
    C = np.asarray(covariances, float).reshape(-1, 3, 3)
    return np.asarray(R @ C @ np.swapaxes(R, 1, 2))


def grid_axes(frame: MapFrame, p_enu: Array) -> Array:
    """Rotations from enu to grid east, grid north and up at places; (n, 3) m -> (n, 3, 3)."""
    R_local_enu = local_axes(frame, p_enu)
    # true north on the map, as `MapFrame.convergence_at` has it of one place
    north = _STEP * R_local_enu[:, 1]
    way = frame.map_from_enu(p_enu + north) - frame.map_from_enu(p_enu - north)
    convergence = -np.arctan2(way[:, 0], way[:, 1])
    # grid north lies east of true north by the convergence
    R_grid_local = np.zeros((len(p_enu), 3, 3))
    R_grid_local[:, 0, 0] = R_grid_local[:, 1, 1] = np.cos(convergence)
    R_grid_local[:, 1, 0] = np.sin(convergence)
    R_grid_local[:, 0, 1], R_grid_local[:, 2, 2] = -np.sin(convergence), 1.0
    return np.asarray(R_grid_local @ R_local_enu)


def local_axes(frame: MapFrame, p_enu: Array) -> Array:
    """Rotations from enu to east, north, up at the places themselves; (n, 3) m -> (n, 3, 3)."""
    lat, lon, _ = np.moveaxis(frame.origin.geo_from_enu(p_enu), -1, 0)
    return np.asarray(np.swapaxes(R_ecef_from_enu(lat, lon), 1, 2) @ frame.origin.R_ecef_from_enu)


def ellipse_of(frame: MapFrame, point: MeasuredPoint, *, conf: float = STANDARD) -> Ellipse:
    """Ellipse of a measured point on the map."""
    (C,) = on_map(frame, point.p_enu[None], point.covariance[None])
    return error_ellipse(C, conf=conf)


def ellipses_of(
    frame: MapFrame, points: MeasuredPoints, *, conf: float = STANDARD
) -> list[Ellipse]:
    """Ellipses of measured points on the map."""
    return [error_ellipse(C, conf=conf) for C in on_map(frame, points.p_enu, points.each)]


def map_unit(frame: MapFrame) -> float:
    """Metres per unit of the map."""
    return metres_per_unit(frame.horizontal)
