"""Exporters as tools on a project: from the database, whole or not at all."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
from rio_cogeo.cogeo import cog_validate
from site_cases import NASTY, make_site, write_mosaic, write_photos

import exports
from exports.site.site import SiteLayers
from georef_gis.errors import ExportError
from georef_gis.project import Project
from georef_gis.project.records import (
    camera_row,
    footprint_row,
    photo_row,
    pose_row,
    save_frame,
)
from georef_gis.toolbox import CollectingFeedback, Context, Exporter, ExportReport, Sender
from georef_gis.toolbox.exporter import tool_of
from georef_gis.toolbox.parameters import Parameters

CRS = "EPSG:6549"
# one writes no file: test_postgis.py has a server for it
TOOLS = {one.id: one for one in exports.EXPORTERS if not issubclass(one, Sender)}


@pytest.fixture
def project(tmp_path) -> Project:
    """The synthetic site in a project database."""
    folder = tmp_path / "site"
    folder.mkdir()
    write_photos(folder)
    project = Project.create(folder, {"project": {"name": "Site & <road>"}})
    project.prepare()
    site = make_site(folder, crs=CRS)
    write_mosaic(project.products / "mosaic.tif", site.frame, width=700, height=500)
    rows = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
    poses = [
        pose_row(p.photo.id, p.pose, site.frame, height_above_ground=100.0, dialect="ypr",
                 doubts=p.photo.doubts)
        for p in site.photos
    ]  # fmt: skip
    database = project.database
    with database.transaction():
        save_frame(database, site.frame)
        database.set_meta(epoch=site.epoch_gps)
        database.replace_rows("photo", rows)
        database.replace_rows("pose", poses)
        database.replace_rows("camera", [camera_row(c) for c in site.cameras])
        database.replace_rows(
            "footprint",
            [footprint_row(f, pose_kind="tags", doubts=()) for f in site.footprints],
        )
    yield project
    project.close()


def export(project: Project, name: str, **values: object) -> Path:
    tool = tool_of(TOOLS[name])
    result = tool().run(Context(project=project), tool.Parameters(**values), CollectingFeedback())
    target = Path(result.outputs["target"])
    left = [p.name for p in target.parent.iterdir() if ".part" in p.name]
    assert left == []
    return target


def test_database_gives_the_same_layers_as_the_values(project):
    found = SiteLayers.from_project(project)
    wanted = make_site(project.folder, crs=CRS)
    for name in ("photos", "footprints", "track", "cameras"):
        ours, theirs = found.layers[name].features, wanted.layers[name].features
        assert len(ours) == len(theirs)
        for a, b in zip(ours, theirs, strict=True):
            assert a.xy_map == pytest.approx(b.xy_map, abs=1e-6)
            assert a.geo == pytest.approx(b.geo, abs=1e-9, nan_ok=True)
            assert dict(a.values) == pytest.approx(dict(b.values), abs=1e-9)
    assert found.mosaic == project.products / "mosaic.tif"


def test_the_pose_is_that_of_the_footprint(project):
    rows = project.database.rows("pose")
    for row in rows:
        row.pop("fid")
    better = [{**row, "kind": "adjusted", "x_enu": row["x_enu"] + 1.0} for row in rows[:2]]
    project.database.add_rows("pose", better)
    used = {"photo_id": rows[0]["photo_id"]}
    project.database.delete_rows("footprint", used)
    kinds = [p.pose.kind for p in SiteLayers.from_project(project).photos]
    assert kinds == ["adjusted", "tags", "tags"]


@pytest.mark.parametrize(
    ("name", "values", "file"),
    [
        ("kmz", {}, "site.kmz"),
        ("geopackage", {}, "site.gpkg"),
        ("geopackage", {"layer": "footprints"}, "footprints.gpkg"),
        ("kml", {}, "site.kml"),
        ("geojson", {}, "photos.geojson"),
        ("geojson", {"layer": "site"}, "site.geojson"),
        ("filegdb", {}, "site.gdb"),
        ("shapefile", {}, "site_shp"),
        ("shapefile", {"layer": "footprints"}, "footprints_shp"),
        ("dxf", {}, "site_dxf"),
        ("csv", {"layer": "photos"}, "photos_csv"),
        ("flatgeobuf", {"layer": "photos"}, "photos_fgb"),
        ("cog", {"layer": "mosaic", "compression": "zstd"}, None),
        ("odm_geo", {"layer": "poses"}, None),
        ("poses_csv", {"layer": "poses"}, None),
    ],
)
def test_every_exporter_writes_from_a_project(project, name, values, file):
    target = export(project, name, **values)
    assert target.parent == project.products
    assert target.stat().st_size > 100
    assert file is None or target.name == file


def test_the_layers_are_not_changed(project):
    before = {p: p.read_bytes() for p in project.products.iterdir()}
    database = project.database.path.read_bytes()
    for name in TOOLS:
        if name == "colmap":
            # its format cannot hold the blanks in a name of this site
            continue
        export(project, name, **({"layer": "mosaic"} if name == "cog" else {}))
    assert all(p.read_bytes() == data for p, data in before.items())
    assert project.database.path.read_bytes() == database


def test_export_again_replaces_the_file(project):
    first = export(project, "geopackage")
    count = pyogrio.read_info(first, layer="photos")["features"]
    again = export(project, "geopackage")
    assert first == again
    assert pyogrio.read_info(again, layer="photos")["features"] == count


def test_cog_of_the_project(project):
    target = export(project, "cog", layer="mosaic", compression="jpeg", target="out.tif")
    try:
        assert cog_validate(target, quiet=True)[0]
        with rasterio.open(target) as ds:
            assert ds.crs.to_epsg() == 6549
            assert np.all(ds.read(1) >= 0)
    finally:
        target.unlink()


@pytest.mark.parametrize(("name", "layer", "target", "driver"), [
    ("cog", "mosaic", "M.TIFF", "GTiff"), ("geojson", "photos", "a.json", "GeoJSON"),
])  # fmt: skip
def test_other_suffix_of_the_same_format_is_taken(project, tmp_path, name, layer, target, driver):
    written = export(project, name, layer=layer, target=str(tmp_path / target))
    assert written == tmp_path / target
    if name == "cog":
        with rasterio.open(written) as ds:
            assert ds.driver == driver
    else:
        assert pyogrio.read_info(written)["driver"] == driver
    (spec,) = [one for one in tool_of(TOOLS[name]).Parameters.specs() if one.name == "target"]
    # the first is that of the default
    assert spec.manifest()["suffixes"] == [TOOLS[name].suffix, written.suffix.lower()]


@pytest.mark.parametrize("compression", ["keep", "zstd"])
def test_cog_says_how_accurate_the_mosaic_is(project, compression):
    told = json.loads(STATEMENT)
    (project.products / "accuracy.json").write_text(json.dumps(told))
    with rasterio.open(project.products / "mosaic.tif") as ds:
        pixels = ds.read()
    target = export(project, "cog", layer="mosaic", compression=compression, target="out.tif")
    try:
        with rasterio.open(target) as ds:
            assert ds.tags()["ACCURACY_STATEMENT_H"] == "Tested <well> & found."
            assert ds.tags()["ACCURACY_RMSE_H_CM"] == "4.2"
            assert ds.tags()["TITLE"] == "Mosaic & more"
            assert np.array_equal(ds.read(), pixels)
        valid, errors, _ = cog_validate(target, quiet=True)
        assert valid, errors
    finally:
        target.unlink()


STATEMENT = """{"format": "georef_gis accuracy 1", "standard": "S", "survey":
{"datum": "unknown", "product_datum": "unknown", "flags": []}, "assessments": {"products":
{"axes": {}, "flags": [], "components": [{"name": "H", "n": 31, "vegetated": false,
"rmse": 0.042, "class_m": 0.05, "class_declared": true, "statement": "Tested <well> & found."}]}}}
"""


@pytest.mark.parametrize("name", list(TOOLS))
def test_unwritable_target_is_one_line_with_the_cure(project, tmp_path, name):
    (tmp_path / "file").write_text("in the way")
    target = tmp_path / "file" / f"x{TOOLS[name].suffix}"
    layer = {"layer": "mosaic"} if name == "cog" else {}
    with pytest.raises(ExportError) as caught:
        export(project, name, target=str(target), **layer)
    text = str(caught.value)
    assert str(target) in text
    assert "check free space and permission" in text
    assert "\n" not in text


FULL_DISK = """
import json, resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from pathlib import Path
from exports import EXPORTERS
from georef_gis.errors import ExportError
from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of
project, out = Project.open(sys.argv[1]), {}
project.database.count("photo")
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
for exporter in EXPORTERS:
    values = {"layer": "mosaic", "compression": "deflate"} if exporter.id == "cog" else {}
    # small files fit; a name of this site does not fit into COLMAP's format
    small = ("odm_geo", "poses_csv", "pix4dmapper_csv", "pix4dmatic_csv", "xyz_tiles")
    if exporter.id in (*small, "colmap", "postgis"):
        continue
    tool = tool_of(exporter)
    try:
        tool().run(Context(project=project), tool.Parameters(**values), CollectingFeedback())
        out[exporter.id] = "written"
    except ExportError as error:
        out[exporter.id] = str(error)
