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
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import ExportError
from georef_gis.rasters import files
from georef_gis.rasters.directories import cog_head
from georef_gis.rasters.geokeys import geo_tags
from georef_gis.rasters.ledger import Place, remarks
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Tile, levels
from georef_gis.rasters.pyramid_builder import PyramidBuilder, Step
from georef_gis.rasters.spool import Backing, Scratch
from georef_gis.rasters.work_folder import Resumption, WorkFolder

logger = logging.getLogger(__name__)

# tiles in flight for each worker thread
_QUEUE = 2


class TiledWriter:
    """Writes one raster from tiles in any order; a context manager.

    The file appears whole when the context ends, or not at all after an exception.
    Its bytes depend on the tiles only, not on their order or the number of workers.

    With `resume` and `work` the finished tiles outlive an exception, the process and the machine:
    a later writer with the same key and profile goes on, and its file is the same to the byte.

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
    resume
        Fingerprint of what is written: photos, poses, settings. Work kept under another one, or
        for another profile, is dropped.
    work
        Folder that keeps finished tiles until the file is in its place; made if there is none.

    Attributes
    ----------
    done : shape (tile_rows, tile_cols)
        Tiles an earlier run has finished, empty ones included; they must not be written again.
    resumption
        How much that was, and whether something of it was of no use.
    notes
        What an earlier run noted of tiles that are done, by row and column.

    Raises
    ------
    ExportError
        If the target cannot be written, here or later, or another process is writing it.
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
        resume: str | None = None,
        work: Path | None = None,
    ) -> None:
        if workers < 1:
            raise ValueError(f"workers {workers}: must be at least 1")
        if (resume is None) != (work is None):
            raise ValueError("resume and work go together: a key and the folder that keeps tiles")
        self.path = files.resolve_target(path)
        self.profile = profile
        self.levels = levels(profile.width, profile.height, profile.tile_size, overviews=overviews)
        self._bigtiff = bigtiff
        # made now, so that a CRS that does not fit is refused before the work
        self._geo = geo_tags(profile)
        self._lock = threading.Lock()
        self.resumption = Resumption()
        self.notes: dict[tuple[int, int], Any] = {}
        self._work = work
        self._seen = np.zeros((self.levels[0].down, self.levels[0].across), np.bool_)
        self._futures: set[Future[None]] = set()
        self._open = True
        self._failure: BaseException | None = None
        self._resources = ExitStack()
        with files.export_errors(self.path, lambda: 0, folder=work), ExitStack() as opened:
            files.remove_stale(self.path)
            self._open_files(opened, resume or "")
            self._resources = opened.pop_all()
        self.done = self._seen.copy()
        self._workers = workers
        self._pool: ThreadPoolExecutor | None = None
        if workers > 1:
            self._pool = ThreadPoolExecutor(workers, thread_name_prefix="tiles")

    def _open_files(self, opened: ExitStack, key: str) -> None:
        """Open what keeps the tiles, and take over what an earlier run left."""
        kept = None
        if self._work is not None:
            kept = WorkFolder(self._work, self.path, key, profile=self.profile, levels=self.levels)
        self._backing: Backing = kept or Scratch(self.path)
        opened.callback(self._backing.close)
        self._builder = PyramidBuilder(self.profile, self.levels, self._backing)
        opened.callback(self._builder.close)
        self._builder.open()
        if kept is not None:
            self.resumption = self._builder.recover(kept)
            self._seen[:] = kept.ledger.resolved
            self.notes = kept.ledger.notes

    def __enter__(self) -> Self:
        """Start writing."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file, or leave nothing, or what can be resumed, if the body failed."""
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
        self,
        row: int,
        col: int,
        data: NDArray[Any],
        mask: NDArray[Any] | None = None,
        *,
        note: Any = None,
        provisional: bool = False,
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
        note
            What a later writer that goes on is to know of the tile (`notes`); anything JSON holds.
        provisional
            The tile is good for this file only: a later writer that goes on makes it again.

        Raises
        ------
        ValueError
            If the tile lies outside, has been written before, or has an unfit shape or dtype.
        ExportError
            If the disk is full or refuses.
        """
        tile = self._checked(row, col, data, mask)
        self._claim(row, col)
        step = Step(records=remarks(row, col, note, provisional=provisional))
        self._submit((0, row, col), tile, step)

    def skip_tile(self, row: int, col: int, *, provisional: bool = False) -> None:
        """Declare a tile empty, so that overviews above it need not wait until the end.

        A `provisional` one is empty in this file only, as of `write_tile`.
        """
        self._check_index(row, col)
        self._claim(row, col)
        step = Step(records=remarks(row, col, None, provisional=provisional))
        self._guarded(self._builder.finish, (0, row, col), None, step)

    def close(self) -> None:
        """Finish the overviews and put the file in its place."""
        if not self._open:
            return
        try:
            self._check_failure()
            self._drain(0)
            self._finish_rest()
            self._assemble()
            self._backing.remove()
        finally:
            self._release()

    def abort(self, *, keep: bool = True) -> None:
        """Stop; the target stays as it was.

        Parameters
        ----------
        keep
            Keep what a later writer may go on with, if this one has a key; else drop everything.
        """
        if self._open:
            self._stop_workers()
            if not keep:
                self._backing.remove()
        self._release()

    def _stop_workers(self) -> None:
        self._open = False
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._futures.clear()

    def _release(self) -> None:
        self._stop_workers()
        self._resources.close()

    def _claim(self, row: int, col: int) -> None:
        with self._lock:
            self._check_failure()
            if not self._open:
                raise ValueError(f"{self.path}: tile ({row}, {col}) after the writer was closed")
            if self._seen[row, col]:
                raise ValueError(f"tile ({row}, {col}) has been written before")
            self._seen[row, col] = True

    def _check_failure(self) -> None:
        if isinstance(self._failure, ExportError):
            raise ExportError(str(self._failure)) from self._failure
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
                return Tile(data=self._own(data), mask=None)
            mask = _present(data, self.profile.nodata)
        elif self.profile.validity == "none":
            raise ValueError("a mask for a raster whose profile has validity none")
        if mask.shape != shape[:2]:
            raise ValueError(f"tile ({row}, {col}): mask of shape {mask.shape}, not {shape[:2]}")
        valid = mask != 0
        if valid.all():
            return Tile(data=self._own(data), mask=None)
        if not valid.any():
            return None
        return Tile(data=self._own(data), mask=valid.view(np.uint8))

    def _own(self, data: NDArray[Any]) -> NDArray[Any]:
        """The samples row by row; a copy if the caller may use its array again before a worker."""
        return np.ascontiguousarray(data) if self._pool is None else np.array(data, order="C")

    def _guarded(self, step: Callable[..., None], *arguments: Any) -> None:
        """Run a step; after a failure the writer takes no more tiles."""
        try:
            with self._refusals():
                step(*arguments)
        except BaseException as error:
            with self._lock:
                self._failure = self._failure or error
            raise

    def _refusals(self) -> AbstractContextManager[None]:
        """Turn a refusal of the disk the tiles are on into an error of one line."""
        return files.export_errors(
            self.path, self._needed, folder=self._work, kept=self._work is not None
        )

    def _needed(self) -> int:
        """Bytes that the final file takes on the disk of the tiles if no more of them come."""
        known = self._work is None or files.same_disk(self._work, self.path.parent)
        return self._builder.size if known else 0

    def _submit(self, place: Place, tile: Tile | None, step: Step | None = None) -> None:
        if self._pool is None:
            self._guarded(self._builder.finish, place, tile, step)
            return
        self._drain(_QUEUE * self._workers - 1)
        job = self._pool.submit(self._guarded, self._builder.finish, place, tile, step)
        self._futures.add(job)

    def _drain(self, left: int) -> None:
        """Wait until at most this number of tiles is in flight; raise what a worker met."""
        while len(self._futures) > left:
            done, self._futures = wait(self._futures, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()

    def _finish_rest(self) -> None:
        """Make the overview tiles that still wait for tiles which never came."""
        self._guarded(self._builder.no_more)
        for level in range(1, len(self.levels)):
            for key in self._builder.incomplete(level):
                with self._refusals():
                    step, tile = self._builder.taken(level, key)
                self._submit((level, *key), tile, step)
            self._drain(0)

    def _assemble(self) -> None:
        """Write the file from the spooled tiles, coarsest level first."""
        masks = self.profile.validity == "mask" and (
            self._builder.spools[0].partial or not self._builder.spools[0].image_sizes.all()
        )
        head, size = cog_head(
            self.profile,
            self._builder.spools,
            geo=self._geo,
            jpeg_tables=self._builder.jpeg_tables,
            masks=masks,
            bigtiff=self._bigtiff,
        )
        self._builder.drop_halves()
        lasting = self._work is not None
        folder = self.path.parent if lasting else None
        with files.export_errors(self.path, lambda: size, folder=folder, kept=lasting):
            files.check_space(self.path, size)
            with files.whole_file(self.path) as stream:
                stream.write(head)
                for spool in reversed(self._builder.spools):
                    for chunk in spool.chunks(masks=masks):
                        stream.write(chunk)
        logger.debug("%s: %d bytes in %d levels", self.path, size, len(self.levels))


def _present(data: NDArray[Any], nodata: float) -> NDArray[np.bool_]:
    """Where at least one band differs from nodata, shape (rows, cols)."""
    differs = ~np.isnan(data) if np.isnan(nodata) else data != data.dtype.type(nodata)
    return np.asarray(differs.any(axis=2), dtype=np.bool_)
