"""A raster seen in web mercator: blocks of 8-bit colour with alpha, from the overview that fits."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self

import cv2
import numpy as np

from exports.web_mercator import RasterPlace
from georef_gis.rasters.warp import upsample

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from exports.kml_picture import Pixels
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame

# px; between nodes the transformation is taken as linear, more finely where that is too coarse
MESH_STEPS = (64, 32, 16, 8, 4)
# px of the raster; of the mesh between its nodes, a tenth of what remap rounds to at worst
MESH_ERROR = 0.03
# MB; some rows of tiles, so that neighbouring blocks do not decode them twice
CACHE_MB = 128
# px of a decimated reading from which brightness is judged
SAMPLE = 512
# %; what becomes black and white of pixels that are not 8-bit
DARK, BRIGHT = 1.0, 99.0
# px; side in which an overview shows a tile whose emptiness is asked for
GLANCE = 128


class WebPicture:
    """A raster in any CRS, read as premultiplied BGRA on grids of web mercator.

    Parameters
    ----------
    frame
        See `RasterPlace`.
    """

    def __init__(self, path: Path, frame: MapFrame | None) -> None:
        import rasterio

        with ExitStack() as files:
            files.enter_context(rasterio.Env(GDAL_CACHEMAX=CACHE_MB))
            self._full = files.enter_context(rasterio.open(path))
            self._levels: dict[int, Any] = {1: self._full}
            for k, factor in enumerate(self._full.overviews(1)):
                level = files.enter_context(rasterio.open(path, overview_level=k))
                self._levels[factor] = level
            self.place = RasterPlace(self._full, path.name, frame)
            self._bands = _colour_bands(self._full)
            self.stretch = _stretch(self._full, self._levels[max(self._levels)], self._bands)
            """Per band the values that become black and white; None for 8 bit."""
            self._step = self._mesh_step()
            self._files = files.pop_all()

    def __enter__(self) -> Self:
        """Give the open picture."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self._files.close()

    def coarseness(self, pixel: float) -> float:
        """Pixels of the overview that fits best per pixel of a grid, along a side."""
        return pixel / self.place.native_pixel / self._factor(pixel)

    def valid_share(self) -> float:
        """Part of the raster's box that has pixels, from its coarsest overview."""
        coarsest = self._levels[max(self._levels)]
        scale = max(1.0, max(coarsest.width, coarsest.height) / SAMPLE)
        size = (math.ceil(coarsest.height / scale), math.ceil(coarsest.width / scale))
        return float((coarsest.dataset_mask(out_shape=size) > 0).mean())

    def may_hold(self, x: float, y: float, side: float) -> bool:
        """Whether a square may have pixels; looks at an overview, whose mask is never smaller.

        Parameters
        ----------
        x, y, side
            North-west corner and side, m of the projection.
        """
        west, south, east, north = self.place.bounds
        left, right = max(x, west), min(x + side, east)
        low, high = max(y - side, south), min(y, north)
        if left >= right or low >= high:
            return False
        nodes = np.meshgrid(np.linspace(left, right, 9), np.linspace(low, high, 9))
        at = self.place.colrow_from_mercator(np.stack(nodes, axis=-1))
        if not np.isfinite(at).all():
            return True
        ds = self._levels[self._factor(side / GLANCE)]
        at *= (ds.width / self._full.width, ds.height / self._full.height)
        # Sides may bulge between the nodes.
        margin = 2 + int(np.ptp(at, axis=(0, 1)).max() / 16)
        window = _window(at, margin, ds)
        return window is not None and bool(ds.dataset_mask(window=window).any())

    def block(self, x: float, y: float, pixel: float, side: int) -> Pixels | None:
        """Block of a grid as (side, side, 4) BGRA, colour premultiplied by alpha.

        None where the raster has nothing.

        Parameters
        ----------
        x, y
            North-west corner, m of the projection.
        pixel
            Side of a pixel, m of the projection.
        side
            px
        """
        ds = self._levels[self._factor(pixel)]
        at = self._nodes(x, y, pixel, side)
        at *= (ds.width / self._full.width, ds.height / self._full.height)
        corner = np.floor(np.nanmin(at, axis=(0, 1)))
        uv = np.ascontiguousarray(upsample(at - corner, self._step, (side, side)))
        rim = np.concatenate([uv[0], uv[-1], uv[:, 0], uv[:, -1]]) + corner
        window = _window(rim, 1, ds)
        if window is None:
            return None
        source = self._read(ds, window)
        if source is None:
            return None
        shift = corner - (window.col_off, window.row_off) - 0.5
        uv += shift.astype(np.float32)
        no_second_map: Any = None
        out = cv2.remap(source, uv, no_second_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(out, dtype=np.uint8)

    def _factor(self, pixel: float) -> int:
        """Of the coarsest overview that is at least as fine as a grid."""
        wanted = pixel / self.place.native_pixel
        return max(factor for factor in self._levels if factor <= max(wanted * 1.001, 1.0))

    def _nodes(self, x: float, y: float, pixel: float, side: int) -> Array:
        """Pixel coordinates in the middle of cells of the mesh, one cell around the block."""
        middle = (np.arange(-1, math.ceil(side / self._step) + 1) + 0.5) * self._step * pixel
        return self.place.colrow_from_mercator(
            np.stack(np.meshgrid(x + middle, y - middle), axis=-1)
        )

    def _mesh_step(self) -> int:
        """Distance of nodes at which the middles between them are near enough."""
        west, south, east, north = self.place.bounds
        pixel = self.place.native_pixel
        xs, ys = np.meshgrid(np.linspace(west, east, 5)[:-1], np.linspace(south, north, 5)[1:])
        for step in MESH_STEPS:
            along = np.array([0.0, 0.5, 1.0]) * step * pixel
            x = xs[..., None, None] + along
            y = ys[..., None, None] - along[:, None]
            at = self.place.colrow_from_mercator(np.stack(np.broadcast_arrays(x, y), axis=-1))
            corners = at[..., ::2, ::2, :].mean(axis=(-3, -2))
            if not np.nanmax(np.abs(corners - at[..., 1, 1, :])) > MESH_ERROR:
                break
        return step

    def _read(self, ds: Any, window: Any) -> Pixels | None:
        """Part of a level as premultiplied BGRA; None without valid pixels."""
        mask = ds.dataset_mask(window=window)
        if not mask.any():
            return None
        bands = [
            self._to_byte(band, i) for i, band in enumerate(ds.read(self._bands, window=window))
        ]
        blue_green_red = bands[::-1] if len(bands) == 3 else bands * 3
        out = np.asarray(cv2.merge([*blue_green_red, mask]), dtype=np.uint8)
        partly = (mask > 0) & (mask < 255)
        if partly.any():
            share = mask[partly, None].astype(np.uint16)
            out[partly, :3] = (out[partly, :3] * share + 127) // 255
        # Colour under no opacity must not bleed in.
        return np.asarray(cv2.bitwise_and(out, out, mask=mask), dtype=np.uint8)

    def _to_byte(self, band: NDArray[Any], number: int) -> Pixels:
        if self.stretch is None:
            return np.asarray(band, dtype=np.uint8)
        low, high = self.stretch[number]
        value = (np.nan_to_num(band.astype(np.float32)) - low) * (255.0 / max(high - low, 1e-9))
        return np.asarray(np.clip(np.rint(value), 0, 255), dtype=np.uint8)


def _window(at: Array, margin: int, ds: Any) -> Any:
    """Window of a raster that holds places and a margin; None outside."""
    from rasterio.windows import Window

    points = at.reshape(-1, 2)
    left, top = np.maximum(np.floor(np.nanmin(points, axis=0)).astype(int) - margin, 0)
    end = np.ceil(np.nanmax(points, axis=0)).astype(int) + margin
    right, bottom = np.minimum(end, (ds.width, ds.height))
    if right <= left or bottom <= top:
        return None
    return Window(int(left), int(top), int(right - left), int(bottom - top))


def _colour_bands(ds: Any) -> list[int]:
    """Numbers of the bands to show as red, green, blue; one band is shown in grey."""
    from rasterio.enums import ColorInterp

    kinds = list(ds.colorinterp)
    wanted = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(kind in kinds for kind in wanted):
        return [kinds.index(kind) + 1 for kind in wanted]
    plain = [i + 1 for i, kind in enumerate(kinds) if kind is not ColorInterp.alpha]
    return plain[:3] if len(plain) >= 3 else plain[:1]


def _stretch(full: Any, coarsest: Any, bands: list[int]) -> list[tuple[float, float]] | None:
    """Per band the percentiles that become black and white; None for 8 bit."""
    if all(full.dtypes[band - 1] == "uint8" for band in bands):
        return None
    scale = max(1.0, max(coarsest.width, coarsest.height) / SAMPLE)
    size = (max(1, int(coarsest.height / scale)), max(1, int(coarsest.width / scale)))
    valid = coarsest.dataset_mask(out_shape=size) > 0
    out = []
    for band in coarsest.read(bands, out_shape=(len(bands), *size)):
        values = band[valid & np.isfinite(band)]
        low, high = np.percentile(values, [DARK, BRIGHT]) if values.size else (0.0, 1.0)
        out.append((float(low), float(high)))
    return out
