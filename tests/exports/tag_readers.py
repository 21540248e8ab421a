"""How other programs read a pose from a photo's tags, re-told from their documented behaviour.

Written apart from the product: other libraries (exifread, expat, GDAL, ElementTree), no code of
ours. What is described here is OpenDroneMap's `opendm/photo.py` (July 2026) and orthority's
`exif.py` and `param_io.py` (September 2025).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import exifread
import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.warp import transform

# From the photo's axes (right, up, back) to a body's (forward, right, down), camera looking down
BODY_FROM_PHOTO = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


@dataclass
class Reading:
    """Degrees and metres as a program takes them; None where it finds nothing."""

    lat: float | None = None
    lon: float | None = None
    alt: float | None = None
    yaw: float | None = None
    pitch: float | None = None
    roll: float | None = None
    xy: float | None = None
    z: float | None = None
    make: str = ""
    names: set[str] = field(default_factory=set)

    @property
    def R_enu_from_photo(self) -> np.ndarray:
        """Rotation that the angles mean in the level frame at the camera."""
        R_ned_from_body = rotation(2, self.yaw) @ rotation(1, self.pitch) @ rotation(0, self.roll)
        return BODY_FROM_PHOTO @ R_ned_from_body @ BODY_FROM_PHOTO


def rotation(axis: int, degrees: float | None) -> np.ndarray:
    assert degrees is not None
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


# -- OpenDroneMap ---------------------------------------------------------------------------------


def odm(path: Path) -> Reading:
    """What OpenDroneMap takes from a photo."""
    out = Reading()
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=True, extract_thumbnail=False)
    ratio = {k: [float(v) for v in tags[k].values] for k in tags if "Altitude" not in k
             and k in ("GPS GPSLatitude", "GPS GPSLongitude")}  # fmt: skip
    out.make = str(tags["Image Make"].values).strip() if "Image Make" in tags else ""
    for name, ref in (("Latitude", "SWsw"), ("Longitude", "SWsw")):
        if f"GPS GPS{name}" in tags:
            d, m, s = ratio[f"GPS GPS{name}"]
            sign = -1 if str(tags[f"GPS GPS{name}Ref"].values)[0] in ref else 1
            setattr(out, name[:3].lower(), sign * (d + m / 60 + s / 3600))
    if "GPS GPSAltitude" in tags:
        out.alt = float(tags["GPS GPSAltitude"].values[0])
        # Any reference above 0 turns the sign, the ellipsoidal ones of EXIF 3.0 too.
        if "GPS GPSAltitudeRef" in tags and int(tags["GPS GPSAltitudeRef"].values[0]) > 0:
            out.alt = -out.alt
    for tag in odm_descriptions(path.read_bytes()):
        _odm_description(tag, out)
    return out


def _odm_description(tag: dict[str, str], out: Reading) -> None:
    """One rdf:Description; values stay from one to the next, and so do the corrections."""
    out.names |= set(tag)

    def first(attribute: str, *names: str) -> None:
        for name in names:
            if name in tag:
                setattr(out, attribute, float(tag[name]))
                return

    if not out.make and "@tiff:Make" in tag:
        out.make = tag["@tiff:Make"]
    first("lon", "@drone-dji:Longitude")
    first("lat", "@drone-dji:Latitude")
    first("alt", "@drone-dji:AbsoluteAltitude")
    if "@drone-dji:RtkStdLon" in tag:
        out.xy = max(float(tag["@drone-dji:RtkStdLon"]), float(tag["@drone-dji:RtkStdLat"]))
        first("z", "@drone-dji:RtkStdHgt")
    else:
        first("xy", "@Camera:GPSXYAccuracy", "GPSXYAccuracy")
        first("z", "@Camera:GPSZAccuracy", "GPSZAccuracy")
    # It calls every stated accuracy too good and doubles it, after each description.
    out.xy = None if out.xy is None else 2.0 * out.xy
    out.z = None if out.z is None else 2.0 * out.z
    first("yaw", "@drone-dji:FlightYawDegree", "@Camera:Yaw", "Camera:Yaw")
    first("pitch", "@drone-dji:GimbalPitchDegree", "@Camera:Pitch", "Camera:Pitch")
    first("roll", "@drone-dji:GimbalRollDegree", "@Camera:Roll", "Camera:Roll")
    if out.yaw is not None and out.pitch is not None and out.roll is not None:
        if out.make.lower() in ("dji", "hasselblad"):
            out.pitch += 90.0
        if out.make.lower() == "sensefly":
            out.roll = -out.roll


def odm_descriptions(data: bytes) -> list[dict[str, str]]:
    """Descriptions of the first packet found anywhere in the file, names with their prefixes."""
    start, end = data.find(b"<x:xmpmeta"), data.find(b"</x:xmpmeta")
    if not start < end:
        return []
    out: list[dict[str, str]] = []
    stack: list[str] = []
    text: list[str] = []

    def opened(name: str, attributes: dict[str, str]) -> None:
        stack.append(name)
        text.clear()
        if stack == ["x:xmpmeta", "rdf:RDF", "rdf:Description"]:
            out.append({f"@{k}": v for k, v in attributes.items()})

    def closed(name: str) -> None:
        if len(stack) == 4 and stack[2] == "rdf:Description":
            out[-1][name] = "".join(text).strip()
        stack.pop()
        text.clear()

    parser = expat.ParserCreate()
    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    parser.CharacterDataHandler = text.append
    parser.Parse(data[start : end + 12], True)
    return out


# -- orthority ---------------------------------------------------------------------------------

_DJI = "{http://www.dji.com/drone-dji/1.0/}"
# Namespace and names of position and angles, and what is added to the angles; the first full set
_SETS: tuple[tuple[tuple[str, ...], float], ...] = (
    (tuple(f"{_DJI}Gimbal{a}Degree" for a in ("Roll", "Pitch", "Yaw")), 90.0),
    (tuple(f"{{http://ns.sensefly.com/Camera/1.0/}}{a}" for a in ("Roll", "Pitch", "Yaw")), 0.0),
    (tuple(f"{{http://pix4d.com/camera/1.0/}}{a}" for a in ("Roll", "Pitch", "Yaw")), 0.0),
)


def orthority(path: Path) -> Reading:
    """What orthority takes from a photo, through GDAL."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        dataset = rasterio.open(path)
    with dataset as ds:
        spaces = ds.tag_namespaces()
        exif: dict[str, Any] = ds.tags(ns="EXIF") if "EXIF" in spaces else ds.tags()
        packet = ds.tags(ns="xml:XMP")["xml:XMP"] if "xml:XMP" in spaces else ""
    flat: dict[str, str | None] = {}
    for node in ElementTree.fromstring(packet).iter() if packet else ():
        flat[node.tag] = node.text
        flat.update(node.attrib)
    out = Reading(make=exif.get("EXIF_Make", ""))
    place = [f"{_DJI}{n}" for n in ("GpsLatitude", "GpsLongtitude", "AbsoluteAltitude")]
    if all(name in flat for name in place):
        out.lat, out.lon, out.alt = (float(str(flat[name])) for name in place)
    elif "EXIF_GPSLatitude" in exif:
        for name in ("Latitude", "Longitude"):
            d, m, s = _floats(exif[f"EXIF_GPS{name}"])
            sign = 1 if exif[f"EXIF_GPS{name}Ref"] in "NE" else -1
            setattr(out, name[:3].lower(), sign * (d + m / 60 + s / 3600))
        below = int(exif.get("EXIF_GPSAltitudeRef", "0x00"), 0) == 1
        out.alt = _floats(exif["EXIF_GPSAltitude"])[0] * (-1 if below else 1)
    for names, add in _SETS:
        if all(name in flat for name in names):
            out.roll, out.pitch, out.yaw = (float(str(flat[name])) for name in names)
            out.pitch += add
            break
    return out


def _floats(text: str) -> list[float]:
    return [float(part.strip(" (")) for part in text.split(")") if part.strip()]


def orthority_opk(reading: Reading, crs: str) -> np.ndarray:
    """Omega, phi, kappa, deg, in a projected CRS: north by a small step of latitude."""
    ends = []
    for step in (1e-7, -1e-7):
        x, y, z = transform("EPSG:4979", crs, [reading.lon], [reading.lat + step], [reading.alt])
        ends.append(np.array([x[0], y[0], z[0]]))
    north = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    down = np.array([0.0, 0.0, -1.0])
    R_map_from_ned = np.column_stack([north, np.cross(down, north), down])
    R = R_map_from_ned @ BODY_FROM_PHOTO @ reading.R_enu_from_photo
    return np.degrees(
        [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])]
    )
