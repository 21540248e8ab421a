"""A raster seen in web mercator: blocks of 8-bit colour with alpha, from the overview that fits."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from exports.tiles.open_raster import OpenRaster
from exports.tiles.raster_colour import SAMPLE, colour_bands, premultiplied, stretches
from exports.tiles.web_mercator import RasterPlace
from georef_gis.rasters.warp import upsample

if TYPE_CHECKING:
    from pathlib import Path

    from exports.tiles.raster_colour import Pixels
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame

# px; between nodes the transformation is taken as linear, more finely where that is too coarse
MESH_STEPS = (64, 32, 16, 8, 4)
# px of the raster; of the mesh between its nodes, a tenth of what remap rounds to at worst
MESH_ERROR = 0.03
# MB; some rows of tiles, so that neighbouring blocks do not decode them twice
CACHE_MB = 128
# px; side in which an overview shows a tile whose emptiness is asked for
GLANCE = 128


class WebPicture(OpenRaster):
    """A raster in any CRS, read as premultiplied BGRA on grids of web mercator.

    Parameters
    ----------
    frame
        See `RasterPlace`.
    """

    def __init__(self, path: Path, frame: MapFrame | None) -> None:
        super().__init__(path, CACHE_MB)
        with ExitStack() as on_error:
            on_error.callback(self.close)
            self.place = RasterPlace(self.full, path.name, frame)
            self._bands = colour_bands(self.full)
            eight_bit = all(self.full.dtypes[band - 1] == "uint8" for band in self._bands)
            self.stretch = None if eight_bit else stretches(self.coarsest, self._bands)
            """Per band the values that become black and white; None for 8 bit."""
            self._step = self._mesh_step()
            on_error.pop_all()

    def coarseness(self, pixel: float) -> float:
        """Pixels of the overview that fits best per pixel of a grid, along a side."""
        return pixel / self.place.native_pixel / self._factor(pixel)

    def valid_share(self) -> float:
        """Part of the raster's box that has pixels, from its coarsest overview."""
        coarsest = self.coarsest
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
        ds = self.levels[self._factor(side / GLANCE)]
        at *= (ds.width / self.full.width, ds.height / self.full.height)
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
        ds = self.levels[self._factor(pixel)]
        at = self._nodes(x, y, pixel, side)
        at *= (ds.width / self.full.width, ds.height / self.full.height)
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
        return self.factor_for(pixel / self.place.native_pixel)

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
        return premultiplied(ds.read(self._bands, window=window), mask, self.stretch)


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
