"""Tables of poses: axis orders, angles by scipy, units, and what comes back."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from interchange_cases import PLACES, make_block_site, with_blanks
from pyproj import CRS, Transformer
from scipy.spatial.transform import Rotation

from exports.poses.pose_tables import (
    _wish,
    write_metashape,
    write_pix4dmapper,
    write_pix4dmatic,
)
from georef_gis.errors import ExportError
from georef_gis.geodesy import geoid_undulation
from georef_gis.ingest.poses import read_poses
from georef_gis.model.pose import Mount
from georef_gis.orient.dialects import R_enu_from_cam_of_tag


def local_axes(lat: float, lon: float) -> np.ndarray:
    """East, north, up at a place as columns in ecef."""
    ned = Rotation.from_euler("ZY", [lon, -lat - math.pi / 2]).as_matrix()
    return ned @ [[0, 1, 0], [1, 0, 0], [0, 0, -1]]


def convergence(lat: float, lon: float, crs: str) -> float:
    """Azimuth of grid north from true north, rad, by a step along the meridian."""
    to_map = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    e, n = to_map.transform(
        [math.degrees(lon)] * 2, [math.degrees(lat) - 5e-4, math.degrees(lat) + 5e-4]
    )
    return -math.atan2(e[1] - e[0], n[1] - n[0])


def expected(site, one, crs: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotation in axes level at the photo: true north, and grid north."""
    o = site.frame.origin
    lat, lon, _ = o.geo_from_enu(one.pose.origin_enu)
    R_local = local_axes(lat, lon).T @ local_axes(o.lat, o.lon) @ one.pose.R_enu_from_cam
    turn = Rotation.from_euler("z", convergence(lat, lon, crs)).as_matrix()
    return R_local, turn @ R_local


def from_ypr(deg: list[float]) -> np.ndarray:
    """Yaw, pitch, roll of a body (forward, right, down) whose camera looks down."""
    R_ned_body = Rotation.from_euler("ZYX", deg, degrees=True).as_matrix()
    enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    return enu @ R_ned_body @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]]


def from_opk(deg: list[float]) -> np.ndarray:
    """Rx(omega) Ry(phi) Rz(kappa) of axes right, up, backwards."""
    return Rotation.from_euler("XYZ", deg, degrees=True).as_matrix() @ np.diag([1, -1, -1])


