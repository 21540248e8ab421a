"""Items of metadata for rasters that are written already: in a file beside, or in a copy's tags.

GDAL, and QGIS by it, reads ``<raster>.aux.xml`` beside every raster (PAM: gdal.org,
`user/raster_data_model` and `GDALPamDataset`) and merges its items with those in the file. The
raster stays byte for byte what it is, so nothing that was made of it becomes stale.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import InputError
from georef_gis.rasters.files import export_errors, whole_file
from georef_gis.rasters.tiff_tags import ASCII, Tag, TiffTags

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# GDAL_METADATA of its TIFF driver
_GDAL_METADATA = 42112
_SUFFIX = ".aux.xml"


def aux_path(raster: Path) -> Path:
    """File beside a raster that holds its further metadata."""
    return raster.with_name(raster.name + _SUFFIX)


def write_aux_metadata(path: Path, items: Mapping[str, str], *, family: str = "") -> Path:
    """Put items beside a raster, whole or not at all; what else stands there stays.

    Parameters
    ----------
    path
        The raster, which is not touched.
    items
        Name -> text.
    family
        Older items whose names begin with this go, unless it is empty.

    Returns
    -------
    Path
        The file written; it is removed if nothing is left to say.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    from xml.etree import ElementTree as ET

    target = aux_path(path)
    root = _existing(target)
    plain = [one for one in root.findall("Metadata") if not one.get("domain")]
    block = plain[0] if plain else ET.SubElement(root, "Metadata")
    for item in block.findall("MDI"):
        if _goes(item.get("key", ""), items, family):
            block.remove(item)
    for name, value in items.items():
        ET.SubElement(block, "MDI", key=name).text = _clean(value)
    if not len(block):
        root.remove(block)
    with export_errors(target, lambda: 0):
        if not len(root):
            target.unlink(missing_ok=True)
            return target
        ET.indent(root)
        with whole_file(target) as stream:
            stream.write(ET.tostring(root, encoding="utf-8") + b"\n")
    return target


def _existing(target: Path) -> Element:
    """What stands beside the raster; a file that is no such XML is replaced."""
    from xml.etree import ElementTree as ET

    try:
        root = ET.fromstring(target.read_bytes())
    except (OSError, ET.ParseError):
        return ET.Element("PAMDataset")
    return root if root.tag == "PAMDataset" else ET.Element("PAMDataset")


def add_tiff_items(path: Path, items: Mapping[str, str], *, family: str = "") -> bool:
    """Put items into the GDAL metadata of a TIFF; False if it has none that could be replaced.

    The new text goes behind the end of the file and only the entry that points to it is changed,
    last: directories and tiles stay where a COG has them, and a write that fails leaves the file
    as it was but for its length.

    Raises
    ------
    InputError
        If the file is no TIFF, or its metadata cannot be read.
    OSError
        If it cannot be written.
    """
    with path.open("r+b") as stream:

        def read(offset: int, length: int) -> bytes:
            stream.seek(offset)
            return stream.read(length)

        tags = TiffTags(read, os.fstat(stream.fileno()).st_size)
        first = tags.directory(tags.first)
        old = tags.text(first, _GDAL_METADATA)
        if not old:
            return False
        data = _with_items(old, items, family, path).encode() + b"\0"
        tags.put(first, {_GDAL_METADATA: Tag(kind=ASCII, count=len(data), data=data)})
        stream.seek(0, os.SEEK_END)
        stream.write(tags.tail)
        stream.flush()
        os.fsync(stream.fileno())
        for at, patch in tags.patches.items():
            stream.seek(at)
            stream.write(patch)
    return True


def _with_items(old: str, items: Mapping[str, str], family: str, path: Path) -> str:
    from xml.etree import ElementTree as ET

    try:
        root = ET.fromstring(old)
    except ET.ParseError as error:
        raise InputError(f"holds damaged GDAL metadata ({error})", source=str(path)) from error
    for item in root.findall("Item"):
        own = not (item.get("domain") or item.get("sample"))
        if own and _goes(item.get("name", ""), items, family):
            root.remove(item)
    for name, value in items.items():
        # GDAL escapes values twice in this tag
        ET.SubElement(root, "Item", name=name).text = _escaped(_clean(value))
    return ET.tostring(root, encoding="unicode") + "\n"


def _goes(name: str, items: Mapping[str, str], family: str) -> bool:
    return name in items or bool(family and name.startswith(family))


def _clean(value: str) -> str:
    """Text without the characters that XML cannot hold."""
    return "".join(c for c in value if c in "\t\n" or (c >= " " and c not in "\ufffe\uffff"))


def _escaped(value: str) -> str:
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        value = value.replace(character, entity)
    return value
