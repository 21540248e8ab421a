"""What lies beside the photos: DEM, control points, poses and logs of the flight."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

# Section and key of project.toml, and the names of its file, best first.
NAMED = (
    ("ground", "dem", ("dem.tif", "dem.tiff", "dem.asc", "dtm.tif", "dtm.asc", "dsm.tif")),
    ("control", "file", ("control.csv", "gcp_list.txt")),
    ("control", "marks", ("marks.csv",)),
    ("poses", "file", ("geo.txt",)),
)
SUBFOLDERS = (
    "logs", "log", "flight_logs", "control", "gcp", "gcps", "dem", "dsm", "dtm", "ground",
    "gnss", "gps", "ppk", "rtk", "imu",
)  # fmt: skip
_LOG_SUFFIXES = {
    ".ulg", ".ulog", ".bin", ".ubx", ".nmea", ".pos", ".mrk", ".fdr", ".sbet", ".csv", ".log",
}  # fmt: skip
# Format by its content -> key of [logs]; other formats hold several things.
_KEYS = {
    "sync board ($TSB)": "sync", "NMEA 0183": "gnss", "RTKLIB .pos": "gnss",
    "RTKLIB _events.pos": "sync", "SBET": "trajectory",
    # A table of photos may as well be one of poses or marks.
    "geoinfo": "",
}  # fmt: skip
# Of these a flight has one log, each with IMU, GNSS and more.
_WHOLE = {"PX4 ULog", "ArduPilot DataFlash"}
_WITH_GNSS = ("autopilot", "Eagle Tree .FDR", "text log")
# Names that say which of several files of a kind is meant.
_PLAIN = {"imu": "imu.csv", "gnss": "gnss.csv", "sync": "sync_board.log"}
_TIMES = {"tow", "gps_time", "utc", "unix_time", "boot_time", "time"}
# bytes in which a text log shows its header
_HEAD = 65_536
# files in a folder; more is no place that was made for one flight
_MOST = 5000


@dataclass(slots=True)
class Beside:
    """Files by section and key of project.toml, and what is to be said of others, by section."""

    files: dict[tuple[str, str], Path] = field(default_factory=dict)
    logs: list[Path] = field(default_factory=list)
    notes: dict[str, list[str]] = field(default_factory=dict)

    def names_in(self, folder: Path) -> set[str]:
        """Names of the found files that lie in a folder."""
        found = [*self.files.values(), *self.logs]
        return {path.name for path in found if path.parent.resolve() == folder.resolve()}

    def say(self, section: str, words: str) -> None:
        """Note something at the head of a section."""
        self.notes.setdefault(section, []).append(words)


def find_beside(photos: Path, into: Path) -> Beside:
    """Files in the project's folder, the photos' and the one above, and their obvious subfolders.

    A key is left open where several files might be meant; a note names them.
    """
    found = Beside()
    here = list(_files(photos, into))
    for section, key, names in NAMED:
        known = [path for name in names for path in here if path.name.lower() == name]
        if known:
            # In the order of the folders; in one folder in that of the names.
            first = min(known, key=lambda path: here.index(path))
            same = [path for path in known if path.parent == first.parent]
            found.files[section, key] = same[0]
    taken = set(found.files.values())
    _logs(found, [path for path in here if path not in taken])
    return found


def _files(photos: Path, into: Path) -> Iterator[Path]:
    """Files of the places to look in, the nearest to the project first, each once."""
    seen: set[Path] = set()
    above = photos.resolve().parent
    bases = [into, photos] + [above] * (above not in (Path.home(), Path(above.anchor)))
    for base in bases:
        for folder in (base, *_subfolders(base)):
            real = folder.resolve()
            if real in seen:
                continue
            seen.add(real)
            yield from _names(folder)


def _subfolders(base: Path) -> list[Path]:
    try:
        folders = [path for path in base.iterdir() if path.is_dir()]
    except OSError:
        return []
    wanted = [path for path in folders if path.name.lower() in SUBFOLDERS]
    return sorted(wanted, key=lambda path: SUBFOLDERS.index(path.name.lower()))


def _names(folder: Path) -> list[Path]:
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return []
    files = (Path(folder, name) for name in names if not name.startswith("."))
    return [path for path in files if path.is_file()] if len(names) <= _MOST else []


# -- logs --------------------------------------------------------------------------------------


def _logs(found: Beside, paths: Sequence[Path]) -> None:
    """Logs by what they hold; several of one kind are left to the user."""
    from georef_gis.errors import InputError

    kinds: dict[str, list[Path]] = {}
    for path in paths:
        if path.suffix.lower() not in _LOG_SUFFIXES:
            continue
        try:
            kind = log_kind(path)
        except InputError as error:
            if path.suffix.lower() not in (".csv", ".log"):
                found.say("logs", f"Not used: {error}")
            continue
        if kind:
            kinds.setdefault(kind, []).append(path)
    for kind, files in kinds.items():
        plain = [path for path in files if path.name.lower() == _PLAIN.get(kind)]
        chosen = files[0] if len(files) == 1 else plain[0] if plain else None
        others = [path.name for path in files if path != chosen]
        if others:
            found.say("logs", f"Several logs of one kind; not entered: {', '.join(others)}")
        if chosen is None:
            continue
        if kind in ("imu", "gnss", "attitude", "sync", "trajectory"):
            found.files["logs", kind] = chosen
        else:
            found.logs.append(chosen)
    _one_receiver(found, kinds)


def _one_receiver(found: Beside, kinds: dict[str, list[Path]]) -> None:
    """Say which log the positions are taken from, where an autopilot and a receiver have them."""
    receiver = [path for path in kinds.get("u-blox UBX", ()) if path in found.logs]
    others = [path for kind in _WITH_GNSS for path in kinds.get(kind, ()) if path in found.logs]
    if receiver and others and ("logs", "gnss") not in found.files:
        found.files["logs", "gnss"] = receiver[0]
        found.logs.remove(receiver[0])
        found.say("logs", f"Positions are taken from {receiver[0].name}; say gnss for another log")


def log_kind(path: Path) -> str:
    """Key of [logs] that a file is for, or the name of a format that holds several; '' for none.

    Raises
    ------
    InputError
        If it cannot be read or is of no known format.
    """
    from georef_gis.ingest.logs.open_log import format_of

    label = format_of(path)
    if label == "text with columns":
        return _text_kind(path)
    # A flight has one autopilot, whoever made it.
    return _KEYS.get(label, "autopilot" if label in _WHOLE else label)


def _text_kind(path: Path) -> str:
    """Kind of a text log by its headers; '' for a table that is no log."""
    from georef_gis.ingest.logs.column_names import understand
    from georef_gis.ingest.logs.text_table import decode_head, find_layout

    with path.open("rb") as stream:
        decoded = decode_head(stream.read(_HEAD))
    layout = find_layout(*decoded) if decoded else None
    if layout is None:
        return ""
    headings = (understand(*pair) for pair in zip(layout.headers, layout.units, strict=True))
    targets = {heading.target for heading in headings if heading is not None}
    if not targets & _TIMES or "photo" in targets:
        return ""
    imu = {"gyro_x", "gyro_y", "gyro_z"} <= targets
    gnss = {"lat", "lon"} <= targets
    attitude = {"roll", "pitch", "yaw"} <= targets
    if imu + gnss + attitude > 1:
        return "text log"
    return "imu" if imu else "gnss" if gnss else "attitude" if attitude else ""
