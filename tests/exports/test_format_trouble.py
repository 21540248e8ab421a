"""Every vector format against bad input: empty layers, no heights, broken and busy targets."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import adjusted_case
import format_cases as cases
import numpy as np
import pyogrio
import pytest
import shapely
from site_cases import ORIGIN

from exports.site.columns import Column, Layer, Places
from exports.site.schemas import Field
from exports.site.site import SiteLayers
from exports.tables.geojson import write_geojson
from georef_gis.errors import ExportError
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.project import Project
from georef_gis.project.records import photo_row, save_frame
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of

FILES = {"geopackage": ".gpkg", "geojson": ".geojson", "shapefile": "", "filegdb": ".gdb",
         "dxf": "", "geoparquet": "", "flatgeobuf": "", "csv": ""}  # fmt: skip
ALL = pytest.mark.parametrize("name", list(FILES))


@pytest.fixture
def project(tmp_path: Path):
    """Three photos with tags and nothing else."""
    site = cases.make_site(tmp_path)
    project = Project.create(tmp_path / "site", {})
    project.prepare()
    with project.database.transaction():
        save_frame(project.database, site.frame)
        project.database.set_meta(epoch=site.epoch_gps)
        rows = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
        project.database.replace_rows("photo", rows)
    yield project
    project.close()


def use(monkeypatch: pytest.MonkeyPatch, site: SiteLayers) -> None:
    """Let every project be this site."""
    found = classmethod(lambda cls, project, *, best=False: site)
    monkeypatch.setattr(SiteLayers, "from_project", found)


def export(project: Project, name: str, target: Path, layer: str = "assets") -> list[str]:
    tool = tool_of(cases.FORMATS[name])
    feedback = CollectingFeedback()
    parameters = tool.Parameters(layer=layer, target=str(target))
    tool().run(Context(project=project), parameters, feedback)
    return feedback.warnings


@ALL
def test_layer_without_features_is_refused_with_the_cure(project, monkeypatch, tmp_path, name):
    use(monkeypatch, cases.make_site(tmp_path))
    target = tmp_path / f"out{FILES[name]}"
    with pytest.raises(ExportError, match=r"no assets are mapped; `georef assets --clicks`"):
        export(project, name, target)
    assert not target.exists()


@ALL
def test_empty_layers_of_a_site_are_left_out(tmp_path, name) -> None:
    site = cases.format_site(tmp_path)
    some = replace(site, assets=site.assets[1:2], footprints=())
    names = [layer.name for layer in cases.layers_of(some, cameras=False)]
    assert names == ["photos", "track", "asset_lines"]
    cases.write(name, some, cases.layers_of(some, cameras=False), tmp_path / f"out{FILES[name]}")
    if (tmp_path / "out").is_dir() and name != "dxf":
        stems = {p.name.partition(".")[0] for p in (tmp_path / "out").iterdir()}
        assert stems - {"about", "fields", "cut_texts"} == set(names)


@ALL
def test_heights_that_are_not_known_are_no_numbers_in_the_file(tmp_path, name) -> None:
    site = cases.format_site(tmp_path, names=("a", "b"))
    layer = site.layers["asset_points"]
    target = tmp_path / f"out{FILES[name]}"
    cases.write(name, site, [layer], target)
    column = layer.columns["height_ellipsoidal_m"]
    assert column.missing.tolist() == [False, True]
    if name == "geojson":
        last = json.loads(target.read_text("utf-8"))["features"][-1]
        assert last["properties"]["height_ellipsoidal_m"] is None
        assert len(last["geometry"]["coordinates"]) == 2
    elif name == "csv":
        (first, last) = cases.read_csv(target / "asset_points.csv")
        assert float(first["height_ellipsoidal_m"]) > 0.0
        assert last["height_ellipsoidal_m"] == ""
    elif name == "dxf":
        assert "nan" not in (target / "drawing.dxf").read_text("utf-8").lower()
    elif name in ("geopackage", "filegdb"):
        where = "height_ellipsoidal_m IS NULL"
        assert len(pyogrio.raw.read(target, layer="asset_points", where=where)[2]) == 1


@ALL
def test_half_written_older_file_is_replaced(project, monkeypatch, tmp_path, name) -> None:
    use(monkeypatch, cases.format_site(tmp_path))
    target = tmp_path / f"out{FILES[name]}"
    export(project, name, target)
    part, other = (target.with_name(f".{target.stem}.{k}.part{target.suffix}") for k in (7, 8))
    if target.is_dir():
        # a folder of ours of which another program, or a broken disk, left rubbish
        for path in target.iterdir():
            if path.name != ".georef_export.json":
                path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        part.mkdir()
        (part / "rest.shp").write_bytes(b"half")
        other.mkdir()
    else:
        target.write_bytes(target.read_bytes()[:1000])
        part.write_bytes(b"half")
        other.write_bytes(b"half")
    # two days ago, and now by another process
    os.utime(part, (time.time() - 172_800.0,) * 2)
    export(project, name, target)
    assert not part.exists()
    assert other.exists()
    fresh = tmp_path / f"fresh{FILES[name]}"
    export(project, name, fresh)
    assert sizes(target) == sizes(fresh)


def sizes(path: Path) -> dict[str, int]:
    """Bytes of each file, but of the list that names them."""
    if path.is_file():
        return {"": path.stat().st_size}
    return {p.name: p.stat().st_size for p in path.iterdir() if p.name != ".georef_export.json"}


@ALL
def test_failed_export_leaves_the_older_one(project, monkeypatch, tmp_path, name) -> None:
    use(monkeypatch, cases.format_site(tmp_path))
    target = tmp_path / f"out{FILES[name]}"
    export(project, name, target)
    before = sizes(target)

    def fail(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Layer, "batches", fail)
    with pytest.raises(ExportError, match=r"cannot be written \(No space left on device\)"):
        export(project, name, target)
    assert sizes(target) == before
    assert [p.name for p in tmp_path.iterdir() if ".part" in p.name] == []


@ALL
def test_folder_that_is_a_file_cannot_be_written_to(project, monkeypatch, tmp_path, name) -> None:
    """No right to write, for whoever runs it: root is not stopped by permissions."""
    use(monkeypatch, cases.format_site(tmp_path))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ExportError, match=r"cannot be written.*free space and permission"):
        export(project, name, tmp_path / "file" / f"out{FILES[name]}")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0,
                    reason="permissions do not stop root")  # fmt: skip
@ALL
def test_folder_without_the_right_to_write_is_told(project, monkeypatch, tmp_path, name) -> None:
    use(monkeypatch, cases.format_site(tmp_path))
    (tmp_path / "shut").mkdir(mode=0o500)
    with pytest.raises(ExportError, match="Permission denied"):
        export(project, name, tmp_path / "shut" / f"out{FILES[name]}")


def test_geopackage_that_another_program_has_open_is_replaced_as_a_whole(
    project, monkeypatch, tmp_path
) -> None:
    """The old file stays what it was to who has it open; a new one has its name."""
    use(monkeypatch, cases.format_site(tmp_path))
    target = tmp_path / "out.gpkg"
    export(project, "geopackage", target)
    other = sqlite3.connect(target, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    export(project, "geopackage", target)
    assert other.execute("SELECT count(*) FROM asset_points").fetchone() == (13,)
    other.close()
    with sqlite3.connect(target) as again:
        assert again.execute("SELECT count(*) FROM asset_points").fetchone() == (13,)
    again.close()


@pytest.mark.parametrize(
    ("mode", "name"), [("wal", "out.gpkg"), ("delete", "out.gpkg"), ("wal", "out.GPKG")]
)
def test_journal_of_the_older_file_is_not_played_into_the_new_one(
    project, monkeypatch, tmp_path, mode, name
) -> None:
    """SQLite knows journals by their names: those of a GIS that has the old file open, too."""
    use(monkeypatch, cases.format_site(tmp_path))
    target = tmp_path / name
    export(project, "geopackage", target)
    with closing(sqlite3.connect(target, isolation_level=None)) as gis:
        gis.execute(f"PRAGMA journal_mode = {mode}")
        # a page that is written before the end of the transaction, as a large edit does
        gis.execute("PRAGMA cache_size = 1")
        gis.execute("BEGIN IMMEDIATE")
        gis.execute("CREATE TABLE edit AS SELECT randomblob(9000) FROM asset_points")
        gis.execute("COMMIT" if mode == "wal" else "SELECT 1")
        export(project, "geopackage", target)
        assert [p.name for p in tmp_path.iterdir() if "out" in p.name] == [name]
        with closing(sqlite3.connect(target)) as again:
            assert again.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert "edit" not in {
                name for (name,) in again.execute("SELECT name FROM sqlite_master")
            }
        # who has it open goes on with that one
        assert gis.execute("SELECT count(*) FROM edit").fetchone() == (13,)
    assert pyogrio.read_info(target, layer="asset_points")["features"] == 13


def test_file_that_cannot_be_replaced_keeps_its_journals(project, monkeypatch, tmp_path) -> None:
    """As on Windows while a GIS has it open: its last edits may be in the journal alone."""
    use(monkeypatch, cases.format_site(tmp_path))
    (tmp_path / "open").mkdir()
    export(project, "geopackage", tmp_path / "open" / "out.gpkg")
    with closing(sqlite3.connect(tmp_path / "open" / "out.gpkg", isolation_level=None)) as gis:
        gis.execute("PRAGMA journal_mode = WAL")
        gis.execute("CREATE TABLE edit AS SELECT 1 AS mine")
        # what a GIS leaves that is killed
        for path in (tmp_path / "open").iterdir():
            shutil.copyfile(path, tmp_path / path.name)
    target = tmp_path / "out.gpkg"
    before = sorted(p.name for p in tmp_path.iterdir())
    real = os.replace

    def refuse(source: Path, place: Path) -> None:
        if place == target:
            raise PermissionError(13, "Access is denied")
        real(source, place)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(ExportError, match=r"cannot be written \(Access is denied\)"):
        export(project, "geopackage", target)
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    with closing(sqlite3.connect(target)) as again:
        assert again.execute("SELECT mine FROM edit").fetchall() == [(1,)]


@pytest.mark.parametrize("name", ["filegdb", "shapefile"])
def test_lock_of_arcgis_is_told_as_one(project, monkeypatch, tmp_path, name) -> None:
    use(monkeypatch, cases.format_site(tmp_path))
    target = tmp_path / f"out{FILES[name]}"
    export(project, name, target)
    (target / "_gdb.HOST.1234.5678.sr.lock").touch()
    with pytest.raises(ExportError, match=r"sr\.lock, by which another program has it open: close"):
        export(project, name, target)


# -- the antimeridian ------------------------------------------------------------------------------


def fiji(lon: float = 180.0) -> MapFrame:
    """Fiji Map Grid, whose area the 180th meridian crosses."""
    origin = Origin(lat=np.radians(-17.0), lon=np.radians(lon), height_ellipsoidal=50.0)
    return MapFrame(origin, parse_crs("EPSG:3460"))


def across(tmp_path: Path) -> SiteLayers:
    """A line and an area 200 m wide with the meridian in the middle."""
    site = cases.make_site(tmp_path)
    frame = fiji()
    ring = frame.map_from_enu(
        np.array(
            [[-100, -50, 0], [100, -50, 4], [100, 50, 4], [-100, 50, 0], [-100, -50, 0]], float
        )
    )
    tables = (
        cases.table("asset_lines", [ring[:2]], [cases.asset(1, "line")]),
        cases.table("asset_polygons", [ring], [cases.asset(2, "area")]),
    )
    return replace(site, frame=frame, photos=(), footprints=(), assets=tables)


def test_geojson_is_cut_at_the_antimeridian(tmp_path) -> None:
    site = across(tmp_path)
    names = ("asset_lines", "asset_polygons")
    write_geojson(site, tmp_path / "f.geojson", names)
    data = json.loads((tmp_path / "f.geojson").read_text())
    line, area = data["features"]
    for feature, kind in ((line, "MultiLineString"), (area, "MultiPolygon")):
        assert feature["geometry"]["type"] == kind
        whole = shapely.geometry.shape(feature["geometry"])
        assert whole.is_valid
        sides = [part.bounds for part in whole.geoms]
        assert sorted(round(b[2] - b[0], 3) for b in sides) == [0.001, 0.001]
        assert {b[0] == -180.0 or b[2] == 180.0 for b in sides} == {True}
        box = feature["bbox"]
        # RFC 7946, 5.2: the western side has the larger number
        assert box[0] > 179.9 > 0.0 > -179.9 > box[len(box) // 2]
    assert data["bbox"][0] > data["bbox"][2]
    # the height goes on evenly along the line
    points = shapely.get_coordinates(shapely.geometry.shape(line["geometry"]), include_z=True)
    assert points[:, 2] == pytest.approx([50.0, 52.0, 52.0, 54.0], abs=0.02)
    rings = shapely.geometry.shape(area["geometry"]).geoms
    assert all(shapely.is_ccw(one.exterior) for one in rings)


def test_area_that_crosses_itself_is_cut_at_the_antimeridian_of_geojson_too(tmp_path) -> None:
    corners = [[-100, -50, 0], [100, 90, 4], [100, -50, 4], [-100, 10, 0], [-100, -50, 0]]
    site, frame = cases.make_site(tmp_path), fiji()
    ring = frame.map_from_enu(np.array(corners, float))
    table = cases.table("asset_polygons", [ring], [cases.asset(1, "bow tie")])
    site = replace(site, frame=frame, photos=(), footprints=(), assets=(table,))
    write_geojson(site, tmp_path / "f.geojson", ("asset_polygons",))
    (area,) = json.loads((tmp_path / "f.geojson").read_text())["features"]
    whole = shapely.geometry.shape(area["geometry"])
    assert whole.geom_type == "MultiPolygon"
    assert whole.is_valid
    sides = [part.bounds for part in whole.geoms]
    # the lobes meet 40 m west of it, so that one of them is cut
    assert sorted({b[0] > 0.0 for b in sides}) == [False, True]
    assert len(sides) == 3
    # the vertices keep their heights
    z = shapely.get_coordinates(whole, include_z=True)[:, 2]
    assert (z.min(), z.max()) == pytest.approx((50.0, 54.0), abs=0.02)


@pytest.mark.parametrize("name", ["geopackage", "shapefile", "flatgeobuf", "csv"])
def test_on_the_map_nothing_is_cut_at_the_antimeridian(tmp_path, name) -> None:
    site = across(tmp_path)
    area = site.layers["asset_polygons"]
    target = tmp_path / f"out{FILES[name]}"
    cases.write(name, site, [area], target)
    ring = shapely.Polygon(area.features[0].xy_map)
    # 200 m by 100 m, whatever the longitudes
    assert ring.area == pytest.approx(20_000.0, rel=2e-3)
    if name == "csv":
        (row,) = cases.read_csv(target / "asset_polygons.csv")
        assert shapely.from_wkt(row["wkt"]).equals_exact(ring, 1e-3)


def test_longitudes_of_one_side_are_not_cut(tmp_path) -> None:
    assert np.degrees(ORIGIN.lon) == pytest.approx(-83.0)
    site = cases.format_site(tmp_path)
    write_geojson(site, tmp_path / "f.geojson", ("asset_polygons",))
    kinds = [f["geometry"]["type"] for f in json.loads(
        (tmp_path / "f.geojson").read_text())["features"]]  # fmt: skip
    assert kinds == ["Polygon", "Polygon"]


# -- columns ---------------------------------------------------------------------------------------


def test_a_column_keeps_what_is_known_and_says_what_is_not() -> None:
    real = Column.of("real", [1.5, None, float("nan")])
    assert real.tolist() == [1.5, None, None]
    assert Column.of("integer", [1, None]).tolist() == [1, None]
    assert Column.of("flag", [True, None, False]).tolist() == [True, None, False]
    assert Column.of("text", ["", None, "x"]).tolist() == ["", None, "x"]
    assert Column.of("integer", np.array([3, 4], np.int32)).tolist() == [3, 4]


def test_batches_hold_each_feature_once_however_large_it_is() -> None:
    sizes = np.array([3, 200, 1, 1, 90, 7])
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    places = Places.of_points(np.zeros((offsets[-1], 6)), offsets)
    layer = Layer(name="x", title="x", geometry="LineString", fields=(), places=places)
    found = list(layer.batches(vertices=100))
    assert [i for a, b in found for i in range(a, b)] == list(range(6))
    assert all(sizes[a:b].sum() <= 100 or b - a == 1 for a, b in found)


def test_geometry_would_be_hidden_by_a_column_of_its_name_in_parquet(tmp_path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    site = cases.format_site(tmp_path)
    fields = (Field(name="geometry", kind="text", unit="", doc="in the way"),)
    layer = Layer.of_rows("x", "x", "Point", fields, [{"geometry": "a"}],
                          Places.of_points(np.zeros((1, 6))))  # fmt: skip
    with pytest.raises(ExportError, match="a column is called 'geometry'"):
        cases.write("geoparquet", site, [layer], tmp_path / "out")


@ALL
def test_photos_without_a_place_are_told_in_every_format(
    project, monkeypatch, tmp_path, name
) -> None:
    site = cases.make_site(tmp_path)
    nowhere = replace(site.photos[1].photo, geotag=None)
    lost = replace(site.photos[1], photo=nowhere, pose=None)
    use(monkeypatch, replace(site, photos=(site.photos[0], lost, site.photos[2])))
    told = export(project, name, tmp_path / f"out{FILES[name]}", layer="photos")
    assert f"photos left out, as they have no position: {lost.photo.id}" in told


@ALL
def test_file_of_features_is_refused_with_what_converts_it(project, tmp_path, name) -> None:
    with pytest.raises(ExportError, match=r"not files of others, which QGIS or ogr2ogr convert"):
        export(project, name, tmp_path / f"out{FILES[name]}", layer="other.gpkg")


@pytest.mark.parametrize("name", ["geojson", "csv"])
def test_place_where_the_crs_does_not_hold_is_told(tmp_path, name) -> None:
    site = cases.format_site(tmp_path, crs="EPSG:32617")
    far = cases.table("asset_lines", [[[0, 0, 0], [1e12, 1e12, 0]]], [cases.asset(1, "far")])
    layer = replace(site, assets=(far,)).layers["asset_lines"]
    assert not np.isfinite(layer.places.lonlat).all()
    with pytest.raises(ExportError, match="no longitude and latitude"):
        cases.write(name, replace(site, assets=(far,)), [layer], tmp_path / f"out{FILES[name]}")


@pytest.mark.parametrize("name", ["geojson", "csv"])
def test_height_of_no_earth_is_refused_and_not_cut_to_another(tmp_path, name) -> None:
    site = cases.format_site(tmp_path)
    x, y = site.assets[0].xy[0]
    wrong = cases.table("asset_lines", [[[x, y, 1e300], [x + 1, y, 2.0]]], [cases.asset(1, "up")])
    site = replace(site, assets=(wrong,))
    with pytest.raises(ExportError, match=r"height of 1e\+300, which is none on Earth"):
        cases.write(name, site, [site.layers["asset_lines"]], tmp_path / f"out{FILES[name]}")


@ALL
def test_control_and_tie_points_go_the_same_way(tmp_path, name) -> None:
    (tmp_path / "site").mkdir()
    project, site = adjusted_case.save(tmp_path / "site")
    adjusted_case.add_control(project, site)
    for layer in ("control", "tie_points"):
        target = tmp_path / f"{layer}{FILES[name]}"
        tool = tool_of(cases.FORMATS[name])
        parameters = tool.Parameters(layer=layer, target=str(target))
        result = tool().run(Context(project=project), parameters, CollectingFeedback())
        assert target.exists()
        assert result.summary["features"] == len(SiteLayers.from_project(project).layer(layer)) > 1
    project.close()
