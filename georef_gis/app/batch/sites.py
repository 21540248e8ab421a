"""Which sites a batch is of, and what each is called."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from georef_gis.errors import InputError

SETTINGS_FILE = "project.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """A project of a batch: its folder, and a name that no other of the batch has."""

    name: str
    folder: Path


def find_sites(given: Sequence[str]) -> list[Site]:
    """Sites of folders, project.toml files and patterns, in order, each once.

    A pattern is resolved here too, as not every shell does. A folder without a project.toml
    stands for the projects right below it.

    Raises
    ------
    InputError
        If one of them leads to no project, as a typing error would go unnoticed otherwise.
    """
    folders: dict[str, Path] = {}
    for text in given:
        found = list(_folders(text))
        if not found:
            raise InputError(
                f"no {SETTINGS_FILE} is there; give folders of projects, or a pattern such as "
                f"'sites/*/{SETTINGS_FILE}'",
                source=text,
            )
        for folder in found:
            folders.setdefault(os.path.realpath(folder), folder)
    return _named(list(folders.values()))


def _folders(text: str) -> Iterator[Path]:
    """Folders of the projects that a text stands for."""
    paths = [text] if os.path.lexists(text) else sorted(glob.glob(text, recursive=True))
    for path in map(Path, paths):
        if path.name == SETTINGS_FILE and path.is_file():
            yield Path(os.path.abspath(path)).parent
        elif (path / SETTINGS_FILE).is_file():
            yield Path(os.path.abspath(path))
        elif path.is_dir():
            below = sorted(path.glob(f"*/{SETTINGS_FILE}"))
            yield from (Path(os.path.abspath(settings)).parent for settings in below)


def _named(folders: Sequence[Path]) -> list[Site]:
    """Sites named by their folder; alike ones by as many parents as tell them apart."""
    depth = 1
    while depth < max((len(folder.parts) for folder in folders), default=1):
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
        if len(set(names)) == len(names):
            break
        depth += 1
    counts = [folder.name for folder in folders]
    return [
        Site(
            name=folder.name if counts.count(folder.name) == 1 else "/".join(folder.parts[-depth:]),
            folder=folder,
        )
        for folder in folders
    ]


def common_folder(sites: Sequence[Site]) -> Path:
    """Folder that holds the sites, where their table goes."""
    parents = [str(site.folder.parent) for site in sites]
    try:
        return Path(os.path.commonpath(parents))
    except ValueError:
        # on Windows: of several drives
        return Path.cwd()
