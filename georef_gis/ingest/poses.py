"""Positions and angles of photos from text files instead of tags."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS, MapFrame, Origin, horizontal_crs
from georef_gis.ingest.tables import (
    Lines,
    Row,
    height_of,
    parse_table_crs,
    read_lines,
    separator_of,
    split,
)
from georef_gis.model.photo import AttitudeTag, Geotag
from georef_gis.units import wrap_angle

PoseFormat = Literal["auto", "odm", "metashape", "pix4d", "orthority"]
FORMATS: tuple[PoseFormat, ...] = ("auto", "odm", "metashape", "pix4d", "orthority")
PoseOfFile = tuple[Geotag, AttitudeTag | None]

# Headings of columns, letters and digits only -> meaning. "coordinate1" follows the CRS's axes.
_COLUMNS = {
    "label": "name", "name": "name", "imagename": "name", "image": "name", "filename": "name",
    "photo": "name", "file": "name", "photoname": "name",
    "x": "x", "xeast": "x", "xeasting": "x", "easting": "x", "east": "x",
    "y": "y", "ynorth": "y", "ynorthing": "y", "northing": "y", "north": "y",
    "xlongitude": "lon", "longitude": "lon", "lon": "lon", "long": "lon",
    "ylatitude": "lat", "latitude": "lat", "lat": "lat",
    "coordinate1": "first", "coordinate2": "second",
    "z": "z", "zaltitude": "z", "altitude": "z", "alt": "z", "height": "z", "elevation": "z",
    "yaw": "yaw", "heading": "yaw", "pitch": "pitch", "roll": "roll",
    "yawdeg": "yaw", "pitchdeg": "pitch", "rolldeg": "roll",
    "omega": "omega", "phi": "phi", "kappa": "kappa",
    "omegadeg": "omega", "phideg": "phi", "kappadeg": "kappa",
    "accuracyhorz": "acc_h", "acch": "acc_h", "hacc": "acc_h", "accuracyxym": "acc_h",
    "horizontalaccuracy": "acc_h", "accuracyh": "acc_h", "sigmahm": "acc_h",
    "accuracyvert": "acc_v", "accv": "acc_v", "vacc": "acc_v", "accuracyzm": "acc_v",
    "verticalaccuracy": "acc_v", "accuracyv": "acc_v", "sigmavm": "acc_v",
}  # fmt: skip
# Columns of files without a header, by format; 'first' and 'second' follow the CRS's axes.
_ODM = ("name", "x", "y", "z", "yaw", "pitch", "roll", "acc_h", "acc_v")
_METASHAPE = ("name", "x", "y", "z", "yaw", "pitch", "roll")
_PIX4D = ("name", "first", "second", "z", "yaw", "pitch", "roll", "acc_h", "acc_v")
_PIX4D_ACCURACIES = ("name", "first", "second", "z", "acc_h", "acc_v")
_GROUPS = (("yaw", "pitch", "roll"), ("omega", "phi", "kappa"))
# rows; fewer say nothing about their unit
_ENOUGH_ROWS = 4
# rad; about 100 km
_FAR = math.radians(1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Table:
    rows: tuple[Row, ...]
    crs_text: str | None
    format: PoseFormat


def read_poses(
    path: Path,
    *,
    format: PoseFormat = "auto",
    crs: str | None = None,
    angle_unit: Literal["degrees", "radians"] = "degrees",
    near: tuple[float, float] | None = None,
) -> dict[str, PoseOfFile]:
    """Positions and, where given, angles by photo name as the file writes it.

    Parameters
    ----------
    path
        ODM geo.txt, or reference CSV of Metashape, Pix4D or orthority.
    format
        Its format; "auto" tells by the first lines.
    crs
        CRS where the file names none; otherwise WGS 84.
    angle_unit
        Unit of the angles.
    near : (lat, lon), rad
        Where the photos are by their own tags: finds swapped coordinates and wrong units.

    Returns
    -------
    poses
        Angles in dialect `ypr` (zero at nadir) or `opk` (roll = omega, pitch = phi, yaw = kappa).

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    if format not in FORMATS:
        raise InputError(
            f"'{format}' is not known; use one of {', '.join(FORMATS)}", field="[poses] format"
        )
    table = _table(read_lines(path), format)
    used = parse_table_crs(table.crs_text or crs or "EPSG:4326", f"{path}, crs")
    _check_angle_unit(table.rows, angle_unit)
    to_geo = _geo_of(used, near, table)
    out: dict[str, PoseOfFile] = {}
    seen: dict[str, int] = {}
    for row in table.rows:
        name = row.text("name")
        if not name:
            raise InputError("the photo's name is missing", source=row.source, field="name")
        if name.lower() in seen:
            raise InputError(
                f"'{name}' stands in line {seen[name.lower()]} too; keep one of the two",
                source=row.source,
                field="name",
            )
        seen[name.lower()] = row.line
        lat, lon = to_geo(row)
        geotag = Geotag(
            lat=lat,
            lon=lon,
            height=height_of(row.number("z", "z"), used),
            sigma_h=_sigma(row, "acc_h"),
            sigma_v=_sigma(row, "acc_v"),
            source=path.name,
        )
        out[name] = geotag, _attitude(row, angle_unit)
    return out


