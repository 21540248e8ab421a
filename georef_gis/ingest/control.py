"""Control and check points and their pixels in the photos: the door to every format.

What is wrong with one line becomes one line of `Control.doubts`, and the rest goes on; only a
file of which nothing can be used raises.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS, Datum, HeightKind
from georef_gis.ingest.control_metashape import read_markers_xml
from georef_gis.ingest.control_odm import gcp_rows, is_gcp_list, read_gcp_rows
from georef_gis.ingest.control_tables import PointTable, marks_of, point_of, point_table
from georef_gis.ingest.tables import (
    Lines,
    height_of,
    height_unit,
    parse_table_crs,
    read_lines,
)
from georef_gis.model.control import Control, ControlPoint, Mark
from georef_gis.model.table_header import stated_height
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

ControlFormat = Literal["auto", "georef", "odm", "pix4d", "metashape", "dronedeploy"]
PixelZero = Literal["auto", "centre", "corner"]
HEIGHT_UNITS = {"m": 1.0, "ft": INTERNATIONAL_FOOT, "us-ft": US_SURVEY_FOOT}
_HEIGHT_KINDS = tuple(kind.value for kind in HeightKind)
# m; the same point written twice with as many decimals
_SAME_PLACE = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlOptions:
    """What the user says of a file of points; "auto" and None leave it to the file.

    Parameters
    ----------
    crs, geoid
        Where the file names none.
    datum, height_kind, height_unit
        Instead of what the file says. Kind "none" leaves all heights out.
    sigma_h, sigma_v, sigma_px
        Instead of what the file says, m and px.
    """

    format: ControlFormat = "auto"
    crs: str | None = None
    datum: str = "auto"
    height_kind: str = "auto"
    height_unit: str = "auto"
    geoid: str | None = None
    pixel_zero: PixelZero = "auto"
    sigma_h: float | None = None
    sigma_v: float | None = None
    sigma_px: float | None = None


def read_control(path: Path, options: ControlOptions | None = None) -> Control:
    """Points of a file, and its marks if the format has them.

    Heights come out in m where their unit is stated (`Control.height_unit`); easting and northing
    stay in the unit of the CRS.

    Raises
    ------
    InputError
        If nothing of the file can be used, naming file, line, column, value and cure.
    """
    options = options or ControlOptions()
    if options.format not in get_args(ControlFormat):
        known = ", ".join(get_args(ControlFormat))
        raise InputError(
            f"'{options.format}' is not known; use one of {known}", field="[control] format"
        )
    if _is_xml(path):
        return _finish(_from_xml(path, options), path, options)
    lines = read_lines(path)
    odm = is_gcp_list(lines) if options.format == "auto" else options.format == "odm"
    read = _from_gcp_list if odm else _from_table
    return _finish(read(lines, options), path, options)


def read_marks(path: Path, control: Control, options: ControlOptions | None = None) -> Control:
    """Control with the marks of a file of their own besides those it has.

    Raises
    ------
    InputError
        If nothing of the file can be used.
    """
    options = options or ControlOptions()
    if _is_xml(path):
        corner = options.pixel_zero != "centre"
        _, _, marks, doubts = read_markers_xml(path, corner=corner)
    else:
        lines = read_lines(path)
        if is_gcp_list(lines):
            _, marks, doubts = read_gcp_rows(gcp_rows(lines)[1])
            marks = _shifted(marks, options)
        else:
            corner_or_not = {"auto": None, "centre": False, "corner": True}[options.pixel_zero]
            names = [point.name for point in control.points]
            marks, doubts = marks_of(lines, names, corner_or_not)
    marks, others = _known_names(marks, control.points)
    if options.sigma_px is not None:
        marks = [replace(mark, sigma_px=options.sigma_px) for mark in marks]
    return replace(control, marks=(*control.marks, *marks)).saying(*doubts, *others)


def _is_xml(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(200).lstrip(b"\xef\xbb\xbf \r\n\t").startswith(b"<")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error


# -- formats -----------------------------------------------------------------------------------


def _from_xml(path: Path, options: ControlOptions) -> Control:
    crs, points, marks, doubts = read_markers_xml(path, corner=options.pixel_zero != "centre")
    used = _crs(crs, options, str(path))
    return Control(
        crs=used, datum=Datum(), height_kind=HeightKind.UNKNOWN, geoid="", points=tuple(points),
        marks=tuple(marks), doubts=tuple(doubts), height_unit=None, format="metashape",
    )  # fmt: skip


def _from_gcp_list(lines: Lines, options: ControlOptions) -> Control:
    text, rows = gcp_rows(lines)
    used = _crs(text, options, f"{lines.path}, line 1")
    points, marks, doubts = read_gcp_rows(rows)
    return Control(
        crs=used, datum=Datum(), height_kind=HeightKind.UNKNOWN, geoid="", points=tuple(points),
        marks=tuple(_shifted(marks, options)), doubts=tuple(doubts), height_unit=None,
        format="odm",
    )  # fmt: skip


def _shifted(marks: Iterable[Mark], options: ControlOptions) -> list[Mark]:
    shift = 0.5 if options.pixel_zero == "corner" else 0.0
    return [replace(mark, u=mark.u - shift, v=mark.v - shift) for mark in marks]


def _from_table(lines: Lines, options: ControlOptions) -> Control:
    text = lines.header.get("crs") or lines.header.get("coordinatesystem") or ""
    stated = _crs(text, options, str(lines.path)) if text or options.crs else None
    table = point_table(lines, stated)
    format = options.format if options.format != "auto" else _format_of(lines, table)
    used = _table_crs(table, stated, lines)
    points, doubts = [], []
    for row in table.rows:
        try:
            points.append(point_of(row, used, format))
        except InputError as error:
            doubts.append(f"{error}; left out")
    if not points:
        raise InputError(doubts[0].removesuffix("; left out"))
    kind, geoid = _stated_kind(lines)
    unit = table.height_unit
    if "unit" in lines.header or "height_unit" in lines.header:
        unit = height_unit(lines, used)
    control = Control(
        crs=used, datum=Datum.parse(lines.header.get("datum", "unknown")), height_kind=kind,
        geoid=geoid, points=tuple(points), doubts=tuple(doubts), height_unit=unit,
        order_open=not table.headed, format=format,
    )  # fmt: skip
    return _one_of_each(control)


def _format_of(lines: Lines, table: PointTable) -> ControlFormat:
    if not table.headed:
        return "pix4d"
    text = " ".join(line.lower() for _, line in lines.lines[:10])
    if "gcp label" in text:
        return "dronedeploy"
    return "metashape" if re.search(r"#\s*label|x/(easting|longitude)", text) else "georef"


def _table_crs(table: PointTable, stated: CRS | None, lines: Lines) -> CRS:
    if table.degrees and (stated is None or stated.is_projected):
        return parse_table_crs("EPSG:4326", str(lines.path))
    if stated is None and not table.headed and _look_like_degrees(table):
        return parse_table_crs("EPSG:4326", str(lines.path))
    if stated is None:
        raise InputError(
            "no CRS; write '# crs: EPSG:code' above the columns, or [control] crs in project.toml",
            source=str(lines.path),
            field="crs",
        )
    return stated


def _look_like_degrees(table: PointTable) -> bool:
    try:
        pairs = [(row.number("easting"), row.number("northing")) for row in table.rows]
    except InputError:
        return False
    return all(a is not None and b is not None and abs(a) <= 180 and abs(b) <= 180
               for a, b in pairs)  # fmt: skip


def _crs(text: str, options: ControlOptions, source: str) -> CRS:
    text = re.sub(r"(?i)^epsg[:\s]+", "EPSG:", text.strip()) or options.crs or ""
    if not text:
        raise InputError(
            "no CRS; write it in the first line, such as EPSG:32722, or [control] crs in "
            "project.toml",
            source=source,
            field="crs",
        )
    return parse_table_crs(text, source)


# -- heights, datum and names ------------------------------------------------------------------


def _stated_kind(lines: Lines) -> tuple[HeightKind, str]:
    """Kind of the heights and their geoid ('' = not stated) by the header."""
    kind, geoid = stated_height(dict(lines.header))
    if kind not in _HEIGHT_KINDS:
        raise InputError(
            f"'{kind}' is no kind of height; use one of {', '.join(_HEIGHT_KINDS)}",
            source=str(lines.path),
            field="height",
        )
    return HeightKind(kind), geoid


def _finish(control: Control, path: Path, options: ControlOptions) -> Control:
    """Control with the user's words put in, heights in m, and names of marks that exist."""
    points, doubts = _without_zeros(control.points, path)
    # A vertical part of the CRS tells kind, geoid and unit of the heights.
    of_crs = height_of(1.0, control.crs)
    unit, kind, geoid = control.height_unit, control.height_kind, control.geoid
    if of_crs is not None and (control.crs.is_compound or of_crs.kind is HeightKind.ELLIPSOIDAL):
        unit = of_crs.value
        if of_crs.kind is not HeightKind.UNKNOWN:
            kind, geoid = of_crs.kind, geoid or of_crs.geoid
    if options.height_unit != "auto":
        unit = HEIGHT_UNITS[options.height_unit]
    if options.height_kind in _HEIGHT_KINDS:
        kind = HeightKind(options.height_kind)
    keep = options.height_kind != "none"
    unknown = kind is HeightKind.UNKNOWN and control.crs.is_compound
    if unknown and keep and any(point.height is not None for point in points):
        raise InputError(
            f"heights of '{control.crs.sub_crs_list[-1].name}' are of no geoid that is known: "
            'convert them, e.g. to NAVD88, say [control] height_kind = "orthometric" and geoid, '
            'or leave them out by height_kind = "none"',
            source=str(path), field="crs",
        )  # fmt: skip
    points = [
        replace(
            point,
            height=None if point.height is None or not keep else point.height * (unit or 1.0),
            sigma_h=options.sigma_h or point.sigma_h,
            sigma_v=options.sigma_v or point.sigma_v,
        )
        for point in points
    ]
    marks, strangers = _known_names(control.marks, points)
    if options.sigma_px is not None:
        marks = [replace(mark, sigma_px=options.sigma_px) for mark in marks]
    return replace(
        control, points=tuple(points), marks=tuple(marks), height_unit=unit, height_kind=kind,
        geoid=geoid or options.geoid or "egm96",
        datum=control.datum if options.datum == "auto" else Datum.parse(options.datum),
    ).saying(*doubts, *strangers)  # fmt: skip


