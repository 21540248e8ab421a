"""The front door of log reading: which format a file has, and several files as one flight."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from georef_gis.errors import InputError
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.text_table import HEAD, decode_head
from georef_gis.model.logs import FlightLogs, TimedLog

Part = Literal["imu", "gnss", "attitude", "trajectory"]
_PARTS: tuple[Part, ...] = ("imu", "gnss", "attitude", "trajectory")
_WORDS = {"imu": "IMU", "gnss": "GNSS", "attitude": "attitude", "trajectory": "trajectory"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Format:
    """A format: where its reader lives, and what users call it."""

    module: str
    name: str
    label: str
    suffixes: tuple[str, ...] = ()
    # the reader takes a mapping of columns
    mapped: bool = False


# In the order of trial: the ones that a signature or checksum proves come first.
_FORMATS = (
    _Format(module="ulog", name="ulog", label="PX4 ULog", suffixes=(".ulg", ".ulog")),
    _Format(
        module="dataflash",
        name="dataflash",
        label="ArduPilot DataFlash",
        suffixes=(".bin",),
    ),
    _Format(module="tsb_file", name="tsb", label="sync board ($TSB)"),
    _Format(module="ubx", name="ubx", label="u-blox UBX", suffixes=(".ubx",)),
    _Format(module="nmea", name="nmea", label="NMEA 0183", suffixes=(".nmea",)),
    _Format(
        module="rtklib",
        name="rtklib_events",
        label="RTKLIB _events.pos",
    ),
    _Format(module="rtklib", name="rtklib_pos", label="RTKLIB .pos", suffixes=(".pos",)),
    _Format(module="mrk", name="mrk", label="DJI .MRK", suffixes=(".mrk",)),
    _Format(
        module="eagle_tree",
        name="eagle_tree",
        label="Eagle Tree .FDR",
        suffixes=(".fdr",),
        mapped=True,
    ),
    _Format(module="geoinfo", name="geoinfo", label="geoinfo", mapped=True),
    _Format(module="sbet", name="sbet", label="SBET", suffixes=(".sbet", ".out")),
)
_CURE = "name its columns in [logs.columns] or by --map, such as --map 'gyro_x = GyroX:deg/s'"


def _function(format: _Format, prefix: str) -> Callable[..., Any]:
    module = importlib.import_module(f"georef_gis.ingest.logs.{format.module}")
    return cast("Callable[..., Any]", getattr(module, f"{prefix}_{format.name}"))


def read_log(path: Path, *, columns: ColumnMap | None = None) -> FlightLogs:
    """Logs of one file in any known format, which is told by its content, then by its suffix.

    Parameters
    ----------
    path
        File.
    columns
        What the columns of a text log hold, where its headers do not say.

    Raises
    ------
    InputError
        Unreadable, empty, of no known format, or as the reader of its format says.
    """
    logs, absent = _read(path, columns or ColumnMap())
    if absent:
        from georef_gis.ingest.logs.csv_log import refuse_absent

        refuse_absent(absent, path)
    return logs


def format_of(path: Path) -> str:
    """Name of the format of a file for people; "text with columns" for a text of no other kind.

    Raises
    ------
    InputError
        If the file is empty, cannot be read or is of no known format.
    """
    found = _recognise(path, _head(path))
    return found.label if found else "text with columns"


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    if not head.strip(b"\x00\xff \r\n\t"):
        what = "is empty" if not head else f"holds nothing but blanks in its first {len(head)} B"
        raise InputError(f"{what}; copy the log from the recorder again", source=str(path))
    return head


def _recognise(path: Path, head: bytes) -> _Format | None:
    """Format of a file; None for a text of no other kind.

    Raises
    ------
    InputError
        If the bytes are no text and no known binary format.
    """
    for format in _FORMATS:
        if _function(format, "looks_like")(head, path):
            return format
    by_suffix = [f for f in _FORMATS if path.suffix.lower() in f.suffixes]
    if decode_head(head) is not None:
        return None
    tried = ", ".join(f.label for f in _FORMATS)
    hint = f" (its name says {by_suffix[0].label}, its content does not)" if by_suffix else ""
    raise InputError(
        f"is of no known format{hint}: tried {tried} and text with columns; give a log in one of "
        f"these, or export it as text and {_CURE}",
        source=str(path),
    )


def _read(path: Path, columns: ColumnMap) -> tuple[FlightLogs, dict[str, str]]:
    """Logs of a file, and what the mapping names that a text log has not."""
    found = _recognise(path, _head(path))
    own = columns.for_file(path)
    if found is None:
        return _read_text(path, columns)
    reader = _function(found, "read")
    if found.mapped:
        return reader(path, own), {}
    if found.name == "tsb":
        return reader(path, date=own.date), {}
    return reader(path), {}


def _read_text(path: Path, columns: ColumnMap) -> tuple[FlightLogs, dict[str, str]]:
    from georef_gis.ingest.logs.csv_log import read_text_log

    try:
        text = read_text_log(path, columns)
    except InputError as error:
        if error.source != str(path) or "holds no rows of numbers" not in str(error):
            raise
        tried = ", ".join(f.label for f in _FORMATS)
        raise InputError(
            f"holds no rows of numbers and is of no known format: tried {tried} and text with "
            f"columns; {_CURE}",
            source=str(path),
        ) from error
    return text.logs, text.absent


def read_logs(
    paths: Sequence[Path],
    columns: ColumnMap | None = None,
    *,
    take: Mapping[Part, Path] | None = None,
) -> FlightLogs:
    """One flight of several files, such as IMU from one and GNSS from another.

    Parameters
    ----------
    paths
        Files; each at most once.
    columns
        What the columns of text logs hold.
    take
        Part -> file to take it from where several have it.

    Returns
    -------
    logs
        Not cleaned; events and aids of all files.

    Raises
    ------
    InputError
        A file as `read_log` says; two files that hold the same part; a mapping that names a
        column of no file.
    """
    if not paths:
        raise InputError("no log is named; name one in [logs]", source="logs")
    used = columns or ColumnMap()
    read: list[tuple[Path, FlightLogs]] = []
    absent: list[tuple[Path, dict[str, str]]] = []
    for path in dict.fromkeys(paths):
        logs, missing = _read(path, used)
        read.append((path, logs))
        absent.append((path, missing))
    _refuse_absent(absent)
    chosen = take or {}
    parts: dict[str, Any] = {part: _one(read, part, chosen.get(part)) for part in _PARTS}
    return FlightLogs(
        **parts,
        events=tuple(e for _, logs in read for e in logs.events),
        aids=tuple(a for _, logs in read for a in logs.aids),
        source=", ".join(dict.fromkeys(logs.source or str(path) for path, logs in read)),
        format=", ".join(dict.fromkeys(logs.format for _, logs in read if logs.format)),
        doubts=_doubts(read, parts),
    )


def _refuse_absent(absent: list[tuple[Path, dict[str, str]]]) -> None:
    """Raise for what a mapping names and no text log has; another file may hold the rest."""
    missing = [(path, found) for path, found in absent if found]
    if not missing:
        return
    from georef_gis.ingest.logs.csv_log import refuse_absent

    texts = [found for _, found in absent]
    nowhere = {
        target: column
        for target, column in missing[0][1].items()
        if all(target in found for found in texts)
    }
    if nowhere:
        refuse_absent(nowhere, missing[0][0])


def _holds(log: TimedLog | None) -> bool:
    """Whether a log has rows that say something."""
    if log is None or not len(log):
        return False
    places = getattr(log, "lat", None)
    return places is None or bool(np.isfinite(places).any())


def _one(read: list[tuple[Path, FlightLogs]], part: Part, chosen: Path | None) -> TimedLog | None:
    """The one log of a part.

    Raises
    ------
    InputError
        If two files hold it, or the chosen one does not.
    """
    holders = [(p, getattr(logs, part)) for p, logs in read if _holds(getattr(logs, part))]
    if chosen is not None:
        holders = [(p, log) for p, log in holders if p == chosen]
        if not holders:
            raise InputError(
                f"holds no {_WORDS[part]}; name another file in [logs]", source=str(chosen)
            )
    if len(holders) > 1:
        names = " and ".join(str(p) for p, _ in holders[:2])
        raise InputError(
            f"{len(holders)} logs hold {_WORDS[part]}: {names}; name only one of them, or say in "
            f"[logs] which file the {_WORDS[part]} comes from",
            source="logs",
        )
    if holders:
        return cast("TimedLog", holders[0][1])
    empty = [getattr(logs, part) for _, logs in read if getattr(logs, part) is not None]
    return cast("TimedLog | None", empty[0] if empty else None)


def _doubts(read: list[tuple[Path, FlightLogs]], parts: Mapping[str, Any]) -> tuple[str, ...]:
    """Doubts of the files with their names, and of the files together."""
    several = len(read) > 1
    out = [f"{p.name}: {d}" if several else d for p, logs in read for d in logs.doubts]
    scales = {
        part: log.scale for part, log in parts.items() if isinstance(log, TimedLog) and len(log)
    }
    if len(set(scales.values())) > 1:
        said = ", ".join(f"{_WORDS[p]} in {_SCALES[s]}" for p, s in scales.items())
        out.append(f"the logs have no common clock: {said}")
    return tuple(dict.fromkeys(out))


_SCALES = {"gps": "GPS time", "boot": "s since an unknown instant"}
