"""A surface as GeoTIFF: heights and their sigma, with what the heights are measured from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.geodesy import (
    CRS,
    MapFrame,
    VerticalPart,
    geoid_undulation,
    navd88_code,
    parse_crs,
)
from georef_gis.measure.surface.field import HeightField, bounds_of
from georef_gis.model.grid import Grid
from georef_gis.rasters.profile import RasterProfile
from georef_gis.units import INTERNATIONAL_FOOT

Reference = Literal["orthometric", "ellipsoidal"]
# value of cells without a height
NODATA = -9999.0
# EPSG codes of heights above a geoid, m
_VERTICAL = {"egm96": 5773, "egm2008": 3855, "geoid18": 5703, "cgvd2013": 6647}
# of Puerto Rico and the Virgin Islands: above GEOID18 too, and not NAVD88
_ISLANDS = (6641, 6642)
# Vertical datum 2002 of WKT 1 is an ellipsoid.
_ELLIPSOIDAL = (
    'VERT_CS["ellipsoidal height",VERT_DATUM["Ellipsoid",2002],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Up",UP]]'
)
# nodes along each side of a lattice on which what is smooth is told
_LATTICE = 9
TILE = 512
# of m or ft; finer digits are noise, which no compression makes small
_STEP = np.float32(2.0**-13)
# of deflate: the usual 6 takes four times as long for files 7 % smaller
_LEVEL = 2
# names of the bands of sigmas, by which a raster of ours is known; the unit comes last
SIGMA_BAND = "one sigma of the height, m"
LOCAL_BAND = "one sigma of the height against its surroundings, m"
SIGMA_BANDS = (SIGMA_BAND, LOCAL_BAND)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightReference:
    """What heights are measured from, a geoid or the ellipsoid, and the unit they are written in.

    Parameters
    ----------
    unit
        Of the heights and sigmas of a product, m.
    code
        EPSG code of the heights; None = that of the geoid in metres, if it has one.
    """

    kind: Reference
    geoid: str = "egm96"
    unit: float = 1.0
    code: int | None = None

    @classmethod
    def promised(
        cls, kind: Reference, geoid: str, part: VerticalPart | None, *, metres: bool = False
    ) -> HeightReference:
        """Heights as the vertical part of a map promises them; without one above a geoid, in m.

        Parameters
        ----------
        metres
            Whatever the part's unit.
        """
        if part is None or kind == "ellipsoidal":
            return cls(kind=kind, geoid=geoid if part is None else part.geoid)
        if part.code in _ISLANDS:
            return cls(kind=kind, geoid=part.geoid, code=part.code)
        code = navd88_code(part.unit) if part.geoid == "geoid18" and not metres else None
        # A unit without a code would be written as metres.
        return cls(kind=kind, geoid=part.geoid, unit=part.unit if code else 1.0, code=code)

    @property
    def unit_name(self) -> str:
        """Short, as EPSG has it: m, ft, ftUS."""
        if self.unit == 1.0:
            return "m"
        return "ft" if abs(self.unit / INTERNATIONAL_FOOT - 1.0) < 1e-6 else "ftUS"

    @property
    def _up(self) -> CRS | None:
        """CRS of the heights above a geoid, if it has one."""
        code = self.code or _VERTICAL.get(self.geoid)
        return None if code is None else parse_crs(f"EPSG:{code}")

    @property
    def told(self) -> str:
        """In words."""
        if self.kind == "ellipsoidal":
            return f"above the WGS 84 ellipsoid of the positions, {self.unit_name}"
        name = "no CRS" if self._up is None else self._up.name
        return f"above the geoid {self.geoid} ({name}), {self.unit_name}"

    @property
    def bands(self) -> tuple[str, str, str]:
        """Names of the bands of a raster: height and its two sigmas, with their unit."""
        whole, local = (f"{band.removesuffix('m')}{self.unit_name}" for band in SIGMA_BANDS)
        return f"height {self.told}", whole, local

    def crs_wkt(self, horizontal: CRS) -> str:
        """CRS of a raster of such heights; above an ellipsoid that of the map alone.

        GeoTIFF has no sound way to tell that heights of a map are above its ellipsoid.
        """
        if self.kind == "ellipsoidal" or self._up is None:
            return str(horizontal.to_wkt())
        across, height = horizontal.to_wkt("WKT1_GDAL"), self._up.to_wkt("WKT1_GDAL")
        return f'COMPD_CS["{horizontal.name} + {self._up.name}",{across},{height}]'

    def point_wkt(self, horizontal: CRS) -> str:
        """WKT 1 of points with such heights: without a vertical part a reader takes feet for them.

        Of heights above a geoid that has no CRS that of the map alone.
        """
        if self.kind != "ellipsoidal":
            return str(parse_crs(self.crs_wkt(horizontal)).to_wkt("WKT1_GDAL"))
        across = horizontal.to_wkt("WKT1_GDAL")
        return f'COMPD_CS["{horizontal.name} + ellipsoidal height",{across},{_ELLIPSOIDAL}]'

    def from_ellipsoidal(self, frame: MapFrame, xy_map: Array, heights: Array) -> Array:
        """Heights of this kind from ellipsoidal ones, m, at places of the map; (..., 2), (...)."""
        if self.kind == "ellipsoidal":
            return heights
        level = np.nan_to_num(heights, nan=frame.origin.height_ellipsoidal)
        geo = frame.geo_from_map(np.concatenate([xy_map, level[..., None]], axis=-1))
        n = geoid_undulation(geo[..., 0], geo[..., 1], geoid=self.geoid, datum=frame.gnss_datum)
        return np.asarray(heights - n)


def surface_profile(
    grid: Grid, frame: MapFrame, reference: HeightReference, field: HeightField
) -> RasterProfile:
    """Raster of three bands: height, its one sigma, and that against its surroundings."""
    return RasterProfile(
        width=grid.width,
        height=grid.height,
        transform=grid.transform,
        crs_wkt=reference.crs_wkt(frame.horizontal),
        bands=3,
        dtype="float32",
        compression="deflate",
        level=_LEVEL,
        tile_size=TILE,
        nodata=NODATA,
        band_descriptions=reference.bands,
        metadata={
            "SURFACE": field.name,
            "VERTICAL_REFERENCE": reference.told,
            "SIGMA": "one standard deviation of the height, what all heights share included",
            "SIGMA_COMMON_M": f"{field.common.sigma:.4g}",
        },
    )


def surface_tiles(
    field: HeightField, grid: Grid, frame: MapFrame, reference: HeightReference, cover: Any,
    *, tell: Callable[[float], None] = lambda share: None,
) -> Iterator[tuple[int, int, NDArray[np.float32], NDArray[np.bool_]]]:  # fmt: skip
    """Tiles of a surface that hold any height.

    Parameters
    ----------
    cover
        Polygon of the map, CRS units: beyond it no heights are given.

    Yields
    ------
    row, col
        Of the tile.
    values : shape (rows, cols, 3), float32
        In the unit of the reference.
    known : shape (rows, cols)
    """
    shapely.prepare(cover)
    down, across = -(-grid.height // TILE), -(-grid.width // TILE)
    for number in range(down * across):
        row, col = divmod(number, across)
        tell(number / (down * across))
        xy = cell_centres(grid, row, col)
        known = _covered(cover, xy)
        if not known.any():
            continue
        bands = _heights(field, frame, reference, xy)
        known &= np.isfinite(bands).all(axis=-1)
        values = np.where(known[..., None], bands, np.float32(NODATA))
        if known.any():
            yield row, col, values, known


def _covered(cover: Any, xy: Array) -> NDArray[np.bool_]:
    """Which places of a grid lie in a polygon that is prepared; (rows, cols, 2)."""
    rim = shapely.box(*bounds_of(xy))
    if shapely.contains_properly(cover, rim):
        return np.ones(xy.shape[:-1], dtype=np.bool_)
    if not shapely.intersects(cover, rim):
        return np.zeros(xy.shape[:-1], dtype=np.bool_)
    return np.asarray(shapely.contains_xy(cover, xy[..., 0], xy[..., 1]))


def cell_centres(grid: Grid, row: int, col: int) -> Array:
    """Middles of the cells of a tile of a grid, CRS units; (rows, cols, 2)."""
    a, _, left, _, e, top = grid.transform
    c = np.arange(col * TILE, min((col + 1) * TILE, grid.width)) + 0.5
    r = np.arange(row * TILE, min((row + 1) * TILE, grid.height)) + 0.5
    return np.stack(np.meshgrid(left + a * c, top + e * r), axis=-1)


def _heights(
    field: HeightField, frame: MapFrame, reference: HeightReference, xy: Array
) -> NDArray[np.float32]:
    """Height, sigma, local sigma at places of the map, in the reference's unit; (r, c, 2 or 3)."""
    found = field.on_map(frame, xy)
    level = float(frame.origin.height_ellipsoidal)

    def common(places: Array) -> Array:
        at = np.concatenate([places, np.full((*places.shape[:-1], 1), level)], axis=-1)
        return field.common.sigma_at(frame.enu_from_map(at)[..., :2])

    out = np.empty((*xy.shape[:-1], 3), dtype=np.float32)
    out[..., 0] = found.height - undulation_over(frame, reference, xy)
    out[..., 1] = np.hypot(found.local, _smooth(common, xy))
    out[..., 2] = found.local
    out /= np.float32(reference.unit)
    return np.asarray(np.round(out / _STEP) * _STEP, dtype=np.float32)


