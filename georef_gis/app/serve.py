"""`georef serve`: the page of a project, on this machine only."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

import click

from georef_gis.app.facing import Face, face_options, facing
from georef_gis.errors import InputError

if TYPE_CHECKING:
    from georef_gis.app.web.guard import Access

# Tried first, so that a bookmark of the page may hold; a free one where it is taken.
USUAL_PORT = 8642
EXTRA = 'pip install "georef-gis[web]"'


@click.command(short_help="Open the project's page in the browser.")
@click.argument("project", default=".", type=click.Path(path_type=Path))
@click.option("--port", type=click.IntRange(1024, 65535), help="Port of the page; else a free one.")
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@face_options
def serve(project: Path, port: int | None, no_browser: bool, as_json: bool, verbose: int) -> None:
    """Show PROJECT on a page: map, photos, measuring, assets, control points, tools, report.

    The page is on this machine only and needs no network. Its address holds a token: who has it
    can do what you can do with the project. Ctrl-C ends it. Where the page is served already, its
    address is told and opened.
    """
    with facing(Face(as_json=as_json, verbose=verbose)):
        try:
            from georef_gis.app.web.running import running_page
            from georef_gis.app.web.server import run_server
        except ImportError as error:
            raise InputError(f"the page needs {error.name}, which is not there; {EXTRA}") from error
        from georef_gis.project import Project

        def tell(address: str) -> None:
            click.echo(f"the page of {found.folder.name} is at {address}")
            click.echo("it is on this machine only; Ctrl-C ends it", err=True)

        found = Project.open(project)
        there = running_page(found)
        if there is not None:
            _tell_of(found.folder.name, there, port, browser=not no_browser)
            return
        run_server(found, port or USUAL_PORT, tell=tell, fixed=port is not None,
                   browser=not no_browser)  # fmt: skip


def _tell_of(name: str, there: Access, port: int | None, *, browser: bool) -> None:
    """Say where the page is served already, and open it.

    Raises
    ------
    InputError
        If it was to be at another port.
    """
    if port is not None and port != there.port:
        raise InputError(
            f"the page of {name} is served at port {there.port} already: {there.address}; use that "
            "one, or end it first",
            source=f"port {port}",
        )
    click.echo(f"the page of {name} is served at port {there.port} already: {there.address}")
    click.echo("nothing was started; Ctrl-C ends it where it was started", err=True)
    if browser:
        webbrowser.open(there.address)