print(json.dumps(out))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
def test_full_disk_leaves_nothing_and_says_so(project):
    """A limit of file sizes stands in for the full disk: writing fails half way."""
    before = sorted(p.name for p in project.products.iterdir())
    run = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(project.folder)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    messages = json.loads(run.stdout.splitlines()[-1])
    # What is written is whole, as it is without a limit.
    for name in [name for name, text in messages.items() if text == "written"]:
        written = project.products / TOOLS[name].target
        whole = written.read_bytes()
        assert len(whole) <= 3000
        assert export(project, name).read_bytes() == whole
        written.unlink()
        del messages[name]
    assert {"kmz", "geopackage", "kml", "geojson", "cog", "tagged_photos"} <= messages.keys()
    assert {"mbtiles", "pmtiles"} <= messages.keys()
    for name, text in messages.items():
        assert "cannot be written" in text, (name, text)
        assert "\n" not in text
    assert sorted(p.name for p in project.products.iterdir()) == before


def test_layer_without_export_is_refused(project):
    for name in ("geojson", "geopackage", "kml"):
        with pytest.raises(ExportError, match="no control points"):
            export(project, name, layer="control")
    with pytest.raises(ExportError, match="has no poses"):
        export(project, "poses_csv", layer="footprints")


def test_empty_project_says_what_to_do(tmp_path):
    project = Project.create(tmp_path, {})
    project.prepare()
    assert project.database.count("photo") == 0
    with pytest.raises(ExportError, match="georef run"):
        export(project, "kmz")
    project.close()


