"""GeoPackage geometry blobs: WKB behind a header with the CRS and the bounds."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import isnan

Bounds = tuple[float, float, float, float]

POINT, LINE, POLYGON = 1, 2, 3
COLLECTIONS = (4, 5, 6, 7)
NAMES = {
    1: "POINT", 2: "LINESTRING", 3: "POLYGON", 4: "MULTIPOINT", 5: "MULTILINESTRING",
    6: "MULTIPOLYGON", 7: "GEOMETRYCOLLECTION",
}  # fmt: skip
# EWKB flags
FLAG_Z, FLAG_M, FLAG_SRID = 0x80000000, 0x40000000, 0x20000000


def point_wkb(x: float, y: float, z: float | None = None) -> bytes:
    """WKB of a point."""
    if z is None:
        return struct.pack("<BIdd", 1, POINT, x, y)
    return struct.pack("<BIddd", 1, POINT + 1000, x, y, z)


def polygon_wkb(ring: list[tuple[float, float]]) -> bytes:
    """WKB of a polygon of one ring; closed here if it is open."""
    closed = ring if ring[0] == ring[-1] else [*ring, ring[0]]
    body = b"".join(struct.pack("<dd", x, y) for x, y in closed)
    return struct.pack("<BIII", 1, POLYGON, 1, len(closed)) + body


def to_blob(wkb: bytes, srs_id: int) -> tuple[bytes, Bounds | None]:
    """GeoPackage blob of a WKB geometry, and its bounds (None if it is empty)."""
    points = list(_points(wkb, [0]))
    xs = [x for x, _ in points if not isnan(x)]
    if not xs:
        return struct.pack("<2sBBi", b"GP", 0, 0b10001, srs_id) + wkb, None
    ys = [y for _, y in points if not isnan(y)]
    bounds = (min(xs), min(ys), max(xs), max(ys))
    if len(points) == 1:
        return struct.pack("<2sBBi", b"GP", 0, 0b00001, srs_id) + wkb, bounds
    envelope = (bounds[0], bounds[2], bounds[1], bounds[3])
    return struct.pack("<2sBBi4d", b"GP", 0, 0b00011, srs_id, *envelope) + wkb, bounds


def from_blob(blob: bytes) -> bytes:
    """WKB of a GeoPackage blob."""
    envelope = (0, 32, 48, 48, 64)[(blob[3] >> 1) & 0b111]
    return blob[8 + envelope :]


def geometry_type(wkb: bytes) -> tuple[str, bool]:
    """Name of a WKB geometry's type, and whether it has z."""
    code = struct.unpack_from("<I" if wkb[0] else ">I", wkb, 1)[0]
    plain = code & 0xFFFF
    return NAMES.get(plain % 1000, f"type {plain}"), bool(code & FLAG_Z) or plain // 1000 in (1, 3)


def _points(wkb: bytes, at: list[int]) -> Iterator[tuple[float, float]]:
    """Points of a geometry; `at` is where to read, and is moved behind it."""
    order = "<" if wkb[at[0]] else ">"
    code = struct.unpack_from(order + "I", wkb, at[0] + 1)[0]
    at[0] += 9 if code & FLAG_SRID else 5
    plain = code & 0xFFFF
    size = 2 + bool(code & FLAG_Z) + bool(code & FLAG_M) + (0, 1, 1, 2)[plain // 1000]
    kind = plain % 1000
    if kind == POINT:
        yield from _coordinates(wkb, at, order, size, 1)
    elif kind == LINE:
        yield from _coordinates(wkb, at, order, size, _count(wkb, at, order))
    elif kind == POLYGON:
        for _ in range(_count(wkb, at, order)):
            yield from _coordinates(wkb, at, order, size, _count(wkb, at, order))
    elif kind in COLLECTIONS:
        for _ in range(_count(wkb, at, order)):
            yield from _points(wkb, at)
    else:
        raise ValueError(f"WKB geometry type {code} is not supported")


def _count(wkb: bytes, at: list[int], order: str) -> int:
    count: int = struct.unpack_from(order + "I", wkb, at[0])[0]
    at[0] += 4
    return count


def _coordinates(
    wkb: bytes, at: list[int], order: str, size: int, count: int
) -> Iterator[tuple[float, float]]:
    numbers = struct.unpack_from(f"{order}{size * count}d", wkb, at[0])
    at[0] += 8 * size * count
    yield from zip(numbers[::size], numbers[1::size], strict=True)
