"""Messages about many photos, or other things with names, as one line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from georef_gis.toolbox.ranges import with_ranges, without_figures

# names listed one by one; more become the first and the last, or a count
MOST_NAMES = 3
_TRAILING_NUMBER = re.compile(r"(\d+)(?:\.\w+)?$")
# stands for the name inside a message; no message holds it
_NAME = "\0"
# A name before the first colon may be another thing's.
_OTHER_HEADS = ("camera ", "tool ", "project.toml")
_LINE_OF_FILE = re.compile(r", line \d+$")


def grouped(messages: Sequence[str], about: str = "photos") -> list[str]:
    """Messages in order, with those that differ only in the name and their figures as one.

    ``a.jpg: no heading`` and ``b.jpg: no heading`` become ``2 photos (a.jpg, b.jpg): no heading``;
    figures that differ become ranges, ``12 to 15``.

    Parameters
    ----------
    about
        What the names are of, in the plural: that of the tool.
    """
    groups: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    for message in dict.fromkeys(messages):
        name, text = _split(message)
        key = (without_figures(text),) if name else (message, "")
        groups.setdefault(key, []).append((name, text, message))
    return [_line(members, about) for members in groups.values()]


def _split(message: str) -> tuple[str, str]:
    """Name that a message begins with, and the rest; ('', message) without one."""
    head, colon, text = message.partition(": ")
    name = head.removeprefix("photo ")
    if not colon or not name or "\n" in name or name.startswith(_OTHER_HEADS):
        return "", message
    if _LINE_OF_FILE.search(name):
        return "", message
    for spelling in (name, PurePath(name).name):
        text = re.sub(rf"(?<!\w){re.escape(spelling)}(?!\w)", _NAME, text)
    return name, text


def _line(members: Sequence[tuple[str, str, str]], about: str) -> str:
    name, _, message = members[0]
    if len(members) == 1:
        return message
    names = list(dict.fromkeys(PurePath(name).name for name, *_ in members))
    if len(names) == 1:
        head = f"{name}: "
    else:
        head = f"{len(members)} {about} ({_names(names)}): "
    return head + with_ranges([text for _, text, _ in members]).replace(_NAME, PurePath(name).name)


def _names(names: Sequence[str]) -> str:
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    numbers = [int(found[1]) if (found := _TRAILING_NUMBER.search(n)) else None for n in names]
    first = numbers[0]
    if first is not None and numbers == list(range(first, first + len(names))):
        return f"{names[0]} ... {names[-1]}"
    return f"{', '.join(names[:MOST_NAMES])} and {len(names) - MOST_NAMES} more"
