"""Pose files: formats, names, CRS, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from pyproj import Geod

from georef_gis.errors import InputError
from georef_gis.ingest.poses import match_poses, read_poses


@pytest.fixture
def write(tmp_path: Path):
    def put(text: str, name: str = "poses.csv") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return put


def test_odm_geo_txt_in_utm(write) -> None:
    poses = read_poses(
        write(
            "WGS84 UTM 17N\nIMG_1.JPG 500000 4000000 350.5 10 -2 3 0.02 0.04\n"
            "IMG_2.JPG 500010 4000000\nIMG_3.JPG 500020 4000000 351 nan nan nan\n"
        )
    )
    geotag, attitude = poses["IMG_1.JPG"]
    # the central meridian of zone 17: 4000 km / 0.9996 along it from the equator
    latitude = Geod(ellps="WGS84").fwd(-81.0, 0.0, 0.0, 4_000_000 / 0.9996)[1]
    assert math.degrees(geotag.lon) == pytest.approx(-81.0, abs=1e-9)
    assert math.degrees(geotag.lat) == pytest.approx(latitude, abs=1e-8)
    assert geotag.height is not None
    assert (geotag.height.value, geotag.height.kind) == (350.5, "unknown")
    assert (geotag.sigma_h, geotag.sigma_v) == (0.02, 0.04)
    assert attitude is not None
    assert attitude.dialect == "ypr"
    assert (attitude.yaw, attitude.pitch, attitude.roll) == pytest.approx(
        (math.radians(10), math.radians(-2), math.radians(3))
    )
    assert poses["IMG_2.JPG"][0].height is None
    assert poses["IMG_2.JPG"][1] is None
    assert poses["IMG_3.JPG"][1] is None


METASHAPE = """# CoordinateSystem: EPSG:4326
#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw,Pitch,Roll,Error_(m),X_est,Y_est,Z_est
IMG_1,-81.5,36.25,350.5,10.5,-2,3,0.1,0,0,0
# Total Error
"""
PIX4DMATIC = """#imagename,coordinate1,coordinate2,z,yaw,pitch,roll
IMG_1.JPG,36.25,-81.5,350.5,10.5,-2,3
"""
PIX4D_PLAIN = "IMG_1.JPG,36.25,-81.5,350.5,10.5,-2,3,0.02,0.04\n"
PIX4DMAPPER = """imagename;latitude [deg];longitude [deg];altitude [m];yaw;pitch;roll
IMG_1.JPG;36.25;-81.5;350.5;10.5;-2;3
"""
ORTHORITY = """filename,latitude,longitude,altitude,roll,pitch,yaw,camera
IMG_1.JPG,36.25,-81.5,350.5,3,-2,10.5,cam
"""


@pytest.mark.parametrize(
    "text",
    [METASHAPE, PIX4DMATIC, PIX4D_PLAIN, PIX4DMAPPER, ORTHORITY],
    ids=["metashape", "pix4dmatic", "pix4d-plain", "pix4dmapper", "orthority"],
)
def test_formats_are_told_apart(write, text: str) -> None:
    ((geotag, attitude),) = read_poses(write(text)).values()
    assert (math.degrees(geotag.lat), math.degrees(geotag.lon)) == pytest.approx((36.25, -81.5))
    assert attitude is not None
    angles = (attitude.yaw, attitude.pitch, attitude.roll)
    assert [math.degrees(v or 0.0) for v in angles] == pytest.approx([10.5, -2, 3])


def test_opk_keeps_its_name_and_order(write) -> None:
    text = "name,x,y,z,omega,phi,kappa\nA,500000,4000000,1,1.5,-2.5,100\n"
    ((_, attitude),) = read_poses(write(text), crs="EPSG:32617").values()
    assert attitude is not None
    assert attitude.dialect == "opk"
    angles = (attitude.roll, attitude.pitch, attitude.yaw)
    assert [math.degrees(v or 0.0) for v in angles] == pytest.approx([1.5, -2.5, 100])


def test_state_plane_feet_with_heights_in_feet(write) -> None:
    # Ohio South in US survey feet, NAVD88 in feet: 1000 ft = 304.8006 m, orthometric
    text = "EPSG:6551+6360\nA.JPG 1968500 100000 1000\n"
    ((geotag, _),) = read_poses(write(text)).values()
    assert math.degrees(geotag.lon) == pytest.approx(-82.5, abs=1e-6)
    assert geotag.height is not None
    assert geotag.height.value == pytest.approx(304.8006, abs=1e-4)
    assert (geotag.height.kind, geotag.height.geoid) == ("orthometric", "geoid18")


def test_a_3d_crs_makes_heights_ellipsoidal(write) -> None:
    ((geotag, _),) = read_poses(write("EPSG:4979\nA.JPG -81.5 36.25 250\n")).values()
    assert geotag.height is not None
    assert geotag.height.kind == "ellipsoidal"


HERE = (math.radians(36.25), math.radians(-81.5))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,lat,lon\nA,-120.5,36.25\n", r"line 2: lat, lon: .*swapped; exchange"),
        ("name,lat,lon\nA,4000000,500000\n", r"line 2: .*no degrees; name the CRS"),
        ("name,lat,lon\nA,-81.5,36.25\n", r"line 2: .*swapped, they lie where the photos are"),
        ("name,lat,lon\nA,0.63268,-1.42244\n", r"line 2: .*as radians they lie"),
        ("name,lat,lon\nA,36.25,x\n", r"line 2: lon: 'x' is not a number"),
        ("name,lat,lon\nA,36.25,\n", r"line 2: lon: the value is missing"),
        ("name,lat,lon\nA,36.25,inf\n", r"line 2: lon: 'inf' is not a finite"),
        ("name,lat,lon\n,36.25,-81.5\n", r"line 2: name: .*missing"),
        ("name,lat,lon\nA,36.2,-81.5\na,36.2,-81.5\n", r"line 3: name: 'a' stands in line 2 too"),
        ("name,lat,lon,z,yaw,pitch,roll\nA,36.2,-81.5,1,900,0,0\n", r"line 2: angles: 900"),
        ("name,lat,lon,z,acc_h\nA,36.2,-81.5,1,-3\n", r"line 2: acc_h: -3 m is negative"),
        ("EPSG:99999999\nA 1 2 3\n", r"is not a CRS"),
        ("name,lat,lon\n", r"has no rows"),
        ("\n", r"is empty"),
        ("A 36\n", r"line 1: has 2 columns"),
    ],
    ids=lambda v: v.encode("unicode_escape").decode()[:40],
)
def test_bad_rows_name_file_line_field_and_value(write, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_poses(write(text), near=HERE)
    assert "poses.csv" in str(caught.value)


def test_radians_for_degrees_and_degrees_for_radians(write) -> None:
    rows = "".join(f"P{n},36.2,-81.5,1,{0.3 * n + 0.1:.3f},0.01,-0.02\n" for n in range(8))
    path = write("name,lat,lon,z,yaw,pitch,roll\n" + rows)
    with pytest.raises(InputError, match="these are radians"):
        read_poses(path)
    poses = read_poses(path, angle_unit="radians")
    attitude = poses["P1"][1]
    assert attitude is not None
    assert attitude.yaw == pytest.approx(0.4)
    with pytest.raises(InputError, match=r"45 is no angle in radians; they look like degrees"):
        read_poses(
            write("name,lat,lon,z,yaw,pitch,roll\nA,36,-81,1,45,0,0\n"), angle_unit="radians"
        )


def test_unreadable_files_are_input_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_poses(tmp_path / "none.csv")
    binary = tmp_path / "x.csv"
    binary.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(InputError, match="UTF-8"):
        read_poses(binary)
    with pytest.raises(InputError, match="'xml' is not known"):
        read_poses(binary, format="xml")  # type: ignore[arg-type]


def test_names_match_with_or_without_ending_and_case(write) -> None:
    text = "name,lat,lon\nimg_1,1,2\nfolder/IMG_2.jpg,1,2\nIMG_3.JPG,1,2\nIMG_9,1,2\n"
    matched, left = match_poses(
        read_poses(write(text)), ["IMG_1.JPG", "IMG_2.JPG", "IMG_3.tif", "IMG_4.JPG"]
    )
    assert set(matched) == {"IMG_1.JPG", "IMG_2.JPG", "IMG_3.tif"}
    assert left == ("IMG_9",)
