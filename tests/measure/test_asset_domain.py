"""Classes of assets and their attributes: what comes with the package, what a project changes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.measure.assets.domain import (
    CLASSES_FILE,
    LONGEST_TEXT,
    Attribute,
    Domain,
    load_domain,
)

OWN = """
[attributes.owner]
title = "Owner"
type = "choice"
choices = ["district", "contractor"]

[classes.cone]
title = "Traffic cone"
geometry = "point"
group = "channelizing device"
attributes = ["line", "owner"]
required = ["owner"]

[classes.delineator]
title = "Delineator"
geometry = "point"
attributes = ["order"]

[classes.flagger]
remove = true
"""


@pytest.fixture(scope="module")
def domain() -> Domain:
    return load_domain()


def test_work_zone_classes_are_there_with_their_geometry(domain: Domain) -> None:
    wanted = {
        "cone": "point", "drum": "point", "tubular_marker": "point", "vertical_panel": "point",
        "barricade_1": "point", "barricade_2": "point", "barricade_3": "point",
        "longitudinal_device": "line", "temporary_barrier": "line", "crash_cushion": "point",
        "arrow_board": "point", "message_sign": "point", "sign": "point", "flagger": "point",
        "shadow_vehicle": "point", "temporary_signal": "point", "marking": "line",
        "lane_edge": "line", "work_area": "polygon", "buffer": "polygon", "taper_line": "line",
    }  # fmt: skip
    assert wanted.items() <= {name: c.geometry for name, c in domain.classes.items()}.items()


def test_devices_of_a_row_have_a_line_and_an_order(domain: Domain) -> None:
    for name in domain.in_group("channelizing device"):
        assert {"line", "order"} <= {a.name for a in domain.find(name).attributes}, name


@pytest.mark.parametrize(
    ("kind", "given", "read"),
    [
        ("cone", {"line": "T1", "order": "3"}, {"line": "T1", "order": 3}),
        ("cone", {"height_in": "28"}, {"height_in": 28.0}),
        ("cone", {"upright": "yes"}, {"upright": True}),
        ("cone", {"upright": False, "line": "", "order": None}, {"upright": False}),
        ("arrow_board", {"arrow_mode": "left"}, {"arrow_mode": "left"}),
    ],
)
def test_values_are_read_in_their_types(
    domain: Domain, kind: str, given: dict[str, object], read: dict[str, object]
) -> None:
    assert domain.find(kind).read(given) == read


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        ("cone", {"order": "3.5"}, "cone: order: '3.5' is no whole number"),
        ("cone", {"order": 0}, "0 is less than 1"),
        ("cone", {"height_in": "tall"}, "height_in: 'tall' is no number"),
        ("cone", {"height_in": "nan"}, "is no number"),
        ("cone", {"height_in": 1e9}, "1e+09 in is more than 240 in"),
        ("cone", {"order": True}, "is no whole number"),
        ("cone", {"upright": "maybe"}, "'maybe' is not yes or no"),
        ("cone", {"condition": "broken"}, "use one of acceptable, marginal, unacceptable"),
        ("cone", {"lyne": "T1"}, "did you mean 'line'?"),
        ("cone", {"line": "a\0b"}, "control character U+0000"),
        ("cone", {"line": "x" * (LONGEST_TEXT + 1)}, "shorten it"),
        ("sign", {}, "sign: mutcd_code: is missing"),
    ],
)
def test_unfit_value_is_refused_in_one_line(
    domain: Domain, kind: str, given: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError) as refused:
        domain.find(kind).read(given)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_date_is_read_as_iso() -> None:
    attribute = Attribute(name="since", title="Since", type="date")
    assert attribute.read("2026-03-31") == "2026-03-31"
    with pytest.raises(ValueError, match="write 2026-03-31"):
        attribute.read("31.3.2026")


def test_unknown_class_names_the_nearest(domain: Domain) -> None:
    with pytest.raises(InputError, match="did you mean 'cone'"):
        domain.find("cones")


def test_project_extends_overrides_and_removes(tmp_path: Path) -> None:
    (tmp_path / CLASSES_FILE).write_text(OWN)
    domain = load_domain(tmp_path)
    assert domain.find("cone").title == "Traffic cone"
    assert domain.find("cone").read({"owner": "district"}) == {"owner": "district"}
    with pytest.raises(InputError, match="owner: is missing"):
        domain.find("cone").read({"line": "T1"})
    assert domain.find("delineator").geometry == "point"
    assert "flagger" not in domain.classes
    assert domain.find("drum").attributes == load_domain().find("drum").attributes


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[classes.x]\ngeometry = 'blob'", "geometry 'blob' is none; use one of point"),
        ("[classes.x]\ngeometry = 'point'\nattributes = ['lin']", "did you mean 'line'?"),
        ("[classes.x]\ngeometry = 'point'\nrequired = ['line']", "add it there"),
        ("[classes.x]\ngeometri = 'point'", "did you mean 'geometry'?"),
        ("[classes.'a b']\ngeometry = 'point'", "a name is letters"),
        ("[classes.x]\nremove = true", "cannot be removed"),
        ("[attributes.x]\ntype = 'real'", "use one of text, integer"),
        ("[attributes.x]\nchoices = ['a']", 'choices go with type = "choice"'),
        ("[attributes.x]\ntype = 'number'\nmin = 'low'", "min 'low' is no number"),
        ("[kinds.x]", "[kinds] is no table"),
        ("classes = 3", "a name is letters"),
        ("[classes.x", "is not TOML"),
    ],
)
def test_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / CLASSES_FILE).write_text(text)
    with pytest.raises(InputError) as refused:
        load_domain(tmp_path)
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / CLASSES_FILE))
    assert "\n" not in str(refused.value)


def test_classes_as_json_make_a_form(domain: Domain) -> None:
    told = {one["name"]: one for one in json.loads(json.dumps(domain.as_json()))}
    sign = {a["name"]: a for a in told["sign"]["attributes"]}
    assert sign["mutcd_code"]["required"] is True
    assert any(code.startswith("W20-1") for code in sign["mutcd_code"]["suggestions"])
    assert sign["condition"]["choices"] == ["acceptable", "marginal", "unacceptable"]
