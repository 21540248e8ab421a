"""Sheets along a line, the middle of a flight, and what a diagonal corridor costs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import GeometryError, InputError
from georef_gis.mosaic.sheet_cut import (
    Cover,
    centre_line,
    cut_sheets,
    gap_to,
    join_lines,
    spans,
    trimmed,
    width_over,
)

REACH = 70.0


def test_spans_share_the_overlap_and_end_with_the_line() -> None:
    assert spans(1000.0, 500.0, 0.0) == [(0.0, 500.0), (500.0, 1000.0)]
    assert spans(1000.0, 500.0, 100.0) == [(0.0, 500.0), (400.0, 900.0), (800.0, 1000.0)]
    assert spans(10.0, 500.0, 100.0) == [(0.0, 10.0)]


def test_too_many_sheets_are_refused_with_their_number() -> None:
    with pytest.raises(InputError, match="12500 sheets, more than 10000"):
        spans(12_500.0, 1.0, 0.0)
    with pytest.raises(InputError, match="overlap: is not less"):
        spans(1000.0, 100.0, 100.0)


corners = st.lists(
    st.tuples(st.integers(-300, 300), st.integers(-300, 300)), min_size=2, max_size=7
)


@given(corners, st.floats(20.0, 400.0), st.floats(1.0, 80.0), st.integers(0, 2**31))
def test_no_ground_beside_a_line_is_left_out(
    xy: list[tuple[int, int]], length: float, width: float, seed: int
) -> None:
    line = shapely.linestrings(np.array(xy, dtype=float))
    if line.length == 0.0:
        return
    sheets = list(cut_sheets(line, spans(line.length, length, 0.0), width))
    rng = np.random.default_rng(seed)
    middle = shapely.get_coordinates(
        shapely.line_interpolate_point(line, rng.random(60), normalized=True)
    )
    angle, away = rng.uniform(0, math.tau, 60), 0.49 * width * rng.random(60)
    points = shapely.points(
        middle + away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    )
    along = shapely.line_locate_point(line, points)
    # beyond the ends of the line, which are cut square, there is no sheet; 1e-6: of the border
    points = points[(along > 1e-6) & (along < line.length - 1e-6)]
    nearest = np.min([shapely.distance(sheet.area, points) for sheet in sheets], axis=0)
    np.testing.assert_array_less(nearest, 1e-6)
    rim = 0.5 * width + 1e-6
    assert all(
        (shapely.distance(line, shapely.points(shapely.get_coordinates(s.area))) < rim).all()
        for s in sheets
    )


def test_a_corner_where_two_sheets_meet_leaves_no_wedge() -> None:
    line = shapely.linestrings([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0]])
    sheets = [sheet.area for sheet in cut_sheets(line, spans(200.0, 100.0, 0.0), 40.0)]
    outer = shapely.Point(112.0, -12.0)
    assert [bool(area.contains(outer)) for area in sheets] == [True, True]
    # a straight part holds length times width; the quarter circle of 20 m is polygonal
    assert sheets[0].area == pytest.approx(4000.0 + 100.0 * math.pi, rel=1e-3)


def test_parts_that_meet_make_one_line_in_the_direction_of_the_first() -> None:
    parts = [[[10.0, 0.0], [5.0, 0.0]], [[0.0, 3.0], [5.0, 0.0]], [[10.0, 0.0], [12.0, 0.0]]]
    line = join_lines([shapely.linestrings(p) for p in parts])
    assert list(line.coords) == [(12.0, 0.0), (10.0, 0.0), (5.0, 0.0), (0.0, 3.0)]


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([[[1.0, 1.0], [1.0, 1.0]]], "has no length"),
        ([[[0.0, 0.0], [1.0, 0.0]], [[2.0, 0.0], [3.0, 0.0]]], "2 lines make 2 that do not meet"),
    ],
)
def test_parts_that_make_no_line_are_refused(parts: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        join_lines([shapely.linestrings(p) for p in parts])


def strip(
    line: Any, *, lanes: int, step: float = 30.0, apart: float = 40.0
) -> np.ndarray[Any, Any]:
    """Positions of a flight along a line, to and fro in lanes beside each other."""
    out = []
    for lane in range(lanes):
        side = line.offset_curve(apart * (lane - 0.5 * (lanes - 1)))
        at = np.arange(0.0, side.length, step)
        xy = shapely.get_coordinates(shapely.line_interpolate_point(side, at))
        out.append(xy[::-1] if lane % 2 else xy)
    return np.vstack(out)


def bent(kind: str) -> Any:
    t = np.linspace(0.0, 1.0, 60)
    if kind == "diagonal":
        return shapely.linestrings(np.column_stack([2000.0 * t, 2000.0 * t]))
    if kind == "hairpin":
        return shapely.linestrings(
            np.column_stack([900.0 * np.sin(math.pi * t), -900.0 * np.cos(math.pi * t)])
        )
    return shapely.linestrings(np.column_stack([3000.0 * t, 150.0 * np.sin(9.0 * t)]))


@pytest.mark.parametrize("lanes", [1, 2, 3])
@pytest.mark.parametrize("kind", ["diagonal", "winding", "hairpin"])
def test_the_middle_of_a_flight_follows_its_road(kind: str, lanes: int) -> None:
    road = bent(kind)
    places = strip(road, lanes=lanes)
    line = centre_line(places, REACH, 0)
    along = shapely.get_coordinates(
        shapely.line_interpolate_point(road, np.linspace(0, 1, 50), normalized=True)
    )
    away = shapely.distance(line, shapely.points(along))
    # m; a fifth of what a photo shows across, by which the bends are cut
    assert away.max() < 0.4 * REACH
    # it runs on beyond both ends, from that of the first photo
    assert line.length > road.length
    first = line.project(shapely.Point(places[0]))
    assert 0.0 < first < 0.3 * line.length
    assert centre_line(places, REACH, int(np.argmax(shapely.line_locate_point(
        road, shapely.points(places))))).coords[0] == line.coords[-1]  # fmt: skip


def test_many_photos_at_one_place_cost_no_more() -> None:
    """One hovered over: pairs of photos would be 5 * 10^7."""
    places = np.vstack([np.zeros((10_000, 2)), strip(bent("diagonal"), lanes=1)])
    line = centre_line(places, REACH, 0)
    assert line.coords[0] == pytest.approx((line.coords[0][1],) * 2, abs=REACH)


@pytest.mark.parametrize(
    ("places", "told"),
    [
        (np.array([[0.0, 0.0], [5000.0, 0.0]]), "in 2 groups that do not meet"),
        (np.zeros((3, 2)), "lie in one place"),
    ],
)
def test_photos_without_an_axis_are_refused(places: Any, told: str) -> None:
    with pytest.raises(GeometryError, match=told):
        centre_line(places, REACH, 0)


def test_line_and_width_are_fitted_to_what_is_shown() -> None:
    """A band 300 m long and 60 m wide, from x = 100; the line lies 10 m off its middle."""
    shown = np.zeros((200, 500), bool)
    shown[70:130, 100:400] = True
    cover = Cover(shown=shown, left=0.0, top=200.0, cell=(1.0, 1.0))
    line = trimmed(shapely.linestrings([[-500.0, 110.0], [1000.0, 110.0]]), cover)
    # m; a cell and its half at both ends
    assert line.bounds == pytest.approx((100.0, 110.0, 400.0, 110.0), abs=2.0)
    assert 80.0 <= width_over(line, cover) <= 80.0 + 4.0 * math.sqrt(2.0)
    assert gap_to(line, cover) == 0.0
    assert gap_to(shapely.linestrings([[0.0, 0.0], [500.0, 0.0]]), cover) == pytest.approx(70.5)
