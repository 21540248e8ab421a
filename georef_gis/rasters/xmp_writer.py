"""XMP packets of a copy: the pose goes in, what else states position or attitude goes out.

Names of tags: Pix4D support article 360016450032 (namespace Camera); DJI, senseFly, Parrot,
Skydio, FLIR and Teal as their photos have them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from lxml import etree

from georef_gis.rasters.jpeg_segments import (
    APP1,
    EXTENDED_MARK,
    LARGEST_PAYLOAD,
    Segment,
    segment,
)

CAMERA = "http://pix4d.com/camera/1.0/"
DRONE_DJI = "http://www.dji.com/drone-dji/1.0/"
PREFIXES = {"Camera": CAMERA, "drone-dji": DRONE_DJI}
_RDF_URI = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_RDF, _DESCRIPTION, _ABOUT = (f"{{{_RDF_URI}}}{n}" for n in ("RDF", "Description", "about"))
_XMPMETA = "{adobe:ns:meta/}xmpmeta"
_HAS_EXTENDED = "{http://ns.adobe.com/xmp/note/}HasExtendedXMP"
_TIFF_MAKE = "{http://ns.adobe.com/tiff/1.0/}Make"

# Angles of the camera, the gimbal or the vehicle, and their accuracies, in any namespace
_ATTITUDE = re.compile(
    r"(gimbal|flight|camera|drone|aircraft|vehicle|platform|mav|uav|imu|gps)?"
    r"(yaw|pitch|roll|heading|imgdirection(ref)?)(degrees?|angle|accuracy)?"
    r"|(camera|vehicle|gimbal|drone|platform)(orientation|attitude|quaternion|position).*",
    re.I,
)
# Places, heights over the sea, the ellipsoid or take-off, and their accuracies
_PLACE = re.compile(
    r"(gps)?(latitude|longt?itude)(ref)?|(gps|absolute|relative|mav|mavrelative)altitude(ref)?"
    r"|altitude(type|wgs84|amsl|ref)?|rtk(flag|std\w*|diffage)|gps(xy|z)accuracy"
    r"|(horiz|vert)cs|gps(time|date)stamp|gpsmapdatum|gpshpositioningerror|gpsdop",
    re.I,
)
# A height above take-off whose name is too common to be taken out of every namespace
_SENSEFLY_HEIGHT = "Height"
# Light sensors, panoramas, lens corrections and edit histories have angles of their own.
_LEFT_ALONE = ("micasense.com/dls", "ns.google.com/photos", "camera-raw-settings", "xap/1.0/")
_BODY = re.compile(rb"<((?:[\w-]+:)?(?:xmpmeta|xapmeta|RDF))\b.*</\1\s*>", re.S)
_USED_PREFIX = re.compile(rb"[\s<]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*(?=[\s=/>])")
_DECLARED_PREFIX = re.compile(rb"xmlns:([\w.-]+)\s*=")
_OPEN_RDF = re.compile(rb"<rdf:RDF\b")
# Where the packet is, and where it ends; no padding, as the copy is not edited in place
_HEAD = '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>\n'.encode()
_FOOT = b'\n<?xpacket end="w"?>'


# GUID, full length and offset stand before each part of an extended packet (XMP part 3, 1.1.3.1).
_EXTENDED_HEAD = 40


@dataclass(slots=True, kw_only=True)
class Packet:
    """A parsed packet; `root` is the x:xmpmeta or rdf:RDF element, None if it cannot be read."""

    root: etree._Element | None
    repaired: bool = False
    removed: list[str] = field(default_factory=list)


def parse_packet(packet: bytes) -> Packet:
    """A packet's elements; malformed XML is repaired as far as it can be."""
    found = _BODY.search(packet)
    if not found:
        return Packet(root=None)
    body = found.group(0)
    root = _parsed(body, recover=False)
    if root is not None:
        return Packet(root=root)
    # The common fault is a prefix that nothing declares.
    missing = sorted(set(_USED_PREFIX.findall(body)) - set(_DECLARED_PREFIX.findall(body)))
    names = [m.decode("ascii") for m in missing if m not in (b"xmlns", b"xml", b"rdf", b"x")]
    spaces = "".join(f' xmlns:{n}="{PREFIXES.get(n, f"urn:undeclared:{n}")}"' for n in names)
    body = _OPEN_RDF.sub(b"<rdf:RDF" + spaces.encode(), body, count=1)
    root = _parsed(body, recover=True)
    if root is None or _parsed(etree.tostring(root), recover=False) is None:
        return Packet(root=None)
    return Packet(root=root, repaired=True)


def _parsed(body: bytes, *, recover: bool) -> etree._Element | None:
    parser = etree.XMLParser(
        recover=recover, resolve_entities=False, no_network=True, huge_tree=True
    )
    try:
        return etree.fromstring(body, parser)
    except (etree.XMLSyntaxError, ValueError):
        return None


def _is_pose(name: str, also: Collection[str] = ()) -> bool:
    """Whether a tag, `{namespace}name`, states a position, a height or an attitude."""
    uri, _, local = name[1:].partition("}")
    if not name.startswith("{") or uri == _RDF_URI:
        return False
    if any(part in uri.lower() for part in _LEFT_ALONE):
        return False
    if local == _SENSEFLY_HEIGHT and "sensefly" in uri.lower():
        return True
    return local in also or bool(_ATTITUDE.fullmatch(local) or _PLACE.fullmatch(local))


