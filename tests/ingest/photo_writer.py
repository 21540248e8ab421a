"""Writes photos with given tags, by Pillow and piexif and hand-made XMP packets: an oracle that
shares no code with the readers.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import piexif
from PIL import Image

GPS_TAGS = {name: tag for tag, name in ((t, d["name"]) for t, d in piexif.TAGS["GPS"].items())}
NAMESPACES = {
    "drone-dji": "http://www.dji.com/drone-dji/1.0/",
    "Camera": "http://pix4d.com/camera/1.0",
    "sensefly": "http://ns.sensefly.com/sensefly/1.0/",
    "drone-parrot": "http://www.parrot.com/drone-parrot/1.0/",
    "drone-skydio": "https://www.skydio.com/drone-skydio/1.0/",
    "FLIR": "http://ns.flir.com/xmp/1.0/",
    "MicaSense": "http://micasense.com/MicaSense/1.0/",
    "DLS": "http://micasense.com/DLS/1.0/",
    "exif": "http://ns.adobe.com/exif/1.0/",
    "xmp": "http://ns.adobe.com/xap/1.0/",
}
EXIF_NAMES = {"ISO": "ISOSpeedRatings", "CreateDate": "DateTimeDigitized"} | {
    "ExifImageWidth": "PixelXDimension",
    "ExifImageHeight": "PixelYDimension",
    "FocalLengthIn35mmFormat": "FocalLengthIn35mmFilm",
}
IFD0_NAMES = {"ModifyDate": "DateTime"}


def rational(value: float) -> tuple[int, int]:
    fraction = Fraction(value).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator


def value_of(kind: int, value: object) -> object | None:
    """Value in the form piexif wants for a TIFF type."""
    if kind == piexif.TYPES.Ascii:
        text = f"{value:g}" if isinstance(value, float) else str(value)
        return text.encode()
    if kind in (piexif.TYPES.Rational, piexif.TYPES.SRational):
        if value == "undef":
            return (0, 0)
        return rational(float(value)) if isinstance(value, int | float) else None
    if kind in (piexif.TYPES.Short, piexif.TYPES.Long) and isinstance(value, int | float):
        return int(value)
    return None


def degrees(value: float) -> tuple[tuple[int, int], ...]:
    """Degrees and the rest in minutes and seconds, to 1e-6 seconds."""
    micro = round(value * 3600e6)
    d, rest = divmod(micro, 3_600_000_000)
    m, s = divmod(rest, 60_000_000)
    return (d, 1), (m, 1), (s, 1_000_000)


def exif_bytes(record: Mapping[str, object]) -> bytes:
    """EXIF of exiftool's groups IFD0, ExifIFD and GPS."""
    ifds: dict[str, dict[int, object]] = {"0th": {}, "Exif": {}, "GPS": {}}
    by_name = {
        ifd: {d["name"]: (tag, d["type"]) for tag, d in piexif.TAGS[table].items()}
        for ifd, table in (("0th", "Image"), ("Exif", "Exif"), ("GPS", "GPS"))
    }
    for full, value in record.items():
        group, _, name = full.partition(":")
        ifd = {"IFD0": "0th", "ExifIFD": "Exif", "GPS": "GPS"}.get(group)
        name = {**EXIF_NAMES, **IFD0_NAMES}.get(name, name)
        if ifd is None or name not in by_name[ifd]:
            continue
        tag, kind = by_name[ifd][name]
        if name in ("GPSLatitude", "GPSLongitude"):
            out: object | None = degrees(float(str(value)))
        elif name == "GPSTimeStamp":
            h, m, s = str(value).split(":")
            out = ((int(h), 1), (int(m), 1), rational(float(s)))
        elif name == "GPSAltitudeRef":
            out = int(float(str(value)))
        else:
            out = value_of(kind, value)
        if out is not None:
            ifds[ifd][tag] = out
    note = makernote(record)
    if note:
        ifds["Exif"][piexif.ExifIFD.MakerNote] = note
    return piexif.dump(ifds)


def makernote(record: Mapping[str, object]) -> bytes:
    """DJI's MakerNote: directory of floats, or bracketed text."""
    if "DJI:GimbalDegree" in record:
        return (
            f"[ae_dbg_info:abc][GimbalDegree(Y,P,R):{record['DJI:GimbalDegree']}]"
            f"[FlightDegree(Y,P,R):{record['DJI:FlightDegree']}]"
            f"[FlightSpeed(X,Y,Z):{record['DJI:FlightSpeed']}]"
        ).encode()
    names = ["SpeedX", "SpeedY", "SpeedZ", "Pitch", "Yaw", "Roll"]
    names += ["CameraPitch", "CameraYaw", "CameraRoll"]
    values = [(i, record.get(f"DJI:{name}")) for i, name in enumerate(names, start=3)]
    entries = [
        struct.pack("<HHIf", tag, 11, 1, v) for tag, v in values if isinstance(v, int | float)
    ]
    if not entries:
        return b""
    entries.insert(0, struct.pack("<HHI4s", 1, 2, 4, b"DJI\0"))
    return struct.pack("<H", len(entries)) + b"".join(entries) + b"\0" * 4


def xmp_packet(record: Mapping[str, object], *, as_elements: bool = False) -> bytes:
    """One packet of every XMP group whose namespace is known."""
    fields: list[tuple[str, str, object]] = []
    for full, value in record.items():
        match = re.match(r"XMP-([\w-]+):(.+)", full)
        if match and match[1] in NAMESPACES:
            fields.append((match[1], match[2], value))
    if not fields:
        return b""
    spaces = " ".join(f'xmlns:{p}="{u}"' for p, u in NAMESPACES.items())
    attributes, elements = [], []
    for group, name, value in fields:
        if isinstance(value, list):
            items = "".join(f"<rdf:li>{v}</rdf:li>" for v in value)
            elements.append(f"<{group}:{name}><rdf:Seq>{items}</rdf:Seq></{group}:{name}>")
        elif as_elements:
            elements.append(f"<{group}:{name}>{value}</{group}:{name}>")
        else:
            attributes.append(f'{group}:{name}="{value}"')
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" {spaces} {" ".join(attributes)}>{"".join(elements)}'
        '</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def write_photo(
    path: Path,
    *,
    tags: Mapping[str, object] | None = None,
    size: tuple[int, int] = (64, 48),
    packets: list[bytes] | None = None,
    as_elements: bool = False,
) -> None:
    """A grey photo; `tags` by exiftool's names, `packets` instead of the XMP among them."""
    record = dict(tags or {})
    xmp = packets if packets is not None else [xmp_packet(record, as_elements=as_elements)]
    image = Image.new("L" if path.suffix.lower().startswith(".tif") else "RGB", size, 90)
    if path.suffix.lower() in (".tif", ".tiff"):
        exif = Image.Exif()
        exif.load(exif_bytes(record))
        if xmp and xmp[0]:
            exif[700] = xmp[0]
        image.save(path, exif=exif)
        return
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=20)
    raw = buffer.getvalue()
    parts = [raw[:2], segment(exif_bytes(record))]
    parts += [segment(b"http://ns.adobe.com/xap/1.0/\0" + packet) for packet in xmp if packet]
    path.write_bytes(b"".join(parts) + raw[2:])


def segment(payload: bytes) -> bytes:
    """APP1 segment."""
    return b"\xff\xe1" + struct.pack(">H", len(payload) + 2) + payload
