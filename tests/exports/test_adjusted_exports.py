"""What is exported after an adjustment is the adjusted result: pose, camera, pixels, ground."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
import zipfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio
import pytest
from adjusted_case import ADJUSTED, POINT_SIGMA, TURNED, add_control, adjusted_camera, save
from interchange_cases import CAMERAS
from lxml import etree

from exports.kml.kml import Kml, Kmz, write_kml
from exports.poses.colmap import Colmap
from exports.poses.opensfm import OpenSfm
from exports.poses.poses import ReferenceCsv
from exports.site import accuracy as accuracy_items
from exports.site.site import SiteLayers
from exports.tables.geojson import GeoJson
from exports.tables.geopackage import GeoPackage
from georef_gis.errors import ExportError
from georef_gis.ingest.poses_blocks import read_blocks
from georef_gis.model.grid import Grid
from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of
from processing_algorithms.measure.measure_photo import MeasurePhoto
from processing_algorithms.rasters import profile_for

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is the oracle; it is not installed")


@pytest.fixture
def case(tmp_path: Path) -> Iterator[tuple[Project, SiteLayers]]:
    (tmp_path / "site").mkdir()
    project, truth = save(tmp_path / "site")
    yield project, truth
    project.close()


def export(project: Project, exporter, **values: object) -> tuple[Path, tuple[str, ...]]:
    tool = tool_of(exporter)
    result = tool().run(Context(project=project), tool.Parameters(**values), CollectingFeedback())
    return Path(result.outputs["target"]), result.warnings


def reprojection(folder: Path) -> tuple[float, float]:
    """Mean error as the file says it, and as pycolmap finds it anew, px."""
    model = pycolmap.Reconstruction(str(folder))
    told = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    return told, model.compute_mean_reprojection_error()


def residual_mean(project: Project) -> float:
    """Mean length of the adjustment's own residuals by point, px."""
    with np.load(project.adjustment / "residuals.npz") as read:
        tie = read["mark"] < 0
        length = np.linalg.norm(read["residual"][tie], axis=1)
        point = read["point"][tie]
    return float(np.mean(np.bincount(point, weights=length) / np.bincount(point)))


# -- blocks ------------------------------------------------------------------------------------


def test_pycolmap_finds_the_residuals_of_the_adjustment(case) -> None:
    project, truth = case
    folder, warnings = export(project, Colmap)
    model = pycolmap.Reconstruction(str(folder))
    told, found = reprojection(folder)
    # px; observations are kept in single precision
    assert found == pytest.approx(residual_mean(project), abs=1e-3)
    assert told == pytest.approx(found, abs=1e-5)
    assert warnings == ()
    with np.load(project.adjustment / "points.npz") as read:
        assert model.num_points3D() == len(read["p_enu"]) > 20
    sizes = {c.camera_id: c.params.tolist() for c in model.cameras.values()}
    assert len(sizes) == 2
    assert sizes[1][0] == pytest.approx(adjusted_camera().fx)
    names = [one.photo.path.name for one in truth.photos]
    turned = model.find_image_with_name(names[TURNED])
    assert turned.camera_id == 2
    assert turned.num_points2D() > 3


@pytest.mark.parametrize("degrees", [90, 270])
def test_quarter_turns_that_the_matching_found_are_in_the_pixels(tmp_path, degrees) -> None:
    (tmp_path / "site").mkdir()
    project, _ = save(tmp_path / "site", degrees=degrees)
    folder, _ = export(project, Colmap)
    _, found = reprojection(folder)
    assert found == pytest.approx(residual_mean(project), abs=1e-3)
    (block,) = read_blocks(folder, "colmap")
    assert {(c.width, c.height) for c in block.cameras.values()} == {(640, 480), (480, 640)}
    project.close()


