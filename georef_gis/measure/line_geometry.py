"""Legs and rings of measured points: their lengths, bearings and areas, and the derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.measure.ellipses import local_axes
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.model.photo_stack import Ints

# quantities of a leg, in order
OF_LEG = ("slope", "ground", "grid", "height_difference", "bearing_true", "bearing_grid")
# m; places nearer to each other are one
NO_LENGTH = 1e-6
# m; half the base over which the map's axes are taken
_STEP = 10.0
# sides of a ring that are looked at together
_SIDES = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Legs:
    """L legs between n points: what is told of them, and how it depends on the points.

    Parameters
    ----------
    first, second : shape (L,)
        Points from which and to which they run.
    n
        Number of points.
    values : shape (L, 6)
        Of `OF_LEG`, m and rad.
    by_first, by_second : shape (L, 6, 3)
        Their derivatives by the ends, in enu.
    by_enu : shape (n, 2, 3)
        Metres on the map by metres of enu, at the points.
    """

    first: Ints
    second: Ints
    n: int
    values: Array
    by_first: Array
    by_second: Array
    by_enu: Array

    @classmethod
    def of(cls, points: MeasuredPoints, first: Ints, second: Ints) -> Legs:
        """Legs of points.

        Raises
        ------
        GeometryError
            If both ends of one are one place.
        """
        frame, p = points.scene.frame, points.p_enu
        d = p[second] - p[first]
        for k in np.flatnonzero(np.linalg.norm(d, axis=1) < NO_LENGTH)[:1]:
            names = f"{points.names[first[k]]} and {points.names[second[k]]}"
            raise GeometryError(f"{names} are one place: there is no length between them")
        axes = local_axes(frame, p)
        M = _map_jacobians(frame, p, axes)
        up = axes[first, 2] + axes[second, 2]
        level = d - up * (np.sum(d * up, axis=1) / np.sum(up * up, axis=1))[:, None]
        p_map = frame.map_from_enu(p)[:, :2] * metres_per_unit(frame.horizontal)
        way = p_map[second] - p_map[first]
        true = np.einsum("lij,lj->li", axes[first], d)
        heights = frame.origin.geo_from_enu(p)[:, 2]
        along, turning, turning_map = (
            x[:, None] for x in (_unit(way), _turning(true), _turning(way))
        )

        def by_end(at: Ints) -> Array:
            of_legs = [
                _unit(d), _unit(level), (along @ M[at])[:, 0], axes[at, 2],
                (turning @ axes[first, :2])[:, 0], (turning_map @ M[at])[:, 0],
            ]  # fmt: skip
            return np.stack(of_legs, axis=1)

        lengths = [np.linalg.norm(x, axis=1) for x in (d, level, way)]
        height = heights[second] - heights[first]
        return cls(
            first=first, second=second, n=len(p), by_enu=M,
            values=np.stack([*lengths, height, _azimuth(true), _azimuth(way)], axis=1),
            by_first=-by_end(first), by_second=by_end(second),
        )  # fmt: skip

    def rows(self) -> csr_array:
        """Derivatives of all values by all points, leg by leg; (6 L, 3 n)."""
        parts = ((self.first, self.by_first), (self.second, self.by_second))
        columns = [np.broadcast_to(3 * at[:, None, None] + np.arange(3), J.shape)
                   for at, J in parts]  # fmt: skip
        count = self.values.size
        row = np.arange(count).reshape(*self.values.shape, 1) + np.zeros((1, 1, 3), dtype=np.int64)
        values = np.concatenate([J.ravel() for _, J in parts])
        at = (np.tile(row.ravel(), 2), np.concatenate([c.ravel() for c in columns]))
        return csr_array((values, at), shape=(count, 3 * self.n))

    @property
    def scale(self) -> float:
        """Metres on the map by metres at the first point, along grid east."""
        return float(np.linalg.norm(self.by_enu[0, 0]))


def _unit(v: Array) -> Array:
    """Directions of (L, k); zero of a vector without length, which has none."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1e-9, v / np.maximum(length, 1e-9), 0.0))


def _azimuth(d: Array) -> Array:
    """Azimuths of (L, k), east, north, ..., in [0, 2 pi), rad."""
    azimuth = np.arctan2(d[:, 0], d[:, 1]) % (2.0 * math.pi)
    # a hair west of north is rounded to a full turn
    return np.where(azimuth < 2.0 * math.pi, azimuth, 0.0)


def _turning(d: Array) -> Array:
    """Derivatives of azimuths of (L, k), east, north, ..., by east and north; (L, 2), rad/m."""
    square = np.maximum(d[:, 0] ** 2 + d[:, 1] ** 2, 1e-18)
    return np.asarray(np.stack([d[:, 1], -d[:, 0]], axis=1) / square[:, None])


def _map_jacobians(frame: MapFrame, p_enu: Array, axes: Array) -> Array:
    """Metres on the map by metres of enu; (n, 3) and local axes (n, 3, 3) -> (n, 2, 3)."""
    level = axes[:, :2]
    ahead, behind = (
        frame.map_from_enu(p_enu[:, None] + step * level)[..., :2] for step in (_STEP, -_STEP)
    )
    by_level = (ahead - behind) * (metres_per_unit(frame.horizontal) / (2.0 * _STEP))
    return np.asarray(np.swapaxes(by_level, 1, 2) @ level)


# -- areas ------------------------------------------------------------------------------------


def ring_areas(points: MeasuredPoints, by_enu: Array) -> tuple[Array, csr_array]:
    """Areas on the level at the points' mean height and on the map, by `Legs.by_enu`.

    Returns
    -------
    values : shape (2,), m^2
    rows : shape (2, 3 n)
        Their derivatives by all points.
    """
    frame, p = points.scene.frame, points.p_enu
    middle = p.mean(axis=0)
    axes = local_axes(frame, middle[None])[0, :2]
    level = (p - middle) @ axes.T
    p_map = frame.map_from_enu(p)[:, :2]
    on_map = (p_map - p_map.mean(axis=0)) * metres_per_unit(frame.horizontal)
    areas, rows = [], []
    for xy, J in ((level, np.broadcast_to(axes, (len(p), 2, 3))), (on_map, by_enu)):
        area, by_xy = _shoelace(xy)
        areas.append(abs(area))
        rows.append(np.einsum("ni,nij->nj", by_xy, J).ravel())
    return np.array(areas), csr_array(np.stack(rows))


def _shoelace(xy: Array) -> tuple[float, Array]:
    """Signed area of a ring (n, 2), and its derivatives by the corners (n, 2)."""
    after, before = np.roll(xy, -1, axis=0), np.roll(xy, 1, axis=0)
    area = 0.5 * float(np.sum(xy[:, 0] * after[:, 1] - after[:, 0] * xy[:, 1]))
    by_x, by_y = 0.5 * (after[:, 1] - before[:, 1]), 0.5 * (before[:, 0] - after[:, 0])
    return area, np.stack([by_x, by_y], axis=1)


def crossing_sides(xy: Array) -> tuple[int, int] | None:
    """First two sides of a ring that cross, by the numbers of their first corners."""
    import shapely

    sides = shapely.linestrings(np.stack([xy, np.roll(xy, -1, axis=0)], axis=1))
    tree = shapely.STRtree(sides)
    for start in range(0, len(sides), _SIDES):
        one, other = tree.query(sides[start : start + _SIDES], predicate="crosses")
        pairs = np.stack([one + start, other], axis=1)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        if len(pairs):
            first, second = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))[0]]
            return int(first), int(second)
    return None
