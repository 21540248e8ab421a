"""The one folder of PROJ's grids: where it is, and that every PROJ of ours looks there.

By default it is the folder in which PROJ itself looks for grids of the user, so that a grid is
there for a GIS of the same machine too. GEOREF_GRIDS, or `grids` in project.toml, names another.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from pyproj import datadir

from georef_gis.errors import InputError

ENVIRONMENT = "GEOREF_GRIDS"
# PROJ reads it in every process that is started from here, a GIS included.
_OF_PROJ = "PROJ_USER_WRITABLE_DIRECTORY"
# Folders of proj.db, of PROJ 9.1 on and before
_DATABASES = ("PROJ_DATA", "PROJ_LIB")
SUFFIXES = (".tif", ".gtx", ".gsb")

_forget: list[Callable[[], object]] = []


def grids_folder() -> Path:
    """Folder that grids are put into; it need not be there yet."""
    own = os.environ.get(ENVIRONMENT, "").strip()
    return Path(own).expanduser().absolute() if own else _folder_of_proj()


def _folder_of_proj() -> Path:
    """Folder of this user's grids by PROJ itself."""
    return Path(datadir.get_user_data_dir())  # type: ignore[attr-defined]


def search_folders() -> Iterator[Path]:
    """Folders in which PROJ looks for grids, ours first."""
    yield from dict.fromkeys([grids_folder(), *map(Path, datadir.get_data_dir().split(os.pathsep))])


def find_grid(name: str) -> Path | None:
    """File of a grid, None if it is not installed."""
    return next((f / name for f in search_folders() if (f / name).is_file()), None)


def use_grids(folder: Path | None = None) -> None:
    """Have PROJ look for grids in a folder, in this process and those started from it.

    Without a folder in that of GEOREF_GRIDS, if it is set.

    Raises
    ------
    InputError
        If the folder's name cannot stand in a list of folders.
    """
    if folder is not None:
        os.environ[ENVIRONMENT] = str(folder.absolute())
    if not os.environ.get(ENVIRONMENT, "").strip():
        return
    name = str(grids_folder())
    if os.pathsep in name:
        raise InputError(
            f"'{name}' holds a '{os.pathsep}', which parts folders for PROJ; take another folder",
            field="grids",
        )
    os.environ[_OF_PROJ] = name
    # proj.db must stay that of the PROJ at work: its own folder remains the first. Ours is the last
    # and no other between: pyproj hands PROJ a list of which only the last name is sure to be
    # there still when it is read, and a folder of before would be taken for ours.
    first = datadir.get_data_dir().split(os.pathsep)[0]
    datadir.set_data_dir(os.pathsep.join([first, name]))
    forget_grids()


@contextmanager
def grids_kept() -> Iterator[None]:
    """Have the folder of before again afterwards, whatever projects are opened in between.

    One that names a folder of grids leaves it to all that comes after in this process, and to the
    processes that are started from it: to those of other projects too.
    """
    names = (ENVIRONMENT, _OF_PROJ)
    before = {name: os.environ.get(name) for name in names}
    folders = datadir.get_data_dir()
    try:
        yield
    finally:
        if any(os.environ.get(name) != value for name, value in before.items()):
            for name, value in before.items():
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value
            datadir.set_data_dir(folders)
            forget_grids()


def drop_foreign_databases() -> None:
    """Forget the database of another PROJ that a GIS, its shell or conda names to all it starts.

    The wheel of rasterio brings its own and would take the named one before it, whose layout it
    does not read: no CRS would be known.
    """
    if not any(name in os.environ for name in _DATABASES):
        return
    spec = find_spec("rasterio")
    for place in (spec.submodule_search_locations or ()) if spec is not None else ():
        if Path(place, "proj_data", "proj.db").is_file():
            for name in _DATABASES:
                os.environ.pop(name, None)


def forget_grids() -> None:
    """Have everything that was made with the grids made again."""
    for clear in _forget:
        clear()


def made_with_grids(clear: Callable[[], object]) -> None:
    """Call `clear` when grids came or went."""
    _forget.append(clear)


def how_to_get(*grids: str) -> str:
    """The cure for grids that are missing."""
    names = " ".join(grids)
    return (
        f"get {'it' if len(grids) == 1 else 'them'} by `georef grids download {names}`, or "
        "without a network from a file by `georef grids add FILE`"
    )
