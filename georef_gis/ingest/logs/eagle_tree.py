"""Text files of the Eagle Tree recorders (.FDR), parsed by the names of their columns.

The first lines hold the model's name, its set-up and, in later software, the sessions; then a line
of column names that begins with `Milliseconds IsEvent`, then the records, separated by blanks
(Eagle Tree eLogger V4 manual, p. 13). Which GPS and servo columns there are varies. Decimal
fractions are written as whole numbers, with the factor in the name: `PackVolt*100`.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.column_map import ColumnMap, ColumnSpec
from georef_gis.ingest.logs.column_names import TARGETS, base_name
from georef_gis.ingest.logs.column_resolve import resolve
from georef_gis.ingest.logs.column_units import Unit, unit_of
from georef_gis.ingest.logs.csv_gnss import fix_rows, gnss_of
from georef_gis.ingest.logs.quantities import Quantities
from georef_gis.ingest.logs.text_table import Layout, TextTable, decode_head, read_bytes, table_of
from georef_gis.ingest.logs.unit_telling import tell_speed_unit
from georef_gis.model.logs import FIX_NONE, AidKind, AidLog, FlightLogs, GnssLog, unknown

# Quantity -> columns of the recorder, letters and digits only.
_COLUMNS = {
    "boot_time": ("milliseconds",),
    "lat": ("gpslat", "gpslatitude"),
    "lon": ("gpslon", "gpslong", "gpslongitude"),
    "height": ("gpsalt", "gpsaltitude"),
    "ground_speed": ("gpsspeed", "gpsspd"),
    "course": ("gpscourse",),
    "satellites": ("numsats", "gpsnumsats", "gpssats"),
    "baro_height": ("altitude",),
    "airspeed": ("airspeed",),
}
# Codes of event records (manual, p. 13).
_CODES = {9: "restart", 18: "GPS packet", 27: "Spektrum packet"}
# The recorder shows heights in feet where it shows speeds in miles per hour, else in metres.
_HEIGHT_UNIT = {"mph": "ft", "ft/s": "ft", "km/h": "m", "m/s": "m"}
_FACTOR = re.compile(r"\*(\d+)$")


def looks_like_eagle_tree(head: bytes, path: Path) -> bool:
    """Whether the head of a file holds the recorder's line of column names."""
    del path
    text = decode_head(head)
    return text is not None and _header_at(text[0].splitlines()) is not None


def _header_at(lines: list[str]) -> int | None:
    for i, line in enumerate(lines):
        words = line.split()
        if len(words) > 2 and words[0].lower() == "milliseconds" and words[1].lower() == "isevent":
            return i
    return None


def read_eagle_tree(path: Path, columns: ColumnMap | None = None) -> FlightLogs:
    """GNSS, barometric height and airspeed of a recorder, in s since power-up.

    Parameters
    ----------
    path
        File.
    columns
        Mapping for columns of other names, and for units: the file states none. Speeds are told
        by the distance between fixes, heights follow them.

    Raises
    ------
    InputError
        If the file is no such record, or a unit cannot be told.
    """
    table = _records(path)
    own = (columns or ColumnMap()).for_file(path)
    headers = table.layout.headers
    auto = {
        target: ColumnSpec(column=f"#{at + 1}", unit=_own_unit(target))
        for target, names in _COLUMNS.items()
        if target not in own.columns
        for at in _found(headers, names)
    }
    own = replace(own, columns={**auto, **own.columns})
    # Only what is listed or mapped counts: other columns of the recorder are channels.
    blank = [h if any(s.column == h for s in own.columns.values()) else "" for h in headers]
    resolved = resolve(blank, table.layout.units, own, table.source)
    if resolved.absent:
        target, column = next(iter(resolved.absent.items()))
        raise InputError(
            f"no column '{column}'; columns are {', '.join(headers)}",
            source=table.source,
            field=target,
        )
    q = Quantities(table, resolved)
    for target, found in list(q.columns.items()):
        q.columns[target] = replace(found, header=headers[found.index])
    return _logs(q)


def _own_unit(target: str) -> Unit | None:
    return (
        unit_of("ms", "time")
        if target == "boot_time"
        else (unit_of("deg", "angle") if TARGETS[target] == "angle" else None)
    )


def _found(headers: tuple[str, ...], names: tuple[str, ...]) -> list[int]:
    """First column of some names, as a list of none or one."""
    plain = [re.sub(r"[^a-z0-9]", "", base_name(h).lower()) for h in headers]
    return [plain.index(n) for n in names if n in plain][:1]


def read_channels(path: Path) -> dict[str, Array]:
    """All columns of numbers by their names, and `time`, s since power-up.

    Parameters
    ----------
    path
        File. Records of events are left out, factors in names (`ServoCurrent*100`) are undone.

    Returns
    -------
    channels
        Each of shape (n,); servo and PWM columns in the recorder's own unit.

    Raises
    ------
    InputError
        If the file is no such record.
    """
    table = _records(path)
    out: dict[str, Array] = {}
    for i, header in enumerate(table.layout.headers):
        if table.frame.iloc[:, i].dtype.kind in "fiub" and header:
            found = _FACTOR.search(header)
            name = header[: found.start()] if found else header
            out[name] = table.numbers(i) / (float(found[1]) if found else 1.0)
    out["time"] = table.numbers(0) * 1e-3
    return out


