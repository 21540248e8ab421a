"""What `georef init` finds beside the photos and enters into project.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from photo_writer import write_photo
from test_logs_mrk import line as mrk_line

from georef_gis.app import cli
from georef_gis.project import read_settings

TAGS = {
    "IFD0:Make": "Canon", "IFD0:Model": "Canon EOS 450D", "ExifIFD:FocalLength": 24,
    "ExifIFD:FocalLengthIn35mmFormat": 39,
    "GPS:GPSLatitude": 39.0975, "GPS:GPSLongitude": 80.467, "GPS:GPSLongitudeRef": "W",
    "GPS:GPSAltitude": 374.0,
}  # fmt: skip
IMU = "gps_week,tow_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
IMU = f"{IMU}\n" + "1536,604741.2,0,0,0,0.1,0.2,-9.8\n1536,604741.3,0,0,0,0.1,0.2,-9.8\n"
GNSS = "gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m\n"
GNSS += "1536,604741.2,39.09,-80.46,335.4\n1536,604741.4,39.09,-80.46,335.5\n"
TSB = "$TSB,1,1536,604749.116585,1498,1*44\n$TSB,2,1536,604751.218195,1499,1*47\n"
POS = (
    "%  GPST            latitude(deg) longitude(deg) height(m) Q\n"
    "2025/07/08 19:34:18.499 40.0966268 -105.1474483 1601.474 1\n"
)
NMEA = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n"
# heads by which the formats are known
ULG, BIN = b"ULog\x01\x12\x35" + bytes(60), b"\xa3\x95\x80" + bytes(90)
# a whole frame: sync, NAV-EOE, 4 bytes, checksum
UBX = b"\xb5b\x01\x61\x04\x00\x00\x00\x00\x00\x66\xc7"
CONTROL = "# CRS EPSG:32617\nname,easting,northing,height\nA,1,2,3\n"


def put(folder: Path, files: dict[str, str | bytes]) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A flight's folder with photos in it, and a project's folder elsewhere."""
    photos = tmp_path / "flight" / "photos"
    photos.mkdir(parents=True)
    write_photo(photos / "IMG_1.JPG", tags=TAGS)
    return tmp_path


def init(site: Path, photos: str = "flight/photos", into: str = "project") -> tuple[dict, str]:
    """project.toml of a new project, parsed and as text."""
    words = ["init", str(site / photos), "--into", str(site / into)]
    done = CliRunner().invoke(cli.georef, words)
    assert done.exit_code == 0, done.output
    path = site / into / "project.toml"
    read_settings(path)
    return tomllib.loads(path.read_text()), path.read_text()


@pytest.mark.parametrize("place", ["flight/photos", "flight", "flight/photos/logs", "flight/Logs",
                                   "project", "project/logs"])  # fmt: skip
def test_logs_are_found_in_every_place(site: Path, place: str) -> None:
    put(site / place, {"imu.csv": IMU, "gnss.csv": GNSS, "sync_board.log": TSB})
    settings, _ = init(site)
    logs = settings["logs"]
    for key, name in (("imu", "imu.csv"), ("gnss", "gnss.csv"), ("sync", "sync_board.log")):
        assert (site / "project" / logs[key]).resolve() == site / place / name
    assert "files" not in logs


def test_dem_control_marks_and_poses_are_found_beside_the_photos(site: Path) -> None:
    put(
        site / "flight",
        {"dem/dem.asc": "x", "control/control.csv": CONTROL, "control/marks.csv": "name,photo,u,v"},
    )
    put(site / "flight" / "photos", {"geo.txt": "EPSG:4326\n"})
    settings, _ = init(site)
    assert settings["ground"]["dem"] == "../flight/dem/dem.asc"
    assert settings["control"] == {
        "file": "../flight/control/control.csv", "marks": "../flight/control/marks.csv",
    }  # fmt: skip
    assert settings["poses"]["file"] == "../flight/photos/geo.txt"


def test_files_in_the_folder_of_the_project_go_first(site: Path) -> None:
    put(site, {"flight/dem.asc": "x", "project/dem.asc": "x"})
    assert init(site)[0]["ground"]["dem"] == "dem.asc"


