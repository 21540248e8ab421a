"""Copies of photos with a pose in their tags; the picture itself stays byte for byte.

Only the EXIF GPS directory and the XMP packets change. Data behind the first picture (previews,
thermal data, motion) and every other segment are copied as they are.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from georef_gis.errors import InputError
from georef_gis.rasters import exif_writer as exif
from georef_gis.rasters import jpeg_segments as jpeg
from georef_gis.rasters import xmp_writer as xmp
from georef_gis.rasters.jpeg_segments import Segment
from georef_gis.rasters.tiff_tags import BYTE, Directory, Tag, TiffTags

_CHUNK = 1 << 20
_END_OF_IMAGE = b"\xff\xd9"
_STRIPS = ((0x0111, 0x0117), (0x0144, 0x0145))
# Makers whose Camera angles OpenDroneMap changes (opendm/photo.py)
_ODM_ADDS_90 = ("dji", "hasselblad")
_ODM_NEGATES_ROLL = ("sensefly",)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseTags:
    """What is written; angles in deg, zero at nadir, yaw clockwise from true north.

    Parameters
    ----------
    lat_lon_deg
        Latitude and longitude, deg.
    altitude
        Height as GPSAltitude, m, of the kind that `vertical_crs` names.
    yaw_pitch_roll_deg, sigma_yaw_pitch_roll_deg
        deg; a sigma that is not known is None and not written.
    direction_deg
        Bearing of the image from true north, deg.
    sigma_h, sigma_v
        One sigma per horizontal axis and of the height, m.
    utc
        Instant of the exposure; None leaves the time that is there.
    height_above_ground
        m; None leaves what is there.
    horizontal_crs, vertical_crs, map_datum
        Names as the tags hold them; '' is not written.
    odm_corrections
        Whether to undo in drone-dji tags what OpenDroneMap does to the angles of some makers.
    """

    lat_lon_deg: tuple[float, float]
    altitude: float
    yaw_pitch_roll_deg: tuple[float, float, float]
    sigma_yaw_pitch_roll_deg: tuple[float | None, float | None, float | None] = (None, None, None)
    direction_deg: float = 0.0
    sigma_h: float | None = None
    sigma_v: float | None = None
    utc: datetime | None = None
    height_above_ground: float | None = None
    horizontal_crs: str = "EPSG:4326"
    vertical_crs: str = "EPSG:5773"
    map_datum: str = "WGS-84"
    odm_corrections: bool = True


def write_tagged_copy(source: Path, target: Path, pose: PoseTags) -> tuple[str, ...]:
    """Copy a JPEG or TIFF photo with a pose in its tags, whole or not at all.

    Returns
    -------
    Doubts about the source's tags, in words.

    Raises
    ------
    InputError
        If the source is gone, damaged or of another format.
    OSError
        If the target cannot be written.
    """
    if source.exists() and target.exists() and source.samefile(target):
        raise InputError("is the original, which is never written to", source=str(target))
    part = target.with_name(f".{target.name}.part")
    try:
        with _opened(source) as file:
            try:
                doubts = _write(file, part, pose)
            except InputError as error:
                raise InputError(str(error), source=str(source)) from error
            stat = os.fstat(file.fileno())
        os.utime(part, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    return doubts


class _Source:
    """A file to read, whose faults are the photo's and not the target's."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, n: int = -1) -> bytes:
        try:
            return self._file.read(n)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}") from error

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()


def _opened(source: Path) -> BinaryIO:
    try:
        return source.open("rb")
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot be read: {reason}", source=str(source)) from error


def _write(file: BinaryIO, part: Path, pose: PoseTags) -> tuple[str, ...]:
    source = _Source(file)
    head = source.read(4)
    source.seek(0)
    if head[:2] == b"\xff\xd8":
        return _write_jpeg(source, part, pose)
    if head in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return _write_tiff(source, part, pose)
    what = "is empty" if not head else f"starts with bytes {head.hex()}"
    raise InputError(f"{what}: not a JPEG or TIFF photo")


# -- fields -------------------------------------------------------------------------------------


