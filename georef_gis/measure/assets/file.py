"""The file ``assets.gpkg``: transactions that happen whole or not at all, and rows of its layers.

Users have it open in QGIS while it is written here. A GIS that only looks at it does not mind; one
that is just saving holds it for moments, which are waited for; one that holds it for long is named.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from threading import RLock
from typing import Any

from georef_gis.errors import InputError
from georef_gis.measure.assets.domain import Domain
from georef_gis.measure.assets.field_domains import enter_classes
from georef_gis.measure.assets.layout import (
    at_once,
    checked_srs,
    is_whole,
    lay_out,
    make_whole,
)
from georef_gis.measure.assets.tables import Row, blob_of, wkb_in
from georef_gis.project.asset_layers import ASSETS_FILE
from georef_gis.project.database import CURES, Srs
from georef_gis.project.geometry import Bounds
from georef_gis.project.geopackage import table_names
from georef_gis.project.spatial_index import add_functions

__all__ = ["ASSETS_FILE", "WAIT", "AssetFile"]

# s; a GIS that is saving holds the file no longer
WAIT = 5.0


class AssetFile:
    """Connection to the file, made on first use; one for all threads of a process.

    Parameters
    ----------
    srs
        Project CRS.
    wait
        How long to wait for other programs, s.
    """

    def __init__(self, path: Path, srs: Srs, domain: Domain, *, wait: float = WAIT) -> None:
        self.path = path
        self.wait = wait
        self.srs_id = -1
        self._srs = srs
        self._domain = domain
        self.mutex = RLock()
        self._depth = 0
        self._connection: sqlite3.Connection | None = None
        self._inode: tuple[int, int] | None = None
        self._opened = 0

    def close(self) -> None:
        """Close the connection."""
        with self.mutex:
            if self._connection is not None:
                self._connection.close()
                self._connection = None

    @property
    def in_transaction(self) -> bool:
        """Whether this thread, which holds the mutex, is inside a transaction."""
        return self._depth > 0

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """All writes inside happen, or none; may be nested.

        Raises
        ------
        InputError
            If the file cannot be written, or another program holds it for longer than `wait`.
        """
        with self.mutex, self._refusals():
            if self._depth:
                yield
                return
            with at_once(self._open()):
                self._depth = 1
                try:
                    yield
                finally:
                    self._depth = 0

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """One state of the file for all reads inside; needs no lock but that of the moment."""
        with self.mutex, self._refusals():
            if self._depth:
                yield
                return
            connection = self._open()
            connection.execute("BEGIN")
            try:
                yield
            finally:
                with contextlib.suppress(sqlite3.Error):
                    connection.execute("COMMIT")

    def execute(self, sql: str, values: Any = ()) -> sqlite3.Cursor:
        """Run a statement inside `transaction` or `reading`."""
        assert self._connection is not None, "outside of a transaction"
        return self._connection.execute(sql, values)

    def make_whole(self) -> None:
        """Put layers and columns back that another program took away; inside `transaction`."""
        assert self._connection is not None, "outside of a transaction"
        if not is_whole(self._connection):
            make_whole(self._connection, self._srs)

    def version(self) -> tuple[int, int]:
        """What is another when another connection wrote to the file; own writes leave it."""
        return self._opened, int(self.execute("PRAGMA data_version").fetchone()[0])

    # -- rows ------------------------------------------------------------------------------------

    def rows(self, layer: str) -> list[tuple[int, Row]]:
        """(fid, row) of a layer in the order of fids; the geometry as WKB."""
        cursor = self.execute(f"SELECT * FROM {layer} ORDER BY fid")
        names = [column[0] for column in cursor.description]
        return [_as_row(names, values) for values in cursor.fetchall()]

    def row(self, layer: str, fid: int) -> Row | None:
        """Row of a fid."""
        cursor = self.execute(f"SELECT * FROM {layer} WHERE fid = ?", (fid,))
        names = [column[0] for column in cursor.description]
        values = cursor.fetchone()
        return None if values is None else _as_row(names, values)[1]

    def write(self, layer: str, fid: int | None, row: Row) -> int:
        """Insert a row (under `fid` if that is free), or change that of `fid`; gives its fid."""
        blob, box = blob_of(row.get("geom"), self.srs_id)
        # A column that was removed meanwhile is made again at the next look.
        known = {c[1] for c in self.execute(f"PRAGMA table_info({layer})")}
        values = {key: value for key, value in row.items() if key in known} | {"geom": blob}
        names = [f'"{name.replace(chr(34), chr(34) * 2)}"' for name in values]
        there = fid is not None and self.row(layer, fid) is not None
        if there:
            pairs = ", ".join(f"{name} = ?" for name in names)
            self.execute(f"UPDATE {layer} SET {pairs} WHERE fid = ?", (*values.values(), fid))
        else:
            marks = ", ".join("?" * (len(names) + 1))
            fid = self.execute(
                f"INSERT INTO {layer} (fid, {', '.join(names)}) VALUES ({marks})",
                (fid, *values.values()),
            ).lastrowid
        self._touch(layer, box)
        assert fid is not None
        return fid

    def delete(self, layer: str, fid: int) -> None:
        """Delete the row of a fid."""
        self.execute(f"DELETE FROM {layer} WHERE fid = ?", (fid,))
        self._touch(layer, None)

    def _touch(self, layer: str, box: Bounds | None) -> None:
        """Note that a layer changed, and widen its bounds; to narrow them it had to be read."""
        west, south, east, north = box or (None, None, None, None)
        self.execute(
            "UPDATE gpkg_contents SET last_change = strftime('%Y-%m-%dT%H:%M:%fZ','now'), "
            "min_x = coalesce(min(min_x, ?), min_x, ?), min_y = coalesce(min(min_y, ?), min_y, ?), "
            "max_x = coalesce(max(max_x, ?), max_x, ?), max_y = coalesce(max(max_y, ?), max_y, ?) "
            "WHERE table_name = ?",
            (west, west, south, south, east, east, north, north, layer),
        )

    # -- opening ---------------------------------------------------------------------------------

    def _open(self) -> sqlite3.Connection:
        # A file that was put in its place is another one: writes to the old would be lost.
        inode = _inode(self.path)
        if self._connection is not None and inode is not None and inode == self._inode:
            return self._connection
        self.close()
        connection = sqlite3.connect(
            self.path, timeout=self.wait, isolation_level=None, check_same_thread=False
        )
        try:
            add_functions(connection)
            if not table_names(connection):
                lay_out(connection, self._srs)
            _leave_wal(connection, self.wait)
            # A file that is held or may not be written can be read all the same.
            with contextlib.suppress(sqlite3.OperationalError):
                if not is_whole(connection):
                    with at_once(connection):
                        make_whole(connection, self._srs)
            self.srs_id = checked_srs(connection, self._srs, str(self.path))
            with contextlib.suppress(sqlite3.OperationalError):
                enter_classes(connection, self._domain)
        except BaseException:
            connection.close()
            raise
        self._connection, self._inode = connection, _inode(self.path)
        self._opened += 1
        return connection

    @contextlib.contextmanager
    def _refusals(self) -> Iterator[None]:
        """Errors of SQLite and of the system as one line with a cure."""
        try:
            yield
        except sqlite3.Error as error:
            words = str(error)
            cure = next((cure for word, cure in CURES.items() if word in words), "")
            if "locked" in words or "busy" in words:
                raise InputError(
                    "is held by another program, such as QGIS, which is editing it (waited "
                    f"{self.wait:g} s); save or end the editing there, then try again",
                    source=str(self.path),
                ) from error
            if "not a database" in words or "malformed" in words:
                cure = "put a copy in its place, or move it away, then a new one is made"
            raise InputError(f"cannot be used ({words}); {cure}", source=str(self.path)) from error
        except OSError as error:
            raise InputError(
                f"cannot be used ({error.strerror}); check the permission and the free space",
                source=str(self.path),
            ) from error


def _leave_wal(connection: sqlite3.Connection, wait: float) -> None:
    """Go back to one file, if a GIS left it in WAL mode and nobody uses it."""
    if connection.execute("PRAGMA journal_mode").fetchone()[0] != "wal":
        return
    connection.execute("PRAGMA busy_timeout = 0")
    with contextlib.suppress(sqlite3.OperationalError):
        connection.execute("PRAGMA journal_mode = DELETE")
    connection.execute(f"PRAGMA busy_timeout = {int(1000 * wait)}")


def _inode(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _as_row(names: list[str], values: tuple[Any, ...]) -> tuple[int, Row]:
    row = dict(zip(names, values, strict=True))
    fid = int(row.pop("fid"))
    row["geom"] = wkb_in(row.get("geom"))
    return fid, row
