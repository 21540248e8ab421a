"""What is said of several points is one line that calls them points."""

from __future__ import annotations

from georef_gis.app.grouping import grouped
from processing_algorithms.measure.told_points import points_told


def test_points_are_called_points_on_the_terminal_too() -> None:
    lines = points_told(
        [(f"C{k:02d}", f"not matched: unlike (correlation 0.{60 + k})") for k in range(1, 8)]
    )
    told = "7 points (C01, C02, C03 and 4 more): not matched: unlike (correlation 0.61 to 0.67)"
    assert lines == [told]
    assert grouped(lines) == [told]


def test_other_words_are_other_lines_and_stay_apart_on_the_terminal() -> None:
    said = [("A", "no texture"), ("B", "an edge alone"), ("C", "no texture"), ("A", "2 px off")]
    lines = points_told(said)
    assert lines == ["2 points (A, C): no texture", "B: an edge alone", "A: 2 px off"]
    assert grouped(lines) == lines


def test_points_that_are_numbered_are_not_taken_for_figures() -> None:
    lines = points_told([("1", "seen in 3 photos"), ("2", "seen in 4 photos")])
    assert lines == ["2 points (1, 2): seen in 3 to 4 photos"]
    assert grouped(lines) == lines
