"""A servo channel out of a recorder's text log, and the table of photos that it gives."""

from __future__ import annotations

import os
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.column_map import ColumnMap, parse_spec
from georef_gis.ingest.logs.column_names import compact, understand
from georef_gis.ingest.logs.column_resolve import resolve
from georef_gis.ingest.logs.eagle_tree import looks_like_eagle_tree, read_channels
from georef_gis.ingest.logs.quantities import Quantities
from georef_gis.ingest.logs.text_table import HEAD, TextTable, read_bytes, read_table
from georef_gis.ingest.logs.text_times import TimeReader
from georef_gis.ingest.pwm_index import PwmIndex
from georef_gis.model.logs import TimeScale
from georef_gis.units import week_from_gps

_TIMES = frozenset(
    {"gps_week", "tow", "gps_time", "utc", "utc_date", "unix_time", "time", "boot_time"}
)
# us; what the servo pulse of a board can be, to tell it from per cent
_SHORTEST_PULSE, _LONGEST_PULSE = 300.0, 5000.0
_SHOWN = 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecorderChannel:
    """Samples of a channel: `time` s on `scale`, `value` in the recorder's unit, shape (n,)."""

    time: Array
    value: Array
    scale: TimeScale
    doubts: tuple[str, ...] = ()


def read_channel(path: Path, channel: str, time_column: str = "") -> RecorderChannel:
    """Samples of one column.

    Parameters
    ----------
    path
        Text table with a header, or an Eagle Tree record.
    channel
        Name of the column, or its number as ``#7``.
    time_column
        Name of the column of the time, with its unit where that cannot be told: ``t:ms``.

    Raises
    ------
    InputError
        If the file, the channel or the time cannot be read.
    """
    if looks_like_eagle_tree(read_bytes(path)[:HEAD], path):
        channels = read_channels(path)
        names = [name for name in channels if name != "time"]
        at = names[_find(channel, names, path)]
        return RecorderChannel(time=channels["time"], value=channels[at], scale="boot")
    table = read_table(path)
    headers = [table.name(i) for i in range(len(table.layout.headers))]
    value = table.numbers(_find(channel, headers, path))
    return _with_time(table, value, time_column)


def _find(channel: str, names: list[str], path: Path) -> int:
    """Place of a column by its name, letter for letter, then without case and signs."""
    wanted = channel.strip()
    if wanted in names:
        return names.index(wanted)
    if wanted.startswith("#") and wanted[1:].isdigit() and 0 < int(wanted[1:]) <= len(names):
        return int(wanted[1:]) - 1
    alike = [i for i, name in enumerate(names) if compact(name) == compact(wanted)]
    if len(alike) == 1:
        return alike[0]
    near = get_close_matches(wanted, names, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    raise InputError(
        f"{'several columns are' if alike else 'no column is'} called '{wanted}'{hint}; columns "
        f"are {', '.join(names[:_SHOWN])}{more}",
        source=str(path),
        field="channel",
    )


def _with_time(table: TextTable, value: Array, time_column: str) -> RecorderChannel:
    own = ColumnMap()
    headers = table.layout.headers
    kept = []
    for header, unit in zip(headers, table.layout.units, strict=True):
        heading = understand(header, unit) if header.strip() else None
        kept.append(header if heading is not None and heading.target in _TIMES else "")
    if time_column:
        own = ColumnMap(columns={"time": parse_spec(time_column, "time", table.source)})
        kept = [header if header == own.columns["time"].column else "" for header in headers]
    q = Quantities(table, resolve(kept, table.layout.units, own, table.source))
    q.refuse_clash(sorted(_TIMES))
    time = q.columns.get("time")
    if time is not None and not table.is_numeric(time.index):
        q.columns["utc"] = q.columns.pop("time")
    times = TimeReader(table, q.columns, None, fast=True).read()
    if times is None:
        raise InputError(
            f"no column is known as the time; name one by --time-column, of "
            f"{', '.join(header for header in headers[:_SHOWN] if header)}",
            source=table.source,
        )
    doubts = list(table.doubts)
    if times.needs_week:
        doubts.append("the log states no GPS week: times are seconds of the week")
    return RecorderChannel(
        time=times.value, value=value, scale=times.scale, doubts=tuple(dict.fromkeys(doubts))
    )


def write_index(path: Path, index: PwmIndex, channel: RecorderChannel) -> None:
    """Write photos as a table of events, which `georef` reads as a log; whole or not at all."""
    on_gps = channel.scale == "gps"
    scale = index.scale
    pulses = scale.base + scale.step * np.array([0, scale.levels - 1])
    in_us = bool(np.all((pulses > _SHORTEST_PULSE) & (pulses < _LONGEST_PULSE)))
    rows = ["gps_week,tow_s" if on_gps else "boot_time_s"]
    rows[0] += ",event,sigma_time_s,pulse_us,level,steps,confidence"
    for i in range(len(index)):
        week, tow = week_from_gps(float(index.time[i]))
        time = f"{week},{tow:.4f}" if on_gps else f"{index.time[i]:.4f}"
        level = int(index.level[i])
        pulse = f"{scale.base + scale.step * level:.1f}" if in_us else ""
        rows.append(
            f"{time},{index.count[i]},{index.sigma[i]:.5f},{pulse},{level},{index.steps[i]},"
            f"{index.confidence[i]:.4f}"
        )
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text("\n".join(rows) + "\n", encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(
            f"cannot be written ({error.strerror}); choose another --output", source=str(path)
        ) from error
