"""Metadata files beside products: which are ours, which are of the product as it is now."""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from georef_gis.errors import ExportError

ISO, FGDC, QMD = ".xml", ".fgdc.xml", ".qmd"
State = Literal["none", "ours", "broken", "edited", "foreign", "folder", "too long"]
# Bytes that a file's name may have on most disks
_LONGEST_NAME = 255
_MARK = re.compile(rb"<!-- georef_gis metadata 1 of ([0-9a-f]{64}); text ([0-9a-f]{64}) -->\n")
# Bytes at the end of a file in which its mark stands
_TAIL = 256


def metadata_path(product: Path, ending: str = ISO) -> Path:
    """File beside a product, which GIS find by its name."""
    return product.with_name(product.name + ending)


def state_of(path: Path) -> State:
    """What lies where metadata are to be written.

    ``edited`` is ours as another program left it; ``broken`` is no XML, such as a file that was
    half written.
    """
    if len(os.fsencode(path.name)) > _LONGEST_NAME:
        return "too long"
    if path.is_dir():
        return "folder"
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return "none"
    except OSError as error:
        raise _refusal(path, error) from error
    mark = _MARK.search(data[-_TAIL:])
    if mark is not None and data.endswith(mark[0]):
        body = data[: -len(mark[0])]
        return "ours" if hashlib.sha256(body).hexdigest().encode() == mark[2] else "edited"
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError:
        return "broken"
    known = root.tag.endswith("}MD_Metadata") or root.tag == "qgis"
    return "edited" if known and b"georef_gis" in data else "foreign"


def checksum_in(path: Path) -> str:
    """Checksum of the product that a file of ours is of; empty if it is none of ours."""
    try:
        with path.open("rb") as stream:
            stream.seek(max(0, os.fstat(stream.fileno()).st_size - _TAIL))
            mark = _MARK.search(stream.read())
    except OSError:
        return ""
    return mark[1].decode() if mark else ""


def write_metadata(path: Path, text: str, checksum: str) -> None:
    """Write a file whole or not at all, with the mark by which it is known again.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    body = text.encode("utf-8", "replace")
    mark = f"<!-- georef_gis metadata 1 of {checksum}; text {hashlib.sha256(body).hexdigest()} -->"
    # shorter than any name that it is for
    part = path.with_name(f".xml{os.getpid()}.part")
    try:
        part.write_bytes(body + mark.encode() + b"\n")
        os.replace(part, path)
    except OSError as error:
        raise _refusal(path, error) from error
    finally:
        with suppress(OSError):
            part.unlink()


def remove_orphans(folder: Path, kept: set[Path]) -> list[Path]:
    """Remove files of ours in a folder whose product is gone; gives what was removed."""
    gone = []
    if not folder.is_dir():
        return []
    for path in sorted(path for ending in (ISO, QMD) for path in folder.glob(f"*{ending}")):
        # a .qmd has not its product's whole name: `kept` tells of which there is one
        name = path.name.removesuffix(FGDC) if path.name.endswith(FGDC) else path.stem
        if path in kept or path.with_name(name).exists() or state_of(path) != "ours":
            continue
        try:
            path.unlink()
        except OSError as error:
            raise _refusal(path, error) from error
        gone.append(path)
    return gone


def _refusal(path: Path, error: OSError) -> ExportError:
    return ExportError(
        f"{path}: cannot be written ({error.strerror or error}); check free space and permission"
    )
