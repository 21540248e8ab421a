"""Tables in text files: header, separator, line numbers, and numbers that say where they fail."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from georef_gis import geodesy
from georef_gis.errors import CrsError, InputError
from georef_gis.geodesy import CRS, Height, HeightKind, parse_crs, vertical_part
from georef_gis.model.table_header import header_values
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

_UTM = re.compile(r"^WGS\s*84\s*/?\s*UTM\s*(?:zone)?\s*(\d{1,2})\s*([NS])$", re.IGNORECASE)
# bytes; more is not a table of photos or points
_LARGEST = 200_000_000
# m by the name of the unit; a plain "foot" could be either
_UNITS = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0,
    "us survey foot": US_SURVEY_FOOT, "us survey feet": US_SURVEY_FOOT, "ftus": US_SURVEY_FOOT,
    "international foot": INTERNATIONAL_FOOT, "international feet": INTERNATIONAL_FOOT,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Cells of one line, by column where the table has a header."""

    path: Path
    line: int
    cells: tuple[str, ...]
    columns: Mapping[str, int] = field(default_factory=dict)

    @property
    def source(self) -> str:
        """File and line for a message."""
        return f"{self.path}, line {self.line}"

    def text(self, column: str | int) -> str:
        """Cell of a column, '' if there is none."""
        at = column if isinstance(column, int) else self.columns.get(column, -1)
        return self.cells[at].strip() if 0 <= at < len(self.cells) else ""

    def number(self, column: str | int, name: str = "") -> float | None:
        """Number in a cell; None if the cell is empty or 'nan'.

        Raises
        ------
        InputError
            If the cell is not a number, naming file, line and column.
        """
        value = self.text(column)
        if value.lower() in {"", "nan", "none", "null", "-"}:
            return None
        try:
            out = float(value)
        except ValueError as error:
            raise InputError(
                f"'{value[:40]}' is not a number; write decimals with a point",
                source=self.source,
                field=name or str(column),
            ) from error
        if not math.isfinite(out):
            raise InputError(
                f"'{value}' is not a finite number", source=self.source, field=name or str(column)
            )
        return out

    def required(self, column: str | int, name: str = "") -> float:
        """Like `number`, refusing an empty cell."""
        value = self.number(column, name)
        if value is None:
            raise InputError(
                "the value is missing; give a number or remove the line",
                source=self.source,
                field=name or str(column),
            )
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines:
    """Lines of a text file that hold something, with their numbers."""

    path: Path
    lines: tuple[tuple[int, str], ...]
    # values of "# key: value" lines, keys in lower case
    header: Mapping[str, str]

    @property
    def data(self) -> tuple[tuple[int, str], ...]:
        """Lines that are no comments."""
        return tuple((n, line) for n, line in self.lines if not line.startswith("#"))


def read_lines(path: Path) -> Lines:
    """Non-empty lines of a text file.

    Raises
    ------
    InputError
        If the file cannot be read, is no text or holds nothing.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError("is too large for a table", source=str(path))
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"is not a text file in UTF-8 (byte {error.start}); save it as CSV, UTF-8",
            source=str(path),
        ) from error
    lines = tuple((n, line.strip()) for n, line in enumerate(text.splitlines(), 1) if line.strip())
    if not lines:
        raise InputError("is empty", source=str(path))
    return Lines(path=path, lines=lines, header=header_values(line for _, line in lines))


def separator_of(line: str) -> str:
    """Separator of a line: comma, semicolon, tab, else blanks ('')."""
    return next((s for s in (";", ",", "\t") if s in line), "")


def split(line: str, separator: str) -> tuple[str, ...]:
    """Cells of a line."""
    if not separator:
        return tuple(line.split())
    return tuple(cell.strip() for cell in next(csv.reader([line], delimiter=separator)))


def parse_table_crs(text: str, source: str) -> CRS:
    """CRS of a table: EPSG code, WKT, PROJ text or ODM's 'WGS84 UTM 16N'.

    Raises
    ------
    InputError
        If it is not known.
    """
    utm = _UTM.match(text.strip())
    if utm:
        return parse_crs(f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}")
    try:
        return parse_crs(text)
    except InputError as error:
        raise InputError(str(error), source=source) from error


def height_of(value: float | None, crs: CRS) -> Height | None:
    """Height of a table's z by its CRS: kind, geoid and unit of the vertical part."""
    if value is None:
        return None
    if crs.is_compound:
        axis = crs.sub_crs_list[-1].axis_info[0].unit_conversion_factor or 1.0
        try:
            part = vertical_part(crs)
        except CrsError:
            part = None
        if part is None:
            return Height(value=value * axis, kind=HeightKind.UNKNOWN)
        return Height(value=value * axis, kind=HeightKind.ORTHOMETRIC, geoid=part.geoid)
    if len(crs.axis_info) == 3:
        axis = crs.axis_info[2].unit_conversion_factor or 1.0
        return Height(value=value * axis, kind=HeightKind.ELLIPSOIDAL)
    return Height(value=value, kind=HeightKind.UNKNOWN)


def height_unit(lines: Lines, crs: CRS) -> float:
    """Length of the unit of the heights, m, where the CRS has no vertical part.

    By a header line `# height_unit: ft`, or one such as `# unit: US survey foot (easting, northing,
    height)`; metres otherwise.

    Raises
    ------
    InputError
        If the unit is not known, or one of easting and northing too and a foot of unstated kind.
    """
    value = lines.header.get("height_unit", "")
    alone = bool(value)
    if not alone:
        value, _, columns = lines.header.get("unit", "").partition("(")
        if columns and "height" not in columns.partition(")")[0]:
            value = ""
    has_vertical = crs.is_compound or len(crs.axis_info) == 3
    name = " ".join(value.lower().replace("_", " ").split())
    if not name or has_vertical:
        return 1.0
    # Which foot matters to an easting, and not to a height.
    unit = geodesy.height_unit(name) if alone else _UNITS.get(name)
    if unit is None:
        raise InputError(
            f"'{value.strip()}' is not known; write metre, US survey foot or international foot",
            source=str(lines.path),
            field="unit",
        )
    return unit
