"""Bytes of a TIFF: header, GDAL's ghost area and directories, classic or BigTIFF."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Codes of field types, TIFF 6.0 section 2 and the BigTIFF extension.
ASCII, SHORT, LONG, RATIONAL, UNDEFINED, DOUBLE, LONG8 = 2, 3, 4, 5, 7, 12, 16
_FORMATS = {SHORT: "<u2", LONG: "<u4", DOUBLE: "<f8", LONG8: "<u8"}

TILE_OFFSETS = 324
TILE_BYTE_COUNTS = 325

# bytes before and after a tile's data: its size, its last four bytes again
LEADER = TRAILER = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """One entry of a directory, its values already in file order."""

    code: int
    type: int
    count: int
    data: bytes


def numbers(code: int, type: int, values: Sequence[float] | NDArray[np.integer]) -> Tag:
    """Tag of numbers: SHORT, LONG, LONG8 or DOUBLE."""
    data = np.asarray(values, dtype=_FORMATS[type]).tobytes()
    return Tag(code=code, type=type, count=len(values), data=data)


def rationals(code: int, values: Sequence[int]) -> Tag:
    """Tag of whole numbers written as fractions over one."""
    data = b"".join(struct.pack("<II", value, 1) for value in values)
    return Tag(code=code, type=RATIONAL, count=len(values), data=data)


def text(code: int, value: str) -> Tag:
    """Tag of text, UTF-8, closed by a zero byte."""
    data = value.encode() + b"\0"
    return Tag(code=code, type=ASCII, count=len(data), data=data)


def opaque(code: int, data: bytes) -> Tag:
    """Tag of bytes."""
    return Tag(code=code, type=UNDEFINED, count=len(data), data=data)


@dataclass(slots=True, kw_only=True)
class Page:
    """One directory: an image or a mask of one level.

    Parameters
    ----------
    tags
        All but where the tiles lie.
    offsets, sizes : shape (tiles,)
        Where each tile's data lies in the file and its length, bytes; 0, 0 = no tile.
    """

    tags: list[Tag]
    offsets: NDArray[np.uint64]
    sizes: NDArray[np.uint32]

    def all_tags(self, *, big: bool) -> list[Tag]:
        """Tags in the order of their codes, as TIFF asks."""
        tiles = [
            numbers(TILE_OFFSETS, LONG8 if big else LONG, self.offsets),
            numbers(TILE_BYTE_COUNTS, LONG, self.sizes),
        ]
        return sorted([*self.tags, *tiles], key=lambda tag: tag.code)


def ghost_area(*, masks: bool) -> bytes:
    """GDAL's promise that directories come first and tiles follow in rows.

    See the GDAL documentation, "COG driver: header ghost area". The blank after ``NO`` leaves
    room for a program that edits the file to write ``YES``.
    """
    body = (
        "LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n"
        "BLOCK_TRAILER=LAST_4_BYTES_REPEATED\nKNOWN_INCOMPATIBLE_EDITION=NO\n "
    )
    if masks:
        body += "MASK_INTERLEAVED_WITH_IMAGERY=YES\n"
    area = f"GDAL_STRUCTURAL_METADATA_SIZE={len(body):06d} bytes\n{body}".encode()
    return area + b"\0" * (len(area) % 2)


def head(pages: Sequence[Page], *, ghost: bytes, big: bool) -> bytes:
    """All bytes before the first tile; their number does not depend on the tiles' offsets."""
    start = (16 if big else 8) + len(ghost)
    header = (
        struct.pack("<2sHHHQ", b"II", 43, 8, 0, start)
        if big
        else (struct.pack("<2sHI", b"II", 42, start))
    )
    parts = [header, ghost]
    for page in pages:
        last = page is pages[-1]
        directory = _directory(page.all_tags(big=big), start, big=big, last=last)
        parts.append(directory)
        start += len(directory)
    return b"".join(parts)


def _directory(tags: Sequence[Tag], start: int, *, big: bool, last: bool) -> bytes:
    """One directory at byte `start`, followed by the values too long for their entries."""
    room = 8 if big else 4
    size = 8 + 20 * len(tags) + 8 if big else 2 + 12 * len(tags) + 4
    entries, values, at = [], [], start + size
    for tag in tags:
        inline = tag.data
        if len(tag.data) > room:
            inline = struct.pack("<Q" if big else "<I", at)
            values.append(tag.data + b"\0" * (-len(tag.data) % 8))
            at += len(values[-1])
        entries.append(
            struct.pack("<HHQ8s" if big else "<HHI4s", tag.code, tag.type, tag.count, inline)
        )
    padding = b"\0" * (-at % 8)
    following = 0 if last else at + len(padding)
    count = struct.pack("<Q" if big else "<H", len(tags))
    end = struct.pack("<Q" if big else "<I", following)
    return b"".join([count, *entries, end, *values, padding])
