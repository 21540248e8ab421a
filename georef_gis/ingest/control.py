"""Control and check points and their pixels in the photos."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import unquote

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS, Datum, HeightKind
from georef_gis.ingest.tables import (
    Lines,
    Row,
    height_of,
    height_unit,
    parse_table_crs,
    read_lines,
    separator_of,
    split,
)

Role = Literal["control", "check", "off"]
ROLES: tuple[Role, ...] = ("control", "check", "off")
_HEIGHT_KINDS = tuple(kind.value for kind in HeightKind)
_CONTROL = ("name", "easting", "northing", "height", "sigma_h_m", "sigma_v_m", "role")
_MARKS = ("name", "photo", "u", "v", "sigma_px")
# m and px, one sigma where a file states none
_SIGMA_SURVEYED = 0.02
_SIGMA_CLICKED = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """A surveyed point in its file's CRS: x east, y north; sigmas in m. No height is None."""

    name: str
    easting: float
    northing: float
    height: float | None
    sigma_h: float = _SIGMA_SURVEYED
    sigma_v: float = _SIGMA_SURVEYED
    role: Role = "control"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Pixel of a point in a photo; (0, 0) is the centre of the first pixel."""

    name: str
    photo: str
    u: float
    v: float
    sigma_px: float = _SIGMA_CLICKED


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Points of one file with its CRS, datum and kind of height; heights in m."""

    crs: CRS
    datum: Datum
    height_kind: HeightKind
    geoid: str
    points: tuple[ControlPoint, ...]
    marks: tuple[Mark, ...] = ()
    doubts: tuple[str, ...] = ()


def read_control(path: Path, *, crs: str | None = None, datum: str = "auto") -> Control:
    """Points of a control.csv.

    The header states `# crs: EPSG:6601`, `# datum: NAD83(2011)@2010.0` and, where the CRS has no
    vertical part, `# height_kind: orthometric`, `# geoid: geoid18`, `# unit: US survey foot`.
    Heights come out in metres, easting and northing stay in the unit of the CRS.

    Parameters
    ----------
    path
        Columns name, easting, northing, height, sigma_h_m, sigma_v_m, role.
    crs
        CRS where the file states none.
    datum
        Datum instead of the one the file states; "auto" takes the file's.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    lines = read_lines(path)
    text = lines.header.get("crs") or crs
    if not text:
        raise InputError(
            "no CRS; write '# crs: EPSG:code' above the columns", source=str(path), field="crs"
        )
    used = parse_table_crs(text, str(path))
    rows = _rows(lines, _CONTROL, ("name", "easting", "northing"))
    unit = height_unit(lines, used)
    points = [_point(row, used, unit) for row in rows]
    _refuse_twice(((row, point.name) for row, point in zip(rows, points, strict=True)), "point")
    kind, geoid = _height_kind(lines, used)
    stated = lines.header.get("datum", "unknown") if datum == "auto" else datum
    return Control(
        crs=used,
        datum=Datum.parse(stated),
        height_kind=kind,
        geoid=geoid,
        points=tuple(points),
        doubts=tuple(_zero_heights(points, path)),
    )


def read_marks(path: Path, *, control: Control | None = None) -> tuple[Mark, ...]:
    """Pixels of a marks.csv: name, photo, u, v, sigma_px.

    Parameters
    ----------
    path
        The file.
    control
        Points that the names must belong to.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    rows = _rows(read_lines(path), _MARKS, ("name", "photo", "u", "v"))
    known = None if control is None else {point.name for point in control.points}
    marks = []
    for row in rows:
        name, photo = row.text("name"), row.text("photo")
        if not name or not photo:
            raise InputError("name or photo is missing", source=row.source)
        if known is not None and name not in known:
            raise InputError(
                f"point '{name}' is not among the control points; correct the name or add it",
                source=row.source,
                field="name",
            )
        sigma = row.number("sigma_px")
        marks.append(
            Mark(
                name=name,
                photo=photo,
                u=_pixel(row, "u"),
                v=_pixel(row, "v"),
                sigma_px=_positive(row, "sigma_px", sigma, _SIGMA_CLICKED),
            )
        )
    return tuple(marks)


