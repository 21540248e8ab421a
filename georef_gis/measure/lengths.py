"""Distances, heights, bearings and areas of measured points, by the covariance of all together.

Two points of one photo share the error of its pose, points of one flight what its poses share: a
distance is better than the places, and how much better is said.

Notes
-----
A ground distance is that between the verticals of both ends at their mean height, a grid distance
that on the map. Sigmas by first-order propagation through the joint covariance (Mikhail and Gracie,
Analysis and Adjustment of Survey Measurements (1981), chapter 4); the area by the surveyor's
formula.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, R_ecef_from_enu
from georef_gis.geodesy import MapFrame, metres_per_unit
from georef_gis.measure.ellipses import grid_axes
from georef_gis.measure.measured import MeasuredPoints, photos_in

# sigmas below which a length is not told from none
_TOLD_APART = 3.0
# by how much better than the places' own sigmas a length must be to be worth a word
_MUCH_BETTER = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A value, m, m^2 or rad, and one sigma of it.

    `sigma_apart` is what sigma would be if the points shared no error.
    """

    value: float
    sigma: float
    sigma_apart: float

    @property
    def better(self) -> float:
        """How many times better it is than the places alone let expect."""
        return self.sigma_apart / self.sigma if self.sigma > 0.0 else math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """From one point to the next.

    Parameters
    ----------
    slope
        Distance in space, m.
    ground
        Horizontal distance at the mean height of both, m.
    grid
        Distance on the map, m.
    height_difference
        Of the heights above the ellipsoid, second less first, m.
    bearing_true, bearing_grid
        At the first point, clockwise from true north and from the map's, in [0, 2 pi), rad.
    """

    names: tuple[str, str]
    slope: Quantity
    ground: Quantity
    grid: Quantity
    height_difference: Quantity
    bearing_true: Quantity
    bearing_grid: Quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Lengths:
    """A line, or the ring of an area.

    Parameters
    ----------
    legs
        From point to point, with the one back to the first of a ring.
    slope, ground, grid
        Of all legs together, m: the perimeter of a ring.
    area_ground, area_grid
        Of a ring, m^2, on the level at its mean height and on the map; else None.
    scale
        Grid over ground distance.
    doubts
        One line each.
    """

    names: tuple[str, ...]
    legs: tuple[Leg, ...]
    slope: Quantity
    ground: Quantity
    grid: Quantity
    area_ground: Quantity | None
    area_grid: Quantity | None
    scale: float
    doubts: tuple[str, ...] = ()

    @property
    def closed(self) -> bool:
        """Whether it is a ring."""
        return self.area_ground is not None

    def told(self) -> list[str]:
        """Sentences for people."""
        what = "perimeter" if self.closed else "length"
        out = [
            f"{what} {_with_sigma(self.ground, 'm')} on the ground, "
            f"{self.grid.value:.3f} m on the map (scale {self.scale:.6f})"
        ]
        if self.area_ground is not None and self.area_grid is not None:
            out.append(
                f"area {_with_sigma(self.area_ground, 'm2')} on the ground, "
                f"{self.area_grid.value:.2f} m2 on the map"
            )
        better = self.ground.better
        if better >= _MUCH_BETTER:
            out.append(
                f"{better:.3g} times better than the places, by which it would be good to "
                f"{self.ground.sigma_apart:.3g} m: the points share most of their errors"
            )
        return [*out, *self.doubts]


def measure_lines(points: MeasuredPoints, *, closed: bool = False) -> Lengths:
    """Lengths along measured points in their order.

    Parameters
    ----------
    closed
        Back to the first point: a ring, with its area.

    Raises
    ------
    GeometryError
        If there are too few points, or two neighbours are one place.
    """
    n, least = len(points), 3 if closed else 2
    if n < least:
        what = "an area needs three points" if closed else "a distance needs two points"
        raise GeometryError(f"{what} or more; there are {n}: mark another")
    spread = _Spread(points)
    pairs = [(i, (i + 1) % n) for i in range(n if closed else n - 1)]
    found = [_leg(points, spread, i, j) for i, j in pairs]
    legs, rows = [leg for leg, _ in found], [row for _, row in found]
    total = np.sum(rows, axis=0)
    slope, ground, grid = (
        spread.quantity(sum(getattr(leg, name).value for leg in legs), total[k])
        for k, name in enumerate(("slope", "ground", "grid"))
    )
    areas = _areas(points, spread) if closed else (None, None)
    return Lengths(
        names=points.names,
        legs=tuple(legs),
        slope=slope,
        ground=ground,
        grid=grid,
        area_ground=areas[0],
        area_grid=areas[1],
        scale=grid.value / ground.value if ground.value else math.nan,
        doubts=tuple(_doubts(points, legs, closed)),
    )


