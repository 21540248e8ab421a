"""ODM's gcp_list.txt: CRS, then `geo_x geo_y geo_z im_x im_y image [gcp_name] [extras]`.

Facts: OpenDroneMap docs, "Ground Control Points"; WebODM's opendm/gcp.py for `CHK-`, %20 and
points told apart by their coordinates.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

from georef_gis.errors import InputError
from georef_gis.ingest.tables import Lines, Row, separator_of, split
from georef_gis.model.control import ControlPoint, Mark

_NAMES = ("geo_x", "geo_y", "geo_z", "im_x", "im_y")


def is_gcp_list(lines: Lines) -> bool:
    """Whether the rows behind the first are those of a gcp_list.txt."""
    for i, (_, line) in enumerate(lines.lines[:20]):
        if line.startswith("#"):
            continue
        cells = split(line, separator_of(line) if i else "")
        places = _all_numbers(cells[:2]) and _all_numbers(cells[3:5])
        if len(cells) >= 6 and places and not _all_numbers(cells[5:6]):
            return True
        if len(cells) >= 5 and _all_numbers(cells[:4]) and not _all_numbers(cells[4:5]):
            return True
    return False


def gcp_rows(lines: Lines) -> tuple[str, tuple[Row, ...]]:
    """Text of the CRS ('' if the first line is a point) and the rows.

    Raises
    ------
    InputError
        If there are no rows.
    """
    first = lines.lines[0][1]
    # PROJ texts hold blanks, WKT commas: the first line is not split before it is known.
    has_crs = not _all_numbers(split(first, separator_of(first))[:2])
    rows = [
        Row(path=lines.path, line=n, cells=split(line, separator_of(line)))
        for n, line in lines.lines[int(has_crs) :]
        if not line.startswith("#")
    ]
    if not rows:
        raise InputError("has no points", source=str(lines.path))
    return (first.lstrip("# ") if has_crs else ""), tuple(rows)


def read_gcp_rows(rows: tuple[Row, ...]) -> tuple[list[ControlPoint], list[Mark], list[str]]:
    """Points, marks and what was wrong; heights as written.

    Pixels need no shift: `(im_x + 0.5 - w / 2) / max(w, h)` of opendm/gcp.py puts (0, 0) at the
    centre of the first pixel.
    """
    doubts: list[str] = []
    parsed: list[tuple[ControlPoint, Mark]] = []
    for row in rows:
        try:
            parsed.append(_gcp(row))
        except InputError as error:
            doubts.append(f"{error}; left out")
    doubts += _without_z(rows)
    parsed = _named(parsed)
    points, other = _one_place_each(parsed)
    doubts += other
    marks, turned = _upright([mark for _, mark in parsed])
    return points, marks, doubts + turned + _same_place(points)


def _gcp(row: Row) -> tuple[ControlPoint, Mark]:
    cells = row.cells
    short = len(cells) >= 5 and not _all_numbers(cells[4:5]) and _all_numbers(cells[:4])
    if short:
        # Four numbers and a name: the height was left out.
        row = replace(row, cells=(*cells[:2], "nan", *cells[2:]))
    if len(row.cells) < 6:
        raise InputError(
            f"has {len(row.cells)} columns; x y z u v photo are needed", source=row.source
        )
    x, y, u, v = (row.required(i, _NAMES[i]) for i in (0, 1, 3, 4))
    label = row.text(6)
    check = label.upper().startswith("CHK-")
    point = ControlPoint(
        name=label[4:] if check else label,
        easting=x,
        northing=y,
        height=row.number(2, "geo_z"),
        role="check" if check else "control",
        source=row.source,
    )
    mark = Mark(name=point.name, photo=unquote(row.text(5)), u=u, v=v, source=row.source)
    return point, mark


def _without_z(rows: tuple[Row, ...]) -> list[str]:
    short = [
        row for row in rows
        if len(row.cells) >= 5 and _all_numbers(row.cells[:4]) and not _all_numbers(row.cells[4:5])
    ]  # fmt: skip
    if not short:
        return []
    return [
        f"{short[0].source}: geo_z: {len(short)} lines have no height column; used without height "
        "(write nan for a height that is not known)"
    ]


def _named(parsed: list[tuple[ControlPoint, Mark]]) -> list[tuple[ControlPoint, Mark]]:
    """Names for points without one: that of the same coordinates, else GCP-1, GCP-2 and so on."""
    names = {(q.easting, q.northing, q.height): q.name for q, _ in reversed(parsed) if q.name}
    taken = set(names.values())
    out = []
    for point, mark in parsed:
        key = (point.easting, point.northing, point.height)
        if key not in names:
            number = 1
            while f"GCP-{number}" in taken:
                number += 1
            names[key] = f"GCP-{number}"
            taken.add(names[key])
        name = point.name or names[key]
        out.append((replace(point, name=name), replace(mark, name=name)))
    return out


def _one_place_each(
    parsed: list[tuple[ControlPoint, Mark]],
) -> tuple[list[ControlPoint], list[str]]:
    """Point of each name: the coordinates of most of its lines; at a draw it is off."""
    by_name: dict[str, list[ControlPoint]] = {}
    for point, _ in parsed:
        by_name.setdefault(point.name, []).append(point)
    out, doubts = [], []
    for name, same in by_name.items():
        count = Counter((q.easting, q.northing, q.height) for q in same)
        (best, most), *others = count.most_common()
        point = next(q for q in same if (q.easting, q.northing, q.height) == best)
        if others:
            odd = next(q for q in same if (q.easting, q.northing, q.height) != best)
            draw = others[0][1] == most
            doubts.append(
                f"{odd.source}: gcp_name: point '{name}' has other coordinates "
                f"({odd.easting:.12g} {odd.northing:.12g} {_text(odd.height)}) than in "
                f"{_line(point)} ({best[0]:.12g} {best[1]:.12g} {_text(best[2])}); "
                f"{'not used' if draw else f'those of {most} lines are used'}: correct it"
            )
            point = replace(point, role="off") if draw else point
        out.append(point)
    return out, doubts


def _same_place(points: list[ControlPoint]) -> list[str]:
    seen: dict[tuple[float, float], ControlPoint] = {}
    doubts = []
    for point in points:
        before = seen.setdefault((point.easting, point.northing), point)
        if before is not point:
            doubts.append(
                f"{point.source}: gcp_name: point '{point.name}' has the coordinates of "
                f"'{before.name}' ({_line(before)}); give both one name or correct one"
            )
    return doubts


def _upright(marks: list[Mark]) -> tuple[list[Mark], list[str]]:
    """Marks with v downwards; QGIS shows an image's rows as negative numbers."""
    if not marks or not all(mark.v <= 0.0 for mark in marks) or not any(m.v < -1 for m in marks):
        return marks, []
    return [replace(mark, v=-mark.v) for mark in marks], [
        f"{marks[0].source}: im_y: all {len(marks)} rows are negative ({marks[0].v:g} px), as QGIS "
        "shows them; their sign is turned: write them downwards from the top"
    ]


def _all_numbers(cells: tuple[str, ...]) -> bool:
    try:
        return bool(cells) and bool([float(cell) for cell in cells])
    except ValueError:
        return False


def _text(height: float | None) -> str:
    return "nan" if height is None else f"{height:g}"


def _line(point: ControlPoint) -> str:
    return point.source.rpartition(", ")[2] or Path(point.source).name
