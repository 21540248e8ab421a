"""Assets in Google Earth: typed data, plain tables, styles by class, thousands of them."""

from __future__ import annotations

import math
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from kml_checks import K, documents, faults_of
from kmz_assets import CLASSES, asset_columns, asset_tables, table_of
from lxml import etree
from site_cases import ORIGIN, dot_places, make_site, write_mosaic

from exports.kml.icons import COLOURS, ClassLook
from exports.kml.kml import write_kml, write_kmz
from exports.kml.legend import entries_of
from exports.kml.light_kmz import write_light_kmz
from exports.kml.options import KmzOptions, LightKmzOptions
from exports.kml.tree import MOST_AT_ONCE, FeatureTree
from exports.site.schemas import ASSETS
from exports.site.site import SiteLayers
from georef_gis.errors import ExportError
from georef_gis.geodesy import MapFrame, parse_crs
from georef_gis.model.photo import Geotag
from georef_gis.toolbox import CollectingFeedback
from georef_gis.toolbox import exporter as toolbox

# What people write into names, and what must not break, run or be lost
HOSTILE = (
    "&<>\"'", "<script>alert(1)</script>", "</name>]]>", "cone \U0001f6a7 ü 标志", "n" * 300,
    "'; DROP TABLE assets; --", '=HYPERLINK("http://x")', "$[description]", "../../x", " ",
)  # fmt: skip


def with_assets(folder: Path, count: int, **options: object) -> SiteLayers:
    site = make_site(folder)
    return replace(site, assets=asset_tables(site.frame, count, **options))  # type: ignore[arg-type]


def export(site: SiteLayers, folder: Path) -> tuple[Path, list[str]]:
    feedback = CollectingFeedback()
    options = KmzOptions(thumbnails=False, overlay="none")
    write_kmz(site, folder / "s.kmz", options, feedback)
    return folder / "s.kmz", feedback.warnings


def placemarks(path: Path, start: str) -> list[etree._Element]:
    return [m for _, root in documents(path) for m in root.iter(K + "Placemark")
            if start in m.get("id")]  # fmt: skip


def test_hostile_names_come_back_as_they_were(tmp_path):
    path, _ = export(with_assets(tmp_path, len(HOSTILE), names=HOSTILE), tmp_path)
    assert faults_of(path) == []
    marks = placemarks(path, "asset_points")
    for name, mark in zip(HOSTILE, marks, strict=True):
        data = {e.get("name"): e.text for e in mark.iter(K + "SimpleData")}
        assert mark.findtext(K + "name") == name
        assert data["name"] == name
        html = etree.HTML(f"<div>{mark.findtext(K + 'description')}</div>")
        assert html.xpath("//script | //a") == []
        # HTML takes a name of blanks for none
        assert name.strip() in [cell.strip() for cell in [*html.xpath("//td/text()"), ""]]


def test_another_library_reads_the_typed_data(tmp_path):
    site = with_assets(tmp_path, len(HOSTILE), names=HOSTILE)
    write_kml(site, tmp_path / "s.kml", ("asset_points",))
    frame = pyogrio.read_dataframe(tmp_path / "s.kml", layer="Assets")
    wanted = site.layers["asset_points"]
    assert frame["Name"].str.strip().tolist() == [name.strip() for name in HOSTILE]
    assert frame["sigma_e_m"].tolist() == pytest.approx([0.03] * len(HOSTILE))
    assert frame["n_rays"].tolist() == [4] * len(HOSTILE)
    got = np.column_stack([frame.geometry.x, frame.geometry.y])
    assert np.abs(got - wanted.places.lonlat).max() < 1e-9  # deg, 0.1 mm


def test_attributes_of_a_class_are_untyped_data_and_rows_of_the_table(tmp_path):
    path, _ = export(with_assets(tmp_path, 3), tmp_path)
    mark = placemarks(path, "asset_points")[1]
    data = {e.get("name"): e.findtext(K + "value") for e in mark.iter(K + "Data")}
    assert data == {"line": "taper 1", "order": "1", "upright": "yes"}
    cells = etree.HTML(mark.findtext(K + "description")).xpath("//td/text()")
    pairs = dict(zip(cells[::2], cells[1::2], strict=True))
    assert pairs["line"] == "taper 1"
    assert pairs["sigma e (m)"] == "0.0300"