def distance(points: MeasuredPoints, i: int = 0, j: int = 1) -> Leg:
    """From one measured point to another."""
    return measure_lines(points.subset([i, j])).legs[0]


class _Spread:
    """Covariance of all points, and of all that is made of them."""

    def __init__(self, points: MeasuredPoints) -> None:
        self.joint = points.covariance()
        n = len(points)
        self.apart = np.zeros((3 * n, 3 * n))
        for i in range(n):
            at = slice(3 * i, 3 * i + 3)
            self.apart[at, at] = self.joint[at, at]

    def quantity(self, value: float, gradient: Array) -> Quantity:
        """Value with its sigmas, by its derivatives (3 n,)."""
        together, apart = (float(gradient @ C @ gradient) for C in (self.joint, self.apart))
        return Quantity(
            value=float(value),
            sigma=math.sqrt(max(together, 0.0)),
            sigma_apart=math.sqrt(max(apart, 0.0)),
        )


def _leg(points: MeasuredPoints, spread: _Spread, i: int, j: int) -> tuple[Leg, Array]:
    """Leg from i to j, and the derivatives of its three lengths (3, 3 n)."""
    frame, pair = points.scene.frame, points.p_enu[[i, j]]
    d = pair[1] - pair[0]
    if float(np.linalg.norm(d)) < 1e-6:
        names = f"{points.names[i]} and {points.names[j]}"
        raise GeometryError(f"{names} are one place: there is no length between them")
    ups = _local_axes(frame, pair)
    up = ups[:, 2].sum(axis=0)
    level = d - (d @ up) * up / (up @ up)
    way = _grid_way(frame, pair)
    M = _map_jacobians(frame, pair)
    heights = frame.origin.geo_from_enu(pair)[:, 2]
    true = ups[0] @ d
    rows = {
        "slope": _row(points, i, j, -_unit(d), _unit(d)),
        "ground": _row(points, i, j, -_unit(level), _unit(level)),
        "grid": _row(points, i, j, -_unit(way) @ M[0], _unit(way) @ M[1]),
        "height_difference": _row(points, i, j, -ups[0, 2], ups[1, 2]),
        "bearing_true": _row(
            points, i, j, -_turning(true) @ ups[0, :2], _turning(true) @ ups[0, :2]
        ),
        "bearing_grid": _row(points, i, j, -_turning(way) @ M[0], _turning(way) @ M[1]),
    }
    values = {
        "slope": float(np.linalg.norm(d)),
        "ground": float(np.linalg.norm(level)),
        "grid": float(np.linalg.norm(way)),
        "height_difference": float(heights[1] - heights[0]),
        "bearing_true": _azimuth(true),
        "bearing_grid": _azimuth(way),
    }
    leg = Leg(
        names=(points.names[i], points.names[j]),
        **{name: spread.quantity(values[name], rows[name]) for name in rows},
    )
    return leg, np.stack([rows[name] for name in ("slope", "ground", "grid")])


def _row(points: MeasuredPoints, i: int, j: int, first: Array, second: Array) -> Array:
    """Derivatives by all points of what depends on two; (3,) each -> (3 n,)."""
    out = np.zeros(3 * len(points))
    out[3 * i : 3 * i + 3] += first
    out[3 * j : 3 * j + 3] += second
    return out


def _unit(v: Array) -> Array:
    """Direction; zero of a vector without length, which has none."""
    length = float(np.linalg.norm(v))
    return np.asarray(v / length if length > 1e-9 else np.zeros_like(v))


def _azimuth(d: Array) -> float:
    """Azimuth of (east, north, ...) in [0, 2 pi), rad."""
    azimuth = math.atan2(d[0], d[1]) % (2.0 * math.pi)
    # a hair west of north is rounded to a full turn
    return azimuth if azimuth < 2.0 * math.pi else 0.0


def _turning(d: Array) -> Array:
    """Derivative of the azimuth of (east, north, ...) by east and north; shape (2,), rad/m."""
    square = float(d[0] ** 2 + d[1] ** 2)
    return np.array([d[1], -d[0]]) / max(square, 1e-18)


