"""Maps on the grid of another one: place, masks, kinds of files, any windows alike."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from georef_gis.errors import CrsError, InputError
from georef_gis.rasters.resampled import coarse_valid, open_bands, open_bands_on

UTM = "EPSG:32617"
NORTH_UP = Affine(0.5, 0.0, 500_000.0, 0.0, -0.5, 4_500_000.0)
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def _write(
        name: str, data: np.ndarray, transform: Affine = NORTH_UP, crs: str | None = UTM,
        mask: np.ndarray | None = None, **more: Any,
    ) -> Path:  # fmt: skip
        """A GeoTIFF of shape (bands, rows, cols)."""
        path = tmp_path / name
        with (
            rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
            rasterio.open(
                path, "w", driver="GTiff", count=len(data), height=data.shape[1],
                width=data.shape[2], dtype=data.dtype, crs=crs, transform=transform, **more,
            ) as file,
        ):  # fmt: skip
            file.write(data)
            if mask is not None:
                file.write_mask(mask)
        return path

    return _write


def ramp(size: int = 96) -> np.ndarray:
    """Float values that tell their place: column + 1000 row of the pixel's middle."""
    at = np.arange(size) + 0.5
    return (at[None, :] + 1000.0 * at[:, None])[None].astype(np.float32)


def test_same_grid_is_read_as_it_is(write: Write) -> None:
    path = write("a.tif", ramp())
    with open_bands(path) as plain, open_bands_on(path, plain.header) as warped:
        window = (8, 16, 40, 30)
        expected, valid = plain.read(window, [1])
        found, seen = warped.read(window, [1])
    np.testing.assert_array_equal(found, expected)
    assert valid.all()
    assert seen.all()
    assert found.shape == (30, 40, 1)


def test_moved_reads_from_where_the_other_shows_it(write: Write) -> None:
    path = write("a.tif", ramp())
    with open_bands(path) as plain:
        moved = (1.01, 0.0, 5.7, 0.0, 1.0, -2.25)
        with open_bands_on(path, plain.header, moved=moved) as warped:
            found, _ = warped.read((10, 10, 20, 20), [1])
    at = np.arange(10, 30) + 0.5
    expected = (1.01 * at + 5.7)[None, :] + 1000.0 * (at - 2.25)[:, None]
    # float32 of values to 30 000, and GDAL's weights
    np.testing.assert_allclose(found[:, :, 0], expected, atol=0.02)


@pytest.mark.parametrize("gsd", [0.2, 0.5, 1.25])
def test_other_gsd_and_extent_keep_the_place(write: Write, gsd: float) -> None:
    size = round(70.0 / gsd)
    at = (np.arange(size) + 0.5) * gsd
    # values are metres east and south of the corner of the first map
    data = np.stack(np.broadcast_arrays((at - 10.0)[None, :], (at - 10.0)[:, None]))
    corner = NORTH_UP @ Affine.translation(-20, -20)
    transform = Affine(gsd, 0.0, corner.c, 0.0, -gsd, corner.f)
    path = write("other.tif", data.astype(np.float32), transform)
    with open_bands(write("a.tif", ramp())) as first, open_bands_on(path, first.header) as other:
        found, valid = other.read((4, 4, 80, 80), [1, 2])
    assert valid.all()
    expected = (np.arange(4, 84) + 0.5) * 0.5
    # m; a fiftieth of a pixel
    np.testing.assert_allclose(found[:, :, 0], np.broadcast_to(expected, (80, 80)), atol=0.01)
    np.testing.assert_allclose(found[:, :, 1], np.broadcast_to(expected, (80, 80)).T, atol=0.01)


def test_other_crs_keeps_the_place(write: Write) -> None:
    from rasterio.warp import transform

    step = 2e-6
    lon, lat = (v[0] for v in transform(UTM, "EPSG:4326", [NORTH_UP.c], [NORTH_UP.f]))
    size = 400
    west, north = lon - 40 * step, lat + 40 * step
    lons = west + (np.arange(size) + 0.5) * step
    lats = north - (np.arange(size) + 0.5) * step
    east, north_m = transform(
        "EPSG:4326", UTM, np.tile(lons, size).tolist(), np.repeat(lats, size).tolist()
    )
    data = np.stack([np.array(east) - NORTH_UP.c, NORTH_UP.f - np.array(north_m)])
    data = data.reshape(2, size, size).astype(np.float32)
    path = write("wgs.tif", data, Affine(step, 0, west, 0, -step, north), "EPSG:4326")
    with open_bands(write("a.tif", ramp())) as first, open_bands_on(path, first.header) as other:
        found, valid = other.read((4, 4, 80, 80), [1, 2])
    assert valid.all()
    expected = np.broadcast_to((np.arange(4, 84) + 0.5) * 0.5, (80, 80))
    # m; GDAL's weights for a finer map are off by a twentieth of its pixels of 0.2 m
    np.testing.assert_allclose(found[:, :, 0], expected, atol=0.015)
    np.testing.assert_allclose(found[:, :, 1], expected.T, atol=0.015)


