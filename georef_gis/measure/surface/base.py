"""What volumes are measured against: the rim, its lowest place, a level, another surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import Origin
from georef_gis.measure.surface.field import HeightField
from georef_gis.measure.surface.integral import Cells, cells_of, correlated_variance, ring_of
from georef_gis.model.terrain import z_of_constant_height

# rounds, and robust standard deviations beyond which a place of the rim does not count
_ROUNDS, _CUT = 12, 4.685


# Makes the base of a surface over an area.
MakeBase = Callable[[HeightField], "Base"]
# stretches of a rim of which the lowest is taken
STRETCHES = 16
# times that errors of a rim are drawn
_DRAWS = 200
# places about an area where the plane through the rim is tried, in diameters from its middle
_RINGS, _WAYS = (1.15, 1.7), 8
# share of such a place and of its rim that must have a height
_KNOWN = 0.85


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Support:
    """What the base's part of a volume rests on.

    Parameters
    ----------
    xy : shape (k, 2), m
        Places of the surface itself.
    weights : shape (k,), m^2
        Of their heights in the volume.
    variance : m^6
        Of what else the base is uncertain by.
    """

    xy: Array
    weights: Array
    variance: float = 0.0


class Base(Protocol):
    """What a volume is measured against."""

    @property
    def told(self) -> str:
        """In words."""
        ...

    @property
    def on_surface(self) -> bool:
        """Whether it rests on the surface itself, and rises with it."""
        ...

    def model_sigma(self, field: HeightField, area: Any, own: float) -> float:
        """One sigma, m^3, by which the true base differs from this one over an area.

        `own`, m^3, is what the surface's own errors give the volume.
        """
        ...

    def z_at(self, xy: Array) -> Array:
        """Its up coordinate, m; (n, 2) -> (n,)."""
        ...

    def local(self, xy: Array) -> Array:
        """One sigma of its heights against their surroundings by its own errors; (n,), m."""
        ...

    def support(self, cells: Cells, weights: Array) -> Support:
        """What minus the weighted sum of its heights over cells, (n,) m^2, rests on."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RimPlane:
    """Plane through the surface's own heights along the rim, robust against what stands there.

    `solve` (3, k) makes its three terms from the k heights of `xy`; `spread`, m, is how the rim
    stands off it.
    """

    xy: Array
    solve: Array
    terms: Array
    middle: Array
    spread: float

    @classmethod
    def of(cls, field: HeightField, area: Any) -> RimPlane:
        """Plane of an area's rim.

        Raises
        ------
        GeometryError
            If too little of the rim has a height.
        """
        xy = ring_of(area, step=max(field.detail / 2.0, area.length / 2000.0))
        z = field.z_at(xy)
        known = np.isfinite(z)
        if known.sum() < 0.5 * len(known):
            raise GeometryError(
                f"{field.name}: most of the rim of the area has no height; draw the area where "
                "the surface is known"
            )
        xy, z = xy[known], z[known]
        middle = xy.mean(axis=0)
        X = np.column_stack([np.ones(len(xy)), xy - middle])
        solve = _robust(X, z)
        terms = solve @ z
        spread = _scale(z - X @ terms)
        return cls(xy=xy, solve=solve, terms=terms, middle=middle, spread=spread)

    @property
    def told(self) -> str:
        """In words."""
        slope = 100.0 * float(np.hypot(*self.terms[1:]))
        return f"plane through the rim, slope {slope:.1f} %, rim off it by {self.spread:.2f} m"

    @property
    def on_surface(self) -> bool:
        """It rises with the surface."""
        return True

    def model_sigma(self, field: HeightField, area: Any, own: float) -> float:
        """What the plane through the same rim misses of the ground about the area, m^3.

        The rim does not show whether the ground below is a hollow; the ground beside it does show
        how hollow it is there. Where there is none, the rim's own unevenness must do.
        """
        x0, y0, x1, y1 = shapely.bounds(area)
        across = math.hypot(x1 - x0, y1 - y0) / math.sqrt(2.0)
        missed = []
        for ring in _RINGS:
            for way in 2.0 * np.pi * np.arange(_WAYS) / _WAYS:
                step = ring * across * np.array([math.cos(way), math.sin(way)])
                one = _missed(field, shapely.transform(area, lambda xy, step=step: xy + step))
                if math.isfinite(one):
                    missed.append(abs(one))
        if len(missed) < _WAYS // 2:
            return self.spread * float(area.area)
        # the surface's own errors are in it too
        return math.sqrt(max((1.4826 * float(np.median(missed))) ** 2 - own**2, 0.0))

    def z_at(self, xy: Array) -> Array:
        """Its up coordinate, m; (n, 2) -> (n,)."""
        return np.asarray(self.terms[0] + (xy - self.middle) @ self.terms[1:])

    def local(self, xy: Array) -> Array:
        """It is smooth; (n, 2) -> (n,)."""
        return np.zeros(len(xy))

    def support(self, cells: Cells, weights: Array) -> Support:
        """Heights of the rim."""
        X = np.column_stack([np.ones(len(cells.xy)), cells.xy - self.middle])
        return Support(xy=self.xy, weights=-(weights @ X) @ self.solve)


