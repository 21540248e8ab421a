"""Web mercator: its tiles, and where the pixels of a raster lie in it.

Places are metres of EPSG:3857: x to the east, y to the north, (0, 0) on the equator at Greenwich.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.errors import ExportError
from georef_gis.geodesy import WGS84_A, same_crs

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame

CRS = "EPSG:3857"
# m; side of the square that zoom 0 shows
WORLD = 2.0 * math.pi * WGS84_A
# deg; where that square ends to the north and south
LATITUDE_LIMIT = math.degrees(math.atan(math.sinh(math.pi)))
# px; nodes along each side of a raster by which its place is judged
_RIM_NODES = 33
# deg; no two neighbouring nodes of a rim are so far apart, unless the 180th meridian is between
_JUMP = 180.0


def pixel_size(zoom: int, tile: int) -> float:
    """Side of a pixel of tiles of `tile` px, m of the projection."""
    return math.ldexp(WORLD / tile, -zoom)


def tile_corner(zoom: int, x: int, y: int) -> tuple[float, float]:
    """North-west corner of a tile, m of the projection; rows count from the north (XYZ)."""
    side = math.ldexp(WORLD, -zoom)
    return x * side - WORLD / 2.0, WORLD / 2.0 - y * side


def mercator_from_lonlat(lonlat: Array) -> Array:
    """Metres of the projection from degrees; latitudes are cut at its edge; (..., 2)."""
    lat = np.radians(np.clip(lonlat[..., 1], -LATITUDE_LIMIT, LATITUDE_LIMIT))
    x, y = WGS84_A * np.radians(lonlat[..., 0]), WGS84_A * np.arcsinh(np.tan(lat))
    return np.stack([x, y], axis=-1)


def lonlat_from_mercator(xy: Array) -> Array:
    """Degrees from metres of the projection; (..., 2)."""
    lat = np.arctan(np.sinh(xy[..., 1] / WGS84_A))
    lonlat: Array = np.degrees(np.stack([xy[..., 0] / WGS84_A, lat], axis=-1))
    return lonlat


class RasterPlace:
    """Where the pixels of a raster lie in web mercator.

    Parameters
    ----------
    ds
        Open raster; pixels are counted from its outer corner.
    frame
        The project's way from map to degrees, datum step included, so that tiles and vectors
        agree. It serves if the raster is in its CRS; else GDAL's way is taken.

    Raises
    ------
    ExportError
        If the raster has no place, crosses the 180th meridian or lies beyond the projection.
    """

    def __init__(self, ds: Any, name: str, frame: MapFrame | None) -> None:
        if ds.crs is None:
            raise ExportError(f"{name}: has no CRS; make it again, or assign one with gdal_edit")
        own = frame is not None and same_crs(ds.crs.to_wkt(), frame.horizontal.to_wkt())
        self._frame = frame if own else None
        self._crs, self._transform = ds.crs, ds.transform
        self._size = np.array([ds.width, ds.height], dtype=np.float64)
        self._name = name
        self.bounds_lonlat, self.is_cut = self._find_bounds()
        """West, south, east, north, deg; and whether a part beyond 85.05 deg is left out."""
        self.native_pixel = self._find_pixel()
        """Side of the raster's pixel in the middle, m of the projection."""

    def lonlat_from_colrow(self, colrow: Array) -> Array:
        """Degrees of pixel coordinates, NaN where there are none; (..., 2)."""
        t = self._transform
        x = t.a * colrow[..., 0] + t.b * colrow[..., 1] + t.c
        y = t.d * colrow[..., 0] + t.e * colrow[..., 1] + t.f
        if self._frame is None:
            return _transformed(self._crs, "EPSG:4326", x, y)
        h = np.full(x.shape, self._frame.origin.height_ellipsoidal)
        geo = self._frame.geo_from_map(np.stack([x, y, h], axis=-1))
        return np.degrees(geo[..., 1::-1])

    def colrow_from_mercator(self, xy: Array) -> Array:
        """Pixel coordinates of places, NaN where there are none; (..., 2)."""
        if self._frame is None:
            p = _transformed(CRS, self._crs, xy[..., 0], xy[..., 1])
        else:
            lonlat = np.radians(lonlat_from_mercator(xy))
            h = np.full(lonlat.shape[:-1], self._frame.origin.height_ellipsoidal)
            p = self._frame.map_from_geo(np.stack([lonlat[..., 1], lonlat[..., 0], h], axis=-1))
        t, x, y = ~self._transform, p[..., 0], p[..., 1]
        return np.stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f], axis=-1)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north in metres of the projection."""
        low, high = mercator_from_lonlat(np.array(self.bounds_lonlat).reshape(2, 2)).tolist()
        return low[0], low[1], high[0], high[1]

    def _find_bounds(self) -> tuple[tuple[float, float, float, float], bool]:
        t = np.linspace(0.0, 1.0, _RIM_NODES)
        zero, one = np.zeros_like(t), np.ones_like(t)
        sides = ((t, zero), (one, t), (t[::-1], one), (zero, t[::-1]))
        ring = np.concatenate([np.column_stack(side) for side in sides]) * self._size
        lonlat = self.lonlat_from_colrow(ring)
        if not np.isfinite(lonlat).all():
            raise ExportError(f"{self._name}: a part of it lies outside its CRS; cut it smaller")
        if np.abs(np.diff(lonlat[:, 0])).max() > _JUMP:
            raise ExportError(
                f"{self._name}: crosses the 180th meridian or holds a pole, where web maps end; "
                "cut it there and export both parts"
            )
        west, south = lonlat.min(axis=0)
        east, north = lonlat.max(axis=0)
        if south >= LATITUDE_LIMIT or north <= -LATITUDE_LIMIT:
            raise ExportError(
                f"{self._name}: lies beyond {LATITUDE_LIMIT:.2f} deg of latitude, where web "
                "mercator ends; use export-cog"
            )
        cut = max(south, -LATITUDE_LIMIT), min(north, LATITUDE_LIMIT)
        box = (float(west), float(cut[0]), float(east), float(cut[1]))
        return box, bool(cut != (south, north))

    def _find_pixel(self) -> float:
        west, south, east, north = self.bounds
        step = min(east - west, north - south) * 1e-3
        x, y = (west + east) / 2.0, (south + north) / 2.0
        at = self.colrow_from_mercator(np.array([[x, y], [x + step, y], [x, y + step]]))
        area = abs(np.linalg.det((at[1:] - at[0]) / step))
        return 1.0 / math.sqrt(area)


def _transformed(source: Any, target: Any, x: Array, y: Array) -> Array:
    from rasterio.warp import transform

    xs, ys = transform(source, target, x.ravel(), y.ravel())
    out = np.stack([xs, ys], axis=-1).reshape(*x.shape, 2)
    # GDAL says inf where a place has no coordinates.
    return np.where(np.isfinite(out), out, np.nan)
