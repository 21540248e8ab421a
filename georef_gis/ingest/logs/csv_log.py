"""Text logs with columns: IMU, GNSS, attitude, events and aids from one table.

The columns and units are told by a `ColumnMap`, by the headers, or by the numbers where only one
unit fits; anything else is an error that says how to map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.boot_clock import fit_boot_clock
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.column_resolve import Column, has_triplet, resolve
from georef_gis.ingest.logs.csv_gnss import fix_rows, gnss_of
from georef_gis.ingest.logs.quantities import Quantities
from georef_gis.ingest.logs.text_table import TextTable, read_table
from georef_gis.ingest.logs.text_times import TimeReader, Times
from georef_gis.model.logs import (
    AidKind,
    AidLog,
    AttitudeLog,
    EventLog,
    FlightLogs,
    GnssLog,
    ImuLog,
    TimeScale,
    unknown,
)
from georef_gis.units import GPS_WEEK

_TIMES = ("tow", "gps_time", "utc", "unix_time", "boot_time", "time")
_COUNTERS = ("seq", "sequence", "sequence_number", "counter")
_ANGLES = ("roll", "pitch", "yaw")
# share of rows whose GPS time repeats from which it is the time of the last fix, not of the row
_STALE = 0.3
# s; a number of whole weeks
_ANY_WEEKS = 2000 * GPS_WEEK


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLog:
    """A text log and how its mapping was used.

    Parameters
    ----------
    logs
        What the file holds.
    mapped
        Quantities of the mapping that the file has.
    absent
        Quantity -> column that the mapping names but the file has not.
    """

    logs: FlightLogs
    mapped: frozenset[str]
    absent: dict[str, str]


def read_csv_log(path: Path, columns: ColumnMap | None = None) -> FlightLogs:
    """Logs of a text file with columns.

    Raises
    ------
    InputError
        Naming the file, the columns and how to map them.
    """
    text = read_text_log(path, columns or ColumnMap())
    refuse_absent(text.absent, path)
    return text.logs


def refuse_absent(absent: dict[str, str], path: Path) -> None:
    """Raise if a mapping names columns that the file has not.

    Raises
    ------
    InputError
        Naming the first of them and the columns that are there.
    """
    for target, column in absent.items():
        table = read_table(path)
        there = ", ".join(h for h in table.layout.headers if h)
        have = f"columns are {there}" if there else f"it has {len(table.layout.headers)} columns"
        raise InputError(
            f"no column '{column}'; {have} (a column may be named by its number, such as #1)",
            source=str(path),
            field=target,
        )


def read_text_log(path: Path, columns: ColumnMap) -> TextLog:
    """Like `read_csv_log`, with what the mapping named in vain instead of an error."""
    own = columns.for_file(path)
    return logs_of_table(read_table(path, delimiter=own.delimiter, decimal=own.decimal), own)


def logs_of_table(table: TextTable, own: ColumnMap) -> TextLog:
    """Logs of a table with the mapping of its file; raises as `read_csv_log`."""
    layout = table.layout
    resolved = resolve(layout.headers, layout.units, own, table.source)
    absent = dict(resolved.absent)
    try:
        logs = _build(Quantities(table, resolved), own)
    except InputError:
        # What the mapping names in vain explains the rest.
        refuse_absent(absent, Path(table.source))
        raise
    mapped = frozenset(t for t, c in resolved.columns.items() if c.mapped)
    return TextLog(logs=logs, mapped=mapped, absent=absent)


def _build(q: Quantities, own: ColumnMap) -> FlightLogs:
    _settle_names(q)
    _check_enough(q)
    imu = has_triplet(q.columns, "gyro") and has_triplet(q.columns, "accel")
    if not any(q.has(t) for t in _TIMES):
        q.refuse_clash(_TIMES)
    q.refuse_clash([f"{k}_{a}" for k in ("gyro", "accel") for a in "xyz"])
    q.refuse_clash(["lat", "lon"])
    times = TimeReader(q.table, q.columns, own.date, fast=imu).read()
    if times is None and not _is_event_table(q):
        raise _no_time(q.table, q.columns)
    return Builder(q, times or Times(value=unknown(q.table.rows), scale="boot"), own).build()


def _settle_names(q: Quantities) -> None:
    """Settle names that mean one thing or another by what stands beside them.

    `heading` is yaw beside roll and pitch, and course beside a speed; a `time` of text is UTC.
    """
    time = q.columns.get("time")
    if time is not None and not q.has("utc") and not q.table.is_numeric(time.index):
        q.columns["utc"] = replace(q.columns.pop("time"), target="utc")
    if not any(q.has(t) for t in ("photo", "event", *_ANGLES, "lat", "gyro_x", "accel_x")):
        # A counter alone beside times counts exposures; beside samples it counts rows.
        for i, header in enumerate(q.table.layout.headers):
            if header.strip().lower() in _COUNTERS:
                q.columns["event"] = Column(target="event", index=i, header=header)
    heading = q.columns.get("heading")
    if heading is None or heading.mapped:
        return
    if q.has("roll", "pitch") and not q.has("yaw"):
        q.columns["yaw"] = replace(q.columns.pop("heading"), target="yaw")
    elif q.has("lat", "lon", "ground_speed") and not q.has("course"):
        q.table.doubts.append(
            f"column {heading.header} is taken as the course over ground; map heading if it is a "
            "compass"
        )
        q.columns["course"] = replace(q.columns.pop("heading"), target="course")


def _is_event_table(q: Quantities) -> bool:
    """Whether the rows are exposures: named photos, or counted events without samples."""
    if has_triplet(q.columns, "gyro") or has_triplet(q.columns, "accel"):
        return False
    return q.has("photo") or q.has("event")


def _check_enough(q: Quantities) -> None:
    """Raise if a table holds nothing that navigation reads.

    Raises
    ------
    InputError
        Listing the columns, and how to map them.
    """
    held = (
        has_triplet(q.columns, "gyro") and has_triplet(q.columns, "accel"),
        q.has("lat", "lon"),
        q.has(*_ANGLES),
        _is_event_table(q),
        q.has("baro_height"),
        q.has("airspeed"),
        q.has("heading"),
        has_triplet(q.columns, "mag"),
    )
    if any(held):
        return
    table = q.table
    if table.layout.has_header:
        there = "columns " + ", ".join(h for h in table.layout.headers if h)
    else:
        there = f"{len(table.layout.headers)} columns without a header"
    raise InputError(
        f"{there} hold no IMU, GNSS, attitude, event or aid that is known; map them in "
        "[logs.columns] or by --map, such as --map 'gyro_x = #4:deg/s'",
        source=table.source,
    )


def _no_time(table: TextTable, columns: dict[str, Column]) -> InputError:
    known = ", ".join(c.header for c in columns.values())
    return InputError(
        f"no column of time beside {known[:120]}; map one in [logs.columns] or by --map, such as "
        "--map 'time = #1:ms' (or tow with gps_week, utc, unix_time, boot_time)",
        source=table.source,
        field="time",
    )


class Builder:
    """Makes the logs of one table."""

    def __init__(self, q: Quantities, times: Times, columns: ColumnMap) -> None:
        self.q, self.times, self.columns = q, times, columns
        self.R = columns.R_body_from_sensor()
        self.events_only = _is_event_table(q)
        self.has_imu = has_triplet(q.columns, "gyro") and has_triplet(q.columns, "accel")
        self.sample_time, self.sample_scale = self._sample_times()

    def build(self) -> FlightLogs:
        """All logs of the table; doubts about the file as a whole."""
        q = self.q
        q.doubt_clashes()
        self._doubt_halves()
        imu = self._imu() if self.has_imu else None
        gnss = attitude = None
        if not self.events_only:
            gnss = self._gnss() if q.has("lat", "lon") else None
            attitude = self._attitude() if q.has(*_ANGLES) else None
        events = (self._events(),) if self.events_only else ()
        aids = () if self.events_only else self._aids()
        lost = int(np.sum(~np.isfinite(self.times.value)))
        if lost and not self.events_only:
            q.table.doubts.append(f"{lost} of {q.table.rows} rows have no time; left out")
        return FlightLogs(
            imu=imu,
            gnss=gnss,
            attitude=attitude,
            events=events,
            aids=aids,
            source=q.table.source,
            format="text with columns",
            doubts=tuple(dict.fromkeys(q.table.doubts)),
        )

    def _doubt_halves(self) -> None:
        gyro, accel = (has_triplet(self.q.columns, k) for k in ("gyro", "accel"))
        if gyro != accel:
            there, missing = ("rates", "accelerations") if gyro else ("accelerations", "rates")
            self.q.table.doubts.append(
                f"the file has {there} but no {missing} on three axes: no IMU is read from it"
            )

    def _sample_times(self) -> tuple[Array, TimeScale]:
        """Times of the samples; the logger's own clock where GPS time repeats the last fix."""
        times = self.times
        if times.boot is None or times.scale != "gps":
            return times.value, times.scale
        good = np.isfinite(times.value)
        steps = np.diff(times.value[good])
        if not len(steps) or (np.mean(steps <= 0.0) < _STALE and good.mean() > 1.0 - _STALE):
            return times.value, times.scale
        new = np.flatnonzero(good)[np.concatenate([[True], steps > 0.0])]
        # The line is found for present times only; a time without its week is put there and back.
        shift = _ANY_WEEKS if times.needs_week else 0.0
        clock = fit_boot_clock(times.boot[new], times.value[new] + shift)
        if clock is None:
            return times.boot, "boot"
        self.q.table.doubts.append(
            "GPS time is that of the last fix: samples are timed by the logger's clock, which the "
            "fixes set; their shortest delay remains in it"
        )
        self.q.table.doubts.extend(clock.doubts)
        return clock.gps_of(times.boot) - shift, "gps"

    def _imu(self) -> ImuLog:
        gyro, accel = self.q.triplet("gyro", self.R), self.q.triplet("accel", self.R)
        rows = np.isfinite(self.sample_time)
        # Rows of another message in the same table have no sample at all.
        rows &= np.isfinite(gyro).any(axis=1) | np.isfinite(accel).any(axis=1)
        self._need_rows(rows, "IMU")
        return ImuLog(
            time=self.sample_time[rows],
            scale=self.sample_scale,
            source=self.q.table.source,
            gyro=gyro[rows],
            accel=accel[rows],
        )

    def _need_rows(self, rows: NDArray[np.bool_], what: str) -> None:
        if not np.any(rows):
            raise InputError(
                f"no row of {what} has a time and values; check the columns",
                source=self.q.table.source,
            )

    def _gnss(self) -> GnssLog:
        mixed = self.has_imu or self.q.has(*_ANGLES)
        rows = fix_rows(self.q, self.times.value, mixed=mixed)
        return gnss_of(self.q, self.times.value, self.times.scale, rows)

    def _attitude(self) -> AttitudeLog:
        rpy = self.q.angles(_ANGLES)
        rows = np.isfinite(self.sample_time) & np.isfinite(rpy).any(axis=1)
        self._need_rows(rows, "attitude")
        told = self.q.angle_unit(_ANGLES)
        sigma = np.stack([self.q.si(f"sigma_{a}", told) for a in _ANGLES], axis=1)
        return AttitudeLog(
            time=self.sample_time[rows],
            scale=self.sample_scale,
            source=self.q.table.source,
            rpy=rpy[rows],
            sigma_rpy=sigma[rows],
        )

    def _events(self) -> EventLog:
        q, count = self.q, self.q.table.rows
        lat, lon = q.place() if q.has("lat", "lon") else (unknown(count), unknown(count))
        height, kind = unknown(count), HeightKind.UNKNOWN
        for target in ("height_ellipsoidal", "height_orthometric", "height"):
            if q.has(target):
                height = q.si(target)
                kind = HeightKind(target.partition("_")[2] or "unknown")
                break
        sigma = np.stack([q.si(f"sigma_{a}") for a in ("north", "east", "down")], axis=1)
        names = q.table.texts(q.columns["photo"].index) if q.has("photo") else [""] * count
        return EventLog(
            time=self.times.value,
            scale=self.times.scale,
            source=q.table.source,
            kind=self.columns.events or self._event_kind(),
            sequence=q.whole("event", -1),
            sigma=q.si("sigma_time"),
            lat=lat,
            lon=lon,
            height=height,
            height_kind=kind,
            covariance_ned=np.asarray(sigma[..., None] ** 2 * np.eye(3)),
            rpy=q.angles(_ANGLES) if q.has(*_ANGLES) else unknown(count, 3),
            names=tuple(names),
            flags=q.whole("flags", -1),
        )

    def _event_kind(self) -> str:
        if self.q.has("pulse"):
            return "sync_board"
        column = self.q.columns.get("event")
        return "trigger" if column and "trig" in column.header.lower() else "feedback"

    def _aids(self) -> tuple[AidLog, ...]:
        q, out = self.q, []
        if q.has("baro_height"):
            out.append(self._aid("baro_height", q.si("baro_height")))
        if q.has("airspeed"):
            out.append(self._aid("airspeed", q.si("airspeed")))
        if q.has("heading"):
            out.append(self._aid("heading", q.angles(["heading"])[:, 0]))
        if has_triplet(q.columns, "mag"):
            out.append(self._aid("magnetic_field", q.triplet("mag", self.R)))
        return tuple(out)

    def _aid(self, kind: AidKind, value: Array) -> AidLog:
        known = np.isfinite(value) if value.ndim == 1 else np.isfinite(value).all(axis=1)
        rows = known & np.isfinite(self.sample_time)
        return AidLog(
            time=self.sample_time[rows],
            scale=self.sample_scale,
            source=self.q.table.source,
            kind=kind,
            value=value[rows],
            sigma=unknown(int(rows.sum())),
        )
