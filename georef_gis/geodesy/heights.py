"""Heights and what they are measured from: ellipsoid, geoid, ground."""

from __future__ import annotations

import functools
import lzma
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from georef_gis.errors import CrsError
from georef_gis.frames import Array


class HeightKind(StrEnum):
    """What a height is measured from."""

    ELLIPSOIDAL = "ellipsoidal"
    ORTHOMETRIC = "orthometric"
    ABOVE_GROUND = "above_ground"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """A height and what it is measured from, m."""

    value: float
    kind: HeightKind
    geoid: str = "egm96"

    def ellipsoidal(self, lat: float, lon: float) -> float:
        """Height above the WGS 84 ellipsoid at a place (rad), m.

        Raises
        ------
        CrsError
            If the kind cannot be turned into an ellipsoidal height.
        """
        if self.kind is HeightKind.ELLIPSOIDAL:
            return self.value
        if self.kind is HeightKind.ORTHOMETRIC:
            return self.value + float(geoid_undulation(lat, lon, geoid=self.geoid))
        raise CrsError(
            f"a height of {self.value:.2f} m of kind '{self.kind}' has no ellipsoidal value; "
            "state its kind (ellipsoidal or orthometric)",
            field="height",
        )


@functools.cache
def _egm96_cm() -> Array:
    """EGM96 undulation on its 15' grid from (-90, -180), cm; shape (721, 1441)."""
    raw = resources.files("georef_gis").joinpath("data/egm96_15.xz").read_bytes()
    d = np.frombuffer(lzma.decompress(raw), dtype="<i2").reshape(721, 1440).astype(np.int32)
    grid = np.cumsum(np.cumsum(d, axis=0), axis=1)
    return np.concatenate([grid, grid[:, :1]], axis=1).astype(np.float64)


def _egm96(lat: Array, lon: Array) -> Array:
    row = np.clip((np.degrees(lat) + 90.0) * 4.0, 0.0, 720.0)
    col = ((np.degrees(lon) + 180.0) % 360.0) * 4.0
    i = np.minimum(row.astype(int), 719)
    j = np.minimum(col.astype(int), 1439)
    v, u = row - i, col - j
    g = _egm96_cm()
    top = g[i, j] * (1 - u) + g[i, j + 1] * u
    bottom = g[i + 1, j] * (1 - u) + g[i + 1, j + 1] * u
    return np.asarray((top * (1 - v) + bottom * v) / 100.0)


# name -> (vertical CRS, its geographic 3D CRS); grids come with proj-data or `georef grids`
_PROJ_GEOIDS = {
    "geoid18": ("EPSG:5703", "EPSG:6319"),
    "egm2008": ("EPSG:3855", "EPSG:4979"),
    "cgvd2013": ("EPSG:6647", "EPSG:4955"),
}


def geoid_undulation(lat: ArrayLike, lon: ArrayLike, *, geoid: str = "egm96") -> Array:
    """Height of the geoid above the ellipsoid, m, at lat, lon in rad; shapes (...).

    Raises
    ------
    CrsError
        If the geoid is unknown or its grid is not installed: never a silent zero.
    """
    lat, lon = np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float))
    if geoid == "egm96":
        return _egm96(lat, lon)
    if geoid not in _PROJ_GEOIDS:
        known = ", ".join(["egm96", *_PROJ_GEOIDS])
        raise CrsError(f"'{geoid}' is not known; use one of {known}", field="geoid")
    vertical, geographic = _PROJ_GEOIDS[geoid]
    horizontal = CRS(geographic).to_2d().to_authority()
    compound = f"{':'.join(horizontal or ())}+{vertical.split(':')[1]}"
    try:
        # allow_ballpark=False: otherwise PROJ hands the height back unchanged.
        t = Transformer.from_crs(compound, geographic, always_xy=True, allow_ballpark=False)
        h = t.transform(np.degrees(lon), np.degrees(lat), np.zeros_like(lat), errcheck=True)[2]
    except ProjError as error:
        raise CrsError(
            f"the grid of geoid '{geoid}' is not installed; add it (PROJ's proj-data) "
            'or use geoid = "egm96"',
            field="geoid",
        ) from error
    if not np.all(np.isfinite(h)):
        raise CrsError(f"'{geoid}' does not cover the place", field="geoid")
    return np.asarray(h, dtype=np.float64)