def test_each_class_has_an_icon_of_its_own_in_the_file(tmp_path):
    path, _ = export(with_assets(tmp_path, 20), tmp_path)
    root = dict(documents(path))["doc.kml"]
    icons = {
        s.get("id"): s.findtext(f".//{K}href") for s in root.iter(K + "Style")
        if s.find(f".//{K}href") is not None
    }  # fmt: skip
    by_class: dict[str, set[str]] = {}
    for mark in placemarks(path, "asset_points"):
        (kind,) = [e.text for e in mark.iter(K + "SimpleData") if e.get("name") == "class"]
        by_class.setdefault(kind, set()).add(icons[mark.findtext(K + "styleUrl")[1:]])
    assert set(by_class) == set(CLASSES)
    assert all(len(paths) == 1 for paths in by_class.values())
    with zipfile.ZipFile(path) as archive:
        pictures = {archive.read(next(iter(paths))) for paths in by_class.values()}
    assert len(pictures) == len(CLASSES)
    assert not any("http" in href for href in icons.values())


def test_ellipses_are_areas_and_assets_lie_on_the_ground(tmp_path):
    path, _ = export(with_assets(tmp_path, 4, ellipses=True), tmp_path)
    assert faults_of(path) == []
    marks = placemarks(path, "asset_")
    assert len(marks) == 4 + 2 + 4
    modes = {e.text for m in marks for e in m.iter(K + "altitudeMode")}
    assert modes == {"clampToGround"}
    ring = placemarks(path, "asset_ellipses")[0].findtext(f".//{K}coordinates")
    lon, _ = np.array([p.split(",") for p in ring.split()], float).T
    east = np.ptp(lon) * math.cos(ORIGIN.lat) * 111_320.0
    assert east == pytest.approx(0.16, rel=0.02)  # m; the map's scale and convergence


def test_thousands_are_files_that_load_as_one_comes_closer(tmp_path):
    count = MOST_AT_ONCE + 1500
    site = with_assets(tmp_path, count)
    path, _ = export(site, tmp_path)
    assert faults_of(path) == []
    marks = placemarks(path, "asset_points")
    ids = [e.text for m in marks for e in m.iter(K + "SimpleData") if e.get("name") == "asset_id"]
    assert sorted(ids) == [f"A{i:06d}" for i in range(count)]
    tree = {name: root for name, root in documents(path) if name.startswith("asset_points/")}
    assert 5 <= len(tree) < 40
    for name, root in tree.items():
        box = root.find(f"{K}Document/{K}Region/{K}LatLonAltBox")
        north, south, east, west = (
            float(box.findtext(K + side)) for side in ("north", "south", "east", "west")
        )
        lon, lat = np.array([e.text.split(",") for e in root.iter(K + "coordinates")], float).T
        assert len(lon) <= 750, name
        # deg; features have a decimal less
        assert west - 1e-9 <= lon.min() <= lon.max() <= east + 1e-9
        assert south - 1e-9 <= lat.min() <= lat.max() <= north + 1e-9
    # lines are few and stay in the document
    assert "asset_lines" not in {name.split("/")[0] for name in tree}
    assert len(placemarks(path, "asset_lines")) == 1


def test_files_of_long_lines_load_wherever_one_comes_closer_to_them(tmp_path):
    site = make_site(tmp_path)
    start = np.random.default_rng(6).uniform(-300, 300, (800, 3)) * [1, 1, 0]
    parts = list(site.frame.map_from_enu(start[:, None] + [[0, 0, 0], [900, 500, 0]]))
    table = table_of("asset_lines", asset_columns(len(parts)), parts)
    files: dict[str, bytes] = {}
    layer = replace(site, assets=(table,)).layers["asset_lines"]
    FeatureTree(
        layer=layer, sink=SimpleNamespace(add=files.__setitem__), styles={}, looks=()
    ).write()
    assert len(files) > 1
    for data in files.values():
        root = etree.fromstring(data)
        box = root.find(f"{K}Document/{K}Region/{K}LatLonAltBox")
        sides = [float(box.findtext(K + side)) for side in ("west", "south", "east", "north")]
        at = np.array(
            [v.split(",") for e in root.iter(K + "coordinates") for v in e.text.split()], float
        )
        # deg; vertices have a decimal less
        assert (at.min(axis=0) >= np.array(sides[:2]) - 1e-9).all()
        assert (at.max(axis=0) <= np.array(sides[2:]) + 1e-9).all()


