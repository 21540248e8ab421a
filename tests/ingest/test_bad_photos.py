"""Photos that cannot be used, or only with doubt; the rest of the batch goes on."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from georef_gis.errors import Cancelled, InputError
from georef_gis.ingest.containers import read_file_tags
from georef_gis.ingest.exif import read_exif
from georef_gis.ingest.photos import find_photos, read_photo, read_photos
from georef_gis.ingest.xmp import tags_from_packets

Writer = Callable[..., Path]

GOOD: dict[str, object] = {
    "IFD0:Make": "DJI",
    "IFD0:Model": "FC300S",
    "ExifIFD:FocalLength": 3.61,
    "ExifIFD:FocalLengthIn35mmFormat": 20,
    "ExifIFD:DateTimeOriginal": "2016:06:23 16:31:59",
    "GPS:GPSLatitudeRef": "N",
    "GPS:GPSLatitude": 46.8426,
    "GPS:GPSLongitudeRef": "W",
    "GPS:GPSLongitude": 91.99456,
    "GPS:GPSAltitudeRef": 0,
    "GPS:GPSAltitude": 198.3,
    "XMP-drone-dji:RelativeAltitude": "+39.80",
    "XMP-drone-dji:GimbalRollDegree": "+0.00",
    "XMP-drone-dji:GimbalPitchDegree": "-89.90",
    "XMP-drone-dji:GimbalYawDegree": "+45.00",
    "XMP-drone-dji:FlightRollDegree": "+3.00",
    "XMP-drone-dji:FlightPitchDegree": "+1.80",
    "XMP-drone-dji:FlightYawDegree": "+46.00",
}


def test_a_good_photo_gives_no_doubt(photo_file: Writer) -> None:
    assert read_photo(photo_file(tags=GOOD)).doubts == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"GPS:GPSLatitude": None, "GPS:GPSLongitude": None}, "no position"),
        ({"GPS:GPSLatitude": 0.0, "GPS:GPSLongitude": 0.0}, "position is 0, 0"),
        ({"GPS:GPSLatitude": 146.0}, "is not on the Earth"),
        ({"GPS:GPSAltitude": 0.0}, "[GPS:GPSAltitude] is 0 m"),
        ({"GPS:GPSAltitude": None}, "[GPS:GPSAltitude] is missing"),
        ({"XMP-drone-dji:RelativeAltitude": "+1.20"}, "taken on or near the ground"),
        ({"XMP-drone-dji:GimbalPitchDegree": "-10.00"}, "towards the horizon"),
        ({"XMP-drone-dji:FlightYawDegree": "-170.00"}, "flight yaw -170.0 deg differ by 145 deg"),
        ({"XMP-drone-dji:GimbalRollDegree": "+180.00"}, "upside down"),
        ({"IFD0:Orientation": 3}, "[EXIF:Orientation] 3"),
        ({"IFD0:Software": "Adobe Photoshop 22.1"}, "photo viewer or editor '"),
        ({"IFD0:Software": "GIMP 2.10"}, "photo viewer or editor '"),
    ],
    ids=str,
)
def test_doubt_names_file_and_cure(
    photo_file: Writer, change: dict[str, object], words: str
) -> None:
    tags = {k: v for k, v in (GOOD | change).items() if v is not None}
    doubts = read_photo(photo_file("P_1.jpg", tags=tags)).doubts
    assert any(words in doubt and doubt.startswith("P_1.jpg: ") for doubt in doubts), doubts


def test_position_of_zero_is_no_position(photo_file: Writer) -> None:
    tags = GOOD | {"GPS:GPSLatitude": 0.0, "GPS:GPSLongitude": 0.0}
    assert read_photo(photo_file(tags=tags)).geotag is None


def test_gimbal_lock_is_not_a_contradiction(photo_file: Writer) -> None:
    # Looking straight down, roll 100 and yaw -55 deg are heading 45 deg.
    change = {"XMP-drone-dji:GimbalRollDegree": "100", "XMP-drone-dji:GimbalYawDegree": "-55"}
    doubts = read_photo(photo_file(tags=GOOD | change)).doubts
    assert ["gimbal lock" in doubt for doubt in doubts] == [True]


def test_tags_that_disagree_on_the_place_are_doubted(photo_file: Writer) -> None:
    change = {
        "XMP-drone-dji:GPSLatitude": "46.8427",
        "XMP-drone-dji:GPSLongtitude": "-91.99456",
    }
    photo = read_photo(photo_file(tags=GOOD | change))
    assert any("differ by about 11.1 m" in doubt for doubt in photo.doubts)
    assert photo.geotag is not None
    assert photo.geotag.source == "EXIF GPS"


@pytest.mark.parametrize("keep", [0, 2, 40, 300, 900], ids="{} bytes".format)
def test_a_cut_off_jpeg_is_refused(photo_file: Writer, keep: int) -> None:
    path = photo_file("cut.jpg", tags=GOOD, size=(200, 150))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"cut\.jpg"):
        read_photo(path)


def test_a_jpeg_without_its_last_part_is_refused(photo_file: Writer) -> None:
    path = photo_file("cut.jpg", tags=GOOD, size=(200, 150))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"no end mark.*copy it again"):
        read_photo(path)


def test_data_behind_the_end_mark_is_no_fault(photo_file: Writer) -> None:
    path = photo_file(tags=GOOD)
    path.write_bytes(path.read_bytes() + b"thermal" * 5000)
    assert read_photo(path).doubts == ()


@pytest.mark.parametrize("content", [b"GPS log\n", b"\x89PNG\r\n\x1a\n", b"II*\0"], ids=repr)
def test_what_is_no_photo_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.jpg"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.jpg"):
        read_photo(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_photo(tmp_path / "none.jpg")


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=400), head=st.sampled_from([b"II*\0", b"MM\0*", b"II+\0", b""]))
def test_any_exif_block_is_survived(data: bytes, head: bytes) -> None:
    block = head + data
    assert isinstance(read_exif(lambda offset, n: block[offset : offset + n]).tags, dict)


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(place=st.integers(2, 1500), value=st.integers(0, 255))
def test_a_damaged_byte_gives_a_photo_or_a_refusal(
    photo_file: Writer, place: int, value: int
) -> None:
    path = photo_file(tags=GOOD)
    raw = bytearray(path.read_bytes())
    raw[place] = value
    path.write_bytes(raw)
    with contextlib.suppress(InputError):
        read_photo(path)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200))
def test_any_packet_is_survived(text: str) -> None:
    body = f"<x:xmpmeta xmlns:x='adobe:ns:meta/'>{text}</x:xmpmeta>"
    packets = [body.encode("utf-8", "replace"), text.encode("utf-8", "replace")]
    assert tags_from_packets(packets) is not None


def test_malformed_xmp_is_doubted_and_used(photo_file: Writer) -> None:
    packet = (
        b"<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF "
        b"xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'><rdf:Description rdf:about='' "
        b"xmlns:Camera='http://www.pix4d.com/camera/1.0/'><Camera:Yaw>12.5</Camera:Yaw>"
        b"<Camera:Pitch>1</Camera:Pitch><Camera:Roll>2</Camera:Roll><Camera:Bad>&nope;</Camera:Bad>"
        b"</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    tags = {k: v for k, v in GOOD.items() if not k.startswith("XMP")}
    photo = read_photo(photo_file(tags=tags, packets=[packet]))
    assert photo.attitude is not None
    assert photo.attitude.dialect == "pix4d-camera"
    assert any("malformed XML" in doubt for doubt in photo.doubts)


def test_several_packets_and_an_extended_one_are_read(photo_file: Writer, tmp_path: Path) -> None:
    import photo_writer

    one = photo_writer.xmp_packet({"XMP-Camera:Yaw": 1.5})
    two = photo_writer.xmp_packet({"XMP-drone-dji:RelativeAltitude": "+20.0"})
    long = photo_writer.xmp_packet({"XMP-FLIR:MAVYaw": 9.5})
    half = len(long) // 2
    path = photo_file(packets=[one, two])
    raw = path.read_bytes()
    parts = b""
    for offset, part in ((0, long[:half]), (half, long[half:])):
        head = b"http://ns.adobe.com/xmp/extension/\0" + b"A" * 32
        head += len(long).to_bytes(4, "big") + offset.to_bytes(4, "big")
        parts += photo_writer.segment(head + part)
    path.write_bytes(raw[:2] + parts + raw[2:])
    tags = read_file_tags(path).tags
    assert tags["XMP-Camera:Yaw"] == "1.5"
    assert tags["XMP-drone-dji:RelativeAltitude"] == "+20.0"
    assert tags["XMP-FLIR:MAVYaw"] == "9.5"


def test_a_bad_photo_does_not_stop_the_batch(photo_file: Writer) -> None:
    good = [photo_file(f"A_{n}.jpg", tags=GOOD) for n in range(5)]
    bad = photo_file("A_9.jpg", tags=GOOD)
    bad.write_bytes(b"")
    result = read_photos([*good, bad], workers=2)
    assert [photo.id for photo in result.photos] == [f"A_{n}" for n in range(5)]
    assert [path for path, _ in result.refused] == [bad]


def test_if_all_are_refused_the_batch_fails(photo_file: Writer) -> None:
    bad = photo_file("A.jpg")
    bad.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"none of 1 photos can be used; the first: .*A\.jpg"):
        read_photos([bad])


def test_a_photo_without_focal_length_is_refused_with_a_cure(photo_file: Writer) -> None:
    tags = {k: v for k, v in GOOD.items() if "Focal" not in k}
    result = read_photos([photo_file("A.jpg", tags=GOOD), photo_file("B.jpg", tags=tags)])
    assert [photo.id for photo in result.photos] == ["A"]
    (_, error) = result.refused[0]
    assert "B.jpg" in str(error)
    assert "[camera] focal_px" in str(error)


def test_a_stranger_among_the_cameras_is_doubted(photo_file: Writer) -> None:
    paths = [photo_file(f"A_{n}.jpg", tags=GOOD) for n in range(6)]
    paths.append(photo_file("B.jpg", tags=GOOD | {"IFD0:Model": "FC350"}))
    result = read_photos(paths)
    assert len(result.cameras) == 2
    doubtful = [photo.id for photo in result.photos if photo.doubts]
    assert doubtful == ["B"]


def test_photos_of_one_name_get_ids_of_their_own(photo_file: Writer, tmp_path: Path) -> None:
    for name in ("a/DJI_0001.JPG", "b/DJI_0001.JPG", "b/DJI_0002.JPG"):
        photo_file(name, tags=GOOD)
    result = read_photos(find_photos(tmp_path, subfolders=True))
    by_id = {photo.id: photo for photo in result.photos}
    assert set(by_id) == {"a/DJI_0001.JPG", "b/DJI_0001.JPG", "DJI_0002"}
    assert "2 photos have this name" in by_id["a/DJI_0001.JPG"].doubts[0]
    assert by_id["DJI_0002"].doubts == ()


def test_find_photos_counts_as_people_do(tmp_path: Path) -> None:
    for name in ("D_10.jpg", "D_2.JPG", "D_1.tif", "notes.txt", "D_3_thumb.jpg", ".D_0.jpg"):
        (tmp_path / name).write_bytes(b"")
    found = find_photos(tmp_path, exclude=("*_THUMB.*",))
    assert [path.name for path in found] == ["D_1.tif", "D_2.JPG", "D_10.jpg"]


def test_an_empty_folder_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no photos"):
        find_photos(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        find_photos(tmp_path / "none")


def test_progress_may_cancel(photo_file: Writer) -> None:
    def stop(done: int, _all: int) -> None:
        if done == 2:
            raise Cancelled

    paths = [photo_file(f"A_{n}.jpg", tags=GOOD) for n in range(4)]
    with pytest.raises(Cancelled):
        read_photos(paths, workers=2, progress=stop)


@pytest.mark.slow
def test_processes_give_what_one_thread_gives(
    photo_file: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [photo_file(f"A_{n}.jpg", tags=GOOD) for n in range(8)]
    paths[3].write_bytes(b"x")
    monkeypatch.setattr("georef_gis.ingest.photos._ENOUGH_FOR_PROCESSES", 1)
    one, many = read_photos(paths), read_photos(paths, workers=2)
    assert one.photos == many.photos
    assert [str(error) for _, error in one.refused] == [str(error) for _, error in many.refused]


def test_makernote_keeps_its_byte_order_in_an_edited_file(photo_file: Writer) -> None:
    # piexif writes the EXIF big-endian around the little-endian note.
    tags = {k: v for k, v in GOOD.items() if not k.startswith("XMP")}
    note = {"DJI:CameraPitch": -89.9, "DJI:CameraYaw": 12.5, "DJI:CameraRoll": 0.0}
    photo = read_photo(photo_file(tags=tags | note))
    assert photo.attitude is not None
    assert photo.attitude.dialect == "dji-makernote"