def match_poses(
    poses: Mapping[str, PoseOfFile], names: Iterable[str]
) -> tuple[dict[str, PoseOfFile], tuple[str, ...]]:
    """Poses by photo name, and the names in the file that no photo has.

    Parameters
    ----------
    poses
        As `read_poses` gives them.
    names
        File names of the photos. Names match in either case, with or without folder and ending.

    Returns
    -------
    matched, left_over
    """
    by_name: dict[str, str] = {}
    for name in names:
        base = PurePosixPath(name.replace("\\", "/")).name.lower()
        by_name.setdefault(base, name)
        by_name.setdefault(_stem(base), name)
    matched: dict[str, PoseOfFile] = {}
    left: list[str] = []
    for written, pose in poses.items():
        base = PurePosixPath(written.replace("\\", "/")).name.lower()
        photo = by_name.get(base) or by_name.get(_stem(base))
        if photo is None:
            left.append(written)
        else:
            matched[photo] = pose
    return matched, tuple(left)


def _stem(name: str) -> str:
    return re.sub(r"\.(jpe?g|tiff?|png|dng)$", "", name)


def _table(lines: Lines, format: PoseFormat) -> _Table:
    """Rows with their columns, the CRS the file names, and its format."""
    first = lines.lines[0][1]
    if format == "odm" or (format == "auto" and _is_odm(first)):
        rows = _rows(lines.path, lines.lines[1:], _ODM, "")
        return _Table(rows=rows, crs_text=first.lstrip("# "), format="odm")
    crs_text = lines.header.get("coordinatesystem") or lines.header.get("crs")
    header = next((i for i, (_, line) in enumerate(lines.lines) if _is_header(line)), None)
    if header is not None:
        line = lines.lines[header][1]
        separator = separator_of(line)
        names = tuple(_role(cell) for cell in split(line.lstrip("# "), separator))
        data = tuple(x for x in lines.lines[header + 1 :] if not x[1].startswith("#"))
        kind: PoseFormat = "metashape" if line.lower().startswith("#label") else "orthority"
        kind = kind if format == "auto" else format
        return _Table(
            rows=_rows(lines.path, data, names, separator), crs_text=crs_text, format=kind
        )
    data = lines.data
    if not data:
        raise InputError("has no rows", source=str(lines.path))
    separator = separator_of(data[0][1])
    columns = len(split(data[0][1], separator))
    names = _PIX4D_ACCURACIES if columns == 6 else _PIX4D
    if format == "metashape":
        names = _METASHAPE
    kind = "pix4d" if format == "auto" else format
    return _Table(rows=_rows(lines.path, data, names, separator), crs_text=crs_text, format=kind)


def _is_odm(first: str) -> bool:
    if first.startswith("#") or "," in first.split("[")[0]:
        return False
    return bool(re.match(r"(?i)(epsg:\d+|\+proj=|wgs\s*84\b|(proj|geog|comp)\w*crs?\[)", first))


def _is_header(line: str) -> bool:
    cells = split(line.lstrip("# "), separator_of(line))
    roles = {_role(cell) for cell in cells}
    return "name" in roles and bool(roles & {"x", "lon", "lat", "first"})


def _role(heading: str) -> str:
    key = re.sub(r"\[[^\]]*\]|[^a-z0-9]", "", heading.lower())
    return _COLUMNS.get(key, heading.lower())


def _rows(
    path: Path, lines: Iterable[tuple[int, str]], names: tuple[str, ...], separator: str
) -> tuple[Row, ...]:
    columns: dict[str, int] = {}
    for i, name in enumerate(names):
        # The first column of a name counts: exports put estimated values behind the given ones.
        columns.setdefault(name, i)
    rows = tuple(
        Row(path=path, line=n, cells=split(line, separator), columns=columns)
        for n, line in lines
        if not line.startswith("#")
    )
    if not rows:
        raise InputError("has no rows", source=str(path))
    for row in rows:
        if len(row.cells) < 3:
            raise InputError(
                f"has {len(row.cells)} columns; a name and two coordinates are needed",
                source=row.source,
            )
    return rows


