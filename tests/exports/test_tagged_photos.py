"""Poses in copies of photos: what other programs and our own reader get out of them.

The readers of `tag_readers.py` follow OpenDroneMap's and orthority's rules; photos come from the
tags of 32 cameras, from real flights, and from hand-made headers.
"""

from __future__ import annotations

import errno
import hashlib
import importlib.util
import json
import math
import os
import struct
import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

import exifread
import numpy as np
import piexif
import pytest
import tag_readers
from PIL import Image
from site_cases import ORIGIN, R_NADIR_NORTH, make_frame, make_site

import exports.poses.tagged_photos as tagged
from exports.poses.tagged_photos import INDEX, TaggedPhotosOptions, write_tagged_photos
from exports.site.site import SiteLayers, SitePhoto
from georef_gis.errors import Cancelled, ExportError, InputError
from georef_gis.frames import R_PHOTO_FROM_CAM, R_ecef_from_enu, exp_so3
from georef_gis.geodesy import HeightKind
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Mount, Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.direct import DirectSettings, direct_poses
from georef_gis.orient.heights import Heights, tag_height
from georef_gis.project import Project
from georef_gis.project.records import footprint_row, photo_row, pose_row, save_frame
from georef_gis.rasters import jpeg_segments as jpeg
from georef_gis.rasters import photo_tags
from georef_gis.rasters.photo_tags import PoseTags, write_tagged_copy
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of

CRS = "EPSG:32617"
# 2026-05-01 12:00:00 UTC on the GPS scale
EPOCH = (datetime(2026, 5, 1, 12) - datetime(1980, 1, 6)).total_seconds() + 18.0
ANGLE_DEG, PLACE_M = 1e-4, 0.01
METADATA = Path(os.environ.get("GEOREF_DATA", "/nowhere")) / "metadata"


def helper(name: str) -> ModuleType:
    """A helper of the tests of `ingest`."""
    path = Path(__file__).parents[1] / "ingest" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules.setdefault(name, module)
    spec.loader.exec_module(module)
    return module


writer = helper("photo_writer")
MAKERS = sorted(helper("makers").MAKERS)


def pose_of_turn(turn: list[float], at: list[float]) -> Pose:
    """A camera turned by a rotation vector, deg, out of looking down with its top to the north."""
    covariance = np.diag([0.04, 0.09, 0.16, *np.radians([0.1, 0.2, 0.4]) ** 2])
    return Pose(
        origin_enu=np.array(at),
        R_enu_from_cam=exp_so3(np.radians(turn)) @ R_NADIR_NORTH,
        covariance=covariance,
        kind="navigation",
    )


TURN, AT = [12.0, -7.0, 118.0], [14_000.0, -9_000.0, 150.0]


def site_of(paths: list[Path], poses: list[Pose | None]) -> SiteLayers:
    photos = tuple(
        SitePhoto(
            photo=Photo(id=str(i), path=path, width=64, height=48, time_gps=2.25 + i),
            pose=pose,
            height_above_ground=88.5,
        )
        for i, (path, pose) in enumerate(zip(paths, poses, strict=True))
    )
    return SiteLayers(name="site", frame=make_frame(CRS), photos=photos, epoch_gps=EPOCH)


def export(site: SiteLayers, target: Path, **options: object) -> list[str]:
    """Export; the warnings."""
    feedback = CollectingFeedback()
    write_tagged_photos(site, target, TaggedPhotosOptions(**options), feedback)
    return list(feedback.warnings)


def copy_of(path: Path, target: Path, pose: Pose | None = None, **options: object) -> Path:
    export(site_of([path], [pose or pose_of_turn(TURN, AT)]), target, **options)
    return target / path.name


def truth(pose: Pose) -> tuple[float, float, float, np.ndarray]:
    """Lat, lon in deg, ellipsoidal height, and the rotation from the photo's axes to level enu."""
    lat, lon, h = ORIGIN.geo_from_enu(pose.origin_enu)
    R_local = R_ecef_from_enu(lat, lon).T @ ORIGIN.R_ecef_from_enu @ pose.R_enu_from_cam
    return math.degrees(lat), math.degrees(lon), float(h), R_local @ R_PHOTO_FROM_CAM.T


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """deg; by the sine, as the arc cosine of a trace is blind below 1e-6 deg."""
    return math.degrees(np.linalg.norm(a @ b.T - np.eye(3)) / math.sqrt(2.0))


def check(reading: tag_readers.Reading, pose: Pose, *, alt: float) -> None:
    lat, lon, _, R = truth(pose)
    assert reading.lat is not None
    assert reading.lon is not None
    assert abs(reading.lat - lat) * 111_200.0 < PLACE_M
    assert abs(reading.lon - lon) * 85_000.0 < PLACE_M
    assert reading.alt == pytest.approx(alt, abs=PLACE_M)
    assert angle_between(reading.R_enu_from_photo, R) < ANGLE_DEG


def scan_of(data: bytes) -> bytes:
    """From the start of the image data to the end of the file."""
    at = 2
    while data[at + 1] != 0xDA:
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return data[at:]


def segments_of(path: Path) -> list[jpeg.Segment]:
    with path.open("rb") as file:
        return jpeg.read_segments(file)


def decoded(path: Path) -> str:
    with Image.open(path) as image:
        return hashlib.sha256(np.asarray(image).tobytes()).hexdigest()