def _missed(field: HeightField, area: Any) -> float:
    """Volume between bare ground and the plane through its rim, m^3; NaN where it is not known."""
    cells = cells_of(area, detail=math.sqrt(area.area) / 10.0)
    off = field.z_at(cells.xy)
    ring = np.isfinite(field.z_at(ring_of(area, step=math.sqrt(area.area) / 20.0)))
    known = np.isfinite(off)
    if min(float(known.mean()), float(ring.mean())) < _KNOWN:
        return math.nan
    off = (off - RimPlane.of(field, area).z_at(cells.xy))[known]
    return float(off @ cells.area[known] / cells.area[known].sum() * cells.area.sum())


def _scale(off: Array) -> float:
    return 1.4826 * float(np.median(np.abs(off - np.median(off)))) + 1e-4


def _robust(X: Array, z: Array) -> Array:
    """Linear map (3, k) from heights to the terms of a plane, by Tukey's biweight.

    Begins with a plane through the lower half: what stands on the rim stands above the ground.
    """
    weight = (z <= np.median(z)).astype(float) + 0.05
    solve: Array = np.zeros((3, len(z)))
    for _ in range(_ROUNDS):
        XW = X.T * weight
        solve = np.asarray(np.linalg.solve(XW @ X + 1e-9 * np.eye(3), XW), dtype=np.float64)
        off = z - X @ (solve @ z)
        r = off / (_CUT * _scale(off))
        weight = np.maximum(1.0 - r**2, 0.0) ** 2 + 1e-6
    return np.asarray(solve)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LowestLevel:
    """Level through the lowest stretch of the rim: one bad height alone does not make it.

    Parameters
    ----------
    xy : shape (k, 2), m
        Places of that stretch.
    """

    xy: Array
    z: float

    @classmethod
    def of(cls, field: HeightField, area: Any) -> LowestLevel:
        """Level of an area's rim.

        Raises
        ------
        GeometryError
            If the rim has no height.
        """
        xy = ring_of(area, step=max(field.detail / 2.0, area.length / 2000.0))
        z = field.z_at(xy)
        stretches = _stretches(len(z))
        means = z[stretches].mean(axis=1)
        if not np.any(np.isfinite(means)):
            raise GeometryError(
                f"{field.name}: the rim of the area has no height; draw the area where the "
                "surface is known"
            )
        lowest = stretches[int(np.nanargmin(means))]
        return cls(xy=xy[lowest], z=float(z[lowest].mean()))

    @property
    def told(self) -> str:
        """In words."""
        return f"level through the lowest {STRETCHES}th of the rim"

    @property
    def on_surface(self) -> bool:
        """It rises with the surface."""
        return True

    def model_sigma(self, field: HeightField, area: Any, own: float) -> float:
        """How much lower errors make the lowest of many stretches, m^3.

        Errors like those of the rim, drawn once more on top of it, lower it by as much again.
        """
        step = max(field.detail / 2.0, area.length / 2000.0)
        xy = ring_of(area, step=step)
        z, sigma = field.z_at(xy), field.local(xy)
        known = np.isfinite(z) & np.isfinite(sigma)
        z, sigma = z[known], sigma[known]
        stretches = _stretches(len(z))
        lag = np.minimum(np.arange(len(z)), len(z) - np.arange(len(z))) * step
        kernel = np.exp(-((lag / max(field.alike(step)[0], step)) ** 2))
        kernel /= np.sqrt(np.sum(kernel**2))
        draws = np.random.default_rng(0).standard_normal((_DRAWS, len(z)))
        errors = np.fft.irfft(np.fft.rfft(draws) * np.fft.rfft(kernel), len(z)) * sigma
        lowest = (z + errors)[:, stretches].mean(axis=2).min(axis=1)
        lower = float(z[stretches].mean(axis=1).min() - lowest.mean())
        return max(lower, 0.0) * float(area.area)

    def z_at(self, xy: Array) -> Array:
        """Its up coordinate, m; (n, 2) -> (n,)."""
        return np.full(len(xy), self.z)

    def local(self, xy: Array) -> Array:
        """It is smooth; (n, 2) -> (n,)."""
        return np.zeros(len(xy))

    def support(self, cells: Cells, weights: Array) -> Support:
        """Heights of that stretch."""
        return Support(xy=self.xy, weights=np.full(len(self.xy), -weights.sum() / len(self.xy)))


