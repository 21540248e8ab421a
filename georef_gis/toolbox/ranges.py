"""Messages that differ in their figures only, as one."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")


def without_figures(text: str) -> str:
    """Text by which messages that differ in their figures only are alike."""
    return _NUMBER.sub("#", text)


def with_ranges(texts: Sequence[str]) -> str:
    """The text that all share, with the least and the greatest of each figure that differs."""
    columns = list(zip(*(_NUMBER.findall(text) for text in texts), strict=True))
    shown = iter(
        column[0]
        if len(set(column)) == 1
        else f"{min(column, key=float)} to {max(column, key=float)}"
        for column in columns
    )
    return _NUMBER.sub(lambda _: next(shown), texts[0])