def others(path: Path) -> list[bytes]:
    """Segments that must not change: all but EXIF, XMP and the offsets of further pictures."""
    marks = (jpeg.EXIF_MARK, jpeg.XMP_MARK, jpeg.EXTENDED_MARK)
    return [
        s.raw
        for s in segments_of(path)
        if not any(s.starts(m) for m in marks) and not s.starts(jpeg.MPF_MARK, jpeg.APP2)
    ]


def own_pose(path: Path) -> Pose | None:
    """The pose that our own reader and direct orientation get."""
    from georef_gis.ingest.photos import read_photo

    photo = read_photo(path)
    if photo.attitude is None:
        assert photo.make.upper().startswith(("FLIR", "PARROT"))
        assert any("convention is not known" in doubt for doubt in photo.doubts)
        return None
    height = tag_height(photo, HeightKind.ORTHOMETRIC)
    assert height is not None
    heights = Heights(
        cameras={photo.id: height}, sigma={photo.id: 1.0}, source="test",
        terrain=FlatTerrain(origin=ORIGIN, height_ellipsoidal=height - 120.0, sigma=1.0),
    )  # fmt: skip
    settings = DirectSettings(yaw_source="tags")
    found = direct_poses([photo], ORIGIN, heights, Mount(), settings, convergence_at=lambda _: 0.0)[
        0
    ]
    assert found.pose is not None, found
    return found.pose


# -- readers, every maker ----------------------------------------------------------------------


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("as_elements", [False, True], ids=["attributes", "elements"])
def test_other_programs_read_our_pose_from_every_maker(
    tmp_path: Path, maker: str, as_elements: bool
) -> None:
    file = METADATA / f"{maker}.json"
    if not file.is_file():
        pytest.skip("GEOREF_DATA is not set: no real tags")
    record = json.loads(file.read_text())
    record = record[0] if isinstance(record, list) else record
    # The files have no directory names: tags of the camera stand in the first one.
    ifd0 = ("Make", "Model", "Orientation", "Software", "ModifyDate")
    for key in [k for k in record if k.startswith("EXIF:")]:
        name = key.partition(":")[2]
        record[("IFD0:" if name in ifd0 else "ExifIFD:") + name] = record[key]
    path = tmp_path / "in" / "A.jpg"
    path.parent.mkdir()
    writer.write_photo(path, tags=record, as_elements=as_elements)
    pose = pose_of_turn(TURN, AT)
    copy = copy_of(path, tmp_path / "out", pose)
    check_all(path, copy, pose)


def check_all(path: Path, copy: Path, pose: Pose) -> None:
    """Readers of others and our own; nothing else changed."""
    lat, lon, h, _ = truth(pose)
    from georef_gis.geodesy import geoid_undulation

    orthometric = h - float(geoid_undulation(math.radians(lat), math.radians(lon)))
    odm, oty = tag_readers.odm(copy), tag_readers.orthority(copy)
    check(odm, pose, alt=orthometric)
    check(oty, pose, alt=orthometric)
    # sqrt((0.2^2 + 0.3^2) / 2) and 0.4 m; OpenDroneMap doubles them
    assert odm.xy == pytest.approx(2 * 0.2550, abs=2e-3)
    assert odm.z == pytest.approx(2 * 0.4, abs=2e-3)
    site = site_of([path], [pose])
    wanted = site.layers["photos"].features[0].values
    opk = [wanted[f"{name}_deg"] for name in ("omega", "phi", "kappa")]
    assert tag_readers.orthority_opk(oty, CRS) == pytest.approx(opk, abs=ANGLE_DEG)
    own = own_pose(copy)
    if own is not None:
        assert own.origin_enu == pytest.approx(pose.origin_enu, abs=PLACE_M)
        assert angle_between(own.R_enu_from_cam, pose.R_enu_from_cam) < ANGLE_DEG
    assert decoded(copy) == decoded(path)
    assert scan_of(copy.read_bytes()) == scan_of(path.read_bytes())
    assert others(copy) == others(path)


def test_the_readers_here_know_what_goes_wrong_without_the_corrections(tmp_path: Path) -> None:
    """A copy with Camera angles alone is 90 deg off for DJI and has senseFly's roll reversed."""
    pose = pose_of_turn(TURN, AT)
    for make, wrong in (("DJI", True), ("Hasselblad", True), ("senseFly", True), ("SONY", False)):
        path = tmp_path / "in" / f"{make}.jpg"
        path.parent.mkdir(exist_ok=True)
        writer.write_photo(path, tags={"IFD0:Make": make})
        for corrected in (True, False):
            copy = copy_of(path, tmp_path / f"{make}{corrected}", pose, odm_corrections=corrected)
            off = angle_between(tag_readers.odm(copy).R_enu_from_photo, truth(pose)[3])
            assert (off > 10.0) == (wrong and not corrected), (make, corrected, off)
            assert (
                angle_between(tag_readers.orthority(copy).R_enu_from_photo, truth(pose)[3])
                < ANGLE_DEG
            )
            with Image.open(copy) as image:
                assert image.getexif()[0x010F] == make


@pytest.mark.parametrize(
    "turn",
    [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -179.99999],
        [0.0, -80.0, 10.0],
        [89.9, 0.0, 0.0],
        [0.0, 120.0, 45.0],
        [3.0, 2.0, -90.0],
    ],
)
@pytest.mark.parametrize("make", ["DJI", "senseFly", "Canon"])
def test_any_attitude_comes_through(tmp_path: Path, turn: list[float], make: str) -> None:
    path = tmp_path / "A.jpg"
    writer.write_photo(path, tags={"IFD0:Make": make})
    pose = pose_of_turn(turn, [10.0, 20.0, 100.0])
    copy = copy_of(path, tmp_path / "out", pose)
    for reading in (tag_readers.odm(copy), tag_readers.orthority(copy)):
        assert angle_between(reading.R_enu_from_photo, truth(pose)[3]) < ANGLE_DEG


