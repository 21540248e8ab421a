"""Tiles of a map as pictures for a screen, from the file's own pyramid and on its own grid."""

from __future__ import annotations

import os
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import _dataset, _one_line
from georef_gis.rasters.screen import EMPTY_TILE, ScreenPicture, Stretch, encode, stretch_of

# px, where a file has no tiles of its own
_TILE = 512
# files open at once: GDAL's handles may not be shared between threads
_HANDLES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPyramid:
    """Grid of the tiles of a map.

    Parameters
    ----------
    transform
        Grid to map, (0, 0) = outer corner, CRS units per px, of level 0.
    levels
        (factor, width, height) of each level: its pixel as a multiple of the finest, and px.
    tile_size
        px.
    """

    transform: Transform
    levels: tuple[tuple[int, int, int], ...]
    tile_size: int

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, south, east, north, CRS units."""
        a, _, c, _, e, f = self.transform
        _, width, height = self.levels[0]
        return c, f + e * height, c + a * width, f


class MapTiles:
    """A map that is open for tiles; may be asked by several threads.

    Raises
    ------
    InputError
        If it cannot be read as a raster, or is not north up.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._stamp = _stamp(self.path)
        self._handles: queue.LifoQueue[_Levels | None] = queue.LifoQueue()
        for _ in range(_HANDLES):
            self._handles.put(None)
        with self._levels() as levels:
            self.pyramid = levels.pyramid(self.path.name)
            self._stretch = levels.stretch()

    @property
    def is_current(self) -> bool:
        """Whether the file is still the one that was opened."""
        return _stamp(self.path) == self._stamp

    def tile(self, level: int, col: int, row: int) -> ScreenPicture:
        """Picture of a tile; empty outside the map.

        Raises
        ------
        InputError
            If there is no such level, or the file is damaged there.
        """
        if not 0 <= level < len(self.pyramid.levels):
            raise InputError(f"no level {level} px; it has {len(self.pyramid.levels)}",
                             source=self.path.name)  # fmt: skip
        size = self.pyramid.tile_size
        _, width, height = self.pyramid.levels[level]
        left, top = col * size, row * size
        if col < 0 or row < 0 or left >= width or top >= height:
            return EMPTY_TILE
        window = (left, top, min(size, width - left), min(size, height - top))
        with self._levels() as levels:
            samples, valid = levels.read(level, window, self.path.name)
        return encode(self._stretch.applied(samples), valid, (size, size))

    def close(self) -> None:
        """Close the file."""
        while True:
            try:
                levels = self._handles.get_nowait()
            except queue.Empty:
                return
            if levels is not None:
                levels.close()

    @contextmanager
    def _levels(self) -> Iterator[_Levels]:
        levels = self._handles.get()
        try:
            if levels is None:
                levels = _Levels(self.path)
            yield levels
        finally:
            self._handles.put(levels)


class _Levels:
    """The open levels of a raster, for one thread at a time."""

    def __init__(self, path: Path) -> None:
        import rasterio

        with _dataset(path) as dataset:
            factors = dataset.overviews(1)
        self.open: list[Any] = [rasterio.open(path)]
        self.open += [rasterio.open(path, overview_level=k) for k in range(len(factors))]
        self.factors = (1, *factors)
        kinds = [kind.name for kind in self.open[0].colorinterp]
        colours = [k + 1 for k, kind in enumerate(kinds) if kind != "alpha"]
        self.bands = colours[:3] if len(colours) >= 3 else colours[:1]

    def close(self) -> None:
        for dataset in self.open:
            dataset.close()

    def pyramid(self, name: str) -> MapPyramid:
        a, b, c, d, e, f = tuple(self.open[0].transform)[:6]
        if self.open[0].transform.is_identity or b != 0.0 or d != 0.0 or a <= 0.0 or e >= 0.0:
            raise InputError("is not a north-up map; give a GeoTIFF", source=name)
        block = self.open[0].block_shapes[0]
        square = block[0] == block[1] and 128 <= block[0] <= 1024
        return MapPyramid(
            transform=(a, b, c, d, e, f),
            levels=tuple(
                (factor, dataset.width, dataset.height)
                for factor, dataset in zip(self.factors, self.open, strict=True)
            ),
            tile_size=block[0] if square else _TILE,
        )

    def stretch(self) -> Stretch:
        """Shades of the screen by the coarsest level."""
        coarsest = self.open[-1]
        side = max(coarsest.width, coarsest.height)
        shrink = max(1, -(-side // 1024))
        shape = (max(1, coarsest.height // shrink), max(1, coarsest.width // shrink))
        samples = coarsest.read(self.bands, out_shape=(len(self.bands), *shape))
        valid = coarsest.dataset_mask(out_shape=shape) > 0
        return stretch_of(np.moveaxis(samples, 0, 2), valid)

    def read(
        self, level: int, window: tuple[int, int, int, int], name: str
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Samples (rows, cols, bands) and where they are valid (rows, cols)."""
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as GdalWindow

        dataset, part = self.open[level], GdalWindow(*window)
        try:
            samples = dataset.read(self.bands, window=part)
            valid = dataset.dataset_mask(window=part) > 0
        except RasterioError as error:
            raise InputError(
                f"cannot be read at {window} px ({_one_line(error)}); make it again", source=name
            ) from error
        if samples.dtype.kind == "f":
            valid &= np.isfinite(samples).all(axis=0)
        return np.moveaxis(samples, 0, 2), valid


def _stamp(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", source=path.name) from error
    return status.st_mtime_ns, status.st_size
