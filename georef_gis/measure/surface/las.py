"""Points as LAS 1.4 with their sigmas as extra bytes, written by own code.

One kind of point and three records: 150 lines that need nothing, where a library would be one more
to install for all. The tests read the files with laspy.

Notes
-----
ASPRS LAS Specification 1.4 R15: header of 375 bytes (section 2.4), point data record format 6
(table 17), OGC coordinate system WKT record (section 2.6), extra bytes record (section 2.7).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import ExportError
from georef_gis.frames import Array

HEADER_SIZE = 375
_FORMAT = 6
_SOFTWARE = "georef_gis"
# Of global encoding: the CRS is told as WKT.
_WKT_BIT = 1 << 4
# kinds of extra bytes, by numpy's name
_EXTRA_TYPES = {"uint8": 1, "uint16": 3, "float32": 9, "float64": 10}
# most that a description of extra bytes, and a name, hold
_TEXT = 32
# Of a point: unclassified.
_CLASS = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Extra:
    """One more value of every point; `values` (n,) of uint8, uint16, float32 or float64."""

    name: str
    values: Any
    told: str = ""

    def __post_init__(self) -> None:
        """Check the kind and the length of the words."""
        if str(self.values.dtype) not in _EXTRA_TYPES:
            raise ValueError(f"extra {self.name}: {self.values.dtype} cannot be written")
        if len(self.name.encode()) > _TEXT or len(self.told.encode()) > _TEXT:
            raise ValueError(f"extra {self.name}: name and words hold {_TEXT} bytes")


def write_las(
    stream: IO[bytes], xyz: ArrayLike, *, crs_wkt: str, extras: Sequence[Extra] = (),
    scale: float = 0.001, made: date | None = None,
) -> None:  # fmt: skip
    """Write points.

    Parameters
    ----------
    xyz : shape (n, 3)
        In units of the CRS, heights in those of its vertical part.
    crs_wkt
        WKT 1; empty where there is none.
    scale
        Step of the coordinates, in the same units.
    made
        Day of the file; today if not given.

    Raises
    ------
    ExportError
        If the points reach too far for so fine a step.
    """
    points = np.asarray(xyz, dtype=np.float64).reshape(-1, 3)
    offset = np.floor(points.min(axis=0)) if len(points) else np.zeros(3)
    steps = np.round((points - offset) / scale)
    if len(points) and steps.max() > np.iinfo(np.int32).max:
        raise ExportError(
            f"points {np.ptp(points, axis=0).max():.0f} units apart do not fit into LAS at steps "
            f"of {scale:g}; take a coarser step"
        )
    records = _vlr("LASF_Projection", 2112, crs_wkt.encode() + b"\0", "OGC WKT") if crs_wkt else b""
    if extras:
        told = b"".join(_described(extra) for extra in extras)
        records += _vlr("LASF_Spec", 4, told, "extra bytes")
    body = _records(steps.astype(np.int32), extras)
    count = int(bool(crs_wkt)) + int(bool(extras))
    used = offset + steps * scale
    stream.write(_header(used, offset, scale, len(records), count, body.dtype.itemsize, made))
    stream.write(records)
    stream.write(body.tobytes())


def _records(steps: Any, extras: Sequence[Extra]) -> Any:
    """Points as they stand in the file."""
    fields: list[tuple[str, str]] = [
        ("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"),
        ("flags", "u1"), ("class", "u1"), ("user", "u1"), ("angle", "<i2"), ("source", "<u2"),
        ("time", "<f8"),
    ]  # fmt: skip
    fields += [(f"extra_{e.name}", e.values.dtype.newbyteorder("<").str) for e in extras]
    out = np.zeros(len(steps), dtype=fields)
    out["x"], out["y"], out["z"] = steps.T
    # the first of one return
    out["returns"] = 1 | (1 << 4)
    out["class"] = _CLASS
    for extra in extras:
        out[f"extra_{extra.name}"] = extra.values
    return out


def _header(
    places: Array, offset: Array, scale: float, records: int, count: int, size: int,
    made: date | None,
) -> bytes:  # fmt: skip
    """Header of the file; `places` (n, 3) are the points as they are stored."""
    day = made or date.today()
    low = places.min(axis=0) if len(places) else np.zeros(3)
    high = places.max(axis=0) if len(places) else np.zeros(3)
    n = len(places)
    out = struct.pack(
        "<4sHHIHH8sBB32s32sHHHIIBHI5I",
        b"LASF", 0, _WKT_BIT, 0, 0, 0, b"\0" * 8, 1, 4, b"OTHER".ljust(32, b"\0"),
        _SOFTWARE.encode().ljust(32, b"\0"), day.timetuple().tm_yday, day.year, HEADER_SIZE,
        HEADER_SIZE + records, count, _FORMAT, size,
        # counts of older readers, which do not know this kind of point
        0, 0, 0, 0, 0, 0,
    )  # fmt: skip
    bounds = [value for pair in zip(high, low, strict=True) for value in pair]
    out += struct.pack("<12d", scale, scale, scale, *offset, *bounds)
    # no waveforms, no extended records; one return each
    out += struct.pack("<QQIQ15Q", 0, 0, 0, n, n, *([0] * 14))
    if len(out) != HEADER_SIZE:
        raise ValueError(f"header of {len(out)} bytes")
    return out


def _vlr(user: str, number: int, data: bytes, told: str) -> bytes:
    head = struct.pack(
        "<H16sHH32s", 0, user.encode().ljust(16, b"\0"), number, len(data),
        told.encode().ljust(32, b"\0"),
    )  # fmt: skip
    return head + data


def _described(extra: Extra) -> bytes:
    kind = _EXTRA_TYPES[str(extra.values.dtype)]
    return struct.pack(
        "<HBB32s4s24s24s24s24s24s32s", 0, kind, 0, extra.name.encode().ljust(32, b"\0"), b"\0" * 4,
        *([b"\0" * 24] * 5), extra.told.encode().ljust(32, b"\0"),
    )  # fmt: skip