def test_dem_among_the_photos_is_no_photo(site: Path) -> None:
    with rasterio.open(
        site / "flight" / "photos" / "dem.tif", "w", driver="GTiff", width=4, height=4, count=1,
        dtype="float32", crs="EPSG:32617", transform=rasterio.Affine(1, 0, 5e5, 0, -1, 4e6),
    ) as target:  # fmt: skip
        target.write(np.full((4, 4), 300.0, np.float32), 1)
    settings, text = init(site)
    assert settings["ground"]["dem"] == "../flight/photos/dem.tif"
    assert settings["photos"]["exclude"] == ["dem.tif"]
    assert "Found: 1 photos" in text
    assert "cannot be used" not in text


@pytest.mark.parametrize(
    ("name", "content", "key"),
    [
        ("log_7.ulg", ULG, "files"),
        ("00000042.BIN", BIN, "files"),
        ("100_0001_Timestamp.MRK", mrk_line(), "files"),
        ("rover.ubx", UBX, "files"),
        ("rover.pos", POS, "gnss"),
        ("receiver.nmea", NMEA, "gnss"),
        ("rover_events.pos", POS, "sync"),
        ("MyImu.CSV", IMU, "imu"),
        ("track.csv", GNSS, "gnss"),
        ("both.csv", IMU.replace("gyro_x_rad_s", "gyro_x_rad_s,lat_deg,lon_deg", 1)
         .replace(",0,0,0,", ",0,39.0,-80.0,0,0,"), "files"),
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) < 30 else "",
)  # fmt: skip
def test_log_is_entered_by_its_content(
    site: Path, name: str, content: str | bytes, key: str
) -> None:
    put(site / "flight", {name: content})
    expected = f"../flight/{name}"
    assert init(site)[0]["logs"] == {key: [expected] if key == "files" else expected}


def test_content_goes_before_the_name(site: Path) -> None:
    put(site / "flight", {"firmware.bin": b"\x00\x01" * 400, "old.ulg": "nothing of a log at all"})
    settings, text = init(site)
    assert "logs" not in settings or not settings["logs"]
    assert "firmware.bin" in text


@pytest.mark.parametrize(
    "files",
    [{"a.ulg": ULG, "b.ulg": ULG}, {"a.ulg": ULG, "b.BIN": BIN}, {"a.csv": GNSS, "b.csv": GNSS}],
)
def test_several_logs_of_one_kind_are_named_and_left_to_the_user(site: Path, files: dict) -> None:
    put(site / "flight", files)
    settings, text = init(site)
    assert not settings.get("logs")
    note = next(x for x in text.splitlines() if "Several logs of one kind" in x)
    assert all(name in note for name in files)


def test_a_plain_name_goes_before_others_of_its_kind(site: Path) -> None:
    put(site / "flight", {"gnss.csv": GNSS, "rover.pos": POS})
    settings, text = init(site)
    assert settings["logs"] == {"gnss": "../flight/gnss.csv"}
    assert "rover.pos" in text


def test_positions_are_taken_from_the_receiver_beside_an_autopilot(site: Path) -> None:
    """Both hold them, and the readers refuse to choose."""
    put(site / "flight", {"log.ulg": ULG, "rover.ubx": UBX})
    logs = init(site)[0]["logs"]
    assert logs == {"gnss": "../flight/rover.ubx", "files": ["../flight/log.ulg"]}


def test_tables_that_are_no_logs_are_left_alone(site: Path) -> None:
    reference = "label,lat,lon,altitude,time\nIMG_1.JPG,39.1,-80.4,374,1.0\n"
    put(site / "flight", {"reference.csv": reference, "prices.csv": "item,price\n1,2\n",
                          "control.csv": CONTROL, "empty.csv": ""})  # fmt: skip
    settings, text = init(site)
    assert not settings.get("logs")
    assert "Not used" not in text
    assert settings["control"]["file"] == "../flight/control.csv"


@pytest.mark.parametrize(
    ("name", "model", "hint"),
    [
        ("IMG_1.JPG", "S110 NIR", True),
        ("IMG_1.JPG", "Sequoia", True),
        ("IMG_1.JPG", "Survey3N RGN", True),
        ("DJI_0001_MS_NIR.TIF", "M3M", True),
        ("IMG_1.JPG", "Canon EOS 450D", False),
        ("UNIRON_1.JPG", "NIROZ 5", False),
    ],
)
def test_near_infrared_camera_gives_a_hint_of_band_names(
    tmp_path: Path, name: str, model: str, hint: bool
) -> None:
    (tmp_path / "photos").mkdir()
    write_photo(tmp_path / "photos" / name, tags={**TAGS, "IFD0:Model": model})
    _, text = init(tmp_path, "photos", ".")
    assert ("name the bands in order" in text) is hint
