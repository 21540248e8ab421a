"""What encloses the tags: JPEG segments or a TIFF file; sizes, and whether the file is whole."""

from __future__ import annotations

import functools
import mmap
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from georef_gis.errors import InputError
from georef_gis.ingest.exif import read_exif
from georef_gis.ingest.tags import Tags
from georef_gis.ingest.xmp import tags_from_packets

# bytes; read at once, more only where a header is longer
_HEADER = 262_144
_EXIF_MARK = b"Exif\0\0"
_XMP_MARK = b"http://ns.adobe.com/xap/1.0/\0"
_EXTENDED_MARK = b"http://ns.adobe.com/xmp/extension/\0"
# Start of frame, all but DHT, JPG and DAC (ITU-T T.81 table B.1)
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_NO_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})


@dataclass(frozen=True, slots=True, kw_only=True)
class FileTags:
    """Tags of a file with the doubts about its form."""

    tags: Tags
    doubts: tuple[str, ...] = ()


@dataclass(slots=True)
class _Segments:
    exif: bytes = b""
    xmp: list[bytes] = field(default_factory=list)
    extended: dict[bytes, dict[int, bytes]] = field(default_factory=dict)
    size: tuple[int, int, int] | None = None


def read_file_tags(path: Path) -> FileTags:
    """Tags of a JPEG or TIFF file, from its header and nothing else.

    Raises
    ------
    InputError
        If the file cannot be read, is no JPEG or TIFF, or is cut off.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEADER)
            if head[:2] == b"\xff\xd8":
                return _read_jpeg(file, head, path)
            if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
                return _read_tiff(file, head, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be read: {reason}", source=str(path)) from error
    what = "is empty" if not head else f"starts with bytes {head[:4].hex()}"
    raise InputError(
        f"{what}: not a JPEG or TIFF photo; leave it out of the photos", source=str(path)
    )


def _read_jpeg(file: BinaryIO, head: bytes, path: Path) -> FileTags:
    segments = _walk(file, head, path)
    if segments.size is None:
        raise InputError(
            "the JPEG header ends before the image size: the file is cut off; copy it again",
            source=str(path),
        )
    _check_end(file, path)
    exif = segments.exif
    block = read_exif(lambda offset, n: exif[offset : offset + n]) if exif else None
    packets = [*segments.xmp, *(_joined(parts) for parts in segments.extended.values())]
    if block and block.xmp:
        packets.append(block.xmp)
    xmp, doubts = tags_from_packets(packets)
    width, height, bands = segments.size
    tags: Tags = {
        "File:FileType": "JPEG",
        "File:ImageWidth": float(width),
        "File:ImageHeight": float(height),
        "File:ColorComponents": float(bands),
    }
    tags.update(block.tags if block else {})
    for name, value in xmp.items():
        tags.setdefault(name, value)
    return FileTags(tags=tags, doubts=(*(block.doubts if block else ()), *doubts))


def _walk(file: BinaryIO, data: bytes, path: Path) -> _Segments:
    """Segments up to the image data."""
    out = _Segments()
    at = 2
    while True:
        if at + 4 > len(data):
            data = _grown(file, data, at + 4)
        if at + 4 > len(data):
            return out
        if data[at] != 0xFF:
            raise InputError(
                f"the JPEG header is damaged at byte {at}: no segment starts there; "
                "copy the file again",
                source=str(path),
            )
        marker = data[at + 1]
        if marker == 0xFF or marker in _NO_LENGTH:
            at += 1 if marker == 0xFF else 2
            continue
        if marker in (0xDA, 0xD9):
            return out
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        end = at + 2 + length
        if marker == 0xE1 or marker in _SOF:
            data = _grown(file, data, end)
            _keep(marker, data[at + 4 : end], out)
        at = end


def _grown(file: BinaryIO, data: bytes, size: int) -> bytes:
    if size <= len(data):
        return data
    file.seek(len(data))
    return data + file.read(max(size - len(data), 65_536))


def _keep(marker: int, payload: bytes, out: _Segments) -> None:
    if marker in _SOF:
        if out.size is None and len(payload) >= 6:
            height, width = (int.from_bytes(payload[i : i + 2], "big") for i in (1, 3))
            if width and height:
                out.size = (width, height, payload[5])
    elif payload.startswith(_EXIF_MARK):
        out.exif = out.exif or payload[len(_EXIF_MARK) :]
    elif payload.startswith(_XMP_MARK):
        out.xmp.append(payload[len(_XMP_MARK) :])
    elif payload.startswith(_EXTENDED_MARK):
        # GUID of 32 bytes, full length, offset (XMP specification part 3, 1.1.3.1)
        rest = payload[len(_EXTENDED_MARK) :]
        parts = out.extended.setdefault(rest[:32], {})
        parts[int.from_bytes(rest[36:40], "big")] = rest[40:]


def _joined(parts: dict[int, bytes]) -> bytes:
    return b"".join(parts[offset] for offset in sorted(parts))


def _check_end(file: BinaryIO, path: Path) -> None:
    """Whether the image data has its end mark; data behind it (previews, thermal) is no fault.

    Within image data FF is always followed by 00 or a restart mark, so FFD9 is the end of an image.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 4096))
    if b"\xff\xd9" in file.read():
        return
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole:
        start = _image_data(whole)
        if start >= 0 and whole.find(b"\xff\xd9", start) >= 0:
            return
    raise InputError(
        f"the JPEG has no end mark after {size} bytes: the file is cut off; copy it again",
        source=str(path),
    )


def _image_data(data: mmap.mmap) -> int:
    """Where the image data starts, -1 if it does not."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        if data[at + 1] == 0xDA:
            return at
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big") if data[at + 1] != 0xFF else 1
    return -1


def _read_tiff(file: BinaryIO, head: bytes, path: Path) -> FileTags:
    block = read_exif(functools.partial(_read_at, file, head))
    xmp, doubts = tags_from_packets([block.xmp] if block.xmp else [])
    tags: Tags = {"File:FileType": "TIFF", **block.tags}
    for name, value in xmp.items():
        tags.setdefault(name, value)
    if not {"EXIF:ImageWidth", "EXIF:ImageHeight"} <= tags.keys():
        raise InputError(
            "the TIFF directory has no image size: the file is cut off or damaged; copy it again",
            source=str(path),
        )
    tags.setdefault("EXIF:SamplesPerPixel", 1.0)
    return FileTags(tags=tags, doubts=(*block.doubts, *doubts))


def _read_at(file: BinaryIO, head: bytes, offset: int, n: int) -> bytes:
    if offset + n <= len(head):
        return head[offset : offset + n]
    file.seek(offset)
    return file.read(n)
