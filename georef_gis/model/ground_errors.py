"""Errors of the ground's height: a part that all places share, and one of each neighbourhood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.model.terrain import FlatTerrain, Terrain
from georef_gis.model.tin import TinTerrain

# m; over which the relief that a flat ground leaves out stays alike
FLAT_LENGTH = 50.0
# lengths of `Terrain.detail` over which errors of a surface stay alike
DETAILS = 3.0
# m; no surface is told finer
LEAST_LENGTH = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundErrors:
    """Law of the errors of a ground's height.

    The covariance of two places is `shared^2 + s_i s_j exp(-(d / length)^2 / 2)`, with s the
    local sigma and d their distance.

    Parameters
    ----------
    terrain
        Whose errors they are.
    shared : m
        One sigma of what all places have in common.
    length : m
        Over which local errors stay alike: what is flat here leaves the same hill out there.
    """

    terrain: Terrain
    shared: float
    length: float

    @classmethod
    def of(cls, terrain: Terrain, *, tied: bool = False) -> GroundErrors:
        """Law of a terrain by what it says of itself.

        A TIN knows its shared part; of level ground and a DEM, of which nothing else is known,
        half of the variance is shared.

        Parameters
        ----------
        tied
            Only what a TIN leaves out between its points: the rest is told by the photos.
        """
        if tied and isinstance(terrain, TinTerrain):
            terrain = terrain.beside_photos()
        if isinstance(terrain, TinTerrain):
            finite = terrain.detail if np.isfinite(terrain.detail) else FLAT_LENGTH / DETAILS
            return cls(
                terrain=terrain,
                shared=terrain.sigma_shared,
                length=max(DETAILS * finite, LEAST_LENGTH),
            )
        flat = isinstance(terrain, FlatTerrain) or not np.isfinite(terrain.detail)
        length = FLAT_LENGTH if flat else max(DETAILS * terrain.detail, LEAST_LENGTH)
        return cls(terrain=terrain, shared=terrain.sigma / np.sqrt(2.0), length=length)

    def local(self, xy_enu: ArrayLike) -> Array:
        """One sigma of the local part, m, at east, north; (m, 2) m -> (m,)."""
        xy = np.asarray(xy_enu, float)
        if isinstance(self.terrain, TinTerrain):
            whole = self.terrain.sigma_at(xy)
        else:
            whole = np.full(xy.shape[:-1], self.terrain.sigma)
        return np.asarray(np.sqrt(np.maximum(whole**2 - self.shared**2, 0.0)))

    def variance(self, xy_enu: ArrayLike) -> Array:
        """Variance of the height, m^2, at east, north; (m, 2) m -> (m,)."""
        return np.asarray(self.local(xy_enu) ** 2 + self.shared**2)

    def between(self, a: ArrayLike, b: ArrayLike) -> Array:
        """Covariance of the heights of places, m^2; (m, 2) and (k, 2) m -> (m, k)."""
        first, second = np.asarray(a, float), np.asarray(b, float)
        apart = np.sum((first[:, None] - second) ** 2, axis=-1)
        alike = np.exp(-0.5 * apart / self.length**2)
        return np.asarray(np.outer(self.local(first), self.local(second)) * alike + self.shared**2)