@pytest.mark.parametrize("kind", ["mask", "alpha", "nodata", "nan", "only nan"])
def test_missing_pixels_stay_missing(write: Write, kind: str) -> None:
    hole = np.zeros((96, 96), np.bool_)
    hole[40:60, 30:50] = True
    data = np.full((1, 96, 96), 100, np.uint8)
    if kind == "mask":
        path = write("a.tif", data, mask=~hole)
    elif kind == "alpha":
        both = np.concatenate([data, np.where(hole, 0, 255).astype(np.uint8)[None]])
        path = write("a.tif", both, photometric="MINISBLACK", alpha="YES")
    elif kind == "nodata":
        path = write("a.tif", np.where(hole, np.uint8(0), data), nodata=0)
    else:
        more = {"nodata": np.nan} if kind == "nan" else {}
        path = write("a.tif", np.where(hole, np.nan, data).astype(np.float32), **more)
    with open_bands(path) as plain:
        assert len(plain.header.bands) == 1
        valid = plain.read((0, 0, 96, 96), [1])[1][:, :, 0]
        with open_bands_on(path, plain.header, moved=(1, 0, 2.5, 0, 1, 0)) as warped:
            values, seen = (part[:, :, 0] for part in warped.read((0, 0, 90, 96), [1]))
        coarse = coarse_valid(path, plain.header, most=48)
    np.testing.assert_array_equal(valid, ~hole)
    # half a pixel either side
    assert not seen[41:59, 28:47].any()
    assert seen[:, :27].all()
    assert seen[:, 49:].all()
    # no fill value is mixed in at the rim
    assert set(np.unique(values[seen])) == {100}
    assert coarse.shape == (48, 48)
    assert not coarse[21:29, 16:24].any()
    assert coarse[:19].all()


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("bands", [1, 2, 3, 5])
@pytest.mark.parametrize("kind", ["mask", "alpha"])
def test_any_number_of_bands_is_masked(write: Write, kind: str, bands: int, dtype: str) -> None:
    hole = np.zeros((64, 64), np.bool_)
    hole[20:40, 20:40] = True
    data = np.full((bands, 64, 64), 100, dtype)
    if kind == "mask":
        path = write("a.tif", data, mask=~hole)
    else:
        alpha = np.where(hole, 0, 255).astype(dtype)[None]
        more = {"photometric": "MINISBLACK", "alpha": "YES"}
        path = write("a.tif", np.concatenate([data, alpha]), **more)
        with rasterio.open(path, "r+") as file:
            kinds = [rasterio.enums.ColorInterp.undefined] * bands
            file.colorinterp = [*kinds, rasterio.enums.ColorInterp.alpha]
    with open_bands(path) as plain, open_bands_on(path, plain.header) as warped:
        assert len(plain.header.bands) == bands
        for one in (plain, warped):
            values, seen = one.read((0, 0, 64, 64), range(1, bands + 1))
            np.testing.assert_array_equal(seen, np.broadcast_to(~hole[:, :, None], seen.shape))
            assert (values[seen] == 100).all()
        np.testing.assert_array_equal(coarse_valid(path, plain.header), ~hole)


def test_windows_do_not_change_the_values(write: Write) -> None:
    rng = np.random.default_rng(5)
    path = write("a.tif", rng.integers(0, 60_000, (1, 300, 300)).astype(np.uint16))
    with open_bands(path) as plain:
        with open_bands_on(path, plain.header, moved=(1.001, 1e-3, 0.3, 0, 1, 5.7)) as warped:
            whole, valid = warped.read((0, 0, 300, 300), [1])
        with open_bands_on(path, plain.header, moved=(1.001, 1e-3, 0.3, 0, 1, 5.7)) as warped:
            for row in range(0, 300, 50):
                for col in range(0, 300, 60):
                    values, seen = warped.read((col, row, 60, 50), [1])
                    part = np.s_[row : row + 50, col : col + 60]
                    np.testing.assert_array_equal(values, whole[part])
                    np.testing.assert_array_equal(seen, valid[part])


def test_header_tells_names_scales_and_place(write: Write) -> None:
    path = write("a.tif", np.zeros((2, 8, 8), np.uint16))
    with rasterio.open(path, "r+") as file:
        file.descriptions = ("red", "nir")
        file.scales, file.offsets = (1e-4, 1e-4), (0.0, -0.1)
    with open_bands(path) as bands:
        header = bands.header
    assert header.bands == ("red", "nir")
    assert header.scales == ((1e-4, 0.0), (1e-4, -0.1))
    assert (header.epsg, header.dtype, header.name) == (32617, "uint16", "a.tif")


def test_maps_without_place_are_refused(write: Write) -> None:
    with open_bands(write("a.tif", ramp())) as first:
        header = first.header
    bare = write("bare.tif", ramp(), crs=None)
    with pytest.raises(CrsError, match=r"bare\.tif: has no CRS, a\.tif has one"):
        with open_bands_on(bare, header):
            pass
    with open_bands(bare) as plain, open_bands_on(bare, plain.header) as warped:
        np.testing.assert_array_equal(warped.read((0, 0, 9, 9), [1])[0], ramp()[0, :9, :9, None])
    (bare.parent / "text.tif").write_text("no raster")
    with pytest.raises(InputError, match="cannot be read as a raster"):
        with open_bands(bare.parent / "text.tif"):
            pass