def _without_zeros(
    points: Sequence[ControlPoint], path: Path
) -> tuple[list[ControlPoint], list[str]]:
    """Heights of exactly 0 among others stand for unknown ones (WebODM's docs advise that)."""
    zero = [point.name for point in points if point.height == 0.0]
    if not zero or not any(point.height and abs(point.height) > 1.0 for point in points):
        return list(points), []
    some = ", ".join(zero[:5]) + (" ..." if len(zero) > 5 else "")
    return [replace(p, height=None) if p.height == 0.0 else p for p in points], [
        f"{path}: height: point {some} has height 0 while others have not; used without height "
        "(leave it empty if it is unknown)"
    ]


def _one_of_each(control: Control) -> Control:
    """Points of one name: one if they agree; else the name is ambiguous and off."""
    metres = control.crs.axis_info[0].unit_conversion_factor if control.crs.is_projected else 111e3
    out: dict[str, ControlPoint] = {}
    doubts = []
    for point in control.points:
        first = out.setdefault(point.name, point)
        if first is point:
            continue
        away = metres * max(
            abs(first.easting - point.easting), abs(first.northing - point.northing)
        )
        both = first.height is not None and point.height is not None
        rise = abs((first.height or 0.0) - (point.height or 0.0)) * both
        rise *= control.height_unit or 1.0
        if max(away, rise) <= _SAME_PLACE:
            continue
        doubts.append(
            f"{point.source}: name: point '{point.name}' stands in "
            f"{first.source.rpartition(', ')[2]} too, {max(away, rise):.3g} m away; neither is "
            "used: rename or remove one"
        )
        out[point.name] = replace(first, role="off")
    return replace(control, points=tuple(out.values())).saying(*doubts)


def _known_names(
    marks: Iterable[Mark], points: Iterable[ControlPoint]
) -> tuple[list[Mark], list[str]]:
    """Marks under the points' own names, whatever their case; marks of no point are told."""
    names = {point.name: point.name for point in points}
    folded: dict[str, list[str]] = {}
    for name in names:
        folded.setdefault(" ".join(name.lower().split()), []).append(name)
    kept, strangers = [], dict[str, list[Mark]]()
    for mark in marks:
        like = folded.get(" ".join(mark.name.lower().split()), [])
        own = names.get(mark.name) or (like[0] if len(like) == 1 else None)
        if own is None:
            strangers.setdefault(mark.name, []).append(mark)
        else:
            kept.append(mark if own == mark.name else replace(mark, name=own))
    return kept, [
        f"{some[0].source}: name: point '{name}' is not among the control points; its "
        f"{'mark is' if len(some) == 1 else f'{len(some)} marks are'} left out: correct the name "
        "or add the point"
        for name, some in strangers.items()
    ]