def test_photos_of_a_lens_that_was_held_have_the_pixels_of_their_lens(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    fisheye = replace(CAMERAS["fisheye"], id="k3")
    project, _ = save(tmp_path / "site", camera=fisheye, held=True)
    folder, _ = export(project, Colmap)
    _, found = reprojection(folder)
    # px: noise of 0.7 px per axis has a mean length of 0.88
    assert found == pytest.approx(residual_mean(project), abs=2e-3)
    assert 0.7 < found < 1.1
    project.close()


def test_a_skew_is_left_out_with_a_word_and_kept_beside(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    project, _ = save(tmp_path / "site", camera=adjusted_camera(b2=1.0))
    for exporter in (Colmap, OpenSfm):
        target, warnings = export(project, exporter)
        # b2 times the largest |v - cy| / fy
        (told,) = [line for line in warnings if "b2 = 1 px is left out" in line]
        camera = adjusted_camera(b2=1.0)
        most = max(camera.cy + 0.5, camera.height - 0.5 - camera.cy) / camera.fy
        assert f"up to {most:.2f} px in the photo" in told
        path = target / "georef_frame.json" if exporter is Colmap else target
        facts = json.loads(path.read_text())
        facts = facts if exporter is Colmap else facts[0]["georef_gis"]
        assert facts["cameras"][ADJUSTED]["b2"] == 1.0
    _, found = reprojection(project.products / "colmap")
    # px; larger than the noise alone, but by no more than the skew
    assert residual_mean(project) < found < residual_mean(project) + most
    project.close()


def test_a_skew_of_many_pixels_is_refused(tmp_path: Path) -> None:
    (tmp_path / "site").mkdir()
    project, _ = save(tmp_path / "site", camera=adjusted_camera(b2=20.0))
    with pytest.raises(ExportError, match="skew b2 = 20 px moves pixels"):
        export(project, Colmap)
    project.close()


def test_points_of_another_adjustment_are_left_out_with_a_word(case) -> None:
    project, _ = case
    path = project.adjustment / "points.npz"
    with np.load(path) as read:
        columns = {key: read[key] for key in read.files}
    columns["p_enu"] = columns["p_enu"] + [80.0, 0.0, 0.0]
    np.savez(path, **columns)
    folder, (warning,) = export(project, Colmap)
    assert "tie points are left out" in warning
    assert pycolmap.Reconstruction(str(folder)).num_points3D() == 0


def test_without_the_points_poses_are_written_and_the_lack_is_told(case) -> None:
    project, _ = case
    (project.adjustment / "points.npz").unlink()
    folder, (warning,) = export(project, Colmap)
    assert "no tie points are written" in warning
    assert pycolmap.Reconstruction(str(folder)).num_reg_images() == 6


@pytest.mark.parametrize("name", ["points.npz", "residuals.npz", "report.json"])
def test_a_damaged_file_of_the_adjustment_is_one_line_with_the_cure(case, name) -> None:
    project, _ = case
    path = project.adjustment / name
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(ExportError, match=rf"{name}: cannot be read .*georef adjust") as caught:
        export(project, Colmap)
    assert "\n" not in str(caught.value)


# -- values ------------------------------------------------------------------------------------


def test_camera_turn_and_residuals_are_those_of_the_chosen_pose(case) -> None:
    project, _ = case
    photos = SiteLayers.from_project(project).layers["photos"].features
    for i, feature in enumerate(photos):
        v = feature.values
        assert (v["pose_kind"], v["camera"]) == ("adjusted", ADJUSTED)
        assert v["turned_deg"] == (180 if i == TURNED else 0)
        assert v["residual_px"] == 0.5 + i
    # the footprints of a quick run go with the tags' poses
    database = project.database
    database.delete_rows("pose", {"kind": "adjusted"})
    for feature in SiteLayers.from_project(project).layers["photos"].features:
        v = feature.values
        assert (v["pose_kind"], v["camera"], v["turned_deg"]) == ("tags", "k3", 0)
        assert v["residual_px"] is None
    cameras = SiteLayers.from_project(project).layers["cameras"].features
    assert {f.values["camera"]: f.values["photos"] for f in cameras} == {"k3": 6, ADJUSTED: 0}


def test_height_above_the_adjusted_ground_has_its_sigma(case) -> None:
    project, truth = case
    poses = [one.pose for one in truth.photos]

    def sigmas() -> list[float | None]:
        return [one.sigma_above_ground for one in SiteLayers.from_project(project).photos]

    # the pose holds the shared height apart, so of the ground only its own share counts
    own = 0.5**2 - 0.4**2
    wanted = [math.sqrt(pose.covariance[2, 2] + own) for pose in poses]
    assert sigmas() == pytest.approx(wanted)
    rows = project.database.rows("pose", {"kind": "adjusted"})
    for row in rows:
        row.pop("fid")
        row["extra"] = {**row["extra"], "sigma_height_shared_m": 0.0}
    project.database.replace_rows("pose", rows, where={"kind": "adjusted"})
    wanted = [math.sqrt(pose.covariance[2, 2] + 0.5**2) for pose in poses]
    assert sigmas() == pytest.approx(wanted)
    # without a ground of its own the direct one, whose level is from the tags
    project.database.set_meta(ground_adjusted=None)
    wanted = [math.sqrt(pose.covariance[2, 2] + 1.5**2 + 12.0**2) for pose in poses]
    assert sigmas() == pytest.approx(wanted)


def test_pose_files_have_the_best_pose_whatever_the_footprints_used(case) -> None:
    project, truth = case
    target, _ = export(project, ReferenceCsv)
    lines = target.read_text(encoding="utf-8").splitlines()
    columns = next(line for line in lines if "longitude" in line).lstrip("#").split(",")
    rows = [line.split(",") for line in lines if line.startswith("IMG_")]
    assert len(rows) == len(truth.photos)
    for row, one in zip(rows, truth.photos, strict=True):
        _, _, h = truth.frame.origin.geo_from_enu(one.pose.origin_enu)
        assert float(row[columns.index("z")]) == pytest.approx(h, abs=1e-3)


# -- layers ------------------------------------------------------------------------------------


def test_geopackage_has_tie_points_and_control(case) -> None:
    project, truth = case
    add_control(project, truth)
    target, _ = export(project, GeoPackage)
    with closing(sqlite3.connect(target)) as connection:
        styles = dict(connection.execute("SELECT f_table_name, styleQML FROM layer_styles"))
    for name in ("tie_points", "control"):
        root = etree.fromstring(styles[name].encode())
        symbols = {e.get("name") for e in root.iter("symbol")}
        assert {e.get("symbol") for e in root.iter("rule")} == symbols
    points = pyogrio.read_dataframe(target, layer="tie_points")
    with np.load(project.adjustment / "points.npz") as read:
        p_enu, rays = read["p_enu"], read["rays"]
    assert len(points) == len(p_enu)
    wanted = truth.frame.map_from_enu(p_enu)
    # US survey feet
    assert points.geometry.x.to_numpy() == pytest.approx(wanted[:, 0], abs=1e-4)
    assert points["height_ellipsoidal_m"].to_numpy() == pytest.approx(wanted[:, 2], abs=1e-4)
    assert points["rays"].tolist() == rays.tolist()
    # 5 m of a level that cameras and points share
    level = math.hypot(POINT_SIGMA[2], 5.0)
    for key, sigma in zip(("e", "n", "u_block", "u"), (*POINT_SIGMA, level), strict=True):
        assert points[f"sigma_{key}_m"].to_numpy() == pytest.approx(sigma, rel=2e-3)
    assert points["residual_px"].between(0.05, 3.0).all()
    control = pyogrio.read_dataframe(target, layer="control").set_index("name")
    first, second = control.loc["GCP <1>"], control.loc["GCP 2"]
    assert (first["role"], first["marks"], first["rays"]) == ("check", 3, 3)
    assert [first["off_east_m"], first["off_north_m"]] == [0.01, -0.02]
    assert math.isnan(first["off_up_m"])
    assert first["sigma_u_m"] == pytest.approx(math.hypot(0.05, 5.0))
    assert [first["sigma_e_m"], first["residual_px"]] == [0.011, 0.4]
    h = truth.frame.map_from_enu([10.0, 20.0, -30.0])[2]
    assert first["height_ellipsoidal_m"] == pytest.approx(h, abs=1e-4)
    assert second["marks"] == 0
    assert math.isnan(second["height_ellipsoidal_m"])
    assert math.isnan(second["off_east_m"])
    other = str(project.folder / "w.gpkg")
    without, _ = export(project, GeoPackage, tie_points=False, target=other)
    assert "tie_points" not in {name for name, _ in pyogrio.list_layers(without)}


def test_geojson_has_control_and_on_demand_tie_points(case) -> None:
    project, truth = case
    add_control(project, truth)
    target, _ = export(project, GeoJson, layer="control")
    first, second = json.loads(target.read_text())["features"]
    assert len(first["geometry"]["coordinates"]) == 3
    assert len(second["geometry"]["coordinates"]) == 2
    target, _ = export(project, GeoJson, layer="site", tie_points=True)
    found = json.loads(target.read_text())["features"]
    points = [f for f in found if f["properties"]["layer"] == "tie_points"]
    with np.load(project.adjustment / "points.npz") as read:
        geo = truth.frame.origin.geo_from_enu(read["p_enu"][3])
    lon, lat, h = points[3]["geometry"]["coordinates"]
    assert [lon, lat] == pytest.approx(np.degrees(geo[1::-1]), abs=1e-8)
    assert h == pytest.approx(geo[2], abs=1e-3)


def test_kml_shows_control_where_it_was_surveyed(case) -> None:
    project, truth = case
    add_control(project, truth)
    target, _ = export(project, Kml, layer="control")
    root = etree.fromstring(target.read_bytes())
    ns = {"k": root.nsmap[None]}
    marks = root.findall(".//k:Placemark", ns)
    assert [m.findtext("k:name", namespaces=ns) for m in marks] == ["GCP <1>", "GCP 2"]
    modes = [m.findtext("k:Point/k:altitudeMode", namespaces=ns) for m in marks]
    assert modes == ["absolute", "clampToGround"]
    with pytest.raises(ExportError, match="too many for KML"):
        write_kml(SiteLayers.from_project(project), target, ("tie_points",))


def test_layers_that_are_not_there_say_why(case) -> None:
    project, _ = case
    project.database.delete_rows("pose", {"kind": "adjusted"})
    site = SiteLayers.from_project(project)
    assert len(site.layer("tie_points")) == 0
    assert "not adjusted" in site.why_empty(("tie_points",))
    with pytest.raises(ExportError, match="no control points"):
        export(project, GeoPackage, layer="control")


# -- other tools on the same project -----------------------------------------------------------


def test_a_photo_is_measured_with_its_adjusted_pose_and_camera(case) -> None:
    project, truth = case
    level = truth.frame.origin.height_ellipsoidal - 20.0
    project.database.set_meta(
        ground_adjusted={"kind": "flat", "sigma_m": 0.5, "height_ellipsoidal_m": level}
    )
    one = truth.photos[TURNED]
    # a pixel of the stored picture, which is turned by 180 deg
    camera = adjusted_camera()
    u, v = 411.0, 122.0
    d = one.pose.enu_directions(
        camera.ray([camera.width - 1 - u, camera.height - 1 - v]) * [-1, -1, 1]
    )
    tool = MeasurePhoto.Parameters(
        photo=one.photo.path.name, site=project.folder, pixel=[f"{u},{v}"]
    )
    summary = MeasurePhoto().run(Context(), tool, CollectingFeedback()).summary
    assert (summary["pose_kind"], summary["camera"]) == ("adjusted", ADJUSTED)
    (point,) = summary["points"]
    place = truth.frame.enu_from_map(
        [point["easting"], point["northing"], point["height_ellipsoidal_m"]]
    )
    assert point["height_ellipsoidal_m"] == pytest.approx(level, abs=2e-3)
    along = (place - one.pose.origin_enu) / np.linalg.norm(place - one.pose.origin_enu)
    # rad; 1 mm of rounding at 100 m
    assert along == pytest.approx(d, abs=2e-5)
    # the level that camera and ground share is in the sigma of the height
    assert point["sigma_u_m"] > 5.0


def test_rasters_say_from_which_poses_they_are(case) -> None:
    project, truth = case
    rows = [
        {"photo_id": one.photo.id, "pose_kind": "tags" if i else "adjusted"}
        for i, one in enumerate(truth.photos)
    ]
    project.database.add_rows("footprint", rows)
    grid = Grid(crs_wkt=truth.crs.to_wkt(), left=0.0, top=0.0, pixel=0.1, width=16, height=16)
    profile = profile_for(project, truth.frame, grid, bands=3, dtype="uint8", title="Mosaic")
    assert profile.metadata["POSES"] == "tags (5 photos), adjusted (1 photos)"


# -- accuracy ----------------------------------------------------------------------------------


def statement() -> tuple[dict, dict[str, str]]:
    """JSON and metadata of a report with 31 check points, by the stage that makes them."""
    from georef_gis.measure.accuracy.metadata import statement_json, statement_metadata
    from georef_gis.measure.accuracy.product import CheckResidual, Targets, assess
    from georef_gis.measure.accuracy.report import AccuracyReport, Survey

    rng = np.random.default_rng(2)
    residuals = [
        CheckResidual(
            name=f"c{i}", dx=d[0], dy=d[1] + 0.05, dz=d[2], sigma_h=0.01, sigma_v=0.02,
            x=float(i), y=float(-i), cover="vegetated" if i > 27 else "open",
        )
        for i, d in enumerate(rng.normal(0.0, 0.03, (31, 3)))
    ]  # fmt: skip
    report = AccuracyReport(
        title="Site", assessments=(assess(residuals, targets=Targets(horizontal=0.1)),),
        survey=Survey(datum="NAD83(2011)@2010.0"), untested={"c99": "in no photo"},
    )  # fmt: skip
    return statement_json(report), statement_metadata(report)


def record(project: Project, *tools: str) -> None:
    for tool in tools:
        project.database.insert("run", {"tool": f"georef:{tool}", "outcome": "done"})


def test_the_statement_is_in_what_is_exported(case) -> None:
    project, _ = case
    data, wanted = statement()
    assert len(wanted) > 10
    (project.products / "accuracy.json").write_text(json.dumps(data))
    record(project, "mosaic", "accuracy")
    assert SiteLayers.from_project(project).accuracy == wanted
    target, _ = export(project, GeoPackage)
    with closing(sqlite3.connect(target)) as connection:
        facts = dict(connection.execute("SELECT key, value FROM site_metadata"))
    for name, text in wanted.items():
        assert facts[name.lower()] == text
    target, _ = export(project, Kmz, thumbnails=False)
    with zipfile.ZipFile(target) as archive:
        root = etree.fromstring(archive.read("doc.kml"))
    (told, *_) = [e.text for e in root.iter("{*}description")]
    assert wanted["ACCURACY_STATEMENT_H"] in told
    target, _ = export(project, GeoJson, layer="site")
    assert json.loads(target.read_text())["metadata"] == wanted


def test_the_statement_of_an_older_mosaic_is_left_out_with_a_word(case) -> None:
    project, _ = case
    data, _ = statement()
    (project.products / "accuracy.json").write_text(json.dumps(data))
    record(project, "accuracy", "mosaic")
    target, (warning,) = export(project, GeoPackage)
    assert "older mosaic" in warning
    with closing(sqlite3.connect(target)) as connection:
        keys = [k for (k,) in connection.execute("SELECT key FROM site_metadata")]
    assert not any(key.startswith("accuracy_") for key in keys)


def test_a_damaged_statement_is_one_line(case) -> None:
    project, _ = case
    (project.products / "accuracy.json").write_text('{"format": "georef_gis accuracy 1"}')
    with pytest.raises(ExportError, match=r"accuracy.json: cannot be read .*georef accuracy"):
        export(project, GeoPackage)


def test_control_points_are_read_back_from_the_database(case) -> None:
    project, truth = case
    add_control(project, truth)
    (row, _) = project.database.rows("control")
    x, y, z = struct.unpack("<ddd", row["geom"][5:29])
    one = SiteLayers.from_project(project).control[0]
    assert one.p_map.tolist() == [x, y, z]


# -- agreement with the stage that writes the files --------------------------------------------


def test_the_files_are_read_as_the_adjustment_writes_them() -> None:
    from exports.site import adjustment
    from georef_gis.measure.accuracy.metadata import FORMAT
    from georef_gis.measure.accuracy.sentences import STANDARD
    from georef_gis.orient.adjustment import keep
    from processing_algorithms.measure.accuracy_table import JSON

    assert (adjustment.POINTS, adjustment.RESIDUALS) == (keep.POINTS, keep.RESIDUALS)
    assert (accuracy_items.STATEMENT, accuracy_items.FORMAT) == (JSON, FORMAT)
    assert statement()[1]["ACCURACY_STANDARD"] == STANDARD


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_pixels_are_turned_back_as_the_adjustment_turned_them(degrees: int) -> None:
    from exports.site.adjustment import turned_uv
    from georef_gis.orient.adjustment.build import uv_in_sensor

    camera = CAMERAS["k3"]
    uv = np.random.default_rng(1).uniform(0.0, 480.0, (9, 2))
    turned = turned_uv(uv, camera, degrees)
    assert uv_in_sensor(turned, camera.width, camera.height, degrees) == pytest.approx(uv)
