from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from raster_cases import make_profile, smooth

from georef_gis.errors import InputError


@pytest.mark.parametrize(
    ("bands", "dtype", "changes", "words"),
    [
        (4, "uint8", {}, ["JPEG", "4 of uint8", "deflate"]),
        (3, "uint16", {}, ["JPEG", "3 of uint16", "deflate"]),
        (1, "uint8", {"compression": "webp"}, ["WEBP", "1 of uint8", "deflate"]),
        (3, "uint8", {"nodata": 0}, ["JPEG", "nodata"]),
        (3, "uint8", {"validity": "alpha"}, ["JPEG", "alpha", "mask"]),
        (1, "float32", {"compression": "zstd", "validity": "alpha"}, ["alpha", "float32"]),
        (4, "uint8", {"compression": "zstd", "validity": "alpha"}, ["alpha", "4 of uint8", "mask"]),
        (1, "float64", {"compression": "zstd"}, ["float64", "float32"]),
        (3, "uint8", {"compression": "lzw"}, ["lzw", "deflate"]),
        (3, "uint8", {"quality": 0}, ["quality 0"]),
        (3, "uint8", {"compression": "deflate", "level": 12}, ["level 12"]),
    ],
)
def test_what_a_format_cannot_hold_is_refused(
    bands: int, dtype: str, changes: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        make_profile(np.zeros((10, 10, bands), dtype), **changes)
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 0},
        {"tile_size": 100},
        {"transform": (1.0, 0.1, 0.0, 0.0, -1.0, 0.0)},
        {"transform": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)},
        {"transform": (float("nan"), 0.0, 0.0, 0.0, -1.0, 0.0)},
        {"band_descriptions": ("red",)},
    ],
    ids=["empty", "tile", "turned", "south-up", "nan", "names"],
)
def test_nonsense_is_a_bug_of_the_caller(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        make_profile(smooth(10, 10, 3), **changes)


def test_a_profile_travels_between_processes() -> None:
    profile = make_profile(smooth(10, 10, 3), metadata={"a": "b"})
    assert pickle.loads(pickle.dumps(profile)) == profile
