"""Pose files of other programs: telling them apart, what lies beside them, accuracies."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.geodesy import HeightKind, Origin
from georef_gis.ingest.poses import match_poses, read_poses
from georef_gis.ingest.poses_blocks import read_blocks
from georef_gis.model.interchange.block import Block

CAMERAS = "1 PINHOLE 64 48 50 50 32 24\n"
# Looking down from 100 m, image up to the north: Rx(180).
IMAGES = "".join(f"{i} 0 1 0 0 {-10.0 * i} 0 100 1 IMG_{i}.JPG\n\n" for i in (1, 2, 3, 4))
FRAME = {
    "version": 1,
    "origin": {"latitude": 40.0, "longitude": -83.0, "altitude": 200.0},
    "height_kind": "ellipsoidal",
}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    folder = tmp_path / "sparse"
    folder.mkdir()
    (folder / "cameras.txt").write_text(CAMERAS)
    (folder / "images.txt").write_text(IMAGES)
    return folder


def test_a_colmap_model_is_known_by_its_folder_or_files(model: Path) -> None:
    (model / "georef_frame.json").write_text(json.dumps(FRAME))
    for path in (model, model / "images.txt", model / "cameras.txt"):
        poses = read_poses(path)
        assert len(poses) == 4
        geotag, attitude = poses["IMG_2.JPG"]
        # 20 m east of the origin, 100 m over it
        assert math.degrees(geotag.lat) == pytest.approx(40.0, abs=1e-6)
        assert math.degrees(geotag.lon) == pytest.approx(-83.0 + 20.0 / 85394.0, abs=1e-7)
        assert geotag.height is not None
        assert geotag.height.value == pytest.approx(300.0, abs=1e-3)
        assert geotag.height.kind == "ellipsoidal"
        assert attitude is not None
        angles = (attitude.roll, attitude.pitch, attitude.yaw)
        assert angles == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
    matched, left = match_poses(read_poses(model), ["img_1.jpg", "IMG_9.JPG"])
    assert (set(matched), len(left)) == ({"img_1.jpg"}, 3)


def test_a_model_without_a_place_is_put_there_by_the_caller_or_refused(model: Path) -> None:
    with pytest.raises(InputError, match=r"no place on the Earth; .*georef_frame.json or geo.txt"):
        read_poses(model)
    origin = Origin(lat=0.7, lon=-1.4, height_ellipsoidal=10.0)
    asked: list[Block] = []

    def placing(block: Block) -> Block:
        asked.append(block)
        return replace(block, origin=origin, height_kind=HeightKind.ELLIPSOIDAL)

    poses = read_poses(model, placing=placing)
    assert len(asked) == 1
    assert poses["IMG_1.JPG"][0].lat == pytest.approx(0.7, abs=1e-5)


def test_positions_beside_a_model_are_read(model: Path) -> None:
    rows = "".join(f"IMG_{i}.JPG -83.000{i} 40.0 300.5\n" for i in (1, 2, 3))
    (model / "geo.txt").write_text("EPSG:4326\n" + rows)
    (block,) = read_blocks(model, "colmap", read_positions=lambda path: {
        name: tag for name, (tag, _) in read_poses(path, format="odm").items()
    })  # fmt: skip
    assert math.degrees(block.positions["IMG_2.JPG"].lon) == pytest.approx(-83.0002)
    seen: list[Block] = []

    def placing(block: Block) -> Block:
        seen.append(block)
        return replace(block, origin=Origin(lat=0.7, lon=-1.4, height_ellipsoidal=0.0))

    read_poses(model, placing=placing)
    assert len(seen[0].positions) == 3
    # What `colmap model_aligner` takes has the latitude first.
    (model / "ref_images.txt").write_text("IMG 1.JPG 40.0 -83.5 300.5\n")
    (block,) = read_blocks(model, "colmap")
    tag = block.positions["IMG 1.JPG"]
    assert (math.degrees(tag.lat), math.degrees(tag.lon)) == pytest.approx((40.0, -83.5))
    (model / "ref_images.txt").write_text("IMG_1.JPG -120.0 40.0 300.5\n")
    with pytest.raises(InputError, match="line 1: latitude -120, longitude 40 is not on the Earth"):
        read_blocks(model, "colmap")


def test_unreadable_models_are_input_errors(tmp_path: Path, model: Path) -> None:
    (model / "images.txt").unlink()
    with pytest.raises(InputError, match=r"images.txt: cannot be read"):
        read_poses(model)
    (model / "images.bin").write_bytes(b"\0")
    with pytest.raises(InputError, match="binary model; convert it: colmap model_converter"):
        read_poses(model)
    path = tmp_path / "reconstruction.json"
    path.write_text("[{")
    with pytest.raises(InputError, match=r"reconstruction.json: is no JSON: .* in line 1"):
        read_poses(path)
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match="is no JSON"):
        read_poses(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="UTF-8"):
        read_poses(path)


def test_a_photo_in_two_reconstructions_is_that_of_the_larger(tmp_path: Path) -> None:
    camera = {"projection_type": "perspective", "width": 64, "height": 48, "focal": 0.9}
    lla = {"latitude": 40.0, "longitude": -83.0, "altitude": 0.0}

    def part(names: list[str], z: float) -> dict:
        shot = {"rotation": [math.pi, 0.0, 0.0], "translation": [0.0, 0.0, z], "camera": "c"}
        return {"cameras": {"c": camera}, "shots": dict.fromkeys(names, shot), "reference_lla": lla}

    path = tmp_path / "reconstruction.json"
    path.write_text(
        json.dumps([part(["a.jpg", "b.jpg"], 50.0), part(["b.jpg", "c.jpg", "d.jpg"], 70.0)])
    )
    heights = {name: tag.height.value for name, (tag, _) in read_poses(path).items() if tag.height}
    assert heights == pytest.approx({"a.jpg": 50.0, "b.jpg": 70.0, "c.jpg": 70.0, "d.jpg": 70.0})


METASHAPE = (
    "# CoordinateSystem: EPSG:32617\n"
    "#Label,X/Easting,Y/Northing,Z/Altitude,{angles},Accuracy_X/Y_(m),Accuracy_Z_(m),{sigmas}\n"
    "IMG_1,500000,4000000,350.5,10,-2,3,0.03,0.05,3,1,2\n"
)


def test_accuracies_of_angles_are_read(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text(
        METASHAPE.format(
            angles="Yaw,Pitch,Roll",
            sigmas="Accuracy_Yaw_(deg),Accuracy_Pitch_(deg),Accuracy_Roll_(deg)",
        )
    )
    ((geotag, attitude),) = read_poses(path).values()
    assert (geotag.sigma_h, geotag.sigma_v) == (0.03, 0.05)
    assert attitude is not None
    # root mean square of 1 and 2 deg
    assert math.degrees(attitude.sigma_roll_pitch or 0.0) == pytest.approx(math.sqrt(2.5))
    assert math.degrees(attitude.sigma_yaw or 0.0) == pytest.approx(3.0)
    path.write_text(
        METASHAPE.format(
            angles="Omega,Phi,Kappa",
            sigmas="Accuracy_Omega_(deg),Accuracy_Phi_(deg),Accuracy_Kappa_(deg)",
        )
    )
    ((_, attitude),) = read_poses(path).values()
    assert attitude is not None
    assert attitude.dialect == "opk"
    assert math.degrees(attitude.sigma_yaw or 0.0) == pytest.approx(2.0)
    assert math.degrees(attitude.sigma_roll_pitch or 0.0) == pytest.approx(math.sqrt(5.0))


def test_our_own_table_of_poses_is_read_with_its_crs_and_accuracies(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(
        "# CRS EPSG:32617 (WGS 84 / UTM zone 17N); x east, y north in metre; z ellipsoidal\n"
        "label,x,y,z,yaw,pitch,roll,omega,phi,kappa,accuracy_xy,accuracy_z,sigma_yaw,sigma_pitch,"
        "sigma_roll\nIMG_1.JPG,500000.0,4000000.0,350.5,10,-2,3,1,2,3,0.02,0.04,0.3,0.1,0.1\n"
    )
    ((geotag, attitude),) = read_poses(path).values()
    assert math.degrees(geotag.lon) == pytest.approx(-81.0, abs=1e-9)
    assert (geotag.sigma_h, geotag.sigma_v) == (0.02, 0.04)
    assert attitude is not None
    assert math.degrees(attitude.sigma_yaw or 0.0) == pytest.approx(0.3)


def test_units_of_heights_and_accuracies_are_those_the_file_states(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    text = (
        "# crs: EPSG:6549\n# heights: ellipsoidal\n# height_unit: US survey foot\n"
        "# accuracy_unit: US survey foot\n"
        "#imagename,easting,northing,z,yaw,pitch,roll,accuracy_h,accuracy_v\n"
        "A.JPG,1968500,100000,1000,10,-2,3,0.1,0.2\n"
    )
    path.write_text(text)
    ((geotag, _),) = read_poses(path).values()
    assert geotag.height is not None
    assert geotag.height.kind == "ellipsoidal"
    assert geotag.height.value == pytest.approx(304.8006, abs=1e-4)
    assert geotag.sigma_v == pytest.approx(0.06096, abs=1e-5)
    path.write_text(text.replace("US survey foot", "cubit"))
    with pytest.raises(InputError, match="'cubit' is not known"):
        read_poses(path)
