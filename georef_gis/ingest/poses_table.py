"""Rows of a table of poses: which program wrote it, what its columns hold, which CRS it names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from georef_gis.errors import InputError
from georef_gis.ingest.poses_columns import COLUMNS, METASHAPE, ODM, PIX4D, PIX4D_ACCURACIES
from georef_gis.ingest.tables import Lines, Row, separator_of, split

PoseFormat = Literal["auto", "odm", "metashape", "pix4d", "orthority", "opensfm", "colmap"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseTable:
    """Rows with their columns, the CRS that the file names, and its format."""

    rows: tuple[Row, ...]
    crs_text: str | None
    format: PoseFormat


def pose_table(lines: Lines, format: PoseFormat) -> PoseTable:
    """Table in a file's lines; format "auto" tells by the first of them."""
    first = lines.lines[0][1]
    if format == "odm" or (format == "auto" and _is_odm(first)):
        rows = _rows(lines.path, lines.lines[1:], ODM, "")
        return PoseTable(rows=rows, crs_text=first.lstrip("# "), format="odm")
    crs_text = lines.header.get("coordinatesystem") or lines.header.get("crs") or _own_crs(lines)
    header = next((i for i, (_, line) in enumerate(lines.lines) if _is_header(line)), None)
    if header is not None:
        line = lines.lines[header][1]
        separator = separator_of(line)
        names = tuple(_role(cell) for cell in split(line.lstrip("# "), separator))
        data = tuple(x for x in lines.lines[header + 1 :] if not x[1].startswith("#"))
        kind: PoseFormat = "metashape" if line.lower().startswith("#label") else "orthority"
        kind = kind if format == "auto" else format
        return PoseTable(
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
    return PoseTable(rows=_rows(lines.path, data, names, separator), crs_text=crs_text, format=kind)


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
