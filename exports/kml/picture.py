"""The mosaic seen in latitude and longitude, block by block, from the overview that fits."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from exports.tiles.open_raster import OpenRaster
from exports.tiles.raster_colour import Pixels, colour_bands, premultiplied, straight, stretches
from georef_gis.errors import ExportError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, meridian_radius, metres_per_unit, prime_vertical_radius

# px; between the nodes the transformation is taken as linear (error far below 0.01 px)
MESH_STEP = 64
# MB; some rows of tiles, so that neighbouring blocks do not decode them twice
CACHE_MB = 64
# rad; a mosaic that is wider in longitude lies around a pole
WIDEST = math.pi / 2.0
# Least opacity that is taken for opaque where the rim is written hard.
HARD_RIM = 128
# zlib's effort for rims of few colours; more takes longer and saves 1 %
SMALL_EFFORT = 3
# Few colours pack best as they are, without differences between pixels (older OpenCV has no say).
_PLAIN_PNG: list[int] = []
if hasattr(cv2, "IMWRITE_PNG_FILTER"):
    _PLAIN_PNG += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    _PLAIN_PNG += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT]


@dataclass(frozen=True, slots=True, kw_only=True)
class LatLonGrid:
    """Pixels of equal size in degrees, north-up; (0, 0) is the outer corner of the first."""

    west: float
    north: float
    dlon: float
    dlat: float
    width: int
    height: int

    def bounds(self, col: float, row: float, cols: float, rows: float) -> dict[str, float]:
        """Sides of a block, deg; neighbours get the very same numbers."""
        return {
            "north": self.north - row * self.dlat,
            "south": self.north - (row + rows) * self.dlat,
            "east": self.west + (col + cols) * self.dlon,
            "west": self.west + col * self.dlon,
        }

    def parted(self) -> tuple[LatLonGrid, ...]:
        """The same without crossing the 180th meridian, which no box may: itself, or two."""
        west = self.west + 360.0 if self.west < -180.0 else self.west
        cols = round((180.0 - west) / self.dlon)
        if cols >= self.width:
            return (replace(self, west=west),)
        # The western part must end at the meridian at every level: it grows to the west.
        step = 2 ** max(1, math.ceil(math.log2(max(self.width, self.height))) - 7)
        whole = math.ceil(cols / step) * step
        return (
            replace(self, west=180.0 - whole * self.dlon, width=whole),
            replace(self, west=-180.0, width=self.width - cols),
        )

    def coarser(self, factor: int) -> LatLonGrid:
        """The same corner with pixels `factor` times as large."""
        return LatLonGrid(
            west=self.west,
            north=self.north,
            dlon=self.dlon * factor,
            dlat=self.dlat * factor,
            width=math.ceil(self.width / factor),
            height=math.ceil(self.height / factor),
        )


class MosaicPicture(OpenRaster):
    """A GeoTIFF in the project CRS, read as 8-bit colour with alpha in latitude and longitude.

    The way from degrees to pixels is the project's own (`MapFrame`, datum step included), so the
    picture and the vectors of one file agree.
    """

    def __init__(self, path: Path, frame: MapFrame) -> None:
        super().__init__(path, CACHE_MB)
        with ExitStack() as on_error:
            on_error.callback(self.close)
            self.path, self.frame = path, frame
            if self.full.crs is None:
                raise ExportError(f"{path.name}: has no CRS; make the mosaic again")
            self._bands = colour_bands(self.full)
            eight_bit = self.full.dtypes[0] == "uint8"
            self._stretch = None if eight_bit else stretches(self.full, self._bands)
            self.grid = self._make_grid()
            on_error.pop_all()

    def _make_grid(self) -> LatLonGrid:
        """Grid over the mosaic whose pixels are as large as the mosaic's."""
        ds, origin = self.full, self.frame.origin
        t = np.linspace(0.0, 1.0, 33)
        zero, one = np.zeros_like(t), np.ones_like(t)
        rim = np.concatenate(
            [np.column_stack(side) for side in ((t, zero), (t, one), (zero, t), (one, t))]
        )
        lat, lon = self._geo_from_colrow(rim * (ds.width, ds.height)).T
        # Beyond 180 deg where the mosaic goes on there, so that its columns follow each other.
        lon = origin.lon + np.mod(lon - origin.lon + math.pi, 2.0 * math.pi) - math.pi
        if np.ptp(lon) > WIDEST:
            raise ExportError(
                "the mosaic lies around a pole, where no box of longitudes and latitudes holds it; "
                "export it without overlay, or as cog"
            )
        centre = origin.enu_from_geo([lat.mean(), lon.mean(), origin.height_ellipsoidal])
        pixel = ds.transform.a * metres_per_unit(self.frame.horizontal)
        metres = pixel / self.frame.scale_at(centre)
        dlat = math.degrees(metres / float(meridian_radius(lat.mean())))
        radius = float(prime_vertical_radius(lat.mean())) * math.cos(lat.mean())
        dlon = math.degrees(metres / radius)
        west, north = math.degrees(lon.min()), math.degrees(lat.max())
        east = math.degrees(lon.max())
        for meridian in (-180.0, 180.0):
            if west < meridian < east:
                # Pixels part there, as boxes must.
                west = meridian - math.ceil((meridian - west) / dlon) * dlon
        self.narrowing = float(np.cos(lat).max() / np.cos(lat).min())
        return LatLonGrid(
            west=west,
            north=north,
            dlon=dlon,
            dlat=dlat,
            width=math.ceil((east - west) / dlon),
            height=math.ceil((north - math.degrees(lat.min())) / dlat),
        )

    def _geo_from_colrow(self, colrow: Array) -> Array:
        """Lat, lon in rad of outer-corner pixel coordinates at full resolution; (n, 2)."""
        t = self.full.transform
        x = t.a * colrow[:, 0] + t.b * colrow[:, 1] + t.c
        y = t.d * colrow[:, 0] + t.e * colrow[:, 1] + t.f
        h = np.full(len(colrow), self.frame.origin.height_ellipsoidal)
        return self.frame.geo_from_map(np.column_stack([x, y, h]))[:, :2]

    def _colrow_from_lonlat(self, lon: Array, lat: Array) -> Array:
        """Outer-corner pixel coordinates at full resolution of degrees; (..., 2)."""
        h = np.full(lon.shape, self.frame.origin.height_ellipsoidal)
        p = self.frame.map_from_geo(np.stack([np.radians(lat), np.radians(lon), h], axis=-1))
        t = ~self.full.transform
        x, y = p[..., 0], p[..., 1]
        return np.stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f], axis=-1)

    def block(self, grid: LatLonGrid, col: int, row: int, cols: int, rows: int) -> Pixels | None:
        """Block of a grid as (rows, cols, 4) BGRA with colour premultiplied by alpha.

        None where the mosaic has nothing.
        """
        wanted = grid.dlat / self.grid.dlat
        factor = self.factor_for(wanted)
        ds = self.levels[factor]
        us, vs = _nodes(cols), _nodes(rows)
        lonlat = np.meshgrid(
            grid.west + (col + us) * grid.dlon, grid.north - (row + vs) * grid.dlat
        )
        at = self._colrow_from_lonlat(*lonlat)
        at *= (ds.width / self.full.width, ds.height / self.full.height)
        # Between nodes all is linear, so they bound the block.
        low = np.floor(at.min(axis=(0, 1))).astype(int) - 2
        high = np.ceil(at.max(axis=(0, 1))).astype(int) + 2
        left, top = np.maximum(low, 0)
        right, bottom = np.minimum(high, (ds.width, ds.height))
        if right <= left or bottom <= top:
            return None
        shrink = max(1, int(wanted / factor))
        source, scale = self._read(ds, (left, top, right - left, bottom - top), shrink)
        if not has_content(source):
            return None
        uv = (at - (left, top)) * scale - 0.5
        u, v = (_between_nodes(uv[..., i], cols, rows) for i in (0, 1))
        out = np.asarray(
            cv2.remap(source, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8
        )
        return out if has_content(out) else None

    def _read(
        self, ds: Any, window: tuple[int, int, int, int], shrink: int
    ) -> tuple[Pixels, Array]:
        """Part of a level as premultiplied BGRA, and pixels read per pixel of the level (2,)."""
        from rasterio.enums import Resampling
        from rasterio.windows import Window

        part = Window(*(int(value) for value in window))
        size = (max(1, window[3] // shrink), max(1, window[2] // shrink))
        how = Resampling.average if shrink > 1 else Resampling.nearest
        bands = ds.read(self._bands, window=part, out_shape=(len(self._bands), *size),
                        resampling=how)  # fmt: skip
        mask = ds.dataset_mask(window=part, out_shape=size, resampling=Resampling.nearest)
        if self._stretch is None and len(bands) == 3 and cv2.countNonZero(mask) == mask.size:
            out = np.asarray(cv2.merge([*bands[::-1], mask]), dtype=np.uint8)
        else:
            out = premultiplied(bands, mask, self._stretch)
        return out, np.array([size[1] / window[2], size[0] / window[3]])


def _nodes(size: int) -> Array:
    """Places of nodes along a side, px from its outer edge; the last may lie beyond the end."""
    return np.arange(0, size + MESH_STEP, MESH_STEP, dtype=np.float64)


def _between_nodes(values: Array, cols: int, rows: int) -> NDArray[np.float32]:
    """Bilinear between nodes at all pixel centres; (nodes of rows, nodes of cols) -> (rows, cols).

    Notes
    -----
    cv2 takes each value for that of a cell's middle, so the cells begin half a step before.
    """
    size = (values.shape[1] * MESH_STEP, values.shape[0] * MESH_STEP)
    cells = cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    half = MESH_STEP // 2
    return np.ascontiguousarray(cells[half : half + rows, half : half + cols], dtype=np.float32)


def has_content(premultiplied: Pixels) -> bool:
    """Whether anything of a picture can be seen."""
    return cv2.countNonZero(cv2.extractChannel(premultiplied, 3)) > 0


def encode(premultiplied: Pixels, quality: int, *, small: bool = False) -> tuple[str, bytes]:
    """File ending and bytes of a picture: JPEG where it is opaque, else PNG.

    Parameters
    ----------
    small
        PNG of 256 colours with a hard rim: a third of the bytes. It is written with all its
        channels, because GDAL's reader of superoverlays does not look up a palette.
    """
    alpha = np.asarray(cv2.extractChannel(premultiplied, 3), np.uint8)
    least = cv2.minMaxLoc(alpha)[0]
    if least == 255 or (small and least >= HARD_RIM):
        image = premultiplied if least == 255 else _hard(premultiplied, alpha)
        suffix = "jpg"
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2BGR), np.uint8)
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    elif small:
        suffix, image = "png", _few_colours(_hard(premultiplied, alpha))
        options = [cv2.IMWRITE_PNG_COMPRESSION, SMALL_EFFORT, *_PLAIN_PNG]
    else:
        suffix, image = "png", straight(premultiplied)
        options = [cv2.IMWRITE_PNG_COMPRESSION, 6]
    done, data = cv2.imencode(f".{suffix}", image, options)
    if not done:
        raise ValueError(f"OpenCV cannot encode a picture of shape {premultiplied.shape}")
    return suffix, data.tobytes()


def _hard(premultiplied: Pixels, alpha: Pixels) -> Pixels:
    """The same picture with a hard rim: every pixel is seen or not.

    Half-covered pixels would share colours, and so opacity, with the inside.
    """
    seen = np.where(alpha >= HARD_RIM, np.uint8(255), np.uint8(0))
    out = cv2.bitwise_and(premultiplied, premultiplied, mask=seen)
    rows, cols = np.nonzero(seen & (alpha < 255))
    share = alpha[rows, cols, None].astype(np.uint16)
    out[rows, cols, :3] = np.minimum(
        (out[rows, cols, :3] * np.uint16(255) + share // 2) // share, 255
    )
    out[rows, cols, 3] = 255
    return np.asarray(out, dtype=np.uint8)


def _few_colours(image: Pixels) -> Pixels:
    """The same picture in 256 colours, as BGRA."""
    from PIL import Image

    rgba = Image.fromarray(cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA))
    few = rgba.quantize(256, method=Image.Quantize.FASTOCTREE).convert("RGBA")
    return np.asarray(cv2.cvtColor(np.asarray(few), cv2.COLOR_RGBA2BGRA), np.uint8)
