"""What a mark says beside its pixel: its sigma, what it shares, whether it lies on the ground."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from asset_cases import cone, sql, store_at

from georef_gis.ingest.control_tables import marks_of
from georef_gis.ingest.tables import read_lines
from georef_gis.measure.assets.asset import Click, Quality
from georef_gis.model.control import SIGMA_CLICKED, Mark
from georef_gis.toolbox.context import CollectingFeedback
from georef_gis.toolbox.registry import load_registry
from processing_algorithms.measure.mark_file import set_mark
from processing_algorithms.measure.marks import CLICK, on_ground, read_mark_table

TABLE = """name,photo,u,v,sigma_px,shared_px,ground
A,one.jpg,1,2,0.2,0.5,on
A,two.jpg,3,4,,,
B,one.jpg,5,6,0.7,0,free
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "marks.csv"
    path.write_text(text)
    return path


def test_a_click_is_as_good_in_the_page_as_on_the_command_line() -> None:
    assert CLICK == SIGMA_CLICKED == Mark(name="", photo="", u=0.0, v=0.0).sigma_px
    told = {
        (tool.id, spec.default)
        for tool in load_registry()
        for spec in tool.algorithm.Parameters.specs()
        # a forecast does not know who will click
        if spec.name == "click" and tool.id != "plan_flight"
    }
    assert len(told) > 6
    # a tool that states none takes the table's, else the same
    assert {default for _, default in told} == {None, CLICK}


def test_marks_say_what_they_share_and_whether_they_lie_on_the_ground(tmp_path: Path) -> None:
    marks, doubts = marks_of(read_lines(written(tmp_path, TABLE)), (), None)
    assert doubts == []
    assert [m.shared_px for m in marks] == [0.5, 0.0, 0.0]
    assert [m.sigma_px for m in marks] == [0.2, SIGMA_CLICKED, 0.7]
    assert [m.on_ground for m in marks] == [True, False, False]
    assert marks[0].whole_px == pytest.approx(math.hypot(0.2, 0.5))


@pytest.mark.parametrize(
    "text",
    ["name,photo,u,v\nA,one.jpg,1,2\n", "one.jpg A 1.5 2.5\n", "one.jpg,A,1.5,2.5,0.5\n"],
    ids=["four columns", "without a header", "with a sigma"],
)
def test_tables_without_these_columns_are_read_as_ever(tmp_path: Path, text: str) -> None:
    (mark,), doubts = marks_of(read_lines(written(tmp_path, text)), (), None)
    assert doubts == []
    assert (mark.u, mark.v, mark.sigma_px) == (1.0, 2.0, SIGMA_CLICKED)
    assert (mark.shared_px, mark.on_ground) == (0.0, False)


@pytest.mark.parametrize(
    ("cell", "word"), [("0.5,up", "'up' is neither on nor free"), ("-1,on", "standard deviation")]
)
def test_a_slip_in_these_columns_is_one_line_and_that_mark_is_left_out(
    tmp_path: Path, cell: str, word: str
) -> None:
    text = TABLE.replace("0.5,on", cell)
    marks, (line,) = marks_of(read_lines(written(tmp_path, text)), (), None)
    assert len(marks) == 2
    assert "marks.csv, line 2" in line
    assert word in line


def test_the_clicks_sigma_of_matched_marks_is_what_they_share(tmp_path: Path) -> None:
    marks = read_mark_table(written(tmp_path, TABLE), CollectingFeedback(), sigma_px=2.0)
    assert [(m.sigma_px, m.shared_px) for m in marks] == [(0.2, 2.0), (2.0, 0.0), (2.0, 0.0)]


def test_what_is_said_of_all_marks_wins_over_the_table(tmp_path: Path) -> None:
    marks = read_mark_table(written(tmp_path, TABLE), CollectingFeedback())
    for word, wanted in ((None, [True, False, False]), ("on", [True] * 3), ("free", [False] * 3)):
        assert [m.on_ground for m in on_ground(marks, word)] == wanted


def test_who_takes_marks_as_independent_counts_what_they_share_as_often() -> None:
    mark = Mark(name="A", photo="one", u=0.0, v=0.0, sigma_px=0.3, shared_px=0.5)
    assert mark.kept_px(4) == pytest.approx(math.hypot(0.3, 1.0))
    assert replace(mark, shared_px=0.0).kept_px(4) == 0.3


def test_a_mark_that_is_set_by_hand_shares_nothing_any_more(tmp_path: Path) -> None:
    path = written(tmp_path, TABLE)
    set_mark(
        path, "A", "one.jpg", (7.0, 8.0), sigma_px=0.5, is_photo=lambda name: name == "one.jpg"
    )
    marks, _ = marks_of(read_lines(path), (), None)
    assert (marks[0].u, marks[0].sigma_px, marks[0].shared_px) == (7.0, 0.5, 0.0)
    assert [m.name for m in marks] == ["A", "A", "B"]


def test_stored_clicks_keep_what_they_share_and_old_ones_are_read(tmp_path: Path) -> None:
    clicks = (
        Click(photo_id="one", u=1.0, v=2.0, sigma_px=0.2, shared_px=0.5, on_ground=True),
        Click(photo_id="two", u=3.0, v=4.0, sigma_px=0.5),
    )
    with store_at(tmp_path) as store:
        store.add(replace(cone(), quality=Quality(method="intersect_ground", clicks=clicks)))
    with store_at(tmp_path) as store:
        (asset,) = store.assets()
    assert asset.quality is not None
    assert asset.quality.clicks == clicks
    assert asset.quality.method == "intersect_ground"
    ((pixels,),) = sql(tmp_path, "SELECT pixels FROM asset_points")
    # what needs nothing new is written as it always was
    assert json.loads(pixels)[1] == ["two", 3.0, 4.0, 0, 0.5]
