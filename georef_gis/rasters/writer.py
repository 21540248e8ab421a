"""Tiled writer of Cloud Optimised GeoTIFFs that builds overviews while tiles arrive.

The file is laid out as GDAL's COG driver does it: directories first, then the tiles of the
coarsest overview up to those of the full resolution, each tile followed by its mask.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import ExportError
from georef_gis.rasters import files
from georef_gis.rasters.codecs import Encoder
from georef_gis.rasters.directories import cog_head
from georef_gis.rasters.geokeys import geo_tags
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Tile, halve, join, levels
from georef_gis.rasters.spool import LevelSpool, QuarterStore, Spilled

logger = logging.getLogger(__name__)

# bytes of halved tiles kept in memory; more of them wait on disk
_WAITING_LIMIT = 48 << 20
# tiles in flight for each worker thread
_QUEUE = 2

_Quarters = list[Tile | Spilled | None]


class TiledWriter:
    """Writes one raster from tiles in any order; a context manager.

    The file appears whole when the context ends, or not at all after an exception.
    Its bytes depend on the tiles only, not on their order or the number of workers.

    Parameters
    ----------
    path
        File to write; an older one is replaced at the end.
    profile
        What the file is.
    overviews
        Build overviews, each half the size of the one before, down to 512 px.
    workers
        Threads that encode; 1 encodes in the caller's thread.
    bigtiff
        True or False to force the kind of TIFF; None chooses BigTIFF when 4 GB are not enough.

    Raises
    ------
    ExportError
        If the target cannot be written, here or later.
    CrsError
        If a GeoTIFF cannot hold the CRS.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        profile: RasterProfile,
        *,
        overviews: bool = True,
        workers: int = 1,
        bigtiff: bool | None = None,
    ) -> None:
        if workers < 1:
            raise ValueError(f"workers {workers}: must be at least 1")
        self.path = files.resolve_target(path)
        self.profile = profile
        self.levels = levels(profile.width, profile.height, profile.tile_size, overviews=overviews)
        self._bigtiff = bigtiff
        # made now, so that a CRS that does not fit is refused before the work
        self._geo = geo_tags(profile)
        self._encoder = Encoder(profile)
        self._lock = threading.Lock()
        self._seen = np.zeros((self.levels[0].down, self.levels[0].across), np.bool_)
        self._waiting: list[dict[tuple[int, int], _Quarters]] = [{} for _ in self.levels]
        self._missing: list[dict[tuple[int, int], int]] = [{} for _ in self.levels]
        self._futures: set[Future[None]] = set()
        self._open = True
        self._failure: BaseException | None = None
        self._resources = ExitStack()
        with files.export_errors(self.path, lambda: 0), ExitStack() as opened:
            files.remove_stale(self.path)
            self._spools = [LevelSpool(level, self.path) for level in self.levels]
            for spool in self._spools:
                opened.callback(spool.close)
            self._quarters = QuarterStore(self.path, _WAITING_LIMIT)
            opened.callback(self._quarters.close)
            self._resources = opened.pop_all()
        self._workers = workers
        self._pool: ThreadPoolExecutor | None = None
        if workers > 1:
            self._pool = ThreadPoolExecutor(workers, thread_name_prefix="tiles")

    def __enter__(self) -> Self:
        """Start writing."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file, or leave nothing if the body failed."""
        if kind is None:
            self.close()
        else:
            self.abort()

    @property
    def tile_rows(self) -> int:
        """Rows of full-resolution tiles."""
        return self.levels[0].down

    @property
    def tile_cols(self) -> int:
        """Columns of full-resolution tiles."""
        return self.levels[0].across

    def tile_shape(self, row: int, col: int) -> tuple[int, int]:
        """Rows and columns of pixels of a tile, fewer at the right and bottom edge."""
        self._check_index(row, col)
        return self.levels[0].shape(row, col)

    def write_tile(
        self, row: int, col: int, data: NDArray[Any], mask: NDArray[Any] | None = None
    ) -> None:
        """Write one tile of the full resolution, once.

        Parameters
        ----------
        row, col
            Place in the grid of tiles, (0, 0) upper left.
        data : shape (rows, cols, bands), or (rows, cols) for one band
            Samples, RGB order; a whole tile, or cropped at the right or bottom edge.
        mask : shape (rows, cols)
            Not 0 = valid; None = valid everywhere (with nodata: where data differ from it).

        Raises
        ------
        ValueError
            If the tile lies outside, has been written before, or has an unfit shape or dtype.
        ExportError
            If the disk is full or refuses.
        """
        tile = self._checked(row, col, data, mask)
        self._claim(row, col)
        if self._pool is None:
            self._guarded(self._finish, 0, row, col, tile)
        elif tile is None:
            self._submit(0, row, col, None)
        else:
            # the caller may use its arrays again before a worker has read them
            own = tile.mask if tile.mask is None else tile.mask.copy()
            self._submit(0, row, col, Tile(data=tile.data.copy(), mask=own))

    def skip_tile(self, row: int, col: int) -> None:
        """Declare a tile empty, so that overviews above it need not wait until the end."""
        self._check_index(row, col)
        self._claim(row, col)
        self._guarded(self._finish, 0, row, col, None)

    def close(self) -> None:
        """Finish the overviews and put the file in its place."""
        if not self._open:
            return
        try:
            self._check_failure()
            self._drain(0)
            self._finish_rest()
            self._assemble()
        finally:
            self._release()

    def abort(self) -> None:
        """Drop everything; the target stays as it was."""
        self._release()

    def _release(self) -> None:
        self._open = False
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._futures.clear()
        self._resources.close()
        self._waiting.clear()

    def _claim(self, row: int, col: int) -> None:
        with self._lock:
            self._check_failure()
            if not self._open:
                raise ValueError(f"{self.path}: tile ({row}, {col}) after the writer was closed")
            if self._seen[row, col]:
                raise ValueError(f"tile ({row}, {col}) has been written before")
            self._seen[row, col] = True

    def _check_failure(self) -> None:
        if self._failure is not None:
            raise ExportError(
                f"{self.path}: not written, an earlier tile failed ({self._failure})"
            ) from self._failure

    def _check_index(self, row: int, col: int) -> None:
        if not (0 <= row < self.tile_rows and 0 <= col < self.tile_cols):
            raise ValueError(
                f"tile ({row}, {col}) lies outside {self.tile_rows} x {self.tile_cols} tiles"
            )

    def _checked(
        self, row: int, col: int, data: NDArray[Any], mask: NDArray[Any] | None
    ) -> Tile | None:
        """The tile in the form used inside; None if nothing in it is valid."""
        shape = (*self.tile_shape(row, col), self.profile.bands)
        if data.shape == shape[:2] and self.profile.bands == 1:
            data = data[:, :, None]
        if data.shape != shape or data.dtype != self.profile.dtype:
            raise ValueError(
                f"tile ({row}, {col}): {data.dtype} of shape {data.shape}, "
                f"not {self.profile.dtype} of shape {shape}"
            )
        if mask is None:
            if self.profile.nodata is None:
                return Tile(data=np.ascontiguousarray(data), mask=None)
            mask = _present(data, self.profile.nodata)
        elif self.profile.validity == "none":
            raise ValueError("a mask for a raster whose profile has validity none")
        if mask.shape != shape[:2]:
            raise ValueError(f"tile ({row}, {col}): mask of shape {mask.shape}, not {shape[:2]}")
        valid = mask != 0
        if valid.all():
            return Tile(data=np.ascontiguousarray(data), mask=None)
        if not valid.any():
            return None
        return Tile(data=np.ascontiguousarray(data), mask=valid.view(np.uint8))

    def _guarded(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run a step; after a failure the writer takes no more tiles."""
        try:
            with files.export_errors(self.path, self._needed):
                step(*arguments)
        except BaseException as error:
            with self._lock:
                self._failure = self._failure or error
            raise

    def _needed(self) -> int:
        """Bytes the final file takes if no more tiles come."""
        return sum(spool.size for spool in self._spools)

    def _submit(self, number: int, row: int, col: int, tile: Tile | None) -> None:
        if self._pool is None:
            self._guarded(self._finish, number, row, col, tile)
            return
        self._drain(_QUEUE * self._workers - 1)
        self._futures.add(self._pool.submit(self._guarded, self._finish, number, row, col, tile))

    def _drain(self, left: int) -> None:
        """Wait until at most this number of tiles is in flight; raise what a worker met."""
        while len(self._futures) > left:
            done, self._futures = wait(self._futures, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()

    def _finish(self, number: int, row: int, col: int, tile: Tile | None) -> None:
        """Encode a tile and every overview tile it completes."""
        while True:
            half = None
            if tile is not None:
                half = self._store(number, row, col, tile)
            number, quarter = number + 1, 2 * (row % 2) + col % 2
            row, col = row // 2, col // 2
            if number == len(self.levels):
                return
            quarters = self._arrived(number, row, col, quarter, half)
            if quarters is None:
                return
            tile = self._joined(number, row, col, quarters)

    def _store(self, number: int, row: int, col: int, tile: Tile) -> Tile | None:
        """Encode and keep a tile; its half if there is a coarser level."""
        image = self._encoder.image(tile)
        mask = self._encoder.mask(tile) if self.profile.validity == "mask" else None
        spool = self._spools[number]
        with self._lock:
            index = row * spool.level.across + col
            spool.add(index, image, mask, partial=tile.mask is not None)
        return halve(tile) if number + 1 < len(self.levels) else None

    def _arrived(
        self, number: int, row: int, col: int, quarter: int, half: Tile | None
    ) -> _Quarters | None:
        """Keep a quarter of an overview tile; all its quarters if this was the last."""
        with self._lock:
            key = row, col
            missing = self._missing[number]
            if key not in missing:
                below = self.levels[number - 1]
                rows, cols = min(2, below.down - 2 * row), min(2, below.across - 2 * col)
                missing[key] = rows * cols
            missing[key] -= 1
            if half is not None:
                quarters = self._waiting[number].setdefault(key, [None] * 4)
                quarters[quarter] = self._quarters.put(half)
            if missing[key]:
                return None
            del missing[key]
            return self._take(self._waiting[number].pop(key, [None] * 4))

    def _take(self, quarters: _Quarters) -> _Quarters:
        return [kept if kept is None else self._quarters.take(kept) for kept in quarters]

    def _joined(self, number: int, row: int, col: int, quarters: _Quarters) -> Tile | None:
        tiles = [kept if isinstance(kept, Tile) else None for kept in quarters]
        like = next((kept.data for kept in tiles if kept is not None), None)
        if like is None:
            return None
        shape = self.levels[number].shape(row, col)
        return join(tiles, shape, self.profile.tile_size // 2, like)

    def _finish_rest(self) -> None:
        """Make the overview tiles that still wait for tiles which never came."""
        for number in range(1, len(self.levels)):
            with self._lock:
                self._missing[number].clear()
                keys = sorted(self._waiting[number])
            for row, col in keys:
                with self._lock:
                    quarters = self._take(self._waiting[number].pop((row, col)))
                self._submit(number, row, col, self._joined(number, row, col, quarters))
            self._drain(0)

    def _assemble(self) -> None:
        """Write the file from the spooled tiles, coarsest level first."""
        masks = self.profile.validity == "mask" and (
            self._spools[0].partial or not self._spools[0].image_sizes.all()
        )
        head, size = cog_head(
            self.profile,
            self._spools,
            geo=self._geo,
            jpeg_tables=self._encoder.jpeg_tables,
            masks=masks,
            bigtiff=self._bigtiff,
        )
        with files.export_errors(self.path, lambda: size):
            files.check_space(self.path, size)
            with files.whole_file(self.path) as stream:
                stream.write(head)
                for spool in reversed(self._spools):
                    for chunk in spool.chunks(masks=masks):
                        stream.write(chunk)
        logger.debug("%s: %d bytes in %d levels", self.path, size, len(self.levels))


def _present(data: NDArray[Any], nodata: float) -> NDArray[np.bool_]:
    """Where at least one band differs from nodata, shape (rows, cols)."""
    differs = ~np.isnan(data) if np.isnan(nodata) else data != data.dtype.type(nodata)
    return np.asarray(differs.any(axis=2), dtype=np.bool_)
