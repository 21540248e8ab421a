"""A page for every command, made from the manifest of the tools and from click's own help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import click

from georef_gis.app import cli
from georef_gis.errors import GeorefError
from georef_gis.toolbox.registry import Tool, load_registry
from site_builder.chapters import CHAPTER_OF_GROUP
from site_builder.command_lines import CommandLine, command_of
from site_builder.examples import LINES
from site_builder.texts import block, cells, folded, markdown, table, toctree

TITLES = {
    "project": "Project",
    "ingest": "Ingest: photos and logs",
    "navigate": "Navigate: logs to poses",
    "orient": "Orient: tags, ties, adjustment, calibration",
    "rectify": "Rectify: footprints and orthos",
    "mosaic": "Mosaic",
    "measure": "Measure",
    "export": "Export",
}
# Chapters that speak of many commands, and explain none.
GENERAL = ("index", "quick_start", "start", "architecture", "benchmarks", "changelog")
TYPES = {
    "File": "file", "Folder": "folder", "PhotoSet": "photos", "Crs": "CRS", "Extent": "extent",
    "RasterLayer": "raster", "VectorLayer": "layer", "MapPoint": "point", "PhotoPixel": "pixel",
    "Length": "length", "Angle": "angle", "Number": "number", "Integer": "whole number",
    "Text": "text", "Flag": "yes or no", "Choice": "choice", "TableField": "column",
}  # fmt: skip
# What stands for a value in an example that no chapter gives.
EXAMPLES = {
    "File": "file.csv", "Folder": "folder", "PhotoSet": "IMG_0013.JPG", "Crs": "EPSG:6549",
    "Extent": "586000,4389000,586400,4389300", "RasterLayer": "products/mosaic.tif",
    "VectorLayer": "assets", "MapPoint": "586200,4389150", "PhotoPixel": "IMG_0013.JPG:421.8,249.7",
    "Text": "name", "TableField": "name",
}  # fmt: skip
HEAD = ("Name", "Value", "Default", "Meaning")


@dataclass(frozen=True, slots=True, kw_only=True)
class Mention:
    """A command line of a chapter."""

    chapter: str
    line: CommandLine


def tool_pages(lines: Mapping[str, Sequence[CommandLine]]) -> dict[str, str]:
    """Markdown of the page of every command and of their index, by path below the site.

    Parameters
    ----------
    lines
        Command lines of the chapters, in the order of reading.
    """
    registry, mentions = load_registry(), _by_command(lines)
    words = {tool.full_id: cli.command_words(tool) for tool in registry}
    givers = _givers(registry)
    pages = {
        f"tools/{page_name(path)}.md": _tool_page(tool, path, mentions.get(path, ()), givers, lines)
        for tool in registry
        for path in (words[tool.full_id],)
    }
    for name in cli.BUILT_IN:
        command, path, _ = command_of((name,))
        for inner, inner_path in _with_inner(command, path):
            page = _built_in_page(inner, inner_path, mentions.get(inner_path, ()))
            pages[f"tools/{page_name(inner_path)}.md"] = page
    pages["tools/index.md"] = _index([(tool, words[tool.full_id]) for tool in registry])
    return pages


def page_name(path: Sequence[str]) -> str:
    """Name of the page of a command."""
    return "-".join(path).replace(":", "-")


def _with_inner(
    command: click.Command, path: tuple[str, ...]
) -> Iterator[tuple[click.Command, tuple[str, ...]]]:
    """Yield a command and, of a group, those in it."""
    yield command, path
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from _with_inner(inner, (*path, name))


def _by_command(
    lines: Mapping[str, Sequence[CommandLine]],
) -> dict[tuple[str, ...], tuple[Mention, ...]]:
    """Mentions of every command, by its words."""
    found: dict[tuple[str, ...], tuple[Mention, ...]] = {}
    for chapter, of_chapter in lines.items():
        for line in of_chapter:
            try:
                _, path, _ = command_of(line.words)
            except (click.UsageError, GeorefError):
                continue
            found[path] = (*found.get(path, ()), Mention(chapter=chapter, line=line))
    return found


def _givers(registry: Iterable[Tool]) -> dict[str, list[Tool]]:
    """Tools that give what others need, by its name."""
    givers: dict[str, list[Tool]] = {}
    for tool in registry:
        for name in tool.algorithm.gives:
            givers.setdefault(name, []).append(tool)
    return givers


def _tool_page(
    tool: Tool,
    path: tuple[str, ...],
    mentions: Sequence[Mention],
    givers: Mapping[str, Sequence[Tool]],
    chapters: Iterable[str],
) -> str:
    """Page of one tool."""
    told = tool.algorithm.manifest()
    chapter = CHAPTER_OF_GROUP.get(told["group"], "")
    lead = f"**{markdown(told['name'])}** · {told['group']}"
    lead += " · a step of `georef run`" if told["in_run"] else ""
    ours = [line for line, of in _paths_of_examples() if of == path]
    examples = _examples(mentions) or ours or [_made_example(told, path)]
    parts = [
        f"# {' '.join(path)}\n\n{lead}\n\n{markdown(told['help'])}",
        "## Example\n\n" + "\n".join(block(folded(example)) for example in examples),
        _parameters(told["parameters"]),
        _outputs(told["outputs"]),
        _order(told, givers),
        _common(tool),
        _explained(mentions, chapter if chapter in chapters else ""),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


@cache
def _paths_of_examples() -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Examples of ours, each with the words of its command."""
    return tuple((line, command_of(line.split()[1:])[1]) for line in LINES)