def test_an_asset_where_the_crs_does_not_hold_is_left_out_and_named(tmp_path):
    site = make_site(tmp_path)
    points, *others = asset_tables(site.frame, 4)
    points.xy[2] = 1e12
    for write in (write_kmz, write_light_kmz):
        feedback = CollectingFeedback()
        options = KmzOptions(thumbnails=False) if write is write_kmz else LightKmzOptions()
        write(replace(site, assets=(points, *others)), tmp_path / "s.kmz", options, feedback)
        assert faults_of(tmp_path / "s.kmz") == []
        marks = placemarks(tmp_path / "s.kmz", "asset_points")
        assert [m.findtext(K + "name") for m in marks] == ["asset 0", "asset 1", "asset 3"]
        told = [w for w in feedback.warnings if "longitude" in w]
        assert len(told) == 1
        assert told[0].endswith(": asset 2")


def test_lines_and_areas_are_cut_at_the_180th_meridian(tmp_path):
    # 4.3 m west of it: the line of 60 m and the area of 20 x 10 m lie on both sides
    frame = MapFrame(replace(ORIGIN, lon=math.radians(179.99995)), parse_crs("EPSG:32601"))
    site = replace(make_site(tmp_path), frame=frame, assets=asset_tables(frame, 1), photos=(),
                   footprints=())  # fmt: skip
    write_kml(site, tmp_path / "s.kml", ASSETS)
    for layer, kind in (("Assets, lines", "LineString"), ("Assets, areas", "Polygon")):
        (shape,) = pyogrio.read_dataframe(tmp_path / "s.kml", layer=layer).geometry
        assert shape.geom_type in (f"Multi{kind}", "GeometryCollection")
        west, east = shape.geoms
        assert {west.geom_type, east.geom_type} == {kind}
        # one side ends at +180, the other begins at -180
        assert west.bounds[2] == 180.0
        assert east.bounds[0] == -180.0
        metres = math.cos(ORIGIN.lat) * 111_320.0
        wide = (west.bounds[2] - west.bounds[0] + east.bounds[2] - east.bounds[0]) * metres
        # the map's scale, and the sphere for the ellipsoid
        assert wide == pytest.approx({"LineString": 60.0, "Polygon": 20.0}[kind], rel=5e-3)


@pytest.mark.parametrize(("corners", "kinds"), [
    ([[-50, 0], [50, 60], [50, 0], [-50, 20]], {"Polygon"}),
    ([[-50, 0], [50, 0]], {"LineString"}),
], ids=["bow tie", "no ground"])  # fmt: skip
def test_area_that_crosses_itself_is_cut_at_the_180th_meridian_too(tmp_path, corners, kinds):
    frame = MapFrame(replace(ORIGIN, lon=math.radians(180.0 - 1e-9)), parse_crs("EPSG:32601"))
    ring = frame.map_from_enu(np.array([[*xy, 0.0] for xy in [*corners, corners[0]]]))
    area = table_of("asset_polygons", asset_columns(1), [ring])
    site = replace(make_site(tmp_path), frame=frame, assets=(area,), photos=(), footprints=())
    write_kml(site, tmp_path / "s.kml", ASSETS)
    (shape,) = pyogrio.read_dataframe(tmp_path / "s.kml", layer="Assets, areas").geometry
    assert {part.geom_type for part in shape.geoms} == kinds
    sides = sorted({part.bounds[0] > 0.0 for part in shape.geoms})
    assert sides == [False, True]
    metres = math.cos(ORIGIN.lat) * 111_320.0
    for east in (True, False):
        bounds = shapely.union_all([p for p in shape.geoms if (p.bounds[0] > 0.0) == east]).bounds
        # half of 100 m on each side; the map's scale, and the sphere for the ellipsoid
        assert (bounds[2] - bounds[0]) * metres == pytest.approx(50.0, rel=5e-3)


