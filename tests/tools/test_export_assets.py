"""Mapped assets in the exported files: places, accuracy, ellipses, and names as text."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import shapely
from lxml import etree
from tool_cases import SAMPLE, Site, georef
from work_zone_cases import clicks_csv, copied, posed_site

TRUTH = SAMPLE / "truth"
K = "{http://www.opengis.net/kml/2.2}"
NASTY = "<script>alert(1)</script> ]]> & \"'🚧 $[name]"


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Two cones and an edge of a lane, one cone with a hostile name."""
    site = posed_site(tmp_path_factory.mktemp("exported") / "site")
    for words in (("footprints",), ("mosaic", "--blend", "none")):
        done = georef(*words, "--project", site.folder)
        assert done.code == 0, done.text
    photos = [path.name for path in site.photos]
    lines = clicks_csv(TRUTH, ["C01", "C02"], photos=photos).splitlines()
    lines += [f"edge,lane_edge,{photos[0]},{u},500,,," for u in (300, 600, 900)]
    path = site.folder / "clicks.csv"
    path.write_text("\n".join(lines) + "\n")
    assert georef("assets", "--project", site.folder, "--clicks", path).code == 0
    sql(site, "UPDATE asset_points SET name = ? WHERE name = 'C02'", NASTY)
    assert georef("assets", "--project", site.folder).code == 0
    return site


@pytest.fixture
def site(mapped: Site, tmp_path: Path) -> Site:
    return copied(mapped, tmp_path / "site")


def sql(site: Site, statement: str, *values: Any) -> None:
    with closing(sqlite3.connect(site.folder / "assets.gpkg")) as connection, connection:
        connection.execute(statement, values)


def export(site: Site, name: str, suffix: str, layer: str = "assets") -> Path:
    target = site.folder / f"out{suffix}"
    done = georef(f"export-{name}", "--project", site.folder, "--layer", layer, "--target", target)
    assert done.code == 0, done.text
    return target


def test_geojson_has_places_and_accuracy_in_degrees_and_metres(site: Site) -> None:
    features = json.loads(export(site, "geojson", ".geojson").read_text())["features"]
    layers = [f["properties"]["layer"] for f in features]
    assert layers == ["asset_points"] * 2 + ["asset_lines"] + ["asset_ellipses"] * 2
    stored = geopandas.read_file(site.folder / "assets.gpkg", layer="asset_points")
    for feature, (_, row) in zip(features, stored.iterrows(), strict=False):
        p = feature["properties"]
        assert (p["class"], p["name"], p["method"]) == ("cone", row["name"], row["method"])
        for name in ("sigma_e", "sigma_n", "sigma_u", "semi_major", "semi_minor"):
            assert p[f"{name}_m"] == pytest.approx(row[name], abs=1e-9)
        assert p["azimuth_deg"] == pytest.approx(row["azimuth"], abs=1e-9)
        assert json.loads(p["pixels"]) == json.loads(row["pixels"])
    geographic = stored.to_crs("EPSG:4326").geometry
    found = [shapely.Point(f["geometry"]["coordinates"]) for f in features[:2]]
    # deg: 0.1 mm
    assert max(a.distance(b) for a, b in zip(found, geographic, strict=True)) < 1e-9


def test_ellipse_of_the_geopackage_is_that_of_the_columns(site: Site) -> None:
    path = export(site, "geopackage", ".gpkg")
    points = geopandas.read_file(path, layer="asset_points").set_index("asset_id")
    ellipses = geopandas.read_file(path, layer="asset_ellipses").set_index("asset_id")
    assert len(points) == len(ellipses) == 2
    assert geopandas.read_file(path, layer="asset_lines").crs.to_epsg() == 6601
    foot = 1200 / 3937
    for asset_id, p in points.iterrows():
        # from the covariance alone: sigmas, correlation and the quantile of chi-square
        C = p.corr_en * p.sigma_e_m * p.sigma_n_m
        root = np.linalg.cholesky([[p.sigma_e_m**2, C], [C, p.sigma_n_m**2]])
        t = np.linspace(0, 2 * np.pi, 400)
        ring = math.sqrt(-2 * math.log(1 - p.conf)) * root @ [np.cos(t), np.sin(t)] / foot
        own = shapely.Polygon(ring.T + np.array([p.geometry.x, p.geometry.y]))
        theirs = ellipses.loc[asset_id].geometry
        # a polygon of 64 corners lacks 0.16 % of its ellipse
        assert own.symmetric_difference(theirs).area < 0.003 * own.area