def _examples(mentions: Sequence[Mention], most: int = 3) -> list[str]:
    """Lines of the chapters that may be typed as they are."""
    whole = [mention.line for mention in mentions if mention.line.whole]
    return list(dict.fromkeys("georef " + _joined(line.words) for line in whole))[:most]


def _joined(words: Sequence[str]) -> str:
    return " ".join(f'"{word}"' if re.search(r"[\s|;&]", word) else word for word in words)


def _made_example(told: Mapping[str, Any], path: Sequence[str]) -> str:
    """A shortest line: what is required, and the project."""
    words = ["georef", *path]
    for given in told["parameters"]:
        if given["required"]:
            value = _example_value(given)
            words += [value] if given.get("positional") else [f"--{_option(given)}", value]
    return " ".join(words + ["--project", "my_site"] * told["needs_project"])


def _example_value(given: Mapping[str, Any]) -> str:
    if given.get("choices"):
        return str(given["choices"][0])
    if given["type"] == "File" and given.get("suffixes"):
        return "file" + str(given["suffixes"][0])
    low = given.get("minimum", given.get("above", 0))
    number = low + 1 if given["type"] == "Integer" else low + 1.0
    return EXAMPLES.get(given["type"], f"{number:g}{given.get('unit', '')}")


def _option(given: Mapping[str, Any]) -> str:
    return str(given["name"]).replace("_", "-")


def _parameters(parameters: Sequence[Mapping[str, Any]]) -> str:
    """Tables of the parameters, the advanced apart."""
    common = [given for given in parameters if not given.get("advanced")]
    advanced = [given for given in parameters if given.get("advanced")]
    parts = [
        f"## {title}\n\n" + table(HEAD, [parameter_row(one) for one in given])
        for title, given in (("Parameters", common), ("Advanced parameters", advanced))
        if given
    ]
    return "\n\n".join(parts)


def parameter_row(given: Mapping[str, Any]) -> str:
    """Row of a parameter of the manifest."""
    name = given["name"].upper() if given.get("positional") else f"--{_option(given)}"
    if given["type"] == "Flag" and not given.get("positional"):
        name += f"`, `--no-{_option(given)}"
    return cells(f"`{name}`", _value(given), _default(given), _meaning(given))


def _value(given: Mapping[str, Any]) -> str:
    """Kind, unit, limits and number of what may be given."""
    kind = f"[{TYPES[given['type']]}](../values.md#{anchor_of(given['type'])})"
    unit = f"in {given['unit']}" if given.get("unit") else ""
    again = "may be given again" if given.get("multiple") else ""
    return ", ".join(part for part in (f"{kind} {unit}".strip(), _range(given), again) if part)


def _meaning(given: Mapping[str, Any]) -> str:
    """Title and help; a help that begins small goes on with the title's sentence."""
    title, text = given["title"].strip().rstrip("."), given.get("help", "").strip()
    end = "" if title.endswith("?") else "."
    joined = f"{title} – {text}" if text[:1].islower() else f"{title}{end} {text}".strip()
    return markdown(joined)


def anchor_of(kind: str) -> str:
    """Heading in ``values.md`` of a parameter type."""
    return TYPES[kind].replace(" ", "-").lower()


def _default(given: Mapping[str, Any]) -> str:
    if given["required"]:
        return "required"
    value = given["default"]
    if value in (None, "", []):
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    shown = ", ".join(_plain(one) for one in (value if isinstance(value, list) else [value]))
    return f"`{shown}`" + (f" {given['unit']}" if given.get("unit") else "")


def _plain(value: Any) -> str:
    """Shortest text of a value: 15, not 15.0."""
    short = f"{value:g}" if isinstance(value, float) else str(value)
    return short if not isinstance(value, float) or float(short) == value else str(value)


def _range(given: Mapping[str, Any]) -> str:
    """Choices, endings of files or limits, in words."""
    if given.get("choices"):
        return ", ".join(f"`{choice}`" for choice in given["choices"])
    if given.get("suffixes"):
        return ", ".join(f"`{suffix}`" for suffix in given["suffixes"])
    if "minimum" in given and "maximum" in given:
        return f"{given['minimum']:g} to {given['maximum']:g}"
    signs = {"minimum": "at least", "above": "above", "maximum": "at most", "below": "below"}
    return ", ".join(f"{sign} {given[key]:g}" for key, sign in signs.items() if key in given)


