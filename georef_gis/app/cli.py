"""The command line, made from the manifest of the tools: ``georef``."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from georef_gis import __version__
from georef_gis.app.batch.command import batch
from georef_gis.app.facing import (
    CANCELLED,
    DONE,
    USER_ERROR,
    Face,
    face_options,
    facing,
    fail,
)
from georef_gis.app.feedback import JsonFeedback, PlainFeedback
from georef_gis.app.grids import grids
from georef_gis.app.qgis import qgis
from georef_gis.app.serve import serve
from georef_gis.app.values import step_values
from georef_gis.errors import GeorefError

if TYPE_CHECKING:
    from georef_gis.toolbox.registry import Registry, Tool
    from georef_gis.toolbox.specs import Spec
    from georef_gis.toolbox.steps import RunOptions, StepReport

BUILT_IN = ("run", "batch", "serve", "qgis", "grids", "tools", "doctor")


class Tools(click.Group):
    """Commands of the application, and one for every tool; made when asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands."""
        words = [command_words(tool)[0] for tool in _registry()]
        return list(dict.fromkeys([*BUILT_IN, *words]))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Make the command of a name."""
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        return group_command(cmd_name) or tool_command(_registry().find(cmd_name))

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run a command; what is wrong with its words is one line, as every error."""
        kwargs["standalone_mode"] = False
        try:
            sys.exit(super().main(*args, **kwargs) or DONE)
        except click.UsageError as error:
            path = error.ctx.command_path if error.ctx else "georef"
            fail(f"{error.format_message().rstrip('.')}; see `{path} --help`", USER_ERROR)
        except GeorefError as error:
            fail(str(error), USER_ERROR)
        except click.ClickException as error:
            fail(error.format_message(), USER_ERROR)
        except click.Abort:
            fail("cancelled", CANCELLED)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the tools by group."""
        with formatter.section("Commands"):
            built_in = [(name, self.commands[name].get_short_help_str(70)) for name in BUILT_IN]
            formatter.write_dl(built_in)
        registry = _registry()
        groups: dict[str, list[tuple[str, str]]] = {}
        for tool in registry:
            line = (" ".join(command_words(tool)), tool.algorithm.summary())
            groups.setdefault(tool.algorithm.group, []).append(line)
        for group, lines in groups.items():
            with formatter.section(f"Tools: {group}"):
                formatter.write_dl(lines)


def _registry() -> Registry:
    from georef_gis.toolbox.registry import load_registry

    return load_registry()


@click.group(
    cls=Tools,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="georef")
