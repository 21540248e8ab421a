from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
import piexif
import pytest
import rasterio
import tifffile
from PIL import Image
from raster_cases import UTM_17N, ellipse, smooth, write

from georef_gis.errors import InputError
from georef_gis.rasters.reading import read_grid, read_grid_header, read_image


def red_corner(rows: int = 48, cols: int = 80) -> np.ndarray:
    """Red in the upper left quarter, black elsewhere."""
    image = np.zeros((rows, cols, 3), np.uint8)
    image[: rows // 2, : cols // 2, 0] = 255
    return image


def jpeg(image: np.ndarray, orientation: int = 1, **options: object) -> bytes:
    """JPEG with EXIF and a preview inside it, as cameras write."""
    preview = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image[::4, ::4])).save(preview, "JPEG")
    exif = {
        "0th": {piexif.ImageIFD.Orientation: orientation},
        "1st": {},
        "thumbnail": preview.getvalue(),
    }
    target = io.BytesIO()
    Image.fromarray(image).save(target, "JPEG", exif=piexif.dump(exif), quality=95, **options)
    return target.getvalue()


@pytest.mark.parametrize("reduce", [1, 2, 4, 8])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_jpeg_is_read_as_stored(tmp_path: Path, orientation: int, reduce: int) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(red_corner(), orientation))
    image = read_image(tmp_path / "a.jpg", reduce=reduce)
    assert image.shape == (48 // reduce, 80 // reduce, 3)
    np.testing.assert_allclose(image[1, 1], [255, 0, 0], rtol=0, atol=3)  # grey values
    np.testing.assert_allclose(image[-2, -2], [0, 0, 0], rtol=0, atol=3)


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_a_tiff_is_read_as_stored(tmp_path: Path, orientation: int) -> None:
    Image.fromarray(red_corner()).save(tmp_path / "a.tif", tiffinfo={274: orientation})
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), red_corner())


@pytest.mark.parametrize("orientation", [1, 6])
@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L"])
def test_a_png_is_read_as_stored(tmp_path: Path, mode: str, orientation: int) -> None:
    image = Image.fromarray(red_corner()).convert(mode)
    exif = Image.Exif()
    exif[274] = orientation
    image.save(tmp_path / "a.png", exif=exif)
    expected = np.asarray(image).reshape(48, 80, -1)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)


def test_a_grey_jpeg_has_one_band(tmp_path: Path) -> None:
    Image.fromarray(smooth(40, 50, 1)[..., 0]).save(tmp_path / "a.jpg", quality=95)
    assert read_image(tmp_path / "a.jpg").shape == (40, 50, 1)
    assert read_image(tmp_path / "a.jpg", reduce=2).shape == (20, 25, 1)


@pytest.mark.parametrize("bands", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_bands_of_a_tiff_are_kept_apart(tmp_path: Path, bands: int, dtype: str) -> None:
    data = smooth(40, 50, bands, dtype)
    layout = {"planarconfig": "contig"} if bands > 1 else {}
    tifffile.imwrite(tmp_path / "a.tif", data, photometric="minisblack", **layout)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), data)
    assert read_image(tmp_path / "a.tif", reduce=4).shape == (10, 13, bands)