@pytest.mark.parametrize("folder", ["seneca16", "brighton_beach"])
def test_real_photos_are_read_by_other_programs_with_our_pose(folder: str, tmp_path: Path) -> None:
    photos = METADATA.parent / folder / "photos"
    if not photos.is_dir():
        pytest.skip("GEOREF_DATA is not set: no real photos")
    for path in sorted(p for p in photos.iterdir() if p.suffix.lower() == ".jpg")[:2]:
        pose = pose_of_turn(TURN, AT)
        copy = copy_of(path, tmp_path / path.stem, pose)
        check_all(path, copy, pose)
        assert piexif.load(str(copy))["Exif"] == piexif.load(str(path))["Exif"]
        assert further_pictures(copy) == further_pictures(path)


def further_pictures(path: Path) -> list[tuple[bytes, bytes]]:
    """First and last bytes of every picture of a multi-picture file by its index."""
    data = path.read_bytes()
    base = data.find(b"MPF\0") + 4
    if base < 4:
        return []
    order = "<" if data[base : base + 2] == b"II" else ">"
    entries = data.index(struct.pack(order + "H", 0xB002), base)
    count, place = struct.unpack_from(order + "II", data, entries + 4)
    found = []
    for i in range(count // 16):
        size, offset = struct.unpack_from(order + "II", data, base + place + 16 * i + 4)
        start = base + offset if offset else 0
        found.append((data[start : start + 2], data[start + size - 16 : start + size]))
    return found


# -- what is written -----------------------------------------------------------------------------


def test_the_gps_directory_holds_what_the_pose_says(tmp_path: Path) -> None:
    path = tmp_path / "A.jpg"
    writer.write_photo(
        path,
        tags={
            "IFD0:Make": "Canon", "IFD0:Orientation": 6,
            "ExifIFD:DateTimeOriginal": "2020:01:02 03:04:05",
            "GPS:GPSLatitude": 1.0, "GPS:GPSTimeStamp": "01:02:03", "GPS:GPSDOP": 2.0,
            "GPS:GPSTrack": 33.0, "GPS:GPSTrackRef": "T",
        },
    )  # fmt: skip
    exif = piexif.load(str(copy_of(path, tmp_path / "out")))
    gps = {piexif.TAGS["GPS"][tag]["name"]: value for tag, value in exif["GPS"].items()}
    assert gps["GPSLatitudeRef"] == b"N"
    assert gps["GPSLongitudeRef"] == b"W"
    assert gps["GPSImgDirectionRef"] == b"T"
    assert gps["GPSDateStamp"] == b"2026:05:01"
    assert gps["GPSTimeStamp"] == ((12, 1), (0, 1), (2_250_000, 1_000_000))
    assert gps["GPSHPositioningError"] == (2550, 10_000)
    assert gps["GPSTrack"] == (33, 1)
    assert "GPSDOP" not in gps
    assert exif["Exif"][piexif.ExifIFD.DateTimeOriginal] == b"2020:01:02 03:04:05"
    assert exif["0th"][piexif.ImageIFD.Orientation] == 6


def test_ellipsoidal_heights_are_written_on_request_without_a_vertical_crs(tmp_path: Path) -> None:
    path = tmp_path / "A.jpg"
    writer.write_photo(path)
    pose = pose_of_turn(TURN, AT)
    copy = copy_of(path, tmp_path / "out", pose, heights="ellipsoidal")
    check(tag_readers.odm(copy), pose, alt=truth(pose)[2])
    assert b"VertCS" not in copy.read_bytes()
    assert b'VertCS="EPSG:5773"' in copy_of(path, tmp_path / "other", pose).read_bytes()


def test_below_the_geoid_and_south_and_east_have_their_signs(tmp_path: Path) -> None:
    path, copy = tmp_path / "A.jpg", tmp_path / "B.jpg"
    writer.write_photo(path)
    tags = PoseTags(
        lat_lon_deg=(-0.5, 12.999999999999), altitude=-3.25, yaw_pitch_roll_deg=(0.0, 0.0, 0.0)
    )
    write_tagged_copy(path, copy, tags)
    for reading in (tag_readers.odm(copy), tag_readers.orthority(copy)):
        assert (reading.lat, reading.alt) == (pytest.approx(-0.5, abs=1e-9), -3.25)
        # 59.99999999 s must not become 60 s.
        assert reading.lon == pytest.approx(13.0, abs=1e-9)


@pytest.mark.parametrize(
    ("ypr", "bearing"),
    [
        ((30.0, 0.0, 0.0), 30.0),
        ((30.0, -10.0, 5.0), 30.0),
        ((30.0, 60.0, 0.0), 30.0),
        ((30.0, -60.0, 0.0), 210.0),
        ((30.0, 0.0, 80.0), 300.0),
    ],
)
def test_image_direction_is_of_the_top_at_nadir_and_of_the_view_when_oblique(
    ypr: tuple[float, float, float], bearing: float
) -> None:
    assert tagged.image_direction(*ypr) == pytest.approx(bearing, abs=1e-9)


def test_a_pose_of_zeros_is_not_taken_for_a_placeholder(tmp_path: Path) -> None:
    from georef_gis.ingest.photos import read_photo

    path, copy = tmp_path / "A.jpg", tmp_path / "B.jpg"
    writer.write_photo(path, tags={"IFD0:Make": "Canon"})
    zero = PoseTags(lat_lon_deg=(40.0, -83.0), altitude=300.0, yaw_pitch_roll_deg=(0.0, -0.0, 0.0))
    write_tagged_copy(path, copy, zero)
    attitude = read_photo(copy).attitude
    assert attitude is not None
    assert attitude.dialect == "pix4d-camera"


# -- forms of headers ------------------------------------------------------------------------------


def app1(mark: bytes, body: bytes) -> bytes:
    return writer.segment(mark + body)


def jpeg_with(folder: Path, *segments: bytes, behind: bytes = b"") -> Path:
    """A photo with given segments right behind the start, and data behind its end."""
    path = folder / "A.jpg"
    writer.write_photo(path)
    raw = path.read_bytes()
    plain = raw[: raw.index(b"\xff\xe1")] + raw[raw.index(b"\xff\xe0") :]
    path.write_bytes(plain[:2] + b"".join(segments) + plain[2:] + behind)
    return path


def tiff_block(order: str, *, next_directory: int = 0, note: bytes = b"note-with-offsets") -> bytes:
    """EXIF: Make, an EXIF directory with a MakerNote, and no GPS directory."""
    make = b"Canon\0"
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    main_end = 8 + 2 + 2 * 12 + 4
    sub_end = main_end + len(make) + 2 + 12 + 4
    main = struct.pack(order + "H", 2)
    main += struct.pack(order + "HHII", 0x010F, 2, len(make), main_end)
    main += struct.pack(order + "HHII", 0x8769, 4, 1, main_end + len(make))
    main += struct.pack(order + "I", next_directory)
    sub = struct.pack(order + "H", 1)
    sub += struct.pack(order + "HHII", 0x927C, 7, len(note), sub_end)
    sub += struct.pack(order + "I", 0)
    return head + main + make + sub + note


@pytest.mark.parametrize("order", ["<", ">"])
def test_exif_keeps_its_bytes_and_the_makernote_its_place(tmp_path: Path, order: str) -> None:
    block = tiff_block(order)
    path = jpeg_with(tmp_path, app1(b"Exif\0\0", block))
    copy = copy_of(path, tmp_path / "out")
    new = next(s for s in segments_of(copy) if s.starts(b"Exif\0\0")).payload[6:]
    # The header's pointer alone changes: the first directory had no entry for GPS.
    assert new[:4] + new[8 : len(block)] == block[:4] + block[8:]
    with path.open("rb") as a, copy.open("rb") as b:
        old_note = exifread.process_file(a)["EXIF MakerNote"]
        new_note = exifread.process_file(b)["EXIF MakerNote"]
    assert new_note.values == old_note.values
    assert new_note.field_offset == old_note.field_offset
    pose = pose_of_turn(TURN, AT)
    assert angle_between(tag_readers.odm(copy).R_enu_from_photo, truth(pose)[3]) < ANGLE_DEG
    assert tag_readers.odm(copy).make == "Canon"


def test_photo_without_any_tags_gets_them(tmp_path: Path) -> None:
    path = jpeg_with(tmp_path)
    copy = copy_of(path, tmp_path / "out")
    assert [s.payload[:4] for s in segments_of(copy)][:3] == [b"JFIF", b"Exif", b"http"]
    assert decoded(copy) == decoded(path)
    assert tag_readers.orthority(copy).lat == pytest.approx(truth(pose_of_turn(TURN, AT))[0])


def packet(description: str) -> bytes:
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'{description}</rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


XMP = b"http://ns.adobe.com/xap/1.0/\0"
DJI = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'
GIMBAL = (
    'drone-dji:GimbalYawDegree="+9" drone-dji:GimbalPitchDegree="-9" drone-dji:GimbalRollDegree="9"'
    ' drone-dji:FlightYawDegree="+8" drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.01"'
    ' drone-dji:RtkStdLat="0.01" drone-dji:Latitude="1" drone-dji:Longitude="2"'
    ' drone-dji:GpsLatitude="1" drone-dji:GpsLongtitude="2" drone-dji:AbsoluteAltitude="+3"'
    ' drone-dji:CamReverse="0" drone-dji:DewarpData="2018;1,2,3"'
)


@pytest.mark.parametrize(
    "packets",
    [
        [packet(f"<rdf:Description {DJI} {GIMBAL}/>")] * 3,
        [packet(f'<rdf:Description {DJI} {GIMBAL}/><rdf:Description rdf:about=""/>')],
        [packet(f"<rdf:Description rdf:about='' {DJI} {GIMBAL}/>" * 3)],
        [
            packet(
                '<rdf:Description xmlns:Camera="http://ns.sensefly.com/Camera/1.0/" '
                'Camera:Yaw="5" Camera:Pitch="5" Camera:Roll="5" Camera:Other="6"/>'
            )
        ],
        [
            packet(
                '<rdf:Description xmlns:Camera="http://pix4d.com/camera/1.0" '
                'Camera:BandName="Red" Camera:GPSXYAccuracy="9" Camera:AboveGroundAltitude="1">'
                "<Camera:Yaw>5</Camera:Yaw>"
                "<Camera:Pitch>5</Camera:Pitch><Camera:Roll>5</Camera:Roll></rdf:Description>"
            )
        ],
        [
            packet(
                '<rdf:Description xmlns:c="http://pix4d.com/camera/1.0/" c:Yaw="5" c:Pitch="5" '
                'c:Roll="5" c:BandName="Red"/>'
            )
        ],
        # A prefix that nothing declares, as some thermal cameras write
        [packet(f"<rdf:Description {GIMBAL}/>")],
        [b"this is no XML at all"],
        [b"<x:xmpmeta><rdf:RDF><rdf:Description", packet(f"<rdf:Description {DJI} {GIMBAL}/>")],
    ],
)
@pytest.mark.parametrize("make", ["DJI", "senseFly", "Canon"])
def test_every_form_of_packets_gives_our_pose(
    tmp_path: Path, packets: list[bytes], make: str
) -> None:
    exif = piexif.dump({"0th": {piexif.ImageIFD.Make: make.encode()}})
    path = jpeg_with(tmp_path, writer.segment(exif), *(app1(XMP, one) for one in packets))
    pose = pose_of_turn(TURN, AT)
    copy = copy_of(path, tmp_path / "out", pose)
    check_all(path, copy, pose)
    text = copy.read_bytes()
    for name in (b"GimbalYawDegree", b"RtkFlag", b"RtkStdLon", b"AbsoluteAltitude", b"GpsLat"):
        assert name not in text
    assert text.count(b"AboveGroundAltitude") == 1
    for kept in (b"DewarpData", b"CamReverse", b"BandName", b'Camera:Other="6"'):
        assert (kept in text) == any(kept in one for one in packets)


def test_a_damaged_packet_is_named(tmp_path: Path) -> None:
    path = jpeg_with(tmp_path, app1(XMP, b"this is no XML at all"))
    warnings = export(site_of([path], [pose_of_turn(TURN, AT)]), tmp_path / "out")
    assert warnings == ["A.jpg: an XMP packet is not XML: its tags are not in the copy"]


def test_a_full_packet_moves_behind_one_with_the_pose(tmp_path: Path) -> None:
    long = packet(f'<rdf:Description {DJI} drone-dji:Filler="{"x" * 64_900}"/>')
    path = jpeg_with(tmp_path, app1(XMP, long))
    target = tmp_path / "out"
    warnings = export(site_of([path], [pose_of_turn(TURN, AT)]), target)
    copy = target / path.name
    assert "XMP packet is full" in "".join(warnings)
    check_all(path, copy, pose_of_turn(TURN, AT))
    assert b"x" * 64_900 in copy.read_bytes()


def extended(body: bytes) -> tuple[str, list[bytes]]:
    guid = hashlib.md5(body).hexdigest().upper()
    step = 60_000
    return guid, [
        app1(
            jpeg.EXTENDED_MARK,
            guid.encode() + struct.pack(">II", len(body), at) + body[at : at + step],
        )
        for at in range(0, len(body), step)
    ]


@pytest.mark.parametrize("posed", [True, False])
def test_extended_xmp_loses_its_poses_and_keeps_its_link(tmp_path: Path, posed: bool) -> None:
    inner = GIMBAL if posed else 'drone-dji:CamReverse="0"'
    body = packet(f'<rdf:Description {DJI} {inner} drone-dji:Filler="{"x" * 150_000}"/>')
    guid, segments = extended(body)
    main = packet(
        '<rdf:Description xmlns:xmpNote="http://ns.adobe.com/xmp/note/" '
        f'xmpNote:HasExtendedXMP="{guid}"/>'
    )
    path = jpeg_with(tmp_path, app1(XMP, main), *segments)
    copy = copy_of(path, tmp_path / "out")
    parts = [s for s in segments_of(copy) if s.starts(jpeg.EXTENDED_MARK)]
    heads = [s.payload[len(jpeg.EXTENDED_MARK) :][:40] for s in parts]
    joined = b"".join(s.payload[len(jpeg.EXTENDED_MARK) + 40 :] for s in parts)
    new = hashlib.md5(joined).hexdigest().upper()
    assert {h[:32].decode() for h in heads} == {new}
    assert all(struct.unpack(">I", h[32:36])[0] == len(joined) for h in heads)
    assert f'HasExtendedXMP="{new}"'.encode() in copy.read_bytes()
    assert b"x" * 150_000 in joined
    assert b"GimbalYaw" not in joined
    assert (joined == body) == (not posed)
    check_all(path, copy, pose_of_turn(TURN, AT))


def test_a_packet_inside_exif_does_not_come_first(tmp_path: Path) -> None:
    inner = packet(f"<rdf:Description {DJI} {GIMBAL}/>")
    head = b"II*\0\x08\0\0\0" + struct.pack("<H", 1)
    head += struct.pack("<HHII", 0x02BC, 1, len(inner), 26) + b"\0\0\0\0"
    path = jpeg_with(tmp_path, app1(b"Exif\0\0", head + inner))
    copy = copy_of(path, tmp_path / "out")
    check_all(path, copy, pose_of_turn(TURN, AT))
    assert b"DewarpData" in copy.read_bytes()


@pytest.mark.parametrize("before", [True, False], ids=["MPF first", "XMP first"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_further_pictures_are_found_wherever_the_segments_are(
    tmp_path: Path, before: bool, order: str
) -> None:
    raw_xmp = app1(XMP, packet(f"<rdf:Description {DJI} {GIMBAL}/>"))
    second = tmp_path / "second.jpg"
    Image.new("RGB", (16, 16), 40).save(second, "JPEG")

    def mpf(size: int, offset: int) -> bytes:
        block = (b"II" if order == "<" else b"MM") + struct.pack(order + "HIH", 42, 8, 3)
        block += struct.pack(order + "HHI4s", 0xB000, 7, 4, b"0100")
        block += struct.pack(order + "HHII", 0xB001, 4, 1, 2)
        block += struct.pack(order + "HHIII", 0xB002, 7, 32, 50, 0)
        block += struct.pack(order + "IIIHH", 0x030000, size, 0, 0, 0)
        block += struct.pack(order + "IIIHH", 0, second.stat().st_size, offset, 0, 0)
        return b"\xff\xe2" + struct.pack(">H", len(block) + 6) + b"MPF\0" + block

    parts = [mpf(0, 0), raw_xmp] if before else [raw_xmp, mpf(0, 0)]
    first = jpeg_with(tmp_path, *parts).stat().st_size
    data = (tmp_path / "A.jpg").read_bytes()
    base = data.index(b"MPF\0") + 4
    right = mpf(first, first - base)
    parts = [right, raw_xmp] if before else [raw_xmp, right]
    path = jpeg_with(tmp_path, *parts, behind=second.read_bytes())
    copy = copy_of(path, tmp_path / "out")
    assert copy.stat().st_size != path.stat().st_size
    pictures = further_pictures(copy)
    assert [start for start, _ in pictures] == [b"\xff\xd8"] * 2
    assert all(end.endswith(b"\xff\xd9") for _, end in pictures)
    with Image.open(copy) as image:
        image.seek(1)
        assert image.size == (16, 16)


def test_a_full_exif_block_gives_up_its_preview_and_says_so(tmp_path: Path) -> None:
    note = b"n" * 50_000
    block = tiff_block("<", note=note)
    preview_at = len(block)
    thumb = b"\xff\xd8" + b"t" * 15_200 + b"\xff\xd9"
    block = tiff_block("<", note=note, next_directory=preview_at)
    block += struct.pack("<H", 2) + struct.pack("<HHII", 0x0201, 4, 1, preview_at + 30)
    block += struct.pack("<HHII", 0x0202, 4, 1, len(thumb)) + b"\0\0\0\0" + thumb
    path = jpeg_with(tmp_path, app1(b"Exif\0\0", block))
    warnings = export(site_of([path], [pose_of_turn(TURN, AT)]), tmp_path / "out")
    copy = tmp_path / "out" / path.name
    assert "without its small preview" in warnings[0]
    exif = piexif.load(str(copy))
    assert exif["Exif"][piexif.ExifIFD.MakerNote] == note
    assert exif["thumbnail"] is None
    check_all(path, copy, pose_of_turn(TURN, AT))


def test_an_exif_block_without_room_is_refused_by_name(tmp_path: Path) -> None:
    block = tiff_block("<", note=b"n" * 65_400)
    path = jpeg_with(tmp_path, app1(b"Exif\0\0", block))
    with pytest.raises(ExportError, match=r"A\.jpg: the EXIF block of \d+ bytes has no room"):
        export(site_of([path], [pose_of_turn(TURN, AT)]), tmp_path / "out")


@pytest.mark.parametrize("big_endian", [True, False])
@pytest.mark.parametrize("tagged_before", [True, False])
def test_tiff_photos_keep_their_pixels(
    tmp_path: Path, big_endian: bool, tagged_before: bool
) -> None:
    path = tmp_path / "A.tif"
    image = Image.fromarray(np.arange(64 * 48, dtype=np.uint8).reshape(48, 64))
    exif = Image.Exif()
    exif.endian = ">" if big_endian else "<"
    if tagged_before:
        exif[0x010F] = "DJI"
        exif[700] = packet(f"<rdf:Description {DJI} {GIMBAL}/>")
        exif.get_ifd(0x8825).update({1: "S", 2: (1.0, 2.0, 3.0), 3: "E", 4: (1.0, 2.0, 3.0)})
    image.save(path, exif=exif)
    if big_endian:
        _as_big_endian(path)
    pose = pose_of_turn(TURN, AT)
    copy = copy_of(path, tmp_path / "out", pose)
    data, old = copy.read_bytes(), path.read_bytes()
    assert data[:2] == old[:2]
    assert bytes(np.arange(64 * 48, dtype=np.uint8)) in data
    assert decoded(copy) == decoded(path)
    assert b"GimbalYawDegree" not in data
    for reading in (tag_readers.odm(copy), tag_readers.orthority(copy)):
        assert reading.lat == pytest.approx(truth(pose)[0], abs=1e-7)
        assert angle_between(reading.R_enu_from_photo, truth(pose)[3]) < ANGLE_DEG
    own = own_pose(copy)
    assert own is not None
    assert angle_between(own.R_enu_from_cam, pose.R_enu_from_cam) < ANGLE_DEG


def _as_big_endian(path: Path) -> None:
    """Write the same picture with tifffile's other byte order."""
    import tifffile

    with Image.open(path) as image:
        pixels, exif = np.asarray(image), image.getexif()
        extra = [(271, "s", 0, exif[0x010F], True)] if 0x010F in exif else []
        if 700 in exif:
            extra.append((700, "B", len(exif[700]), exif[700], True))
    tifffile.imwrite(path, pixels, byteorder=">", extratags=extra)


def test_bigtiff_photos_too(tmp_path: Path) -> None:
    import tifffile

    path = tmp_path / "A.tif"
    pixels = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64)
    tifffile.imwrite(path, pixels, bigtiff=True, extratags=[(271, "s", 0, "Canon", True)])
    pose = pose_of_turn(TURN, AT)
    copy = copy_of(path, tmp_path / "out", pose)
    assert np.array_equal(tifffile.imread(copy), pixels)
    reading = tag_readers.orthority(copy)
    assert angle_between(reading.R_enu_from_photo, truth(pose)[3]) < ANGLE_DEG
    # GDAL reads no EXIF directories of a BigTIFF.
    own = own_pose(copy)
    assert own is not None
    assert own.origin_enu == pytest.approx(pose.origin_enu, abs=PLACE_M)


# -- bad input -------------------------------------------------------------------------------------


def good(folder: Path, name: str = "good.jpg") -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / name
    writer.write_photo(path, tags={"IFD0:Make": "Canon"})
    return path


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda p: p.unlink(), "cannot be read"),
        (lambda p: p.write_bytes(b""), "is empty"),
        (lambda p: p.write_bytes(b"GIF89a"), "not a JPEG or TIFF"),
        (lambda p: p.write_bytes(p.read_bytes()[:100]), "ends before its image data"),
        (lambda p: p.write_bytes(p.read_bytes()[:-20]), "no end mark"),
        (lambda p: p.write_bytes(p.read_bytes()[:2] + b"\0" * 500), "header is damaged at byte 2"),
        (lambda p: p.write_bytes(b"II*\0\xff\xff\0\0"), "damaged directory"),
    ],
)
def test_one_bad_photo_does_not_stop_the_rest(tmp_path: Path, spoil, words: str) -> None:  # type: ignore[no-untyped-def]
    folder = tmp_path / "in"
    bad, fine = good(folder, "bad.jpg"), good(folder)
    spoil(bad)
    pose = pose_of_turn(TURN, AT)
    warnings = export(site_of([bad, fine, good(folder, "c.jpg")], [pose, pose, None]),
                      tmp_path / "out")  # fmt: skip
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["good.jpg", INDEX]
    assert len(warnings) == 2
    assert "c.jpg: has no pose" in warnings[0]
    assert "bad.jpg" in warnings[1]
    assert words in warnings[1]
    assert "\n" not in warnings[1]


