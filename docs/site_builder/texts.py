"""Pieces of Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence


def markdown(text: str) -> str:
    """Plain text of a docstring as Markdown; spans of code and names of chapters have a meaning."""
    text = re.sub(r"(?<![`/\w])docs/(\w+\.md)\b(?!`)", r"`\1`", text)
    parts = re.split(r"(``[^`]+``|`[^`]+`)", text)
    return "".join(
        part if number % 2 else re.sub(r"([\\<>*\[\]$#])", r"\\\1", part)
        for number, part in enumerate(parts)
    )


def cells(*texts: str) -> str:
    """Row of a table."""
    return "| " + " | ".join(text.replace("|", "\\|").replace("\n", " ") for text in texts) + " |"


def table(head: Sequence[str], rows: Sequence[str]) -> str:
    """Table of a head and of rows that `cells` made."""
    return "\n".join([cells(*head), "|" + "---|" * len(head), *rows])


def block(text: str, language: str = "text") -> str:
    """Block of code."""
    return f"```{language}\n{text}\n```"


def folded(command: str, most: int = 96) -> str:
    """Line of a shell, broken before options where it is longer than `most` characters."""
    lines = [""]
    for piece in re.split(r" (?=--)", command):
        if lines[-1] and len(lines[-1]) + len(piece) + 3 > most:
            lines[-1] += " \\"
            lines.append(f"    {piece}")
        else:
            lines[-1] = (
                f"{lines[-1]} {piece}".lstrip() if len(lines) == 1 else f"{lines[-1]} {piece}"
            )
    return "\n".join(lines)


def toctree(pages: Sequence[str], caption: str = "") -> str:
    """Block that hangs pages into the navigation without showing a list."""
    named = f":caption: {caption}\n" if caption else ""
    return block(f":hidden:\n:maxdepth: 1\n{named}\n" + "\n".join(pages), "{toctree}")
