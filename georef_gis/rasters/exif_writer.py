"""EXIF GPS tags of a pose, written behind what an EXIF block or a TIFF file has.

Tags and types: CIPA DC-008 (EXIF 3.0) section 4.6.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from georef_gis.errors import GeorefError, InputError
from georef_gis.rasters.tiff_tags import ASCII, BYTE, RATIONAL, Directory, Tag, TiffTags

MAKE, XMP, GPS_IFD = 0x010F, 0x02BC, 0x8825
_THUMBNAIL_AT, _THUMBNAIL_SIZE = 0x0201, 0x0202
_UINT32 = 0xFFFFFFFF
# 1e-7 of an arc second is 3 um; 60 s of it still fit into 32 bits.
_PER_SECOND = 10_000_000
_PER_METRE = 10_000
_PER_DEGREE = 1_000_000
_PER_TIME_SECOND = 1_000_000
_GPS_DOP = 0x000B


def gps_tags(
    tags: TiffTags,
    *,
    lat_lon_deg: tuple[float, float],
    altitude: float,
    direction_deg: float,
    sigma_h: float | None,
    utc: datetime | None,
    map_datum: str,
) -> dict[int, Tag]:
    """GPS tags of a pose.

    Parameters
    ----------
    tags
        Structure whose byte order holds.
    altitude
        m; its sign goes into GPSAltitudeRef.
    direction_deg
        Bearing of the image from true north, deg.
    sigma_h
        One sigma per horizontal axis, m.
    utc
        Instant of the exposure; None leaves the time that is there.
    """

    def text(value: str) -> Tag:
        data = value.encode("ascii", "replace") + b"\0"
        return Tag(kind=ASCII, count=len(data), data=data)

    def ratios(*pairs: tuple[int, int]) -> Tag:
        flat = [min(v, _UINT32) for pair in pairs for v in pair]
        return Tag(kind=RATIONAL, count=len(pairs), data=tags.pack(f"{len(flat)}I", *flat))

    def flags(*values: int) -> Tag:
        return Tag(kind=BYTE, count=len(values), data=bytes(values))

    lat, lon = lat_lon_deg
    new = {
        0x00: flags(2, 3, 0, 0),
        0x01: text("S" if lat < 0 else "N"),
        0x02: ratios(*_sexagesimal(abs(lat), _PER_SECOND)),
        0x03: text("W" if lon < 0 else "E"),
        0x04: ratios(*_sexagesimal(abs(lon), _PER_SECOND)),
        # 2 and 3 would state ellipsoidal heights, but programs take any number above 0 as a sign.
        0x05: flags(1 if altitude < 0 else 0),
        0x06: ratios((round(abs(altitude) * _PER_METRE), _PER_METRE)),
        0x10: text("T"),
        0x11: ratios((round(direction_deg % 360.0 * _PER_DEGREE) % (360 * _PER_DEGREE),
                      _PER_DEGREE)),
        0x12: text(map_datum),
    }  # fmt: skip
    if sigma_h is not None and sigma_h > 0.0:
        new[0x1F] = ratios((max(1, round(sigma_h * _PER_METRE)), _PER_METRE))
    if utc is not None:
        micro = utc.second * _PER_TIME_SECOND + utc.microsecond
        new[0x07] = ratios((utc.hour, 1), (utc.minute, 1), (micro, _PER_TIME_SECOND))
        new[0x1D] = text(f"{utc.year:04d}:{utc.month:02d}:{utc.day:02d}")
    return new


def _sexagesimal(value: float, per_second: int) -> Sequence[tuple[int, int]]:
    """Degrees, minutes and seconds of an angle >= 0 in deg, as fractions."""
    degrees, rest = divmod(round(value * 3600 * per_second), 3600 * per_second)
    minutes, seconds = divmod(rest, 60 * per_second)
    return (degrees, 1), (minutes, 1), (seconds, per_second)


def put_gps(tags: TiffTags, main: Directory, gps: dict[int, Tag]) -> dict[int, Tag]:
    """Write the GPS directory behind the end: the old one's tags, then the new ones over them.

    Returns
    -------
    The pointer to it, to be put into the first directory.
    """
    entries: dict[int, bytes] = {}
    old = tags.numbers(main, GPS_IFD)
    if old:
        try:
            entries = dict(tags.directory(old[0]).entries)
        except InputError:
            # A damaged directory holds nothing to keep; the photo's others are untouched.
            entries = {}
    # The receiver's dilution is of another solution, and programs turn it into an accuracy.
    replaced = {*gps, _GPS_DOP} | ({0x1F} if 0x1F not in gps else set())
    entries = {tag: raw for tag, raw in entries.items() if tag >= 0 and tag not in replaced}
    entries |= {tag: tags.entry(tag, value) for tag, value in gps.items()}
    return {GPS_IFD: tags.pointer(tags.append_directory(entries))}


def empty_block() -> bytes:
    """EXIF block of a photo that has none: a first directory without tags, little-endian."""
    # A directory must have an entry: ResolutionUnit, inch, which is the default anyway.
    return b"II*\0\x08\0\0\0" + b"\x01\0" + b"\x28\x01\x03\0\x01\0\0\0\x02\0\0\0" + b"\0\0\0\0"


def without_thumbnail(block: bytes) -> bytes | None:
    """EXIF block without the preview at its end, to make room; None if there is none there."""
    tags = TiffTags(lambda offset, n: block[offset : offset + n], len(block))
    main = tags.directory(tags.first)
    try:
        preview = tags.directory(main.following)
        (start,), (size,) = (tags.numbers(preview, tag) for tag in (_THUMBNAIL_AT, _THUMBNAIL_SIZE))
    except (GeorefError, ValueError):
        return None
    after_last = main.offset + tags.head_size + len(main.entries) * tags.entry_size
    if start < after_last or block[start + size :].strip(b"\0") or start + size > len(block):
        return None
    out = bytearray(block[:start])
    out[after_last : after_last + 4] = b"\0\0\0\0"
    return bytes(out)