def xmp_fields(pose: PoseTags, make: str) -> dict[str, dict[str, str]]:
    """XMP attributes of a pose by prefix and name.

    Notes
    -----
    OpenDroneMap takes `drone-dji` tags before `Camera`'s, adds 90 deg to the pitch of DJI and
    Hasselblad and turns the sign of senseFly's roll round, whichever tags they came from
    (opendm/photo.py). The `drone-dji` tags here are what that undoes. They leave out
    GimbalYawDegree: programs that want all three gimbal angles then take `Camera`'s.
    """
    # 0, 0, 0 is what cameras without a pose write; a millionth of a degree is none.
    yaw, pitch, roll = (round(v, 6) for v in pose.yaw_pitch_roll_deg)
    yaw %= 360.0
    roll = roll if (yaw, pitch, roll) != (0.0, 0.0, 0.0) else 1e-6
    camera = {"Yaw": f"{yaw:.6f}", "Pitch": f"{pitch:.6f}", "Roll": f"{roll:.6f}"}
    for name, sigma in zip(("Yaw", "Pitch", "Roll"), pose.sigma_yaw_pitch_roll_deg, strict=True):
        if sigma is not None:
            camera[f"IMU{name}Accuracy"] = f"{max(sigma, 1e-5):.5f}"
    for name, value in (("GPSXYAccuracy", pose.sigma_h), ("GPSZAccuracy", pose.sigma_v)):
        if value is not None:
            camera[name] = f"{max(value, 1e-4):.4f}"
    for name, text in (("HorizCS", pose.horizontal_crs), ("VertCS", pose.vertical_crs)):
        if text:
            camera[name] = text
    if pose.height_above_ground is not None:
        camera["AboveGroundAltitude"] = f"{pose.height_above_ground:.3f}"
    odm: dict[str, str] = {}
    if pose.odm_corrections and make.lower() in _ODM_ADDS_90:
        odm = {
            "FlightYawDegree": f"{yaw:+.6f}",
            "GimbalPitchDegree": f"{pitch - 90.0:+.6f}",
            "GimbalRollDegree": f"{roll:+.6f}",
        }
    elif pose.odm_corrections and make.lower() in _ODM_NEGATES_ROLL:
        odm = {"GimbalRollDegree": f"{-roll:+.6f}"}
    return {"Camera": camera, "drone-dji": odm}


def _gps(pose: PoseTags, tags: TiffTags) -> dict[int, Tag]:
    return exif.gps_tags(
        tags,
        lat_lon_deg=pose.lat_lon_deg,
        altitude=pose.altitude,
        direction_deg=pose.direction_deg,
        sigma_h=pose.sigma_h,
        utc=pose.utc,
        map_datum=pose.map_datum,
    )


@dataclass(slots=True)
class _Packets:
    """New packets of a file: the one with the pose first; doubts about the old ones."""

    packets: list[bytes]
    doubts: list[str]


def _new_packets(
    old: list[bytes], pose: PoseTags, make: str, guids: Mapping[str, str], limit: float
) -> _Packets:
    """Packets with the pose in the first, of `limit` bytes at most; no other pose in any."""
    doubts: list[str] = []
    parsed: list[xmp.Packet] = []
    for raw in old:
        packet = xmp.parse_packet(raw)
        if packet.root is None and raw.strip(b" \0\r\n\t"):
            doubts.append("an XMP packet is not XML: its tags are not in the copy")
        elif packet.root is not None:
            if packet.repaired:
                doubts.append("an XMP packet was malformed: the copy has what could be read")
            xmp.remove_poses(packet, xmp_fields(pose, make)["Camera"])
            xmp.rename_extended(packet, guids)
            parsed.append(packet)
    first = parsed[0] if parsed else xmp.Packet(root=None)
    make = make or next((m for m in map(xmp.make_of, parsed) if m), "")
    plain = xmp.packet_bytes(first)
    xmp.put_fields(first, xmp_fields(pose, make))
    out = [xmp.packet_bytes(first)]
    if len(out[0]) > limit:
        own = xmp.Packet(root=None)
        xmp.put_fields(own, xmp_fields(pose, make))
        out = [xmp.packet_bytes(own), plain]
        doubts.append("the XMP packet is full: the pose stands in a packet of its own before it")
    return _Packets(out + [xmp.packet_bytes(p) for p in parsed[1:]], doubts)


# -- JPEG ---------------------------------------------------------------------------------------


def _write_jpeg(source: _Source, part: Path, pose: PoseTags) -> tuple[str, ...]:
    old = jpeg.read_segments(source)  # type: ignore[arg-type]
    new, doubts = _tagged_segments(old, pose)
    new = jpeg.with_moved_pictures(old, new)
    with part.open("wb") as out:
        out.write(b"\xff\xd8" + b"".join(s.raw for s in new))
        ended, last = False, b""
        for chunk in _chunks(source):
            # Within image data FF is followed by 00 or a restart mark, so this ends an image.
            ended = ended or _END_OF_IMAGE in last + chunk
            last = chunk[-1:]
            out.write(chunk)
    if not ended:
        raise InputError("the JPEG has no end mark: the file is cut off; copy it again")
    return doubts


def _chunks(source: _Source) -> Iterator[bytes]:
    while chunk := source.read(_CHUNK):
        yield chunk


