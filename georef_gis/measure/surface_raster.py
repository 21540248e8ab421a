"""A surface as GeoTIFF: heights and their sigma, with what the heights are measured from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import shapely

from georef_gis.frames import Array
from georef_gis.geodesy import CRS, MapFrame, geoid_undulation, parse_crs
from georef_gis.measure.surface_field import HeightField, sigma_at
from georef_gis.model.grid import Grid
from georef_gis.rasters.profile import RasterProfile

Reference = Literal["orthometric", "ellipsoidal"]
# value of cells without a height
NODATA = -9999.0
# CRS of heights above a geoid, m
_VERTICAL = {"egm96": "EPSG:5773", "egm2008": "EPSG:3855", "geoid18": "EPSG:5703",
             "cgvd2013": "EPSG:6647"}  # fmt: skip
# cells of a lattice on which the geoid is told, along each side of a tile
_LATTICE = 9
TILE = 512
# name of the band of sigmas, by which a raster of ours is known
SIGMA_BAND = "one sigma of the height, m"


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightReference:
    """What heights are measured from: a geoid, or the ellipsoid."""

    kind: Reference
    geoid: str = "egm96"

    @property
    def told(self) -> str:
        """In words."""
        if self.kind == "ellipsoidal":
            return "above the WGS 84 ellipsoid of the positions, m"
        vertical = parse_crs(_VERTICAL[self.geoid]) if self.geoid in _VERTICAL else None
        return f"above the geoid {self.geoid} ({vertical.name if vertical else 'no CRS'}), m"

    def crs_wkt(self, horizontal: CRS) -> str:
        """CRS of a raster of such heights; above an ellipsoid that of the map alone.

        GeoTIFF has no sound way to tell that heights of a map are above its ellipsoid.
        """
        code = _VERTICAL.get(self.geoid)
        if self.kind == "ellipsoidal" or code is None:
            return str(horizontal.to_wkt())
        up = parse_crs(code)
        across, height = horizontal.to_wkt("WKT1_GDAL"), up.to_wkt("WKT1_GDAL")
        return f'COMPD_CS["{horizontal.name} + {up.name}",{across},{height}]'

    def from_ellipsoidal(self, frame: MapFrame, xy_map: Array, heights: Array) -> Array:
        """Heights of this kind from ellipsoidal ones, m, at places of the map; (..., 2), (...)."""
        if self.kind == "ellipsoidal":
            return heights
        level = np.nan_to_num(heights, nan=frame.origin.height_ellipsoidal)
        geo = frame.geo_from_map(np.concatenate([xy_map, level[..., None]], axis=-1))
        return np.asarray(heights - geoid_undulation(geo[..., 0], geo[..., 1], geoid=self.geoid))


def surface_profile(
    grid: Grid, frame: MapFrame, reference: HeightReference, field: HeightField
) -> RasterProfile:
    """Raster of two bands, height and its one sigma."""
    return RasterProfile(
        width=grid.width,
        height=grid.height,
        transform=grid.transform,
        crs_wkt=reference.crs_wkt(frame.horizontal),
        bands=2,
        dtype="float32",
        compression="deflate",
        tile_size=TILE,
        nodata=NODATA,
        band_descriptions=(f"height {reference.told}", SIGMA_BAND),
        metadata={
            "SURFACE": field.name,
            "VERTICAL_REFERENCE": reference.told,
            "SIGMA": "one standard deviation of the height, what all heights share included",
            # the rest is the height against its surroundings
            "SIGMA_COMMON_M": f"{field.common:.4f}",
        },
    )


def surface_tiles(
    field: HeightField, grid: Grid, frame: MapFrame, reference: HeightReference, cover: Any,
    *, tell: Callable[[float], None] = lambda share: None,
) -> Iterator[tuple[int, int, Array, Array]]:  # fmt: skip
    """Tiles of a surface that hold any height.

    Parameters
    ----------
    cover
        Polygon of the map, CRS units: beyond it no heights are given.

    Yields
    ------
    row, col
        Of the tile.
    values : shape (rows, cols, 2), float32
    known : shape (rows, cols)
    """
    shapely.prepare(cover)
    down, across = -(-grid.height // TILE), -(-grid.width // TILE)
    for number in range(down * across):
        row, col = divmod(number, across)
        tell(number / (down * across))
        xy = _centres(grid, row, col)
        known = shapely.contains_xy(cover, xy[..., 0], xy[..., 1])
        if not known.any():
            continue
        values = np.full((*known.shape, 2), NODATA, dtype=np.float32)
        height, sigma = _heights(field, frame, reference, xy)
        known &= np.isfinite(height) & np.isfinite(sigma)
        values[known] = np.column_stack([height[known], sigma[known]])
        if known.any():
            yield row, col, values, known


def _centres(grid: Grid, row: int, col: int) -> Array:
    """Middles of the cells of a tile, CRS units; (rows, cols, 2)."""
    a, _, left, _, e, top = grid.transform
    c = np.arange(col * TILE, min((col + 1) * TILE, grid.width)) + 0.5
    r = np.arange(row * TILE, min((row + 1) * TILE, grid.height)) + 0.5
    return np.stack(np.meshgrid(left + a * c, top + e * r), axis=-1)


def _heights(
    field: HeightField, frame: MapFrame, reference: HeightReference, xy: Array
) -> tuple[Array, Array]:
    """Height and sigma at places of the map, (rows, cols, 2) -> (rows, cols), m."""
    above = field.height_on_map(frame, xy)
    level = np.nan_to_num(above, nan=float(frame.origin.height_ellipsoidal))
    p_enu = frame.enu_from_map(np.concatenate([xy, level[..., None]], axis=-1))
    sigma = sigma_at(field, p_enu[..., :2])
    return above - _undulation(frame, reference, xy), sigma


def _undulation(frame: MapFrame, reference: HeightReference, xy: Array) -> Array:
    """What the reference lies above the ellipsoid, m; (rows, cols, 2) -> (rows, cols).

    A geoid bends by centimetres per kilometre: told on a lattice, bilinear between.
    """
    rows, cols = xy.shape[:2]
    r, c = (np.linspace(0, n - 1, _LATTICE) for n in (rows, cols))
    corners = np.stack(
        np.meshgrid(np.interp(c, np.arange(cols), xy[0, :, 0]),
                    np.interp(r, np.arange(rows), xy[:, 0, 1])), axis=-1
    )  # fmt: skip
    lattice = -reference.from_ellipsoidal(frame, corners, np.zeros(corners.shape[:2]))
    by_col = np.stack([np.interp(np.arange(cols), c, line) for line in lattice])
    at = np.arange(rows) / max(rows - 1, 1) * (_LATTICE - 1)
    low = np.minimum(at.astype(np.intp), _LATTICE - 2)
    share = (at - low)[:, None]
    return np.asarray(by_col[low] * (1.0 - share) + by_col[low + 1] * share)
