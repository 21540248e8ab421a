"""Times of text logs: weeks, roll-overs, UTC, Unix and boot clocks to one scale."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.boot_clock import gps_of_unix
from georef_gis.ingest.logs.column_resolve import Column
from georef_gis.ingest.logs.column_units import Unit, unit_of
from georef_gis.ingest.logs.text_table import TextTable, pandas
from georef_gis.model.logs import TimeScale
from georef_gis.units import GPS_WEEK, gps_from_utc

# weeks; the week number of the old GPS message has 10 bits
ROLLOVER_WEEKS = 1024
# s since 1970; 1995 and 2065: a clock within is Unix time, one outside counts from power-up
_UNIX_FROM, _UNIX_TO = 7.9e8, 3.0e9
# s; what one step of a log may last: unit -> from 4 kHz to one in 15 s, cut where units meet
_STEPS = {"s": (2.4e-4, 16.0), "ms": (0.24, 1.6e4), "us": (240.0, 1.6e7), "ns": (2.4e5, 1.6e10)}
_FASTEST_IMU, _SLOWEST_IMU = 2.4e-4, 0.22
_SLOWEST_GNSS = 16.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Times:
    """Times of the rows of a table, s.

    Parameters
    ----------
    value : shape (rows,), s
        NaN where a row has no time.
    scale
        Of `value`.
    boot : shape (rows,), s, or None
        The logger's own clock where the table has one beside a GPS or UTC time.
    needs_week
        Only the second of the week is known: `value` is of week 0, as the cleaning expects it.
    """

    value: Array
    scale: TimeScale
    boot: Array | None = None
    needs_week: bool = False


def resolve_week(week: Array, date: datetime | None) -> tuple[Array, int]:
    """Weeks without roll-over, and how many times 1024 weeks were added.

    Parameters
    ----------
    week : shape (n,)
        GPS weeks as logged; below 1024 only the lowest ten bits are taken to be there.
    date
        An instant near the flight. Without it the latest week that is not in the future holds.
    """
    known = week[np.isfinite(week)]
    if not len(known):
        return week, 0
    middle = float(np.median(known))
    if date is not None:
        goal = gps_from_utc(date) / GPS_WEEK
        turns = round((goal - middle) / ROLLOVER_WEEKS)
    elif middle < ROLLOVER_WEEKS:
        now = gps_from_utc(datetime.now(UTC)) / GPS_WEEK
        turns = int((now - middle) // ROLLOVER_WEEKS)
    else:
        turns = 0
    return np.asarray(week + turns * ROLLOVER_WEEKS), turns


def unwrap_week(seconds: Array) -> Array:
    """Times in order of record without falls of about a week; shape (n,), NaN stays NaN."""
    out = seconds.copy()
    good = np.flatnonzero(np.isfinite(seconds))
    steps = np.diff(seconds[good]) / GPS_WEEK
    # A late line after the turn goes back to the week before. Steps of many weeks are no turns.
    turns = ((steps < -0.5) & (steps > -1.01)).astype(float)
    turns -= (steps > 0.99) & (steps < 1.01)
    out[good] += np.concatenate([[0.0], np.cumsum(turns)]) * GPS_WEEK
    return out


def unwrap_counter(raw: Array) -> Array:
    """Counts of a 32-bit clock without its wraps; shape (n,). Other counts are left alone."""
    good = np.flatnonzero(np.isfinite(raw))
    known = raw[good]
    if not len(known) or known.max() >= 2.0**32 or known.min() < 0.0:
        return raw
    wraps = np.concatenate([[0.0], np.cumsum(np.diff(known) < -(2.0**31))])
    out = raw.copy()
    out[good] += wraps * 2.0**32
    return out


def tell_time_unit(raw: Array, *, fast: bool) -> Unit | None:
    """Unit of a clock by the length of its steps; None if it cannot be told.

    Parameters
    ----------
    raw : shape (n,)
        Counts of the clock.
    fast
        Whether the rows are inertial samples (0.25 ms to 0.2 s apart), else fixes (to 16 s).
    """
    steps = np.diff(raw[np.isfinite(raw)])
    steps = steps[steps > 0.0]
    if len(steps) < 3:
        return None
    step = float(np.median(steps))
    longest = _SLOWEST_IMU if fast else _SLOWEST_GNSS
    shortest = _FASTEST_IMU if fast else longest / 999.0
    for name in ("s", "ms", "us", "ns"):
        unit = unit_of(name, "time")
        if unit is not None and shortest <= step * unit.factor <= longest:
            return unit
    return None


class TimeReader:
    """Reads the times of one table.

    Parameters
    ----------
    table, columns
        Table and its columns by quantity.
    date
        An instant near the flight, or None.
    fast
        Whether the rows are inertial samples.
    """

    def __init__(
        self,
        table: TextTable,
        columns: dict[str, Column],
        date: datetime | None,
        *,
        fast: bool,
    ) -> None:
        self.table, self.columns, self.date, self.fast = table, columns, date, fast
        self.doubts = table.doubts

    def read(self) -> Times | None:
        """Times of the rows, the best scale first; None if the table has no time.

        Raises
        ------
        InputError
            A clock whose unit cannot be told, or a date that cannot be read.
        """
        boot = self._clock("boot_time")
        absolute = self._gps()
        if absolute is None and "utc" in self.columns:
            absolute = self._utc()
        if absolute is None and "unix_time" in self.columns:
            absolute = Times(value=gps_of_unix(self._required("unix_time")), scale="gps")
        if absolute is None and "time" in self.columns:
            absolute = self._plain(self._required("time"))
        elif boot is None and "time" in self.columns:
            boot = self._clock("time")
        if absolute is None:
            return None if boot is None else Times(value=boot, scale="boot")
        if absolute.scale == "boot" and boot is not None:
            return Times(value=boot, scale="boot")
        return Times(
            value=absolute.value, scale=absolute.scale, boot=boot, needs_week=absolute.needs_week
        )

    def _gps(self) -> Times | None:
        if "tow" in self.columns:
            tow = self._tow()
            if "gps_week" in self.columns:
                return Times(value=self._with_week(tow), scale="gps")
            return self._without_week(tow)
        if "gps_time" not in self.columns:
            return None
        value = self._required("gps_time")
        known = value[np.isfinite(value)]
        if len(known) and known.max() <= GPS_WEEK:
            return self._without_week(value)
        return Times(value=value, scale="gps")

    def _with_week(self, tow: Array) -> Array:
        """GPS seconds of week and time of week; a stale week at the turn is mended."""
        week = self.table.numbers(self.columns["gps_week"].index)
        week = self._without_placeholders(week)
        week, turns = resolve_week(week, self.date)
        if turns:
            by = "the date given" if self.date else "today's date"
            self.doubts.append(
                f"gps_week rolled over: {turns * ROLLOVER_WEEKS:+d} weeks by {by}; state date in "
                "[logs.columns] if it is another"
            )
        value = week * GPS_WEEK + tow
        steps = np.diff(value[np.isfinite(value)])
        if np.any((steps < -0.5 * GPS_WEEK) & (steps > -1.01 * GPS_WEEK)):
            self.doubts.append(
                "the week does not change where the time of week begins again; mended"
            )
            return unwrap_week(value)
        return np.asarray(value)

    def _without_placeholders(self, week: Array) -> Array:
        """Weeks without the zeros that a receiver writes before it knows the week."""
        known = week[np.isfinite(week) & (week != 0.0)]
        void = week == 0.0
        if not len(known) or np.median(known) < 2.0 or not void.any():
            return week
        self.doubts.append(
            f"{int(void.sum())} rows have week 0, before the week was known; left out"
        )
        return np.where(void, np.nan, week)

    def _without_week(self, tow: Array) -> Times:
        value = unwrap_week(tow)
        if self.date is None:
            self.doubts.append(
                "the time of week has no week: that of another log is taken, or state date in "
                '[logs.columns], such as date = "2026-06-30"'
            )
            return Times(value=value, scale="gps", needs_week=True)
        return Times(value=value + week_start(value, self.date), scale="gps")

    def _tow(self) -> Array:
        """Time of week, s; ms are told by values beyond a week, or by steps."""
        column = self.columns["tow"]
        raw = self.table.numbers(column.index)
        known = raw[np.isfinite(raw)]
        if column.unit is not None:
            tow = raw * column.unit.factor
        elif len(known) and known.max() > GPS_WEEK + 1.0:
            tow = raw * 1e-3
        else:
            whole = bool(len(known)) and bool(np.all(known == np.round(known)))
            told = tell_time_unit(raw, fast=self.fast) if whole else None
            tow = raw * (told.factor if told else 1.0)
        known = tow[np.isfinite(tow)]
        if len(known) and (known.max() > GPS_WEEK + 1.0 or known.min() < 0.0):
            raise InputError(
                f"{known.max():.3f} s is no time of week (0 to 604800 s); check the unit, such as "
                f'tow = "{column.header}:ms"',
                source=self.table.source,
                field=column.header,
            )
        return np.asarray(tow)

    def _clock(self, target: str) -> Array | None:
        """Clock of unknown zero, s; None if there is none or it is no such clock."""
        if target not in self.columns:
            return None
        if target == "time" and self._unit(target) is None:
            return None
        value = self._required(target)
        known = value[np.isfinite(value)]
        return None if len(known) and known.min() >= _UNIX_FROM else value

    def _required(self, target: str) -> Array:
        """Values of a clock in s; the unit as stated, else as told by its steps."""
        column = self.columns[target]
        raw = unwrap_counter(self.table.numbers(column.index))
        unit = self._unit(target)
        if unit is None:
            raise InputError(
                "the unit of this time cannot be told; map it in [logs.columns] or by --map, such "
                f"as --map '{target} = {column.header}:ms' (s, ms, us, ns)",
                source=self.table.source,
                field=column.header,
            )
        return np.asarray(raw * unit.factor * column.sign)

    def _unit(self, target: str) -> Unit | None:
        """Unit of a clock as stated, else as told by its size or steps."""
        column = self.columns[target]
        if column.unit is not None:
            return column.unit
        raw = unwrap_counter(self.table.numbers(column.index))
        return self._unit_by_size(raw, target) or tell_time_unit(raw, fast=self.fast)

    @staticmethod
    def _unit_by_size(raw: Array, target: str) -> Unit | None:
        """Unit of a Unix clock by its size, which no other unit reaches in our century."""
        known = raw[np.isfinite(raw)]
        if target != "unix_time" or not len(known):
            return None
        for name in ("s", "ms", "us", "ns"):
            unit = unit_of(name, "time")
            if unit and _UNIX_FROM < float(np.median(known)) * unit.factor < _UNIX_TO:
                return unit
        return None

    def _plain(self, value: Array) -> Times:
        """A clock called `time` only: Unix if its size says so, else of unknown zero."""
        known = value[np.isfinite(value)]
        if len(known) and _UNIX_FROM < float(np.median(known)) < _UNIX_TO:
            self.doubts.append(
                f"column {self.columns['time'].header} is taken as Unix time (UTC) by its size; "
                "map gps_time if it is GPS seconds"
            )
            return Times(value=gps_of_unix(value), scale="gps")
        return Times(value=value, scale="boot")

    def _utc(self) -> Times:
        """UTC from text: ISO 8601 or the format stated, with a date column or a date given."""
        column = self.columns["utc"]
        text = self.table.texts(column.index)
        form = column.format
        if "utc_date" in self.columns:
            dates = self.table.texts(self.columns["utc_date"].index)
            date_form = self.columns["utc_date"].format
            text = [f"{d}T{t}" if d and t else "" for d, t in zip(dates, text, strict=True)]
            form = f"{date_form or '%Y-%m-%d'}T{form or '%H:%M:%S.%f'}" if form or date_form else ""
        elif any(t and ("-" not in t and "/" not in t and not form) for t in text[:5]):
            if self.date is None:
                raise InputError(
                    f"'{text[0]}' has no date; state one, such as date = \"2026-06-30\" in "
                    "[logs.columns]",
                    source=self.table.source,
                    field=column.header,
                )
            value = unwrap_day(_unix_of([f"1970-01-01T{t}" if t else "" for t in text], "", self))
            return Times(value=gps_of_unix(value + day_start(value, self.date)), scale="gps")
        return Times(value=gps_of_unix(_unix_of(text, form, self)), scale="gps")


def _unix_of(text: list[str], form: str, reader: TimeReader) -> Array:
    """Unix seconds of dates and times; NaN where a cell holds none."""
    pd = pandas()
    header = reader.columns["utc"].header
    cells = pd.Series(text, dtype="string").str.replace(",", ".", regex=False)
    cells = cells.str.replace("/", "-", regex=False) if not form else cells
    stamps = pd.to_datetime(
        cells.where(cells != ""), format=form or "ISO8601", utc=True, errors="coerce"
    )
    wrong = np.asarray(stamps.isna() & (cells != ""), dtype=bool)
    if wrong.sum() > len(wrong) / 2:
        raise InputError(
            f"'{text[int(np.flatnonzero(wrong)[0])][:40]}' is no date and time of ISO 8601; state "
            f"its format, such as --map 'utc = {header}:%m/%d/%Y %H:%M:%S.%f'",
            source=reader.table.source,
            field=header,
        )
    if wrong.any():
        reader.doubts.append(f"column {header}: {int(wrong.sum())} cells are no times; left out")
    if (
        not any(t.endswith(("Z", "z")) or "+" in t for t in text[:5])
        and "utc" not in header.lower()
    ):
        reader.doubts.append(f"column {header} states no zone; taken as UTC")
    naive = stamps.dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")
    seconds = naive.astype(np.int64) / 1e9
    return np.asarray(np.where(np.isnat(naive), np.nan, seconds))


def unwrap_day(seconds: Array) -> Array:
    """Times of day in order of record without the falls at midnight, s."""
    out = seconds.copy()
    good = np.flatnonzero(np.isfinite(seconds))
    turns = np.concatenate([[0.0], np.cumsum(-np.round(np.diff(seconds[good]) / 86400.0))])
    out[good] += turns * 86400.0
    return out


def day_start(seconds: Array, date: datetime) -> float:
    """Unix instant of the midnight before the first time of day, nearest to a date; s."""
    known = seconds[np.isfinite(seconds)]
    first = float(known[0]) if len(known) else 0.0
    goal = date.astimezone(UTC)
    if (goal.hour, goal.minute, goal.second) == (0, 0, 0):
        return goal.timestamp()
    return round((goal.timestamp() - first) / 86400.0) * 86400.0


def week_start(tow: Array, date: datetime) -> float:
    """GPS seconds of the start of the week of the first time of week, nearest to a date; s.

    A date without a time of day is that whole day: its middle counts.
    """
    known = tow[np.isfinite(tow)]
    first = float(known[0]) if len(known) else 0.0
    middle = 43200.0 if (date.hour, date.minute, date.second) == (0, 0, 0) else 0.0
    return round((gps_from_utc(date) + middle - first) / GPS_WEEK) * GPS_WEEK
