"""A map averaged onto the cells of a grid, once, in a file: what follows reads it many times.

Windows of a map that is warped as it is read cost as much again with every pass over the site.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import ExportError
from georef_gis.rasters.files import lock
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import UNMOVED, Bands, MapHeader, open_bands_on

# cells of a block that is warped at once: GDAL takes far longer for blocks beyond its memory
_BLOCK = 1024
# bands that are compared where a map has so many, else the first
_COLOURS = 3
# folders of files of a comparison, and the file in one that is locked while it is in use
_PREFIX, _LOCK = "change_", "in_use"
# s; a folder younger than this may not be locked yet, one older than a day without a lock was never
_YOUNG, _OLD = 60.0, 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CellMap:
    """A map on cells.

    Parameters
    ----------
    name
        Of the map's file.
    samples, shown
        Files of the samples, shape (rows, cols, bands), and of where they have a value, (rows,
        cols).
    dtype
        Of the samples.
    shape
        Rows, columns, bands.
    start
        Column and row of the grid that the first cell kept is at; negative outside of it.
    placed
        Cell of the grid, (0, 0) = outer corner -> cell where the map, placed as it says, shows what
        is kept for it.
    """

    name: str
    samples: Path
    shown: Path
    dtype: str
    shape: tuple[int, int, int]
    start: tuple[int, int]
    placed: Transform

    def read(self, window: Window) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """A window of the grid, which may reach beyond it; without a value there."""
        col, row, width, height = window
        samples = np.zeros((height, width, self.shape[2]), self.dtype)
        valid = np.zeros((height, width), np.bool_)
        # opened anew, so that what was read does not stay in the memory
        files = (
            (np.memmap(self.samples, self.dtype, "r", shape=self.shape), samples),
            (np.memmap(self.shown, np.bool_, "r", shape=self.shape[:2]), valid),
        )
        c0, r0 = col - self.start[0], row - self.start[1]
        left, top = max(c0, 0), max(r0, 0)
        right, bottom = min(c0 + width, self.shape[1]), min(r0 + height, self.shape[0])
        if left < right and top < bottom:
            for file, out in files:
                out[top - r0 : bottom - r0, left - c0 : right - c0] = file[top:bottom, left:right]
        return samples, valid


def band_numbers(header: MapHeader) -> list[int]:
    """Bands that are compared: three colours, or the first of fewer."""
    return [1, 2, 3] if len(header.bands) >= _COLOURS else [1]


def average_map(
    path: Path, header: MapHeader, target: Path, *, area: Window | None = None,
    placed: Transform = UNMOVED, step: Callable[[float], None] = lambda _: None,
) -> CellMap:  # fmt: skip
    """Average a map onto the cells of a grid.

    Parameters
    ----------
    header
        Of the grid.
    target
        Path of the files to write, less their endings.
    area
        Cells that are kept, which may lie outside of the grid; by default the grid.
    placed
        Cell of the grid -> cell where the map shows what is to be kept for it.
    step
        Called with the part done; may raise to cancel.

    Raises
    ------
    InputError, CrsError
        If the map cannot be read or brought to the grid.
    ExportError
        If the disk is full.
    """
    area = area or (0, 0, header.width, header.height)
    part = part_of(header, area)
    files = target.with_suffix(".samples"), target.with_suffix(".shown")
    with open_bands_on(path, part, moved=_of_part(placed, area)) as bands:
        numbers = band_numbers(bands.header)
        shape = (part.height, part.width, len(numbers))
        # written, not mapped: a full disk is an error then, and not the end of the process
        with (
            _disk_errors(target.parent, shape),
            files[0].open("wb") as one,
            files[1].open("wb") as two,
        ):
            for row in range(0, part.height, _BLOCK):
                values, valid = _strip(bands, numbers, row)
                one.write(values.tobytes())
                two.write(valid.tobytes())
                step(min(1.0, (row + _BLOCK) / part.height))
        name, dtype = bands.header.name, bands.header.dtype
    return CellMap(
        name=name, samples=files[0], shown=files[1], dtype=dtype, shape=shape,
        start=area[:2], placed=placed,
    )  # fmt: skip


def _strip(bands: Bands, numbers: list[int], row: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Samples and where they have a value, of some rows of the cells."""
    width, height = bands.header.width, min(_BLOCK, bands.header.height - row)
    parts = [
        bands.read((col, row, min(_BLOCK, width - col), height), numbers)
        for col in range(0, width, _BLOCK)
    ]
    samples, valid = (np.concatenate([part[i] for part in parts], axis=1) for i in range(2))
    return samples, np.asarray(valid.all(axis=2))


@contextmanager
def work_folder(parent: Path | None) -> Iterator[Path]:
    """A folder for files of a comparison, which is gone in the end.

    Raises
    ------
    ExportError
        If it cannot be made.
    """
    if parent is not None:
        _remove_stale(parent)
    try:
        folder = tempfile.TemporaryDirectory(prefix=_PREFIX, dir=parent)
    except OSError as error:
        raise ExportError(
            f"{parent or tempfile.gettempdir()}: no files can be made there ({error.strerror}); "
            "check the permission and the free space"
        ) from error
    with folder as name, (Path(name) / _LOCK).open("wb") as held:
        # some disks of a network know no locks: there the files of a killed run stay
        with suppress(OSError):
            lock(held)
        yield Path(name)


def _remove_stale(parent: Path) -> None:
    """Remove what killed comparisons left; the folders of living ones are locked."""
    for folder in parent.glob(f"{_PREFIX}*"):
        held = folder / _LOCK
        with suppress(OSError):
            age, locks = time.time() - folder.stat().st_mtime, held.is_file()
            if age < (_YOUNG if locks else _OLD):
                continue
            if locks:
                _refuse_living(held)
            shutil.rmtree(folder)


def _refuse_living(held: Path) -> None:
    """Raise OSError if a process holds the lock."""
    if sys.platform == "win32":
        # an open file cannot be removed there, which is lock enough
        held.unlink()
        return
    with held.open("rb") as stream:
        lock(stream)


@contextmanager
def _disk_errors(folder: Path, shape: tuple[int, int, int]) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        size = shape[0] * shape[1] * (shape[2] + 1) / 1e6
        raise ExportError(
            f"{folder}: files of the comparison, {size:.0f} MB or more, cannot be written "
            f"({error.strerror}); make room, give a larger --cell or a smaller --max-shift"
        ) from error


def _of_part(placed: Transform, area: Window) -> Transform:
    """The same on the grid of some cells alone."""
    a, b, c, d, e, f = placed
    col, row = area[:2]
    return a, b, c + a * col + b * row - col, d, e, f + d * col + e * row - row


def part_of(header: MapHeader, area: Window) -> MapHeader:
    """The grid of some cells alone."""
    col, row, width, height = area
    a, b, left, d, e, top = header.transform
    return replace(
        header, width=width, height=height,
        transform=(a, b, left + col * a, d, e, top + row * e),
    )  # fmt: skip
