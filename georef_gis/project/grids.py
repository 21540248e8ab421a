"""Grids of PROJ for a project: which it needs by its settings, and what the folder holds.

The door of the application to the grids: it knows projects, not geodesy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from georef_gis.errors import CrsError, GeorefError, InputError
from georef_gis.geodesy import CRS, Datum, horizontal_crs, map_crs, parse_crs, vertical_part
from georef_gis.geodesy.geoids import needed_grids
from georef_gis.geodesy.grid_downloads import OfferedGrid, download_grid, offered_grids
from georef_gis.geodesy.grid_files import (
    GridFile,
    add_grid,
    examine_grid,
    installed_grids,
    remove_grid,
)
from georef_gis.geodesy.grids_folder import find_grid, grids_folder, grids_kept, how_to_get
from georef_gis.geodesy.reference_systems import Site, lacking_grids, realisation_of
from georef_gis.model.table_header import header_values, stated_height
from georef_gis.project.project import DATABASE_FILE, Project

__all__ = [
    "GridFile",
    "Need",
    "OfferedGrid",
    "add_grid",
    "download_grid",
    "examine_grid",
    "find_grid",
    "grids_folder",
    "grids_kept",
    "how_to_get",
    "installed_grids",
    "needs_of",
    "offered_grids",
    "open_or_none",
    "place_of",
    "remove_grid",
]


# value of a datum that is that of the CRS
_AUTO = "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class Need:
    """A grid that a project needs, what for, and whether it is there."""

    name: str
    reason: str

    @property
    def is_there(self) -> bool:
        """Whether PROJ finds it."""
        return find_grid(self.name) is not None


def needs_of(project: Project) -> tuple[Need, ...]:
    """Grids that the settings of a project ask for, each once.

    Where no photos were read yet, for the middle of the area that the map CRS is made for.
    """
    place = place_of(project)
    found: dict[str, Need] = {}
    for need in (*_of_geoids(project, place), *_of_datums(project, place)):
        found.setdefault(need.name, need)
    return tuple(found.values())


def place_of(project: Project) -> tuple[float, float] | None:
    """Lat, lon (rad) of the project's origin, else amid its CRS's area; None if unknown."""
    if (project.folder / DATABASE_FILE).is_file():
        with project.reader() as reader:
            origin = reader.database.meta("origin")
        if origin is not None:
            return math.radians(origin[0]), math.radians(origin[1])
    crs = _crs_of(project, project.settings.project.crs)
    area = None if crs is None else horizontal_crs(crs).area_of_use
    if area is None:
        return None
    width = (area.east - area.west) % 360.0
    return math.radians((area.south + area.north) / 2), math.radians(area.west + width / 2)


def _crs_of(project: Project, text: str | None, *, map_only: bool = True) -> CRS | None:
    """CRS of a text of project.toml; None for none, and for one that cannot be used."""
    if not text or text == "auto":
        return None
    if text.lower().endswith((".wkt", ".prj")):
        try:
            text = project.path(text).read_text("utf-8-sig")
        except (OSError, UnicodeDecodeError):
            return None
    try:
        return map_crs(text) if map_only else parse_crs(text)
    except CrsError:
        return None


def _of_geoids(project: Project, place: tuple[float, float] | None) -> Iterator[Need]:
    """Grids of the geoids that settings name, and of those that heights of a CRS are above."""
    settings, control = project.settings, _control(project)
    wanted = {settings.gnss.geoid: "[gnss] geoid"}
    if geoid := control.get("geoid"):
        wanted.setdefault(geoid.lower(), "[control] geoid")
    for section, text in (("project", settings.project.crs), ("control", control.get("crs"))):
        crs = _crs_of(project, text, map_only=section == "project")
        try:
            part = None if crs is None else vertical_part(crs)
        except CrsError:
            continue
        if part is not None:
            wanted.setdefault(part.geoid, f"[{section}] crs: {part.name}")
    for geoid, reason in wanted.items():
        for name in needed_grids(geoid, place):
            yield Need(name=name, reason=f"{reason}, geoid {geoid}")


def _control(project: Project) -> dict[str, str]:
    """crs, datum and geoid of the control: of the head of its file, else of [control]."""
    given = project.settings.control
    said = {"crs": given.crs, "geoid": given.geoid}
    found = {key: value for key, value in said.items() if value}
    with suppress(OSError, UnicodeDecodeError):
        if given.file is not None:
            with project.path(given.file).open(encoding="utf-8-sig") as stream:
                told = header_values(takewhile(lambda line: line.startswith("#"), stream))
                geoid = stated_height(told)[1]
                found |= told | ({"geoid": geoid} if geoid else {})
    return found if given.datum == _AUTO else found | {"datum": given.datum}


def _of_datums(project: Project, place: tuple[float, float] | None) -> Iterator[Need]:
    """Grids on the way from the datum of the positions to those of the map and of control."""
    settings, control = project.settings, _control(project)
    if place is None:
        return
    ends = [(settings.project.crs, settings.project.datum_output)]
    if settings.control.file is not None:
        ends.append((control.get("crs") or settings.project.crs, control.get("datum", _AUTO)))
    site = Site(lat=round(math.degrees(place[0]), 1), lon=round(math.degrees(place[1]), 1),
                slack=0.25)  # fmt: skip
    for text, datum in ends:
        crs = _crs_of(project, text, map_only=False)
        try:
            gnss = Datum.parse(settings.gnss.datum)
            to = Datum.parse(datum) if datum != _AUTO or crs is None else _realisation(crs)
            if not (gnss.is_known and to.is_known):
                continue
            names = lacking_grids(gnss.geographic_3d(), to.geographic_3d(), site)
        except GeorefError:
            continue
        for name in names:
            yield Need(name=name, reason=f"from {gnss} to {to}")


def _realisation(crs: CRS) -> Datum:
    return realisation_of(horizontal_crs(crs))


def open_or_none(folder: Path) -> Project | None:
    """Project of a folder, None if there is none.

    Raises
    ------
    InputError
        If its project.toml cannot be used.
    """
    try:
        return Project.open(folder)
    except InputError as error:
        if error.source and error.source.endswith("project.toml"):
            raise
        return None
