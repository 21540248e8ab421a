"""Photos read without their alpha channel; bands that are none stay."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image
from raster_cases import smooth

from georef_gis.rasters.reading import decode_image, read_image

# options of the file, bands of four that are read without alpha
KINDS: dict[str, tuple[dict[str, Any], list[int]]] = {
    "alpha": ({"photometric": "rgb", "extrasamples": ["unassalpha"]}, [0, 1, 2]),
    "alpha, multiplied": ({"photometric": "rgb", "extrasamples": ["assocalpha"]}, [0, 1, 2]),
    "alpha of three bands": (
        {"photometric": "minisblack", "extrasamples": ["unspecified", "unspecified", "unassalpha"],
         "planarconfig": "contig"}, [0, 1, 2],
    ),
    "NIR": ({"photometric": "rgb", "extrasamples": ["unspecified"]}, [0, 1, 2, 3]),
    "four bands": ({"photometric": "minisblack", "planarconfig": "contig"}, [0, 1, 2, 3]),
    "planes": ({"photometric": "rgb", "extrasamples": ["unassalpha"],
                "planarconfig": "separate"}, [0, 1, 2]),
}  # fmt: skip


@pytest.mark.parametrize(("options", "bands"), KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("reduce", [1, 4])
def test_a_tiff_without_its_alpha_channel(
    tmp_path: Path, options: dict[str, Any], bands: list[int], dtype: str, reduce: int
) -> None:
    data = smooth(40, 50, 4, dtype)
    planes = options.get("planarconfig") == "separate"
    tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(data, -1, 0) if planes else data, **options)
    whole = read_image(tmp_path / "a.tif", reduce=reduce)
    assert whole.shape[2] == 4
    found = read_image(tmp_path / "a.tif", reduce=reduce, alpha=False)
    np.testing.assert_array_equal(found, whole[..., bands])
    raw = (tmp_path / "a.tif").read_bytes()
    np.testing.assert_array_equal(decode_image(raw, "a", reduce=reduce, alpha=False), found)


@pytest.mark.parametrize("mode", ["RGBA", "RGB", "L"])
def test_a_png_without_its_alpha_channel(tmp_path: Path, mode: str) -> None:
    image = Image.fromarray(smooth(40, 50, 3)).convert(mode)
    image.save(tmp_path / "a.png")
    want = np.asarray(image).reshape(40, 50, -1)[..., :3]
    for reduce in (1, 2):
        found = read_image(tmp_path / "a.png", reduce=reduce, alpha=False)
        assert found.shape == (40 // reduce, 50 // reduce, want.shape[2])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", alpha=False), want)


def test_a_jpeg_is_read_as_ever(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.fromarray(smooth(40, 50, 3)).save(file, "JPEG")
    raw = file.getvalue()
    np.testing.assert_array_equal(decode_image(raw, "a", alpha=False), decode_image(raw, "a"))