@pytest.mark.parametrize("kind", ["jpg", "tif"])
@pytest.mark.parametrize("reduce", [2, 4, 8])
def test_reduced_pixels_are_means_of_squares(tmp_path: Path, kind: str, reduce: int) -> None:
    data = smooth(101, 203, 3)
    Image.fromarray(data).save(tmp_path / f"a.{kind}", quality=98, subsampling=0)
    found = read_image(tmp_path / f"a.{kind}", reduce=reduce).astype(float)
    assert found.shape == (-(-101 // reduce), -(-203 // reduce), 3)
    rows, cols = 101 // reduce, 203 // reduce
    cells = data[: rows * reduce, : cols * reduce].reshape(rows, reduce, cols, reduce, 3)
    # grey values: JPEG's own rounding; a shift by half a pixel would show as 5 and more
    assert np.abs(found[:rows, :cols] - cells.mean(axis=(1, 3))).max() <= 3


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("share", [0.999, 0.6, 0.3, 0.02])
def test_a_truncated_jpeg_is_refused(tmp_path: Path, share: float, progressive: bool) -> None:
    noise = np.random.default_rng(7).integers(0, 256, (300, 400, 3), np.uint8)
    whole = jpeg(noise, progressive=progressive)
    (tmp_path / "DJI_0042.jpg").write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(InputError, match=r"DJI_0042\.jpg: JPEG is truncated") as caught:
        read_image(tmp_path / "DJI_0042.jpg")
    assert caught.value.source == "DJI_0042.jpg"


def test_a_jpeg_cut_right_behind_its_preview_is_refused(tmp_path: Path) -> None:
    whole = jpeg(red_corner(480, 640))
    end = whole.index(b"\xff\xd9") + 2
    (tmp_path / "a.jpg").write_bytes(whole[:end])
    with pytest.raises(InputError, match="truncated"):
        read_image(tmp_path / "a.jpg")


@pytest.mark.parametrize("tail", [b"\0" * 100, jpeg(red_corner())[:-9]], ids=["zeros", "preview"])
def test_bytes_behind_the_image_do_no_harm(tmp_path: Path, tail: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(red_corner()) + tail)
    assert read_image(tmp_path / "a.jpg").shape == (48, 80, 3)


@pytest.mark.parametrize("raw", [b"", b"\xff\xd8\xff", b"hello", b"II*\0garbage", b"\x89PNG\r\n"])
def test_what_is_no_image_is_refused(tmp_path: Path, raw: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(raw)
    with pytest.raises(InputError, match=r"a\.jpg: "):
        read_image(tmp_path / "a.jpg")


def test_a_truncated_tiff_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", smooth(200, 200, 3), compression=None, rowsperstrip=10)
    raw = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(raw[: len(raw) // 2])
    with pytest.raises(InputError, match=r"a\.tif: "):
        read_image(tmp_path / "a.tif")


def test_a_missing_photo_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.jpg: .*check the path"):
        read_image(tmp_path / "gone.jpg")


def test_reduction_is_one_of_four(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="reduce 3"):
        read_image(tmp_path / "a.jpg", reduce=3)


def test_opencv_without_rgb_flag_gives_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(smooth(60, 70, 3)))
    first = read_image(tmp_path / "a.jpg", reduce=2)
    monkeypatch.setattr("georef_gis.rasters.reading._HAS_RGB", False)
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg", reduce=2), first)
    assert cv2.__version__


def test_a_grid_comes_by_window(tmp_path: Path) -> None:
    data = smooth(90, 120, 1, "float32")
    data[~ellipse(90, 120)] = -9999
    write(tmp_path / "dem.tif", data, compression="deflate", nodata=-9999.0)
    whole = read_grid(tmp_path / "dem.tif")
    part = read_grid(tmp_path / "dem.tif", window=(30, 20, 50, 40))
    np.testing.assert_array_equal(np.isnan(whole.values), data[..., 0] == -9999)
    np.testing.assert_array_equal(part.values, whole.values[20:60, 30:80])
    assert part.transform == (0.25, 0.0, 500_007.5, 0.0, -0.25, 4_399_995.0)
    assert part.header == whole.header == read_grid_header(tmp_path / "dem.tif")
    assert (whole.header.width, whole.header.height, whole.header.nodata) == (120, 90, -9999.0)
    assert rasterio.CRS.from_wkt(whole.header.crs_wkt) == rasterio.CRS.from_wkt(UTM_17N)


def test_a_grid_is_scaled_and_keeps_whole_numbers(tmp_path: Path) -> None:
    values = np.array([[2**24 + 1, 7], [-5, 0]], np.int32)
    options = {"driver": "GTiff", "width": 2, "height": 2, "count": 1, "dtype": "int32"}
    place = rasterio.Affine(10.0, 0.0, 5.0, 0.0, -10.0, 9.0)
    with rasterio.open(tmp_path / "a.tif", "w", **options, transform=place, nodata=0) as dataset:
        dataset.write(values, 1)
        dataset.scales, dataset.offsets, dataset.units = [0.5], [100.0], ["US survey foot"]
    grid = read_grid(tmp_path / "a.tif")
    expected = [[(2**24 + 1) / 2 + 100, 103.5], [97.5, np.nan]]
    np.testing.assert_array_equal(grid.values, expected)
    assert (grid.header.unit, grid.header.crs_wkt) == ("US survey foot", "")


@pytest.mark.parametrize("window", [(-1, 0, 5, 5), (0, 0, 0, 5), (26, 0, 5, 5), (0, 26, 5, 5)])
def test_a_window_outside_is_refused(tmp_path: Path, window: tuple[int, int, int, int]) -> None:
    write(tmp_path / "a.tif", smooth(30, 30, 1), compression="deflate")
    with pytest.raises(ValueError, match="window"):
        read_grid(tmp_path / "a.tif", window=window)


def test_a_grid_without_a_place_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", smooth(30, 30, 1, "float32"))
    with pytest.raises(InputError, match="no geotransform"):
        read_grid(tmp_path / "a.tif")


def test_a_grid_that_is_no_raster_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dem.tif").write_text("not a raster")
    with pytest.raises(InputError, match=r"dem\.tif: cannot be read as a raster"):
        read_grid(tmp_path / "dem.tif")


def test_a_band_that_is_not_there_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", smooth(30, 30, 3))
    with pytest.raises(InputError, match="no band 4"):
        read_grid(tmp_path / "a.tif", band=4)
