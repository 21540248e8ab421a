"""Surfaces of heights with what is known of their errors: for profiles, volumes and rasters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.ground_errors import FLAT_LENGTH, GroundErrors
from georef_gis.model.terrain import Terrain


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
    def common(self) -> float:
        """One sigma of what all heights above the datum share, m."""
        ...

    @property
    def scale(self) -> float:
        """One sigma of the scale of the block, as a share."""
        ...

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu, m; (..., 2) -> (...), NaN outside."""
        ...

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Height above the ellipsoid, m, at places of a map; (..., 2) -> (...), NaN outside."""
        ...

    def local(self, xy_enu: ArrayLike) -> Array:
        """One sigma of heights against their surroundings, m; (..., 2) -> (...)."""
        ...

    def alike(self, extent: float) -> Sequence[float]:
        """Lengths, m, over which local errors may be alike at a site of an extent, m."""
        ...

    def resampled(self) -> Sequence[Self]:
        """The same surface from random halves of its points; none where it has no points."""
        ...


def sigma_at(field: HeightField, xy_enu: ArrayLike) -> Array:
    """One sigma of heights above the datum, m; (..., 2) -> (...)."""
    return np.asarray(np.hypot(field.local(xy_enu), field.common))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundField:
    """A ground: a DEM, or the TIN or plane that a project's photos are laid on.

    Parameters
    ----------
    level : m
        One sigma of a shift of the surface together with the photos.
    """

    terrain: Terrain
    errors: GroundErrors
    name: str
    level: float = 0.0
    scale: float = 0.0
    spacing: float = math.nan

    @classmethod
    def of(
        cls, terrain: Terrain, name: str, *, level: float = 0.0, spacing: float = math.nan
    ) -> GroundField:
        """Field of a terrain by what it says of itself."""
        errors = GroundErrors.of(terrain)
        return cls(terrain=terrain, errors=errors, name=name, level=level, spacing=spacing)

    @property
    def detail(self) -> float:
        """Distance over which it is smooth, m; of a plane that of its errors."""
        own = self.terrain.detail
        return own if math.isfinite(own) else FLAT_LENGTH

    @property
    def common(self) -> float:
        """One sigma of what all heights above the datum share, m."""
        return math.hypot(self.errors.shared, self.level)

    def z_at(self, xy_enu: ArrayLike) -> Array:
        """Up coordinate in enu, m; (..., 2) -> (...), NaN outside."""
        return self.terrain.z_at(xy_enu)

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        """Height above the ellipsoid, m, at places of a map; (..., 2) -> (...), NaN outside."""
        return self.terrain.height_on_map(frame, xy_map)

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

    def resampled(self) -> Sequence[Self]:
        """None: it has no points of its own."""
        return ()
