"""Tables of control points and of marks, with and without a header, of several programs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS
from georef_gis.ingest.tables import Lines, Row, separator_of, split
from georef_gis.model.control import (
    SIGMA_CLICKED,
    SIGMA_SURVEYED,
    ControlPoint,
    Mark,
    Role,
)
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# Heading without units and signs -> what it holds. Metashape: "X/Easting", "Enable"; DroneDeploy:
# "GCP Label,Northing,Easting,Elevation (ft)" (its help, "GCP CSV File Formatting").
POINT_COLUMNS = {
    **dict.fromkeys(("name", "label", "gcplabel", "gcpname", "gcp", "point", "pointname", "pointid",
                     "marker", "id"), "name"),
    **dict.fromkeys(("easting", "x", "xeasting", "east", "e", "mapx", "geox"), "easting"),
    **dict.fromkeys(("longitude", "lon", "long", "lng", "xlongitude", "ylongitude"), "longitude"),
    **dict.fromkeys(("northing", "y", "ynorthing", "north", "n", "mapy", "geoy"), "northing"),
    **dict.fromkeys(("latitude", "lat", "ylatitude", "xlatitude"), "latitude"),
    **dict.fromkeys(("height", "z", "elevation", "elev", "altitude", "alt", "zaltitude", "h",
                     "zheight", "geoz"), "height"),
    **dict.fromkeys(("sigmahm", "sigmah", "accuracyhorz", "horizontalaccuracy", "acch", "hacc",
                     "accuracyxy", "hprec"), "sigma_h"),
    **dict.fromkeys(("sigmavm", "sigmav", "accuracyvert", "verticalaccuracy", "accv", "vacc",
                     "accuracyz", "vprec"), "sigma_v"),
    **dict.fromkeys(("accuracyxyz", "accuracy", "sxyz"), "accuracy"),
    **dict.fromkeys(("role", "type"), "role"),
    **dict.fromkeys(("enable", "enabled"), "enabled"),
}  # fmt: skip
MARK_COLUMNS = {
    **dict.fromkeys(("name", "label", "point", "pointname", "gcp", "gcpname", "gcplabel", "marker",
                     "markername", "markerlabel"), "name"),
    **dict.fromkeys(("photo", "image", "imagename", "filename", "file", "camera", "cameraname",
                     "cameralabel", "photoname", "img"), "photo"),
    **dict.fromkeys(("u", "imageu"), "u"), **dict.fromkeys(("v", "imagev"), "v"),
    **dict.fromkeys(("x", "px", "pixelx", "imx", "xpx", "projectionx"), "corner_u"),
    **dict.fromkeys(("y", "py", "pixely", "imy", "ypx", "projectiony"), "corner_v"),
    **dict.fromkeys(("sigmapx", "sigma"), "sigma_px"), "sharedpx": "shared_px", "ground": "ground",
}  # fmt: skip
_ROLE_WORDS: dict[str, Role] = {
    **dict.fromkeys(("control", "gcp", "3d gcp", "2d gcp", "ground control point"), "control"),
    **dict.fromkeys(("check", "checkpoint", "check point", "cp", "chk"), "check"),
    **dict.fromkeys(("off", "disabled", "unused", "mtp", "manual tie point"), "off"),
}
_YES_NO = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
_IMAGE = re.compile(r"\.(jpe?g|tiff?|png|dng|arw|cr2|nef)$", re.IGNORECASE)
# px; the first pixel's outer corner counted from its centre
CORNER = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PointTable:
    """Rows of points and what their header says.

    Parameters
    ----------
    degrees
        The columns are called latitude and longitude.
    height_unit
        Of the heights by the header's words, m.
    headed
        Whether there is a header; otherwise the order of the coordinates is open.
    """

    rows: tuple[Row, ...]
    degrees: bool
    height_unit: float | None
    headed: bool


def columns_of(line: str, known: Mapping[str, str], separator: str) -> dict[str, int]:
    """Position of each column that a header names; the first of a kind counts."""
    out: dict[str, int] = {}
    for i, cell in enumerate(split(line.lstrip("# "), separator)):
        key = re.sub(r"[(\[].*?[)\]]|[^a-z0-9]", "", cell.lower())
        if key in known:
            out.setdefault(known[key], i)
    return out


def point_table(lines: Lines, crs: CRS | None) -> PointTable:
    """Rows of a table of points.

    Raises
    ------
    InputError
        If there are none, or columns are missing.
    """
    found = _header(lines)
    if found is None:
        return _headerless(lines)
    at, separator, columns, heading = found
    degrees = "easting" not in columns and "northing" not in columns
    east, north = ("longitude", "latitude") if degrees else ("easting", "northing")
    missing = [name for name in ("name", east, north) if name not in columns]
    if missing:
        raise InputError(
            f"column {', '.join(missing)} is missing; the columns are name, easting, northing, "
            "height, sigma_h_m, sigma_v_m, role",
            source=f"{lines.path}, line {lines.lines[at][0]}",
        )
    columns |= {"easting": columns[east], "northing": columns[north]}
    rows = _rows(lines, at + 1, separator, columns)
    return PointTable(
        rows=rows, degrees=degrees, height_unit=_unit_of(heading, columns, separator, crs),
        headed=True,
    )  # fmt: skip


def _header(lines: Lines) -> tuple[int, str, dict[str, int], str] | None:
    """Index of the header line, its separator, columns and text; after '#Markers' if there is."""
    start = next(
        (i + 1 for i, (_, line) in enumerate(lines.lines) if re.match(r"(?i)#\s*markers\b", line)),
        0,
    )
    for i, (_, line) in enumerate(lines.lines[start:], start):
        separator = separator_of(line)
        columns = columns_of(line, POINT_COLUMNS, separator)
        cells = split(line.lstrip("# "), separator)
        told = {"easting", "northing", "longitude", "latitude"} & set(columns)
        if ("name" in columns or told) and len(columns) >= 2 and not _numbers(cells[1:3]):
            return i, separator, columns, line
        if not line.startswith("#"):
            # Words where numbers belong: a header that names none of the columns.
            if len(cells) > 2 and not _numbers(cells[1:2]):
                return i, separator, columns, line
            return None
    return None


def _headerless(lines: Lines) -> PointTable:
    """Rows `label x y [z [acc_h acc_v]]`: Pix4D (its help 360038397752), DroneMapper."""
    data = lines.data
    if not data:
        raise InputError("has no points", source=str(lines.path))
    columns = {"name": 0, "easting": 1, "northing": 2, "height": 3, "sigma_h": 4, "sigma_v": 5}
    first = next(i for i, (_, line) in enumerate(lines.lines) if not line.startswith("#"))
    rows = _rows(lines, first, separator_of(data[0][1]), columns)
    return PointTable(rows=rows, degrees=False, height_unit=None, headed=False)


def _rows(lines: Lines, at: int, separator: str, columns: Mapping[str, int]) -> tuple[Row, ...]:
    rows = []
    for n, line in lines.lines[at:]:
        if re.match(r"(?i)#\s*cameras\b", line):
            break
        if not line.startswith("#"):
            row = Row(path=lines.path, line=n, cells=split(line, separator), columns=columns)
            rows.append(row)
    if not rows:
        raise InputError("has no points", source=str(lines.path))
    return tuple(rows)


def _unit_of(
    heading: str, columns: Mapping[str, int], separator: str, crs: CRS | None
) -> float | None:
    """Length of the heights' unit that their heading states in brackets, m."""
    if "height" not in columns:
        return None
    cell = split(heading.lstrip("# "), separator)[columns["height"]].lower()
    found = re.search(r"[(\[]\s*([a-z .\-]+?)\s*[)\]]", cell)
    word = found[1].replace("-", " ") if found else ""
    if word in ("m", "metre", "metres", "meter", "meters"):
        return 1.0
    if word in ("us survey feet", "us survey foot", "us ft", "usft", "ftus"):
        return US_SURVEY_FOOT
    if word in ("ft", "feet", "foot"):
        # Which foot is told by the CRS; the two differ by 2 ppm, 0.6 mm in 300 m.
        axis = crs.axis_info[0].unit_conversion_factor if crs and crs.is_projected else None
        return axis if axis and axis < 0.5 else US_SURVEY_FOOT
    if word in ("international feet", "international foot"):
        return INTERNATIONAL_FOOT
    return None


