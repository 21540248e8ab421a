"""What the tiles of a mosaic are made from, as one value for other processes and machines."""

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
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import Photo
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.nadir import MosaicSource, NadirMosaic
from georef_gis.mosaic.seam_mismatch import MismatchProbe
from georef_gis.mosaic.seamed import ColourField, SeamMosaic, Seams
from georef_gis.mosaic.tile_maker import MadeTile, Read, TileMaker, checked_reader
from georef_gis.rasters.reading import decode_image, read_image
from georef_gis.rasters.warp import Image, ImageCache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MosaicJob:
    """All that tiles follow from; can be pickled.

    Parameters
    ----------
    sources
        The photos, in the order that labels of the seams count.
    gsd : m
    kind
        Number and type of the bands; other photos are refused.
    seams
        Which photo has which ground; None = the photo with the nearest nadir.
    field
        What is done to grey values along seams; None leaves them.
    probe
        Where on the seams photos are compared; None = nowhere.
    """

    sources: tuple[MosaicSource, ...]
    ground: Ground
    grid: Grid
    gsd: float
    kind: tuple[int, str]
    seams: Seams | None = None
    field: ColourField | None = None
    probe: MismatchProbe | None = None

    def open(self, read: Read, broken: list[str]) -> NadirMosaic | SeamMosaic:
        """Who makes the tiles; `broken` takes the messages of photos that cannot be read."""
        read = checked_reader(read, self.kind)
        if self.seams is None:
            sources = {source.photo.id: source for source in self.sources}
            return NadirMosaic(
                sources, self.ground, self.grid, gsd=self.gsd, read=read, broken=broken
            )
        return SeamMosaic(
            self.sources, self.ground, self.grid, seams=self.seams, field=self.field, read=read,
            broken=broken,
        )  # fmt: skip


def read_photo(path: Path | str, reduce: int) -> Image:
    """Pixels of a photo of a mosaic: its alpha channel is no band.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    return read_image(path, reduce=reduce, alpha=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoRoot:
    """Where workers find the photos.

    Parameters
    ----------
    here
        Folder of all photos on the machine that knows the project.
    there
        The same folder as workers see it, or a URL that fsspec opens, such as s3://bucket/photos;
        empty = the same path.
    """

    here: Path
    there: str = ""

    def place(self, path: Path) -> str:
        """Path or URL of a photo for workers; a photo beside the folder stays where it is."""
        if not self.there or not path.is_relative_to(self.here):
            return str(path)
        return "/".join([self.there.rstrip("/\\"), *path.relative_to(self.here).parts])

    def read(self, path: Path, reduce: int) -> Image:
        """Pixels of a photo, as `read_photo` gives them.

        Raises
        ------
        InputError
            If it cannot be read; as of the photo on a local disk.
        """
        place = self.place(path)
        if "://" not in place:
            return read_photo(place, reduce)
        return decode_image(_fetched(place, path.name), path.name, reduce=reduce, alpha=False)


def _fetched(url: str, name: str) -> bytes:
    """Bytes behind a URL."""
    import fsspec

    try:
        with fsspec.open(url, "rb") as file:
            return bytes(file.read())
    except ImportError as error:
        scheme = url.partition("://")[0]
        raise InputError(
            f"{scheme}:// needs a package on the workers ({error}); install it there", source=name
        ) from error
    except Exception as error:  # every object storage has errors of its own
        told = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"cannot be read ({told}); check photos_root", source=name) from error


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
