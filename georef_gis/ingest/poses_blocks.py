"""Blocks of OpenSfM and COLMAP as files of poses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from georef_gis.errors import InputError
from georef_gis.geodesy import Height, HeightKind
from georef_gis.ingest.tables import Row, read_lines
from georef_gis.model.interchange.block import Block, with_own_facts
from georef_gis.model.interchange.colmap import block_from_colmap
from georef_gis.model.interchange.opensfm import blocks_from_opensfm
from georef_gis.model.interchange.poses import poses_of_block
from georef_gis.model.photo import AttitudeTag, Geotag

BlockFormat = Literal["opensfm", "colmap"]
# Puts a block that has no place on the Earth there.
Placing = Callable[[Block], Block]

# What stands beside a COLMAP model: our own frame, what `colmap model_aligner` takes, and ODM's.
FRAME_FILE = "georef_frame.json"
REFERENCES_FILE = "ref_images.txt"
GEO_FILE = "geo.txt"
# bytes; a text model of more does not fit in memory as values
_LARGEST = 2_000_000_000


def block_format(path: Path, format: str) -> BlockFormat | None:
    """Which of the two a file of poses is; None for a table."""
    if format in ("opensfm", "colmap"):
        return "opensfm" if format == "opensfm" else "colmap"
    if format != "auto":
        return None
    if path.suffix.lower() == ".json":
        return "opensfm"
    is_model = path.is_dir() or path.name.lower() in ("images.txt", "cameras.txt", "points3d.txt")
    return "colmap" if is_model else None


def read_blocks(
    path: Path,
    format: BlockFormat,
    *,
    read_positions: Callable[[Path], dict[str, Geotag]] | None = None,
    points: bool = False,
) -> tuple[Block, ...]:
    """Blocks of a file of OpenSfM or a text model of COLMAP, the largest first.

    Parameters
    ----------
    path
        `reconstruction.json`; or a model's folder or one of its files.
    read_positions
        Reads ODM's `geo.txt` where one lies beside a block that has no place on the Earth.
    points
        Read COLMAP's ground points too.

    Raises
    ------
    InputError
        Naming the file and what cannot be read.
    """
    if format == "opensfm":
        beside = path.parent / "reference_lla.json"
        reference = _json(beside) if beside.is_file() else None
        blocks = blocks_from_opensfm(_json(path), str(path), reference=reference)
        folder = path.parent
    else:
        folder = path if path.is_dir() else path.parent
        blocks = (_colmap(folder, points=points),)
    return tuple(_with_positions(block, folder, read_positions) for block in blocks)


def read_block_poses(
    path: Path,
    format: BlockFormat,
    *,
    placing: Placing | None = None,
    read_positions: Callable[[Path], dict[str, Geotag]] | None = None,
) -> dict[str, tuple[Geotag, AttitudeTag]]:
    """Position and angles by the name of the shot; of one in two blocks that in the larger.

    Raises
    ------
    InputError
        If a block has no place on the Earth and `placing` is not given or refuses it.
    """
    out: dict[str, tuple[Geotag, AttitudeTag]] = {}
    for block in read_blocks(path, format, read_positions=read_positions):
        if block.origin is None:
            if placing is None:
                raise InputError(
                    "has no place on the Earth; give photos with positions, or put "
                    f"{FRAME_FILE} or {GEO_FILE} beside it",
                    source=str(path),
                )
            block = placing(block)
        for name, pose in poses_of_block(block, path.name).items():
            out.setdefault(name, pose)
    return out


def _colmap(folder: Path, *, points: bool) -> Block:
    if not (folder / "images.txt").is_file() and (folder / "images.bin").is_file():
        raise InputError(
            "is a binary model; convert it: colmap model_converter --output_type TXT",
            source=str(folder),
        )
    tracks = folder / "points3D.txt"
    wanted = _lines(tracks) if points and tracks.is_file() else None
    block = block_from_colmap(
        _lines(folder / "cameras.txt"), _lines(folder / "images.txt"), wanted, str(folder)
    )
    frame = folder / FRAME_FILE
    return with_own_facts(block, _json(frame), str(frame)) if frame.is_file() else block


def _with_positions(
    block: Block, folder: Path, read_positions: Callable[[Path], dict[str, Geotag]] | None
) -> Block:
    """Block with the positions of a file beside it, if it has no place of its own."""
    if block.origin is not None:
        return block
    if (folder / REFERENCES_FILE).is_file():
        return replace(block, positions=_references(folder / REFERENCES_FILE))
    if read_positions is not None and (folder / GEO_FILE).is_file():
        return replace(block, positions=read_positions(folder / GEO_FILE))
    return block


def _references(path: Path) -> dict[str, Geotag]:
    """Positions for `colmap model_aligner --ref_is_gps 1`: name, latitude, longitude, height."""
    from math import radians

    out = {}
    for n, line in read_lines(path).data:
        cells = line.rsplit(maxsplit=3)
        row = Row(path=path, line=n, cells=tuple(cells))
        if len(cells) != 4:
            raise InputError("name, latitude, longitude and height are needed", source=row.source)
        lat, lon, h = (row.required(i, name) for i, name in ((1, "lat"), (2, "lon"), (3, "h")))
        if abs(lat) > 90.0 or abs(lon) > 180.0:
            raise InputError(
                f"latitude {lat:g}, longitude {lon:g} is not on the Earth; the latitude stands "
                "first, both in degrees",
                source=row.source,
            )
        # COLMAP converts them as heights above the ellipsoid, whatever they are.
        height = Height(value=h, kind=HeightKind.UNKNOWN)
        out[cells[0]] = Geotag(lat=radians(lat), lon=radians(lon), height=height, source=path.name)
    return out


def _lines(path: Path) -> list[str]:
    """Lines of a text file, the empty ones too."""
    return _text(path).splitlines()


def _json(path: Path) -> Any:
    try:
        return json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise InputError(
            f"is no JSON: {error.msg} in line {error.lineno}", source=str(path)
        ) from error
    except RecursionError as error:
        raise InputError("is no JSON of a reconstruction", source=str(path)) from error


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError("is larger than 2 GB; leave its points out", source=str(path))
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not a text file in UTF-8 (byte {error.start})", source=str(path)
        ) from error
