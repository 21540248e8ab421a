"""Tables of layers in a PostGIS database: made, filled by COPY, and known again."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, LiteralString

from psycopg import sql

from exports.tables.vector_file import Heights, geometry_type, wkb_batches
from georef_gis.errors import ExportError
from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    import psycopg

    from exports.site.columns import Column, Layer
    from exports.site.site import SiteLayers

    Connection = psycopg.Connection[Any]

TYPES: Mapping[str, LiteralString] = {
    "text": "text", "real": "double precision", "integer": "bigint", "flag": "boolean",
}  # fmt: skip
ABOUT = "about"
# Own numbers of CRSs without a code: the last block that PostGIS leaves to its users
FIRST_SRID, LAST_SRID = 990_000, 998_999
AUTHORITY = "georef_gis"
# Only one export at a time makes tables and numbers of CRSs
_LOCK = 7_281_961
_Z, _SRID = 0x80000000, 0x20000000
_ESCAPES = str.maketrans({"\\": "\\\\", "\t": "\\t", "\n": "\\n", "\r": "\\r"})


def write_tables(
    connection: Connection,
    site: SiteLayers,
    layers: Sequence[Layer],
    *,
    gone: Sequence[str] = (),
    schema: str,
    heights: Heights,
    overwrite: bool,
    feedback: Feedback,
) -> tuple[str, ...]:
    """Write layers to tables of a schema; the caller ends the transaction.

    Parameters
    ----------
    gone
        Names of layers without features now: their tables of an earlier export are removed.

    Returns
    -------
    tuple of str
        Those of `gone` that had such a table.

    Raises
    ------
    ExportError
        If the database has no PostGIS, or a table is there that may not be replaced.
    """
    connection.execute("SELECT pg_advisory_xact_lock(%s)", (_LOCK,))
    home = _postgis_schema(connection)
    srid = _srid(connection, home, site)
    connection.execute(sql.SQL("CREATE SCHEMA IF NOT EXISTS {}").format(sql.Identifier(schema)))
    mark = f"{AUTHORITY}: made from project {site.name!r}; "
    for number, layer in enumerate(layers):
        feedback.progress(number / len(layers), layer.name)
        _clear(connection, schema, layer.name, mark, overwrite=overwrite)
        _write_layer(connection, layer, (schema, home, srid), heights, mark, feedback)
    removed = tuple(name for name in gone if _is_ours(connection, schema, name, mark))
    for name in removed:
        _clear(connection, schema, name, mark, overwrite=overwrite)
    # what an earlier export of this project says of itself may always be replaced
    _clear(connection, schema, ABOUT, mark, overwrite=True)
    _write_about(connection, schema, site.metadata(), mark)
    return removed


# -- what is there -----------------------------------------------------------------------------


def _postgis_schema(connection: Connection) -> str:
    """Schema that PostGIS lives in."""
    row = connection.execute(
        "SELECT nspname FROM pg_extension JOIN pg_namespace n ON n.oid = extnamespace "
        "WHERE extname = 'postgis'"
    ).fetchone()
    if row is None:
        raise ExportError(
            f"PostGIS: database {connection.info.dbname} has no PostGIS; let its owner run "
            "`CREATE EXTENSION postgis`"
        )
    return str(row[0])


def _found(connection: Connection, schema: str, table: str) -> tuple[str, str] | None:
    """Kind and comment of a table or view; None if there is none."""
    row = connection.execute(
        "SELECT c.relkind, obj_description(c.oid, 'pg_class') FROM pg_class c "
        "JOIN pg_namespace n ON n.oid = c.relnamespace WHERE n.nspname = %s AND c.relname = %s",
        (schema, table),
    ).fetchone()
    return None if row is None else (row[0], row[1] or "")


def _is_ours(connection: Connection, schema: str, table: str, mark: str) -> bool:
    found = _found(connection, schema, table)
    return found is not None and found[0] == "r" and found[1].startswith(mark)


def _clear(connection: Connection, schema: str, table: str, mark: str, *, overwrite: bool) -> None:
    """Drop a table that an earlier export of this project made.

    Raises
    ------
    ExportError
        If it was made by someone else, or may not be overwritten.
    """
    if _found(connection, schema, table) is None:
        return
    name = f"PostGIS: {schema}.{table}"
    if not _is_ours(connection, schema, table, mark):
        raise ExportError(
            f"{name} is there and is not of an earlier export of this project; give another schema"
        )
    if not overwrite:
        raise ExportError(f"{name} is there from an earlier export; give overwrite to replace it")
    connection.execute(sql.SQL("DROP TABLE {}").format(sql.Identifier(schema, table)))


def _srid(connection: Connection, home: str, site: SiteLayers) -> int:
    """Number of the project's CRS in the database, which is entered if it has none.

    Raises
    ------
    ExportError
        If the CRS cannot be written as PostGIS needs it, or no number is free.
    """
    table = sql.Identifier(home, "spatial_ref_sys")
    authority = site.crs.to_authority(min_confidence=100)
    if authority and authority[1].isdigit():
        query = sql.SQL("SELECT srid FROM {} WHERE auth_name = %s AND auth_srid = %s").format(table)
        row = connection.execute(query, (authority[0], int(authority[1]))).fetchone()
        if row:
            return int(row[0])
    wkt = _wkt1(site)
    query = sql.SQL("SELECT srid FROM {} WHERE auth_name = %s AND srtext = %s").format(table)
    row = connection.execute(query, (AUTHORITY, wkt)).fetchone()
    if row:
        return int(row[0])
    query = sql.SQL(
        "SELECT coalesce(max(srid), %s) + 1 FROM {} WHERE srid BETWEEN %s AND %s"
    ).format(table)
    found = connection.execute(query, (FIRST_SRID - 1, FIRST_SRID, LAST_SRID)).fetchone()
    srid = int(found[0]) if found else FIRST_SRID
    if srid > LAST_SRID:
        raise ExportError(f"PostGIS: no number from {FIRST_SRID} to {LAST_SRID} is free for a CRS")
    with warnings.catch_warnings():
        # of a PROJ string, which PostGIS uses before the WKT: what it lacks is names
        warnings.simplefilter("ignore", UserWarning)
        proj = site.crs.to_proj4()
    connection.execute(
        sql.SQL("INSERT INTO {} VALUES (%s, %s, %s, %s, %s)").format(table),
        (srid, AUTHORITY, srid, wkt, proj),
    )
    return srid


def _wkt1(site: SiteLayers) -> str:
    try:
        wkt = site.crs.to_wkt("WKT1_GDAL")
    # PROJ's errors are of this kind
    except RuntimeError:
        wkt = None
    if not wkt:
        raise ExportError(
            f"PostGIS: CRS '{site.crs.name}' has no code and cannot be written as WKT 1, which "
            "spatial_ref_sys needs; give the project a CRS with an EPSG code, or export GeoPackage"
        )
    return str(wkt)


# -- tables ------------------------------------------------------------------------------------


def _write_layer(
    connection: Connection,
    layer: Layer,
    place: tuple[str, str, int],
    heights: Heights,
    mark: str,
    feedback: Feedback,
) -> None:
    schema, home, srid = place
    kind = "" if layer.geometry == "None" else geometry_type(layer, heights)
    shapes = wkb_batches(layer, heights) if kind else None
    table = sql.Identifier(schema, layer.name)
    columns = [
        sql.SQL("{} {}").format(sql.Identifier(f.name), sql.SQL(TYPES[f.kind]))
        for f in layer.fields
    ]
    names = [sql.Identifier(f.name) for f in layer.fields]
    if kind:
        shape = sql.SQL("{}.geometry({}, {})").format(
            sql.Identifier(home), sql.SQL(_SHAPES[kind]), sql.Literal(srid)
        )
        columns.append(sql.SQL("geom {}").format(shape))
        names.append(sql.Identifier("geom"))
    connection.execute(
        sql.SQL("CREATE TABLE {} (fid bigint GENERATED BY DEFAULT AS IDENTITY PRIMARY KEY, {})")
        .format(table, sql.SQL(", ").join(columns))
    )  # fmt: skip
    _copy(connection, table, names, _lines(layer, shapes, srid), feedback)
    if kind:
        connection.execute(sql.SQL("CREATE INDEX ON {} USING gist (geom)").format(table))
    _comment(connection, table, f"{mark}{layer.title}")
    for f in layer.fields:
        meaning = sql.Literal(f"{f.doc} [{f.unit}]" if f.unit else f.doc)
        statement = sql.SQL("COMMENT ON COLUMN {}.{} IS {}")
        connection.execute(statement.format(table, sql.Identifier(f.name), meaning))


_SHAPES: Mapping[str, LiteralString] = {
    "Point": "Point", "LineString": "LineString", "Polygon": "Polygon",
    "Point Z": "PointZ", "LineString Z": "LineStringZ", "Polygon Z": "PolygonZ",
}  # fmt: skip


def _write_about(connection: Connection, schema: str, facts: Mapping[str, str], mark: str) -> None:
    table = sql.Identifier(schema, ABOUT)
    connection.execute(sql.SQL("CREATE TABLE {} (key text PRIMARY KEY, value text)").format(table))
    with connection.cursor() as cursor:
        insert = sql.SQL("INSERT INTO {} VALUES (%s, %s)").format(table)
        cursor.executemany(insert, list(facts.items()))
    _comment(connection, table, f"{mark}what this schema holds")


def _comment(connection: Connection, table: sql.Identifier, text: str) -> None:
    connection.execute(sql.SQL("COMMENT ON TABLE {} IS {}").format(table, sql.Literal(text)))


def _copy(
    connection: Connection,
    table: sql.Identifier,
    names: Sequence[sql.Identifier],
    batches: Iterator[str],
    feedback: Feedback,
) -> None:
    statement = sql.SQL("COPY {} ({}) FROM STDIN").format(table, sql.SQL(", ").join(names))
    with connection.cursor() as cursor, cursor.copy(statement) as copy:
        for text in batches:
            check_cancelled(feedback)
            copy.write(text)


def _lines(layer: Layer, shapes: Iterator[Any] | None, srid: int) -> Iterator[str]:
    """Rows in COPY's text format, some thousand at a time."""
    for start, stop in layer.batches():
        columns = [_texts(layer.columns[f.name], start, stop) for f in layer.fields]
        if shapes is not None:
            columns.append(_hex(next(shapes), srid))
        yield "".join("\t".join(row) + "\n" for row in zip(*columns, strict=True))


def _texts(column: Column, start: int, stop: int) -> list[str]:
    values = column.tolist(start, stop)
    if column.values.dtype == object:
        return [v.translate(_ESCAPES) if isinstance(v, str) else r"\N" for v in values]
    return [r"\N" if value is None else str(value) for value in values]


def _hex(wkb: Sequence[bytes], srid: int) -> list[str]:
    """EWKB, which says its SRID, of little-endian ISO WKB of one type."""
    code = int.from_bytes(wkb[0][1:5], "little")
    flags = _SRID | (_Z if code >= 1000 else 0)
    head = b"\x01" + (code % 1000 | flags).to_bytes(4, "little") + srid.to_bytes(4, "little")
    return [(head + one[5:]).hex() for one in wkb]
