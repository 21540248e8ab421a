"""Files of grids: what they hold and where, taken into the folder only if PROJ can use them."""

from __future__ import annotations

import logging
import os
import re
import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pyproj import Transformer
from pyproj.exceptions import ProjError

from georef_gis.errors import InputError
from georef_gis.geodesy.grids_folder import (
    SUFFIXES,
    find_grid,
    forget_grids,
    grids_folder,
    search_folders,
)

Kind = Literal["heights", "places"]
Box = tuple[float, float, float, float]
# places along each side of a grid at which its values are asked for
_LATTICE = 9
# deg; a place on the very rim may fall off by rounding
_INSIDE = 1e-6
# m; the geoid lies 107 m below to 86 m above the ellipsoid, a DEM in degrees looks like its grid
_FARTHEST = 130.0
# a name that can be told to PROJ and written in project.toml
_NAME = re.compile(r"[\w.+-]+\.(tif|gtx|gsb)", re.ASCII)
_GTX_HEADER = struct.Struct(">4d2i")


@dataclass(frozen=True, slots=True, kw_only=True)
class GridFile:
    """A grid on disk: what it moves, and its area: west, south, east, north, deg."""

    path: Path
    kind: Kind
    area: Box

    @property
    def name(self) -> str:
        """As PROJ knows it."""
        return self.path.name

    @property
    def size(self) -> int:
        """Bytes."""
        return self.path.stat().st_size

    @property
    def told(self) -> str:
        """Kind and area in words."""
        w, s, e, n = self.area
        return f"{self.kind}, lat {s:.4g} to {n:.4g}, lon {w:.4g} to {e:.4g} deg"


def installed_grids() -> Iterator[Path]:
    """Files of grids in all folders that PROJ looks into, each name once, by name."""
    found: dict[str, Path] = {}
    for folder in search_folders():
        if folder.is_dir():
            for path in sorted(folder.iterdir()):
                if path.suffix.lower() in SUFFIXES and path.is_file():
                    found.setdefault(path.name, path)
    yield from (found[name] for name in sorted(found, key=str.lower))


