"""What the user says about the columns of text logs: `[logs.columns]` and `--map`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.column_names import TARGETS
from georef_gis.ingest.logs.column_units import Unit, unit_of

EVENT_KINDS = ("feedback", "trigger", "sync_board")
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " ", "blanks": " "}
_OPTIONS = ("axes", "date", "delimiter", "decimal", "events")
# Directions of body axes (forward, right, down) as words.
_DIRECTIONS = {
    "forward": (1, 0, 0), "front": (1, 0, 0), "back": (-1, 0, 0), "backward": (-1, 0, 0),
    "right": (0, 1, 0), "left": (0, -1, 0), "down": (0, 0, 1), "up": (0, 0, -1),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec:
    """Where a quantity stands, as the user says: `[-]NAME[:unit]`.

    Parameters
    ----------
    column
        Header, or `#3` for the third column.
    unit
        None where the user states none.
    sign
        -1 for a leading minus.
    format
        Format of a date and time, such as `%d.%m.%Y %H:%M:%S.%f`; "" for ISO 8601.
    """

    column: str
    unit: Unit | None = None
    sign: float = 1.0
    format: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMap:
    """What the user says about the columns of text logs.

    Parameters
    ----------
    columns
        Quantity -> where it stands.
    axes
        Where the sensor's x, y and z point, such as "forward-left-up"; "" = forward-right-down.
    date
        An instant near the flight; for week roll-over and times without a date.
    delimiter, decimal
        "" = told from the file.
    events
        Kind of the events of a table that does not say: one of `EVENT_KINDS`.
    files
        Pattern of file names -> mapping for these files only; it goes before the common one.
    """

    columns: Mapping[str, ColumnSpec] = field(default_factory=dict)
    axes: str = ""
    date: datetime | None = None
    delimiter: str = ""
    decimal: str = ""
    events: str = ""
    files: Mapping[str, ColumnMap] = field(default_factory=dict)

    @classmethod
    def from_mapping(
        cls, block: Mapping[str, object], *, source: str = "[logs.columns]"
    ) -> ColumnMap:
        """Mapping of a block of project.toml: quantity or option -> text; file -> such a block.

        Raises
        ------
        InputError
            An unknown quantity, option, unit or value.
        """
        columns: dict[str, ColumnSpec] = {}
        options: dict[str, str] = {}
        files: dict[str, ColumnMap] = {}
        for key, value in block.items():
            if isinstance(value, Mapping):
                files[key] = cls.from_mapping(value, source=f'{source[:-1]}."{key}"]')
            elif key in _OPTIONS:
                options[key] = str(value).strip()
            elif key in TARGETS:
                columns[key] = parse_spec(str(value), key, source)
            else:
                raise InputError(f"unknown quantity{_nearest(key)}", source=source, field=key)
        return cls(columns=columns, files=files, **_checked(options, source))

    @classmethod
    def from_strings(cls, texts: Iterable[str], *, source: str = "--map") -> ColumnMap:
        """Mapping of `QUANTITY=COLUMN[:unit]` texts; `FILE/QUANTITY=...` for one file only.

        Raises
        ------
        InputError
            A text of another form, or as `from_mapping`.
        """
        block: dict[str, object] = {}
        for text in texts:
            target, equals, column = text.partition("=")
            if not equals or not column.strip():
                raise InputError(
                    f"'{text}' is not QUANTITY=COLUMN[:unit]; write e.g. gyro_x=GyroX:deg/s",
                    source=source,
                )
            file, _, name = target.strip().rpartition("/")
            place = block.setdefault(file, {}) if file else block
            if isinstance(place, dict):
                place[name.strip()] = column.strip()
        return cls.from_mapping(block, source=source)

    def merged(self, other: ColumnMap) -> ColumnMap:
        """This mapping with another's entries put before its own."""
        names = self.files.keys() | other.files.keys()
        files = {
            n: self.files.get(n, ColumnMap()).merged(other.files.get(n, ColumnMap()))
            for n in sorted(names)
        }
        return ColumnMap(
            columns={**self.columns, **other.columns},
            axes=other.axes or self.axes,
            date=other.date or self.date,
            delimiter=other.delimiter or self.delimiter,
            decimal=other.decimal or self.decimal,
            events=other.events or self.events,
            files=files,
        )

    def for_file(self, path: Path) -> ColumnMap:
        """What holds for one file."""
        own = replace(self, files={})
        for pattern, block in self.files.items():
            if fnmatch(path.name.lower(), pattern.lower()):
                own = own.merged(block)
        return own

    def R_body_from_sensor(self) -> Array:
        """Rotation of the sensor's axes to forward, right, down; shape (3, 3)."""
        if not self.axes:
            return np.eye(3)
        words = re.split(r"[\s,;/-]+", self.axes.strip().lower())
        return np.array([_DIRECTIONS[w] for w in words], dtype=np.float64).T


