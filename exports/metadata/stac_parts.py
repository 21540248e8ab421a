"""Pieces that all STAC documents share: names, times, places, links to files."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from exports.kml.elements import clean
from exports.tables.geojson_features import feature_lines

if TYPE_CHECKING:
    from exports.metadata.facts import Accuracy
    from exports.site.columns import Layer

STAC_VERSION = "1.1.0"
ACCURACY = "https://stac-extensions.github.io/accuracy/v1.0.0-beta.1/schema.json"
FILE = "https://stac-extensions.github.io/file/v2.1.0/schema.json"
PROJECTION = "https://stac-extensions.github.io/projection/v2.0.0/schema.json"
COG = "image/tiff; application=geotiff; profile=cloud-optimized"
MEDIA = {
    ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".tif": "image/tiff; application=geotiff",
    ".tiff": "image/tiff; application=geotiff", ".png": "image/png",
}  # fmt: skip
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST = 80
# Names that Windows keeps for itself
_DEVICES = {"", "CON", "PRN", "AUX", "NUL", *(f"{d}{n}" for d in ("COM", "LPT") for n in range(10))}
# SHA-256 and its length, as multihash has it
_SHA256 = "1220"
# Clocks on Earth are up to so much before and behind UTC.
_MOST_AHEAD, _MOST_BEHIND = timedelta(hours=14), timedelta(hours=12)
# No aerial photo of a project is older.
_EARLIEST = datetime(1900, 1, 1, tzinfo=UTC)


def slug(name: str) -> str:
    """Name of a file for any id: itself where that is safe everywhere, else with a hash."""
    safe = _UNSAFE.sub("_", name).strip("._")[:_LONGEST]
    if safe == name and safe.partition(".")[0].upper() not in _DEVICES:
        return safe
    return _hashed(safe, name)


def slugs(names: Sequence[str]) -> dict[str, str]:
    """Names of files for ids, apart also on disks that do not tell capitals from small letters."""
    seen = Counter(slug(name).casefold() for name in names)
    return {
        name: found if seen[found.casefold()] == 1 else _hashed(found[:_LONGEST], name)
        for name, found in ((name, slug(name)) for name in names)
    }


def _hashed(safe: str, name: str) -> str:
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:10]
    return f"{safe or 'photo'}-{digest}"


def plain(text: str) -> str:
    """Text that any reader of JSON and UTF-8 can hold."""
    return clean(text).encode("utf-8", "replace").decode("utf-8")


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document, its folder too; numbers that are none are a mistake of ours and raise."""
    text = json.dumps(document, ensure_ascii=False, indent=1, allow_nan=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n", encoding="utf-8")


def stamp(when: datetime) -> str:
    """Time in UTC as RFC 3339 has it, to the microsecond, so that texts are in order of time."""
    return when.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def span_of_clock(clock: datetime) -> tuple[datetime, datetime]:
    """Range of UTC in which a clock without time zone may have shown a time."""
    when = clock.replace(tzinfo=UTC)
    return when - _MOST_AHEAD, when + _MOST_BEHIND


def times(when: datetime | None, span: tuple[datetime, datetime] | None) -> dict[str, Any]:
    """`datetime` of an item, null with a range where only that is known."""
    if when is not None:
        return {"datetime": stamp(when)}
    first, last = span or (_EARLIEST, datetime.now(UTC))
    return {"datetime": None, "start_datetime": stamp(first), "end_datetime": stamp(last)}


def shapes(layer: Layer) -> list[dict[str, Any]]:
    """`geometry` and `bbox` of the features of a layer, cut at the antimeridian."""
    found = []
    for lines in feature_lines(layer, named=False):
        for line in lines:
            feature = json.loads(line)
            found.append({"geometry": feature["geometry"], "bbox": feature.get("bbox")})
    return found


def href(path: Path, folder: Path) -> str:
    """Link to a file from a document in a folder: relative, so that all may be moved together."""
    absolute = Path(os.path.abspath(path))
    try:
        relative = Path(os.path.relpath(absolute, folder)).as_posix()
    except ValueError:
        # on another drive
        return absolute.as_uri()
    return quote(os.fsencode(relative))


def file_facts(path: Path, digest: str = "") -> dict[str, Any]:
    """Fields of the file extension."""
    out: dict[str, Any] = {"file:size": path.stat().st_size}
    if digest:
        out["file:checksum"] = _SHA256 + digest
    return out


def accuracy_properties(accuracy: Accuracy | None, expected: float | None) -> dict[str, Any]:
    """Fields of the accuracy extension, in metres: tested, else expected, else none.

    The extension has no field for heights: they stand under `georef:`.
    """
    if accuracy is None or not accuracy.tested:
        if expected is None:
            return {"georef:accuracy": "unknown"}
        value = round(expected, 4)
        return {
            "accuracy:geometric_x_stddev": value, "accuracy:geometric_y_stddev": value,
            "georef:accuracy": "expected from the covariances of poses and ground; not tested",
        }  # fmt: skip
    out: dict[str, Any] = {"georef:accuracy": "tested at check points"}
    for name in ("x", "y"):
        if (axis := accuracy.axes.get(name)) is not None:
            out[f"accuracy:geometric_{name}_bias"] = round(axis.mean, 4)
            out[f"accuracy:geometric_{name}_stddev"] = round(axis.sd, 4)
    for one in accuracy.tested:
        if one.component == "H" and not one.vegetated:
            out["accuracy:geometric_rmse"] = round(one.rmse, 4)
            out["georef:check_points_horizontal"] = one.points
        if one.component == "V" and not one.vegetated:
            out["georef:vertical_rmse_m"] = round(one.rmse, 4)
            out["georef:check_points_vertical"] = one.points
    out["georef:accuracy_statement"] = plain(" ".join(accuracy.statements))
    return out


def extensions_of(*parts: Mapping[str, Any]) -> list[str]:
    """Extensions of the fields that are used, each with its schema."""
    from exports.metadata.stac_camera import PERSPECTIVE, VIEW

    prefixes = {"pers": PERSPECTIVE, "view": VIEW, "accuracy": ACCURACY, "file": FILE,
                "proj": PROJECTION}  # fmt: skip
    used = {key.partition(":")[0] for part in parts for key in part if ":" in key}
    return [uri for prefix, uri in prefixes.items() if prefix in used]


def link(rel: str, target: str, title: str = "", media: str = "application/json") -> dict[str, str]:
    """A link of a document."""
    out = {"rel": rel, "href": target, "type": media}
    return out | {"title": title} if title else out


def union(boxes: Sequence[Sequence[float]]) -> list[float] | None:
    """Box of boxes; west > east across the antimeridian. None of none."""
    import numpy as np

    from exports.tables.geojson_features import bounds_of

    if not boxes:
        return None
    corners = np.array([[(b[0], b[1]), (b[2], b[3])] for b in boxes], dtype=float)
    return bounds_of([corners.reshape(-1, 2)])
