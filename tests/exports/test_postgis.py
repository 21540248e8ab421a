"""Tables in a real PostGIS: what is in them, whole or not at all, only our own replaced."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import format_cases as cases
import numpy as np
import pytest
import shapely
from postgis_server import server

from exports.tables.postgis import PostGis, PostGisOptions
from exports.tables.postgis_tables import AUTHORITY, FIRST_SRID
from georef_gis.errors import Cancelled, ExportError, InputError
from georef_gis.geodesy import CRS
from georef_gis.toolbox import CollectingFeedback

psycopg = pytest.importorskip("psycopg", reason="psycopg is not installed")

CUSTOM = CRS.from_user_input(
    "+proj=tmerc +lat_0=40 +lon_0=-83 +k=1 +x_0=1000 +y_0=2000 +ellps=GRS80 +units=us-ft"
).to_wkt()


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    with server() as connection:
        yield connection


@pytest.fixture
def schema(database: str, request: pytest.FixtureRequest) -> Iterator[str]:
    name = "s_" + "".join(c if c.isalnum() else "_" for c in request.node.name.lower())[:50]
    yield name
    query(database, f'DROP SCHEMA IF EXISTS "{name}" CASCADE')


def query(database: str, text: str, *values: object) -> list[tuple]:
    with psycopg.connect(database) as connection:
        cursor = connection.execute(text, values)
        return cursor.fetchall() if cursor.description else []


@pytest.fixture
def site(tmp_path: Path):
    return cases.format_site(tmp_path)


def send(
    monkeypatch, site, database: str, schema: str, feedback=None, *, layers=(), layer="site",
    **values,
):  # fmt: skip
    """As the tool does, of this site instead of a project's: all its layers, or those given."""
    layers = layers or cases.layers_of(site)
    monkeypatch.setattr(
        "exports.tables.postgis.chosen_layers", lambda source, options: (site, layers)
    )
    options = PostGisOptions(connection=database, database_schema=schema, **values)
    source = SimpleNamespace(kind="site" if layer == "site" else "vector", layer=layer)
    return PostGis().send(source, options, feedback or CollectingFeedback())


@pytest.mark.parametrize("crs", ["EPSG:6549", CUSTOM], ids=["code", "own CRS"])
def test_tables_hold_what_the_layers_do(monkeypatch, tmp_path, database, schema, crs) -> None:
    site = cases.format_site(tmp_path, crs=crs)
    report = send(monkeypatch, site, database, schema)
    layers = cases.layers_of(site)
    assert report.features == sum(map(len, layers))
    assert report.place.startswith("database postgres on ")
    for layer in layers:
        rows = []
        with psycopg.connect(database, row_factory=psycopg.rows.dict_row) as connection:
            shape = ", ST_AsBinary(geom) AS wkb" if layer.geometry != "None" else ""
            for row in connection.execute(f"SELECT *{shape} FROM {schema}.{layer.name}"):
                wkb = row.pop("wkb", None)
                rows.append((row, None if wkb is None else shapely.from_wkb(bytes(wkb))))
        cases.assert_same(rows, layer)
    lonlat = query(
        database, "SELECT ST_X(p), ST_Y(p) FROM (SELECT ST_Transform(geom, 4326) p "
        f"FROM {schema}.photos ORDER BY fid) q",
    )  # fmt: skip
    # deg: 1 mm, by PROJ of the server
    assert np.array(lonlat) == pytest.approx(site.layers["photos"].places.lonlat, abs=1e-8)


def test_crs_without_a_code_gets_a_number_once(monkeypatch, tmp_path, database, schema) -> None:
    site = cases.format_site(tmp_path, crs=CUSTOM)
    for name in (schema, f"{schema}_b"):
        send(monkeypatch, site, database, name)
    numbers = query(database, "SELECT srid FROM spatial_ref_sys WHERE auth_name = %s", AUTHORITY)
    assert numbers == [(FIRST_SRID,)]
    query(database, f"DROP SCHEMA {schema}_b CASCADE")


def test_columns_and_tables_say_what_they_are(monkeypatch, site, database, schema) -> None:
    send(monkeypatch, site, database, schema)
    found = query(
        database, "SELECT obj_description(oid, 'pg_class'), col_description(oid, 2) FROM pg_class "
        "WHERE oid = %s::regclass", f"{schema}.photos",
    )  # fmt: skip
    assert found[0][0].endswith("Photos")
    assert found[0][1] == "Id of the photo"
    indexes = query(database, "SELECT indexdef FROM pg_indexes WHERE schemaname = %s AND "
                    "tablename = 'asset_points'", schema)  # fmt: skip
    assert any("USING gist (geom)" in text for (text,) in indexes)
    facts = dict(query(database, f"SELECT key, value FROM {schema}.about"))
    assert facts["crs"] == "EPSG:6549"


