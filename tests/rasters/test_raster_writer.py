from __future__ import annotations

import itertools
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raster_cases import ellipse, make_profile, read, smooth, write, write_tiles
from rio_cogeo import cog_validate

from georef_gis.rasters.writer import TiledWriter

# size, bands, dtype, whether a mask is given, changes of the profile
KINDS = {
    "jpeg-mask": (600, 700, 3, "uint8", True, {}),
    "jpeg-whole": (600, 700, 3, "uint8", False, {}),
    "jpeg-grey": (600, 700, 1, "uint8", True, {}),
    "deflate-alpha": (600, 700, 3, "uint8", True, {"compression": "deflate"}),
    "deflate-mask": (600, 700, 3, "uint8", True, {"compression": "deflate", "validity": "mask"}),
    "zstd-5-bands": (600, 700, 5, "uint16", True, {"compression": "zstd"}),
    "webp-alpha": (600, 700, 3, "uint8", True, {"compression": "webp"}),
    "webp-opaque": (600, 700, 3, "uint8", False, {"compression": "webp", "validity": "none"}),
    "uint16": (600, 700, 4, "uint16", True, {"compression": "deflate"}),
    "int16-nodata": (600, 700, 1, "int16", True, {"compression": "zstd", "nodata": -32768}),
    "float32-mask": (600, 700, 1, "float32", True, {"compression": "deflate"}),
    "float32-nan": (
        600,
        700,
        2,
        "float32",
        True,
        {"compression": "zstd", "nodata": float("nan"), "tile_size": 256},
    ),
    "one-small-tile": (20, 30, 3, "uint8", True, {}),
    "very-wide": (70, 9000, 3, "uint8", True, {"tile_size": 256}),
    "one-row": (1, 1500, 1, "uint8", False, {"compression": "deflate"}),
    "default-tiles": (1100, 1300, 3, "uint8", True, {"tile_size": 512}),
    "large-tiles": (1100, 1300, 3, "uint8", True, {"tile_size": 1024}),
}
kinds = pytest.mark.parametrize("kind", KINDS)


def make(path: Path, kind: str, **more: object) -> tuple[np.ndarray, np.ndarray | None]:
    rows, cols, bands, dtype, masked, changes = KINDS[kind]
    data = smooth(rows, cols, bands, dtype)
    mask = ellipse(rows, cols) if masked else None
    write(path, data, mask, **{**changes, **more})
    return data, mask


@kinds
def test_every_kind_is_a_valid_cog(tmp_path: Path, kind: str) -> None:
    make(tmp_path / "a.tif", kind)
    assert cog_validate(tmp_path / "a.tif", strict=True, quiet=True) == (True, [], [])
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"


@kinds
def test_every_kind_reads_back(tmp_path: Path, kind: str) -> None:
    data, mask = make(tmp_path / "a.tif", kind)
    found, valid = read(tmp_path / "a.tif")
    inside = np.ones(data.shape[:2], bool) if mask is None else mask
    assert np.array_equal(valid, inside)
    difference = np.abs(found[..., : data.shape[2]].astype(float) - data)[inside]
    if KINDS[kind][5].get("compression", "jpeg") in ("jpeg", "webp"):
        # grey values: quality 85, colours at half resolution; steeper at the rim of the mask
        assert np.mean(difference) < 2
        assert np.quantile(difference, 0.999) <= 10
        assert difference.max() <= 30
    else:
        assert not difference.any()


@kinds
def test_every_kind_opens_in_tifffile(tmp_path: Path, kind: str) -> None:
    data, _ = make(tmp_path / "a.tif", kind)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert tiff.pages[0].shape[:2] == data.shape[:2]
        pages = [(page.imagelength, page.imagewidth) for page in tiff.pages]
    assert pages == sorted(pages, reverse=True)


