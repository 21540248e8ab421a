"""What is said of points, as few lines: by their names, not as if these were photos."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")


def points_told(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Lines, those of several points that differ in their figures only as one.

    Parameters
    ----------
    lines
        (name of the point, what is said of it).
    """
    from georef_gis.ingest.control_photos import some_names

    groups: dict[str, list[tuple[str, str]]] = {}
    for name, text in lines:
        groups.setdefault(_NUMBER.sub("#", text), []).append((name, text))
    out = []
    for members in groups.values():
        names = list(dict.fromkeys(name for name, _ in members))
        head = names[0] if len(names) == 1 else f"{len(names)} points ({some_names(names)})"
        out.append(f"{head}: {_with_ranges([text for _, text in members])}")
    return out


def _with_ranges(texts: Sequence[str]) -> str:
    """The text that all share, with the least and the greatest of each figure that differs."""
    columns = list(zip(*(_NUMBER.findall(text) for text in texts), strict=True))
    shown = iter(
        column[0]
        if len(set(column)) == 1
        else f"{min(column, key=float)} to {max(column, key=float)}"
        for column in columns
    )
    return _NUMBER.sub(lambda _: next(shown), texts[0])
