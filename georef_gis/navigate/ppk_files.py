"""What raw GNSS files hold, found out before a solver sees them: kind, span, satellites, header.

RTKLIB takes a wrong or empty file for one without measurements and says nothing; so it is said
here. Formats: RINEX 2.11 and 3.04 (IGS, 2007 and 2018), u-blox UBX (frames only).
"""

from __future__ import annotations

import gzip
import mmap
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.units import GPS_ZERO, gps_from_utc

# s from the time system of a file to the GPS scale, but for UTC (GLONASS), which has leap seconds
_BEIDOU = 14.0
_EPOCH_3 = re.compile(rb"^> ?(\d{4}) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) *([\d.]+) +(\d)", re.M)
_SATELLITE_3 = re.compile(rb"^([GRECJIS][ \d]\d)[ \d]", re.M)
_NAV_3 = re.compile(
    rb"^([GRECJIS][ \d]\d) (\d{4}) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)", re.M
)
_NAV_2 = re.compile(
    rb"^([ \d]\d) (\d\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ?([ \d]\d\.\d)", re.M
)
_PACKED = {
    b"\x1f\x9d": "is packed by compress; unpack it (gunzip reads .Z)",
    b"PK": "is a ZIP archive; unpack it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """What an observation file holds.

    Parameters
    ----------
    first, last
        Epochs as tagged, s on the GPS scale since 1980.
    epochs
        Number of epochs with measurements.
    satellites
        Names such as ``G05``.
    bands
        Whether there is carrier phase on the first and on the second frequency.
    marker_ecef
        Approximate position of the header, m; None where it has none.
    antenna_up, antenna_east, antenna_north
        Antenna reference point from the marker, m.
    events
        Times of epochs with flag 5, s on the GPS scale.
    """

    file: Path
    version: float
    first: float
    last: float
    epochs: int
    satellites: frozenset[str]
    bands: tuple[bool, bool]
    marker_ecef: Array | None
    antenna_up: float
    antenna_east: float
    antenna_north: float
    events: tuple[float, ...]


def kind_of(file: Path) -> str:
    """`obs`, `nav`, `ubx`, or `gzip` of something.

    Raises
    ------
    InputError
        If the file is missing, empty or none of them.
    """
    try:
        with file.open("rb") as stream:
            head = stream.read(65536)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(file)) from error
    if not head.strip():
        raise InputError("is empty; a raw GNSS file is wanted", source=str(file))
    if head[:2] == b"\x1f\x8b":
        return "gzip"
    for magic, cure in _PACKED.items():
        if head.startswith(magic):
            raise InputError(cure, source=str(file))
    line = head.splitlines()[0]
    if b"CRINEX VERS" in line:
        raise InputError("is Hatanaka-packed; unpack it with crx2rnx", source=str(file))
    if b"RINEX VERSION / TYPE" in line:
        return _rinex_kind(file, line)
    if b"\xb5b" in head:
        return "ubx"
    raise InputError(
        "is neither RINEX (first line 'RINEX VERSION / TYPE') nor UBX; convert it to RINEX 3 "
        "(e.g. RTKLIB's convbin)",
        source=str(file),
    )


def _rinex_kind(file: Path, line: bytes) -> str:
    version = _number(line[:9])
    if not 2.0 <= version < 4.0:
        raise InputError(
            f"RINEX {version:.2f} is not read by RTKLIB 2.4.3; write it as 3.03 or 3.04",
            source=str(file),
        )
    kind = line[20:21].upper()
    # G and H are GLONASS and geostationary navigation of RINEX 2.
    return "obs" if kind == b"O" else "nav" if kind in b"NGHEL" else f"RINEX {kind.decode()!r}"


def unpacked(file: Path, folder: Path) -> Path:
    """The file itself, or its gunzipped copy in a folder."""
    if kind_of(file) != "gzip":
        return file
    target = folder / f"{len(list(folder.iterdir()))}_{file.stem}"
    try:
        with gzip.open(file) as source, target.open("wb") as out:
            while block := source.read(1 << 20):
                out.write(block)
    except (OSError, EOFError) as error:
        raise InputError(f"gzip data are damaged: {error}", source=str(file)) from error
    return target


def read_observations(file: Path, *, name: Path | None = None) -> Observations:
    """Scan a RINEX observation file.

    Parameters
    ----------
    name
        Of the file for messages, where `file` is a copy.

    Raises
    ------
    InputError
        If it is no observation file, or has no epochs or no carrier phase.
    """
    source = str(name or file)
    kind = kind_of(file)
    if kind != "obs":
        what = {"nav": "a navigation file", "ubx": "a UBX file"}.get(kind, kind)
        raise InputError(f"is {what}; an observation file is wanted", source=source)
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        end = data.find(b"END OF HEADER")
        if end < 0:
            raise InputError("the RINEX header does not end; the file is cut off", source=source)
        header = _Header(data[:end])
        walk = _walk_3 if header.version >= 3.0 else _walk_2
        times, events, satellites = walk(data, end, header)
    if not times.size:
        raise InputError("has no epochs with measurements", source=source)
    if not header.bands[0]:
        raise InputError(
            "has no carrier phase on L1: PPK cannot work; log the phase (RXM-RAWX on u-blox)",
            source=source,
        )
    return Observations(
        file=file, version=header.version, first=float(times.min()), last=float(times.max()),
        epochs=len(times), satellites=frozenset(satellites), bands=header.bands,
        marker_ecef=header.marker, antenna_up=header.antenna[0],
        antenna_east=header.antenna[1], antenna_north=header.antenna[2], events=tuple(events),
    )  # fmt: skip


class _Header:
    """The lines of an observation header that matter here."""

    def __init__(self, raw: bytes) -> None:
        rows = [(row[:60], row[60:].strip()) for row in raw.splitlines()]
        self.version = _number(rows[0][0][:9])
        types: list[str] = []
        self.antenna, self.marker, self.system = (0.0, 0.0, 0.0), None, b"GPS"
        # Number of types a system has: of the one system-less list of RINEX 2.
        self.count = 0
        for text, label in rows:
            if label == b"SYS / # / OBS TYPES":
                types += text[6:].decode("ascii", "replace").split()
            elif label == b"# / TYPES OF OBSERV":
                types += text[6:].decode("ascii", "replace").split()
                self.count = int(_number(text[:6])) or self.count
            elif label == b"APPROX POSITION XYZ":
                self.marker = _marker(text)
            elif label == b"ANTENNA: DELTA H/E/N":
                h, e, n = (_number(text[i : i + 14]) for i in (0, 14, 28))
                self.antenna = (h, e, n)
            elif label == b"TIME OF FIRST OBS" and text[48:51].strip():
                self.system = text[48:51]
        phases = {name[1] for name in types if name[:1] == "L"}
        # E5b and B2 are RTKLIB's second frequency of Galileo and BeiDou.
        self.bands = (bool(phases & {"1", "2"}), bool(phases & {"2", "7"}))
        if "1" not in phases and self.bands[0]:
            # BeiDou's first frequency is called 2 (B1I); GPS without L1 has none.
            self.bands = (b"SYS" in raw and "L2I" in types, self.bands[1])

    def gps(self, text: tuple[bytes, ...]) -> float:
        """Seconds on the GPS scale of year, month, day, hour, minute, second."""
        year, month, day, hour, minute = (int(v) for v in text[:5])
        if year < 100:
            year += 1900 if year >= 80 else 2000
        start = datetime(year, month, day, hour, minute, tzinfo=UTC)
        seconds = float(text[5])
        if self.system == b"GLO":
            return gps_from_utc(start) + seconds
        shift = _BEIDOU if self.system == b"BDT" else 0.0
        return (start - GPS_ZERO).total_seconds() + seconds + shift


def _marker(text: bytes) -> Array | None:
    xyz = np.array([_number(text[i : i + 14]) for i in (0, 14, 28)])
    # Receivers write zeros, or the centre of the Earth and its neighbourhood, for "unknown".
    return xyz if 6.3e6 < float(np.linalg.norm(xyz)) < 6.5e6 else None


def _number(text: bytes) -> float:
    try:
        return float(text.replace(b"D", b"E"))
    except ValueError:
        return 0.0


def _walk_3(data: mmap.mmap, start: int, header: _Header) -> tuple[Array, list[float], set[str]]:
    times, events = [], []
    for match in _EPOCH_3.finditer(data, start):
        try:
            time = header.gps(match.groups()[:6])
        except ValueError:
            continue
        flag = match.group(7)
        if flag in b"016":
            times.append(time)
        elif flag == b"5":
            events.append(time)
    names = {m.group(1) for m in _SATELLITE_3.finditer(data, start)}
    return np.array(times), events, {n.decode().replace(" ", "0") for n in names}


def _walk_2(data: mmap.mmap, start: int, header: _Header) -> tuple[Array, list[float], set[str]]:
    data.seek(start)
    data.readline()
    per_satellite = -(-header.count // 5)
    times, events, satellites = [], [], set()
    while line := data.readline():
        flag, count = line[28:29], int(_number(line[29:32]))
        cells = (line[1:3], line[4:6], line[7:9], line[10:12], line[13:15], line[15:26])
        try:
            time = header.gps(cells)
        except ValueError:
            # An event without time, or a damaged line: the next epoch is found by its own look.
            for _ in range(count if flag in b"2345" and flag else 0):
                data.readline()
            continue
        if flag in b"2345":
            if flag == b"5":
                events.append(time)
            for _ in range(count):
                data.readline()
            continue
        names = line[32:68].rstrip()
        for _ in range((count - 1) // 12):
            names += data.readline()[32:68].rstrip()
        satellites |= {
            (names[i : i + 1].strip() or b"G").decode() + names[i + 1 : i + 3].decode().zfill(2)
            for i in range(0, 3 * count, 3)
        }
        for _ in range(count * per_satellite):
            data.readline()
        times.append(time)
    return np.array(times), events, {name.replace(" ", "0") for name in satellites}


def read_ephemeris_times(file: Path) -> dict[str, list[float]]:
    """Reference times of the broadcast elements of each satellite, s on the GPS scale.

    Raises
    ------
    InputError
        If the file is no navigation file.
    """
    kind = kind_of(file)
    if kind != "nav":
        what = {"obs": "an observation file", "ubx": "a UBX file"}.get(kind, kind)
        raise InputError(f"is {what}; a navigation file is wanted", source=str(file))
    data = file.read_bytes()
    system = {b"G": "R", b"H": "S"}.get(data[20:21].upper(), "G")
    is_3 = _number(data[:9]) >= 3.0
    out: dict[str, list[float]] = {}
    for match in (_NAV_3 if is_3 else _NAV_2).finditer(data, data.find(b"END OF HEADER")):
        name = match.group(1).decode().replace(" ", "0")
        name = name if is_3 else system + name
        year, month, day, hour, minute = (int(v) for v in match.groups()[1:6])
        year += 0 if year >= 100 else 1900 if year >= 80 else 2000
        try:
            start = datetime(year, month, day, hour, minute, tzinfo=UTC)
        except ValueError:
            continue
        # Other scales are at most 18 s off, which does not matter for hours of validity.
        time = (start - GPS_ZERO).total_seconds() + float(match.group(7))
        out.setdefault(name, []).append(time)
    return out
