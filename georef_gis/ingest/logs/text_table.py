"""A text log as a table: encoding, comments, delimiter, decimal sign, header, and its columns."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.ingest.logs.column_units import units_of

COMMENTS = ("#", "%", "//", "!")
# Cells that mean "no value".
MISSING = ("", "nan", "-nan", "nan(ind)", "null", "none", "na", "n/a", "-", "--", "---", "?", "*")
# bytes of the head that tell the layout
HEAD = 65536
# lines of a preamble before the data, at most
_PREAMBLE = 200
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eEdD][+-]?\d+)?$")
_DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?$|\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?Z?$")
_INFINITE = re.compile(r"[+-]?inf(inity)?$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How a text log is laid out.

    Parameters
    ----------
    encoding
        Of the text.
    delimiter
        " " for any number of blanks.
    decimal
        "." or ",".
    first
        Number of lines before the first row of data.
    headers, units
        One per column; "" where there is none.
    """

    encoding: str
    delimiter: str
    decimal: str
    first: int
    headers: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def has_header(self) -> bool:
        """Whether the columns have names."""
        return any(self.headers)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextTable:
    """Columns of a text log, and what is doubtful about its lines."""

    source: str
    layout: Layout
    rows: int
    frame: Any
    doubts: list[str] = field(default_factory=list)

    def is_numeric(self, index: int) -> bool:
        """Whether at least half of the filled cells of a column are numbers."""
        if self.frame.iloc[:, index].dtype.kind in "fiub":
            return True
        cells = [c for c in self.texts(index)[:200] if c]
        return sum(map(is_number, cells)) * 2 >= len(cells)

    def numbers(self, index: int) -> Array:
        """Column as numbers, NaN where a cell holds none; shape (rows,).

        Raises
        ------
        InputError
            If more than half of the filled cells are no numbers.
        """
        column = self.frame.iloc[:, index]
        if column.dtype.kind in "fiub":
            return np.asarray(column, dtype=np.float64)
        text = column.astype("string").str.strip()
        if self.layout.decimal == ",":
            text = text.str.replace(",", ".", regex=False)
        values = np.asarray(
            pandas()
            .to_numeric(text, errors="coerce")
            .astype("Float64")
            .to_numpy(dtype=np.float64, na_value=np.nan)
        )
        filled = ~text.isna() & ~text.str.lower().isin(MISSING)
        wrong = np.asarray(filled & np.isnan(values), dtype=bool)
        if wrong.sum() > filled.sum() / 2:
            raise InputError(
                f"'{str(text[wrong].iloc[0])[:40]}' is not a number (row "
                f"{int(np.flatnonzero(wrong)[0]) + 1} of the data); name another column in "
                "[logs.columns] or by --map",
                source=self.source,
                field=self.name(index),
            )
        if wrong.any():
            self.doubts.append(
                f"column {self.name(index)}: {int(wrong.sum())} cells are not numbers, such as "
                f"'{str(text[wrong].iloc[0])[:20]}'; taken as missing"
            )
        return values

    def texts(self, index: int) -> list[str]:
        """Column as text, "" where a cell is empty."""
        column = self.frame.iloc[:, index]
        return ["" if v is None or v != v else str(v).strip() for v in column.tolist()]

    def name(self, index: int) -> str:
        """Header of a column, or its number."""
        return self.layout.headers[index] or f"#{index + 1}"


def pandas() -> Any:
    """The library, imported late because that takes 0.3 s."""
    import pandas as pd

    return pd