def examine_grid(path: Path, *, whole: bool = True) -> GridFile:
    """What a grid holds, by its header and by PROJ at places all over it.

    Parameters
    ----------
    whole
        Else by the header and the length alone: a world's grid takes seconds to read.

    Raises
    ------
    InputError
        If it is no grid, is cut off, or PROJ cannot use it.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"is no grid by its name; PROJ reads {', '.join(SUFFIXES)}", source=str(path)
        )
    try:
        read = {".gtx": _gtx, ".gsb": _ntv2, ".tif": _tiff}[suffix]
        kind, area = read(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be read ({reason})", source=str(path)) from error
    except InputError:
        raise
    except Exception as error:
        # Whatever a reader says of bytes that are no grid.
        raise InputError(
            f"is no grid of kind {suffix}, or damaged; get it anew", source=str(path)
        ) from error
    found = GridFile(path=path, kind=kind, area=area)
    if whole:
        _try_in_proj(found)
    return found


def add_grid(path: Path) -> GridFile:
    """Copy a grid into the folder, whole or not at all.

    Raises
    ------
    InputError
        If it is no good, or the folder cannot be written.
    """
    if not path.is_file():
        what = "is a folder; give the files in it" if path.is_dir() else "no such file"
        raise InputError(what, source=str(path))
    found = examine_grid(path)
    if not _NAME.fullmatch(found.name):
        raise InputError(
            "its name cannot be told to PROJ, which knows a grid by it: give the file its own "
            "again, of letters, digits and . _ + - (a browser puts (1) behind it)",
            source=str(path),
        )
    return GridFile(path=_placed(path, found.name), kind=found.kind, area=found.area)


def _placed(source: Path, name: str) -> Path:
    """File of the folder that is a copy of another."""
    folder = grids_folder()
    target = folder / name
    part = folder / f".{name}.{os.getpid()}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if target.exists() and target.samefile(source):
            return target
        shutil.copyfile(source, part)
        os.replace(part, target)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror}); check the permission and the free space, or "
            "name another folder by GEOREF_GRIDS",
            source=str(folder),
        ) from error
    finally:
        with suppress(OSError):
            part.unlink()
    forget_grids()
    return target


def remove_grid(name: str) -> Path:
    """Delete a grid from the folder.

    Raises
    ------
    InputError
        If it is not there, or lies in a folder that is not ours.
    """
    path = grids_folder() / name
    if Path(name).name != name or not path.is_file():
        other = find_grid(name) if Path(name).name == name else None
        where = f"; it lies in {other.parent}, remove it there" if other else ""
        raise InputError(f"no grid {name}{where}", source=str(grids_folder()))
    try:
        path.unlink()
    except OSError as error:
        raise InputError(f"cannot be removed ({error.strerror})", source=str(path)) from error
    forget_grids()
    return path


# -- headers -----------------------------------------------------------------------------------


def _cut_off(path: Path, wanted: int) -> InputError:
    size = path.stat().st_size
    return InputError(f"is cut off: {size} bytes of {wanted}; get it anew", source=str(path))


def _gtx(path: Path) -> tuple[Kind, Box]:
    """NOAA's GTX: south, west, steps, rows, columns; then rows of floats from the south."""
    with path.open("rb") as stream:
        south, west, step_lat, step_lon, rows, cols = _GTX_HEADER.unpack(
            stream.read(_GTX_HEADER.size)
        )
    if rows < 2 or cols < 2 or not (0 < step_lat < 90 and 0 < step_lon < 90):
        raise ValueError("no header")
    wanted = _GTX_HEADER.size + 4 * rows * cols
    if path.stat().st_size < wanted:
        raise _cut_off(path, wanted)
    return "heights", _box(west, south, west + (cols - 1) * step_lon, south + (rows - 1) * step_lat)


def _ntv2(path: Path) -> tuple[Kind, Box]:
    """NTv2: 11 records of 16 bytes, then sub-grids of a header of 11 and one record for a node."""
    raw = path.read_bytes()
    order = "<" if raw[8:12] == struct.pack("<i", 11) else ">"
    if raw[:8] != b"NUM_OREC" or struct.unpack(f"{order}i", raw[8:12])[0] != 11:
        raise ValueError("no header")
    count = struct.unpack(f"{order}i", raw[40:44])[0]
    at, boxes = 11 * 16, []
    for _ in range(count):
        south, north, east, west = (
            struct.unpack(f"{order}d", raw[at + 16 * k + 8 : at + 16 * k + 16])[0] / 3600.0
            for k in (4, 5, 6, 7)
        )
        nodes = struct.unpack(f"{order}i", raw[at + 168 : at + 172])[0]
        at += 16 * (11 + nodes)
        boxes.append((-west, south, -east, north))
    if len(raw) < at:
        raise _cut_off(path, at)
    sides = np.array(boxes)
    low, high = sides[:, :2].min(axis=0), sides[:, 2:].max(axis=0)
    return "places", _box(*map(float, (*low, *high)))


def _tiff(path: Path) -> tuple[Kind, Box]:
    """PROJ's GeoTIFF: every picture is a grid or a part of one."""
    import tifffile

    boxes = []
    with _quiet("tifffile"), tifffile.TiffFile(path) as tiff:
        for k in range(len(tiff.pages)):
            page: Any = tiff.pages[k]
            ends = np.add(page.dataoffsets, page.databytecounts)
            if int(ends.max()) > path.stat().st_size:
                raise _cut_off(path, int(ends.max()))
            bands = page.samplesperpixel
            scale = page.tags["ModelPixelScaleTag"].value
            tie = page.tags["ModelTiepointTag"].value
            rows, cols = page.imagelength, page.imagewidth
            # Nodes: of pixels that are areas the centres.
            half = 0.0 if _is_point(page) else 0.5
            west = tie[3] + (half - tie[0]) * scale[0]
            north = tie[4] - (half - tie[1]) * scale[1]
            boxes.append((west, north - (rows - 1) * scale[1], west + (cols - 1) * scale[0], north))
    sides = np.array(boxes)
    low, high = sides[:, :2].min(axis=0), sides[:, 2:].max(axis=0)
    return ("heights" if bands == 1 else "places"), _box(*map(float, (*low, *high)))


