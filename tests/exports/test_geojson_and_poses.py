"""GeoJSON by its RFC, pose files by what their programs read."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pyogrio
import pytest
from shapely.geometry import shape
from site_cases import NASTY, make_site

from exports.poses.poses import write_geo_txt, write_reference_csv
from exports.tables.geojson import write_geojson
from georef_gis.errors import ExportError
from georef_gis.frames import exp_so3


def read(path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:6549"])
def test_geojson_is_in_degrees_with_ellipsoidal_heights(tmp_path, crs):
    site = make_site(tmp_path, crs=crs)
    report = write_geojson(site, tmp_path / "p.geojson", ("photos",))
    data = read(tmp_path / "p.geojson")
    assert (report.crs, report.height_kind, report.features) == ("EPSG:4326", "ellipsoidal", 3)
    assert "crs" not in data
    assert data["features"][0]["geometry"]["coordinates"] == [-83.0, 40.0, 300.0]
    assert len(data["bbox"]) == 4
    assert data["bbox"][:2] == pytest.approx([-83.0, 40.0], abs=1e-6)
    assert data["features"][1]["properties"]["photo"] == NASTY


def test_geojson_rings_follow_the_right_hand(site, tmp_path):
    write_geojson(site, tmp_path / "f.geojson", ("footprints",))
    for feature in read(tmp_path / "f.geojson")["features"]:
        ring = feature["geometry"]["coordinates"][0]
        assert ring[0] == ring[-1]
        assert all(len(point) == 2 for point in ring)
        polygon = shape(feature["geometry"])
        assert polygon.is_valid
        assert polygon.exterior.is_ccw
        assert feature["bbox"] == pytest.approx(polygon.bounds, abs=1e-12)


def test_geojson_of_the_site_names_the_layers(site, tmp_path):
    write_geojson(site, tmp_path / "s.geojson")
    kinds = [
        (f["properties"]["layer"], f["geometry"]["type"])
        for f in read(tmp_path / "s.geojson")["features"]
    ]
    assert kinds == [("photos", "Point")] * 3 + [("footprints", "Polygon")] * 3 + [
        ("track", "LineString")
    ]


def test_gdal_reads_the_geojson(site, tmp_path):
    write_geojson(site, tmp_path / "f.geojson", ("footprints",))
    frame = pyogrio.read_dataframe(tmp_path / "f.geojson")
    assert frame.crs.to_epsg() == 4326
    assert frame.to_crs(32617).area.to_numpy() == pytest.approx(768.0, rel=3e-3)


def test_numbers_have_nine_decimals_at_most(site, tmp_path):
    write_geojson(site, tmp_path / "t.geojson", ("track",))
    points = read(tmp_path / "t.geojson")["features"][0]["geometry"]["coordinates"]
    assert all(len(repr(x).partition(".")[2]) <= 9 for point in points for x in point[:2])


def odm_R_map_from_photo(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """As OpenDroneMap builds it from geo.txt: body north-east-down, then axes swapped (deg)."""
    y, p, r = np.radians([yaw, pitch, roll])
    cy, sy, cp, sp, cr, sr = (f(a) for a in (y, p, r) for f in (np.cos, np.sin))
    ned_from_body = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    return swap @ ned_from_body @ swap


def test_geo_txt_means_the_same_to_odm(site, tmp_path):
    R_down = site.photos[0].pose.R_enu_from_cam
    R = exp_so3([0.1, -0.2, 0.7]) @ R_down
    pose = replace(site.photos[0].pose, R_enu_from_cam=R)
    one = replace(site, photos=(replace(site.photos[0], pose=pose),))
    write_geo_txt(one, tmp_path / "geo.txt")
    header, line = (tmp_path / "geo.txt").read_text().splitlines()
    assert header == "EPSG:4326"
    name, lon, lat, h, *rest = line.split()
    assert (name, float(lon), float(lat), float(h)) == ("p1.jpg", -83.0, 40.0, 300.0)
    R_photo = R @ np.diag([1, -1, -1])
    assert odm_R_map_from_photo(*map(float, rest[:3])) == pytest.approx(R_photo, abs=1e-7)
    assert [float(v) for v in rest[3:]] == pytest.approx([math.sqrt(2.5), 3.0], abs=1e-4)


def test_geo_txt_leaves_out_names_with_blanks(site, tmp_path):
    report = write_geo_txt(site, tmp_path / "geo.txt")
    assert report.features == 2
    assert "blanks" in report.warnings[0]
    only = replace(site, photos=site.photos[1:2])
    with pytest.raises(ExportError, match="use CSV"):
        write_geo_txt(only, tmp_path / "geo.txt")


def test_reference_csv_has_both_sets_of_angles(tmp_path):
    site = make_site(tmp_path, crs="EPSG:6549")
    report = write_reference_csv(site, tmp_path / "p.csv")
    assert (report.crs, report.height_kind) == ("EPSG:6549", "ellipsoidal")
    lines = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# CRS EPSG:6549")
    assert "US survey foot" in lines[0]
    rows = list(csv.DictReader(lines[1:]))
    assert rows[1]["label"] == NASTY
    x, y = site.layers["photos"].features[0].xy_map[0]
    assert (float(rows[0]["x"]), float(rows[0]["y"])) == pytest.approx((x, y), abs=1e-4)
    assert float(rows[0]["z"]) == 300.0
    assert float(rows[0]["yaw"]) == pytest.approx(0.0, abs=1e-6)
    # Ohio North, Lambert about 82.5 W and 41.07 N: convergence is (lon - lon0) sin(lat0)
    expected = -0.5 * math.sin(math.radians(41.07))
    assert float(rows[0]["kappa"]) == pytest.approx(expected, abs=1e-3)
    assert float(rows[0]["accuracy_z"]) == 3.0


def test_no_pose_is_no_pose_file(site, tmp_path):
    empty = replace(site, photos=tuple(replace(p, pose=None) for p in site.photos))
    with pytest.raises(ExportError, match="no photo has a pose"):
        write_reference_csv(empty, tmp_path / "p.csv")
