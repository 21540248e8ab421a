"""Metadata beside and inside finished rasters, read back by GDAL."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.transform import Affine
from rio_cogeo.cogeo import cog_validate

from georef_gis.errors import ExportError, InputError
from georef_gis.rasters.aux_metadata import add_tiff_items, aux_path, write_aux_metadata

NASTY = 'RMSE_H = 4.2 (cm) <ok> & "so" – ü;\nsecond line'
ITEMS = {"ACCURACY_STATEMENT_H": NASTY, "ACCURACY_CHECK_POINTS_H": "31"}


@pytest.fixture
def raster(tmp_path: Path) -> Path:
    """A COG of 700 x 600 px with items of its own."""
    path, plain = tmp_path / "mosaic.tif", tmp_path / "plain.tif"
    with rasterio.open(
        plain, "w", driver="GTiff", width=700, height=600, count=1, dtype="uint8",
        crs="EPSG:32617", transform=Affine(0.1, 0, 5e5, 0, -0.1, 4.5e6),
    ) as ds:  # fmt: skip
        ds.write(np.arange(420000, dtype=np.uint32).reshape(1, 600, 700).astype(np.uint8))
        ds.update_tags(TITLE="Site & <road>", ACCURACY_OLD="gone after the next")
        ds.set_band_description(1, "grey & white")
    rasterio.shutil.copy(plain, path, driver="COG", compress="deflate", blocksize=256)
    return path


def tags(path: Path) -> dict[str, str]:
    with rasterio.open(path) as ds:
        return dict(ds.tags())


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_gdal_reads_what_stands_beside_together_with_what_stands_inside(raster: Path) -> None:
    before = digest(raster)
    assert write_aux_metadata(raster, ITEMS) == aux_path(raster)
    found = tags(raster)
    assert found["ACCURACY_STATEMENT_H"] == NASTY
    assert found["ACCURACY_CHECK_POINTS_H"] == "31"
    assert found["TITLE"] == "Site & <road>"
    assert digest(raster) == before


def test_what_others_wrote_beside_stays_and_an_older_statement_goes(raster: Path) -> None:
    aux_path(raster).write_text(
        '<PAMDataset><Metadata domain="X"><MDI key="ACCURACY_A">theirs</MDI></Metadata>'
        '<Metadata><MDI key="ACCURACY_B">old</MDI><MDI key="PLACE">Ohio</MDI></Metadata>'
        '<PAMRasterBand band="1"><Description>red</Description></PAMRasterBand></PAMDataset>'
    )
    write_aux_metadata(raster, ITEMS, family="ACCURACY_")
    with rasterio.open(raster) as ds:
        assert ds.tags(ns="X") == {"ACCURACY_A": "theirs"}
        assert ds.tags()["PLACE"] == "Ohio"
        assert "ACCURACY_B" not in ds.tags()
        assert ds.tags()["ACCURACY_STATEMENT_H"] == NASTY
        assert ds.descriptions == ("red",)
    write_aux_metadata(raster, {}, family="ACCURACY_")
    assert "ACCURACY_STATEMENT_H" not in tags(raster)
    assert tags(raster)["PLACE"] == "Ohio"


def test_nothing_to_say_leaves_no_file(raster: Path) -> None:
    write_aux_metadata(raster, ITEMS)
    write_aux_metadata(raster, {}, family="ACCURACY_")
    assert not aux_path(raster).exists()


def test_a_folder_that_takes_no_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="gone"):
        write_aux_metadata(tmp_path / "gone" / "m.tif", ITEMS)


def test_items_in_the_tags_keep_a_cog_a_cog(raster: Path) -> None:
    with rasterio.open(raster) as ds:
        pixels = ds.read()
    assert add_tiff_items(raster, ITEMS, family="ACCURACY_")
    with rasterio.open(raster) as ds:
        assert ds.tags()["ACCURACY_STATEMENT_H"] == NASTY
        assert ds.tags()["TITLE"] == "Site & <road>"
        assert "ACCURACY_OLD" not in ds.tags()
        assert ds.descriptions == ("grey & white",)
        assert np.array_equal(ds.read(), pixels)
    valid, errors, _ = cog_validate(raster, quiet=True)
    assert valid, errors
    # again: the text behind the end is replaced, not doubled
    assert add_tiff_items(raster, {"ACCURACY_STATEMENT_H": "new"}, family="ACCURACY_")
    assert tags(raster)["ACCURACY_STATEMENT_H"] == "new"
    assert "ACCURACY_CHECK_POINTS_H" not in tags(raster)


def test_a_tiff_without_such_metadata_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "bare.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=16, height=16, count=1, dtype="uint8",
        transform=Affine(0.1, 0, 5e5, 0, -0.1, 4.5e6),
    ) as ds:  # fmt: skip
        ds.write(np.ones((1, 16, 16), np.uint8))
    before = digest(path)
    assert not add_tiff_items(path, ITEMS)
    assert digest(path) == before
    (tmp_path / "no.tif").write_bytes(b"no tiff at all, nothing like it")
    with pytest.raises(InputError, match="no valid TIFF header"):
        add_tiff_items(tmp_path / "no.tif", ITEMS)
