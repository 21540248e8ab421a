"""The public surface of the package."""

import pytest

import georef_gis


@pytest.mark.parametrize("name", georef_gis.__all__)
def test_public_name_loads(name: str) -> None:
    assert getattr(georef_gis, name) is not None


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="Nonsense"):
        georef_gis.Nonsense  # noqa: B018
