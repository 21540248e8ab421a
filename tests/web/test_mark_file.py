"""Marks are edited one by one; whatever else stands in the file stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from georef_gis.errors import ExportError, InputError
from processing_algorithms.measure.mark_file import has_rows, name_mark_file, set_mark

TEXT = """name,photo,u,v,sigma_px,who
# checked twice
P1,a.jpg,10.5,20.25,0.30,me
P1,sub/b.jpg,1,2,0.5,"you, too"
P2,a.jpg,7,8,,
"""


def is_photo(stem: str) -> object:
    return lambda written: Path(written).stem == stem


@pytest.fixture
def marks(tmp_path: Path) -> Path:
    path = tmp_path / "marks.csv"
    path.write_text(TEXT)
    return path


def put(path: Path, name: str, stem: str, uv: tuple[float, float] | None) -> list[str]:
    set_mark(path, name, f"{stem}.jpg", uv, sigma_px=0.5, is_photo=is_photo(stem))  # type: ignore[arg-type]
    return path.read_text().splitlines()


def test_a_mark_is_replaced_in_its_line_with_its_other_columns(marks: Path) -> None:
    lines = put(marks, "P1", "b", (3.0, 4.0))
    assert lines[3] == 'P1,sub/b.jpg,3.000,4.000,0.50,"you, too"'
    assert lines[:3] + lines[4:] == TEXT.splitlines()[:3] + TEXT.splitlines()[4:]


def test_a_new_mark_is_added_at_the_end(marks: Path) -> None:
    lines = put(marks, "P3", "a", (1.23456, 5.0))
    assert lines == [*TEXT.splitlines(), "P3,a.jpg,1.235,5.000,0.50,"]


def test_a_mark_is_taken_away_and_the_others_stay(marks: Path) -> None:
    assert put(marks, "P1", "a", None) == [*TEXT.splitlines()[:2], *TEXT.splitlines()[3:]]
    # one that is not there is no fault
    assert put(marks, "P9", "a", None) == [*TEXT.splitlines()[:2], *TEXT.splitlines()[3:]]


def test_the_file_as_it_was_first_stays_beside_it(marks: Path) -> None:
    put(marks, "P1", "a", (1.0, 1.0))
    put(marks, "P1", "a", (2.0, 2.0))
    assert (marks.parent / "marks.csv.bak").read_text() == TEXT
    assert sorted(path.name for path in marks.parent.iterdir()) == ["marks.csv", "marks.csv.bak"]


def test_a_file_that_is_not_there_is_made(tmp_path: Path) -> None:
    lines = put(tmp_path / "marks.csv", "P1", "a", (1.0, 2.0))
    assert lines == ["name,photo,u,v,sigma_px", "P1,a.jpg,1.000,2.000,0.50"]
    assert not (tmp_path / "marks.csv.bak").exists()


@pytest.mark.parametrize(
    "text", ["EPSG:32617\n1 2 3 4 5 a.jpg P1\n", "a.jpg,P1,10,20\n", "name,photo,x,y\nP1,a,1,2\n",
             "<document></document>"]
)  # fmt: skip
def test_a_file_of_another_program_is_not_touched(tmp_path: Path, text: str) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=r"cannot be edited here.*\[control\] marks"):
        put(path, "P1", "a", (1.0, 2.0))
    assert path.read_text() == text


@pytest.mark.parametrize("name", ["", "a\nb,c.jpg,1,2", "\x00", " P1", "P1 "])
def test_a_name_that_the_file_would_not_give_back_is_refused(marks: Path, name: str) -> None:
    with pytest.raises(InputError, match="no name of a point"):
        put(marks, name, "a", (1.0, 2.0))
    assert marks.read_text() == TEXT


def test_names_with_commas_and_quotes_come_back(marks: Path) -> None:
    name = 'a "b", <c>'
    put(marks, name, "a", (1.0, 2.0))
    lines = put(marks, name, "a", (3.0, 4.0))
    assert len(lines) == len(TEXT.splitlines()) + 1
    assert lines[-1] == '"a ""b"", <c>",a.jpg,3.000,4.000,0.50,'


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="does not exist"):
        put(tmp_path / "no" / "marks.csv", "P1", "a", (1.0, 2.0))


@pytest.mark.parametrize(
    ("text", "found"), [(TEXT, True), ("name,photo,u,v\n", False), ("", False)]
)
def test_whether_there_are_marks(tmp_path: Path, text: str, found: bool) -> None:
    path = tmp_path / "marks.csv"
    assert not has_rows(path)
    path.write_text(text)
    assert has_rows(path) is found


SETTINGS = """[photos]
# marks =   # not this one

[control]
file = "control/control.csv"
# marks =                      # Their pixels in the photos (marks.csv), if apart
# crs =

[logs]
"""


def test_the_file_of_marks_is_named_where_the_comment_waits_for_it(tmp_path: Path) -> None:
    path = tmp_path / "project.toml"
    path.write_text(SETTINGS)
    assert name_mark_file(path, "control/marks.csv")
    lines = path.read_text().splitlines()
    assert lines[5].startswith('marks = "control/marks.csv"')
    assert lines[:5] + lines[6:] == SETTINGS.splitlines()[:5] + SETTINGS.splitlines()[6:]


@pytest.mark.parametrize(
    "text", ["[photos]\n", '[control]\nfile = "c.csv"\n', '[control]\nmarks = "m.csv"\n']
)
def test_settings_without_that_comment_stay_as_they_are(tmp_path: Path, text: str) -> None:
    path = tmp_path / "project.toml"
    path.write_text(text)
    assert not name_mark_file(path, "marks.csv")
    assert path.read_text() == text