def _outputs(outputs: Sequence[Mapping[str, Any]]) -> str:
    if not outputs:
        return ""
    rows = [
        cells(f"`{given['name']}`", TYPES.get(given["type"], given["type"]), given["title"])
        for given in outputs
    ]
    return "## Outputs\n\n" + table(("Name", "Kind", "What"), rows)


def _order(told: Mapping[str, Any], givers: Mapping[str, Sequence[Tool]]) -> str:
    """Say what must be there before, and what is there after."""
    needs = [
        f"- needs `{name}`" + _from([g for g in givers.get(name, ()) if g.id != told["id"]])
        for name in told["needs"]
    ]
    gives = [f"- gives `{name}`" for name in told["gives"]]
    if not (needs or gives):
        return ""
    return "## Order\n\n" + "\n".join(needs + gives)


def _from(givers: Sequence[Tool]) -> str:
    links = [_link(cli.command_words(tool)) for tool in givers]
    return f", from {' or '.join(links)}" if links else ""


def _link(path: Sequence[str]) -> str:
    return f"[`{' '.join(path)}`]({page_name(path)}.md)"


def _common(tool: Tool) -> str:
    """Name the options that every tool has, as the command line makes them."""
    own = {spec.name for spec in tool.algorithm.Parameters.specs()}
    rest = [given for given in cli.tool_command(tool).params if given.name not in own]
    return "## Options of every tool\n\n" + _click_table(rest)


def _click_table(parameters: Sequence[click.Parameter]) -> str:
    rows = []
    for given in parameters:
        if isinstance(given, click.Option):
            value = "" if given.is_flag or given.count else f" {given.make_metavar(_context())}"
            names = f"`, `{given.secondary_opts[0]}" if given.secondary_opts else ""
            name = f"`{', '.join(given.opts)}{value}{names}`"
            rows.append(cells(name, markdown(given.help or "")))
    return table(("Option", "Meaning"), rows) if rows else ""


def _context() -> click.Context:
    return click.Context(cli.georef)


def _explained(mentions: Sequence[Mention], otherwise: str) -> str:
    """Link the chapters that speak of a command."""
    chapters = dict.fromkeys(mention.chapter for mention in mentions)
    names = [name for name in chapters if name not in GENERAL] or [otherwise] * bool(otherwise)
    if not names:
        return ""
    return "## Explained in\n\n" + "\n".join(f"- [](../{name}.md)" for name in names)


def _built_in_page(
    command: click.Command, path: tuple[str, ...], mentions: Sequence[Mention]
) -> str:
    """Page of a command of the application, from click's help."""
    parts = [f"# {' '.join(path)}\n\n{markdown(inspect.cleandoc(command.help or ''))}"]
    examples = _examples(mentions)
    if not examples and not isinstance(command, click.Group):
        needed = [p for p in command.params if p.required]
        examples = [] if needed else ["georef " + " ".join(path)]
    if examples:
        parts.append("## Example\n\n" + "\n".join(block(folded(example)) for example in examples))
    if isinstance(command, click.Group) and command.commands:
        links = [
            f"- {_link((*path, name))}: {markdown(inner.get_short_help_str(200))}"
            for name, inner in command.commands.items()
        ]
        parts.append("## Commands\n\n" + "\n".join(links))
    usage = command.get_usage(click.Context(command, info_name="georef " + " ".join(path)))
    parts.append(f"## Options\n\n```text\n{usage}\n```\n\n" + _click_table(command.params))
    parts.append(_explained(mentions, ""))
    return "\n\n".join(part for part in parts if part) + "\n"


def _index(tools: Sequence[tuple[Tool, tuple[str, ...]]]) -> str:
    """All commands by group, and the tree of their pages."""
    parts = [
        "# Tools\n\nEvery command of `georef`, in the order of the work. These pages are made from "
        "`georef tools --json`, which the command line, the page of `georef serve` and plug-ins "
        "are made from too; `georef TOOL --help` says the same. A step of `georef run` has a star."
        " How lengths, points and the like are written: [](../values.md)."
    ]
    built_in = [(name, *command_of((name,))[:2]) for name in cli.BUILT_IN]
    rows = [
        cells(_link(path), "", markdown(command.get_short_help_str(200)))
        for _, command, path in built_in
    ]
    pages = [page_name(p) for _, c, path in built_in for _, p in _with_inner(c, path)]
    parts.append(_group("Commands of the application", rows, pages))
    for group in dict.fromkeys(tool.algorithm.group for tool, _ in tools):
        of_group = [(tool.algorithm, path) for tool, path in tools if tool.algorithm.group == group]
        rows = [
            cells(_link(path), "★" if tool.in_run else "", markdown(tool.summary()))
            for tool, path in of_group
        ]
        title = TITLES.get(group, group.capitalize())
        parts.append(_group(title, rows, [page_name(path) for _, path in of_group]))
    return "\n\n".join(parts) + "\n"


def _group(title: str, rows: Sequence[str], pages: Sequence[str]) -> str:
    return f"## {title}\n\n{table(('Command', '', 'What it does'), rows)}\n\n" + toctree(pages)