def parse_spec(text: str, target: str, source: str) -> ColumnSpec:
    """Column, sign and unit of `[-]NAME[:unit]`; the unit has to fit the quantity."""
    rest = text.strip()
    sign = -1.0 if rest.startswith("-") else 1.0
    rest = rest.lstrip("+-").strip()
    if TARGETS[target] == "text":
        column, _, form = rest.partition(":%")
        return ColumnSpec(column=column.strip(), format=f"%{form}" if form else "", text=text)
    column, colon, unit_text = rest.rpartition(":")
    unit = unit_of(unit_text, TARGETS[target]) if colon else None
    if unit is None and colon and TARGETS[target] not in {"count", "field"} and column:
        # The colon may belong to the name; `resolve` finds out and names the units otherwise.
        return ColumnSpec(column=rest, sign=sign, text=text)
    if not (column if unit else rest):
        raise InputError(f"'{text}' names no column", source=source, field=target)
    return ColumnSpec(column=column if unit else rest, unit=unit, sign=sign, text=text)


def _checked(options: Mapping[str, str], source: str) -> dict[str, Any]:
    """Options by name, each of a known value."""
    out: dict[str, Any] = dict(options)
    if options.get("axes"):
        _check_axes(options["axes"], source)
    if "date" in options:
        try:
            given = datetime.fromisoformat(options["date"])
        except ValueError as error:
            raise InputError(
                f"'{options['date']}' is no date; write e.g. 2026-06-30",
                source=source,
                field="date",
            ) from error
        out["date"] = given.replace(tzinfo=UTC) if given.tzinfo is None else given
    if "delimiter" in options:
        word = str(options["delimiter"])
        out["delimiter"] = DELIMITERS.get(word, word)
        if out["delimiter"] not in DELIMITERS.values():
            known = ", ".join(DELIMITERS)
            raise InputError(f"'{word}' is none of {known}", source=source, field="delimiter")
    if options.get("decimal", ".") not in {".", ","}:
        raise InputError("is '.' or ','", source=source, field="decimal")
    if options.get("events", EVENT_KINDS[0]) not in EVENT_KINDS:
        raise InputError(
            f"'{options['events']}' is none of {', '.join(EVENT_KINDS)}",
            source=source,
            field="events",
        )
    return out


def _check_axes(text: str, source: str) -> None:
    words = re.split(r"[\s,;/-]+", text.strip().lower())
    known = all(w in _DIRECTIONS for w in words) and len(words) == 3
    matrix = np.array([_DIRECTIONS[w] for w in words]) if known else np.zeros((3, 3))
    determinant = round(float(np.linalg.det(matrix)))
    if determinant == 1:
        return
    if determinant == -1:
        message = (
            f"'{text}' is left-handed: a rotation cannot do it; turn one axis by a sign, such as "
            'accel_z = "-az:g" and gyro_z = "-gz:deg/s"'
        )
    else:
        message = (
            f"'{text}' is not three directions of three axes; say where x, y and z point, such as "
            "forward-left-up (of forward, back, left, right, up, down)"
        )
    raise InputError(message, source=source, field="axes")


def _nearest(key: str) -> str:
    from difflib import get_close_matches

    close = get_close_matches(key, [*TARGETS, *_OPTIONS], n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else f"; one of {', '.join(TARGETS)}"