def test_heights_make_geometries_of_three_dimensions(monkeypatch, site, database, schema) -> None:
    report = send(monkeypatch, site, database, schema, heights="orthometric")
    ((text,),) = query(database, f"SELECT ST_AsText(geom, 3) FROM {schema}.asset_lines")
    z = shapely.get_coordinates(shapely.from_wkt(text), include_z=True)[:, 2]
    expected = site.layers["asset_lines"].features[0].height_orthometric
    assert z == pytest.approx(expected, abs=1e-3)
    assert report.height_kind == "orthometric (EGM96)"


# -- whole or not at all, and only what is ours ----------------------------------------------------


def test_tables_are_replaced_only_when_asked(monkeypatch, site, database, schema) -> None:
    send(monkeypatch, site, database, schema)
    with pytest.raises(
        ExportError, match=r"photos is there from an earlier export; give overwrite"
    ):
        send(monkeypatch, site, database, schema)
    fewer = replace(site, assets=site.assets[:1])
    report = send(monkeypatch, fewer, database, schema, overwrite=True)
    assert query(database, f"SELECT count(*) FROM {schema}.asset_points") == [(13,)]
    # lines that the project no longer has would be taken for some of today
    assert "asset_lines" not in tables(database, schema)
    assert (
        f"table {schema}.asset_lines of an earlier export was removed: its layer has no features "
        "now" in report.warnings
    )


@pytest.mark.parametrize(("layer", "values"), [
    ("photos", {}), ("site", {"tie_points": False})
], ids=["layer", "option"])  # fmt: skip
def test_table_of_a_layer_that_is_not_asked_for_stays(
    monkeypatch, site, database, schema, layer, values
) -> None:
    send(monkeypatch, site, database, schema)
    ties = replace(site.layers["asset_points"], name="tie_points")
    send(monkeypatch, site, database, schema, layers=[ties], layer="tie_points")
    before = tables(database, schema)
    layers = [site.layers["photos"]] if layer == "photos" else cases.layers_of(site)
    report = send(
        monkeypatch, site, database, schema, layers=layers, layer=layer, overwrite=True, **values
    )
    assert tables(database, schema) == before
    assert not any("removed" in told for told in report.warnings)


def test_table_of_others_is_kept_where_the_project_has_no_such_layer(
    monkeypatch, site, database, schema
) -> None:
    query(database, f"CREATE SCHEMA {schema}")
    query(database, f"CREATE TABLE {schema}.asset_lines (mine text)")
    fewer = replace(site, assets=site.assets[:1])
    for _ in range(2):
        send(monkeypatch, fewer, database, schema, overwrite=True)
    assert {"asset_lines", "asset_points"} <= tables(database, schema)


@pytest.mark.parametrize("making", [
    "CREATE TABLE {}.asset_points (mine text)",
    "CREATE VIEW {}.asset_points AS SELECT 1 AS mine",
])  # fmt: skip
def test_what_someone_else_made_is_never_touched(
    monkeypatch, site, database, schema, making
) -> None:
    query(database, f"CREATE SCHEMA {schema}")
    query(database, making.format(schema))
    with pytest.raises(ExportError, match="is not of an earlier export of this project"):
        send(monkeypatch, site, database, schema, overwrite=True)
    assert tables(database, schema) == {"asset_points"}


def test_another_project_is_someone_else(monkeypatch, site, database, schema) -> None:
    send(monkeypatch, site, database, schema)
    other = replace(site, name="Other")
    with pytest.raises(ExportError, match="not of an earlier export of this project"):
        send(monkeypatch, other, database, schema, overwrite=True)


def tables(database: str, schema: str) -> set[str]:
    return {name for (name,) in query(
        database, "SELECT relname FROM pg_class c JOIN pg_namespace n ON n.oid = relnamespace "
        "WHERE nspname = %s AND relkind IN ('r', 'v')", schema)}  # fmt: skip


def test_cancelled_export_leaves_nothing(monkeypatch, site, database, schema) -> None:
    # after the first two of its seven tables
    feedback = CollectingFeedback(stop_at=0.25)
    with pytest.raises(Cancelled):
        send(monkeypatch, site, database, schema, feedback)
    assert "track" in feedback.messages
    assert query(database, "SELECT 1 FROM pg_namespace WHERE nspname = %s", schema) == []


def test_view_upon_a_table_is_named(monkeypatch, site, database, schema) -> None:
    send(monkeypatch, site, database, schema)
    query(database, f"CREATE VIEW {schema}.mine AS SELECT * FROM {schema}.photos")
    with pytest.raises(ExportError, match=r"mine.*nothing was written") as caught:
        send(monkeypatch, site, database, schema, overwrite=True)
    assert "\n" not in str(caught.value)
    assert query(database, f"SELECT count(*) FROM {schema}.photos") == [(3,)]


