"""Control points and marks: own files, ODM's gcp_list.txt, real ones."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.ingest.control import ControlOptions, read_control, read_marks

CONTROL = """# crs: EPSG:6601
# datum: NAD83(2011)@2010.0
# height_kind: orthometric
# geoid: geoid18
# unit: US survey foot (easting, northing, height); sigmas in m
name,easting,northing,height,sigma_h_m,sigma_v_m,role
P01,2000000.5,700000.25,1000,0.01,0.02,control
P02,2000100,700000,,,,check
P03,2000100,700100,1001,0.01,0.02,off
"""


@pytest.fixture
def write(tmp_path: Path):
    def put(text: str, name: str = "control.csv") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return put


def test_control_csv_with_its_header(write) -> None:
    control = read_control(write(CONTROL))
    first, second, third = control.points
    assert control.crs.to_epsg() == 6601
    assert str(control.datum) == "NAD83(2011)@2010.0"
    assert (control.height_kind, control.geoid) == ("orthometric", "geoid18")
    assert (first.easting, first.northing) == (2000000.5, 700000.25)
    assert first.height == pytest.approx(304.8006096, abs=1e-6)
    assert (first.sigma_h, first.sigma_v) == (0.01, 0.02)
    assert second.height is None
    assert [p.role for p in control.points] == ["control", "check", "off"]
    assert third.name == "P03"


def test_heights_above_a_datum_without_a_geoid_are_taken_when_it_is_said_what_they_are(
    write,
) -> None:
    path = write(CONTROL.replace("EPSG:6601", "EPSG:6601+5702"))
    assert read_control(path).height_kind == "orthometric"


def test_points_whose_heights_are_left_out_need_no_geoid(write) -> None:
    lines = CONTROL.replace("EPSG:6601", "EPSG:6601+5702").splitlines(True)
    text = "".join(lines[:1] + lines[5:])
    without = read_control(write(text), ControlOptions(height_kind="none"))
    assert [point.height for point in without.points] == [None, None, None]
    flat = write("# crs: EPSG:6601+5702\nname,easting,northing\nP1,2000000,700000\n", "flat.csv")
    assert read_control(flat).points[0].height is None


@pytest.mark.parametrize(
    ("name", "metres"), [("ft", 304.8), ("Feet", 304.8), ("us_survey_foot", 1200000 / 3937)]
)
def test_a_line_of_the_height_unit_may_name_any_foot(write, name: str, metres: float) -> None:
    lines = [f"# height_unit: {name}\n" if "# unit" in s else s for s in CONTROL.splitlines(True)]
    assert read_control(write("".join(lines))).points[0].height == pytest.approx(metres, abs=1e-9)


def test_marks_csv(write) -> None:
    control = read_control(write(CONTROL))
    text = "name,photo,u,v,sigma_px\nP01,A.JPG,10.25,20.5,0.3\nP02,A.JPG,0,0,\n"
    marks = read_marks(write(text, "marks.csv"), control).marks
    assert (marks[0].u, marks[0].v, marks[0].sigma_px) == (10.25, 20.5, 0.3)
    assert marks[1].sigma_px == 0.5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("check", "maybe"), r"line 8: role: 'maybe' is not a role; .*; left out"),
        (("700000.25", "north"), r"line 7: northing: 'north' is not a number; .*; left out"),
        (
            ("0.01,0.02,control", "-1,0.02,control"),
            r"line 7: sigma_h_m: -1 is no standard .*; left",
        ),
    ],
    ids=lambda v: str(v)[:30],
)
def test_a_bad_line_is_told_and_the_others_are_read(
    write, change: tuple[str, str], words: str
) -> None:
    control = read_control(write(CONTROL.replace(*change, 1)))
    (doubt,) = control.doubts
    assert re.search(words, doubt)
    assert len(control.points) == 2


def test_a_name_with_two_places_is_told_and_off(write) -> None:
    control = read_control(write(CONTROL.replace("P02,2000100", "P01,2000100", 1)))
    (doubt,) = control.doubts
    # 99.5 US survey feet
    assert re.search(r"line 8: name: point 'P01' stands in line 7 too, 30.3 m away", doubt)
    assert [(p.name, p.role) for p in control.points] == [("P01", "off"), ("P03", "off")]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("# crs: EPSG:6601\n", ""), r"control.csv: crs: no CRS"),
        (("EPSG:6601", "EPSG:1"), r"is not a CRS"),
        (("orthometric", "sealevel"), r"'sealevel' is no kind of height"),
        (("US survey foot", "foot"), r"unit: 'foot' is not known"),
        (("easting,northing,height", "a,b,c"), r"line 6: column longitude, latitude is missing"),
        (
            (
                "EPSG:6601\n# datum: NAD83(2011)@2010.0\n# height_kind: orthometric",
                "EPSG:6601+5702",
            ),
            r"crs: heights of 'NGVD29 height \(ftUS\)' are of no geoid that is known: convert them",
        ),
    ],
    ids=lambda v: str(v)[:30],
)
def test_a_file_of_which_nothing_can_be_used_is_refused(
    write, change: tuple[str, str], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        read_control(write(CONTROL.replace(*change, 1)))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("P99,A.JPG,1,1,1", r"line 2: name: point 'P99' is not among"),
        ("P01,A.JPG,1,1,0", r"line 2: sigma_px: 0 is no standard"),
        ("P01,,1,1,1", r"line 2: name or photo is missing"),
    ],
)
def test_bad_marks_are_told_and_the_others_are_read(write, row: str, words: str) -> None:
    control = read_control(write(CONTROL))
    path = write(f"name,photo,u,v,sigma_px\n{row}\nP03,A.JPG,5,6,\n", "marks.csv")
    found = read_marks(path, control)
    (doubt,) = found.doubts
    assert re.search(words, doubt)
    assert [mark.name for mark in found.marks] == ["P03"]


def test_gcp_list_with_a_check_point_and_a_blank_in_a_name(write) -> None:
    text = (
        "EPSG:32617\n500000 4000000 350 100.5 200 IMG%201.JPG G1\n"
        "500010 4000000 nan 10 20 IMG_2.JPG CHK-G2\n"
    )
    control = read_control(write(text, "gcp_list.txt"))
    assert [(p.name, p.role, p.height) for p in control.points] == [
        ("G1", "control", 350.0),
        ("G2", "check", None),
    ]
    assert control.marks[0].photo == "IMG 1.JPG"
    assert control.marks[0].u == 100.5


def test_gcp_list_with_contradicting_points_uses_neither(write) -> None:
    text = "EPSG:32617\n500000 4000000 350 1 2 A.JPG G1\n500000 4000001 350 1 2 B.JPG G1\n"
    control = read_control(write(text, "gcp_list.txt"))
    (doubt,) = control.doubts
    assert "line 3: gcp_name: point 'G1' has other coordinates" in doubt
    assert [p.role for p in control.points] == ["off"]


def test_gcp_list_keeps_the_coordinates_of_most_lines(write) -> None:
    good = "500000 4000000 350 1 2 {}.JPG G1\n"
    text = (
        "EPSG:32617\n" + good.format("A") + good.format("B") + "500900 4000000 350 1 2 C.JPG G1\n"
    )
    control = read_control(write(text, "gcp_list.txt"))
    assert control.points[0].easting == 500000
    assert control.points[0].role == "control"
    assert len(control.marks) == 3
    assert "line 4: gcp_name: point 'G1' has other coordinates (500900" in control.doubts[0]


def test_gcp_list_without_names_groups_by_coordinates(write) -> None:
    text = (
        "WGS84 UTM 22S\n658528.361\t7167002.098\t890.6\t1\t2\tA.JPG\n"
        "658528.361 7167002.098 890.6 3 4 B.JPG\n658528.362 7167002.098 890.6 3 4 A.JPG\n"
    )
    control = read_control(write(text, "gcp_list.txt"))
    assert [p.name for p in control.points] == ["GCP-1", "GCP-2"]
    assert [m.name for m in control.marks] == ["GCP-1", "GCP-1", "GCP-2"]
    assert control.crs.to_epsg() == 32722


def test_gcp_list_with_extras_compound_crs_and_no_height_column(write) -> None:
    text = (
        "EPSG:6527+6360\n2000000 700000 10 1 2 A.JPG G1 extra1 extra2\n"
        "2000100 700000 1 2 A.JPG G2\n"
    )
    control = read_control(write(text, "gcp_list.txt"))
    first, second = control.points
    # EPSG:6360 is NAVD88 height in US survey feet
    assert first.height == pytest.approx(10 * 1200 / 3937)
    assert (control.height_kind, control.geoid) == ("orthometric", "geoid18")
    assert (second.name, second.height) == ("G2", None)
    assert "line 3: geo_z: 1 lines have no height column" in control.doubts[0]


def test_gcp_list_with_rows_counted_upwards_is_turned_and_told(write) -> None:
    text = "EPSG:32617\n500000 4000000 350 10 -20 A.JPG G1\n500009 4000001 1 30 -5 A.JPG G2\n"
    control = read_control(write(text, "gcp_list.txt"))
    assert [(m.u, m.v) for m in control.marks] == [(10, 20), (30, 5)]
    assert "im_y: all 2 rows are negative" in control.doubts[0]


def test_a_height_of_zero_among_others_is_no_height(write) -> None:
    text = "EPSG:32617\n500000 4000000 350 1 2 A.JPG G1\n500009 4000001 0 1 2 A.JPG G2\n"
    control = read_control(write(text, "gcp_list.txt"))
    assert "height 0" in control.doubts[0]
    assert control.points[1].height is None


def test_real_marks_of_curitiba(data: Path) -> None:
    folder = data / "numbers" / "control_marks_br"
    control = read_control(folder / "gcp_list.txt")
    assert control.crs.utm_zone == "22S"
    assert len(control.points) == 6
    assert len(control.marks) == 25
    assert control.doubts == ()
    hv01 = control.points[0]
    assert (hv01.easting, hv01.northing, hv01.height) == (658528.361, 7167002.098, 890.636)


def test_real_list_in_degrees(data: Path) -> None:
    control = read_control(data / "numbers" / "rtk_mrk" / "gcp_list.txt")
    assert control.crs.is_geographic
    first = control.points[0]
    assert (first.easting, first.northing) == (16.47592207, 47.64350399)
