"""Exporter to a PostGIS database."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from pydantic import field_validator

from exports.tables.table_export import SpatialOptions, asked_layers, chosen_layers, report_of
from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox import ExportReport, Feedback, LayerSource, Sender
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    import psycopg

# s; a server that does not answer, a table that another program keeps locked
CONNECT_S, LOCK_S = 10, 30
_NAME = re.compile(r"^[a-z_][a-z0-9_]{0,62}$")
# password=..., sslpassword=..., and user:password@ of an address
_SECRET = re.compile(r"(?i)(?:^|[\s?&])(?:ssl)?password\s*=|^\w+://[^@?]*:[^@?]*@")


class PostGisOptions(SpatialOptions):
    """Where to, and how."""

    connection: p.Text = p.text(
        "", title="Connection", help="As libpq takes it, without a password: service=gis, or "
        "host=server dbname=gis user=me, or postgresql://me@server/gis; empty = PGSERVICE, PGHOST "
        "and the like. Passwords come from ~/.pgpass, the service file or PGPASSWORD.",
    )  # fmt: skip
    database_schema: p.Text = p.text(
        "georef", title="Schema", help="Made if it is not there; a schema for each project."
    )
    overwrite: p.Flag = p.flag(
        False, title="Overwrite", help="Replace tables that an earlier export of this project "
        "made, and remove those of them whose layer is asked for and has no features now."
    )  # fmt: skip

    @field_validator("connection")
    @classmethod
    def _has_no_secret(cls, text: str) -> str:
        # the value itself must not be in the message
        if _SECRET.search(text):
            raise InputError(
                "holds a password, which would be recorded with the run; put it into ~/.pgpass, a "
                "service file or PGPASSWORD",
                field="connection",
            )
        return text

    @field_validator("database_schema")
    @classmethod
    def _is_plain_name(cls, text: str) -> str:
        if not _NAME.match(text) or text.startswith("pg_"):
            raise InputError(
                f"{text!r} is no name for a schema; use lower-case letters, digits and _, 63 at "
                "most, not beginning with a digit or pg_",
                field="database_schema",
            )
        return text


class PostGis(Sender[PostGisOptions]):
    """Layers as tables of a PostGIS database in the project CRS, all of them or none.

    A schema for each project, a table for each layer with a spatial index, comments that say what
    its columns mean, and a table `about`. Tables that are not of an earlier export of this project
    are never replaced, and those of layers that are not asked for stay. Needs psycopg:
    `pip install georef-gis[postgis]`.
    """

    id = "postgis"
    name = "PostGIS"
    accepts = ("site", "vector")
    needs = ("photos", "poses", "footprints")
    wants = ("adjusted", "control", "accuracy")

    def send(
        self, source: LayerSource, options: PostGisOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the tables in one transaction."""
        from exports.tables.vector_file import flat_warnings

        _need_psycopg()
        from exports.tables.postgis_tables import write_tables

        site, layers = chosen_layers(source, options)
        written = {layer.name for layer in layers}
        gone = tuple(name for name in asked_layers(source, options) if name not in written)
        with _connected(options.connection) as connection:
            place = _place(connection, options.database_schema)
            removed = write_tables(
                connection, site, layers, gone=gone, schema=options.database_schema,
                heights=options.heights, overwrite=options.overwrite, feedback=feedback,
            )  # fmt: skip
        told = [
            f"table {options.database_schema}.{name} of an earlier export was removed: its layer "
            "has no features now"
            for name in removed
        ]
        told += flat_warnings(layers, options.heights)
        report = report_of(site, layers, options.heights, told)
        for warning in report.warnings:
            feedback.warn(warning)
        return ExportReport(
            crs=report.crs, height_kind=report.height_kind, features=report.features,
            warnings=report.warnings, place=place,
        )  # fmt: skip


def _need_psycopg() -> None:
    try:
        import psycopg  # noqa: F401
    except ImportError as error:
        raise ExportError(
            "PostGIS needs psycopg, which is not installed; run "
            "`pip install georef-gis[postgis]`, or export GeoPackage"
        ) from error


@contextmanager
def _connected(connection: str) -> Iterator[psycopg.Connection[Any]]:
    """Connection whose one transaction ends with the block: kept, or undone on any error.

    Raises
    ------
    ExportError
        If the server cannot be reached, or refuses.
    """
    import psycopg

    words = {"application_name": "georef_gis"}
    if "connect_timeout" not in connection:
        words["connect_timeout"] = str(CONNECT_S)
    try:
        with psycopg.connect(connection, **words) as opened:  # type: ignore[arg-type]
            opened.execute(f"SET LOCAL lock_timeout = '{LOCK_S}s'")
            yield opened
    except psycopg.errors.LockNotAvailable as error:
        raise ExportError(
            f"PostGIS: another program has kept a table locked for {LOCK_S} s; end its editing "
            "and export again"
        ) from error
    except psycopg.Error as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise ExportError(
            f"PostGIS: {text}; nothing was written; check the connection and the rights there"
        ) from error


def _place(connection: psycopg.Connection[Any], schema: str) -> str:
    info = connection.info
    where = f"{info.host}:{info.port}" if info.host else "the local server"
    return f"database {info.dbname} on {where}, schema {schema}"
