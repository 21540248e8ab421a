"""The project database: a GeoPackage 1.3 by plain sqlite3, which opens in QGIS as it is.

The journal mode stays DELETE: the project is one file that is copied about and opened by QGIS,
and with WAL a copy or a killed process leaves half of the truth in a second file. Readers wait
for a commit only.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from types import TracebackType
from typing import Any, Self

from georef_gis.errors import InputError
from georef_gis.project import geopackage
from georef_gis.project.fingerprint import portable_path
from georef_gis.project.geometry import from_blob, geometry_type, to_blob
from georef_gis.project.schema import SCHEMA_NUMBER, TABLES, Table
from georef_gis.project.spatial_index import add_functions

# s; a commit of another program, such as QGIS, may take this long
BUSY_TIMEOUT = 30.0
Row = dict[str, Any]
# What to do, by a word of SQLite's message.
CURES = {
    "disk is full": "free some space",
    "readonly": "check the permission to write",
    "unable to open": "check the permission to write",
    "locked": "close other programs that have it open",
    "": "move it away and run again",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Srs:
    """A CRS as a GeoPackage states it.

    Parameters
    ----------
    code
        EPSG code; None for a CRS that has none, which is told apart by its WKT.
    """

    name: str
    wkt: str
    code: int | None = None
    description: str = ""


class Database:
    """Connection to ``georef.gpkg``; a context manager that closes it.

    One connection, guarded by a lock, for all threads of a process; other processes open their
    own.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self.path = path
        self.read_only = read_only
        self._lock = RLock()
        self._depth = 0
        try:
            self._connection = self._connect()
            self._check()
        except sqlite3.Error as error:
            raise self._refusal(error) from error

    def _connect(self) -> sqlite3.Connection:
        if self.read_only and not self.path.exists():
            raise InputError("there is no project database yet; run `georef run` first",
                             source=str(self.path))  # fmt: skip
        mode = "ro" if self.read_only else "rwc"
        connection = sqlite3.connect(
            f"{self.path.absolute().as_uri()}?mode={mode}",
            uri=True,
            timeout=BUSY_TIMEOUT,
            isolation_level=None,
            check_same_thread=False,
        )
        connection.row_factory = sqlite3.Row
        add_functions(connection)
        return connection

    def _check(self) -> None:
        try:
            self._check_schema()
            if not self.read_only:
                self._leave_wal()
        except BaseException:
            self._connection.close()
            raise

    def _check_schema(self) -> None:
        names = geopackage.table_names(self._connection)
        if not names and not self.read_only:
            with self.transaction():
                geopackage.create(self._connection, TABLES.values())
                self.set_meta(schema=SCHEMA_NUMBER)
            return
        number = self.meta("schema") if "meta" in names else None
        if number is None:
            raise InputError("is no georef project database; move it away", source=str(self.path))
        if number > SCHEMA_NUMBER:
            raise InputError(
                f"schema {number} is newer than {SCHEMA_NUMBER}, the newest this georef_gis "
                "knows; update georef_gis",
                source=str(self.path),
            )

    def _leave_wal(self) -> None:
        """Go back to one file, if QGIS left the database in WAL mode and nobody uses it."""
        if self._connection.execute("PRAGMA journal_mode").fetchone()[0] != "wal":
            return
        self._connection.execute("PRAGMA busy_timeout = 0")
        with contextlib.suppress(sqlite3.OperationalError):
            self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.execute(f"PRAGMA busy_timeout = {int(1000 * BUSY_TIMEOUT)}")

    def _refusal(self, error: sqlite3.Error) -> InputError:
        words = str(error)
        cure = next((cure for word, cure in CURES.items() if word in words), CURES[""])
        return InputError(f"cannot be used ({words}); {cure}", source=str(self.path))

    def __enter__(self) -> Self:
        """Give the open database."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """All writes inside happen, or none; may be nested."""
        with self._lock:
            if self._depth == 0:
                self._execute("BEGIN IMMEDIATE")
            self._depth += 1
            try:
                yield
            except BaseException:
                if self._depth == 1 and self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
            else:
                if self._depth == 1:
                    self._execute("COMMIT")
            finally:
                self._depth -= 1

    def _execute(self, sql: str, values: Any = ()) -> sqlite3.Cursor:
        try:
            with self._lock:
                return self._connection.execute(sql, values)
        except sqlite3.OperationalError as error:
            raise self._refusal(error) from error
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.IntegrityError | sqlite3.ProgrammingError):
                raise
            raise self._refusal(error) from error

    # Facts

    def meta(self, key: str, default: Any = None) -> Any:
        """Fact of the project by its key."""
        row = self._execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return default if row is None else json.loads(row[0])

    def set_meta(self, **facts: Any) -> None:
        """Set facts of the project: JSON-able values."""
        sql = (
            "INSERT INTO meta (key, value) VALUES (?, ?) "
            "ON CONFLICT (key) DO UPDATE SET value = excluded.value"
        )
        with self.transaction():
            for key, value in facts.items():
                self._execute(sql, (key, json.dumps(value)))

    @property
    def srs_id(self) -> int:
        """Number of the project CRS within this file; 0 or -1 while there is none."""
        return int(self.meta("srs_id", -1))

    def set_crs(self, srs: Srs) -> int:
        """Make a CRS that of all feature layers, and give its number in this file.

        If it differs from the one before, the features there are deleted: they would lie wrong.
        """
        with self.transaction():
            srs_id = geopackage.add_srs(self._connection, srs.name, srs.wkt, srs.code,
                                        srs.description)  # fmt: skip
            if srs_id == self.srs_id:
                return srs_id
            for table in TABLES.values():
                if table.geometry:
                    self._execute(f"DELETE FROM {table.name}")
            geopackage.set_layer_srs(self._connection, srs_id)
            self.set_meta(srs_id=srs_id, crs_wkt=srs.wkt)
        return srs_id

    # Rows

    def replace_rows(
        self, table: str, rows: Iterable[Mapping[str, Any]], where: Mapping[str, Any] | None = None
    ) -> int:
        """Put rows in place of those that `where` selects (all of the table without it).

        Parameters
        ----------
        rows
            Column -> value; JSON columns take lists and dicts, "geom" takes WKB in the project
            CRS. Columns left out are NULL.
        where
            Column -> value of the rows to go.

        Returns
        -------
        int
            Number of rows put in.
        """
        with self.transaction():
            self.delete_rows(table, where)
            return self.add_rows(table, rows)

    def add_rows(self, table: str, rows: Iterable[Mapping[str, Any]]) -> int:
        """Add rows; a row with the key of one that is there takes its place."""
        declared, srs_id, count = _table(table), self.srs_id, 0
        with self.transaction():
            for row in rows:
                values = self._encode(declared, row, srs_id)
                self._execute(_upsert(declared, tuple(values)), tuple(values.values()))
                count += 1
            geopackage.touch(self._connection, declared)
        return count

    def delete_rows(self, table: str, where: Mapping[str, Any] | None = None) -> None:
        """Delete the rows that `where` selects; all without it."""
        condition, values = _condition(_table(table), where)
        with self.transaction():
            self._execute(f"DELETE FROM {table}{condition}", values)
            geopackage.touch(self._connection, _table(table))

    def rows(
        self, table: str, where: Mapping[str, Any] | None = None, order: str = ""
    ) -> list[Row]:
        """Rows that `where` selects, as written; JSON is decoded, "geom" is WKB or None.

        Paths are absolute; those of files in the project's folder are right after it was moved.

        Each has its "fid" too. The order is that of writing unless a column is named.
        """
        declared = _table(table)
        condition, values = _condition(declared, where)
        by = order if order in declared.columns else "fid"
        found = self._execute(f"SELECT * FROM {table}{condition} ORDER BY {by}", values)
        return [_decode(declared, row, self.path) for row in found.fetchall()]

    def last_rows(self, table: str, column: str) -> list[Row]:
        """Last row written for each value of a column."""
        declared = _table(table)
        if column not in declared.columns:
            raise ValueError(f"table {table} has no column {column!r}")
        found = self._execute(
            f'SELECT * FROM {table} WHERE fid IN (SELECT max(fid) FROM {table} GROUP BY "{column}")'
        )
        return [_decode(declared, row, self.path) for row in found.fetchall()]

    def count(self, table: str, where: Mapping[str, Any] | None = None) -> int:
        """Number of rows that `where` selects."""
        condition, values = _condition(_table(table), where)
        found = self._execute(f"SELECT count(*) FROM {table}{condition}", values).fetchone()
        return int(found[0])

    def insert(self, table: str, row: Mapping[str, Any]) -> int:
        """Add one row and give its number (fid)."""
        declared = _table(table)
        values = self._encode(declared, row, self.srs_id)
        with self.transaction():
            cursor = self._execute(_upsert(declared, tuple(values)), tuple(values.values()))
            return int(cursor.lastrowid or 0)

    def update(self, table: str, fid: int, **values: Any) -> None:
        """Change columns of one row."""
        encoded = self._encode(_table(table), values, self.srs_id)
        columns = ", ".join(f'"{column}" = ?' for column in encoded)
        with self.transaction():
            self._execute(f"UPDATE {table} SET {columns} WHERE fid = ?", (*encoded.values(), fid))

    def _encode(self, table: Table, row: Mapping[str, Any], srs_id: int) -> Row:
        values: Row = {}
        for column, value in row.items():
            if column == "geom" and table.geometry:
                values["geom"] = None if value is None else _blob(table, value, srs_id)
            elif column not in table.columns:
                known = ", ".join(table.columns)
                raise ValueError(f"table {table.name} has no column {column!r}; it has {known}")
            elif table.columns[column] == "JSON" and value is not None:
                values[column] = json.dumps(value, default=_plain)
            elif table.columns[column] == "PATH" and value is not None:
                values[column] = _portable(str(value), self.path)
            else:
                values[column] = _plain(value)
        return values


def _table(name: str) -> Table:
    if name not in TABLES:
        raise ValueError(f"no table {name!r}; there are {', '.join(TABLES)}")
    return TABLES[name]


def _blob(table: Table, wkb: bytes, srs_id: int) -> bytes:
    kind, has_z = geometry_type(wkb)
    if kind != table.geometry or (has_z and not table.has_z):
        raise ValueError(f"table {table.name} holds {table.geometry}, not {kind} (z: {has_z})")
    return to_blob(wkb, srs_id)[0]


def _plain(value: Any) -> Any:
    """What sqlite can hold: numbers of numpy and paths are turned into Python's own."""
    if value is None or isinstance(value, int | float | str | bytes):
        # A missing number is NULL in a file, NaN only in arrays.
        return None if isinstance(value, float) and value != value else value
    return value.item() if hasattr(value, "item") else str(value)


