"""`georef batch`: the command."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from georef_gis.app.facing import BUG, CANCELLED, DONE, USER_ERROR, Face, face_options, facing
from georef_gis.app.feedback import JsonFeedback, PlainFeedback

if TYPE_CHECKING:
    from georef_gis.app.batch.process import Outcome
    from georef_gis.app.batch.sites import Site
    from georef_gis.app.batch.table import Row

# bytes of memory for a site that is worked on
MEMORY = 2_000_000_000
FOLDER, LOGS = "batch", "logs"


@click.command(short_help="Make the products of many sites, and one table of them.")
@click.argument("sites", nargs=-1, required=True)
@click.option("--quick", is_flag=True, help="A first answer, from the poses alone.")
@click.option(
    "--jobs", type=click.IntRange(1), help="Sites at once; else by processors and memory."
)
@click.option("--workers", type=click.IntRange(1), help="Processes of each site.")
@click.option(
    "--limit",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="MINUTES",
    help="A site that takes longer is stopped; the next batch goes on from there.",
)
@click.option(
    "--set",
    "values",
    metavar="ID.NAME=VALUE",
    multiple=True,
    help="Parameter of a step, for all sites.",
)
@click.option("--force", is_flag=True, help="Run steps that are up to date too.")
@click.option("--verify", is_flag=True, help="Hash all of the inputs and products.")
@click.option(
    "--summary",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of the table and the logs; else `batch` beside the sites.",
)
@face_options
def batch(sites: tuple[str, ...], as_json: bool, verbose: int, **wishes: Any) -> None:
    """Make the products of SITES: folders of projects, project.toml files, or patterns.

    Each site is run by itself: one that fails does not stop the others, and what is up to date
    is not done again, so a batch may be stopped, repeated and scheduled.

    Writes batch.csv, batch.html and batch.gpkg, a row for each site. Exit code: 0 all is done,
    2 a site failed, 1 one failed by a bug, 130 cancelled.
    """
    with facing(Face(as_json=as_json, verbose=verbose)) as feedback:
        code = _batch(sites, wishes, feedback)
    sys.exit(code)


def _batch(given: Sequence[str], wishes: Mapping[str, Any], feedback: PlainFeedback) -> int:
    from georef_gis.app.batch.schedule import Wishes, run_sites
    from georef_gis.app.batch.sites import common_folder, find_sites
    from georef_gis.app.batch.table import write_tables
    from georef_gis.app.values import step_values
    from georef_gis.toolbox.registry import load_registry

    values = step_values(wishes["values"])
    for name in values:
        load_registry().find(name)
    found = find_sites(given)
    folder: Path = wishes["summary"] or common_folder(found) / FOLDER
    _check_writable(folder / LOGS)
    jobs = wishes["jobs"] or _default_jobs(len(found))
    rows: list[Row] = []

    def finished(outcome: Outcome) -> None:
        rows.append(_row(outcome))
        _say(feedback, outcome, len(rows), len(found))

    outcomes = run_sites(
        found,
        Wishes(
            jobs=jobs,
            arguments=_arguments(wishes, jobs),
            logs=folder / LOGS,
            limit_s=60.0 * (wishes["limit"] or 0.0),
        ),
        feedback,
        unchanged=lambda site: _settled(site, wishes, values),
        finished=finished,
    )
    order = {outcome.site: number for number, outcome in enumerate(outcomes)}
    written = write_tables(sorted(rows, key=lambda row: order[row.outcome.site]), folder)
    code = _exit_code(outcomes)
    _tell(feedback, rows, written, code)
    return code


def _check_writable(folder: Path) -> None:
    """Refuse a folder that no log can be written to, before any site is run.

    Raises
    ------
    ExportError
        With the cure.
    """
    import tempfile

    from georef_gis.errors import ExportError

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ExportError(
            f"{folder}: cannot be written ({error.strerror}); give a folder for the table and the "
            "logs by --summary FOLDER"
        ) from error


def _default_jobs(count: int) -> int:
    """Sites at once: no more than processors, nor than memory holds."""
    from georef_gis.app.doctor import memory_bytes
    from georef_gis.toolbox.steps import default_workers

    memory = memory_bytes()
    held = default_workers() if memory is None else max(1, memory // MEMORY)
    return max(1, min(count, default_workers(), held))


def _arguments(wishes: Mapping[str, Any], jobs: int) -> tuple[str, ...]:
    from georef_gis.toolbox.steps import default_workers

    workers = wishes["workers"] or max(1, default_workers() // jobs)
    flags = [f"--{name}" for name in ("quick", "force", "verify") if wishes[name]]
    values = [text for value in wishes["values"] for text in ("--set", value)]
    return ("--workers", str(workers), *flags, *values)


def _settled(
    site: Site, wishes: Mapping[str, Any], values: Mapping[str, Mapping[str, Any]]
) -> Outcome | None:
    """Outcome of a site that has nothing to do; None if a process must look at it."""
    import time

    from georef_gis.app.batch.process import Outcome
    from georef_gis.errors import GeorefError
    from georef_gis.project import Project
    from georef_gis.project.grids import grids_kept
    from georef_gis.toolbox.registry import load_registry
    from georef_gis.toolbox.runner import why_pending
    from georef_gis.toolbox.steps import RunOptions

    begun = time.monotonic()
    options = RunOptions(**{name: wishes[name] for name in ("quick", "force", "verify")})
    try:
        with grids_kept():
            project = Project.open(site.folder)
            if why_pending(load_registry(), project, values=values, options=options):
                return None
    except GeorefError:
        # `georef run` says it in its own words.
        return None
    return Outcome(site=site, state="unchanged", duration_s=time.monotonic() - begun)


def _row(outcome: Outcome) -> Row:
    from georef_gis.app.batch.table import Row
    from georef_gis.errors import GeorefError
    from georef_gis.project import Project
    from georef_gis.project.grids import grids_kept
    from georef_gis.project.project import DATABASE_FILE
    from georef_gis.project.summary import summarise
    from georef_gis.toolbox.registry import load_registry

    tools = [tool.full_id for tool in load_registry() if tool.algorithm.in_run]
    if not (outcome.site.folder / DATABASE_FILE).is_file():
        return Row(outcome=outcome, summary=None)
    try:
        with grids_kept(), Project.open(outcome.site.folder).reader() as reader:
            return Row(outcome=outcome, summary=summarise(reader, tools))
    except GeorefError:
        # Its outcome says what is wrong; figures are not known.
        return Row(outcome=outcome, summary=None)


def _say(feedback: PlainFeedback, outcome: Outcome, number: int, count: int) -> None:
    text = f"{number}/{count} {outcome.site.name}: {outcome.state}"
    told = outcome.message or f"{outcome.duration_s:.1f} s"
    feedback.info(f"{text}, {told}" if outcome.state != "cancelled" else text)


def _exit_code(outcomes: Sequence[Outcome]) -> int:
    states = {outcome.state for outcome in outcomes}
    if "cancelled" in states:
        return CANCELLED
    return BUG if "bug" in states else USER_ERROR if "failed" in states else DONE


def _tell(feedback: PlainFeedback, rows: Sequence[Row], written: Sequence[Path], code: int) -> None:
    states = [row.outcome.state for row in rows]
    counts = {state: states.count(state) for state in dict.fromkeys(states)}
    if isinstance(feedback, JsonFeedback):
        feedback.event(
            "batch",
            sites=[row.values() for row in rows],
            products=[str(path) for path in written],
            exit_code=code,
        )
        return
    from georef_gis.app.report import short_path

    feedback.__exit__()
    for path in written:
        click.echo(f"wrote  {short_path(path)}")
    click.echo(f"sites  {', '.join(f'{number} {state}' for state, number in counts.items())}")
