from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from raster_cases import make_profile, smooth, write

from georef_gis.errors import ExportError
from georef_gis.rasters import space
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.space import check_room, space_needed
from georef_gis.rasters.writer import TiledWriter

TRANSFORM = (0.25, 0.0, 500_000.0, 0.0, -0.25, 4_400_000.0)


def _profile(side: int, **changes: object) -> RasterProfile:
    return RasterProfile(width=side, height=side, transform=TRANSFORM, **changes)  # type: ignore[arg-type]


def _free(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free: int) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=free)
    monkeypatch.setattr(space.shutil, "disk_usage", lambda path: usage)


def test_space_grows_with_the_tiles_written_and_not_with_the_bounding_box() -> None:
    few, many = space_needed(_profile(512_000), 1500), space_needed(_profile(512_000), 150_000)
    dense = space_needed(_profile(512 * 39), 39 * 39)
    # bytes: only the directories of 10^6 tiles are added, 12 for each image and each mask
    assert few.file - dense.file < 1.35 * 24e6
    assert many.file > 40 * few.file


@pytest.mark.parametrize("compression", ["jpeg", "webp", "deflate", "zstd"])
def test_the_estimate_is_of_the_size_of_a_picture(tmp_path: Path, compression: str) -> None:
    rng = np.random.default_rng(7)
    noise = rng.normal(0, 6, (1024, 1024, 3))
    data = np.clip(smooth(1024, 1024, 3) + noise, 0, 255).astype(np.uint8)
    profile = write(tmp_path / "a.tif", data, compression=compression, tile_size=512)
    found = (tmp_path / "a.tif").stat().st_size
    # pictures of other contents differ this much
    assert 0.4 < found / space_needed(profile, 4).file < 2.5


def test_a_disk_without_room_is_told_with_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = _profile(100_000)
    needed = space_needed(profile, 196 * 196)
    _free(monkeypatch, tmp_path, 100_000_000)
    with pytest.raises(ExportError, match=r"about [\d.]+ GB .* 0\.1 GB are free; free some") as e:
        check_room(tmp_path / "a.tif", profile, 196 * 196, work=tmp_path / "later" / "work")
    assert f"{(needed.file + needed.work) / 1e9:.3g} GB" in str(e.value)
    assert not (tmp_path / "later").exists()


def test_a_disk_with_room_is_not_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = space_needed(_profile(100_000), 196 * 196)
    _free(monkeypatch, tmp_path, needed.file + needed.work)
    check_room(tmp_path / "a.tif", _profile(100_000), 196 * 196)


def test_two_disks_are_asked_each_for_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed = space_needed(_profile(100_000), 196 * 196)
    monkeypatch.setattr(space, "same_disk", lambda first, second: False)
    _free(monkeypatch, tmp_path, max(needed.file, needed.work))
    check_room(tmp_path / "a.tif", _profile(100_000), 196 * 196, work=tmp_path)
    _free(monkeypatch, tmp_path, needed.file // 2)
    with pytest.raises(ExportError, match="are needed on the disk of"):
        check_room(tmp_path / "a.tif", _profile(100_000), 196 * 196, work=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("lasting", [False, True])
def test_a_diagonal_corridor_costs_its_tiles_and_the_directories(
    tmp_path: Path, lasting: bool
) -> None:
    side, size = 1000, 16
    tile = smooth(size, size, 3)
    profile = make_profile(
        np.broadcast_to(np.uint8(0), (side * size, side * size, 3)), tile_size=size
    )
    places = [(i, i) for i in range(side)] + [(i, i + 1) for i in range(0, 999, 2)]
    options = {"resume": "a", "work": tmp_path / "work"} if lasting else {}
    start = time.process_time()
    with TiledWriter(tmp_path / "a.tif", profile, **options) as writer:  # type: ignore[arg-type]
        for row, col in places:
            writer.write_tile(row, col, tile)
        most = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    cpu_s = time.process_time() - start
    assert len(places) == 1500
    # bytes: offset and length of 4/3 million tiles and masks, and less than 700 a tile
    floor = 2 * 8 * side * side * 4 / 3
    assert floor < (tmp_path / "a.tif").stat().st_size < 1.01 * floor + 1500 * 1.5 * 700
    assert most < 1500 * 4 / 3 * (700 + 4 * size * size)
    # CPU seconds, ten times what was measured
    assert cpu_s < 15
    with rasterio.open(tmp_path / "a.tif") as dataset:
        window = rasterio.windows.Window(500 * size, 500 * size, size, size)
        assert dataset.read(1, window=window).any()
        window = rasterio.windows.Window(100 * size, 900 * size, size, size)
        assert not dataset.read_masks(1, window=window).any()
