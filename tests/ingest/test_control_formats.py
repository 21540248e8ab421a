"""Control in the formats of other programs, written here as those programs' manuals show them."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.ingest.control import ControlOptions, read_control, read_marks

# name, easting, northing, height m, sigma_h, sigma_v
TRUTH = [
    ("P1", 500010.25, 4400020.5, 312.125, 0.02, 0.03),
    ("P2", 500110.75, 4400120.25, 315.5, 0.02, 0.03),
    ("P3", 500210.0, 4400220.0, 309.0, 0.02, 0.03),
]
UTM = ControlOptions(crs="EPSG:32617")


def values(control) -> np.ndarray:  # type: ignore[no-untyped-def]
    return np.array(
        [[q.easting, q.northing, q.height, q.sigma_h, q.sigma_v] for q in control.points]
    )


def put(folder: Path, text: str, name: str = "points.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "separator", [",", ";", "\t", " "], ids=["comma", "semicolon", "tab", "blank"]
)
def test_pix4d_points_without_header(tmp_path: Path, separator: str) -> None:
    lines = [separator.join(map(str, row)) for row in TRUTH]
    control = read_control(put(tmp_path, "\n".join(lines)), UTM)
    assert control.format == "pix4d"
    assert np.array_equal(values(control), [row[1:] for row in TRUTH])


def test_pix4d_marks_count_from_the_corner_of_the_first_pixel(tmp_path: Path) -> None:
    points = put(tmp_path, "\n".join(",".join(map(str, row[:4])) for row in TRUTH))
    marks = put(tmp_path, "IMG 1.JPG,P1,100.5,200.5\nIMG 1.JPG,P3,0.5,0.5\n", "marks.csv")
    control = read_marks(marks, read_control(points, UTM), UTM)
    # assumed rule: the manual does not say
    assert [(m.name, m.photo, m.u, m.v) for m in control.marks] == [
        ("P1", "IMG 1.JPG", 100.0, 200.0), ("P3", "IMG 1.JPG", 0.0, 0.0),
    ]  # fmt: skip
    by_centre = ControlOptions(crs="EPSG:32617", pixel_zero="centre")
    assert read_marks(marks, read_control(points, UTM), by_centre).marks[0].u == 100.5


def test_pix4d_marks_with_the_label_first_and_other_case(tmp_path: Path) -> None:
    points = put(tmp_path, "\n".join(",".join(map(str, row[:4])) for row in TRUTH))
    marks = put(tmp_path, "p1,IMG_1.JPG,100.5,200.5\np3,IMG_2.JPG,7,8\n", "marks.csv")
    control = read_marks(marks, read_control(points, UTM), UTM)
    assert [(m.name, m.photo) for m in control.marks] == [("P1", "IMG_1.JPG"), ("P3", "IMG_2.JPG")]


def test_metashape_reference_csv(tmp_path: Path) -> None:
    text = (
        '# CoordinateSystem: EPSG:32617\n'
        "# Markers (3)\n"
        "#Label,Enable,X/Easting,Y/Northing,Z/Altitude,Accuracy_X/Y/Z_(m),Error_(m),X_est,Y_est\n"
        + "".join(
            f"{n},{int(n != 'P2')},{e},{k},{z},{h}/{v},0.1,1,2\n" for n, e, k, z, h, v in TRUTH
        )
        + "# Total Error\n"
    )  # fmt: skip
    control = read_control(put(tmp_path, text))
    assert control.format == "metashape"
    assert control.crs.to_epsg() == 32617
    assert [q.role for q in control.points] == ["control", "check", "control"]
    assert np.array_equal(values(control), [row[1:] for row in TRUTH])


def test_metashape_markers_xml(tmp_path: Path) -> None:
    root = ET.Element("document", version="1.2.0")
    chunk = ET.SubElement(root, "chunk", label="Chunk 1")
    cameras = ET.SubElement(chunk, "cameras")
    for i in (7, 9):
        ET.SubElement(cameras, "camera", id=str(i), label=f"DJI_000{i}")
    markers = ET.SubElement(chunk, "markers", next_id="4")
    for i, (name, e, n, z, h, v) in enumerate(TRUTH):
        marker = ET.SubElement(markers, "marker", id=str(i), label=name)
        ET.SubElement(
            marker, "reference", x=str(e), y=str(n), z=str(z), sx=str(h), sy=str(h), sz=str(v),
            enabled="false" if name == "P2" else "true",
        )  # fmt: skip
    frame = ET.SubElement(ET.SubElement(chunk, "frames"), "frame", id="0")
    placed = ET.SubElement(frame, "markers")
    for i, pinned in ((0, "true"), (1, "true"), (2, "false")):
        one = ET.SubElement(placed, "marker", marker_id=str(i))
        ET.SubElement(one, "location", camera_id="9", pinned=pinned, x="10.5", y=f"{20.5 + i}")
    ET.SubElement(chunk, "reference").text = "EPSG:32617"
    path = tmp_path / "markers.xml"
    ET.ElementTree(root).write(path)
    control = read_control(path)
    assert [q.role for q in control.points] == ["control", "check", "control"]
    assert np.array_equal(values(control), [row[1:] for row in TRUTH])
    # pinned ones only; the centre of the first pixel is 0.5, 0.5 there
    assert [(m.name, m.photo, m.u, m.v) for m in control.marks] == [
        ("P1", "DJI_0009", 10.0, 20.0), ("P2", "DJI_0009", 10.0, 21.0),
    ]  # fmt: skip


@pytest.mark.parametrize(("unit", "length"), [("ft", 1200 / 3937), ("m", 1.0)])
def test_dronedeploy_points_have_northing_first_and_a_unit(
    tmp_path: Path, unit: str, length: float
) -> None:
    text = (
        f"GCP Label,Northing,Easting,Elevation ({unit})\n1,700000.5,2000000.25,1000\n"
        "Checkpoint 1,700100,2000100,1001\n"
    )
    control = read_control(put(tmp_path, text), ControlOptions(crs="EPSG:6601"))
    first, second = control.points
    assert (first.easting, first.northing) == (2000000.25, 700000.5)
    assert first.height == pytest.approx(1000 * length, abs=1e-9)
    assert (first.role, second.role) == ("control", "check")


def test_dronedeploy_degrees_need_no_crs(tmp_path: Path) -> None:
    text = "GCP Label,Latitude,Longitude,Elevation (m)\n1,39.1,-80.4,300\n"
    control = read_control(put(tmp_path, text))
    assert control.crs.to_epsg() == 4326
    assert (control.points[0].easting, control.points[0].northing) == (-80.4, 39.1)


def test_a_2d_point_has_no_height(tmp_path: Path) -> None:
    text = (
        "# crs: EPSG:32617\nname,easting,northing,height,role\n"
        "A,500000,4400000,12,2D GCP\nB,500001,4400000,12,3D GCP\n"
    )
    assert [q.height for q in read_control(put(tmp_path, text)).points] == [None, 12.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("<document/>", "has no markers"),
        ("<document", "cannot be read as XML"),
        ("EPSG:32617\n", "points"),
        ("a,b,c,d\ne,f,g,h\n", "column"),
        ("EPSG:99999\n1 2 3 4 5 A.JPG\n", "line 1: crs: .* is not a CRS"),
        ("P1,500000,4400000,1\n", "crs: no CRS"),
    ],
)
def test_files_that_are_no_control_are_refused_in_one_line(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(InputError, match=words) as raised:
        read_control(put(tmp_path, text, "points.txt"))
    assert "points.txt" in str(raised.value)
    assert "\n" not in str(raised.value)
