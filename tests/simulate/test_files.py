"""A written flight folder: columns, checksums, tags, sizes, and truth that belongs to it."""

import csv
import hashlib
import io
import json
import re

import numpy as np
import piexif
import pyproj
import pytest
import rasterio

from georef_gis import frames
from georef_gis.simulate import ellipsoid, project_truth, simulate_flight, site, write_flight
from georef_gis.units import gps_from_week


def read_rows(path):
    lines = [x for x in path.read_text(encoding="utf-8").splitlines() if not x.startswith("#")]
    return list(csv.DictReader(io.StringIO("\n".join(lines))))


COLUMNS = {
    "logs/imu.csv": "gps_week tow_s gyro_x_rad_s gyro_y_rad_s gyro_z_rad_s accel_x_m_s2 "
    "accel_y_m_s2 accel_z_m_s2",
    "logs/gnss.csv": "gps_week tow_s lat_deg lon_deg height_ellipsoidal_m v_north v_east v_down "
    "sigma_north_m sigma_east_m sigma_down_m sigma_v_north sigma_v_east sigma_v_down fix",
    "control/control.csv": "name easting northing height sigma_h_m sigma_v_m role",
    "control/marks.csv": "name photo u v sigma_px",
}


@pytest.mark.parametrize("name", COLUMNS)
def test_columns_are_the_contracts(folder, name):
    rows = read_rows(folder / name)
    assert list(rows[0]) == COLUMNS[name].split()
    truth = folder / "truth" / name.split("/")[1]
    assert list(read_rows(truth)[0]) == COLUMNS[name].split()


@pytest.mark.parametrize(("name", "step"), [("imu", 0.01), ("gnss", 0.2)])
def test_log_times_step_evenly_over_the_week_boundary(folder, name, step):
    rows = read_rows(folder / "logs" / f"{name}.csv")
    tow = np.array([float(r["tow_s"]) for r in rows])
    week = np.array([int(r["gps_week"]) for r in rows])
    assert tow.max() < 604800.0
    assert set(week) == {week[0], week[0] + 1}
    time = week * 604800.0 + tow
    np.testing.assert_allclose(np.diff(time), step, atol=1e-6)  # s


def test_sync_board_lines_have_the_form_and_the_checksum(folder, flight):
    text = (folder / "logs" / "sync_board.log").read_bytes().decode("ascii")
    lines = text.splitlines()
    assert len(lines) == len(flight.triggers)
    for seq, line in enumerate(lines, start=1):
        body, checksum = re.fullmatch(r"\$(TSB,[^*]+)\*([0-9A-F]{2})", line).groups()
        total = 0
        for character in body:
            total ^= ord(character)
        assert int(checksum, 16) == total
        fields = body.split(",")
        assert len(fields) == 6
        assert int(fields[1]) == seq


def test_exif_and_xmp_carry_the_tags(folder, flight):
    data = (folder / "photos" / "IMG_0003.JPG").read_bytes()
    exif = piexif.load(data)
    assert exif["0th"][piexif.ImageIFD.Model] == b"Canon EOS DIGITAL REBEL XTi"
    assert exif["Exif"][piexif.ExifIFD.FocalLength] == (18, 1)
    per_inch = exif["Exif"][piexif.ExifIFD.FocalPlaneXResolution]
    assert 1296 / (per_inch[0] / per_inch[1]) * 25.4 == pytest.approx(22.2, abs=1e-3)  # mm
    lat = sum(n / d / 60**k for k, (n, d) in enumerate(exif["GPS"][piexif.GPSIFD.GPSLatitude]))
    assert lat == pytest.approx(flight.tags.lat_deg[2], abs=1e-9)  # deg: 0.1 mm
    lon = sum(n / d / 60**k for k, (n, d) in enumerate(exif["GPS"][piexif.GPSIFD.GPSLongitude]))
    assert -lon == pytest.approx(flight.tags.lon_deg[2], abs=1e-9)
    assert exif["GPS"][piexif.GPSIFD.GPSLongitudeRef] == b"W"
    height = exif["GPS"][piexif.GPSIFD.GPSAltitude]
    assert height[0] / height[1] == pytest.approx(flight.tags.height_orthometric[2], abs=1e-3)
    stamp = exif["Exif"][piexif.ExifIFD.DateTimeOriginal].decode()
    assert stamp == flight.tags.camera_clock[2].strftime("%Y:%m:%d %H:%M:%S")
    yaw = re.search(rb"<Camera:Yaw>([-\d.]+)</Camera:Yaw>", data)
    assert float(yaw[1]) == pytest.approx(flight.tags.yaw_deg[2], abs=1e-3)


