"""`georef grids`: PROJ's grids of geoids and datums, in one folder."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from georef_gis.app.facing import Face, face_options, facing
from georef_gis.app.feedback import JsonFeedback, PlainFeedback
from georef_gis.errors import Cancelled, InputError

if TYPE_CHECKING:
    from georef_gis.project.grids import GridFile, Need

_PROJECT = click.option(
    "--project", "folder", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Folder of a project; else the one here, if there is one.",
)  # fmt: skip


@click.group(short_help="Grids of geoids and datums: list, add, download, remove.",
             invoke_without_command=True)  # fmt: skip
@click.pass_context
def grids(context: click.Context) -> None:
    """Look after the grids that heights and datums are transformed by.

    They lie in one folder: that of [project] grids in project.toml, else of GEOREF_GRIDS, else
    the one in which PROJ itself looks for grids of this user.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@grids.command("list", short_help="Which grids are there, and which a project needs.")
@_PROJECT
@click.option("--available", is_flag=True, help="Those of the network too, around the project.")
@click.option("--all", "everywhere", is_flag=True, help="Of the network those of anywhere.")
@face_options
def list_grids(
    folder: Path | None, available: bool, everywhere: bool, as_json: bool, verbose: int
) -> None:
    """List the grids that are installed, those that the project needs, and those to be had."""
    with facing(Face(as_json=as_json, verbose=verbose)):
        from georef_gis.project.grids import grids_folder, needs_of, place_of

        with _project(folder) as project:
            needs = needs_of(project) if project is not None else ()
            place = place_of(project) if project is not None else None
        content: dict[str, Any] = {
            "folder": str(grids_folder()),
            "installed": list(_installed()),
            "needed": [_need(need) for need in needs],
        }
        if not as_json:
            # What is here is told before the network is asked.
            click.echo("\n".join(_lines(content, has_project=project is not None)))
        if available or everywhere:
            content["available"] = _offered(None if everywhere else place)
        if as_json:
            click.echo(json.dumps(content, indent=1))
        elif "available" in content:
            click.echo("\n".join(_available_lines(content["available"])))


@grids.command(short_help="Take grids from files, such as of a USB stick.")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@face_options
def add(files: tuple[Path, ...], as_json: bool, verbose: int) -> None:
    """Copy grids (.tif, .gtx, .gsb) into the folder, if PROJ can use them.

    Keep their names: PROJ knows a grid by its name.
    """
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        from georef_gis.project.grids import add_grid

        for file in files:
            _say(feedback, "added", add_grid(file))


@grids.command(short_help="Get grids from the network.")
@click.argument("names", nargs=-1)
@_PROJECT
@face_options
def download(names: tuple[str, ...], folder: Path | None, as_json: bool, verbose: int) -> None:
    """Get the grids NAMES, or without names those that the project needs and lacks."""
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        from georef_gis.project.grids import download_grid, needs_of

        with _project(folder) as project:
            if not names and project is None:
                raise InputError("name the grids, or give the project: --project FOLDER")
            if not names and project is not None:
                names = tuple(need.name for need in needs_of(project) if not need.is_there)
                if not names:
                    feedback.info("the project lacks no grid")
        found = []
        for number, name in enumerate(names):

            def progress(share: float, name: str = name, number: int = number) -> None:
                if feedback.cancelled():
                    raise Cancelled("stopped by the user")
                feedback.progress((number + share) / len(names), name)

            found.append(download_grid(name, progress=progress))
        feedback.__exit__()
        for grid in found:
            _say(feedback, "downloaded", grid)


@grids.command(short_help="Delete grids from the folder.")
@click.argument("names", nargs=-1, required=True)
@face_options
def remove(names: tuple[str, ...], as_json: bool, verbose: int) -> None:
    """Delete the grids NAMES from the folder."""
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        from georef_gis.project.grids import remove_grid

        for name in names:
            path = remove_grid(name)
            if isinstance(feedback, JsonFeedback):
                feedback.event("removed", name=name, path=str(path))
            else:
                click.echo(f"removed {path}")


@contextlib.contextmanager
def _project(folder: Path | None) -> Iterator[Any]:
    """Project of a folder; without one that of the current folder, None if it is none."""
    from georef_gis.project import Project
    from georef_gis.project.grids import open_or_none

    project = open_or_none(Path()) if folder is None else Project.open(folder)
    try:
        yield project
    finally:
        if project is not None:
            project.close()


def _installed() -> Iterator[dict[str, Any]]:
    from georef_gis.project.grids import examine_grid, installed_grids

    for path in installed_grids():
        told: dict[str, Any] = {"name": path.name, "path": str(path), "size": path.stat().st_size}
        try:
            grid = examine_grid(path, whole=False)
            told |= {"kind": grid.kind, "area": list(grid.area), "told": grid.told}
        except InputError as error:
            told["error"] = str(error)
        yield told


def _need(need: Need) -> dict[str, Any]:
    return {"name": need.name, "reason": need.reason, "is_there": need.is_there}


def _offered(place: tuple[float, float] | None) -> list[dict[str, Any]]:
    from math import degrees

    from georef_gis.project.grids import find_grid, offered_grids

    near = None if place is None else (degrees(place[0]), degrees(place[1]))
    return [
        {"name": g.name, "size": g.size, "area": g.area, "is_there": find_grid(g.name) is not None}
        for g in offered_grids(near=near)
    ]


def _lines(content: dict[str, Any], *, has_project: bool) -> Iterator[str]:
    yield f"folder: {content['folder']}"
    yield f"installed: {len(content['installed']) or 'none'}"
    for grid in content["installed"]:
        what = f"BAD  {grid['error']}" if "error" in grid else grid["told"]
        yield f"  {grid['name']:<28} {_size(grid['size']):>9}  {what}"
    if has_project:
        yield f"needed by the project: {len(content['needed']) or 'none'}"
    for need in content["needed"]:
        state = "there  " if need["is_there"] else "LACKING"
        cure = "" if need["is_there"] else f"; georef grids download {need['name']}"
        yield f"  {need['name']:<28} {state}  {need['reason']}{cure}"


def _available_lines(grids: list[dict[str, Any]]) -> Iterator[str]:
    yield f"available from the network: {len(grids) or 'none'}"
    for grid in grids:
        there = "  (installed)" if grid["is_there"] else ""
        yield f"  {grid['name']:<28} {_size(grid['size']):>9}  {grid['area']}{there}"


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"


def _say(feedback: PlainFeedback, verb: str, grid: GridFile) -> None:
    if isinstance(feedback, JsonFeedback):
        feedback.event(verb, name=grid.name, path=str(grid.path), kind=grid.kind,
                       area=list(grid.area), size=grid.size)  # fmt: skip
        return
    click.echo(f"{verb} {grid.name}: {grid.told}; {_size(grid.size)} in {grid.path.parent}")
