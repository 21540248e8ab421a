"""COG: a copy byte by byte, or another compression of the same pixels."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rio_cogeo.cogeo import cog_validate
from site_cases import make_frame, write_mosaic

from exports.tiles.cog import write_cog
from georef_gis.errors import ExportError


@pytest.fixture(scope="module")
def mosaic(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cog")
    return write_mosaic(folder / "mosaic.tif", make_frame("EPSG:6549"), width=700, height=600)


def test_keep_is_a_copy(mosaic, tmp_path):
    report = write_cog(mosaic, tmp_path / "c.tif")
    assert (tmp_path / "c.tif").read_bytes() == mosaic.read_bytes()
    assert (report.crs, report.height_kind) == ("EPSG:6549", "none")


@pytest.mark.parametrize("compression", ["jpeg", "webp", "deflate", "zstd", "lzw"])
def test_another_compression_of_the_same_picture(mosaic, tmp_path, compression):
    target = tmp_path / "c.tif"
    write_cog(mosaic, target, compression, 90)
    assert cog_validate(target, quiet=True)[0]
    with rasterio.open(mosaic) as before, rasterio.open(target) as after:
        assert after.crs == before.crs
        assert after.transform == before.transform
        a, b = before.read([1, 2, 3]).astype(int), after.read([1, 2, 3]).astype(int)
        valid = before.dataset_mask() > 0
        assert (after.dataset_mask() > 0)[valid].mean() > 0.99
    difference = np.abs(a - b)[:, valid]
    # Colour of 6 px dots is halved in resolution by the lossy ones.
    assert difference.mean() < (4.0 if compression in ("jpeg", "webp") else 1e-9)


def test_plain_tiff_becomes_a_cog(tmp_path):
    path = tmp_path / "plain.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=600, height=600, count=1, dtype="float32",
        crs="EPSG:32617", transform=rasterio.Affine(1, 0, 3e5, 0, -1, 4e6), compress="deflate",
    ) as ds:  # fmt: skip
        ds.write(np.arange(360000, dtype=np.float32).reshape(1, 600, 600))
    write_cog(path, tmp_path / "c.tif")
    assert cog_validate(tmp_path / "c.tif", quiet=True)[0]
    with pytest.raises(ExportError, match="use deflate or zstd"):
        write_cog(path, tmp_path / "d.tif", "jpeg")