@pytest.mark.parametrize(("name", "suffix"), [("kml", ".kml"), ("kmz", ".kmz")])
def test_name_of_an_asset_is_text_in_the_balloon(
    site: Site, name: str, suffix: str, tmp_path: Path
) -> None:
    import zipfile

    path = export(site, name, suffix, layer="site")
    raw = zipfile.ZipFile(path).read("doc.kml") if suffix == ".kmz" else path.read_bytes()
    root = etree.fromstring(raw)
    marks = [m for m in root.iter(f"{K}Placemark") if m.findtext(f"{K}name") == NASTY]
    assert len(marks) == 1
    html = marks[0].findtext(f"{K}description") or ""
    assert "<script" not in html
    assert etree.HTML(html).xpath("//h3/text()") == [NASTY]
    styles = [text for text in root.itertext() if "$[" in text and NASTY not in text]
    # what a viewer puts in for $[name] is HTML to it
    assert {text for text in styles if "<" not in text} == {"$[description]"}
    point = marks[0].find(f"{K}Point")
    assert point is not None
    assert point.findtext(f"{K}altitudeMode") == "clampToGround"


def test_feature_moved_in_a_gis_is_exported_without_the_accuracy_of_where_it_was(
    site: Site,
) -> None:
    frame = geopandas.read_file(site.folder / "assets.gpkg", layer="asset_points")
    frame.geometry = [shapely.Point(p.x + (k == 0), p.y, p.z) for k, p in enumerate(frame.geometry)]
    frame.to_file(site.folder / "assets.gpkg", layer="asset_points", driver="GPKG")
    features = json.loads(export(site, "geojson", ".geojson").read_text())["features"]
    moved, left = (f["properties"] for f in features[:2])
    assert (moved["method"], moved["sigma_e_m"], moved["photo_ids"]) == ("edited", None, None)
    assert left["sigma_e_m"] > 0
    ellipses = [f for f in features if f["properties"]["layer"] == "asset_ellipses"]
    assert [f["properties"]["asset_id"] for f in ellipses] == [left["asset_id"]]


def test_export_is_made_again_when_the_assets_changed(site: Site) -> None:
    def made() -> int:
        done = georef("run", site.folder, "--only", "export_geopackage")
        assert done.code == 0, done.text
        return (site.products / "site.gpkg").stat().st_mtime_ns

    first = made()
    assert made() == first
    assert georef("assets", "--project", site.folder, "--undo", "1").code == 0
    assert made() > first
    names = geopandas.read_file(site.products / "site.gpkg", layer="asset_points")["name"]
    assert set(names) == {"C01", "C02"}


def _spoil(statement: str) -> Callable[[Site], None]:
    return lambda site: sql(site, statement)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda s: (s.folder / "assets.gpkg").write_bytes(b"none" * 500), "cannot be read"),
        (_spoil("UPDATE gpkg_geometry_columns SET srs_id = 4326"), "not the project's CRS"),
    ],
    ids=["no database", "another CRS"],
)
def test_file_that_cannot_be_used_is_refused_in_one_line(
    site: Site, spoil: Callable[[Site], None], words: str
) -> None:
    spoil(site)
    done = georef("export-geojson", "--project", site.folder, "--layer", "assets")
    assert done.code == 2
    assert words in done.text


def test_geometry_that_cannot_be_read_is_left_out_and_told(site: Site) -> None:
    sql(site, "UPDATE asset_points SET geom = NULL WHERE name = 'C01'")
    done = georef("export-geojson", "--project", site.folder, "--layer", "assets")
    assert done.code == 0, done.text
    assert "assets left out, as they have no geometry of their kind: C01" in done.text


def test_project_without_assets_says_how_to_map_some(site: Site) -> None:
    (site.folder / "assets.gpkg").unlink()
    for name in ("geojson", "kml", "geopackage"):
        done = georef(f"export-{name}", "--project", site.folder, "--layer", "assets")
        assert done.code == 2
        assert "no assets are mapped; `georef assets --clicks`" in done.text
