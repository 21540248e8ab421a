"""Surfaces of heights with what is known of their errors: for profiles, volumes and rasters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.measure.surface.common_errors import CommonErrors
from georef_gis.model.ground_errors import FLAT_LENGTH, GroundErrors
from georef_gis.model.mesh import PlanePolynomial
from georef_gis.model.terrain import DemTerrain, Terrain
from georef_gis.model.tin import TinTerrain


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sampled:
    """Heights above the ellipsoid, and one sigma against their surroundings, m; NaN outside."""

    height: Array
    local: Array


# coordinates from which on fitting a polynomial pays
_FEW = 1000


class HeightField(Protocol):
    """Heights of a surface, and how they err."""

    @property
    def name(self) -> str:
        """What the surface is, in words."""
        ...

    @property
    def detail(self) -> float:
        """Distance over which it is smooth, m."""
        ...

    @property
    def spacing(self) -> float:
        """Mean distance of the points that it was made of, m; NaN if of none."""
        ...

    @property
    def common(self) -> CommonErrors:
        """What all heights above the datum err by together."""
        ...

    @property
    def scale(self) -> float:
        """One sigma of the scale of the block, as a share."""
        ...

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu, m; (..., 2) -> (...), NaN outside."""
        ...

    def on_map(self, frame: MapFrame, xy_map: Array) -> Sampled:
        """Heights and local sigmas at places of a map; (..., 2) CRS units -> (...)."""
        ...

    def local(self, xy_enu: ArrayLike) -> Array:
        """One sigma of heights against their surroundings, m; (..., 2) -> (...)."""
        ...

    def alike(self, extent: float) -> Sequence[float]:
        """Lengths, m, over which local errors may be alike at a site of an extent, m."""
        ...

    def resampled(self, bounds: tuple[float, float, float, float]) -> Sequence[Self]:
        """The surface within bounds, m, from random halves of its points; none if it has none."""
        ...


def sigma_at(field: HeightField, xy_enu: ArrayLike) -> Array:
    """One sigma of heights above the datum, m; (..., 2) -> (...)."""
    return np.asarray(np.hypot(field.local(xy_enu), field.common.sigma_at(xy_enu)))


def bounds_of(xy: Array) -> tuple[float, float, float, float]:
    """Left, bottom, right and top of places; (..., 2)."""
    flat = xy.reshape(-1, 2)
    (x0, y0), (x1, y1) = flat.min(axis=0), flat.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundField:
    """A ground: a DEM, or the TIN or plane that a project's photos are laid on.

    Parameters
    ----------
    errors
        Law of its local errors.
    """

    terrain: Terrain
    errors: GroundErrors
    name: str
    common: CommonErrors
    scale: float = 0.0
    spacing: float = math.nan

    @classmethod
    def of(
        cls, terrain: Terrain, name: str, *, level: float = 0.0, common: CommonErrors | None = None
    ) -> GroundField:
        """Field of a terrain by what it says of itself.

        Parameters
        ----------
        level : m
            One sigma of a shift of the surface together with the photos.
        common
            Of its heights but for that, where more is known than a shift.
        """
        errors = GroundErrors.of(terrain)
        known = common or CommonErrors.level(errors.shared)
        return cls(terrain=terrain, errors=errors, name=name, common=known.raised(level))

    @property
    def detail(self) -> float:
        """Distance over which it is smooth, m; of a plane that of its errors."""
        own = self.terrain.detail
        return own if math.isfinite(own) else FLAT_LENGTH

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu, m; (..., 2) -> (...), NaN outside."""
        return self.terrain.z_at(xy_enu)

    def on_map(self, frame: MapFrame, xy_map: Array) -> Sampled:
        """Heights and local sigmas at places of a map; (..., 2) CRS units -> (...)."""
        if not isinstance(self.terrain, DemTerrain):
            height = self.terrain.height_on_map(frame, xy_map)
            return Sampled(height=height, local=np.full(height.shape, self._usual))
        at = _positions(frame, self.terrain, xy_map)
        height = self.terrain.height_at(at)
        if not isinstance(self.terrain, TinTerrain):
            return Sampled(height=height, local=np.where(np.isfinite(height), self._usual, np.nan))
        sigmas = self.terrain.sigmas
        scale = np.array(sigmas.shape[::-1]) / np.array(self.terrain.heights.shape[::-1])
        # heights of a ground whose heights are the sigmas
        local = replace(self.terrain, heights=sigmas).height_at((at + 0.5) * scale - 0.5)
        return Sampled(height=height, local=local)

    @property
    def _usual(self) -> float:
        """One sigma of heights against their surroundings where all have the same, m."""
        return math.sqrt(max(self.terrain.sigma**2 - self.errors.shared**2, 0.0))

    def local(self, xy_enu: ArrayLike) -> Array:
        """One sigma of heights against their surroundings, m; (..., 2) -> (...)."""
        xy = np.asarray(xy_enu, dtype=np.float64)
        return self.errors.local(xy.reshape(-1, 2)).reshape(xy.shape[:-1])

    def alike(self, extent: float) -> Sequence[float]:
        """Lengths, m, over which local errors may be alike: any from a few cells to the site."""
        own = self.errors.length
        if extent <= own:
            return [own]
        steps = max(2, math.ceil(math.log2(extent / own)) + 1)
        return [float(length) for length in np.geomspace(own, extent, steps)]

    def resampled(self, bounds: tuple[float, float, float, float]) -> Sequence[Self]:
        """None: it has no points of its own."""
        return ()


def _positions(frame: MapFrame, dem: DemTerrain, xy_map: Array) -> Array:
    """(col, row) in a DEM of places of a map; (..., 2). By a polynomial where it is as good."""
    if not dem.lies_on(frame) and xy_map.size > _FEW:
        to_dem = PlanePolynomial.between(frame, dem, bounds_of(xy_map))
        if to_dem is not None:
            return dem.position(to_dem(xy_map))
    return dem.position_on_map(frame, xy_map)
