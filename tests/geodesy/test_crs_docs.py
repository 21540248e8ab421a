"""docs/crs.md says what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from georef_gis.errors import CrsError
from georef_gis.geodesy import horizontal_crs, map_crs, metres_per_unit, vertical_part
from georef_gis.geodesy.geoids import GEOIDS

TEXT = (Path(__file__).parents[2] / "docs/crs.md").read_text("utf-8")


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table of a chapter, without its head."""
    chapter = TEXT.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in chapter.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


TAKEN = [(what, text.split("`")[1]) for what, text in rows("What to write")]
REFUSED = [text.strip("`") for text, _ in rows("What is refused, and why")]


@pytest.mark.parametrize(("what", "text"), [t for t in TAKEN if ":" in t[1]])
def test_what_the_table_tells_to_write_is_taken_in_the_unit_it_says(what: str, text: str) -> None:
    crs = map_crs(text)
    for word, unit in (
        ("Plane, metres", 1.0), ("Plane, US survey feet", 1200 / 3937),
        ("Plane, international feet", 0.3048),
    ):  # fmt: skip
        if word in what:
            assert metres_per_unit(horizontal_crs(crs)) == pytest.approx(unit, abs=1e-15)
    part = vertical_part(crs)
    assert (part is not None) == ("heights" in what)
    for name in re.findall(r"\b(Dane|Allen|zone 2|Baker|Hennepin)\b", what):
        assert name in crs.name


@pytest.mark.parametrize("text", REFUSED)
def test_what_it_says_is_refused_is(text: str) -> None:
    with pytest.raises(CrsError):
        map_crs(text)


def test_the_table_of_heights_is_that_of_the_code() -> None:
    told = {grid for *_, text in rows("Heights") for grid in re.findall(r"[\w]+\.tif", text)}
    code = {grid.name for name in GEOIDS for grid in GEOIDS[name].grids if name != "geoid12b"}
    assert told == code
    for vertical, _, _ in rows("Heights"):
        for number in re.findall(r"`(\d{4})`", vertical):
            part = vertical_part(map_crs(f"EPSG:6549+{number}"))
            assert part is not None
            assert part.code == int(number)
