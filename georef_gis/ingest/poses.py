"""Positions and angles of photos from text files instead of tags."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import CRS, Height, HeightKind, MapFrame, Origin, horizontal_crs
from georef_gis.ingest.poses_blocks import Placing, block_format, read_block_poses
from georef_gis.ingest.poses_columns import COLUMNS, METASHAPE, ODM, PIX4D, PIX4D_ACCURACIES
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
from georef_gis.model.photo import AttitudeTag, Geotag
from georef_gis.units import wrap_angle

PoseFormat = Literal["auto", "odm", "metashape", "pix4d", "orthority", "opensfm", "colmap"]
FORMATS: tuple[PoseFormat, ...] = (
    "auto", "odm", "metashape", "pix4d", "orthority", "opensfm", "colmap",
)  # fmt: skip
PoseOfFile = tuple[Geotag, AttitudeTag | None]

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
    placing: Placing | None = None,
) -> dict[str, PoseOfFile]:
    """Positions and, where given, angles by photo name as the file writes it.

    Parameters
    ----------
    path
        ODM geo.txt, or reference CSV of Metashape, Pix4D or orthority; OpenSfM's
        reconstruction.json; images.txt or the folder of a COLMAP text model.
    format
        Its format; "auto" tells by the first lines.
    crs
        CRS where the file names none; otherwise WGS 84.
    angle_unit
        Unit of the angles.
    near : (lat, lon), rad
        Where the photos are by their own tags: finds swapped coordinates and wrong units.
    placing
        Puts a block of OpenSfM or COLMAP that lies nowhere on the Earth, by the photos' tags.

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
    block = block_format(path, format)
    if block is not None:
        found = read_block_poses(
            path, block, placing=placing, read_positions=lambda file: _positions(file, near)
        )
        return dict(found)
    lines = read_lines(path)
    table = _table(lines, format)
    used = parse_table_crs(table.crs_text or crs or "EPSG:4326", f"{path}, crs")
    unit = height_unit(lines, used)
    unit_of_sigmas = _accuracy_unit(lines, used)
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
            height=_height(row.number("z", "z"), used, lines, unit),
            sigma_h=_sigma(row, "acc_h", unit_of_sigmas),
            sigma_v=_sigma(row, "acc_v", unit_of_sigmas),
            source=path.name,
        )
        out[name] = geotag, _attitude(row, angle_unit)
    return out


def _positions(path: Path, near: tuple[float, float] | None) -> dict[str, Geotag]:
    """Positions of ODM's geo.txt by name."""
    return {name: tag for name, (tag, _) in read_poses(path, format="odm", near=near).items()}


def _accuracy_unit(lines: Lines, crs: CRS) -> float:
    """Length of the unit of accuracies, m, by a line such as `# accuracy_unit: US survey foot`."""
    value = lines.header.get("accuracy_unit", "")
    return height_unit(replace(lines, header={"height_unit": value}), crs)


def _height(value: float | None, crs: CRS, lines: Lines, unit: float) -> Height | None:
    """Height by the vertical part of the CRS, else by what a line such as `# heights: ...` says."""
    height = height_of(value, crs)
    if height is None or height.kind is not HeightKind.UNKNOWN:
        return height
    words = lines.header.get("heights", "").lower()
    kind = HeightKind.UNKNOWN
    if words.startswith("ellipsoidal"):
        kind = HeightKind.ELLIPSOIDAL
    elif words.startswith("orthometric (egm96)"):
        kind = HeightKind.ORTHOMETRIC
    return replace(height, value=height.value * unit, kind=kind)


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
        rows = _rows(lines.path, lines.lines[1:], ODM, "")
        return _Table(rows=rows, crs_text=first.lstrip("# "), format="odm")
    crs_text = lines.header.get("coordinatesystem") or lines.header.get("crs") or _own_crs(lines)
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
    names = PIX4D_ACCURACIES if columns == 6 else PIX4D
    if format == "metashape":
        names = METASHAPE
    kind = "pix4d" if format == "auto" else format
    return _Table(rows=_rows(lines.path, data, names, separator), crs_text=crs_text, format=kind)


def _own_crs(lines: Lines) -> str | None:
    """CRS in the first line of our own poses.csv: `# CRS EPSG:6549 (name); x east ...`."""
    found = re.match(r"#\s*CRS\s+([A-Z]+:\d+)\b", lines.lines[0][1])
    return found[1] if found else None


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
    return COLUMNS.get(key, heading.lower())


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
            order = north_first and (table.format == "pix4d" or "first" in row.columns)
            x, y = _xy(row, north_first=order)
            geo = frame.geo_from_map([x, y, 0.0])
            if order and near is not None and not _is_close(geo, near):
                # PIX4Dmatic follows the axes of the CRS, PIX4Dmapper writes x, y in any.
                other = frame.geo_from_map([y, x, 0.0])
                geo = other if _is_close(other, near) else geo
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


def _is_close(geo: Array, near: tuple[float, float]) -> bool:
    place = float(geo[0]), float(geo[1])
    return all(math.isfinite(v) for v in place) and _close(place, near)


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
        sigmas = _angle_sigmas(row, scale, ("acc_omega", "acc_phi", "acc_kappa"))
        return AttitudeTag(
            dialect="opk", roll=a, pitch=b, yaw=wrap_angle(c),
            sigma_roll_pitch=sigmas[0], sigma_yaw=sigmas[1],
        )  # fmt: skip
    if b is None or c is None:
        return None
    yaw = None if a is None else wrap_angle(a)
    sigmas = _angle_sigmas(row, scale, ("acc_roll", "acc_pitch", "acc_yaw"))
    return AttitudeTag(
        dialect="ypr", roll=c, pitch=b, yaw=yaw, sigma_roll_pitch=sigmas[0], sigma_yaw=sigmas[1]
    )


def _angle_sigmas(
    row: Row, scale: float, columns: tuple[str, str, str]
) -> tuple[float | None, float | None]:
    """Sigma of the first two angles, root mean square, and of the third, rad; None = not told."""
    a, b, c = (_sigma(row, column) for column in columns)
    tilt = None if a is None or b is None else math.sqrt((a * a + b * b) / 2.0) * scale
    return tilt, None if c is None else c * scale


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


def _sigma(row: Row, column: str, unit: float = 1.0) -> float | None:
    """One standard deviation in a column, times the length of its unit; None = not told."""
    value = row.number(column, column) if column in row.columns else None
    if value is not None and value < 0.0:
        raise InputError(
            f"{value:g} {'m' if column in ('acc_h', 'acc_v') else 'deg'} is negative; give one "
            "standard deviation",
            source=row.source,
            field=column,
        )
    return value * unit if value else None