def _stretches(count: int) -> NDArray[np.intp]:
    """Places of every stretch of a rim of so many; (count, k)."""
    length = max(1, count // STRETCHES)
    return np.asarray((np.arange(count)[:, None] + np.arange(length)) % count)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenHeight:
    """A level of a stated height above the ellipsoid, m, with its one sigma."""

    origin: Origin
    height_ellipsoidal: float
    sigma: float = 0.0

    @property
    def told(self) -> str:
        """In words."""
        return f"level {self.height_ellipsoidal:.2f} m above the ellipsoid"

    @property
    def on_surface(self) -> bool:
        """It stays where it is."""
        return False

    def model_sigma(self, field: HeightField, area: Any, own: float) -> float:
        """It is what it is."""
        return 0.0

    def z_at(self, xy: Array) -> Array:
        """Its up coordinate, m; (n, 2) -> (n,)."""
        return z_of_constant_height(self.origin, self.height_ellipsoidal, xy)

    def local(self, xy: Array) -> Array:
        """It is smooth; (n, 2) -> (n,)."""
        return np.zeros(len(xy))

    def support(self, cells: Cells, weights: Array) -> Support:
        """Nothing of the surface."""
        variance = (self.sigma * float(weights.sum())) ** 2
        return Support(xy=np.zeros((0, 2)), weights=np.zeros(0), variance=variance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherSurface:
    """Another surface, whose errors are its own."""

    field: HeightField

    @property
    def told(self) -> str:
        """In words."""
        return self.field.name

    @property
    def on_surface(self) -> bool:
        """It stays where it is."""
        return False

    def model_sigma(self, field: HeightField, area: Any, own: float) -> float:
        """It is what it is."""
        return 0.0

    def z_at(self, xy: Array) -> Array:
        """Its up coordinate, m; (n, 2) -> (n,), NaN outside."""
        return self.field.z_at(xy)

    def local(self, xy: Array) -> Array:
        """One sigma of its heights against their surroundings; (n, 2) -> (n,), m."""
        return self.field.local(xy)

    def support(self, cells: Cells, weights: Array) -> Support:
        """Its own errors."""
        weighted = weights * self.field.local(cells.xy)
        local = max(
            correlated_variance(cells.xy, weighted, length, cells.side)
            for length in self.field.alike(cells.extent)
        )
        common = self.field.common.sigma_of_sum(cells.xy, weights)
        none = np.zeros((0, 2))
        return Support(xy=none, weights=np.zeros(0), variance=local + common**2)