def test_control_is_in_feet_of_the_named_crs(folder, flight):
    text = (folder / "control" / "control.csv").read_text(encoding="utf-8")
    assert "# crs: EPSG:6601" in text
    assert "# geoid: EGM96" in text
    back = pyproj.Transformer.from_crs(6601, 6318, always_xy=True)
    for row, point in zip(read_rows(folder / "truth" / "control.csv"), flight.control, strict=True):
        lon, lat = np.radians(back.transform(float(row["easting"]), float(row["northing"])))
        h = float(row["height"]) * 1200 / 3937 + site.geoid_height(lat, lon)
        p = ellipsoid.ecef_from_geodetic(lat, lon, h)
        np.testing.assert_allclose(p, point.p_ecef, atol=1e-3)  # m


def test_marks_are_the_projections_of_the_control_points(folder, flight):
    place = {p.name: p.p_ecef for p in flight.control}
    for row in read_rows(folder / "truth" / "marks.csv"):
        uv = project_truth(flight, flight.names.index(row["photo"]), place[row["name"]])
        np.testing.assert_allclose([float(row["u"]), float(row["v"])], uv, atol=1e-4)  # px
    noise = np.array([m.uv - m.uv_true for m in flight.marks])
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(flight.settings.mark_sigma, rel=0.25)


def test_true_poses_chain_with_the_packages_frames(folder, flight):
    """The one place where the simulator's frames meet the package's: they must agree."""
    for row in read_rows(folder / "truth" / "poses.csv"):
        lat, lon = (np.radians(float(row[f"{c}_deg"])) for c in ("lat", "lon"))
        axes = [f"{i}{j}" for i in range(3) for j in range(3)]
        R_ec, R_nc = (
            np.array([float(row[f"R_{to}_from_cam_{a}"]) for a in axes]).reshape(3, 3)
            for to in ("ecef", "ned")
        )
        np.testing.assert_allclose(frames.R_ecef_from_ned(lat, lon) @ R_nc, R_ec, atol=1e-9)
        rpy = np.radians([float(row[f"{c}_deg"]) for c in ("roll", "pitch", "yaw")])
        mount = json.loads((folder / "truth" / "mount.json").read_text())
        R_bc = frames.exp_so3(np.array(mount["boresight_body"])) @ np.array(
            mount["R_body_from_cam_nominal"]
        )
        # 1e-7 rad: body and camera stand 0.2 m apart on the ellipsoid
        np.testing.assert_allclose(frames.R_ned_from_body(*rpy) @ R_bc, R_nc, atol=1e-7)


def test_dem_is_the_ground_in_utm(folder, flight):
    with rasterio.open(folder / "dem.asc") as dem:
        assert dem.crs.to_epsg() == 32617
        back = pyproj.Transformer.from_crs(32617, 4326, always_xy=True)
        miss = []
        for row, col in ((10, 10), (100, 100), (50, 150), (190, 5)):
            lon, lat = np.radians(back.transform(*dem.xy(row, col)))
            expected = site.ground_height(lat, lon) - site.geoid_height(lat, lon)
            miss.append(dem.read(1)[row, col] - expected)
    assert np.abs(miss).max() < 4.5 * flight.settings.dem_sigma


def test_true_triggers_name_the_missed_and_the_spurious(folder, flight):
    rows = read_rows(folder / "truth" / "triggers.csv")
    assert [r["seq"] for r in rows].count("missed") == 1
    assert [r["photo"] for r in rows].count("spurious") == 1
    times = [gps_from_week(int(r["gps_week"]), float(r["tow_s"])) for r in rows]
    assert times == sorted(times)


@pytest.mark.slow
def test_same_seed_writes_the_same_bytes(flight, folder, tmp_path):
    write_flight(simulate_flight(flight.settings, seed=7), tmp_path, photos=[2], truth_imu=True)
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        a, b = (hashlib.sha256(p.read_bytes()).hexdigest()
                for p in (path, tmp_path / path.relative_to(folder)))  # fmt: skip
        assert a == b, path.name


def test_default_flight_stays_below_eight_megabytes(folder):
    photo = (folder / "photos" / "IMG_0003.JPG").stat().st_size
    rest = sum(
        p.stat().st_size
        for p in folder.rglob("*")
        if p.is_file() and p.suffix != ".JPG" and p != folder / "truth" / "imu.csv"
    )
    assert 16 * 1.3 * photo + rest < 8e6  # 1.3: the photo that compresses worst