def read_gcp_list(path: Path, *, crs: str | None = None) -> Control:
    """Points and marks of ODM's gcp_list.txt: CRS, then x y z u v photo [name].

    Pixels need no shift: OpenSfM counts from the centre of the first pixel too (its
    `normalized_image_coordinates`). Names that start with CHK- are check points.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    lines = read_lines(path)
    first = lines.lines[0][1]
    rows = _gcp_rows(lines)
    used = parse_table_crs(first if rows[0].line != lines.lines[0][0] else crs or "", str(path))
    points: dict[str, ControlPoint] = {}
    marks: dict[tuple[str, str], tuple[int, Mark]] = {}
    kept: list[Mark] = []
    doubts: list[str] = []
    for row in rows:
        point, mark = _gcp(row, used)
        before = points.setdefault(point.name, point)
        if (before.easting, before.northing, before.height) != (
            point.easting, point.northing, point.height
        ):  # fmt: skip
            raise InputError(
                f"point '{point.name}' has other coordinates than above; correct one of them",
                source=row.source,
                field="gcp_name",
            )
        key = (mark.name, mark.photo)
        if key in marks:
            line, other = marks[key]
            doubts.append(
                f"{path.name}, line {row.line}: point {mark.name} is marked in {mark.photo} twice, "
                f"at {other.u:g}, {other.v:g} px (line {line}) and {mark.u:g}, {mark.v:g} px; "
                "remove the wrong one"
            )
        marks.setdefault(key, (row.line, mark))
        kept.append(mark)
    kind, geoid = _height_kind(lines, used)
    return Control(
        crs=used,
        datum=Datum(),
        height_kind=kind,
        geoid=geoid,
        points=tuple(points.values()),
        marks=tuple(kept),
        doubts=(*doubts, *_zero_heights(points.values(), path)),
    )


def _gcp_rows(lines: Lines) -> tuple[Row, ...]:
    """Rows that start with five numbers; the line before them is the CRS."""
    out = []
    for i, (n, line) in enumerate(lines.lines):
        row = Row(path=lines.path, line=n, cells=split(line, separator_of(line) if i else ""))
        if i == 0 and not _starts_with_number(row):
            continue
        if line.startswith("#"):
            continue
        if len(row.cells) < 6:
            raise InputError(
                f"has {len(row.cells)} columns; x y z u v photo are needed", source=row.source
            )
        out.append(row)
    if not out:
        raise InputError("has no points", source=str(lines.path))
    return tuple(out)


def _starts_with_number(row: Row) -> bool:
    try:
        float(row.cells[0])
    except ValueError:
        return False
    return len(row.cells) >= 6


def _gcp(row: Row, crs: CRS) -> tuple[ControlPoint, Mark]:
    names = ("geo_x", "geo_y", "geo_z", "im_x", "im_y")
    x, y, u, v = (row.required(i, names[i]) for i in (0, 1, 3, 4))
    z = row.number(2, "geo_z")
    height = height_of(z, crs)
    label = row.text(6) or f"{x:.3f} {y:.3f}"
    check = label.upper().startswith("CHK-")
    name = label[4:] if check else label
    point = ControlPoint(
        name=name,
        easting=x,
        northing=y,
        height=None if height is None else height.value,
        role="check" if check else "control",
    )
    _check_place(row, x, y, crs)
    return point, Mark(name=name, photo=unquote(row.text(5)), u=u, v=v)


def _rows(lines: Lines, names: tuple[str, ...], needed: tuple[str, ...]) -> tuple[Row, ...]:
    data = lines.data
    if not data:
        raise InputError("has no columns and rows", source=str(lines.path))
    separator = separator_of(data[0][1]) or ","
    header = tuple(cell.lower() for cell in split(data[0][1], separator))
    missing = [name for name in needed if name not in header]
    if missing:
        raise InputError(
            f"column {', '.join(missing)} is missing; the columns are {', '.join(names)}",
            source=f"{lines.path}, line {data[0][0]}",
        )
    columns = {name: i for i, name in enumerate(header)}
    rows = tuple(
        Row(path=lines.path, line=n, cells=split(line, separator), columns=columns)
        for n, line in data[1:]
    )
    if not rows:
        raise InputError("has no rows", source=str(lines.path))
    return rows


def _point(row: Row, crs: CRS, unit: float) -> ControlPoint:
    name = row.text("name")
    if not name:
        raise InputError("the point's name is missing", source=row.source, field="name")
    role = row.text("role").lower() or "control"
    known: Role | None = next((r for r in ROLES if r == role), None)
    if known is None:
        raise InputError(
            f"'{role}' is not a role; use one of {', '.join(ROLES)}",
            source=row.source,
            field="role",
        )
    x, y = row.required("easting"), row.required("northing")
    _check_place(row, x, y, crs)
    height = height_of(row.number("height"), crs)
    return ControlPoint(
        name=name,
        easting=x,
        northing=y,
        height=None if height is None else height.value * unit,
        sigma_h=_positive(row, "sigma_h_m", row.number("sigma_h_m"), _SIGMA_SURVEYED),
        sigma_v=_positive(row, "sigma_v_m", row.number("sigma_v_m"), _SIGMA_SURVEYED),
        role=known,
    )


def _check_place(row: Row, x: float, y: float, crs: CRS) -> None:
    if crs.is_projected:
        return
    if abs(y) > 90.0 or abs(x) > 180.0:
        swapped = abs(x) <= 90.0 and abs(y) <= 180.0
        cure = "longitude comes first: exchange the columns" if swapped else "check the CRS"
        raise InputError(
            f"longitude {x:g}, latitude {y:g} is not on the Earth; {cure}",
            source=row.source,
            field="easting, northing",
        )


def _positive(row: Row, column: str, value: float | None, default: float) -> float:
    if value is None:
        return default
    if value <= 0.0:
        raise InputError(
            f"{value:g} is no standard deviation; give a positive number",
            source=row.source,
            field=column,
        )
    return value


def _pixel(row: Row, column: str) -> float:
    value = row.required(column)
    if not -0.5 <= value < 200_000.0:
        raise InputError(
            f"{value:g} px lies outside of any photo; (0, 0) is the centre of the first pixel",
            source=row.source,
            field=column,
        )
    return value


def _refuse_twice(names: Iterable[tuple[Row, str]], what: str) -> None:
    seen: dict[str, int] = {}
    for row, name in names:
        if name in seen:
            raise InputError(
                f"{what} '{name}' stands in line {seen[name]} too; keep one of the two",
                source=row.source,
                field="name",
            )
        seen[name] = row.line


def _height_kind(lines: Lines, crs: CRS) -> tuple[HeightKind, str]:
    """Kind of the heights and geoid: of the CRS's vertical part, else as the header states."""
    of_crs = height_of(0.0, crs)
    if of_crs is not None and of_crs.kind is not HeightKind.UNKNOWN:
        return of_crs.kind, of_crs.geoid
    words = lines.header.get("height", lines.header.get("height_kind", "unknown")).lower().split()
    if words[0] not in _HEIGHT_KINDS:
        raise InputError(
            f"'{words[0]}' is no kind of height; use one of {', '.join(_HEIGHT_KINDS)}",
            source=str(lines.path),
            field="height",
        )
    geoid = words[1] if len(words) > 1 else lines.header.get("geoid", "egm96").lower()
    return HeightKind(words[0]), geoid


def _zero_heights(points: Iterable[ControlPoint], path: Path) -> list[str]:
    """Doubt about heights of 0 beside others: a place-holder for an unknown height."""
    listed = list(points)
    zero = [p.name for p in listed if p.height == 0.0]
    if zero and any(p.height and abs(p.height) > 1.0 for p in listed):
        return [
            f"{path.name}: point {', '.join(zero[:5])} has height 0 while others have not; leave "
            "the height empty if it is unknown"
        ]
    return []