@kinds
def test_blocks_keep_the_promises_of_the_ghost_area(tmp_path: Path, kind: str) -> None:
    make(tmp_path / "a.tif", kind)
    raw = (tmp_path / "a.tif").read_bytes()
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        pages = [(p.dataoffsets, p.databytecounts, p.subfiletype & 4) for p in tiff.pages]
    images = [page for page in pages if not page[2]]
    masks = [page for page in pages if page[2]] or [None] * len(images)
    assert (b"MASK_INTERLEAVED_WITH_IMAGERY=YES\n" in raw) == (masks[0] is not None)
    expected = None
    for image, mask in reversed(list(zip(images, masks, strict=True))):
        for tile, (offset, size) in enumerate(zip(image[0], image[1], strict=True)):
            blocks = (
                [(offset, size)]
                if mask is None
                else [(offset, size), (mask[0][tile], mask[1][tile])]
            )
            for at, length in blocks:
                if not size:
                    assert (at, length) == (0, 0)
                    continue
                assert expected is None or at == expected
                assert struct.unpack("<I", raw[at - 4 : at]) == (length,)
                assert raw[at + length : at + length + 4] == raw[at + length - 4 : at + length]
                expected = at + length + 8
    assert expected == len(raw) + 4


def halved(data: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the valid pixels of 2 x 2 cells, in float, written for clarity only."""
    rows, cols, bands = data.shape
    total = np.zeros((-(-rows // 2), -(-cols // 2), bands))
    count = np.zeros(total.shape[:2])
    for down, right in itertools.product((0, 1), (0, 1)):
        part = mask[down::2, right::2]
        at = np.s_[: part.shape[0], : part.shape[1]]
        total[at] += np.where(part[..., None], data[down::2, right::2], 0)
        count[at] += part
    return total / np.maximum(count, 1)[..., None], count > 0


@pytest.mark.parametrize(
    "kind", ["deflate-alpha", "deflate-mask", "uint16", "int16-nodata", "float32-mask"]
)
def test_overviews_are_means_of_valid_pixels(tmp_path: Path, kind: str) -> None:
    data, mask = make(tmp_path / "a.tif", kind, tile_size=64)
    level = np.where(mask[..., None], data, 0).astype(float)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        count = len(dataset.overviews(1))
    assert count == 4
    for number in range(count):
        level, mask = halved(level, mask)
        found, valid = read(tmp_path / "a.tif", overview_level=number)
        assert np.array_equal(valid, mask)
        found = found[..., : data.shape[2]].astype(float)
        atol = 1e-3 if data.dtype == np.float32 else 0.51  # grey value: rounding of one level
        np.testing.assert_allclose(found[mask], level[mask], rtol=0, atol=atol)
        level = found


@pytest.mark.parametrize("compression", ["jpeg", "deflate"])
@pytest.mark.parametrize("shape", ["ellipse", "blocks"])
def test_black_outside_the_mask_does_not_darken_the_rim(
    tmp_path: Path, compression: str, shape: str
) -> None:
    mask = ellipse(600, 700)
    if shape == "blocks":  # whole JPEG blocks: the decoder interpolates colours across their edge
        mask = np.kron(mask[::16, ::16], np.ones((16, 16), bool))[:600, :700]
    colour = np.uint8([220, 120, 40])
    data = np.where(mask[..., None], colour, np.uint8(0))
    write(tmp_path / "a.tif", data, mask, compression=compression)
    for options in ({}, {"overview_level": 0}):
        found, valid = read(tmp_path / "a.tif", **options)
        error = np.abs(found[valid][:, :3].astype(int) - colour)
        assert error.max() <= (0 if compression == "deflate" else 4)  # grey values: plain colour


@pytest.mark.parametrize("compression", ["jpeg", "deflate", "zstd", "webp"])
def test_red_stays_red(tmp_path: Path, compression: str) -> None:
    data = np.zeros((128, 128, 3), np.uint8)
    data[32:96, 32:96] = [255, 0, 0]
    write(tmp_path / "a.tif", data, compression=compression)
    found, _ = read(tmp_path / "a.tif")
    np.testing.assert_allclose(found[64, 64, :3], [255, 0, 0], rtol=0, atol=3)  # grey values


@pytest.mark.parametrize("kind", ["jpeg-mask", "deflate-alpha", "float32-nan", "webp-alpha"])
def test_bytes_do_not_depend_on_order_or_workers(
    tmp_path: Path, kind: str, rng: np.random.Generator
) -> None:
    rows, cols, bands, dtype, _, changes = KINDS[kind]
    data, mask = smooth(rows, cols, bands, dtype), ellipse(rows, cols)
    profile = make_profile(data, **changes)
    files = []
    for number, workers in enumerate((1, 1, 1, 2, 3)):
        path = tmp_path / f"{number}.tif"
        with TiledWriter(path, profile, workers=workers) as writer:
            order = list(itertools.product(range(writer.tile_rows), range(writer.tile_cols)))
            if number == 1:
                order.reverse()
            elif number > 1:
                rng.shuffle(order)
            write_tiles(writer, data, mask, order)
        files.append(path.read_bytes())
    assert all(found == files[0] for found in files)


def test_waiting_tiles_spilled_to_disk_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path / "a.tif", "deflate-mask")
    monkeypatch.setattr("georef_gis.rasters.pyramid_builder._WAITING_LIMIT", 30_000)
    make(tmp_path / "b.tif", "deflate-mask")
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_buffers_may_be_used_again_while_workers_encode(tmp_path: Path) -> None:
    data, buffer = smooth(256, 256, 1), np.empty((64, 64, 1), np.uint8)
    profile = make_profile(data, compression="deflate")
    with TiledWriter(tmp_path / "a.tif", profile, workers=2) as writer:
        for row, col in itertools.product(range(4), range(4)):
            buffer[:] = data[64 * row : 64 * row + 64, 64 * col : 64 * col + 64]
            writer.write_tile(row, col, buffer)
            buffer[:] = 0
    assert np.array_equal(read(tmp_path / "a.tif")[0][..., :1], data)


@pytest.mark.parametrize("declare", [True, False], ids=["skipped", "never-named"])
@pytest.mark.parametrize("compression", ["jpeg", "deflate"])
def test_empty_tiles_cost_nothing(tmp_path: Path, compression: str, declare: bool) -> None:
    data = smooth(64, 64, 3)
    profile = make_profile(
        np.broadcast_to(data[:1, :1], (20_000, 20_000, 3)), compression=compression
    )
    with TiledWriter(tmp_path / "a.tif", profile) as writer:
        writer.write_tile(100, 200, data)
        writer.write_tile(7, 7, data, np.zeros((64, 64), bool))
        if declare:
            for row, col in itertools.product(range(100, 104), range(200, 208)):
                if (row, col) != (100, 200):
                    writer.skip_tile(row, col)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        stored = [np.count_nonzero(page.databytecounts) for page in tiff.pages]
    assert set(stored) == {1}  # the one tile, its mask, and those above it
    with rasterio.open(tmp_path / "a.tif") as dataset:
        for row in (0, 7 * 64):
            window = rasterio.windows.Window(row, row, 64, 64)
            assert not dataset.read(window=window).any()
            assert not dataset.dataset_mask(window=window).any()
    assert cog_validate(tmp_path / "a.tif", strict=True, quiet=True)[0]


def test_a_raster_without_any_tile_is_empty(tmp_path: Path) -> None:
    profile = make_profile(smooth(200, 200, 3))
    with TiledWriter(tmp_path / "a.tif", profile):
        pass
    found, valid = read(tmp_path / "a.tif")
    assert not found.any()
    assert not valid.any()


def test_sparse_tiles_with_nodata_read_as_nodata(tmp_path: Path) -> None:
    profile = make_profile(smooth(200, 200, 1, "float32"), compression="deflate", nodata=-9999.0)
    with TiledWriter(tmp_path / "a.tif", profile) as writer:
        writer.write_tile(0, 0, np.full((64, 64), 5, np.float32))
    found, valid = read(tmp_path / "a.tif")
    assert set(np.unique(found)) == {5, -9999}
    assert valid.sum() == 64 * 64


def test_nodata_in_the_data_makes_the_mask(tmp_path: Path) -> None:
    data = smooth(128, 128, 1, "float32")
    data[20:41, 20:41] = np.nan
    write(tmp_path / "a.tif", data, compression="deflate", nodata=float("nan"), tile_size=64)
    found, _ = read(tmp_path / "a.tif")
    np.testing.assert_array_equal(found, data)


@pytest.mark.parametrize("force", [True, False, None])
def test_bigtiff_can_be_forced(tmp_path: Path, force: bool | None) -> None:
    data, mask = smooth(600, 700, 3), ellipse(600, 700)
    write(tmp_path / "a.tif", data, mask, compression="deflate", bigtiff=force)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert tiff.is_bigtiff == (force is True)
    assert cog_validate(tmp_path / "a.tif", strict=True, quiet=True) == (True, [], [])
    found, valid = read(tmp_path / "a.tif")
    assert np.array_equal(found[..., :3][mask], data[mask])
    assert np.array_equal(valid, mask)


def test_bigtiff_is_chosen_beyond_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("georef_gis.rasters.directories._CLASSIC_LIMIT", 20_000)
    make(tmp_path / "a.tif", "deflate-mask")
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert tiff.is_bigtiff
    assert cog_validate(tmp_path / "a.tif", strict=True, quiet=True)[0]


def test_descriptions_and_metadata_survive(tmp_path: Path) -> None:
    names = ("NIR", "green <550 nm>", "bleu é")
    items = {"GSD": "0.03 m", "NOTE": 'a < b & "c"'}
    write(tmp_path / "a.tif", smooth(70, 70, 3), band_descriptions=names, metadata=items)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.descriptions == names
        assert items.items() <= dataset.tags().items()


@pytest.mark.parametrize(
    ("row", "col", "shape", "dtype"),
    [(2, 0, (64, 64, 3), "u1"), (0, -1, (64, 64, 3), "u1"), (0, 0, (64, 63, 3), "u1"),
     (1, 1, (64, 64, 3), "u1"), (0, 0, (64, 64, 1), "u1"), (0, 0, (64, 64, 3), "u2")],
    ids=["below", "left", "narrow", "not-cropped", "bands", "dtype"],
)  # fmt: skip
def test_unfit_tiles_are_refused(
    tmp_path: Path, row: int, col: int, shape: tuple[int, ...], dtype: str
) -> None:
    writer = TiledWriter(tmp_path / "a.tif", make_profile(smooth(100, 100, 3)))
    with pytest.raises(ValueError, match="tile"):
        writer.write_tile(row, col, np.zeros(shape, dtype))
    writer.abort()


def test_a_tile_is_written_once(tmp_path: Path) -> None:
    tile = smooth(64, 64, 3)
    writer = TiledWriter(tmp_path / "a.tif", make_profile(tile))
    writer.write_tile(0, 0, tile)
    with pytest.raises(ValueError, match="before"):
        writer.write_tile(0, 0, tile)
    with pytest.raises(ValueError, match="before"):
        writer.skip_tile(0, 0)
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write_tile(0, 0, tile)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    rows=st.integers(1, 150),
    cols=st.integers(1, 150),
    bands=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.0, 0.02, 0.5, 0.98, 1.0]),
)
def test_any_size_and_mask_reads_back(
    tmp_path: Path, rows: int, cols: int, bands: int, seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    data = rng.integers(0, 256, (rows, cols, bands), np.uint8)
    mask = rng.random((rows, cols)) < share
    write(tmp_path / "a.tif", data, mask, compression="zstd", validity="mask", tile_size=32)
    found, valid = read(tmp_path / "a.tif")
    assert np.array_equal(valid, mask)
    assert np.array_equal(found, np.where(mask[..., None], data, 0))


def test_nothing_is_left_beside_the_file(
    tmp_path: Path, leftovers: Callable[[], list[str]]
) -> None:
    make(tmp_path / "a.tif", "jpeg-mask")
    assert leftovers() == ["a.tif"]


def test_jpeg_tables_are_stored_once(tmp_path: Path) -> None:
    make(tmp_path / "a.tif", "jpeg-mask")
    # two DQT and four DHT segments with the lengths of the standard's tables
    raw = (tmp_path / "a.tif").read_bytes()
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        images = len([page for page in tiff.pages if not page.subfiletype & 4])
    assert raw.count(b"\xff\xdb\x00\x43") == 2 * images
    assert raw.count(b"\xff\xc4\x00") == 4 * images
