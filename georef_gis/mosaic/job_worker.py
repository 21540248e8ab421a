"""A mosaic's job in a worker: read from its file, opened once, its tiles made by number."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import cv2
import numpy as np
import zstandard

import georef_gis
from georef_gis.errors import InputError
from georef_gis.model.photo import Photo
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.job import MosaicJob, PhotoRoot
from georef_gis.mosaic.tile_maker import MadeTile, TileMaker
from georef_gis.rasters.warp import ImageCache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedTile(MadeTile):
    """A tile made by a worker.

    Parameters
    ----------
    number
        Of the tile in the plan.
    broken
        Messages of all photos that this worker could not read so far.
    worker
        Name of the process's own.
    decodes
        Photos that it has decoded so far.
    """

    number: int
    broken: tuple[str, ...]
    worker: str
    decodes: int


class OpenJob:
    """A job in a worker: its mosaic, decoded photos, and the tiles that are known to come."""

    def __init__(self, job: MosaicJob, tiles: Sequence[TileTask], photos: PhotoRoot) -> None:
        # One thread a tile, as in the local run.
        cv2.setNumThreads(1)
        self.name = uuid4().hex
        self._tiles = tiles
        self._broken: list[str] = []
        self._cache = ImageCache(read=photos.read)
        self._maker = TileMaker(job, self._cache.get, self._broken)
        self._sketches: dict[int, Any] = {}
        self._lock = threading.Lock()

    def tile(self, number: int, ahead: Sequence[int]) -> RenderedTile:
        """Render a tile; `ahead` are those that this worker will as a rule be asked for next."""
        sketch = self._expect([number, *ahead])[number]
        made = self._maker.make(sketch)
        self._cache.finished(number, sketch.keys)
        return RenderedTile(
            number=number, pixels=made.pixels, whole=made.whole, shifts=made.shifts,
            broken=tuple(dict.fromkeys(self._broken)), worker=self.name,
            decodes=self._cache.decodes,
        )  # fmt: skip

    def _expect(self, numbers: Sequence[int]) -> Mapping[int, Any]:
        """Sketches of tiles; the cache is told what comes, and what will not come after all."""
        with self._lock:
            known = self._sketches
            for number in sorted(set(numbers) - set(known)):
                known[number] = sketch = self._maker.sketch(self._tiles[number])
                self._cache.announce(number, sketch.keys)
            for number in set(known) - set(numbers):
                self._cache.finished(number, known.pop(number).keys)
            return dict(known)


class _Slim(pickle.Pickler):
    """Pickler that leaves out the photos' tags: most of their bytes, and no tile needs them."""

    def reducer_override(self, obj: Any) -> Any:
        """How to pickle a value; NotImplemented = as usual."""
        if isinstance(obj, Photo) and obj.tags:
            return replace(obj, tags={}).__reduce_ex__(pickle.HIGHEST_PROTOCOL)
        return NotImplemented


def stamp() -> str:
    """Versions that a tile's pixels follow from."""
    return f"georef_gis {georef_gis.__version__}, numpy {np.__version__}, OpenCV {cv2.__version__}"


def write_job(path: Path, job: MosaicJob, tiles: Sequence[TileTask], photos: PhotoRoot) -> None:
    """Write a job for workers; it appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        file.write(f"{stamp()}\n".encode())
        with zstandard.ZstdCompressor(level=3).stream_writer(file, closefd=False) as packed:
            _Slim(packed, pickle.HIGHEST_PROTOCOL).dump((job, tuple(tiles), photos))
    part.replace(path)


def read_job(path: Path) -> tuple[MosaicJob, tuple[TileTask, ...], PhotoRoot]:
    """Read a job that `write_job` wrote.

    Raises
    ------
    InputError
        If it is not there, or was written with other versions.
    """
    try:
        with path.open("rb") as file:
            theirs = file.readline().decode().rstrip("\n")
            if theirs != stamp():
                raise InputError(
                    f"the worker has {stamp()} where the mosaic is made with {theirs}; "
                    "install the same versions on all machines"
                )
            with zstandard.ZstdDecompressor().stream_reader(file) as packed:
                found: tuple[MosaicJob, tuple[TileTask, ...], PhotoRoot] = pickle.load(packed)
    except OSError as error:
        raise InputError(
            f"the worker does not see {path} ({error.strerror}); put the project on a folder that "
            "all machines share under one path"
        ) from error
    return found


_OPEN: dict[Path, OpenJob] = {}
_OPENING = threading.Lock()


def open_job(path: Path) -> OpenJob:
    """Job of a file, opened once in a process; the one before is let go.

    Raises
    ------
    InputError
        If this process does not see what the job needs.
    """
    with _OPENING:
        found = _OPEN.get(path)
        if found is None:
            job, tiles, photos = read_job(path)
            _check_photos(job, photos)
            _OPEN.clear()
            found = _OPEN[path] = OpenJob(job, tiles, photos)
        return found


def _check_photos(job: MosaicJob, photos: PhotoRoot) -> None:
    first = photos.place(job.sources[0].photo.photo.path)
    if "://" not in first and not Path(first).parent.is_dir():
        raise InputError(
            f"the worker does not see the photos' folder {Path(first).parent}; share it under this "
            "path, or say by photos_root where workers find it"
        )


def prepare_worker(path: Path) -> None:
    """Open a job in this process before the first tile; raises what `open_job` does."""
    open_job(path)


def tile_of(path: Path, number: int, ahead: Sequence[int]) -> RenderedTile:
    """Tile of a job by its number in the plan, in any process that sees the job's file."""
    return open_job(path).tile(number, ahead)
