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
from conftest import NASTY, make_site, write_mosaic, write_photos
from rio_cogeo.cogeo import cog_validate

import exports
from exports.site import SiteLayers
from georef_gis.errors import ExportError
from georef_gis.project import Project
from georef_gis.project.records import (
    camera_row,
    footprint_row,
    photo_row,
    pose_row,
    save_frame,
)
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of

CRS = "EPSG:6549"
TOOLS = {exporter.id: exporter for exporter in exports.EXPORTERS}


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
    if exporter.id in ("odm_geo", "poses_csv"):
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
    assert len(messages) == 6
    for name, text in messages.items():
        assert "cannot be written" in text, (name, text)
        assert "\n" not in text
    assert sorted(p.name for p in project.products.iterdir()) == before


def test_layer_without_export_is_refused(project):
    with pytest.raises(ExportError, match="photos"):
        export(project, "geojson", layer="control")
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