def _tagged_segments(old: list[Segment], pose: PoseTags) -> tuple[list[Segment], tuple[str, ...]]:
    """Segments of the copy: the EXIF and XMP ones anew, each where it was, the rest as it is."""
    doubts: list[str] = []
    k = next((i for i, s in enumerate(old) if s.starts(jpeg.EXIF_MARK)), None)
    block = b"" if k is None else old[k].payload[len(jpeg.EXIF_MARK) :]
    block, make, inner = _tagged_exif(block, pose, doubts)
    exif_segment = jpeg.segment(jpeg.APP1, jpeg.EXIF_MARK + block)
    extended, guids = xmp.clean_extended(old, doubts, xmp_fields(pose, make)["Camera"])
    packets = [s.payload[len(jpeg.XMP_MARK) :] for s in old if s.starts(jpeg.XMP_MARK)]
    # The packet inside the EXIF block counts last: readers of JPEGs look at it least.
    packets += [inner] if inner else []
    limit = jpeg.LARGEST_PAYLOAD - len(jpeg.XMP_MARK)
    found = _new_packets(packets, pose, make, guids, limit)
    xmp_segments = [_xmp_segment(packet) for packet in found.packets if packet]
    out: list[Segment] = []
    for i, one in enumerate(old):
        if i == (jpeg.place_of_new(old) if k is None else k):
            out.append(exif_segment)
        if one.starts(jpeg.XMP_MARK):
            # The pose has to be in the first packet of the file.
            out += xmp_segments
            xmp_segments = []
        elif one.starts(jpeg.EXTENDED_MARK):
            out += extended.pop(i, [])
        elif i != k:
            out.append(one)
    if exif_segment not in out:
        out.insert(jpeg.place_of_new(out), exif_segment)
    at = out.index(exif_segment) + 1
    return [*out[:at], *xmp_segments, *out[at:]], (*doubts, *found.doubts)


def _xmp_segment(packet: bytes) -> Segment:
    return jpeg.segment(jpeg.APP1, jpeg.XMP_MARK + packet)


def _tagged_exif(block: bytes, pose: PoseTags, doubts: list[str]) -> tuple[bytes, str, bytes]:
    """EXIF block with the pose, the maker, and the XMP packet that was inside the block."""
    source = block or exif.empty_block()
    try:
        tags, main = _structure(source)
    except InputError as error:
        doubts.append(f"the EXIF block {error}: the copy has a new one with the pose alone")
        source = exif.empty_block()
        tags, main = _structure(source)
    make, (at, inner) = tags.text(main, exif.MAKE), tags.value(main, exif.XMP)
    if inner:
        # Programs that search the file for a packet would find this one first.
        tags.patches[at] = b" " * len(inner)
    new = _with_gps(source, tags, main, pose)
    if len(new) > jpeg.LARGEST_PAYLOAD - len(jpeg.EXIF_MARK):
        cut = exif.without_thumbnail(source)
        if cut is None:
            raise InputError(
                f"the EXIF block of {len(block)} bytes has no room for the GPS tags; export the "
                "poses as CSV or geo.txt instead"
            )
        doubts.append("the EXIF block is full: the copy is without its small preview")
        tags, main = _structure(cut)
        if inner:
            tags.patches[at] = b" " * len(inner)
        new = _with_gps(cut, tags, main, pose)
    return new, make, inner


def _structure(block: bytes) -> tuple[TiffTags, Directory]:
    tags = TiffTags(lambda offset, n: block[offset : offset + n], len(block))
    return tags, tags.directory(tags.first)


def _with_gps(block: bytes, tags: TiffTags, main: Directory, pose: PoseTags) -> bytes:
    tags.put(main, exif.put_gps(tags, main, _gps(pose, tags)))
    return tags.applied(block)


# -- TIFF ---------------------------------------------------------------------------------------


def _write_tiff(source: _Source, part: Path, pose: PoseTags) -> tuple[str, ...]:
    size = source.seek(0, os.SEEK_END)

    def read(offset: int, n: int) -> bytes:
        source.seek(offset)
        return source.read(n)

    tags = TiffTags(read, size)
    main = tags.directory(tags.first)
    _check_strips(tags, main, size)
    at, old = tags.value(main, exif.XMP)
    make = tags.text(main, exif.MAKE)
    found = _new_packets([old] if old else [], pose, make, {}, limit=math.inf)
    if old:
        # Programs that search the file for a packet would find this one first.
        tags.patches[at] = b" " * len(old)
    packet = found.packets[0]
    new = {exif.XMP: Tag(kind=BYTE, count=len(packet), data=packet)}
    tags.put(main, {**new, **exif.put_gps(tags, main, _gps(pose, tags))})
    source.seek(0)
    with part.open("wb") as out:
        for chunk in _chunks(source):
            out.write(chunk)
        out.write(tags.tail)
        for place, patch in tags.patches.items():
            out.seek(place)
            out.write(patch)
    return tuple(found.doubts)


def _check_strips(tags: TiffTags, main: Directory, size: int) -> None:
    """Refuse a file that ends before its picture does."""
    for at, length in _STRIPS:
        for start, count in zip(tags.numbers(main, at), tags.numbers(main, length), strict=False):
            if start + count > size:
                raise InputError(
                    f"the picture ends at byte {start + count}, the file at {size}: it is cut "
                    "off; copy it again"
                )
