"""One line per photo: name, place, height and angles, as ground stations export geotags.

Read by the names of the columns where there is a header: `#name latitude/Y longitude/X height/Z
yaw pitch roll SAlt` of Mission Planner's location.txt, `image_id lon lat alt yaw roll pitch`, and
the like. No public definition of senseFly's own file was found: without a header the order name,
latitude, longitude, altitude, heading, pitch, roll is assumed, and the log says so.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.column_names import understand
from georef_gis.ingest.logs.csv_log import logs_of_table, refuse_absent
from georef_gis.ingest.logs.text_table import (
    Layout,
    TextTable,
    decode_head,
    find_layout,
    read_table,
    split_line,
)
from georef_gis.model.logs import FlightLogs

_PHOTO = re.compile(
    r"\.(jpe?g|tiff?|png|dng|raw|arw|cr[23w]|nef|nrw|rw2|orf|raf|pef)$", re.IGNORECASE
)
# Columns of files without a header by their number.
_ORDER = ("photo", "lat", "lon", "height", "yaw", "pitch", "roll", "sigma_h", "sigma_down")
_SHORT = ("photo", "lat", "lon", "height", "sigma_h", "sigma_down")
_ANGLES = ("roll", "pitch", "yaw")
# "latitude/Y", "X/Longitude": the axis beside the name
_AXIS = re.compile(r"^[xyz]\s*/\s*|\s*/\s*[xyz]$", re.IGNORECASE)


def looks_like_geoinfo(head: bytes, path: Path) -> bool:
    """Whether the rows of a text begin with names of photos, with a place behind them."""
    del path
    text = decode_head(head)
    layout = find_layout(*text) if text else None
    if text is None or layout is None:
        return False
    lines = [x for x in re.split(r"\r\n|\n|\r", text[0])[layout.first :] if x.strip()][:3]
    rows = [split_line(line, layout.delimiter) for line in lines]
    return bool(rows) and all(len(r) >= 4 and any(_PHOTO.search(c) for c in r[:3]) for r in rows)


def read_geoinfo(path: Path, columns: ColumnMap | None = None) -> FlightLogs:
    """Exposures with names of photos, places and angles; times where the file has them.

    Parameters
    ----------
    path
        File.
    columns
        Mapping for columns of other names or order.

    Raises
    ------
    InputError
        As `read_csv_log`.
    """
    own = (columns or ColumnMap()).for_file(path)
    table = read_table(path, delimiter=own.delimiter, decimal=own.decimal)
    table = _named(table, own)
    text = logs_of_table(_in_degrees(table, own), own)
    refuse_absent(text.absent, path)
    logs = text.logs
    if not logs.events:
        raise InputError("holds no column of photo names", source=str(path), field="photo")
    doubts = logs.doubts
    if not np.isfinite(logs.events[0].time).any():
        doubts = (*doubts, "the file states no times: its rows go to photos by name only")
    return replace(logs, format="geoinfo (one line per photo)", doubts=doubts)


def _named(table: TextTable, columns: ColumnMap) -> TextTable:
    """Table with the names of its columns: cleaned, or assumed where the file has no header."""
    layout = table.layout
    if layout.has_header:
        headers = tuple(_AXIS.sub("", h.strip()) for h in layout.headers)
        return replace(table, layout=replace(layout, headers=headers))
    count = len(layout.headers)
    order = _SHORT if count == len(_SHORT) else _ORDER
    if columns.columns or count > len(order):
        return table
    names = order[:count]
    table.doubts.append(
        f"the file has no header: its {count} columns are taken as {', '.join(names)}; map them if "
        "they are others, such as --map 'lat = #3:deg'"
    )
    return replace(table, layout=_with_names(layout, names))


def _with_names(layout: Layout, names: tuple[str, ...]) -> Layout:
    units = {"lat": "deg", "lon": "deg", "height": "m"}
    return replace(layout, headers=names, units=tuple(units.get(n, "") for n in names))


def _in_degrees(table: TextTable, columns: ColumnMap) -> TextTable:
    """Table with degrees as the unit of angles that state none, as all known exports have."""
    layout = table.layout
    units = list(layout.units)
    open_ones = []
    for i, header in enumerate(layout.headers):
        heading = understand(header, units[i]) if header else None
        angle = heading is not None and heading.target in (*_ANGLES, "heading")
        if angle and heading is not None and heading.unit is None and not columns.columns:
            units[i] = "deg"
            open_ones.append(header)
    if open_ones:
        table.doubts.append(f"{', '.join(open_ones)} state no unit; taken in degrees")
    return replace(table, layout=replace(layout, units=tuple(units)))