def _geo_of(
    crs: CRS, near: tuple[float, float] | None, table: _Table
) -> Callable[[Row], tuple[float, float]]:
    """Function from a row to latitude and longitude, rad."""
    plain = horizontal_crs(crs)
    if plain.is_projected:
        frame = MapFrame(Origin(lat=0.0, lon=0.0, height_ellipsoidal=0.0), plain)
        north_first = plain.axis_info[0].direction.lower() == "north"

        def from_map(row: Row) -> tuple[float, float]:
            x, y = _xy(row, north_first=north_first and table.format == "pix4d")
            geo = frame.geo_from_map([x, y, 0.0])
            if not all(math.isfinite(v) for v in geo):
                raise InputError(
                    f"{x:g}, {y:g} lies outside of '{plain.name}'; check the CRS and the order "
                    "of the columns",
                    source=row.source,
                    field="x, y",
                )
            return float(geo[0]), float(geo[1])

        return from_map

    def from_degrees(row: Row) -> tuple[float, float]:
        lon, lat = _xy(row, north_first=table.format == "pix4d" or "first" in row.columns)
        _check_degrees(row, lat, lon, near)
        return math.radians(lat), math.radians(lon)

    return from_degrees


def _xy(row: Row, *, north_first: bool) -> tuple[float, float]:
    """East or longitude, north or latitude, as written."""
    for east, north in (("x", "y"), ("lon", "lat")):
        if east in row.columns and north in row.columns:
            return row.required(east, east), row.required(north, north)
    first, second = row.required("first", "coordinate1"), row.required("second", "coordinate2")
    return (second, first) if north_first else (first, second)


def _check_degrees(row: Row, lat: float, lon: float, near: tuple[float, float] | None) -> None:
    """Refuse swapped or impossible coordinates and radians."""
    value = f"latitude {lat:g}, longitude {lon:g}"
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        if abs(lat) > 360.0 or abs(lon) > 360.0:
            cure = "these are no degrees; name the CRS of the file in [poses] crs"
        elif abs(lon) <= 90.0 and abs(lat) <= 180.0:
            cure = "latitude and longitude are swapped; exchange the two columns"
        else:
            cure = "check the columns"
        raise InputError(
            f"{value} is not on the Earth: {cure}", source=row.source, field="lat, lon"
        )
    if near is None or _close((math.radians(lat), math.radians(lon)), near):
        return
    if _close((math.radians(lon), math.radians(lat)), near):
        raise InputError(
            f"{value}: swapped, they lie where the photos are; exchange the two columns",
            source=row.source,
            field="lat, lon",
        )
    if _close((lat, lon), near):
        raise InputError(
            f"{value}: as radians they lie where the photos are; write degrees",
            source=row.source,
            field="lat, lon",
        )


def _close(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return abs(a[0] - b[0]) < _FAR and abs(wrap_angle(a[1] - b[1])) * math.cos(b[0]) < _FAR


def _angles(row: Row) -> tuple[str, tuple[float | None, ...]] | None:
    for names in _GROUPS:
        if all(name in row.columns for name in names):
            return ("ypr" if names[0] == "yaw" else "opk"), tuple(row.number(n, n) for n in names)
    return None


def _attitude(row: Row, unit: str) -> AttitudeTag | None:
    found = _angles(row)
    if found is None or found[1][1] is None or found[1][2] is None:
        return None
    dialect, values = found
    scale = 1.0 if unit == "radians" else math.pi / 180.0
    a, b, c = (None if v is None else v * scale for v in values)
    if dialect == "opk":
        if a is None or b is None or c is None:
            return None
        return AttitudeTag(dialect="opk", roll=a, pitch=b, yaw=wrap_angle(c))
    if b is None or c is None:
        return None
    yaw = None if a is None else wrap_angle(a)
    return AttitudeTag(dialect="ypr", roll=c, pitch=b, yaw=yaw)


def _check_angle_unit(rows: tuple[Row, ...], unit: str) -> None:
    """Refuse degrees given for radians and the other way round."""
    largest, cells, fractions = 0.0, 0, 0
    for row in rows:
        found = _angles(row)
        for value in found[1] if found else ():
            if value is None:
                continue
            limit = 2.0 * math.pi + 0.01 if unit == "radians" else 360.01
            if abs(value) > limit:
                what = "radians; they look like degrees" if unit == "radians" else "degrees"
                raise InputError(
                    f"{value:g} is no angle in {what}; check the columns and the unit",
                    source=row.source,
                    field="angles",
                )
            largest, cells = max(largest, abs(value)), cells + 1
            fractions += value != round(value)
    if unit == "degrees" and cells >= 3 * _ENOUGH_ROWS and 1.0 < largest <= 2.0 * math.pi:
        if fractions > cells // 2:
            raise InputError(
                f"no angle of {len(rows)} photos is larger than {largest:.3f}: these are radians; "
                "write degrees or say that the unit is radians",
                source=str(rows[0].path),
                field="angles",
            )


def _sigma(row: Row, column: str) -> float | None:
    value = row.number(column, column) if column in row.columns else None
    if value is not None and value < 0.0:
        raise InputError(
            f"{value:g} m is negative; give one standard deviation",
            source=row.source,
            field=column,
        )
    return value or None
