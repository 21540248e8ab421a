"""The commented project.toml that `georef init` writes, made from the settings' own text."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from georef_gis.project.settings import SECTIONS, Settings

HEADER = """\
# Settings of a georef project. Every key is optional; a key behind a "#" shows its default.
# Paths are relative to this file. Sigmas are one standard deviation.
"""
MOST_COLUMNS = 100
FOOTER = """
# Parameters of single tools; `georef TOOL --help` lists them.
# [tools.TOOL]
# parameter = value
"""


def render_settings(
    values: Mapping[str, Mapping[str, Any]], notes: Mapping[str, str] | None = None
) -> str:
    """Text of a project.toml with every key, described.

    Parameters
    ----------
    values
        Section -> key -> value to state; other keys stand behind a "#" with their default.
    notes
        Section -> what was found, as a comment at the head of the section.
    """
    unknown = set(values) - set(SECTIONS)
    if unknown:
        raise ValueError(f"no sections {sorted(unknown)}")
    notes = notes or {}
    parts = [HEADER]
    for name in SECTIONS:
        model = Settings.model_fields[name].annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            parts.append(_section(name, model, values.get(name, {}), notes.get(name, "")))
        else:
            parts.extend(_named(name, key, table) for key, table in values.get(name, {}).items())
    return "\n".join(parts) + FOOTER


def _section(name: str, model: type[BaseModel], values: Mapping[str, Any], note: str) -> str:
    unknown = set(values) - set(model.model_fields)
    if unknown:
        raise ValueError(f"no keys {sorted(unknown)} in [{name}]")
    about = inspect.cleandoc(model.__doc__ or "")
    lines = [*_comment(about), *_comment(note), f"[{name}]"]
    for key, field in model.model_fields.items():
        default = field.get_default(call_default_factory=True)
        shown = "" if default is None else f" {toml_value(default)}"
        line = f"{key} = {toml_value(values[key])}" if key in values else f"# {key} ={shown}"
        lines.extend(_described(line, field.description or ""))
    return "\n".join(lines) + "\n"


def _described(line: str, description: str) -> list[str]:
    """Line with its description behind it, or above it where that gets too long."""
    together = f"{line:<30} # {description}"
    if len(together) <= MOST_COLUMNS and "\n" not in description:
        return [together]
    return [*_comment(description), line]


def _named(name: str, key: str, table: Mapping[str, Any]) -> str:
    lines = [f"{item} = {toml_value(value)}" for item, value in table.items()]
    return "\n".join([f"[{name}.{toml_value(key)}]", *lines]) + "\n"


def _comment(text: str) -> list[str]:
    lines = [part for line in text.splitlines() for part in textwrap.wrap(line, 92)]
    return [f"# {line}" for line in lines]


def toml_value(value: Any) -> str:
    """TOML text of a value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        items = ", ".join(f"{toml_value(str(k))} = {toml_value(v)}" for k, v in value.items())
        return f"{{{items}}}"
    text = value.as_posix() if isinstance(value, Path) else str(value)
    return '"' + "".join(map(_escape, text)) + '"'


def _escape(letter: str) -> str:
    if letter in '"\\':
        return "\\" + letter
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"
