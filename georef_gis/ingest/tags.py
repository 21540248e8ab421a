"""Tags of a photo under the names exiftool gives them; one dictionary whatever the source."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

TagValue = str | float
Tags = dict[str, TagValue]

# exiftool's family-1 groups that go under one name here
_GROUPS = {"IFD0": "EXIF", "ExifIFD": "EXIF"}
# Groups that say nothing about where the camera was, and would only take memory.
DROPPED = frozenset(
    {
        "IFD1", "MPImage1", "MPImage2", "XMP-crs", "XMP-xmpMM", "InteropIFD", "Canon", "Sony",
        "Nikon", "Apple", "FLIR", "GoPro", "IPTC", "ICC_Profile", "JFIF", "XMP-rdf",
    }
)  # fmt: skip
# Sentinels that firmware writes for "no value"
_NO_VALUE = frozenset({"", "undef", "undefined", "inf", "nan", "-nan", "n/a", "none", "unknown"})
_SEPARATORS = re.compile(r"[\s,;]+")


def text(tags: Mapping[str, TagValue], *names: str) -> str:
    """Text of the first of `names` that has some; '' if none does."""
    for name in names:
        value = tags.get(name)
        if value is None:
            continue
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        out = str(value).strip(" \0\t\r\n")
        if out and out.lower() not in {"undef", "undefined"}:
            return out
    return ""


def number(tags: Mapping[str, TagValue], *names: str) -> float | None:
    """First finite number under `names`; None for sentinels such as 'undef', nan and -2e10."""
    for name in names:
        value = parse_number(tags.get(name))
        if value is not None:
            return value
    return None


def numbers(tags: Mapping[str, TagValue], *names: str) -> tuple[float, ...]:
    """Numbers separated by blanks, commas or semicolons; () if any of them is none."""
    for name in names:
        value = tags.get(name)
        if value is None:
            continue
        parts = [parse_number(part) for part in _SEPARATORS.split(str(value).strip()) if part]
        if parts and all(part is not None for part in parts):
            return tuple(part for part in parts if part is not None)
    return ()


def parse_number(value: TagValue | None) -> float | None:
    """Finite number of a tag's value, or None; '3/4' is a number too."""
    if value is None:
        return None
    if isinstance(value, str):
        value = value.strip()
        if value.lower() in _NO_VALUE:
            return None
        top, slash, bottom = value.partition("/")
        try:
            out = float(top) / float(bottom) if slash else float(value)
        except (ValueError, ZeroDivisionError):
            return None
    else:
        out = float(value)
    # senseFly writes -2e10 for a velocity it does not know
    return out if math.isfinite(out) and abs(out) < 1e10 else None


def tags_from_exiftool_json(record: Mapping[str, object]) -> Tags:
    """Tags of one record of `exiftool -j -G1 -n`.

    Parameters
    ----------
    record
        Values by group and name, angles of `GPS` without sign beside their `Ref`.
    """
    out: Tags = {}
    for full, value in record.items():
        group, colon, name = full.partition(":")
        if not colon or group in DROPPED:
            continue
        key = f"{_GROUPS.get(group, group)}:{name}"
        if key not in out:
            out[key] = _plain(value)
    return out


def _plain(value: object) -> TagValue:
    if isinstance(value, bool):
        return str(value)
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, list | tuple):
        return ",".join(str(part) for part in value)
    return str(value)