def _numbers(cells: Iterable[str]) -> bool:
    listed = list(cells)
    try:
        return bool(listed) and all(math.isfinite(float(cell)) for cell in listed)
    except ValueError:
        return False


def point_of(row: Row, crs: CRS, format: str) -> ControlPoint:
    """Point of a row; its height as written.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    name = row.text("name")
    if not name:
        raise InputError("the point's name is missing", source=row.source, field="name")
    x, y = row.required("easting", "easting"), row.required("northing", "northing")
    sigma_h, sigma_v = _sigmas(row)
    flat = row.text("role").lower().startswith("2d")
    return ControlPoint(
        name=name,
        easting=x,
        northing=y,
        height=None if flat else row.number("height", "height"),
        sigma_h=sigma_h,
        sigma_v=sigma_v,
        role=_role(row, name, format),
        source=row.source,
    )


def _role(row: Row, name: str, format: str) -> Role:
    enabled = row.text("enabled").lower()
    if enabled in _YES_NO:
        # Metashape: markers that are not enabled serve as check points.
        return "control" if _YES_NO[enabled] else "check"
    if format == "dronedeploy" and name.lower().startswith("checkpoint"):
        return "check"
    word = row.text("role").lower() or "control"
    if word not in _ROLE_WORDS:
        raise InputError(
            f"'{word}' is not a role; use one of control, check, off",
            source=row.source,
            field="role",
        )
    return _ROLE_WORDS[word]


def _sigmas(row: Row) -> tuple[float, float]:
    """Horizontal and vertical sigma, m; Metashape writes one, or "xy/z", or "x/y/z"."""
    parts = [cell.strip() for cell in row.text("accuracy").split("/") if cell.strip()]
    try:
        both = [float(part) for part in parts]
    except ValueError:
        both = []
    h = row.number("sigma_h", "sigma_h_m")
    v = row.number("sigma_v", "sigma_v_m")
    if both and h is None:
        h = max(both[:-1]) if len(both) > 1 else both[0]
    if both and v is None:
        v = both[-1]
    return positive(row, "sigma_h_m", h, SIGMA_SURVEYED), positive(
        row, "sigma_v_m", v, SIGMA_SURVEYED
    )


def positive(row: Row, column: str, value: float | None, default: float) -> float:
    """A standard deviation, or the default.

    Raises
    ------
    InputError
        If it is not above 0.
    """
    if value is None:
        return default
    if value <= 0.0:
        raise InputError(
            f"{value:g} is no standard deviation; give a positive number",
            source=row.source,
            field=column,
        )
    return value


# -- marks -------------------------------------------------------------------------------------


def marks_of(
    lines: Lines, names: Sequence[str], corner: bool | None
) -> tuple[list[Mark], list[str]]:
    """Marks of a table, and what was wrong in it.

    Parameters
    ----------
    names
        Points that are known, which tell the column of names from that of photos.
    corner
        Whether (0, 0) is the outer corner of the first pixel; None = by the columns: u, v count
        from its centre, x, y and tables without a header from its corner (assumed: Pix4D does not
        say; Metashape's pixels count from the corner).

    Raises
    ------
    InputError
        If columns are missing.
    """
    data = lines.data
    if not data:
        raise InputError("has no marks", source=str(lines.path))
    separator = separator_of(data[0][1])
    columns = columns_of(data[0][1], MARK_COLUMNS, separator)
    if _numbers(split(data[0][1], separator)[2:4]):
        columns, rows = _mark_columns(data, separator, names), data
    else:
        rows = data[1:]
    by_corner = "corner_u" in columns and "u" not in columns
    if by_corner:
        columns |= {"u": columns["corner_u"], "v": columns.get("corner_v", -1)}
    missing = [name for name in ("name", "photo", "u", "v") if columns.get(name, -1) < 0]
    if missing:
        raise InputError(
            f"column {', '.join(missing)} is missing; the columns are name, photo, u, v, sigma_px",
            source=f"{lines.path}, line {data[0][0]}",
        )
    if not rows:
        raise InputError("has no marks", source=str(lines.path))
    shift = CORNER if (by_corner if corner is None else corner) else 0.0
    marks, doubts = [], []
    for n, line in rows:
        row = Row(path=lines.path, line=n, cells=split(line, separator), columns=columns)
        try:
            marks.append(_mark(row, shift))
        except InputError as error:
            doubts.append(f"{error}; left out")
    return marks, doubts


def _mark_columns(
    data: Sequence[tuple[int, str]], separator: str, names: Sequence[str]
) -> dict[str, int]:
    """Columns of a table without a header: image, label, px, py (Pix4D), or label first."""
    known = {name.lower() for name in names}
    first, second = (
        [split(line, separator)[i].lower() for _, line in data if len(split(line, separator)) > 3]
        for i in (0, 1)
    )
    points = [sum(cell in known for cell in column) for column in (first, second)]
    images = [sum(bool(_IMAGE.search(cell)) for cell in column) for column in (first, second)]
    label_first = points[0] > points[1] or (points[0] == points[1] and images[1] > images[0])
    name, photo = (0, 1) if label_first else (1, 0)
    return {"name": name, "photo": photo, "corner_u": 2, "corner_v": 3, "sigma_px": 4}


def _mark(row: Row, shift: float) -> Mark:
    name, photo = row.text("name"), row.text("photo")
    if not name or not photo:
        raise InputError("name or photo is missing", source=row.source)
    return Mark(
        name=name,
        photo=PurePath(photo.replace("\\", "/")).as_posix(),
        u=row.required("u", "u") - shift,
        v=row.required("v", "v") - shift,
        sigma_px=positive(row, "sigma_px", row.number("sigma_px"), SIGMA_CLICKED),
        shared_px=shared_of(row),
        on_ground=on_ground(row),
        source=row.source,
    )


def shared_of(row: Row) -> float:
    """What a mark has in common with others, px; 0 where column `shared_px` says nothing.

    Raises
    ------
    InputError
        If it is no number, or below 0.
    """
    shared = row.number("shared_px") or 0.0
    return positive(row, "shared_px", shared, 0.0) if shared else 0.0


def on_ground(row: Row) -> bool:
    """Whether column `ground` says that a spot lies on the ground: "on", "free" or nothing.

    Raises
    ------
    InputError
        If it says anything else.
    """
    word = row.text("ground").lower()
    if word not in ("on", "free", ""):
        raise InputError(
            f"'{word[:40]}' is neither on nor free: does the spot lie on the ground?",
            source=row.source, field="ground",
        )  # fmt: skip
    return word == "on"
