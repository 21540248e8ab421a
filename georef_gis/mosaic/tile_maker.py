"""Tiles of a mosaic with what is to be known of them: how seams meet, whether a photo was lost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError
from georef_gis.model.grid import Window
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.job import MosaicJob, Read, checked_reader
from georef_gis.mosaic.seam_mismatch import Shift, Squares, Values
from georef_gis.rasters.warp import Image, Mask


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MadeTile:
    """A tile.

    Parameters
    ----------
    pixels
        Pixels (rows, cols, bands) and mask; None where no photo shows it.
    whole
        Whether all photos that may show it could be read so far.
    shifts
        How far photos lie apart at the places on seams in it.
    """

    pixels: tuple[Image, Mask | None] | None
    whole: bool
    shifts: tuple[Shift, ...]


class TileMaker:
    """Makes the tiles of a job; threads may share it.

    Parameters
    ----------
    read
        `read(path, reduce) -> image` (rows, cols, bands), as a rule from a cache.
    broken
        Takes the messages of photos that cannot be read.
    """

    def __init__(self, job: MosaicJob, read: Read, broken: list[str]) -> None:
        self._job, self._get = job, read
        self._lost: set[Path] = set()
        self._paths = {source.photo.id: source.photo.photo.path for source in job.sources}
        self._mosaic: Any = job.open(self._read, broken)
        self._checked = checked_reader(self._read, job.kind)

    def sketch(self, task: TileTask) -> Any:
        """Geometry of a tile. Cheap, reads no photo."""
        return self._mosaic.sketch(task)

    def make(self, sketch: Any) -> MadeTile:
        """Make a sketched tile, and measure its seams while their photos are at hand."""
        task: TileTask = sketch.task
        pixels = self._mosaic.render(sketch)
        shifts = () if pixels is None else self._shifts(task.window)
        whole = not any(self._paths.get(photo) in self._lost for photo in task.photo_ids)
        return MadeTile(pixels=pixels, whole=whole, shifts=shifts)

    def _read(self, path: Path, reduce: int) -> Image:
        """Pixels of a photo; one that cannot be read is noted: it may be there another time."""
        try:
            return self._get(path, reduce)
        except InputError:
            self._lost.add(path)
            raise

    def _shifts(self, window: Window) -> tuple[Shift, ...]:
        """How far photos lie apart at the places on seams in a window."""
        job = self._job
        if job.probe is None:
            return ()
        squares = Squares(job.sources, job.ground, job.grid, self._checked)

        def paint(label: int, square: Window) -> Values | None:
            if job.sources[label].photo.photo.path in self._lost:
                return None
            try:
                return squares.of(label, square)
            except InputError:
                return None

        return job.probe.measure(window, paint)
