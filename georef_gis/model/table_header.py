"""What the `#` lines before a table of points or photos say, such as ``# crs: EPSG:6549``."""

from __future__ import annotations

import re
from collections.abc import Iterable

_VALUE = re.compile(r"^#\s*([A-Za-z_ ]+?)\s*[:=]\s*(\S.*)$")


def header_values(lines: Iterable[str]) -> dict[str, str]:
    """Values by name, in lower case and with `_` for blanks; other lines say nothing."""
    found = (_VALUE.match(line.strip()) for line in lines)
    return {m[1].strip().lower().replace(" ", "_"): m[2].strip() for m in found if m}


def stated_height(header: dict[str, str]) -> tuple[str, str]:
    """Kind of the heights and their geoid, by `height: orthometric geoid18` or a line for each.

    "unknown" and "" where nothing is said.
    """
    words = header.get("height", header.get("height_kind", "unknown")).lower().split()
    return words[0], words[1] if len(words) > 1 else header.get("geoid", "").lower()