def undulation_over(frame: MapFrame, reference: HeightReference, xy: Array) -> Array:
    """What the reference lies above the ellipsoid, m, on a grid; (rows, cols, 2) -> (rows, cols).

    A geoid bends by centimetres per kilometre: told on a lattice, bilinear between.
    """
    if reference.kind == "ellipsoidal":
        return np.zeros(xy.shape[:-1])
    return _smooth(
        lambda at: -reference.from_ellipsoidal(frame, at, np.zeros(at.shape[:-1])), xy
    )  # fmt: skip


def _smooth(told: Callable[[Array], Array], xy: Array) -> Array:
    """What changes little over a grid, (rows, cols, 2) -> (rows, cols), from a lattice of it."""
    rows, cols = xy.shape[:2]
    r, c = (np.linspace(0, n - 1, _LATTICE) for n in (rows, cols))
    nodes = np.stack(
        np.meshgrid(np.interp(c, np.arange(cols), xy[0, :, 0]),
                    np.interp(r, np.arange(rows), xy[:, 0, 1])), axis=-1
    )  # fmt: skip
    by_col = np.stack([np.interp(np.arange(cols), c, line) for line in told(nodes)])
    at = np.arange(rows) / max(rows - 1, 1) * (_LATTICE - 1)
    low = np.minimum(at.astype(np.intp), _LATTICE - 2)
    share = (at - low)[:, None]
    return np.asarray(by_col[low] * (1.0 - share) + by_col[low + 1] * share)