def test_nothing_to_show_makes_no_folders_and_no_faults(tmp_path):
    site = replace(make_site(tmp_path), photos=(), footprints=())
    path, warnings = export(site, tmp_path)
    assert faults_of(path) == []
    assert warnings == []
    root = dict(documents(path))["doc.kml"]
    assert root.find(f".//{K}Placemark") is None


def test_heights_that_are_not_known_lie_on_the_ground(tmp_path):
    site = make_site(tmp_path)
    photo = replace(site.photos[0], pose=None, photo=replace(
        site.photos[0].photo, geotag=Geotag(lat=ORIGIN.lat, lon=ORIGIN.lon)))  # fmt: skip
    path, _ = export(replace(site, photos=(photo,), footprints=()), tmp_path)
    assert faults_of(path) == []
    (mark,) = placemarks(path, "photo-")
    assert mark.findtext(f"{K}Point/{K}altitudeMode") == "clampToGround"
    assert "nan" not in mark.findtext(f"{K}Point/{K}coordinates")


def test_legend_and_statement_can_be_read(tmp_path):
    path, _ = export(with_assets(tmp_path, 30, ellipses=True), tmp_path)
    with zipfile.ZipFile(path) as archive:
        for name, least in (("legend", (150, 260)), ("accuracy", (370, 430))):
            data = np.frombuffer(archive.read(f"files/{name}.png"), np.uint8)
            image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
            assert image.shape[1] in range(least[0], least[1] + 60)
            assert image.shape[0] < 420
            # white letters on a dark ground: both are there
            assert image[..., :3].max() > 230
            assert image[..., :3].min() < 40
    root = dict(documents(path))["doc.kml"]
    names = [s.findtext(K + "name") for s in root.iter(K + "ScreenOverlay")]
    assert names == ["Legend", "Accuracy statement"]


def test_the_legend_draws_each_class_as_it_is_drawn_and_not_like_a_footprint():
    looks = [
        ClassLook(name=name, number=i, geometries=(name,))
        for i, name in enumerate(("asset_points", "asset_lines", "asset_polygons"), start=1)
    ]
    point, line, area = (entry.sign for entry in entries_of(looks, ()))
    footprint = entries_of((), [("footprint", "")])[0].sign
    corner = (6, 3)  # of the frame of an area
    assert area[corner][3] == footprint[corner][3] == 255
    assert line[corner][3] == point[corner][3] == 0
    blue = footprint[corner][2::-1].astype(float)
    assert min(np.linalg.norm(np.array(colour) - blue) for colour in COLOURS) > 60.0


@pytest.mark.parametrize(
    ("lon", "crs", "boxes"), [(180.0, "EPSG:32601", 2), (-179.9, "EPSG:32601", 1)]
)
def test_a_mosaic_across_the_180th_meridian_is_written_as_two(lon, crs, boxes, tmp_path):
    frame = MapFrame(replace(ORIGIN, lon=math.radians(lon - (1e-9 if lon == 180 else 0))),
                     parse_crs(crs))  # fmt: skip
    mosaic = write_mosaic(tmp_path / "m.tif", frame, width=800, height=800)
    base = make_site(tmp_path)
    site = replace(base, frame=frame, photos=(), footprints=(), mosaic=mosaic)
    for overlay in ("pyramid", "single"):
        feedback = CollectingFeedback()
        write_kmz(site, tmp_path / "s.kmz", KmzOptions(overlay=overlay), feedback)
        assert faults_of(tmp_path / "s.kmz") == []
        assert bool(feedback.warnings) == (boxes == 2)
        roots = dict(documents(tmp_path / "s.kmz"))
        if overlay == "single":
            sides = [float(b.findtext(K + "west")) for b in roots["doc.kml"].iter(K + "LatLonBox")]
            assert len(sides) == boxes
            assert (min(sides) == -180.0) == (boxes == 2)
        else:
            starts = {name.split("/")[0] for name in roots if "/" in name}
            assert len(starts) == boxes