def test_locked_table_is_told(monkeypatch, site, database, schema) -> None:
    send(monkeypatch, site, database, schema)
    monkeypatch.setattr("exports.tables.postgis.LOCK_S", 1)
    with psycopg.connect(database) as other:
        other.execute(f"LOCK TABLE {schema}.photos")
        with pytest.raises(ExportError, match="another program has kept a table locked for 1 s"):
            send(monkeypatch, site, database, schema, overwrite=True)
    assert query(database, f"SELECT count(*) FROM {schema}.photos") == [(3,)]


def test_user_without_rights_is_told_in_one_line(monkeypatch, site, database, schema) -> None:
    query(database, "DROP ROLE IF EXISTS guest")
    query(database, "CREATE ROLE guest LOGIN")
    guest = database.replace("user=postgres", "user=guest")
    with pytest.raises(ExportError, match="permission denied") as caught:
        send(monkeypatch, site, guest, schema)
    assert "\n" not in str(caught.value)


def test_database_without_postgis_is_told(monkeypatch, site, database, schema) -> None:
    with psycopg.connect(database, autocommit=True) as connection:
        connection.execute("DROP DATABASE IF EXISTS plain")
        connection.execute("CREATE DATABASE plain")
    with pytest.raises(ExportError, match=r"plain has no PostGIS.*CREATE EXTENSION postgis"):
        send(monkeypatch, site, database.replace("dbname=postgres", "dbname=plain"), schema)


# -- the connection --------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [
    "postgresql://me:s3cret@server/gis", "host=server password=s3cret", "PASSWORD = s3cret host=x",
    "postgresql://server/gis?user=me&password=s3cret", "host=x sslpassword='s3cret'",
    "postgresql://me:a/s3cret@server/gis",
])  # fmt: skip
def test_password_is_refused_and_not_repeated(text: str) -> None:
    with pytest.raises(InputError, match=r"~/.pgpass") as caught:
        PostGisOptions(connection=text)
    assert "s3cret" not in repr(caught.value)
    assert "s3cret" not in str(caught.value.__cause__)


@pytest.mark.parametrize("text", ["service=gis", "postgresql://me@server:5433/gis", ""])
def test_connection_without_a_password_is_taken(text: str) -> None:
    assert PostGisOptions(connection=text).connection == text


@pytest.mark.parametrize(
    "name", ["Site", "a b", "x'; DROP SCHEMA y", "pg_mine", "1st", "", "a" * 64]
)
def test_odd_names_of_schemas_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="no name for a schema"):
        PostGisOptions(database_schema=name)


def test_server_that_is_not_there_is_one_line(monkeypatch, site, tmp_path) -> None:
    with pytest.raises(ExportError, match="check the connection") as caught:
        send(monkeypatch, site, f"host={tmp_path} dbname=x user=y", "s")
    assert "\n" not in str(caught.value)


def test_service_file_tells_where_to(monkeypatch, site, database, schema, tmp_path) -> None:
    lines = ["[gis]", *database.split(" ")]
    (tmp_path / "services").write_text("\n".join(lines) + "\n")
    monkeypatch.setenv("PGSERVICEFILE", str(tmp_path / "services"))
    assert send(monkeypatch, site, "service=gis", schema).features
    manifest = json.dumps(PostGisOptions(connection="service=gis").model_dump())
    assert "password" not in manifest


def test_tool_of_the_command_line_asks_for_no_target_and_says_where_to(database, schema, tmp_path):
    from format_cases import make_site

    from georef_gis.project import Project
    from georef_gis.project.records import photo_row, pose_row, save_frame
    from georef_gis.toolbox import Context
    from georef_gis.toolbox.exporter import tool_of

    site = make_site(tmp_path)
    project = Project.create(tmp_path / "site", {"project": {"name": "Site"}})
    project.prepare()
    with project.database.transaction():
        save_frame(project.database, site.frame)
        project.database.set_meta(epoch=site.epoch_gps)
        rows = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
        project.database.replace_rows("photo", rows)
        poses = [pose_row(p.photo.id, p.pose, site.frame, height_above_ground=100.0, dialect="ypr",
                          doubts=()) for p in site.photos]  # fmt: skip
        project.database.replace_rows("pose", poses)
    tool = tool_of(PostGis)
    assert "target" not in tool.Parameters.model_fields
    parameters = tool.Parameters(connection=database, database_schema=schema, layer="photos")
    result = tool().run(Context(project=project), parameters, CollectingFeedback())
    project.close()
    assert (result.summary["features"], dict(result.outputs)) == (3, {})
    assert schema in result.summary["place"]
    assert tables(database, schema) == {"photos", "about"}