def test_import_of_exports_is_light():
    code = (
        "import sys, exports; "
        "print([m for m in ('numpy', 'lxml', 'cv2', 'rasterio', 'pyogrio', 'pyproj', 'shapely') "
        "if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_nasty_name_comes_through_to_the_csv(project):
    text = export(project, "poses_csv").read_text(encoding="utf-8")
    assert NASTY.replace('"', '""') in text


@pytest.mark.parametrize(("kind", "expected"), [("tags", 5.0), ("navigation", 13.0)])
def test_sigma_above_the_ground_is_that_of_camera_and_ground(project, kind, expected):
    """3 m of the camera and 4 m of the ground, whose level only poses from tags share (12 m)."""
    database = project.database
    rows = [{**row, "kind": kind} for row in database.rows("pose")]
    for row in rows:
        row.pop("fid")
    database.replace_rows("pose", rows)
    assert SiteLayers.from_project(project).photos[0].sigma_above_ground is None
    database.set_meta(ground={"sigma_m": 4.0, "sigma_shared_m": 12.0})
    assert SiteLayers.from_project(project).photos[0].sigma_above_ground == pytest.approx(expected)


# -- targets -----------------------------------------------------------------------------------


class FolderOfText(Exporter[Parameters]):
    """Writes a folder of two files, or of one."""

    id, name, suffix, accepts = "folder_of_text", "Folder", "", ("vector",)
    names = ("a.txt", "sub/b.txt")

    def write(self, source, target, options, feedback):
        for name in self.names:
            path = target / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(name)
        return ExportReport(crs="EPSG:4326", height_kind="none", features=2)


class OtherFolder(FolderOfText):
    """Writes a folder as well."""

    id = "other_folder"


def export_folder(project: Project, target: Path, exporter: type = FolderOfText) -> set[str]:
    tool = tool_of(exporter)
    values = tool.Parameters(target=str(target))
    tool().run(Context(project=project), values, CollectingFeedback())
    assert [p.name for p in target.parent.iterdir() if ".part" in p.name] == []
    return {p.relative_to(target).as_posix() for p in target.rglob("*") if p.is_file()}


@pytest.mark.parametrize("name", ["kmz", "tagged_photos"])
@pytest.mark.parametrize("target", [".", "..", "site/.."])
def test_target_without_a_name_is_a_user_error(project, tmp_path, monkeypatch, name, target):
    here = tmp_path / "work" / "site"
    here.mkdir(parents=True)
    for folder in (here, here.parent, tmp_path):
        (folder / "precious.txt").write_text("mine")
    monkeypatch.chdir(here if target != "site/.." else here.parent)
    with pytest.raises(ExportError, match=r"precious.txt.*would be lost|is a folder"):
        export(project, name, target=target)
    assert len(list(tmp_path.rglob("precious.txt"))) == 3


@pytest.mark.parametrize("name", ["out", "out.geojson"])
def test_folder_is_no_target_of_a_file(project, tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ExportError, match="is a folder; give the name"):
        export(project, "geojson", target=str(tmp_path / name))
    assert list((tmp_path / name).iterdir()) == []


def test_root_of_the_disk_is_no_target(project):
    with pytest.raises(ExportError, match="no place for an export"):
        export(project, "geojson", target=Path("/").anchor)


def test_folder_with_files_of_others_is_refused_and_kept(project, tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "thesis.doc").write_text("years of work")
    with pytest.raises(ExportError, match=r"holds thesis\.doc, .* would be lost"):
        export_folder(project, target)
    assert (target / "thesis.doc").read_text() == "years of work"


def test_folder_of_the_same_exporter_is_replaced_whole(project, tmp_path, monkeypatch):
    target = tmp_path / "out"
    first = export_folder(project, target)
    assert {"a.txt", "sub/b.txt"} < first
    monkeypatch.setattr(FolderOfText, "names", ("c.txt",))
    again = export_folder(project, target)
    assert again == (first - {"a.txt", "sub/b.txt"}) | {"c.txt"}


def test_folder_of_another_exporter_is_refused(project, tmp_path):
    export_folder(project, tmp_path / "out", OtherFolder)
    with pytest.raises(ExportError, match="would be lost"):
        export_folder(project, tmp_path / "out")


def test_file_put_into_an_exported_folder_is_not_lost(project, tmp_path):
    target = tmp_path / "out"
    export_folder(project, target)
    (target / "sub" / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"holds sub/notes\.txt"):
        export_folder(project, target)
    assert (target / "sub" / "notes.txt").read_text() == "mine"


def test_empty_folder_is_taken(project, tmp_path):
    (tmp_path / "out" / "empty").mkdir(parents=True)
    assert "a.txt" in export_folder(project, tmp_path / "out")


def test_file_is_not_replaced_by_a_folder(project, tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ExportError, match="is there and is no folder"):
        export_folder(project, tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


def test_link_to_a_folder_is_refused(project, tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "real")
    with pytest.raises(ExportError, match="link to a folder"):
        export_folder(project, tmp_path / "out")


def test_a_folder_that_failed_half_way_leaves_the_earlier_one(project, tmp_path, monkeypatch):
    target = tmp_path / "out"
    before = export_folder(project, target)

    def fail(self, source, target, options, feedback):
        target.mkdir()
        raise ExportError("half way")

    monkeypatch.setattr(FolderOfText, "write", fail)
    with pytest.raises(ExportError, match="half way"):
        export_folder(project, target)
    assert {p.relative_to(target).as_posix() for p in target.rglob("*") if p.is_file()} == before
