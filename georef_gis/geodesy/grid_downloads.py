"""Grids from the network, where there is one: what PROJ's own store offers, taken whole or not.

The address of the store is PROJ's setting, not ours.
"""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

from pyproj import sync
from pyproj.aoi import BBox
from pyproj.sync import get_transform_grid_list

from georef_gis.errors import InputError
from georef_gis.geodesy.grid_files import GridFile, examine_grid
from georef_gis.geodesy.grids_folder import SUFFIXES, forget_grids, grids_folder

# s; of the network, for one answer
_TIMEOUT = 30.0
_CHUNK = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True)
class OfferedGrid:
    """A grid of PROJ's store: size in bytes, area in words, what its bytes must add up to."""

    name: str
    size: int
    area: str
    sha256: str


def offered_grids(
    *, name: str = "", near: tuple[float, float] | None = None
) -> tuple[OfferedGrid, ...]:
    """Grids that the network offers, by name.

    Parameters
    ----------
    name
        Part of the names wanted.
    near
        Lat, lon (deg) that they must hold at.

    Raises
    ------
    InputError
        If there is no network.
    """
    folder = grids_folder()
    box = None
    if near is not None:
        box = BBox(west=near[1] - 0.01, south=near[0] - 0.01, east=near[1] + 0.01,
                   north=near[0] + 0.01)  # fmt: skip
    with _network("the list of grids"):
        folder.mkdir(parents=True, exist_ok=True)
        found = get_transform_grid_list(
            filename=name or None,
            bbox=box,
            include_already_downloaded=True,
            target_directory=str(folder),
        )
    offered = (_offered(item.get("properties", {})) for item in found)
    wanted = (grid for grid in offered if grid.name.lower().endswith(SUFFIXES))
    return tuple(sorted(wanted, key=lambda grid: grid.name))


def _offered(told: dict[str, Any]) -> OfferedGrid:
    return OfferedGrid(
        name=str(told.get("name", "")),
        size=int(told.get("file_size") or 0),
        area=str(told.get("area_of_use") or ""),
        sha256=str(told.get("sha256sum") or ""),
    )


def download_grid(name: str, *, progress: Callable[[float], None] = lambda share: None) -> GridFile:
    """Get a grid into the folder, whole or not at all.

    Parameters
    ----------
    progress
        Told the share that is here, 0 to 1; may raise to stop.

    Raises
    ------
    InputError
        If there is no network, no such grid, or what came is not what the list says.
    """
    grid = next((grid for grid in offered_grids(name=name) if grid.name == name), None)
    if grid is None:
        raise InputError(f"no grid {name!r} is offered; see `georef grids list --available`")
    folder = grids_folder()
    # Its kind is told by the suffix.
    part = folder / f".{os.getpid()}.part.{name}"
    try:
        with _network(name):
            digest = _fetch(grid, part, progress)
        if digest != grid.sha256:
            raise InputError(
                f"what came is not what the list says (sha256 {digest[:12]}..., not "
                f"{grid.sha256[:12]}...); try again",
                source=name,
            )
        found = examine_grid(part)
        os.replace(part, folder / name)
    finally:
        with suppress(OSError):
            part.unlink()
    forget_grids()
    return GridFile(path=folder / name, kind=found.kind, area=found.area)


def _fetch(grid: OfferedGrid, part: Path, progress: Callable[[float], None]) -> str:
    """Write a grid's bytes and tell their sha256."""
    digest, done = hashlib.sha256(), 0
    store = str(sync.get_proj_endpoint())  # type: ignore[attr-defined]
    address = f"{store.rstrip('/')}/{grid.name}"
    with urlopen(address, timeout=_TIMEOUT) as answer, part.open("wb") as stream:
        while chunk := answer.read(_CHUNK):
            stream.write(chunk)
            digest.update(chunk)
            done += len(chunk)
            progress(min(done / max(grid.size, 1), 1.0))
    return digest.hexdigest()


@contextmanager
def _network(what: str) -> Iterator[None]:
    """Turn what a network, or the lack of one, says into a line with a cure."""
    before = socket.getdefaulttimeout()
    # pyproj asks for its list without a limit.
    socket.setdefaulttimeout(_TIMEOUT)
    try:
        yield
    except HTTPError as error:
        raise InputError(f"the network answers {error.code} {error.reason}", source=what) from error
    except (OSError, ValueError) as error:
        # URLError is an OSError; ValueError is a list that is none.
        reason = getattr(error, "reason", None) or error
        words = getattr(reason, "strerror", None) or str(reason)
        raise InputError(
            f"cannot be had from the network ({words}); on a machine that has one get the file, "
            "then `georef grids add FILE` here",
            source=what,
        ) from error
    finally:
        socket.setdefaulttimeout(before)