@contextmanager
def _quiet(library: str) -> Iterator[None]:
    """Have a library not log what is told here in one line."""
    logger = logging.getLogger(library)
    before = logger.disabled
    logger.disabled = True
    try:
        yield
    finally:
        logger.disabled = before


def _is_point(page: Any) -> bool:
    """Whether key 1025 of a GeoTIFF says that pixels are points."""
    tag = page.tags.get("GeoKeyDirectoryTag")
    keys = np.array(tag.value).reshape(-1, 4) if tag is not None else np.zeros((0, 4), int)
    return bool(np.any((keys[:, 0] == 1025) & (keys[:, 3] == 2)))


def _box(west: float, south: float, east: float, north: float) -> Box:
    """Area of sane numbers, its west in [-180, 180)."""
    if not all(map(np.isfinite, (west, south, east, north))):
        raise ValueError("no area")
    if not (-90.5 <= south < north <= 90.5 and 0 < east - west <= 361.0):
        raise ValueError("no area")
    turned = (west + 180.0) % 360.0 - 180.0
    return turned, south, turned + east - west, north


def _read_all(grid: GridFile) -> None:
    """Decode all of a GeoTIFF: a byte that is wrong spoils a block between the places asked for."""
    if grid.path.suffix.lower() != ".tif":
        return
    import tifffile

    try:
        with _quiet("tifffile"), tifffile.TiffFile(grid.path) as tiff:
            for page in tiff.pages:
                page.asarray()
    except Exception as error:
        # Whatever a decoder says of bytes that are none of its own.
        raise InputError("is damaged; get it anew", source=str(grid.path)) from error


def _try_in_proj(grid: GridFile) -> None:
    """Ask PROJ for values all over a grid, from a folder whose name PROJ's texts can hold."""
    west, south, east, north = grid.area
    lon, lat = np.meshgrid(
        np.linspace(west + _INSIDE, east - _INSIDE, _LATTICE),
        np.linspace(max(south, -90.0) + _INSIDE, min(north, 90.0) - _INSIDE, _LATTICE),
    )
    step = "vgridshift" if grid.kind == "heights" else "hgridshift"
    with tempfile.TemporaryDirectory(prefix="georef-grid-") as folder:
        copy = Path(folder) / f"grid{grid.path.suffix.lower()}"
        shutil.copyfile(grid.path, copy)
        try:
            shift = Transformer.from_pipeline(
                "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
                f'+step +proj={step} +grids="{copy.as_posix()}"'
            )
        except ProjError as error:
            raise InputError(
                "is no grid that PROJ can use, or damaged; get it anew", source=str(grid.path)
            ) from error
        moved = shift.transform(lon.ravel(), lat.ravel(), np.zeros(lon.size))
        # Windows cannot delete a file that is still open.
        del shift
    _read_all(grid)
    known = np.isfinite(moved[2]) & np.isfinite(moved[0])
    if not np.any(known):
        raise InputError("PROJ finds no value in it; get it anew", source=str(grid.path))
    farthest = float(np.max(np.abs(moved[2][known])))
    if grid.kind == "heights" and farthest > _FARTHEST:
        raise InputError(
            f"holds {farthest:.0f} m, and no geoid lies farther than {_FARTHEST:.0f} m from the "
            "ellipsoid; is it a DEM?",
            source=str(grid.path),
        )
