"""GeoPackage: version, CRS, attributes, what it says about itself."""

from __future__ import annotations

import sqlite3
import tomllib
from contextlib import closing
from importlib.resources import files

import pyogrio
import pytest
from format_cases import format_site
from lxml import etree
from site_cases import NASTY, make_site

from exports.tables.geopackage import write_geopackage
from georef_gis.errors import ExportError
from georef_gis.geodesy import CRS

CUSTOM = CRS.from_user_input(
    "+proj=tmerc +lat_0=40 +lon_0=-83 +k=1 +x_0=1000 +y_0=2000 +datum=NAD83 +units=us-ft"
).to_wkt()


def query(path, sql: str) -> list[tuple]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(sql).fetchall()


@pytest.fixture
def gpkg(site, tmp_path):
    write_geopackage(site, tmp_path / "site.gpkg")
    return tmp_path / "site.gpkg"


def test_version_is_1_3(gpkg):
    assert query(gpkg, "PRAGMA application_id") == [(0x47504B47,)]
    assert query(gpkg, "PRAGMA user_version") == [(10300,)]
    assert query(gpkg, "PRAGMA integrity_check") == [("ok",)]
    assert query(gpkg, "PRAGMA foreign_key_check") == []


def test_layers_and_counts(gpkg):
    layers = {name: kind for name, kind in pyogrio.list_layers(gpkg)}
    assert layers["photos"] == "Point"
    assert layers["footprints"] == "Polygon"
    assert layers["track"] == "LineString"
    assert layers["cameras"] is None
    counts = [pyogrio.read_info(gpkg, layer=name)["features"] for name in ("photos", "track")]
    assert counts == [3, 1]


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:6549", CUSTOM], ids=["utm", "usft", "custom"])
def test_crs_is_kept(tmp_path, crs):
    site = make_site(tmp_path, crs=crs)
    write_geopackage(site, tmp_path / "s.gpkg")
    frame = pyogrio.read_dataframe(tmp_path / "s.gpkg", layer="photos")
    assert frame.crs.equals(site.crs, ignore_axis_order=True)
    assert frame.crs.axis_info[0].unit_name == site.crs.axis_info[0].unit_name
    x, y = site.layers["photos"].features[1].xy_map[0]
    point = frame.geometry.iloc[1]
    assert (point.x, point.y) == pytest.approx((x, y), abs=1e-6)
    # Back to degrees by another way: 20 m east of the origin, GRS80 or WGS 84 alike.
    degrees = frame.to_crs(4326).geometry.iloc[0]
    assert (degrees.x, degrees.y) == pytest.approx((-83.0, 40.0), abs=1e-7)


def test_attributes_survive(gpkg, site):
    frame = pyogrio.read_dataframe(gpkg, layer="photos")
    assert list(frame.columns[:-1]) == [f.name for f in site.layers["photos"].fields]
    assert frame["photo"].tolist() == ["p1.jpg", NASTY, "missing.jpg"]
    assert frame["height_ellipsoidal_m"].iloc[0] == pytest.approx(300.0)
    assert frame["doubts"].isna().tolist() == [True, False, True]
    prints = pyogrio.read_dataframe(gpkg, layer="footprints")
    assert prints["clipped"].tolist() == [False] * 3
    assert prints.geometry.is_valid.all()


def test_geometry_is_flat_so_that_no_height_is_misread(gpkg):
    assert not pyogrio.read_dataframe(gpkg, layer="photos").geometry.has_z.any()


def test_it_says_what_it_is(gpkg):
    facts = dict(query(gpkg, "SELECT key, value FROM site_metadata"))
    assert facts["crs"] == "EPSG:32617"
    assert "EGM96" in facts["heights"]
    docs = dict(
        query(
            gpkg,
            "SELECT column_name, description FROM gpkg_data_columns WHERE table_name = 'photos'",
        )
    )
    assert docs["height_orthometric_m"] == "Height above the EGM96 geoid"
    (text,) = query(gpkg, "SELECT description FROM gpkg_contents WHERE table_name = 'photos'")[0]
    assert "EPSG:32617" in text


def test_styles_are_well_formed_and_default(gpkg):
    rows = query(
        gpkg, "SELECT f_table_name, f_geometry_column, useAsDefault, styleQML FROM layer_styles"
    )
    assert {row[0] for row in rows} == {"photos", "footprints", "track"}
    for _, column, default, qml in rows:
        assert (column, default) == ("geom", 1)
        root = etree.fromstring(qml.encode())
        assert root.tag == "qgis"
        symbols = {e.get("name") for e in root.iter("symbol")}
        assert {e.get("symbol") for e in root.iter("rule")} <= symbols
    assert "layer_styles" in {row[0] for row in query(gpkg, "SELECT table_name FROM gpkg_contents")}


def test_assets_are_styled_by_class_and_ellipses_do_not_hide_them(tmp_path):
    write_geopackage(format_site(tmp_path), tmp_path / "s.gpkg")
    rows = query(tmp_path / "s.gpkg", "SELECT f_table_name, styleQML FROM layer_styles")
    styles = {name: etree.fromstring(qml.encode()) for name, qml in rows}
    classes = files("georef_gis.data").joinpath("asset_classes.toml").read_text("utf-8")
    wanted = {"asset_points": set(), "asset_lines": set(), "asset_polygons": set()}
    for name, one in tomllib.loads(classes)["classes"].items():
        wanted[f"asset_{one['geometry']}s"].add(name)
    for layer, names in wanted.items():
        found = {e.get("value"): e.get("symbol") for e in styles[layer].iter("category")}
        # and one for what is of no known class
        assert set(found) == names | {""}
        assert set(found.values()) == {e.get("name") for e in styles[layer].iter("symbol")}
    (colour,) = (e for e in styles["asset_ellipses"].iter("Option") if e.get("name") == "color")
    # of 255
    assert int(colour.get("value").split(",")[3]) < 60


def test_without_styles(site, tmp_path):
    write_geopackage(site, tmp_path / "s.gpkg", styles=False)
    names = {row[0] for row in query(tmp_path / "s.gpkg", "SELECT name FROM sqlite_master")}
    assert "layer_styles" not in names


def test_empty_layers_are_left_out_and_nothing_is_refused(site, tmp_path):
    from dataclasses import replace

    some = replace(site, footprints=())
    write_geopackage(some, tmp_path / "s.gpkg")
    assert "footprints" not in {name for name, _ in pyogrio.list_layers(tmp_path / "s.gpkg")}
    with pytest.raises(ExportError, match="nothing to write"):
        write_geopackage(some, tmp_path / "t.gpkg", ("footprints",))


def test_unwritable_target_is_an_os_error_for_the_toolbox(site, tmp_path):
    with pytest.raises(OSError, match="gone"):
        write_geopackage(site, tmp_path / "gone" / "s.gpkg")