def test_a_cut_off_tiff_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "A.tif"
    Image.new("L", (64, 48), 90).save(path)
    data = path.read_bytes()
    # Directory first, picture last, as cameras write it.
    import tifffile

    tifffile.imwrite(path, np.full((48, 64), 90, np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[:-100])
    with pytest.raises(InputError, match=r"A\.tif: the picture ends at byte \d+"):
        write_tagged_copy(path, tmp_path / "B.tif", PoseTags(
            lat_lon_deg=(1.0, 2.0), altitude=3.0, yaw_pitch_roll_deg=(1.0, 2.0, 3.0)))  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["A.tif"]


def test_a_failing_disk_leaves_no_half_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = good(tmp_path / "in")
    real = Path.open

    class Full:
        """A file on a disk that is full after 100 bytes."""

        def __init__(self, file) -> None:  # type: ignore[no-untyped-def]
            self.file = file

        def __enter__(self) -> Full:
            return self

        def __exit__(self, *_: object) -> None:
            self.file.close()

        def write(self, data: bytes) -> int:
            self.file.write(data[:100])
            raise OSError(28, "No space left on device")

    def opened(self: Path, mode: str = "r", *args: object, **kwargs: object):  # type: ignore[no-untyped-def]
        file = real(self, mode, *args, **kwargs)  # type: ignore[call-overload]
        return Full(file) if mode == "wb" else file

    monkeypatch.setattr(Path, "open", opened)
    target = tmp_path / "B.jpg"
    with pytest.raises(OSError, match="No space left"):
        write_tagged_copy(path, target, PoseTags(
            lat_lon_deg=(1.0, 2.0), altitude=3.0, yaw_pitch_roll_deg=(1.0, 2.0, 3.0)))  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["in"]


def test_a_disk_too_small_is_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        tagged.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 10, "total": 10})
    )
    path = good(tmp_path / "in")
    with pytest.raises(ExportError, match="GB are needed"):
        export(site_of([path], [pose_of_turn(TURN, AT)]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("where", ["photos", ".", "link", "photos/../photos"])
def test_originals_are_never_written_to(tmp_path: Path, where: str) -> None:
    path = good(tmp_path / "photos")
    (tmp_path / "link").symlink_to(tmp_path / "photos")
    before = path.read_bytes()
    target = tmp_path / where
    part = target.with_name(f".{target.name}.part")
    for one in (target, part) if where != "." else (target,):
        with pytest.raises(ExportError, match=r"original|no folder"):
            export(site_of([path], [pose_of_turn(TURN, AT)]), one)
    with pytest.raises(InputError, match="never written to"):
        write_tagged_copy(path, path, PoseTags(
            lat_lon_deg=(1.0, 2.0), altitude=3.0, yaw_pitch_roll_deg=(1.0, 2.0, 3.0)))  # fmt: skip
    assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link", "photos"]


def test_an_earlier_export_is_replaced_and_nothing_else_is(tmp_path: Path) -> None:
    path = good(tmp_path / "in")
    site = site_of([path], [pose_of_turn(TURN, AT)])
    target = tmp_path / "out"
    export(site, target)
    first = (target / path.name).read_bytes()
    (target / path.name).write_bytes(b"changed by someone")
    export(site, target)
    assert (target / path.name).read_bytes() == first
    (target / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"notes\.txt, which is not of an earlier export"):
        export(site, target)
    assert (target / "notes.txt").read_text() == "mine"
    (tmp_path / "a file").write_text("x")
    with pytest.raises(ExportError, match="is no folder"):
        export(site, tmp_path / "a file")


def test_photos_of_one_name_keep_their_folders(tmp_path: Path) -> None:
    pose = pose_of_turn(TURN, AT)
    (tmp_path / "in").mkdir()
    paths = [good(tmp_path / "in" / sub) for sub in ("a", "b")]
    export(site_of(paths, [pose, pose]), tmp_path / "out")
    names = sorted(p.relative_to(tmp_path / "out").as_posix() for p in
                   (tmp_path / "out").rglob("*.jpg"))  # fmt: skip
    assert names == ["a/good.jpg", "b/good.jpg"]
    export(site_of(paths, [pose, pose]), tmp_path / "out")


def test_no_pose_at_all_and_stopping_are_told(tmp_path: Path) -> None:
    path = good(tmp_path / "in")
    with pytest.raises(ExportError, match="no photo has a pose yet"):
        export(site_of([path], [None]), tmp_path / "out")
    feedback = CollectingFeedback(stop_at=0.0)
    feedback.progress(0.0)
    with pytest.raises(Cancelled):
        write_tagged_photos(
            site_of([path], [pose_of_turn(TURN, AT)]), tmp_path / "out", TaggedPhotosOptions(),
            feedback,
        )  # fmt: skip


def test_copies_keep_the_time_of_the_file(tmp_path: Path) -> None:
    path = good(tmp_path / "in")
    os.utime(path, (1e9, 1e9))
    assert copy_of(path, tmp_path / "out").stat().st_mtime == 1e9


# -- from a project --------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Project]:
    """One photo with poses of all kinds; its footprint was made with the one from tags."""
    folder = tmp_path / "site"
    path = good(folder)
    project = Project.create(folder, {"project": {"name": "site"}})
    project.prepare()
    kinds = ("adjusted", "tags", "navigation")
    poses = [replace(pose_of_kind(kind), kind=kind) for kind in kinds]
    site = site_of([path], [poses[0]])
    footprint = replace(make_site(tmp_path, crs=CRS).footprints[0], photo_id="0")
    photos = [photo_row(p.photo, site.frame, status="ok", fingerprint="") for p in site.photos]
    database = project.database
    with database.transaction():
        save_frame(database, site.frame)
        database.set_meta(epoch=EPOCH)
        database.replace_rows("photo", photos)
        database.replace_rows("footprint", [footprint_row(footprint, pose_kind="tags", doubts=())])
        database.replace_rows(
            "pose",
            [
                pose_row("0", pose, site.frame, height_above_ground=90.0, dialect="ypr", doubts=())
                for pose in poses
            ],
        )
    yield project
    project.close()


def pose_of_kind(kind: str) -> Pose:
    heading = {"adjusted": 10.0, "tags": 20.0, "navigation": 30.0}[kind]
    return pose_of_turn([0.0, 0.0, heading], [0.0, 0.0, 100.0])


def run_tool(project: Project, **values: object) -> Path:
    tool = tool_of(tagged.TaggedPhotos)
    result = tool().run(Context(project=project), tool.Parameters(**values), CollectingFeedback())
    return Path(result.outputs["target"])


def test_the_best_pose_of_a_project_is_written(project: Project) -> None:
    target = run_tool(project)
    assert target == project.products / "tagged_photos"
    reading = tag_readers.odm(target / "good.jpg")
    assert angle_between(reading.R_enu_from_photo, truth(pose_of_kind("adjusted"))[3]) < ANGLE_DEG
    assert "adjusted" in (target / INDEX).read_text()
    project.database.delete_rows("pose", {"kind": "adjusted"})
    reading = tag_readers.odm(run_tool(project) / "good.jpg")
    assert angle_between(reading.R_enu_from_photo, truth(pose_of_kind("navigation"))[3]) < ANGLE_DEG


def test_the_tool_does_not_replace_the_folder_of_the_originals(project: Project) -> None:
    path = project.folder / "good.jpg"
    before = path.read_bytes()
    with pytest.raises(ExportError, match="would be lost"):
        run_tool(project, target=str(project.folder))
    assert path.read_bytes() == before


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENOSPC, errno.EROFS])
def test_a_folder_that_cannot_be_written_is_one_line_and_leaves_the_last_export(
    project: Project, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    target = run_tool(project)
    before = {p.name: p.read_bytes() for p in target.iterdir()}
    real = Path.open

    def opened(self: Path, mode: str = "r", *args: object, **kwargs: object):  # type: ignore[no-untyped-def]
        if mode == "wb":
            raise OSError(number, os.strerror(number))
        return real(self, mode, *args, **kwargs)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(ExportError) as caught:
        run_tool(project)
    assert os.strerror(number) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert {p.name: p.read_bytes() for p in target.iterdir()} == before
    assert [p.name for p in project.products.iterdir()] == ["tagged_photos"]


def test_time_of_the_exposure_has_its_fraction(tmp_path: Path) -> None:
    site = site_of([good(tmp_path / "in")], [pose_of_turn(TURN, AT)])
    found = tagged.pose_tags(
        site, site.photos[0], site.layers["photos"].features[0], TaggedPhotosOptions()
    )
    assert found.utc == datetime(2026, 5, 1, 12, 0, 2, 250_000, tzinfo=UTC)
    assert photo_tags.xmp_fields(found, "")["Camera"]["AboveGroundAltitude"] == "88.500"