def _upsert(table: Table, columns: tuple[str, ...]) -> str:
    names = ", ".join(f'"{column}"' for column in columns)
    marks = ", ".join("?" for _ in columns)
    sql = f"INSERT INTO {table.name} ({names}) VALUES ({marks})"
    if not table.key:
        return sql
    key = ", ".join(table.key)
    every = [*table.columns, *(["geom"] if table.geometry else [])]
    others = [column for column in every if column not in table.key]
    changes = ", ".join(
        f'"{column}" = ' + (f'excluded."{column}"' if column in columns else "NULL")
        for column in others
    )
    return f"{sql} ON CONFLICT ({key}) DO UPDATE SET {changes}"


def _condition(table: Table, where: Mapping[str, Any] | None) -> tuple[str, tuple[Any, ...]]:
    if not where:
        return "", ()
    for column in where:
        if column not in table.columns and column != "fid":
            raise ValueError(f"table {table.name} has no column {column!r}")
    terms = " AND ".join(f'"{column}" IS ?' for column in where)
    return f" WHERE {terms}", tuple(where.values())


def _portable(given: str, database: Path) -> str:
    """Path relative to the database's folder if it lies there; a relative one is that already."""
    folder = database.absolute().parent
    return portable_path(Path(given), folder) if Path(given).is_absolute() else given


def _decode(table: Table, row: sqlite3.Row, database: Path) -> Row:
    values: Row = dict(row)
    for column, kind in table.columns.items():
        if kind == "JSON" and values[column] is not None:
            values[column] = json.loads(values[column])
        elif kind == "PATH" and values[column] is not None:
            values[column] = str(database.absolute().parent / values[column])
    if table.geometry and values["geom"] is not None:
        values["geom"] = from_blob(values["geom"])
    return values