def _local_axes(frame: MapFrame, p_enu: Array) -> Array:
    """Rotations from enu to east, north, up at the places themselves; (n, 3) -> (n, 3, 3)."""
    lat, lon, _ = np.moveaxis(frame.origin.geo_from_enu(p_enu), -1, 0)
    return np.asarray(np.swapaxes(R_ecef_from_enu(lat, lon), 1, 2) @ frame.origin.R_ecef_from_enu)


def _grid_way(frame: MapFrame, pair: Array) -> Array:
    """From the first of two places to the second on the map; shape (2,), m."""
    p_map = frame.map_from_enu(pair)[:, :2] * metres_per_unit(frame.horizontal)
    return np.asarray(p_map[1] - p_map[0])


def _map_jacobians(frame: MapFrame, p_enu: Array) -> Array:
    """Metres on the map by metres of enu; (n, 3) -> (n, 2, 3)."""
    scale = np.array([frame.scale_at(p) for p in p_enu])
    return np.asarray(scale[:, None, None] * grid_axes(frame, p_enu)[:, :2])


# -- areas ------------------------------------------------------------------------------------


def _areas(points: MeasuredPoints, spread: _Spread) -> tuple[Quantity, Quantity]:
    """Area on the level at the points' mean height, and on the map."""
    frame, p = points.scene.frame, points.p_enu
    middle = p.mean(axis=0)
    axes = _local_axes(frame, middle[None])[0, :2]
    level = (p - middle) @ axes.T
    unit = metres_per_unit(frame.horizontal)
    p_map = frame.map_from_enu(p)[:, :2]
    on_map = (p_map - p_map.mean(axis=0)) * unit
    M = _map_jacobians(frame, p)
    out = []
    for xy, J in ((level, np.broadcast_to(axes, (len(p), 2, 3))), (on_map, M)):
        area, by_xy = _shoelace(xy)
        out.append(spread.quantity(abs(area), np.einsum("ni,nij->nj", by_xy, J).ravel()))
    return out[0], out[1]


def _shoelace(xy: Array) -> tuple[float, Array]:
    """Signed area of a ring (n, 2), and its derivatives by the corners (n, 2)."""
    after, before = np.roll(xy, -1, axis=0), np.roll(xy, 1, axis=0)
    area = 0.5 * float(np.sum(xy[:, 0] * after[:, 1] - after[:, 0] * xy[:, 1]))
    by_x, by_y = 0.5 * (after[:, 1] - before[:, 1]), 0.5 * (before[:, 0] - after[:, 0])
    return area, np.stack([by_x, by_y], axis=1)


def _crossing(xy: Array) -> tuple[int, int] | None:
    """Two sides of a ring that cross, by the numbers of their first corners."""
    a, b = xy, np.roll(xy, -1, axis=0)
    n = len(xy)
    for i in range(n):
        for j in range(i + 2, n if i else n - 1):
            if _side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) < 0.0 and (
                _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) < 0.0
            ):
                return i, j
    return None


def _side(a: Array, b: Array, p: Array) -> float:
    return float((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]))


# -- words ------------------------------------------------------------------------------------


def _doubts(points: MeasuredPoints, legs: Sequence[Leg], closed: bool) -> list[str]:
    out = []
    for leg in legs:
        if leg.slope.value < _TOLD_APART * leg.slope.sigma:
            out.append(
                f"{leg.names[0]} to {leg.names[1]}: {leg.slope.value:.3g} m with one sigma of "
                f"{leg.slope.sigma:.3g} m is not told from no distance at all"
            )
    crossing = _crossing(points.p_enu[:, :2]) if closed else None
    if crossing is not None:
        sides = [f"{legs[k].names[0]}-{legs[k].names[1]}" for k in crossing]
        out.append(f"sides {sides[0]} and {sides[1]} cross: the area is that of no ring; reorder")
    scene = points.scene
    several = len(photos_in(points.shared, len(scene.photos))) > 1
    if several and not scene.errors.known_together:
        out.append(
            "poses are taken as independent: distances between photos are less sure than said"
        )
    return out


def _with_sigma(q: Quantity, unit: str) -> str:
    digits = max(0, 2 - math.floor(math.log10(q.sigma))) if q.sigma > 0.0 else 3
    digits = min(max(digits - 1, 1), 4)
    return f"{q.value:.{digits}f} +- {q.sigma:.{digits}f} {unit}"