def remove_poses(packet: Packet, also: Collection[str] = ()) -> None:
    """Take out every tag that states a position, a height or an attitude, and names `also`."""
    if packet.root is None:
        return
    for node in list(packet.root.iter(etree.Element)):
        for key in [str(k) for k in node.attrib if _is_pose(str(k), also)]:
            del node.attrib[key]
            packet.removed.append(key)
        parent = node.getparent()
        if _is_pose(str(node.tag), also) and parent is not None:
            packet.removed.append(str(node.tag))
            parent.remove(node)


def make_of(packet: Packet) -> str:
    """Maker that a packet states, as OpenDroneMap takes it where EXIF has none."""
    if packet.root is None:
        return ""
    found = [node.get(_TIFF_MAKE) for node in packet.root.iter(_DESCRIPTION)]
    return next((v.strip() for v in found if v and v.strip()), "")


def put_fields(packet: Packet, fields: Mapping[str, Mapping[str, str]]) -> None:
    """Add attributes, by prefix and name, to the last description of a packet.

    The last one, because OpenDroneMap goes through the descriptions in turn and doubles the
    accuracies and corrects the angles once more at every one after that which holds them.
    """
    spaces = {prefix: PREFIXES[prefix] for prefix in fields if fields[prefix]}
    rdf = None if packet.root is None else next(packet.root.iter(_RDF), None)
    old = [] if rdf is None else [n for n in rdf if n.tag == _DESCRIPTION]
    root = etree.Element(_XMPMETA, nsmap={"x": "adobe:ns:meta/"})
    new = etree.SubElement(root, _RDF, nsmap={"rdf": _RDF_URI})
    about = old[-1].get(_ABOUT) if old else ""
    for node in old:
        new.append(node)
        node.tail = "\n"
    last = _rebuilt(old[-1], spaces) if old else None
    if last is None:
        last = etree.SubElement(new, _DESCRIPTION, nsmap=spaces)
        last.set(_ABOUT, about or "")
    for prefix, values in fields.items():
        for name, value in values.items():
            last.set(f"{{{PREFIXES[prefix]}}}{name}", value)
    packet.root = root


def _rebuilt(node: etree._Element, spaces: Mapping[str, str]) -> etree._Element | None:
    """A description with more namespaces declared; None if it uses a prefix for another one.

    OpenDroneMap compares prefixes, orthority namespaces: both have to be right.
    """
    inside = [n.nsmap for n in node.iter(etree.Element)]
    for prefix, uri in spaces.items():
        uris = {m[prefix] for m in inside if prefix in m}
        aliases = {p for m in inside for p, u in m.items() if u == uri}
        if uris - {uri} or aliases - {prefix}:
            return None
    parent = node.getparent()
    if parent is None:
        return None
    # A default namespace has the prefix None, which the stubs of lxml do not know.
    declared: Any = {**node.nsmap, **spaces}
    attributes = {str(key): str(value) for key, value in node.attrib.items()}
    new = etree.Element(node.tag, attrib=attributes, nsmap=declared)
    new.text, new.tail = node.text, node.tail
    for child in list(node):
        new.append(child)
    parent.replace(node, new)
    return new


def rename_extended(packet: Packet, guids: Mapping[str, str]) -> None:
    """Point to extended packets that have changed."""
    if packet.root is None:
        return
    for node in packet.root.iter(etree.Element):
        if node.get(_HAS_EXTENDED) in guids:
            node.set(_HAS_EXTENDED, guids[str(node.get(_HAS_EXTENDED))])
        elif node.tag == _HAS_EXTENDED and (node.text or "").strip() in guids:
            node.text = guids[(node.text or "").strip()]


def packet_bytes(packet: Packet) -> bytes:
    """The packet as it stands in a file."""
    if packet.root is None:
        return b""
    packet.root.tail = None
    return _HEAD + bytes(etree.tostring(packet.root, encoding="UTF-8")) + _FOOT


def clean_extended(
    old: list[Segment], doubts: list[str], also: Collection[str] = ()
) -> tuple[dict[int, list[Segment]], dict[str, str]]:
    """Extended XMP: new segments by the index of the old ones, and new GUIDs by old ones."""
    groups: dict[bytes, list[int]] = {}
    for i, one in enumerate(old):
        if one.starts(EXTENDED_MARK):
            groups.setdefault(_extended_head(one)[:32], []).append(i)
    segments: dict[int, list[Segment]] = {}
    guids: dict[str, str] = {}
    for guid, places in groups.items():
        for i in places:
            segments[i] = [old[i]]
        parts = {int.from_bytes(_extended_head(old[i])[36:40], "big"): i for i in places}
        body = b"".join(
            old[parts[offset]].payload[len(EXTENDED_MARK) + _EXTENDED_HEAD :]
            for offset in sorted(parts)
        )
        packet = parse_packet(body)
        remove_poses(packet, also)
        if packet.root is None:
            doubts.append("extended XMP is not XML: it is in the copy as it is")
        if not packet.removed:
            continue
        clean = packet_bytes(packet)
        new_guid = hashlib.md5(clean, usedforsecurity=False).hexdigest().upper()
        guids[guid.decode("ascii", "replace")] = new_guid
        for i in places:
            segments[i] = []
        segments[places[0]] = _extended_segments(clean, new_guid)
    return segments, guids


def _extended_head(one: Segment) -> bytes:
    start = len(EXTENDED_MARK)
    return one.payload[start : start + _EXTENDED_HEAD]


def _extended_segments(packet: bytes, guid: str) -> list[Segment]:
    step = LARGEST_PAYLOAD - len(EXTENDED_MARK) - _EXTENDED_HEAD
    size = len(packet).to_bytes(4, "big")
    return [
        segment(
            APP1,
            EXTENDED_MARK
            + guid.encode("ascii")
            + size
            + at.to_bytes(4, "big")
            + packet[at : at + step],
        )
        for at in range(0, len(packet), step)
    ]