def decode_head(head: bytes) -> tuple[str, str] | None:
    """Text of the head of a file and its encoding; None if the bytes are no text."""
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if head.startswith(mark):
            return head[: len(head) // 2 * 2].decode(encoding, "replace"), encoding
    controls = sum(head.count(c) for c in _CONTROLS)
    if controls > len(head) // 200:
        return None
    try:
        return head.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError as error:
        # The head may end within a letter.
        if error.start > len(head) - 4 and head[: error.start]:
            return head[: error.start].decode("utf-8-sig"), "utf-8-sig"
    high = sum(b >= 0x80 for b in head)
    return None if high > len(head) // 20 else (head.decode("latin-1"), "latin-1")


_CONTROLS = tuple(bytes([c]) for c in (*range(0, 9), *range(14, 27), *range(28, 32), 127))


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, or a word for a missing or infinite one."""
    cell = cell.strip()
    return bool(_NUMBER.match(cell) or _INFINITE.match(cell)) or (
        cell.lower() in MISSING and cell != ""
    )


def split_line(line: str, delimiter: str) -> list[str]:
    """Cells of a line."""
    if delimiter == " ":
        return next(csv.reader([" ".join(line.split())], delimiter=" "), [])
    return [c.strip() for c in next(csv.reader([line], delimiter=delimiter), [])]


def _is_data(cells: Sequence[str]) -> bool:
    """Whether cells are a row of data: at least half are numbers or dates, or empty."""
    filled = [c for c in cells if c]
    good = sum(is_number(c) or bool(_DATE.match(c)) for c in filled)
    return bool(filled) and good * 2 >= len(filled) and good > 0


def _delimiter_of(line: str) -> str:
    """Delimiter of a line of data or header."""
    for mark in (";", "\t"):
        if mark in line:
            return mark
    if "," not in line:
        return " "
    tokens = line.split()
    inner = all(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+", t) for t in tokens)
    return " " if inner and len(tokens) > 1 else ","


def _is_comment(line: str) -> bool:
    return line.lstrip('"').startswith(COMMENTS)


def find_layout(
    head: str, encoding: str, *, delimiter: str = "", decimal: str = ""
) -> Layout | None:
    """Layout of a text log by its first lines; None if there is no row of data in them."""
    lines = re.split(r"\r\n|\n|\r", head)
    for i, line in enumerate(lines[:_PREAMBLE]):
        if not line.strip() or _is_comment(line):
            continue
        mark = delimiter or _delimiter_of(line)
        cells = split_line(line, mark)
        if len(cells) < 2 or not _is_data(cells):
            continue
        following = [x for x in lines[i + 1 : i + 4] if x.strip() and not _is_comment(x)]
        # A line of numbers in a preamble is not followed by lines of the same kind.
        if following and abs(len(split_line(following[0], mark)) - len(cells)) > 1:
            continue
        headers, units = _headings(lines[:i], mark, len(cells))
        count = max(len(cells), len(headers))
        return Layout(
            encoding=encoding,
            delimiter=mark,
            decimal=decimal or _decimal_of([line, *following], mark),
            first=i,
            headers=tuple(headers) + ("",) * (count - len(headers)),
            units=tuple(units) + ("",) * (count - len(units)),
        )
    return None


def _decimal_of(lines: Sequence[str], delimiter: str) -> str:
    if delimiter == ",":
        return "."
    cells = [c for line in lines for c in split_line(line, delimiter)]
    commas = any(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", c) for c in cells)
    points = any(re.fullmatch(r"[+-]?\d*\.\d+([eE][+-]?\d+)?", c) for c in cells)
    return "," if commas and not points else "."


def _headings(before: Sequence[str], delimiter: str, count: int) -> tuple[list[str], list[str]]:
    """Headers and units from the lines before the data; a header may be a comment."""
    near = [x for x in before if x.strip()][-6:][::-1]
    units: list[str] = []
    for line in near:
        text = line.strip().lstrip("#%!/ ").rstrip() if _is_comment(line) else line
        for mark in dict.fromkeys((delimiter, _delimiter_of(text), " ")):
            cells = split_line(text, mark)
            if cells and cells[-1] == "" and len(cells) == count + 1:
                cells = cells[:-1]
            if abs(len(cells) - count) > 1 or not any(re.search("[A-Za-z]", c) for c in cells):
                continue
            if not units and _are_units(cells) and line is not near[-1]:
                units = cells
                break
            return cells, units
    return [], []


def _are_units(cells: Sequence[str]) -> bool:
    """Whether cells of a line are units, such as `sec,g,g,deg/s`."""
    inner = [c.strip("[]() ") for c in cells]
    filled = [c for c in inner if c]
    known = sum(bool(units_of(c)) for c in filled)
    return bool(filled) and known * 2 >= len(filled) and known >= 2


def read_table(path: Path, *, delimiter: str = "", decimal: str = "") -> TextTable:
    """Table of a text log.

    Parameters
    ----------
    path
        File.
    delimiter, decimal
        "" = told from the first lines.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, no text, or holds no rows of data.
    """
    raw = read_bytes(path)
    head = decode_head(raw[:HEAD])
    if head is None:
        raise InputError("is not a text file", source=str(path))
    layout = find_layout(head[0], head[1], delimiter=delimiter, decimal=decimal)
    if layout is None:
        raise InputError(
            "holds no rows of numbers; a text log has a header line and one row per sample",
            source=str(path),
        )
    return table_of(raw, layout, path)


def table_of(raw: bytes, layout: Layout, path: Path) -> TextTable:
    """Table of the bytes of a file with a known layout.

    Raises
    ------
    InputError
        If they cannot be read as a table.
    """
    doubts: list[str] = []
    frame = _parse(raw, layout, doubts, path)
    return TextTable(source=str(path), layout=layout, rows=len(frame), frame=frame, doubts=doubts)


def read_bytes(path: Path) -> bytes:
    """Bytes of a file.

    Raises
    ------
    InputError
        If it cannot be read or is empty.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    if not raw.strip(b"\x00 \r\n\t"):
        raise InputError("is empty; copy the log again", source=str(path))
    return raw


def _parse(raw: bytes, layout: Layout, doubts: list[str], path: Path) -> Any:
    pd = pandas()
    raw = _without_cut_line(raw, layout, doubts)
    count = len(layout.headers)
    options: dict[str, Any] = {
        "header": None,
        "names": list(range(count)),
        "skiprows": layout.first,
        "decimal": layout.decimal,
        "encoding": layout.encoding,
        "encoding_errors": "replace",
        "na_values": list(MISSING),
        "skipinitialspace": True,
        "on_bad_lines": "skip",
        "low_memory": False,
        "index_col": False,
    }
    options["sep"] = r"\s+" if layout.delimiter == " " else layout.delimiter
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            frame = pd.read_csv(io.BytesIO(raw), **options)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        raise InputError(
            f"cannot be read as a table ({str(error).splitlines()[0][:80]})", source=str(path)
        ) from error
    if any(issubclass(w.category, pd.errors.ParserWarning) for w in caught):
        doubts.append(f"rows have more than {count} cells; what lies beyond the header is left out")
    frame = _without_comments(frame)
    if layout.encoding != "utf-16":
        _count_lines(raw, layout, len(frame), doubts)
    return frame


def _without_comments(frame: Any) -> Any:
    """Rows whose first cell does not begin a comment."""
    first = frame.iloc[:, 0]
    if first.dtype.kind in "fiub":
        return frame
    comment = first.astype("string").str.strip().str.startswith(COMMENTS).fillna(False)
    return frame[~comment.astype(bool)].reset_index(drop=True) if comment.any() else frame


def _count_lines(raw: bytes, layout: Layout, rows: int, doubts: list[str]) -> None:
    """Doubt lines that no row came from: too many cells, or broken quotes."""
    lines = raw.splitlines()[layout.first :]
    marks = tuple(c.encode() for c in COMMENTS)
    held = sum(bool(line.strip()) and not line.lstrip(b' "').startswith(marks) for line in lines)
    if held > rows:
        doubts.append(
            f"{held - rows} of {held} lines have too many cells or broken quotes; left out"
        )


def _without_cut_line(raw: bytes, layout: Layout, doubts: list[str]) -> bytes:
    """Bytes without a last line that the logger did not finish."""
    if raw.endswith((b"\n", b"\r")) or layout.encoding == "utf-16":
        return raw
    tail = raw[-8192:].splitlines()
    if len(tail) < 4:
        return raw
    rows = [split_line(t.decode("latin-1"), layout.delimiter) for t in tail[-12:]]
    last, before = rows[-1], rows[1:-1]
    fewer = len(last) < min(len(r) for r in before if r)
    decimals = [len(r[-1].rpartition(".")[2]) if "." in r[-1] else -1 for r in (*before, last) if r]
    if fewer or decimals[-1] < min(decimals[:-1]):
        doubts.append("the last line is cut short; left out")
        return raw[: len(raw) - len(tail[-1])]
    return raw
