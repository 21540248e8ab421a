"""The figures of the manual, as its own tables have them."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from georef_gis.errors import InputError
from georef_gis.measure.workzone.rules import Rules, editions, load_rules
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

# Taper lengths for an offset of 12 ft, ft: California MUTCD 2014, Table 6H-4(CA).
PRINTED = {
    20: (80, 40, 27), 25: (125, 63, 42), 30: (180, 90, 60), 35: (245, 123, 82), 40: (320, 160, 107),
    45: (540, 270, 180), 50: (600, 300, 200), 55: (660, 330, 220), 60: (720, 360, 240),
    65: (780, 390, 260), 70: (840, 420, 280), 75: (900, 450, 300),
}  # fmt: skip


@pytest.fixture(scope="module")
def rules() -> Rules:
    return load_rules()


@pytest.mark.parametrize("speed", PRINTED)
def test_taper_lengths_are_those_of_the_printed_table(rules: Rules, speed: int) -> None:
    for kind, printed in zip(("merging", "shifting", "shoulder"), PRINTED[speed], strict=True):
        required = rules.taper_length(kind, speed)
        length = (required.low + required.per_offset * 12 * FOOT) / FOOT
        # the table is rounded to a foot
        assert length == pytest.approx(printed, abs=0.51), kind
        assert "6C-4" in required.source


@pytest.mark.parametrize("kind", ["downstream", "one_lane_two_way"])
def test_short_tapers_have_fixed_lengths_and_a_spacing_of_their_own(
    rules: Rules, kind: str
) -> None:
    required = rules.taper_length(kind, 55)
    assert (required.low / FOOT, required.high / FOOT) == pytest.approx((50, 100))
    assert required.per_offset == 0.0
    assert rules.taper_spacing(kind, 55).high / FOOT == pytest.approx(25)


def test_spacing_is_once_the_speed_in_tapers_and_twice_on_tangents(rules: Rules) -> None:
    assert rules.taper_spacing("merging", 55).high / FOOT == pytest.approx(55)
    assert rules.tangent_spacing(55).high / FOOT == pytest.approx(110)


@pytest.mark.parametrize(
    ("road", "feet"),
    [
        ("urban_low", (100, 100, 100)),
        ("urban_high", (350, 350, 350)),
        ("rural", (500, 500, 500)),
        ("freeway", (1000, 1500, 2640)),
    ],
)
def test_sign_spacings_are_those_of_the_table(
    rules: Rules, road: str, feet: tuple[int, ...]
) -> None:
    assert [r.low / FOOT for r in rules.sign_spacing(road)] == pytest.approx(feet)


@pytest.mark.parametrize("speed", [40.5, 42, 44.9])
def test_speed_between_the_two_formulas_is_refused(rules: Rules, speed: float) -> None:
    with pytest.raises(
        InputError, match="0 to 40 mph, 45 mph and more; give the speed it is posted"
    ):
        rules.taper_length("merging", speed)


def test_unknown_words_are_refused_with_the_known_ones(rules: Rules) -> None:
    with pytest.raises(InputError, match="use one of merging, shifting"):
        rules.taper_length("sideways", 55)
    with pytest.raises(InputError, match="use one of urban_low"):
        rules.sign_spacing("lane")


def test_agency_gives_its_own_figures_in_a_file(tmp_path: Path) -> None:
    own = resources.files("georef_gis.data").joinpath("mutcd_2009.toml").read_text()
    (tmp_path / "ours.toml").write_text(own.replace("min_ft = 10.0", "min_ft = 11.0"))
    rules = load_rules("ours.toml", folder=tmp_path)
    assert rules.lane.low / FOOT == pytest.approx(11)
    assert load_rules().lane.low / FOOT == pytest.approx(10)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[lane]\nmin_ft = 10.0", "[lane]", "lacks 'min_ft'"),
        ("min_ft = 10.0", "min_ft = -1", "must be positive"),
        ("[edition]", "[edition", "is not TOML"),
        ("min_ft = 10.0", "min_ft = 'ten'", "does not fit"),
    ],
)
def test_broken_file_is_refused_in_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    own = resources.files("georef_gis.data").joinpath("mutcd_2009.toml").read_text()
    (tmp_path / "ours.toml").write_text(own.replace(old, new))
    with pytest.raises(InputError) as refused:
        load_rules("ours.toml", folder=tmp_path)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_unknown_edition_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    assert "2009" in editions()
    for name in ("1999", "../2009", "none.toml"):
        with pytest.raises(InputError, match="neither an edition"):
            load_rules(name, folder=tmp_path)
