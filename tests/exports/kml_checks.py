"""Checks of KML and KMZ: the schemas of OGC and Google, and what these do not see.

`faults_of` gives every fault in words; a sound file has none.
"""

from __future__ import annotations

import functools
import posixpath
import zipfile
from collections.abc import Iterable, Iterator
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from lxml import etree

K = "{http://www.opengis.net/kml/2.2}"
GX = "{http://www.google.com/kml/ext/2.2}"
# Elements of one number and the range that a viewer understands
RANGES = {
    "latitude": (-90.0, 90.0), "longitude": (-180.0, 180.0), "north": (-90.0, 90.0),
    "south": (-90.0, 90.0), "east": (-180.0, 180.0), "west": (-180.0, 180.0),
    "heading": (0.0, 360.0), "tilt": (0.0, 180.0), "roll": (-180.0, 180.0),
    "leftFov": (-90.0, 0.0), "rightFov": (0.0, 90.0), "bottomFov": (-90.0, 0.0),
    "topFov": (0.0, 90.0), "altitude": (-1e6, 1e7),
}  # fmt: skip


@functools.cache
def schema() -> etree.XMLSchema:
    """KML 2.2 with Google's extensions, as fastkml has them with it."""
    pytest.importorskip("fastkml", reason="fastkml is not installed: no schema of KML")
    folder = resources.files("fastkml") / "schema"
    return etree.XMLSchema(etree.parse(str(folder / "kml22gx.xsd")))


def documents(path: Path) -> Iterator[tuple[str, Any]]:
    """Names and root elements of the KML files in a KMZ, or of the one KML."""
    if path.suffix == ".kml":
        yield path.name, etree.parse(str(path)).getroot()
        return
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if name.endswith(".kml"):
                yield name, etree.fromstring(archive.read(name))


def faults_of(path: Path) -> list[str]:
    """Everything that is wrong with a KML or KMZ, each with the file it is in."""
    names = [path.name]
    if path.suffix == ".kmz":
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            broken = archive.testzip()
        if broken or names[0] != "doc.kml" or len(names) != len(set(names)):
            return [f"{path.name}: broken archive, or doc.kml is not the first of its files"]
    out: list[str] = []
    used = {names[0]}
    for name, root in documents(path):
        found = [*_schema(root), *_boxes(root), *_ranges(root), *_places(root), *_ids(root),
                 *_tracks(root), *_styles(root)]  # fmt: skip
        out += [f"{name}: {fault}" for fault in found]
        links = {posixpath.normpath(posixpath.join(posixpath.dirname(name), href))
                 for href in hrefs(root)}  # fmt: skip
        out += [f"{name}: no file {link}" for link in sorted(links - set(names))]
        used |= links
    return out + [f"{name}: nothing leads to it" for name in names if name not in used]


def hrefs(root: Any) -> Iterable[str]:
    """Links of a document: of elements, and of pictures in balloons."""
    yield from (e.text for e in root.iter(K + "href"))
    for description in root.iter(K + "description"):
        yield from etree.HTML(f"<div>{description.text}</div>").xpath("//img/@src")


def _schema(root: Any) -> Iterator[str]:
    if not schema().validate(root):
        yield from (str(entry) for entry in list(schema().error_log)[:5])


def _boxes(root: Any) -> Iterator[str]:
    for tag in ("LatLonBox", "LatLonAltBox"):
        for box in root.iter(K + tag):
            text = {side: box.findtext(K + side) for side in ("north", "south", "east", "west")}
            n, s, e, w = (float(text[side]) for side in ("north", "south", "east", "west"))
            if n <= s or e <= w:
                yield f"{tag} without extent: {text}"
            if any(len(t.partition(".")[2]) < 9 for t in text.values()):
                yield f"{tag} of less than 9 decimals: {text}"


def _ranges(root: Any) -> Iterator[str]:
    for tag, (low, high) in RANGES.items():
        for e in root.iter(K + tag):
            if not low <= float(e.text) <= high:
                yield f"{tag} = {e.text}"


def _places(root: Any) -> Iterator[str]:
    for e in root.iter(K + "coordinates"):
        points = [[float(x) for x in p.split(",")] for p in e.text.split()]
        kind = etree.QName(e.getparent()).localname
        least = {"Point": 1, "LineString": 2, "LinearRing": 4}[kind]
        if len(points) < least:
            yield f"{kind} of {len(points)} points"
        if kind == "LinearRing" and points[0] != points[-1]:
            yield "LinearRing that is not closed"
        if any(not (abs(p[0]) <= 180.0 and abs(p[1]) <= 90.0) for p in points):
            yield f"{kind} off the globe"
        mode = e.xpath("ancestor::*[k:altitudeMode][1]/k:altitudeMode/text()",
                       namespaces={"k": K[1:-1]})  # fmt: skip
        if mode == ["absolute"] and any(len(p) < 3 or not abs(p[2]) < 1e7 for p in points):
            yield f"{kind} is absolute and has no height"


def _ids(root: Any) -> Iterator[str]:
    ids = [e.get("id") for e in root.iter() if e.get("id")]
    if len(ids) != len(set(ids)):
        yield f"ids twice: {sorted({i for i in ids if ids.count(i) > 1})[:3]}"


def _styles(root: Any) -> Iterator[str]:
    ids = {e.get("id") for e in root.iter() if e.get("id")}
    yield from (f"no style {e.text}" for e in root.iter(K + "styleUrl") if e.text[1:] not in ids)
    for data in root.iter(K + "SchemaData"):
        if data.get("schemaUrl")[1:] not in ids:
            yield f"no schema {data.get('schemaUrl')}"
    fields = {f.get("name") for tag in (K + "SimpleField", GX + "SimpleArrayField")
              for f in root.iter(tag)}  # fmt: skip
    used = {d.get("name") for tag in (K + "SimpleData", GX + "SimpleArrayData")
            for d in root.iter(tag)}  # fmt: skip
    yield from (f"no field {name} in a schema" for name in sorted(used - fields))


def _tracks(root: Any) -> Iterator[str]:
    for track in root.iter(GX + "Track"):
        whens = [e.text for e in track.iterfind(K + "when")]
        coords = [e.text.split() for e in track.iterfind(GX + "coord")]
        angles = [e.text.split() for e in track.iterfind(GX + "angles")]
        if len(whens) < 2 or len(coords) != len(whens) or len(angles) not in (0, len(whens)):
            yield f"track of {len(whens)} when, {len(coords)} coord, {len(angles)} angles"
        for array in track.iter(GX + "SimpleArrayData"):
            if len(array) != len(whens):
                yield f"{array.get('name')}: {len(array)} values for {len(whens)} when"
        times = [datetime.fromisoformat(text) for text in whens]
        if any(not text.endswith("Z") for text in whens) or times != sorted(set(times)):
            yield "track whose times are not UTC, or not in order"
        if any(len(c) != 3 or abs(float(c[0])) > 180 or abs(float(c[1])) > 90 for c in coords):
            yield "track off the globe"
        if any(len(a) != 3 or not 0 <= float(a[0]) <= 360 for a in angles):
            yield "track with impossible angles"
