"""What the triggers of a GeoPackage's spatial index call, which a GIS may have added to a layer.

OGC 12-128r17, annex F.3: whoever writes to such a layer brings these functions along.
"""

from __future__ import annotations

import sqlite3
import struct
from typing import Any

from georef_gis.project.geometry import Bounds, from_blob, to_blob


def add_functions(connection: sqlite3.Connection) -> None:
    """Make the functions known to a connection."""
    connection.create_function("ST_IsEmpty", 1, _is_empty, deterministic=True)
    for k, name in enumerate(("ST_MinX", "ST_MinY", "ST_MaxX", "ST_MaxY")):
        connection.create_function(name, 1, _bound(k), deterministic=True)


def _is_empty(blob: Any) -> int | None:
    bounds = _bounds(blob)
    return None if blob is None else int(bounds is None)


def _bound(k: int) -> Any:
    def bound(blob: Any) -> float | None:
        bounds = _bounds(blob)
        return None if bounds is None else bounds[k]

    return bound


def _bounds(blob: Any) -> Bounds | None:
    """Bounds of a GeoPackage blob; None of what is none or empty."""
    if not isinstance(blob, bytes) or len(blob) < 8 or blob[:2] != b"GP":
        return None
    try:
        return to_blob(from_blob(blob), 0)[1]
    except (struct.error, IndexError, ValueError):
        return None