def rows_of(path: Path) -> list[list[str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.reader(line for line in lines if not line.startswith("#")))


def angle(R_a: np.ndarray, R_b: np.ndarray) -> float:
    return Rotation.from_matrix(R_a.T @ R_b).magnitude()


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("angles", ["ypr", "opk"])
def test_angles_and_places_of_metashape(tmp_path: Path, place: str, angles: str) -> None:
    site, crs = make_block_site(place), PLACES[place][2]
    write_metashape(site, tmp_path / "m.csv", _wish(angles, "project", "ellipsoidal"))
    for row, one in zip(rows_of(tmp_path / "m.csv"), site.photos, strict=True):
        true, grid = expected(site, one, crs)
        found = [float(v) for v in row[4:7]]
        R = from_ypr(found) if angles == "ypr" else from_opk(found)
        # rad; the convergence by finite differences is good to 1e-8
        assert angle(R, true if angles == "ypr" else grid) < 1e-7
        lat, lon, h = site.frame.origin.geo_from_enu(one.pose.origin_enu)
        to_map = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        xy = to_map.transform(math.degrees(lon), math.degrees(lat))
        assert [float(v) for v in row[1:3]] == pytest.approx(xy, abs=1e-4)
        assert float(row[3]) == pytest.approx(h, abs=1e-4)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("crs", ["geographic", "project"])
@pytest.mark.parametrize("angles", ["ypr", "opk"])
def test_metashape_comes_back(tmp_path: Path, place: str, crs: str, angles: str) -> None:
    if (crs, angles) == ("geographic", "opk"):
        with pytest.raises(ExportError, match="axes of a map"):
            _wish(angles, crs, "ellipsoidal")
        return
    site = make_block_site(place)
    write_metashape(site, tmp_path / "m.csv", _wish(angles, crs, "ellipsoidal"))
    check_round_trip(site, read_poses(tmp_path / "m.csv"), kind="ellipsoidal")


def check_round_trip(site, poses, *, kind: str) -> None:
    """Places to 1 mm, angles to 1e-6 rad, sigmas to what their decimals hold."""
    origin = site.frame.origin
    assert len(poses) == len(site.photos)
    for one in site.photos:
        geotag, attitude = poses[one.photo.path.name]
        height = geotag.height
        assert height is not None
        assert height.kind == kind
        lat, lon, _ = origin.geo_from_enu(one.pose.origin_enu)
        value = height.value if kind == "unknown" else height.ellipsoidal(geotag.lat, geotag.lon)
        p = origin.enu_from_geo([geotag.lat, geotag.lon, value])
        assert p == pytest.approx(one.pose.origin_enu, abs=1e-3)
        assert attitude is not None
        R = R_enu_from_cam_of_tag(
            attitude, yaw=attitude.yaw or 0.0, origin=origin, vehicle_lat=lat, vehicle_lon=lon,
            mount=Mount(), convergence=site.frame.convergence_at(one.pose.origin_enu),
        )  # fmt: skip
        assert angle(R, one.pose.R_enu_from_cam) < 1e-6
        c = one.pose.covariance
        sigma_v = math.sqrt(c[2, 2] + one.pose.sigma_height_shared**2)
        assert geotag.sigma_v == pytest.approx(sigma_v, rel=3e-3, abs=1e-4)
        assert geotag.sigma_h == pytest.approx(math.sqrt((c[0, 0] + c[1, 1]) / 2), rel=3e-3)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("crs", ["geographic", "project"])
def test_pix4dmatic_comes_back(tmp_path: Path, place: str, crs: str) -> None:
    site = make_block_site(place)
    report = write_pix4dmatic(site, tmp_path / "p.csv", _wish("ypr", crs, "ellipsoidal"))
    assert report.crs == ("EPSG:4326" if crs == "geographic" else PLACES[place][2])
    check_round_trip(site, read_poses(tmp_path / "p.csv"), kind="ellipsoidal")


def test_pix4dmatic_follows_the_axes_of_the_crs_and_pix4dmapper_does_not(tmp_path: Path) -> None:
    # NZTM states northing first; UTM easting first; WGS 84 latitude first.
    assert CRS("EPSG:2193").axis_info[0].direction == "north"
    for place, north_first in (("New Zealand", True), ("Chile", False)):
        site = make_block_site(place)
        f = site.layers["photos"].features[0]
        wish = _wish("ypr", "project", "ellipsoidal")
        write_pix4dmatic(site, tmp_path / "matic.csv", wish)
        write_pix4dmapper(site, tmp_path / "mapper.csv", wish)
        matic = [float(v) for v in rows_of(tmp_path / "matic.csv")[0][1:3]]
        mapper = [float(v) for v in rows_of(tmp_path / "mapper.csv")[0][1:3]]
        east, north = f.xy_map[0]
        assert mapper == pytest.approx([east, north], abs=1e-4)
        assert matic == pytest.approx([north, east] if north_first else [east, north], abs=1e-4)
        wish = _wish("ypr", "geographic", "ellipsoidal")
        for write in (write_pix4dmatic, write_pix4dmapper):
            write(site, tmp_path / "geo.csv", wish)
            first = [float(v) for v in rows_of(tmp_path / "geo.csv")[0][1:3]]
            assert first == pytest.approx([f.geo[0, 1], f.geo[0, 0]], abs=1e-9)


@pytest.mark.parametrize("place", PLACES)
def test_pix4dmapper_comes_back_where_the_photos_are(tmp_path: Path, place: str) -> None:
    site, crs = make_block_site(place), PLACES[place][2]
    o = site.frame.origin
    write_pix4dmapper(site, tmp_path / "p.csv", _wish("ypr", "geographic", "ellipsoidal"))
    check_round_trip(site, read_poses(tmp_path / "p.csv"), kind="unknown")
    if place == "Ohio in feet":
        return
    write_pix4dmapper(site, tmp_path / "p.csv", _wish("ypr", "project", "ellipsoidal"))
    # North-first CRSs: the place of the photos tells the order.
    poses = read_poses(tmp_path / "p.csv", format="pix4d", crs=crs, near=(o.lat, o.lon))
    check_round_trip(site, poses, kind="unknown")


def test_pix4dmapper_writes_omega_phi_kappa_of_the_grid(tmp_path: Path) -> None:
    for place in PLACES:
        site = make_block_site(place)
        write_pix4dmapper(site, tmp_path / "p.csv", _wish("opk", "project", "ellipsoidal"))
        for row, one in zip(rows_of(tmp_path / "p.csv"), site.photos, strict=True):
            _, grid = expected(site, one, PLACES[place][2])
            assert angle(from_opk([float(v) for v in row[4:7]]), grid) < 1e-7


def test_heights_in_feet_are_those_of_pix4d_and_metres_those_of_metashape(tmp_path: Path) -> None:
    site = make_block_site("Ohio in feet")
    wish = _wish("ypr", "project", "ellipsoidal")
    h = float(site.layers["photos"].features[0].geo[0, 2])
    write_pix4dmapper(site, tmp_path / "p.csv", wish)
    # US survey foot
    assert float(rows_of(tmp_path / "p.csv")[0][3]) == pytest.approx(h * 3937 / 1200, abs=1e-4)
    write_metashape(site, tmp_path / "m.csv", wish)
    assert float(rows_of(tmp_path / "m.csv")[0][3]) == pytest.approx(h, abs=1e-4)


def test_orthometric_heights_say_so(tmp_path: Path) -> None:
    site = make_block_site("New Zealand")
    wish = _wish("ypr", "geographic", "orthometric")
    report = write_metashape(site, tmp_path / "m.csv", wish)
    assert report.height_kind == "orthometric (EGM96)"
    assert "# heights: orthometric (EGM96), m" in (tmp_path / "m.csv").read_text()
    lat, lon, h = site.frame.origin.geo_from_enu(site.photos[0].pose.origin_enu)
    value = float(rows_of(tmp_path / "m.csv")[0][3])
    assert value == pytest.approx(h - float(geoid_undulation(lat, lon)), abs=1e-4)
    assert abs(value - h) > 5.0
    check_round_trip(site, read_poses(tmp_path / "m.csv"), kind="orthometric")


def test_names_with_commas_are_left_out_of_pix4d_and_told(tmp_path: Path) -> None:
    site = with_blanks(make_block_site())
    wish = _wish("ypr", "geographic", "ellipsoidal")
    report = write_pix4dmatic(site, tmp_path / "p.csv", wish)
    assert report.features == 5
    assert "1 photos left out" in report.warnings[0]
    assert write_metashape(site, tmp_path / "m.csv", wish).features == 6
    assert 'a "b", c.JPG' in read_poses(tmp_path / "m.csv")
    with pytest.raises(ExportError, match="cannot hold names"):
        write_pix4dmapper(replace(site, photos=site.photos[:1]), tmp_path / "p.csv", wish)
    with pytest.raises(ExportError, match="no photo has a pose"):
        write_metashape(replace(site, photos=tuple(replace(p, pose=None) for p in site.photos)),
                        tmp_path / "p.csv", wish)  # fmt: skip
