"""A project: a folder with project.toml, the database, the products and the cache."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError
from georef_gis.project.database import Database
from georef_gis.project.settings import Settings, read_settings

SETTINGS_FILE = "project.toml"
DATABASE_FILE = "georef.gpkg"


class Project:
    """A project on disk. Pickled, it is the folder: every process opens the database itself."""

    def __init__(self, folder: Path, settings: Settings, *, read_only: bool = False) -> None:
        self.folder = Path(os.path.abspath(folder))
        self.settings = settings
        self.read_only = read_only

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = False) -> Project:
        """Project of a folder or of its project.toml.

        Raises
        ------
        InputError
            If there is none, or its project.toml cannot be used.
        """
        path = Path(path)
        folder = path.parent if path.name == SETTINGS_FILE else path
        if not folder.is_dir():
            raise InputError("no such folder", source=str(path))
        if not (folder / SETTINGS_FILE).is_file():
            raise InputError(
                f"has no {SETTINGS_FILE}; make one with `georef init` and the folder of the photos",
                source=os.path.abspath(folder),
            )
        return cls(folder, read_settings(folder / SETTINGS_FILE), read_only=read_only)

    @classmethod
    def create(
        cls,
        folder: Path | str,
        values: Mapping[str, Mapping[str, Any]] | None = None,
        notes: Mapping[str, str] | None = None,
        *,
        overwrite: bool = False,
    ) -> Project:
        """Write a commented project.toml into a folder, which is made if need be.

        Parameters
        ----------
        values
            Section -> key -> value to state; all other keys stand there as comments.
        notes
            Section -> what was found, as a comment.

        Raises
        ------
        InputError
            If there is a project.toml already, or the folder cannot be written.
        """
        from georef_gis.project.template import render_settings

        path = Path(folder) / SETTINGS_FILE
        if path.exists() and not overwrite:
            raise InputError("is there already; edit it, or move it away", source=str(path))
        text = render_settings(values or {}, notes or {})
        part = path.with_name(f".{SETTINGS_FILE}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", source=str(path)) from error
        return cls.open(path)

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave the database behind."""
        return _reopen, (self.folder, self.settings, self.read_only)

    @property
    def products(self) -> Path:
        """Folder of the products."""
        return self.folder / "products"

    @property
    def cache(self) -> Path:
        """Folder of what may be deleted at any time."""
        return self.folder / "cache"

    @property
    def navigation(self) -> Path:
        """Folder of trajectories."""
        return self.folder / "navigation"

    @property
    def adjustment(self) -> Path:
        """Tie points, and what the adjustment left: points, residuals, covariances, ground."""
        return self.folder / "adjustment"

    @cached_property
    def database(self) -> Database:
        """Database of the project, made on first use unless it is read-only."""
        return Database(self.folder / DATABASE_FILE, read_only=self.read_only)

    def close(self) -> None:
        """Close the database if it is open."""
        database = self.__dict__.pop("database", None)
        if database is not None:
            database.close()

    @contextmanager
    def reader(self) -> Iterator[Project]:
        """Open the project a second time, such that nothing in its database can be changed."""
        project = Project(self.folder, self.settings, read_only=True)
        try:
            yield project
        finally:
            project.close()

    def prepare(self) -> None:
        """Make the folders that tools write to."""
        try:
            for folder in (self.products, self.cache):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror}); check the permission and the free space",
                source=str(self.folder),
            ) from error

    def path(self, given: Path | str) -> Path:
        """Absolute path of one in project.toml."""
        return Path(os.path.abspath(self.folder / Path(given).expanduser()))

    def photo_files(self) -> list[Path]:
        """Files of the photos as [photos] selects them, sorted by path.

        Raises
        ------
        InputError
            If the folder is not there.
        """
        photos = self.settings.photos
        folder = self.path(photos.folder)
        if not folder.is_dir():
            raise InputError(
                f"no folder {folder}", source=str(self.folder / SETTINGS_FILE),
                field="photos.folder",
            )  # fmt: skip
        patterns = tuple(pattern.lower() for pattern in photos.patterns)
        files: list[Path] = []
        for parent, folders, names in os.walk(folder):
            folders[:] = sorted(folders) if photos.subfolders else []
            files += [
                Path(parent, name)
                for name in names
                if not name.startswith(".")
                and name not in photos.exclude
                and any(fnmatchcase(name.lower(), pattern) for pattern in patterns)
            ]
        return sorted(files)


def _reopen(folder: Path, settings: Settings, read_only: bool) -> Project:
    return Project(folder, settings, read_only=read_only)
