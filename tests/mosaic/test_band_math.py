"""Formulas of bands: by hand values, and every way to write one wrongly."""

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.mosaic.band_math import INDICES, Expression, find_bands, plain_name

# fractions of white
BANDS = {
    "nir": np.array([0.6, 0.0, 1.0]),
    "red": np.array([0.2, 0.0, 1.0]),
    "green": np.array([0.3, 0.0, 1.0]),
    "blue": np.array([0.1, 0.0, 1.0]),
}


@pytest.mark.parametrize(
    ("name", "first", "last"),
    [
        ("ndvi", 0.4 / 0.8, 0.0),
        ("gndvi", 0.3 / 0.9, 0.0),
        ("blue-ndvi", 0.5 / 0.7, 0.0),
        ("savi", 1.5 * 0.4 / 1.3, 0.0),
        ("ndwi", -0.3 / 0.9, 0.0),
        ("exg", 0.3 / 0.6, 0.0),
    ],
)
def test_index_has_its_hand_value(name: str, first: float, last: float) -> None:
    values = Expression(INDICES[name].expression).evaluate(BANDS)
    # rounding of float64
    np.testing.assert_allclose(values[[0, 2]], [first, last], atol=1e-12)


@pytest.mark.parametrize("name", [name for name in INDICES if name != "savi"])
def test_black_pixel_has_no_index(name: str) -> None:
    assert np.isnan(Expression(INDICES[name].expression).evaluate(BANDS)[1])


def test_savi_of_a_black_pixel_is_zero() -> None:
    assert Expression(INDICES["savi"].expression).evaluate(BANDS)[1] == 0.0


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + b * 3", 17.0),
        ("(a + b) * 3", 21.0),
        ("a - b - 1", -4.0),
        ("12 / a / 3", 2.0),
        ("12 / (a / 3)", 18.0),
        ("-a * b", -10.0),
        ("b - -a", 7.0),
        ("b * -a + 1", -9.0),
        ("--a", 2.0),
        ("+a", 2.0),
        ("A*1.5e1", 30.0),
        ("a * .5 + 2.", 3.0),
        ("2 * a * b - 3 * (b - a) / a", 15.5),
        ("a - b + a * b / a", 2.0),
    ],
)
def test_operators_bind_as_in_school(text: str, value: float) -> None:
    bands = {"a": np.array([2.0]), "b": np.array([5.0])}
    assert Expression(text).evaluate(bands).tolist() == [value]


def test_names_come_once_in_the_order_of_use() -> None:
    assert Expression("(NIR - other.Red) / (nir + other.red) + b_2").names == (
        "nir", "other.red", "b_2",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the end"),
        ("nir -", "at character 6 stands the end"),
        ("(nir - red", "give an operator or )"),
        ("nir red", "at character 5 stands 'red'; give an operator"),
        ("nir)", "at character 4 stands ')'"),
        ("2nir", "at character 2 stands 'nir'"),
        ("nir ** 2", "at character 6 stands '*'"),
        ("nir ^ 2", "at character 5 stands '^'"),
        ("__import__(os)", "stands '('"),
        ("nir.a.b", "stands '.'"),
        ("nir[0]", "stands '['"),
        ("1 + 1", "names no band"),
        ("(" * 60 + "nir" + ")" * 60, "nests deeper than 50"),
        ("-" * 60 + "nir", "nests deeper than 50"),
        ("nir+" * 1000 + "nir", "4003 characters are too many"),
    ],
)
def test_what_is_no_formula_is_refused_in_one_line(text: str, told: str) -> None:
    with pytest.raises(InputError, match=r"^expression: ") as caught:
        Expression(text)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_long_chain_is_no_nest() -> None:
    text = " + ".join(["nir"] * 300)
    assert Expression(text).evaluate({"nir": np.array([2.0])}).tolist() == [600.0]


def test_unknown_band_is_told_with_its_neighbours() -> None:
    with pytest.raises(InputError, match=r"no band 'nirr'; use nir$"):
        find_bands(["red", "nirr"], ["red", "nir", "b1"])
    with pytest.raises(InputError, match=r"no band 'swir2'; use red, green$"):
        find_bands(["swir2"], ["red", "green"])


def test_overflow_has_no_value() -> None:
    values = Expression("a * 1e300 * 1e300").evaluate({"a": np.array([1.0, 0.0])})
    np.testing.assert_array_equal(values, [np.nan, 0.0])


@pytest.mark.parametrize(
    ("given", "name"), [("Band 4", "band_4"), ("NIR (850 nm)", "nir_850_nm"), ("5", "_5")]
)
def test_description_becomes_a_name(given: str, name: str) -> None:
    assert plain_name(given) == name
    assert Expression(name).names == (name,)
