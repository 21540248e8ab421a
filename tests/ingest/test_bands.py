"""Bands, alpha channels and types of photos, as the tags of their files state them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from georef_gis.ingest.bands import alpha_count, band_count, band_type
from georef_gis.ingest.photos import read_photo

RGB: dict[str, Any] = {"photometric": "rgb"}
GREY: dict[str, Any] = {"photometric": "minisblack", "planarconfig": "contig"}
FILES: dict[str, tuple[str, int, dict[str, Any], tuple[int, int, str]]] = {
    # type and samples of the file; bands, alpha channels and type that it states
    "RGB": ("uint8", 3, RGB, (3, 0, "uint8")),
    "RGBA": ("uint8", 4, RGB | {"extrasamples": ["unassalpha"]}, (3, 1, "uint8")),
    "RGBA, multiplied": ("uint16", 4, RGB | {"extrasamples": ["assocalpha"]}, (3, 1, "uint16")),
    "RGB and NIR": ("uint8", 4, RGB | {"extrasamples": ["unspecified"]}, (4, 0, "uint8")),
    "four bands": ("uint16", 4, GREY, (4, 0, "uint16")),
    "five bands and alpha": (
        "uint16", 6, GREY | {"extrasamples": [*["unspecified"] * 4, "unassalpha"]},
        (5, 1, "uint16"),
    ),
    "grey": ("uint8", 1, {"photometric": "minisblack"}, (1, 0, "uint8")),
    "grey and alpha": ("uint8", 2, GREY | {"extrasamples": ["unassalpha"]}, (1, 1, "uint8")),
    "signed": ("int16", 3, RGB, (3, 0, "int16")),
    "float": ("float32", 3, RGB, (3, 0, "float32")),
    "long": ("uint32", 3, RGB, (3, 0, "uint32")),
    "many": ("float32", 14, GREY, (14, 0, "float32")),
}  # fmt: skip


@pytest.mark.parametrize(("dtype", "samples", "options", "want"), FILES.values(), ids=FILES)
def test_bands_of_a_tiff(
    tmp_path: Path, dtype: str, samples: int, options: dict[str, Any], want: tuple[int, int, str]
) -> None:
    shape = (20, 30, samples) if samples > 1 else (20, 30)
    tifffile.imwrite(tmp_path / "a.tif", np.zeros(shape, dtype), **options)
    photo = read_photo(tmp_path / "a.tif")
    assert (photo.bands, alpha_count(photo.tags), band_type(photo.tags)) == want


@pytest.mark.parametrize(("mode", "bands"), [("RGB", 3), ("L", 1)])
def test_a_jpeg_has_eight_bits_and_no_alpha(tmp_path: Path, mode: str, bands: int) -> None:
    """Whatever the tags say that a program copied from a TIFF."""
    exif = Image.Exif()
    exif[0x0102], exif[0x0115], exif[0x0152], exif[0x0153] = 16, 4, 2, 3
    Image.new(mode, (40, 30)).save(tmp_path / "a.jpg", exif=exif)
    photo = read_photo(tmp_path / "a.jpg")
    assert photo.tags["EXIF:ExtraSamples"] == 2.0
    assert (photo.bands, alpha_count(photo.tags), band_type(photo.tags)) == (bands, 0, "uint8")


def test_without_tags_a_photo_has_three_bands_of_eight_bits() -> None:
    assert (band_count({}), alpha_count({}), band_type({})) == (3, 0, "uint8")
