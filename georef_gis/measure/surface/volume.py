"""Volumes between a surface and a base inside an area, with how far to trust them.

A volume is a weighted sum of heights of the surface: those of the cells inside, and those that the
base rests on, with the opposite sign. So its variance is that of the sum of their errors, which are
correlated: a shift of all heights cancels where the base rests on the same surface, and their tilt
where it is a plane through the rim.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from scipy.special import erfc

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.surface.base import Base, MakeBase
from georef_gis.measure.surface.field import HeightField, bounds_of
from georef_gis.measure.surface.integral import MOST_CELLS, Cells, cells_of, correlated_variance

# of the area; more without a height and no volume is told
MOST_MISSING = 0.02
# points inside an area of which a shape can be told
FEW_POINTS = 20
# cells on which a surface is held against those of its halves
_CELLS_OF_HALVES = 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """Volume between a surface and a base; m^2 and m^3, one sigma each.

    Parameters
    ----------
    above, below
        Where the surface stands above the base (to cut), and where below (to fill); both positive.
    net
        Above less below.
    parts
        What the sigma of the net volume is made of, m^3.
    mean_height
        Net volume over the area, m.
    level_cancels
        Whether a shift of the whole surface leaves the volume as it is.
    """

    area: float
    above: float
    sigma_above: float
    below: float
    sigma_below: float
    net: float
    sigma_net: float
    parts: dict[str, float]
    mean_height: float
    highest: float
    lowest: float
    base: str
    level_cancels: bool
    doubts: tuple[str, ...] = ()


def volume(field: HeightField, area: Any, make_base: MakeBase) -> Volume:
    """Volume of a surface over a base.

    Parameters
    ----------
    area
        Polygon, m in enu.
    make_base
        Base of a surface: one that rests on the surface is made anew for each of its halves.

    Raises
    ------
    GeometryError
        If the surface or the base has no height there.
    """
    base = make_base(field)
    found = _sides(field, area, base)
    parts = _Errors.of(field, area, base, make_base, found).parts()
    whole = {name: float(part[2]) for name, part in parts.items()}
    sigma = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    above, below, net = found.sums
    return Volume(
        area=float(found.cells.area.sum()), above=float(above), sigma_above=float(sigma[0]),
        below=float(below), sigma_below=float(sigma[1]), net=float(net),
        sigma_net=float(sigma[2]), parts=whole, mean_height=float(net / found.cells.area.sum()),
        highest=float(found.off.max()), lowest=float(found.off.min()), base=base.told,
        level_cancels=base.on_surface, doubts=_doubts(field, area, found.missing),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sides:
    """Cells of an area, how far the surface stands above the base there, m, what has no height."""

    cells: Cells
    off: Array
    missing: float

    @property
    def weights(self) -> Array:
        """Of the cells in the volumes above, below and net, m^2; (3, n)."""
        area = self.cells.area
        return np.stack([area * (self.off > 0), -area * (self.off < 0), area])

    @property
    def sums(self) -> Array:
        """Volumes above, below and net, m^3; (3,)."""
        return np.asarray(self.weights @ self.off)


def _sides(field: HeightField, area: Any, base: Base, most: int = MOST_CELLS) -> _Sides:
    cells, z, missing = _heights(field, area, most)
    off = z - base.z_at(cells.xy)
    if not np.all(np.isfinite(off)):
        raise GeometryError(f"the base ({base.told}) does not reach over the whole area")
    return _Sides(cells=cells, off=off, missing=missing)


def _heights(field: HeightField, area: Any, most: int) -> tuple[Cells, Array, float]:
    """Cells that have a height, these heights, and the share of the area that has none."""
    cells = cells_of(area, detail=field.detail, most=most)
    z = field.z_at(cells.xy)
    known = np.isfinite(z)
    missing = 1.0 - float(cells.area[known].sum() / cells.area.sum())
    if missing > MOST_MISSING:
        raise GeometryError(
            f"{field.name}: {100.0 * missing:.0f} % of the area has no height; draw the area where "
            "the surface is known"
        )
    scaled = cells.area[known] / (1.0 - missing)
    kept = Cells(xy=cells.xy[known], area=scaled, side=cells.side, extent=cells.extent)
    return kept, z[known], missing


def _doubts(field: HeightField, area: Any, missing: float) -> tuple[str, ...]:
    out = []
    points = area.area / field.spacing**2 if math.isfinite(field.spacing) else math.nan
    if points < FEW_POINTS:
        out.append(
            f"about {points:.0f} adjusted points lie in the area, {field.spacing:.1f} m apart: "
            "shapes finer than that are not in the surface"
        )
    if missing > 0.0:
        out.append(f"{100.0 * missing:.1f} % of the area has no height: taken like the rest")
    return tuple(out)


def _noise_bias(off: Array, sigma: Array, area: Array) -> float:
    """By how much errors of the height make both sides larger, m^3.

    The mean of |x + e| is more than |x|: sigma (phi(r) - r (1 - Phi(r))) with r = |x| / sigma.
    """
    r = np.abs(off) / np.maximum(sigma, 1e-9)
    tail = 0.5 * erfc(r / math.sqrt(2.0))
    more = np.exp(-0.5 * r**2) / math.sqrt(2.0 * math.pi) - r * tail
    return float(np.maximum(more * sigma, 0.0) @ area)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Errors:
    """One sigma of the volumes above, below and net by what it comes from."""

    field: HeightField
    area: Any
    base: Base
    found: _Sides
    # volumes of halves of its points less those of all, m^3; (h, 3)
    halves: Array

    @classmethod
    def of(
        cls, field: HeightField, area: Any, base: Base, make_base: MakeBase, found: _Sides
    ) -> _Errors:
        """With what the volumes of halves of the surface's points are off."""
        halves = field.resampled(bounds_of(shapely.get_coordinates(area)))
        off = []
        if halves:
            whole = _sides(field, area, base, _CELLS_OF_HALVES).sums
        for half in halves:
            try:
                off.append(_sides(half, area, make_base(half), _CELLS_OF_HALVES).sums - whole)
            except GeometryError:
                continue
        return cls(
            field=field, area=area, base=base, found=found, halves=np.array(off).reshape(-1, 3)
        )

    def parts(self) -> dict[str, Array]:
        """Source -> (3,), m^3."""
        out = self._of_halves() if len(self.halves) >= 4 else self._of_law()
        own = math.hypot(*(float(part[2]) for part in out.values()))
        model = self.base.model_sigma(self.field, self.area, own)
        out["scale"] = 3.0 * self.field.scale * np.abs(self.found.sums)
        supports = [self.base.support(self.found.cells, w) for w in self.found.weights]
        out["base"] = np.sqrt(model**2 + np.array([support.variance for support in supports]))
        out["block"] = np.array([
            self.field.common.sigma_of_sum(
                np.vstack([self.found.cells.xy, support.xy]),
                np.concatenate([weights, support.weights]),
            )
            for weights, support in zip(self.found.weights, supports, strict=True)
        ])  # fmt: skip
        return out

    def _of_halves(self) -> dict[str, Array]:
        """What the points' errors and the ground between them give.

        Notes
        -----
        Delete-half jackknife (Shao & Wu 1989): a volume of half of the points differs from that of
        all by as much as that one errs. The mean difference is what flat triangles cut off: half
        of the points miss twice as much.
        """
        sigma = self.field.local(self.found.cells.xy)
        between = np.hypot(self.halves.mean(axis=0), self._both_sides(sigma))
        return {"points": self.halves.std(axis=0, ddof=1), "between points": between}

    def _of_law(self) -> dict[str, Array]:
        """What the surface's errors give by the law that is known of them."""
        sigma = self.field.local(self.found.cells.xy)
        local = [math.sqrt(self._law(weights, sigma)) for weights in self.found.weights]
        return {"surface": np.hypot(local, self._both_sides(sigma))}

    def _both_sides(self, sigma: Array) -> Array:
        """By how much errors of heights make both sides larger; (3,), m^3.

        Parameters
        ----------
        sigma : shape (n,), m
            One sigma of the cells' heights against their surroundings; the base's is added.
        """
        both = np.hypot(sigma, self.base.local(self.found.cells.xy))
        more = _noise_bias(self.found.off, both, self.found.cells.area)
        return np.array([more, more, 0.0])

    def _law(self, weights: Array, sigma: Array) -> float:
        cells, support = self.found.cells, self.base.support(self.found.cells, weights)
        xy = np.vstack([cells.xy, support.xy])
        own = self.field.local(support.xy)
        weighted = np.concatenate([weights * sigma, support.weights * own])
        return max(
            correlated_variance(xy, weighted, length, cells.side)
            for length in self.field.alike(cells.extent)
        )
