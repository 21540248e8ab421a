"""The header of a JPEG as segments, so that some change and all others stay byte for byte."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

from georef_gis.errors import GeorefError, InputError
from georef_gis.rasters.tiff_tags import TiffTags

EXIF_MARK = b"Exif\0\0"
XMP_MARK = b"http://ns.adobe.com/xap/1.0/\0"
EXTENDED_MARK = b"http://ns.adobe.com/xmp/extension/\0"
MPF_MARK = b"MPF\0"
APP1, APP2, SOS = 0xE1, 0xE2, 0xDA
# The length of a segment counts its own two bytes and has 16 bits (ITU-T T.81 B.1.1.4).
LARGEST_PAYLOAD = 65_533
# Markers without a length (T.81 table B.1)
_ALONE = frozenset({0x01, *range(0xD0, 0xD9)})
# MP entry of the multi-picture format (CIPA DC-007 5.2.3): 16 bytes for each picture
_MP_ENTRY, _MP_BYTES = 0xB002, 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """A marker segment; `raw` is all of it, fill bytes and marker included."""

    marker: int
    payload: bytes
    raw: bytes

    def starts(self, mark: bytes, marker: int = APP1) -> bool:
        """Whether it is an application segment of a kind."""
        return self.marker == marker and self.payload.startswith(mark)


def segment(marker: int, payload: bytes) -> Segment:
    """New segment.

    Raises
    ------
    InputError
        If the payload is too long for one.
    """
    if len(payload) > LARGEST_PAYLOAD:
        raise InputError(
            f"a JPEG segment would have {len(payload)} bytes, more than {LARGEST_PAYLOAD}"
        )
    raw = bytes([0xFF, marker]) + struct.pack(">H", len(payload) + 2) + payload
    return Segment(marker=marker, payload=payload, raw=raw)


def read_segments(file: BinaryIO) -> list[Segment]:
    """Segments from the start of a JPEG to the image data, where `file` is left.

    Raises
    ------
    InputError
        If the header is damaged or ends too early.
    """
    if file.read(2) != b"\xff\xd8":
        raise InputError("does not start as a JPEG")
    segments: list[Segment] = []
    while True:
        start = file.tell()
        fill = file.read(2)
        if len(fill) == 2 and fill[0] != 0xFF:
            raise InputError(
                f"the JPEG header is damaged at byte {start}: no segment starts there; "
                "copy the file again"
            )
        while fill[-1:] == b"\xff":
            fill += file.read(1) or b"\0"
        marker = fill[-1]
        if len(fill) < 2 or marker in (0x00, 0xD9):
            raise InputError("the JPEG ends before its image data; copy the file again")
        if marker == SOS:
            file.seek(start)
            return segments
        if marker in _ALONE:
            segments.append(Segment(marker=marker, payload=b"", raw=fill))
            continue
        length = file.read(2)
        size = int.from_bytes(length, "big")
        payload = file.read(max(0, size - 2))
        if len(length) < 2 or size < 2 or len(payload) < size - 2:
            raise InputError("the JPEG ends before its image data; copy the file again")
        segments.append(Segment(marker=marker, payload=payload, raw=fill + length + payload))


def header_size(segments: Sequence[Segment]) -> int:
    """Bytes before the image data."""
    return 2 + sum(len(s.raw) for s in segments)


def place_of_new(segments: Sequence[Segment]) -> int:
    """Index where a new EXIF segment belongs: behind JFIF's own segments."""
    at = 0
    while at < len(segments) and segments[at].marker == 0xE0:
        at += 1
    return at


def with_moved_pictures(old: Sequence[Segment], new: Sequence[Segment]) -> list[Segment]:
    """The new header with the offsets of further pictures behind the first one set right.

    Notes
    -----
    Offsets of the multi-picture format count from the TIFF header inside its own segment, so they
    change if a segment between that and the image data changes; the first picture's size counts
    its header (CIPA DC-007 5.2.3.2 and 5.2.3.3).
    """
    out = list(new)
    grown = header_size(new) - header_size(old)
    for i, one in enumerate(out):
        if not one.starts(MPF_MARK, APP2):
            continue
        k = next((j for j, s in enumerate(old) if s.raw == one.raw), None)
        if k is None:
            continue
        moved = header_size(out[:i]) - header_size(old[:k])
        patched = _patched_mpf(one.payload[len(MPF_MARK) :], grown, grown - moved)
        # The length stays, so what lies behind does not move.
        out[i] = Segment(
            marker=one.marker,
            payload=MPF_MARK + patched,
            raw=one.raw[: len(one.raw) - len(patched)] + patched,
        )
    return out


def _patched_mpf(block: bytes, size_by: int, offset_by: int) -> bytes:
    """MP entries with the first picture's size and the others' offsets changed, bytes."""
    try:
        tags = TiffTags(lambda offset, n: block[offset : offset + n], len(block))
        at, raw = tags.value(tags.directory(tags.first), _MP_ENTRY)
    except GeorefError:
        return block
    out = bytearray(block)
    for i in range(len(raw) // _MP_BYTES):
        place = at + i * _MP_BYTES + 4
        size, offset = struct.unpack_from(tags.order + "II", out, place)
        # Offset 0 stands for the first picture, size or offset 0 for an entry without a picture.
        if offset == 0 and i == 0:
            size = size + size_by if size else 0
        elif offset:
            offset += offset_by
        struct.pack_into(tags.order + "II", out, place, size, offset)
    return bytes(out)