def test_both_parts_at_the_180th_meridian_lie_in_place(tmp_path):
    frame = MapFrame(replace(ORIGIN, lon=math.radians(179.99995)),
                     parse_crs("EPSG:32601"))  # fmt: skip
    mosaic = write_mosaic(tmp_path / "m.tif", frame, width=800, height=800)
    site = replace(make_site(tmp_path), frame=frame, photos=(), footprints=(), mosaic=mosaic)
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(overlay="single"), CollectingFeedback())
    with rasterio.open(mosaic) as ds:
        transform = ds.transform
    parts = []
    with zipfile.ZipFile(tmp_path / "s.kmz") as archive:
        for overlay in dict(documents(tmp_path / "s.kmz"))["doc.kml"].iter(K + "GroundOverlay"):
            data = np.frombuffer(archive.read(overlay.findtext(f".//{K}href")), np.uint8)
            box = overlay.find(K + "LatLonBox")
            sides = {s: float(box.findtext(K + s)) for s in ("north", "south", "east", "west")}
            parts.append((sides, cv2.imdecode(data, -1)))
    seen = [0, 0]
    for col, row in dot_places(800, 800):
        p_map = [transform.a * col + transform.c, transform.e * row + transform.f, 200.0]
        lat, lon = np.degrees(frame.geo_from_map(p_map)[:2])
        lon = (lon + 180.0) % 360.0 - 180.0
        for k, (s, picture) in enumerate(parts):
            u = (lon - s["west"]) / (s["east"] - s["west"]) * picture.shape[1]
            v = (s["north"] - lat) / (s["north"] - s["south"]) * picture.shape[0]
            if not (8 < u < picture.shape[1] - 8 and 8 < v < picture.shape[0] - 8):
                continue
            patch = picture[int(v) - 7 : int(v) + 8, int(u) - 7 : int(u) + 8]
            if patch.shape[2] == 4 and patch[..., 3].min() < 255:
                continue
            weight = np.clip(patch[..., 0].astype(float) - 80.0, 0.0, None)
            yy, xx = np.mgrid[int(v) - 7 : int(v) + 8, int(u) - 7 : int(u) + 8] + 0.5
            at = np.array([(xx * weight).sum(), (yy * weight).sum()]) / weight.sum()
            assert np.abs(at - [u, v]).max() < 0.3  # px: JPEG noise of one dot
            seen[k] += 1
    assert min(seen) >= 10


def test_a_mosaic_around_a_pole_is_left_out_with_a_word(tmp_path):
    frame = MapFrame(replace(ORIGIN, lat=math.radians(89.99999)),
                     parse_crs("EPSG:3413"))  # fmt: skip
    mosaic = write_mosaic(tmp_path / "m.tif", frame, width=800, height=800)
    site = replace(make_site(tmp_path), frame=frame, photos=(), footprints=(), mosaic=mosaic)
    feedback = CollectingFeedback()
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(), feedback)
    assert faults_of(tmp_path / "s.kmz") == []
    assert "pole" in feedback.warnings[0]


def test_writing_where_one_may_not_is_told_and_leaves_the_old_file(tmp_path, monkeypatch):
    """As root permissions do not hold, so the system's refusal is played."""
    target = tmp_path / "site.kmz"
    target.write_bytes(b"half an older file")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(toolbox.os, "replace", refuse)
    site = make_site(tmp_path)

    class Written:
        id, suffix = "kmz", ".kmz"

        def write(self, source, part, options, feedback):
            return write_kmz(site, part, options, feedback)

    options = KmzOptions(thumbnails=False)
    with pytest.raises(ExportError, match=r"site\.kmz: cannot be written .*no other program"):
        toolbox._write_safely(Written(), None, target, options, CollectingFeedback())  # type: ignore[arg-type]
    assert target.read_bytes() == b"half an older file"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["site.kmz"]


def test_a_half_written_older_file_is_replaced_whole(tmp_path):
    target = tmp_path / "site.kmz"
    target.write_bytes(b"PK\x03\x04half")
    site = make_site(tmp_path)

    class Written:
        id, suffix = "kmz", ".kmz"

        def write(self, source, part, options, feedback):
            return write_kmz(site, part, options, feedback)

    toolbox._write_safely(Written(), None, target, KmzOptions(), CollectingFeedback())  # type: ignore[arg-type]
    assert faults_of(target) == []
