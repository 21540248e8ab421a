"""Markers that Metashape exports as XML: places, and pixels in the cameras' photos.

`enabled` markers are control, others check points (Metashape manual, "Reference pane"). Only
pinned locations were clicked by somebody; the others are the program's own predictions.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from georef_gis.errors import InputError
from georef_gis.ingest.control_tables import CORNER
from georef_gis.model.control import SIGMA_SURVEYED, ControlPoint, Mark

_YES = {"1", "true", "yes"}


def read_markers_xml(
    path: Path, *, corner: bool = True
) -> tuple[str, list[ControlPoint], list[Mark], list[str]]:
    """CRS as text ('' if none), points, marks and what was wrong.

    Pixels count from the outer corner of the first pixel, as COLMAP's do.

    Raises
    ------
    InputError
        If it is not such a file.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise InputError(f"cannot be read as XML: {error}", source=str(path)) from error
    if root.find(".//markers") is None:
        raise InputError(
            "has no markers; export them with File > Export > Export Markers", source=str(path)
        )
    crs = next(
        (e.text.strip() for e in root.iter("reference") if e.text and e.text.strip()), ""
    )  # fmt: skip
    points, labels, doubts = _points(root, path)
    marks, others = _marks(root, path, labels, CORNER if corner else 0.0)
    return crs, points, marks, doubts + others


def _points(root: Any, path: Path) -> tuple[list[ControlPoint], dict[str, str], list[str]]:
    points, labels, doubts = [], {}, []
    for marker in root.iter("marker"):
        label = marker.get("label")
        if label is None:
            continue
        labels[marker.get("id") or marker.get("marker_id") or label] = label
        reference = marker.find("reference")
        if reference is None or reference.get("x") is None or reference.get("y") is None:
            # A manual tie point: a mark without a surveyed place.
            continue
        where = f"{path}, marker {label}"
        try:
            points.append(_point(label, reference, where))
        except InputError as error:
            doubts.append(f"{error}; left out")
    return points, labels, doubts


def _point(label: str, reference: Any, where: str) -> ControlPoint:
    x, y, z = (_number(reference, key, where) for key in "xyz")
    if x is None or y is None:
        raise InputError("x or y is missing", source=where, field="reference")
    s = [_number(reference, key, where) for key in ("sx", "sy", "sz")]
    both = _number(reference, "sxyz", where)
    horizontal = [value for value in s[:2] if value] or [both or SIGMA_SURVEYED]
    enabled = (reference.get("enabled") or "true").lower() in _YES
    return ControlPoint(
        name=label,
        easting=x,
        northing=y,
        height=z,
        sigma_h=max(horizontal),
        sigma_v=s[2] or both or SIGMA_SURVEYED,
        role="control" if enabled else "check",
        source=where,
    )


def _marks(
    root: Any, path: Path, labels: dict[str, str], shift: float
) -> tuple[list[Mark], list[str]]:
    photos = {
        camera.get("id") or camera.get("camera_id") or "": camera.get("label") or ""
        for camera in root.iter("camera")
    }
    marks, doubts, predicted = [], [], 0
    for marker in root.iter("marker"):
        label = labels.get(marker.get("marker_id") or "")
        if label is None or marker.get("label") is not None:
            continue
        for location in (*marker.findall("location"), *marker.findall("projection")):
            where = f"{path}, marker {label}"
            if (location.get("pinned") or "false").lower() not in _YES:
                predicted += 1
                continue
            photo = photos.get(location.get("camera_id") or "", "")
            u, v = _number(location, "x", where), _number(location, "y", where)
            if not photo or u is None or v is None:
                doubts.append(f"{where}: location: camera or pixel is missing; left out")
                continue
            marks.append(Mark(name=label, photo=photo, u=u - shift, v=v - shift, source=where))
    if predicted and not marks:
        doubts.append(
            f"{path}: location: none of {predicted} pixels is pinned: they are predictions, not "
            "marks; pin those that were checked"
        )
    return marks, doubts


def _number(element: Any, key: str, where: str) -> float | None:
    text = element.get(key)
    if text is None or not text.strip() or text.lower() == "nan":
        return None
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"'{text[:40]}' is not a number", source=where, field=key) from error
