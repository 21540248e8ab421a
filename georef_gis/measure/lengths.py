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
from scipy.sparse import csr_array

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.line_geometry import (
    NO_LENGTH,
    OF_LEG,
    Legs,
    crossing_sides,
    ring_areas,
)
from georef_gis.measure.measured import MeasuredPoints, photos_in
from georef_gis.measure.spread import sigmas_of

# rad; one sigma of a direction of which nothing is known
_ANY_BEARING = math.pi / math.sqrt(3.0)
# sigmas below which a length is not told from none
_TOLD_APART = 3.0
# by how much longer along the slope a length must be to be worth a word
_SLOPING = 1.01
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
        """How many times better it is than the places alone let expect; 1 of what is known."""
        if self.sigma > 0.0:
            return self.sigma_apart / self.sigma
        return math.inf if self.sigma_apart > 0.0 else 1.0


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
        if self.slope.value > _SLOPING * self.ground.value:
            out.append(f"{what} {_with_sigma(self.slope, 'm')} along the slope")
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
    first = np.arange(n if closed else n - 1)
    found = Legs.of(points, first, (first + 1) % n)
    rows = found.rows()
    quantities = _quantities(points, found.values.ravel(), rows)
    legs = tuple(_leg(points, found, quantities, k) for k in range(len(first)))
    totals = csr_array(np.stack([rows[k :: len(OF_LEG)].sum(axis=0) for k in range(3)]))
    slope, ground, grid = _quantities(points, found.values.sum(axis=0)[:3], totals)
    areas: list[Quantity | None] = [None, None]
    if closed:
        areas = [*_quantities(points, *ring_areas(points, found.by_enu))]
    return Lengths(
        names=points.names,
        legs=legs,
        slope=slope,
        ground=ground,
        grid=grid,
        area_ground=areas[0],
        area_grid=areas[1],
        scale=grid.value / ground.value if ground.value > NO_LENGTH else found.scale,
        doubts=tuple(_doubts(points, legs, areas[0])),
    )


def distance(points: MeasuredPoints, i: int = 0, j: int = 1) -> Leg:
    """From one measured point to another."""
    return measure_lines(points.subset([i, j])).legs[0]


def _leg(points: MeasuredPoints, legs: Legs, quantities: Sequence[Quantity], k: int) -> Leg:
    """Leg number k, by the quantities of all."""
    own = quantities[len(OF_LEG) * k : len(OF_LEG) * (k + 1)]
    found = dict(zip(OF_LEG, own, strict=True))
    for name in ("bearing_true", "bearing_grid"):
        found[name] = _as_bearing(found[name])
    return Leg(names=(points.names[legs.first[k]], points.names[legs.second[k]]), **found)


def _quantities(points: MeasuredPoints, values: Array, rows: csr_array) -> list[Quantity]:
    """Values (q,) with their sigmas, by their derivatives (q, 3 n)."""
    together, apart = sigmas_of(points, rows)
    return [
        Quantity(value=float(v), sigma=float(s), sigma_apart=float(a))
        for v, s, a in zip(values, together, apart, strict=True)
    ]


def _as_bearing(q: Quantity) -> Quantity:
    """Bearing that is no less sure than one of which nothing is known."""
    return Quantity(
        value=q.value,
        sigma=min(q.sigma, _ANY_BEARING),
        sigma_apart=min(q.sigma_apart, _ANY_BEARING),
    )


# -- words ------------------------------------------------------------------------------------


def _doubts(points: MeasuredPoints, legs: Sequence[Leg], area: Quantity | None) -> list[str]:
    out = []
    for leg in legs:
        if leg.slope.value < _TOLD_APART * leg.slope.sigma:
            out.append(
                f"{leg.names[0]} to {leg.names[1]}: {leg.slope.value:.3g} m with one sigma of "
                f"{leg.slope.sigma:.3g} m is not told from no distance at all"
            )
    if area is not None and area.value < _TOLD_APART * area.sigma:
        out.append(
            f"area: {area.value:.3g} m2 with one sigma of {area.sigma:.3g} m2 is not told from none"
        )
    crossing = None if area is None else crossing_sides(points.p_enu[:, :2])
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
