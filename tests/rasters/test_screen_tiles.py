"""Tiles for a screen show the file's own pixels in their place, whatever its samples are."""

from __future__ import annotations

import io
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image

from georef_gis.errors import InputError
from georef_gis.rasters.map_tiles import MapTiles
from georef_gis.rasters.photo_tiles import TILE, PhotoTiles, zoom_levels
from georef_gis.rasters.screen import ScreenPicture, stretch_of

RNG = np.random.default_rng(4)


def smooth(rows: int, cols: int, bands: int = 3) -> NDArray[np.uint8]:
    """A picture that JPEG changes by little."""
    small = RNG.integers(0, 256, (max(2, rows // 64), max(2, cols // 64), bands)).astype(np.uint8)
    large = cv2.resize(small, (cols, rows), interpolation=cv2.INTER_CUBIC)
    return np.asarray(large.reshape(rows, cols, bands), dtype=np.uint8)


def write_map(path: Path, samples: NDArray[Any], **profile: Any) -> Path:
    rows, cols, bands = samples.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=samples.dtype,
        crs="EPSG:32617", transform=rasterio.Affine(0.5, 0, 1000, 0, -0.5, 5000), tiled=True,
        blockxsize=256, blockysize=256, **profile,
    ) as dataset:  # fmt: skip
        dataset.write(np.moveaxis(samples, 2, 0))
        dataset.build_overviews([2, 4], rasterio.enums.Resampling.average)
    return path


def shades(made: ScreenPicture) -> NDArray[np.uint8]:
    """(rows, cols, 4): red, green, blue, alpha."""
    return np.asarray(Image.open(io.BytesIO(made.content)).convert("RGBA"))


# -- maps ----------------------------------------------------------------------------------------


def test_a_tile_holds_the_pixels_of_its_place(tmp_path: Path) -> None:
    samples = smooth(600, 900)
    tiles = MapTiles(write_map(tmp_path / "m.tif", samples))
    assert tiles.pyramid.levels == ((1, 900, 600), (2, 450, 300), (4, 225, 150))
    assert tiles.pyramid.tile_size == 256
    assert tiles.pyramid.extent == (1000.0, 4700.0, 1450.0, 5000.0)
    whole = shades(tiles.tile(0, 1, 1))
    assert whole.shape == (256, 256, 4)
    # shades; JPEG of quality 90 changes a smooth picture by a few
    assert np.abs(whole[..., :3].astype(int) - samples[256:512, 256:512]).mean() < 2.0
    assert (whole[..., 3] == 255).all()
    tiles.close()


def test_a_tile_at_the_edge_is_filled_up_with_nothing(tmp_path: Path) -> None:
    samples = smooth(600, 900)
    tiles = MapTiles(write_map(tmp_path / "m.tif", samples))
    edge = shades(tiles.tile(0, 3, 2))
    assert edge.shape == (256, 256, 4)
    assert (edge[: 600 - 512, : 900 - 768, 3] == 255).all()
    assert (edge[600 - 512 :, :, 3] == 0).all()
    assert (edge[:, 900 - 768 :, 3] == 0).all()
    tiles.close()


def test_a_coarse_level_comes_from_the_files_overviews(tmp_path: Path) -> None:
    samples = smooth(600, 900)
    tiles = MapTiles(write_map(tmp_path / "m.tif", samples))
    coarse = shades(tiles.tile(2, 0, 0))[:150, :225, :3].astype(int)
    averaged = cv2.resize(samples, (225, 150), interpolation=cv2.INTER_AREA).astype(int)
    assert np.abs(coarse - averaged).mean() < 3.0
    tiles.close()


@pytest.mark.parametrize(("level", "col", "row"), [(0, 4, 0), (0, 0, 3), (2, 1, 0), (0, 10**6, 0)])
def test_there_is_nothing_beside_the_map(tmp_path: Path, level: int, col: int, row: int) -> None:
    tiles = MapTiles(write_map(tmp_path / "m.tif", smooth(600, 900)))
    assert shades(tiles.tile(level, col, row))[..., 3].max() == 0
    tiles.close()


def test_missing_pixels_are_transparent(tmp_path: Path) -> None:
    samples = smooth(256, 256)
    samples[:100] = 0
    path = write_map(tmp_path / "m.tif", np.maximum(samples, 1) * (samples > 0), nodata=0)
    tiles = MapTiles(path)
    alpha = shades(tiles.tile(0, 0, 0))[..., 3]
    assert (alpha[:100] == 0).all()
    assert (alpha[100:] == 255).all()
    tiles.close()


@pytest.mark.parametrize("dtype", ["uint16", "int16", "float32"])
def test_other_samples_are_stretched_to_the_screen(tmp_path: Path, dtype: str) -> None:
    ramp = np.linspace(1000, 3000, 256 * 256).reshape(256, 256, 1).astype(dtype)
    tiles = MapTiles(write_map(tmp_path / "m.tif", ramp))
    seen = shades(tiles.tile(0, 0, 0))
    assert seen[0, 0, 0] < 10
    assert seen[-1, -1, 0] > 245
    assert (np.diff(seen[:, 128, 0].astype(int)) >= -3).all()
    tiles.close()


def test_four_bands_with_alpha_show_three_colours(tmp_path: Path) -> None:
    rgba = np.dstack([smooth(256, 256), np.full((256, 256), 255, np.uint8)])
    rgba[:10, :, 3] = 0
    tiles = MapTiles(write_map(tmp_path / "m.tif", rgba, photometric="rgb", alpha="yes"))
    seen = shades(tiles.tile(0, 0, 0))
    assert (seen[:10, :, 3] == 0).all()
    assert np.abs(seen[20:, :, :3].astype(int) - rgba[20:, :, :3]).mean() < 4.0
    tiles.close()


def test_a_map_that_is_made_again_is_noticed(tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.tif", smooth(256, 256))
    tiles = MapTiles(path)
    assert tiles.is_current
    time.sleep(0.01)
    write_map(path, smooth(300, 300))
    assert not tiles.is_current
    tiles.close()


@pytest.mark.parametrize("content", [b"", b"no raster", b"II*\0"])
def test_what_is_no_map_is_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "m.tif"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"m\.tif"):
        MapTiles(path)
    with pytest.raises(InputError, match="cannot be read"):
        MapTiles(tmp_path / "none.tif")


def test_threads_get_the_same_tiles(tmp_path: Path) -> None:
    tiles = MapTiles(write_map(tmp_path / "m.tif", smooth(1024, 1024)))
    places = [(col, row) for col in range(4) for row in range(4)]
    alone = {place: tiles.tile(0, *place).content for place in places}
    together: list[bool] = []

    def ask() -> None:
        together.extend(tiles.tile(0, *place).content == alone[place] for place in places)

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert together == [True] * 128
    tiles.close()


# -- photos --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "levels"), [(100, 1), (512, 1), (513, 2), (1024, 2), (5472, 5)])
def test_the_last_level_of_a_photo_fits_into_a_tile(width: int, levels: int) -> None:
    assert zoom_levels(width, 100) == levels
    assert width / 2 ** (levels - 1) <= TILE


def test_photo_tiles_are_its_own_pixels_as_stored(tmp_path: Path) -> None:
    samples = smooth(700, 1100)
    path = tmp_path / "p.png"
    Image.fromarray(samples).save(path)
    tiles = PhotoTiles()
    seen = shades(tiles.tile(path, 0, 1, 0))
    assert np.array_equal(seen[..., :3], samples[:512, 512:1024])
    edge = shades(tiles.tile(path, 0, 2, 1))
    assert np.array_equal(edge[: 700 - 512, : 1100 - 1024, :3], samples[512:, 1024:])
    assert (edge[700 - 512 :, :, 3] == 0).all()
    assert (edge[:, 1100 - 1024 :, 3] == 0).all()
    coarse = shades(tiles.tile(path, 1, 0, 0))[:350, :512, :3].astype(int)
    half = cv2.resize(samples, (550, 350), interpolation=cv2.INTER_AREA)[:, :512].astype(int)
    assert np.abs(coarse - half).mean() < 3.0
    tiles.close()


def test_the_orientation_tag_does_not_turn_a_photo(tmp_path: Path) -> None:
    samples = smooth(300, 400)
    path = tmp_path / "p.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(samples).save(path, quality=95, exif=exif)
    tiles = PhotoTiles()
    alpha = shades(tiles.tile(path, 0, 0, 0))[..., 3]
    assert (alpha[:300, :400] == 255).all()
    assert alpha[300:].max() == alpha[:, 400:].max() == 0
    tiles.close()


def test_a_photo_is_decoded_once_for_all_its_tiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from georef_gis.rasters import photo_tiles

    decoded: list[int] = []
    real = photo_tiles.read_image
    monkeypatch.setattr(
        photo_tiles, "read_image",
        lambda path, *, reduce, alpha: (
            decoded.append(reduce),
            real(path, reduce=reduce, alpha=alpha),
        )[1],
    )  # fmt: skip
    path = tmp_path / "p.png"
    Image.fromarray(smooth(1024, 1024)).save(path)
    tiles = PhotoTiles()
    threads = [threading.Thread(target=tiles.tile, args=(path, 0, k % 2, k // 2)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert decoded == [1]
    tiles.close()


def test_decoded_photos_do_not_fill_the_memory(tmp_path: Path) -> None:
    tiles = PhotoTiles(most=3_000_000)
    for k in range(5):
        path = tmp_path / f"{k}.png"
        Image.fromarray(smooth(700, 700)).save(path)
        tiles.tile(path, 0, 0, 0)
    # bytes: two photos of 1.47 MB are within the budget
    assert sum(f.result().shades.nbytes for f in tiles._kept.values()) <= 3_000_000
    tiles.close()


def test_a_photo_that_was_replaced_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "p.png"
    Image.fromarray(np.zeros((200, 200, 3), np.uint8)).save(path)
    tiles = PhotoTiles()
    assert shades(tiles.tile(path, 0, 0, 0))[100, 100, 0] < 5
    time.sleep(0.01)
    Image.fromarray(np.full((200, 200, 3), 250, np.uint8)).save(path)
    assert shades(tiles.tile(path, 0, 0, 0))[100, 100, 0] > 240
    tiles.close()


@pytest.mark.parametrize("level", [-1, 13])
def test_a_level_that_no_photo_has_is_refused(tmp_path: Path, level: int) -> None:
    path = tmp_path / "p.png"
    Image.fromarray(smooth(64, 64)).save(path)
    tiles = PhotoTiles()
    with pytest.raises(InputError, match="no level"):
        tiles.tile(path, level, 0, 0)
    tiles.close()


def test_a_broken_photo_is_told_and_may_be_mended(tmp_path: Path) -> None:
    path = tmp_path / "p.jpg"
    path.write_bytes(b"\xff\xd8\xff broken")
    tiles = PhotoTiles()
    for _ in range(2):
        with pytest.raises(InputError, match=r"p\.jpg"):
            tiles.tile(path, 0, 0, 0)
    Image.fromarray(smooth(64, 64)).save(path)
    assert tiles.tile(path, 0, 0, 0).media_type == "image/png"
    with pytest.raises(InputError, match="cannot be read"):
        tiles.tile(tmp_path / "none.jpg", 0, 0, 0)
    tiles.close()


def test_a_stretch_of_nothing_is_no_division_by_zero() -> None:
    flat = np.full((4, 4, 1), 7, dtype=np.uint16)
    assert stretch_of(flat).applied(flat).max() == 0
    none = np.full((4, 4, 1), np.nan, dtype=np.float32)
    assert stretch_of(none).applied(none).max() == 0
