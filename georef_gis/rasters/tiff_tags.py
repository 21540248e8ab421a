"""Changes tags of a TIFF structure (a TIFF file or an EXIF block) without moving what is there.

New values and new directories go behind the end; what points to them is patched in place. So the
offsets inside a MakerNote, of strips and of sub-directories stay right, and nothing that is not
understood is lost.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from georef_gis.errors import InputError

# (offset, length) -> bytes; fewer at the end of the data
Reader = Callable[[int, int], bytes]

BYTE, ASCII, LONG, RATIONAL, LONG8 = 1, 2, 4, 5, 16
# type code -> bytes each (TIFF 6.0 section 2, BigTIFF); an unknown type keeps its raw entry
SIZES = {
    1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4,
    16: 8, 17: 8, 18: 8, 129: 1,
}  # fmt: skip
# A directory of a photo has tens of entries; more means that the offset is wrong.
MOST_ENTRIES = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Tag:
    """A tag to write; `data` is in the byte order of the structure."""

    kind: int
    count: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Directory:
    """One directory: where it is, its raw entries by tag, and where the next one is."""

    offset: int
    entries: Mapping[int, bytes]
    following: int

    def place(self, tag: int, structure: TiffTags) -> int:
        """Offset of an entry itself."""
        at = list(self.entries).index(tag)
        return self.offset + structure.head_size + at * structure.entry_size


class TiffTags:
    """Reads a TIFF structure and collects the changes to it.

    Parameters
    ----------
    read
        Bytes of the structure, which starts at offset 0.
    size
        Its length, bytes: new data goes behind it.

    Raises
    ------
    InputError
        If it has no valid header.
    """

    def __init__(self, read: Reader, size: int) -> None:
        head = read(0, 16)
        order = {b"II": "<", b"MM": ">"}.get(head[:2])
        magic = struct.unpack(order + "H", head[2:4])[0] if order and len(head) >= 8 else 0
        if order is None or magic not in (42, 43) or (magic == 43 and len(head) < 16):
            raise InputError("has no valid TIFF header")
        self.order, self.big = order, magic == 43
        self.head_size, self.entry_size, self.inline = (8, 20, 8) if self.big else (2, 12, 4)
        self._offset = "Q" if self.big else "I"
        self._read, self._size = read, size
        self.patches: dict[int, bytes] = {}
        self.tail = bytearray()
        self.first_at = 8 if self.big else 4
        self.first = self._number(self._offset, head[self.first_at : self.first_at + self.inline])

    def _number(self, code: str, raw: bytes) -> int:
        return int(struct.unpack(self.order + code, raw)[0])

    def pack(self, code: str, *values: int) -> bytes:
        """Numbers in the byte order of the structure."""
        return struct.pack(self.order + code, *values)

    def directory(self, offset: int) -> Directory:
        """Directory at an offset.

        Raises
        ------
        InputError
            If it is cut off or no directory.
        """
        code = "Q" if self.big else "H"
        raw = self._read(offset, self.head_size) if 8 <= offset < self._size else b""
        count = self._number(code, raw) if len(raw) == self.head_size else 0
        length = count * self.entry_size + self.inline
        raw = self._read(offset + self.head_size, length) if 0 < count <= MOST_ENTRIES else b""
        # Some writers leave out the offset of the next directory at the end of the block.
        if not raw or len(raw) < count * self.entry_size:
            raise InputError(f"has a damaged directory at byte {offset}")
        entries = [raw[i * self.entry_size : (i + 1) * self.entry_size] for i in range(count)]
        end = raw[count * self.entry_size :]
        following = self._number(self._offset, end) if len(end) == self.inline else 0
        by_tag: dict[int, bytes] = {}
        for entry in entries:
            key = self._number("H", entry[:2])
            # A repeated tag keeps its place under a number no tag has.
            by_tag[key if key not in by_tag else -len(by_tag)] = entry
        return Directory(offset=offset, entries=by_tag, following=following)

    def value(self, directory: Directory, tag: int) -> tuple[int, bytes]:
        """Offset and bytes of a value; (0, '') if it is not there or goes beyond the end."""
        entry = directory.entries.get(tag)
        if entry is None:
            return 0, b""
        kind = self._number("H", entry[2:4])
        count = self._number(self._offset, entry[4 : 4 + self.inline])
        size = SIZES.get(kind, 0) * count
        at = directory.place(tag, self) + 4 + self.inline
        if size > self.inline:
            at = self._number(self._offset, entry[4 + self.inline :])
        data = self._read(at, size) if 0 < size <= self._size else b""
        return (at, data) if size and len(data) == size else (0, b"")

    def numbers(self, directory: Directory, tag: int) -> list[int]:
        """Whole numbers of a value (BYTE, SHORT, LONG, LONG8 and offsets); [] if none."""
        _, raw = self.value(directory, tag)
        if not raw:
            return []
        kind = self._number("H", directory.entries[tag][2:4])
        code = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}.get(kind)
        if code is None:
            return []
        return list(struct.unpack(f"{self.order}{len(raw) // SIZES[kind]}{code}", raw))

    def text(self, directory: Directory, tag: int) -> str:
        """Text of a value, '' if there is none."""
        return self.value(directory, tag)[1].split(b"\0")[0].decode("utf-8", "replace").strip()

    def append(self, data: bytes) -> int:
        """Put data behind the end, at an even offset, which is returned."""
        if (self._size + len(self.tail)) % 2:
            self.tail += b"\0"
        at = self._size + len(self.tail)
        if not self.big and at + len(data) > 0xFFFFFFFF:
            raise InputError("is a TIFF of 4 GB: no tags can be added behind its end")
        self.tail += data
        return at

    def entry(self, tag: int, new: Tag) -> bytes:
        """Raw entry of a new tag; its value goes behind the end if it is long."""
        field = new.data.ljust(self.inline, b"\0")
        if len(new.data) > self.inline:
            field = self.pack(self._offset, self.append(new.data))
        return self.pack("HH" + self._offset, tag, new.kind, new.count) + field

    def append_directory(self, entries: Mapping[int, bytes], following: int = 0) -> int:
        """Write a directory behind the end and return its offset; its entries sorted by tag."""
        raw = sorted(entries.values(), key=lambda entry: self._number("H", entry[:2]))
        code = "Q" if self.big else "H"
        body = self.pack(code, len(raw)) + b"".join(raw) + self.pack(self._offset, following)
        return self.append(body)

    def pointer(self, offset: int) -> Tag:
        """Tag that holds an offset."""
        kind = LONG8 if self.big else LONG
        return Tag(kind=kind, count=1, data=self.pack(self._offset, offset))

    def put(self, directory: Directory, new: Mapping[int, Tag]) -> Directory:
        """Set tags of the first directory; it moves behind the end only if it has to grow."""
        raw = {tag: self.entry(tag, value) for tag, value in new.items()}
        entries = {**directory.entries, **raw}
        if all(tag in directory.entries for tag in raw):
            for tag, entry in raw.items():
                self.patches[directory.place(tag, self)] = entry
            return Directory(
                offset=directory.offset, entries=entries, following=directory.following
            )
        offset = self.append_directory(entries, directory.following)
        self.patches[self.first_at] = self.pack(self._offset, offset)
        return Directory(offset=offset, entries=entries, following=directory.following)

    def applied(self, data: bytes) -> bytes:
        """All of a structure held in memory, with its changes."""
        out = bytearray(data)
        for at, patch in self.patches.items():
            out[at : at + len(patch)] = patch
        return bytes(out + self.tail)
