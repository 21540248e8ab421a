"""Command lines of ``georef`` in texts, and whether the program would take them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING

import click
from markdown_it import MarkdownIt

from georef_gis.app import cli
from georef_gis.errors import GeorefError

if TYPE_CHECKING:
    from markdown_it.token import Token

    from georef_gis.toolbox.registry import Tool

PROGRAM = "georef"
SEPARATORS = {"|", "||", "&&", ";", "&", ">", ">>", "<", "2>"}
# ``[--closed]`` and ``...`` are signs of a synopsis, which no program takes.
SYNOPSIS = re.compile(r"\[|\.\.\.|\{")
# ``TOOL``, ``export-...``, what a program puts into its messages, and an option of no command
PLACEHOLDER = re.compile(r"^[A-Z][A-Z_]*$|.*\.\.\.$|^\{|^--json$")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandLine:
    """A command line of a text.

    Parameters
    ----------
    line
        Number of the line of the text on which its block or paragraph begins, from 1.
    words
        What follows ``georef``.
    whole
        Whether it may be typed as it is: it stands in a block and is no synopsis.
    text
        As it stands.
    """

    line: int
    words: tuple[str, ...]
    whole: bool
    text: str


def command_lines(markdown: str) -> list[CommandLine]:
    """Command lines of a text, those in blocks and those in sentences."""
    found: list[CommandLine] = []
    for token in MarkdownIt("commonmark").enable("table").parse(markdown):
        line = token.map[0] + 1 if token.map else 0
        if token.type in ("fence", "code_block"):
            found += _of_block(token.content, line)
        for child in token.children or ():
            if child.type == "code_inline":
                found += _of_mention(child, line)
    return found


def _of_block(content: str, line: int) -> Iterator[CommandLine]:
    for text in re.sub(r"\\\n\s*", "", content).splitlines():
        for words in _programs(text):
            whole = SYNOPSIS.search(" ".join(words)) is None
            yield CommandLine(line=line, words=words, whole=whole, text=_bare(text))


def _of_mention(token: Token, line: int) -> Iterator[CommandLine]:
    # a bar in a table is written with a backslash
    text = token.content.replace("\\|", "|")
    if text.startswith(f"{PROGRAM} "):
        yield CommandLine(line=line, words=tuple(text.split()[1:]), whole=False, text=text)


def _programs(text: str) -> Iterator[tuple[str, ...]]:
    """Words after ``georef`` of every call of it in one line of a shell."""
    # Windows' paths are written with what is an escape elsewhere
    text = re.sub(r"\\(?=\w)", "/", text.strip().removeprefix("$ "))
    try:
        words = shlex.split(text, comments=True)
    except ValueError:
        return
    call: list[str] = []
    for word in [*words, ";"]:
        if word not in SEPARATORS:
            call.append(word)
            continue
        while call and re.match(r"^\w+=", call[0]):
            call.pop(0)
        if call and _is_program(call[0]):
            yield tuple(call[1:])
        call = []


def _is_program(word: str) -> bool:
    return PROGRAM in (PurePosixPath(word).name, PureWindowsPath(word).stem)


def _bare(text: str) -> str:
    """A line without its comment and the blanks round it."""
    return re.sub(r"\s+#\s.*$", "", text).strip()


def command_of(words: Sequence[str]) -> tuple[click.Command, tuple[str, ...], tuple[str, ...]]:
    """Command that the first words name, these words, and what follows them.

    Raises
    ------
    GeorefError, click.UsageError
        If there is no such command.
    """
    command: click.Command = cli.georef
    path: tuple[str, ...] = ()
    rest = tuple(words)
    while isinstance(command, click.Group) and rest and not rest[0].startswith("-"):
        inner = command.get_command(click.Context(command), rest[0])
        if inner is None:
            raise click.UsageError(f"no command {' '.join((*path, rest[0]))!r}")
        command, path, rest = inner, (*path, rest[0]), rest[1:]
    return command, path, rest


def problem(line: CommandLine) -> str:
    """Why the program would not take a line; empty if it would.

    Of a mention and a synopsis only the command and the names of its options are looked at.
    """
    if line.words and PLACEHOLDER.match(line.words[0]):
        return ""
    try:
        command, path, rest = command_of(line.words)
        unknown = [word for word in _options(rest) if word not in _known(command)]
        if unknown:
            return f"`georef {' '.join(path)}` has no option {unknown[0]}"
        if line.whole:
            _try(command, path, rest)
    except click.exceptions.Exit:
        return ""
    except click.UsageError as error:
        return error.format_message()
    except GeorefError as error:
        return str(error)
    return ""


def _options(words: Sequence[str]) -> list[str]:
    """Names of options among words, without their values and brackets."""
    names = [re.match(r"^\[?(--?[a-zA-Z][\w-]*)", word) for word in words]
    return [name[1] for name in names if name]


def _known(command: click.Command) -> set[str]:
    parameters = command.get_params(click.Context(command))
    return {name for given in parameters for name in (*given.opts, *given.secondary_opts)}


def _try(command: click.Command, path: tuple[str, ...], words: Sequence[str]) -> None:
    """Read words as the program would; raise what it would."""
    context = command.make_context(" ".join(path), list(words))
    tool = tool_of(path)
    if tool is not None:
        names = [spec.name for spec in tool.algorithm.Parameters.specs()]
        given = {name: context.params[name] for name in names}
        tool.algorithm.Parameters(
            **{name: value for name, value in given.items() if value not in (None, ())}
        )
    elif path == ("run",):
        _try_steps(context.params)


def _try_steps(given: dict[str, object]) -> None:
    """Look whether the steps and parameters exist that ``georef run`` is told."""
    from georef_gis.errors import InputError
    from georef_gis.toolbox.registry import load_registry

    registry = load_registry()
    only, start, values = given["only"], str(given["start"]), given["values"]
    assert isinstance(only, tuple)
    assert isinstance(values, tuple)
    for name in [part for text in (*only, start) for part in text.split(",") if part]:
        registry.find(name)
    for text in values:
        step, _, parameter = str(text).partition("=")[0].partition(".")
        specs = registry.find(step).algorithm.Parameters.specs()
        if parameter.replace("-", "_") not in {spec.name for spec in specs}:
            raise InputError(f"{step} has no parameter {parameter!r}", field="--set")


def tool_of(path: Sequence[str]) -> Tool | None:
    """Tool of the words of a command; None for a command of the application."""
    from georef_gis.toolbox.registry import load_registry

    return {cli.command_words(tool): tool for tool in load_registry()}.get(tuple(path))
