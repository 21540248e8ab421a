"""Disk space a raster will take, told before the work of hours rather than after it."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.errors import ExportError
from georef_gis.rasters.files import resolve_target, same_disk
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import levels

# Encoded bytes per raw byte by quality: medians of aerial photos, 0.6 to 2 times that for single
# tiles of smooth or rough ground.
_QUALITIES = (50, 75, 85, 90, 95, 100)
_JPEG = (0.027, 0.042, 0.057, 0.073, 0.108, 0.227)
_WEBP = (0.016, 0.024, 0.040, 0.058, 0.084, 0.180)
_LOSSLESS = {"uint8": 0.45, "uint16": 0.75, "int16": 0.6, "float32": 0.6}
# What is surely needed of the estimate: the smoothest of those photos.
_SURE = 0.6
# Overviews beside the full resolution: 1/4 + 1/16 + ...
_OVERVIEWS = 4 / 3
# Halves of the full resolution that wait at once, in roots of the number of tiles; and the part of
# the raw raster that all halves take in the worst order.
_WAITING, _WORST_WAITING = 3.0, 0.27


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """Bytes a raster is likely to take.

    Parameters
    ----------
    file
        The file at the end.
    work
        Tiles and halves that are kept until then.
    """

    file: int
    work: int


def space_needed(profile: RasterProfile, tiles: int) -> Space:
    """Space of a raster with overviews of which some tiles of the full resolution are written."""
    size = profile.tile_size
    raw = float(min(tiles * size * size, profile.width * profile.height))
    raw *= np.dtype(profile.dtype).itemsize
    encoded = raw * profile.samples * _ratio(profile)
    step = 2 if profile.validity == "mask" else 1
    # 8 bytes of offset and 4 of length each, present or not
    grid = levels(profile.width, profile.height, size, overviews=True)
    directories = 12 * step * sum(level.across * level.down for level in grid)
    waiting = min(_WAITING / math.sqrt(max(tiles, 1)) / 4, _WORST_WAITING) * raw * profile.bands
    return Space(
        file=round(encoded * _OVERVIEWS) + directories,
        work=round(encoded * _OVERVIEWS + waiting),
    )


def check_room(path: Path, profile: RasterProfile, tiles: int, *, work: Path | None = None) -> None:
    """Refuse a raster that its disk, or that of the work folder, has surely no room for.

    Parameters
    ----------
    path
        File to write.
    tiles
        Tiles of the full resolution that will hold something and are not in `work` already.
    work
        Folder that keeps unfinished tiles; None = beside the file.

    Raises
    ------
    ExportError
        With what is needed and what is free.
    """
    target = resolve_target(path)
    space = space_needed(profile, tiles)
    folder = _existing(work or target.parent)
    if same_disk(folder, target.parent):
        _check(target, target.parent, space.file + space.work)
    else:
        _check(target, folder, space.work)
        _check(target, target.parent, space.file)


def _check(target: Path, folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if free < _SURE * needed:
        raise ExportError(
            f"{target}: about {needed / 1e9:.3g} GB are needed on the disk of {folder} while it is "
            f"made, {free / 1e9:.3g} GB are free; free some space, write to another disk, or "
            "choose a coarser gsd or a smaller area"
        )


def _existing(folder: Path) -> Path:
    """The folder, or the first above it that is there."""
    folder = folder.absolute()
    return next((at for at in (folder, *folder.parents) if at.is_dir()), folder)


def _ratio(profile: RasterProfile) -> float:
    """Encoded bytes per raw byte."""
    lossy = {"jpeg": _JPEG, "webp": _WEBP}.get(profile.compression)
    if lossy is None:
        return _LOSSLESS[profile.dtype]
    return float(np.interp(profile.quality, _QUALITIES, lossy))