def _records(path: Path) -> TextTable:
    """Records that are no events, of the longest run since a power-up."""
    raw = read_bytes(path)
    text = decode_head(raw[:65536])
    lines = re.split(r"\r\n|\n|\r", text[0]) if text else []
    at = _header_at(lines)
    if text is None or at is None:
        raise InputError(
            "is no text file of an Eagle Tree recorder: no line begins with 'Milliseconds "
            "IsEvent'; save it by File, Save Recorder File",
            source=str(path),
        )
    headers = tuple(lines[at].split())
    layout = Layout(
        encoding=text[1],
        delimiter=" ",
        decimal=".",
        first=at + 1,
        headers=headers,
        units=("",) * len(headers),
    )
    if at + 1 >= len(lines) or not raw.split(lines[at].encode(text[1]), 1)[-1].strip():
        raise InputError("holds no record", source=str(path))
    table = table_of(raw, layout, path)
    return _longest_run(_without_events(table))


def _without_events(table: TextTable) -> TextTable:
    event = table.numbers(1)
    rows = event == 1.0
    if not rows.any():
        return table
    codes = table.numbers(2)[rows]
    counts = Counter(int(c) for c in codes[np.isfinite(codes)])
    named = ", ".join(f"{_CODES.get(c, f'code {c}')} {n}x" for c, n in sorted(counts.items()))
    table.doubts.append(f"{int(rows.sum())} event records passed ({named})")
    return _with_rows(table, ~rows)


def _longest_run(table: TextTable) -> TextTable:
    """Records between two power-ups: the clock begins anew at each."""
    time = table.numbers(0)
    starts = np.flatnonzero(np.diff(time) < -1000.0) + 1
    if not len(table.frame):
        raise InputError("holds no record but events", source=table.source)
    if not len(starts):
        return table
    edges = [0, *starts.tolist(), len(time)]
    runs = sorted(pairwise(edges), key=lambda run: run[0] - run[1])
    first, last = runs[0]
    table.doubts.append(
        f"the recorder was started {len(runs)} times: records {first + 1} to {last} of "
        f"{len(time)} are read, the longest run; save the sessions one by one for the others"
    )
    keep = np.zeros(len(time), dtype=bool)
    keep[first:last] = True
    return _with_rows(table, keep)


def _with_rows(table: TextTable, rows: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> TextTable:
    frame = table.frame[rows].reset_index(drop=True)
    return replace(table, frame=frame, rows=len(frame))


def _logs(q: Quantities) -> FlightLogs:
    time = q.si("boot_time")
    speed = _tell_units(q, time)
    gnss = _gnss(q, time) if q.has("lat", "lon") else None
    kinds: tuple[AidKind, ...] = ("baro_height", "airspeed")
    aids = tuple(
        AidLog(
            time=time,
            scale="boot",
            source=q.table.source,
            kind=kind,
            value=q.si(kind),
            sigma=unknown(len(time)),
        )
        for kind in kinds
        if q.has(kind) and q.columns[kind].unit is not None
    )
    if q.has("airspeed") and q.columns["airspeed"].unit is None:
        q.table.doubts.append("airspeed and height are not read: the file states no units")
    del speed
    return FlightLogs(
        gnss=gnss,
        aids=aids,
        source=q.table.source,
        format="Eagle Tree recorder (.FDR)",
        doubts=tuple(dict.fromkeys(q.table.doubts)),
    )


def _gnss(q: Quantities, time: Array) -> GnssLog:
    if q.has("height") and q.columns["height"].unit is None:
        name = q.columns["height"].header
        raise InputError(
            "the unit of this height is not stated and cannot be told; map it in [logs.columns] "
            f"or by --map, such as --map 'height = {name}:ft'",
            source=q.table.source,
            field=name,
        )
    log = gnss_of(q, time, "boot", fix_rows(q, time, mixed=True))
    # Before the first fix the recorder writes zeros.
    void = (log.lat == 0.0) & (log.lon == 0.0)
    return replace(log, fix=np.where(void, FIX_NONE, log.fix).astype(np.int64))


def _tell_units(q: Quantities, time: Array) -> Unit | None:
    """Set the units that nothing states: of speeds by the fixes, of heights by the speeds."""
    if not q.has("lat", "lon", "ground_speed"):
        return None
    speed = q.columns["ground_speed"]
    lat, lon = q.place()
    rows = fix_rows(q, time, mixed=True)
    rows = rows[(lat[rows] != 0.0) | (lon[rows] != 0.0)]
    unit = speed.unit or tell_speed_unit(
        time[rows], lat[rows], lon[rows], q.raw("ground_speed")[rows]
    )
    if unit is None:
        q.columns.pop("ground_speed")
        q.table.doubts.append(
            f"{speed.header} is not read: its unit is not stated and does not follow from the fixes"
        )
        return None
    height = unit_of(_HEIGHT_UNIT.get(unit.name, ""), "length")
    told = []
    for target, own in (
        ("ground_speed", unit), ("airspeed", unit), ("height", height), ("baro_height", height)
    ):  # fmt: skip
        if q.has(target) and q.columns[target].unit is None and own is not None:
            q.columns[target] = replace(q.columns[target], unit=own)
            told.append(f"{q.columns[target].header} in {own.name}")
    if told:
        q.table.doubts.append(
            f"units by the distance between fixes: {', '.join(told)}; map them if they are others"
        )
    return unit