@click.pass_context
def georef(ctx: click.Context) -> None:
    """From UAV photos to orthos, mosaics and measurements, each with how far to trust it.

    Begin with `georef init photos/`, then `georef run .`
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@georef.command(short_help="Make the products: all steps that are not up to date.")
@click.argument("project", default=".", type=click.Path(path_type=Path))
@click.option("--quick", is_flag=True, help="A first answer, from the poses alone.")
@click.option("--only", metavar="ID[,ID]", multiple=True, help="Only these steps.")
@click.option("--from", "start", metavar="ID", default="", help="From this step on.")
@click.option("--force", is_flag=True, help="Run steps that are up to date too.")
@click.option("--verify", is_flag=True, help="Hash all of the inputs and products.")
@click.option(
    "--set",
    "values",
    metavar="ID.NAME=VALUE",
    multiple=True,
    help="Parameter of a step, before those in project.toml.",
)
@click.option("--workers", type=click.IntRange(1), help="Number of processes.")
@click.option("--seed", type=int, help="Of every random choice.")
@face_options
def run(project: Path, as_json: bool, verbose: int, values: tuple[str, ...], **wishes: Any) -> None:
    """Make the products of PROJECT, a folder with a project.toml.

    Steps whose inputs, settings and products did not change are skipped.
    """
    face = Face(as_json=as_json, verbose=verbose)
    with facing(face) as feedback:
        from georef_gis.app.report import report_event, run_lines
        from georef_gis.project import Project
        from georef_gis.toolbox.runner import run_pipeline

        wishes["only"] = tuple(name for part in wishes["only"] for name in part.split(",") if name)
        given, options = step_values(values), _options(wishes)
        found = Project.open(project)
        reports = run_pipeline(_registry(), found, feedback, values=given, options=options)
        _finish(
            feedback,
            [report_event(report) for report in reports],
            run_lines(reports, found.folder / "georef.gpkg"),
        )


@georef.command(short_help="List the tools.")
@click.option("--json", "as_json", is_flag=True, help="The manifest: every tool with its form.")
def tools(as_json: bool) -> None:
    """List the tools, with the steps of `georef run` marked by a star."""
    with facing(Face(as_json=as_json, verbose=0)):
        registry = _registry()
        if as_json:
            from georef_gis.toolbox.algorithm import manifest

            content = manifest((tool.provider, tool.algorithm) for tool in registry)
            click.echo(json.dumps(content, indent=1))
            return
        for tool in registry:
            star = "*" if tool.algorithm.in_run else " "
            click.echo(f"{star} {' '.join(command_words(tool)):<24} {tool.algorithm.summary()}")
        if registry.refused:
            click.echo(f"{len(registry.refused)} refused; see `georef doctor`", err=True)


@georef.command(short_help="Look at the installation.")
@click.argument("folder", default=".", type=click.Path(path_type=Path))
@face_options
def doctor(folder: Path, as_json: bool, verbose: int) -> None:
    """Look at the installation, the plug-ins and the place to work in.

    FOLDER is where a project would be. Exit code 2 if something would keep work from being done.
    """
    with facing(Face(as_json=as_json, verbose=verbose)):
        from georef_gis.app.doctor import examine

        findings = examine(_registry(), folder)
        if as_json:
            click.echo(json.dumps([finding.content() for finding in findings], indent=1))
        else:
            for finding in findings:
                click.echo(finding.line())
        if any(finding.state == "bad" for finding in findings):
            sys.exit(USER_ERROR)


georef.add_command(batch)
georef.add_command(serve)
georef.add_command(qgis)
georef.add_command(grids)


def command_words(tool: Tool) -> tuple[str, ...]:
    """Words of a tool's command: one, or a group and a command in it.

    Words that are taken by an earlier tool, and groups named like a tool, are not given again.
    """
    registry = _registry()
    words = tool.algorithm.command
    taken = {other.algorithm.command for other in _before(registry, tool)}
    names = {*BUILT_IN, *(registry.command(other) for other in registry)}
    return (
        words
        if words and words not in taken and words[0] not in names
        else (registry.command(tool),)
    )


def _before(registry: Registry, tool: Tool) -> Iterator[Tool]:
    """Tools that go before one."""
    return itertools.takewhile(lambda other: other is not tool, registry)


def group_command(name: str) -> click.Group | None:
    """Make a group of tools, e.g. ``georef sync-board``; None if there is none of that name."""
    found = {
        words[1]: tool_command(tool)
        for tool, words in ((tool, command_words(tool)) for tool in _registry())
        if len(words) == 2 and words[0] == name
    }
    if not found:
        return None

    def show_help() -> None:
        context = click.get_current_context()
        if context.invoked_subcommand is None:
            click.echo(context.get_help())

    return click.Group(
        name=name,
        commands=found,
        callback=show_help,
        invoke_without_command=True,
        help=f"Tools: {', '.join(found)}.",
        short_help=f"{len(found)} tools",
    )


def tool_command(tool: Tool) -> click.Command:
    """Make the command of a tool from its declaration."""
    specs = tool.algorithm.Parameters.specs()
    parameters = [_parameter(spec) for spec in specs]
    if tool.algorithm.needs_project:
        parameters.append(
            click.Option(
                ["--project", "_project"],
                default=".",
                show_default=True,
                metavar="FOLDER",
                help="Folder of the project.",
            )
        )
    parameters += [
        click.Option(["--force", "_force"], is_flag=True, help="Run it though it is up to date."),
        click.Option(["--workers", "_workers"], type=click.IntRange(1), help="Processes to use."),
        click.Option(["--seed", "_seed"], type=int, help="Of every random choice."),
        click.Option(["--json", "_json"], is_flag=True, help="Talk in lines of JSON."),
        click.Option(["-v", "--verbose", "_verbose"], count=True, help="Say more."),
    ]
    return click.Command(
        name=command_words(tool)[-1],
        params=parameters,
        help=tool.algorithm.help(),
        short_help=tool.algorithm.summary(),
        callback=lambda **values: _run_tool(tool, specs, values),
    )


def _run_tool(tool: Tool, specs: Sequence[Spec], values: dict[str, Any]) -> None:
    about = tool.algorithm.about
    face = Face(as_json=values["_json"], verbose=values["_verbose"], about=about)
    with facing(face) as feedback:
        from georef_gis.app.report import report_event, tool_lines
        from georef_gis.project import Project
        from georef_gis.toolbox.runner import run_tool

        given = {
            spec.name: values[spec.name] for spec in specs if values[spec.name] not in (None, ())
        }
        project = Project.open(values["_project"]) if tool.algorithm.needs_project else None
        wishes = {key: values[f"_{key}"] for key in ("force", "workers", "seed")}
        report: StepReport = run_tool(
            _registry(), tool.full_id, given, feedback, project=project, options=_options(wishes)
        )
        _finish(feedback, [report_event(report)], tool_lines(report))


def _parameter(spec: Spec) -> click.Parameter:
    if spec.positional:
        many = -1 if spec.multiple or spec.kind == "PhotoSet" else 1
        return click.Argument(
            [spec.name], required=spec.required, nargs=many, metavar=spec.name.upper()
        )
    name = f"--{spec.option}"
    if spec.kind == "Flag":
        return click.Option(
            [f"{name}/--no-{spec.option}", spec.name], default=None, help=_help(spec)
        )
    return click.Option(
        [name, spec.name],
        required=spec.required,
        multiple=spec.multiple or spec.kind == "PhotoSet",
        metavar="|".join(spec.choices) or spec.kind.upper(),
        help=_help(spec),
    )


def _help(spec: Spec) -> str:
    notes = [spec.limits() or spec.unit]
    if spec.default not in (None, [], ""):
        shown = (
            ", ".join(map(str, spec.default)) if isinstance(spec.default, list) else spec.default
        )
        unit = f" {spec.unit}" if spec.unit else ""
        notes.append(f"default {shown}{unit}")
    if spec.advanced:
        notes.append("advanced")
    text = f"{spec.title}. {spec.help}".strip()
    noted = "; ".join(note for note in notes if note)
    return f"{text} [{noted}]" if noted else text


def _options(wishes: dict[str, Any]) -> RunOptions:
    from georef_gis.toolbox.steps import RunOptions

    return RunOptions(**{key: value for key, value in wishes.items() if value is not None})


def _finish(feedback: PlainFeedback, events: list[dict[str, Any]], lines: list[str]) -> None:
    if isinstance(feedback, JsonFeedback):
        for event in events:
            feedback.event("result", **event)
        return
    feedback.say_warnings(told=[d for e in events for d in e["summary"].get("doubts", ())])
    feedback.__exit__()
    for line in lines:
        click.echo(line)


def main() -> None:
    """Entry point of the script ``georef``."""
    georef(prog_name="georef")
