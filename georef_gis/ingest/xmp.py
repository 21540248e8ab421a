"""XMP packets: attributes, elements and lists of every vendor's namespace."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable

from lxml import etree

from georef_gis.ingest.tags import DROPPED, Tags

# Namespace without scheme, 'www.' and closing slash -> exiftool's name of it
NAMESPACES = {
    "dji.com/drone-dji/1.0": "drone-dji",
    "pix4d.com/camera/1.0": "Camera",
    "pix4d.com/camera": "Camera",
    "ns.sensefly.com/sensefly/1.0": "sensefly",
    "sensefly.com/sensefly/1.0": "sensefly",
    "parrot.com/drone-parrot/1.0": "drone-parrot",
    "skydio.com/drone-skydio/1.0": "drone-skydio",
    "ns.flir.com/xmp/1.0": "FLIR",
    "micasense.com/MicaSense/1.0": "MicaSense",
    "micasense.com/DLS/1.0": "DLS",
    "ns.adobe.com/tiff/1.0": "tiff",
    "ns.adobe.com/exif/1.0": "exif",
    "ns.adobe.com/xap/1.0": "xmp",
    "ns.adobe.com/xap/1.0/mm": "xmpMM",
    "ns.adobe.com/photoshop/1.0": "photoshop",
    "ns.adobe.com/camera-raw-settings/1.0": "crs",
    "purl.org/dc/elements/1.1": "dc",
    "cipa.jp/exif/1.0": "exifEX",
    "ns.google.com/photos/1.0/panorama": "GPano",
}
_RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
_LISTS = frozenset({f"{_RDF}Seq", f"{_RDF}Bag", f"{_RDF}Alt"})
_DESCRIPTION = f"{_RDF}Description"
_LI = f"{_RDF}li"
_META = re.compile(rb"<(x:xmpmeta|x:xapmeta|rdf:RDF)\b.*?</\1\s*>", re.S)
_START = re.compile(rb"<(?:x:xmpmeta|x:xapmeta|rdf:RDF)\b")
# An XMP packet is a few kilobytes; more is a picture inside it.
_LARGEST_PACKET = 4_000_000
# An editor's name is the one thing wanted from the history.
_WANTED_HISTORY = "HistorySoftwareAgent"


def tags_from_packets(packets: Iterable[bytes]) -> tuple[Tags, tuple[str, ...]]:
    """Tags of XMP packets, the first value of a name winning, and doubts about their form.

    Returns
    -------
    tags
        By name, such as `XMP-drone-dji:GimbalYawDegree`; lists are joined by commas.
    doubts
        Plain words where a packet is not well-formed.
    """
    tags: Tags = {}
    doubts: list[str] = []
    for packet in packets:
        _read_packet(packet, tags, doubts)
    return tags, tuple(dict.fromkeys(doubts))


def _read_packet(packet: bytes, tags: Tags, doubts: list[str]) -> None:
    found = _META.search(packet) if len(packet) < _LARGEST_PACKET else None
    start = None if found else _START.search(packet)
    if not found and not start:
        if packet.strip(b" \0\r\n\t"):
            doubts.append("the XMP packet holds no metadata element; it was ignored")
        return
    body = found.group(0) if found else packet[start.start() if start else 0 :]
    parser = etree.XMLParser(
        recover=True, resolve_entities=False, no_network=True, remove_comments=True
    )
    try:
        root = etree.fromstring(body, parser)
    except (etree.XMLSyntaxError, ValueError):
        root = None
    if root is None:
        doubts.append("the XMP packet is not XML; its tags were ignored")
        return
    if any(entry.level >= 3 or entry.level_name == "ERROR" for entry in parser.error_log):
        doubts.append("the XMP packet is malformed XML; what could be read of it was used")
    for description in root.iter(_DESCRIPTION):
        parent = description.getparent()
        if parent is not None and parent.tag == f"{_RDF}RDF":
            _read_fields(description, "", tags)


def _read_fields(node: etree._Element, parent: str, tags: Tags) -> None:
    """Attributes and child elements of a description or of a structure inside one."""
    for key, value in node.attrib.items():
        _put(tags, str(key), parent, str(value), node)
    for child in node:
        if isinstance(child.tag, str):
            _read_element(child, parent, tags)


def _read_element(node: etree._Element, parent: str, tags: Tags) -> None:
    name = _name(str(node.tag), node)
    if name is None:
        return
    inner = [c for c in node if isinstance(c.tag, str)]
    full = name if not parent else parent + name.partition(":")[2]
    if not inner:
        if node.text and node.text.strip():
            _put(tags, str(node.tag), parent, node.text.strip(), node)
        elif any(not str(k).startswith("{http://www.w3.org") for k in node.attrib):
            _read_fields(node, full, tags)
        else:
            _put(tags, str(node.tag), parent, "", node)
        return
    if inner[0].tag in _LISTS:
        _read_list(inner[0], full, tags)
    elif inner[0].tag == _DESCRIPTION:
        _read_fields(inner[0], full, tags)
    else:
        _read_fields(node, full, tags)


def _read_list(node: etree._Element, full: str, tags: Tags) -> None:
    plain: list[str] = []
    for item in node.iterfind(_LI):
        if len(item) or any(not str(k).startswith("{http://www.w3.org") for k in item.attrib):
            _read_fields(item[0] if len(item) and item[0].tag == _DESCRIPTION else item, full, tags)
        elif item.text:
            plain.append(item.text.strip())
    if plain and full not in tags and _wanted(full):
        tags[sys.intern(full)] = ",".join(plain)


def _put(tags: Tags, key: str, parent: str, value: str, node: etree._Element) -> None:
    name = _name(key, node)
    if name is None:
        return
    full = name if not parent else parent + name.partition(":")[2]
    if full not in tags and _wanted(full):
        tags[sys.intern(full)] = value


def _wanted(full: str) -> bool:
    return full.partition(":")[0] not in DROPPED or full.endswith(_WANTED_HISTORY)


def _name(key: str, node: etree._Element) -> str | None:
    """exiftool's name of a field, e.g. `XMP-Camera:Yaw`; None for RDF's own attributes."""
    if not key.startswith("{"):
        # A prefix that nothing declares stays in the name when lxml recovers.
        prefix, colon, local = key.partition(":")
        return f"XMP-{prefix}:{local[:1].upper()}{local[1:]}" if colon and prefix != "rdf" else None
    uri, _, local = key[1:].partition("}")
    if uri.startswith(("http://www.w3.org/", "adobe:ns:meta")):
        return None
    short = uri.partition("://")[2].removeprefix("www.").rstrip("/")
    group = NAMESPACES.get(short) or next(
        (p for p, u in node.nsmap.items() if u == uri and p), "unknown"
    )
    return f"XMP-{group}:{local[:1].upper()}{local[1:]}"
