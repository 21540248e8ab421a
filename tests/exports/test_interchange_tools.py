"""The exporters as tools on a project: whole or not at all, and what they say of the frame."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from interchange_cases import CAMERAS, make_block_site

from exports.poses.colmap import Colmap
from exports.poses.opensfm import OpenSfm
from exports.poses.pose_tables import MetashapeCsv, Pix4dMapperCsv, Pix4dMaticCsv
from georef_gis.errors import ExportError, InputError
from georef_gis.ingest.poses import read_poses
from georef_gis.project import Project
from georef_gis.project.records import camera_row, photo_row, pose_row, save_frame
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of

EXPORTERS = (OpenSfm, Colmap, MetashapeCsv, Pix4dMapperCsv, Pix4dMaticCsv)


@pytest.fixture
def project(tmp_path: Path):
    """Six photos with poses by tags, and the better, adjusted ones; the second is turned."""
    folder = tmp_path / "site"
    folder.mkdir()
    site = make_block_site()
    project = Project.create(folder, {"project": {"name": "Site"}})
    project.prepare()
    rows = []
    for i, one in enumerate(site.photos):
        rough = replace(one.pose, kind="tags", origin_enu=one.pose.origin_enu + 5.0)
        for pose in (rough, one.pose):
            rows.append(
                pose_row(
                    one.photo.id, pose, site.frame, height_above_ground=100.0, dialect="ypr",
                    doubts=(), turned_deg=90 if i == 1 else 0,
                )
            )  # fmt: skip
    photos = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
    database = project.database
    with database.transaction():
        save_frame(database, site.frame)
        database.set_meta(epoch=site.epoch_gps)
        database.replace_rows("photo", photos)
        database.replace_rows("pose", rows)
        database.replace_rows("camera", [camera_row(CAMERAS["k3"])])
    yield project
    project.close()


def export(project: Project, exporter, **values: object) -> tuple[Path, dict]:
    tool = tool_of(exporter)
    result = tool().run(Context(project=project), tool.Parameters(**values), CollectingFeedback())
    return Path(result.outputs["target"]), dict(result.summary)


@pytest.mark.parametrize("exporter", EXPORTERS, ids=lambda e: e.id)
def test_the_best_pose_is_written_and_read_back(project: Project, exporter) -> None:
    target, summary = export(project, exporter)
    assert target == project.products / exporter.target
    assert summary["height_kind"] == "ellipsoidal"
    assert "EPSG:4" in summary["crs"]
    assert summary["features"] == 6
    assert [p.name for p in target.parent.iterdir() if ".part" in p.name] == []
    site = make_block_site()
    poses = read_poses(target)
    for one in site.photos:
        lat, lon, h = site.frame.origin.geo_from_enu(one.pose.origin_enu)
        geotag, _ = poses[one.photo.path.name]
        # rad; 1 mm
        assert (geotag.lat, geotag.lon) == pytest.approx((lat, lon), abs=1.6e-10)
        assert geotag.height is not None
        assert geotag.height.value == pytest.approx(h, abs=1e-3)


def test_turned_photos_keep_the_pixels_that_are_stored(project: Project) -> None:
    target, _ = export(project, OpenSfm)
    (one,) = json.loads(target.read_text(encoding="utf-8"))
    sizes = {key: (c["width"], c["height"]) for key, c in one["cameras"].items()}
    assert sizes == {"k3": (640, 480), "k3 turned 90": (480, 640)}
    assert one["shots"]["IMG_1.JPG"]["camera"] == "k3 turned 90"
    # 2026-05-01 12:00:00 UTC, 18 s behind GPS
    assert one["shots"]["IMG_0.JPG"]["capture_time"] == pytest.approx(1777636800.0, abs=1e-3)


def test_a_second_export_takes_the_place_of_the_first_but_of_nothing_else(project) -> None:
    folder, _ = export(project, Colmap)
    assert (folder / "images.txt").is_file()
    export(project, Colmap)
    (folder / "mine.txt").write_text("x")
    with pytest.raises(ExportError, match=r"holds mine.txt"):
        export(project, Colmap)


def test_a_camera_that_cannot_be_held_leaves_nothing_behind(project: Project) -> None:
    rows = [camera_row(replace(CAMERAS["k3"], model="brown_inverse"))]
    database = project.database
    with database.transaction():
        database.replace_rows("camera", rows)
    for exporter in (OpenSfm, Colmap):
        with pytest.raises(ExportError, match=r"no model like 'brown_inverse'"):
            export(project, exporter)
        assert not (project.products / exporter.target).exists()
    export(project, MetashapeCsv)


def test_angles_of_the_map_need_its_coordinates(project: Project) -> None:
    with pytest.raises(ExportError, match="use crs=project"):
        export(project, MetashapeCsv, angles="opk")
    target, summary = export(project, MetashapeCsv, angles="opk", crs="project")
    assert summary["crs"] == "EPSG:6549"
    ((_, attitude), *_) = read_poses(target).values()
    assert attitude is not None
    assert attitude.dialect == "opk"
    with pytest.raises(InputError):
        export(project, Pix4dMaticCsv, angles="opk")


def test_layers_without_poses_are_refused(project: Project) -> None:
    with pytest.raises(ExportError, match="layer footprints has no poses"):
        export(project, OpenSfm, layer="footprints")
