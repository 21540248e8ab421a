"""Web tiles: in place, of the right colour, as many as there is picture, or one clear line."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform
from web_tile_cases import (
    SIZE,
    WAVE,
    colours,
    decoded,
    diamond,
    export,
    folder_tiles,
    make_project,
    misplacement,
    placed,
    run_export,
    seen,
    wave_raster,
)

from exports.tiles import web_walk
from exports.tiles.web_picture import WebPicture
from georef_gis.errors import Cancelled, ExportError
from georef_gis.geodesy import Datum, MapFrame, Origin, parse_crs
from georef_gis.project.records import save_frame
from georef_gis.toolbox import CollectingFeedback

FORMATS = {b"\xff\xd8": "jpeg", b"\x89P": "png", b"RI": "webp"}


@pytest.fixture
def project(tmp_path):
    made = make_project(tmp_path / "site")
    yield made
    made.close()


def tiles_of(project, **values):
    folder = export(project, "xyz_tiles", **values)
    return folder_tiles(folder), json.loads((folder / "metadata.json").read_text("utf-8"))


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:6549", "EPSG:4326"])
@pytest.mark.parametrize("tile_size", ["256", "512"])
def test_a_pixel_shows_the_raster_at_its_place(project, crs, tile_size):
    path = wave_raster(project.products / "mosaic.tif", crs)
    tiles, told = tiles_of(project, format="png", tile_size=tile_size)
    places = []
    for col, row, rgba in seen(path, tiles, told["maxzoom"]):
        inside = diamond(col, row) > 3
        assert (rgba[..., 3][inside] == 255).all()
        assert (rgba[..., 3][diamond(col, row) < -3] == 0).all()
        places.append((col[inside], row[inside], rgba[inside][:, :3]))
    col, row, rgb = (np.concatenate(part) for part in zip(*places, strict=True))
    # Bilinear cuts the crests of a wave of 60 px by 0.4 % of 80; 8 bit twice, 1/32 px of remap.
    assert np.abs(rgb - colours(col, row)).max() < 2.0
    assert np.abs(misplacement(col, row, rgb)).max() < 0.02
    # 70 % to 141 % of the pixels along a side: the nearest zoom
    share = len(col) / (np.prod(SIZE) * 2 * 0.45**2)
    assert 0.45 < share < 2.1


def test_pixels_of_kilometres_are_in_place_too(project):
    """Over 64 px of 5 km the projections differ by far more than a pixel: the mesh is finer."""
    col, row = np.meshgrid(np.arange(900) + 0.5, np.arange(700) + 0.5)
    pixels = np.rint(colours(col, row)).astype(np.uint8).transpose(2, 0, 1)
    path = project.products / "mosaic.tif"
    placed(pixels, None, path, crs="EPSG:4326", corner=(-100.0, 75.0), step=0.05)
    tiles, told = tiles_of(project, format="png")
    for col, row, rgba in seen(path, tiles, told["maxzoom"]):
        inside = (rgba[..., 3] == 255) & (col > 2) & (col < 898) & (row > 2) & (row < 698)
        if inside.sum() > 5000:
            shift = misplacement(col[inside], row[inside], rgba[inside][:, :3])
            assert np.abs(shift).max() < 0.1


def test_the_datum_step_of_the_project_is_taken(project):
    """Positions in ITRF2020 lie more than a metre from their NAD83(2011) coordinates in Ohio."""
    frame = MapFrame(
        Origin(lat=np.radians(40.0), lon=np.radians(-83.0), height_ellipsoidal=200.0),
        parse_crs("EPSG:6549"),
        gnss_datum=Datum.parse("ITRF2020@2026.4"),
        crs_datum=Datum.parse("NAD83(2011)@2010.0"),
    )
    save_frame(project.database, frame)
    path = wave_raster(project.products / "mosaic.tif", "EPSG:6549", masked=False)
    _, told = tiles_of(project)
    with rasterio.open(path) as ds:
        west, north = ds.transform.c, ds.transform.f
        plain = transform(ds.crs, "EPSG:4326", [west], [north])
    lat, lon, _ = np.degrees(frame.geo_from_map([west, north, 200.0]))
    # Grid north is not true north, so the corner of the bounds is not the raster's: below 0.4 m
    assert told["bounds"][0] == pytest.approx(lon, abs=4e-6)
    assert told["bounds"][3] == pytest.approx(lat, abs=4e-6)
    step = np.hypot((lon - plain[0][0]) * 85_000, (lat - plain[1][0]) * 111_000)
    assert 0.8 < step < 2.0
    assert abs(told["bounds"][3] - plain[1][0]) > 5e-6


@pytest.mark.parametrize(("format", "mean"), [("auto", 3.0), ("jpeg", 2.0), ("webp", 3.0)])
def test_packing_with_loss_changes_little(project, format, mean):
    path = wave_raster(project.products / "mosaic.tif")
    tiles, told = tiles_of(project, format=format)
    for col, row, rgba in seen(path, tiles, told["maxzoom"]):
        inside = diamond(col, row) > 8
        if inside.any():
            assert np.abs(rgba[inside][:, :3] - colours(col, row)[inside]).mean() < mean


@pytest.mark.parametrize(
    ("format", "kinds", "told"),
    [("auto", {"jpeg", "webp"}, "webp"), ("jpeg", {"jpeg"}, "jpg"), ("webp", {"webp"}, "webp"),
     ("png", {"png"}, "png")],
)  # fmt: skip
def test_formats_inside_and_along_the_rim(project, format, kinds, told):
    wave_raster(project.products / "mosaic.tif")
    tiles, metadata = tiles_of(project, format=format, max_zoom=23)
    assert {FORMATS[data[:2]] for data in tiles.values()} == kinds
    assert metadata["format"] == told
    assert metadata["tiles"] == [f"{{z}}/{{x}}/{{y}}.{told}"]
    if format == "auto":
        opaque = [decoded(d)[..., 3].min() == 255 for d in tiles.values() if d[:2] == b"\xff\xd8"]
        assert all(opaque)


def test_jpeg_is_white_beside_the_mosaic(project):
    path = wave_raster(project.products / "mosaic.tif")
    tiles, told = tiles_of(project, format="jpeg", quality=95)
    outside = [
        rgba[diamond(col, row) < -20][:, :3]
        for col, row, rgba in seen(path, tiles, told["maxzoom"])
    ]
    assert np.concatenate(outside).min() > 245


def test_a_tile_is_the_mean_of_the_valid_pixels_of_its_children(project):
    wave_raster(project.products / "mosaic.tif")
    tiles, _ = tiles_of(project, format="png")
    for (z, x, y), data in tiles.items():
        four = np.zeros((512, 512, 4))
        kids = [(j, i) for j in (0, 1) for i in (0, 1) if (z + 1, 2 * x + i, 2 * y + j) in tiles]
        for j, i in kids:
            child = decoded(tiles[z + 1, 2 * x + i, 2 * y + j])
            four[j * 256 : (j + 1) * 256, i * 256 : (i + 1) * 256] = child
        if not kids:
            continue
        alpha = four[..., 3:]
        cells = np.concatenate([four[..., :3] * alpha, alpha], axis=2).reshape(256, 2, 256, 2, 4)
        total = cells.sum(axis=(1, 3))
        mine = decoded(data).astype(float)
        assert np.abs(mine[..., 3] - total[..., 3] / 4).max() <= 0.5
        # Where alpha is small, 8-bit premultiplied colour says little.
        solid = mine[..., 3] > 200
        mean = total[solid][:, :3] / total[solid][:, 3:]
        assert np.abs(mine[solid][:, :3] - mean).max() < 2.5


def test_zooms_can_be_chosen(project):
    path = wave_raster(project.products / "mosaic.tif")
    tiles, told = tiles_of(project, format="png", min_zoom=15, max_zoom=20)
    assert {z for z, _, _ in tiles} == set(range(15, 21))
    assert (told["minzoom"], told["maxzoom"]) == (15, 20)
    # 3.3 px of the raster are a pixel: places hold, the wave is a little lower.
    col, row, rgba = next(seen(path, tiles, 20))
    inside = diamond(col, row) > 10
    assert np.abs(misplacement(col[inside], row[inside], rgba[inside][:, :3])).max() < 0.1


def test_one_pixel_in_a_raster_without_overviews_is_not_passed_over(project):
    """A checkerboard of single pixels gives grey at a zoom whose pixels are 13 of them wide."""
    board = (np.indices((512, 512)).sum(axis=0) % 2 * 255).astype(np.uint8)[None]
    placed(board, None, project.products / "mosaic.tif", cog=False)
    tiles, _ = tiles_of(project, format="png", max_zoom=18)
    grey = np.concatenate([decoded(d)[decoded(d)[..., 3] == 255][:, 0] for d in tiles.values()])
    # Bilinear and bytes round to both sides.
    assert np.abs(grey.astype(float) - 127.5).max() < 12


def test_one_band_is_grey(project):
    band = np.tile(np.linspace(20, 200, 600).astype(np.uint8), (500, 1))[None]
    placed(band, None, project.products / "mosaic.tif")
    tiles, _ = tiles_of(project, format="png")
    for data in tiles.values():
        rgba = decoded(data)
        assert (rgba[..., 0] == rgba[..., 1]).all()
        assert (rgba[..., 0] == rgba[..., 2]).all()
    assert max(decoded(data).max(axis=(0, 1))[0] for data in tiles.values()) >= 198


def test_of_four_bands_the_colours_are_shown(project):
    levels = np.array([50, 100, 150, 255], np.uint8)[:, None, None]
    path = placed(np.tile(levels, (1, 400, 400)), None, project.products / "mosaic.tif")
    assert path.is_file()
    tiles, _ = tiles_of(project, format="png")
    inside = np.concatenate([decoded(d)[decoded(d)[..., 3] == 255] for d in tiles.values()])
    assert (inside[:, :3] == (50, 100, 150)).all()


def test_16_bit_is_stretched_and_that_is_said(project):
    ramp = np.tile(np.linspace(1000, 5000, 600).astype(np.uint16), (3, 500, 1))
    placed(ramp, None, project.products / "mosaic.tif")
    result = run_export(project, "xyz_tiles", format="png")
    (warning,) = result.warnings
    low, high = map(float, re.search(r"\(([\d.]+) to ([\d.]+)", warning).groups())
    # 1 % and 99 % of a ramp from 1000 to 5000, read from an overview
    assert low == pytest.approx(1040, abs=20)
    assert high == pytest.approx(4960, abs=20)
    folder = result.outputs["target"]
    tiles = folder_tiles(folder)
    values = np.concatenate([decoded(d)[decoded(d)[..., 3] == 255][:, 0] for d in tiles.values()])
    assert (values.min(), values.max()) == (0, 255)
    assert np.median(values) == pytest.approx(127, abs=4)


def test_a_diagonal_corridor_does_not_pay_for_its_box(project, monkeypatch):
    side = 4000
    mask = np.zeros((side, side), np.uint8)
    for at in range(0, side, 100):
        mask[at : at + 100, max(0, at - 100) : at + 200] = 255
    placed((mask // 2)[None], mask, project.products / "mosaic.tif")
    asked = []
    block = WebPicture.block
    monkeypatch.setattr(WebPicture, "block", lambda *a: asked.append(a) or block(*a))
    monkeypatch.setattr(web_walk, "BLOCK", 256)
    tiles, told = tiles_of(project)
    pixel = 40075016.7 / 256 / 2 ** told["maxzoom"] * np.cos(np.radians(40.0))
    across = side * 0.05 / pixel / 256
    # The blocks on a diagonal and its neighbours, of across x across in the box
    assert across > 12
    assert len(asked) < 4 * across
    assert sum(z == told["maxzoom"] for z, _, _ in tiles) > across


def test_a_raster_without_valid_pixels_is_refused(project):
    empty = np.zeros((1, 400, 400), np.uint8)
    placed(empty, empty[0], project.products / "mosaic.tif")
    with pytest.raises(ExportError, match="no valid pixel"):
        export(project, "xyz_tiles")
    assert [p.name for p in project.products.iterdir()] == ["mosaic.tif"]


def test_too_many_tiles_are_refused_with_a_cure_that_works(project):
    world = np.full((1, 100, 100), 100, np.uint8)
    path = placed(world, None, project.products / "mosaic.tif", crs="EPSG:4326", step=0.1)
    with pytest.raises(ExportError, match=r"about 1\.\de\+09 tiles down to zoom 20") as caught:
        export(project, "xyz_tiles", max_zoom=20)
    cure = int(re.search(r"give max_zoom (\d+) or less", str(caught.value))[1])
    from exports.tiles.options import TileOptions
    from exports.tiles.web_plan import MOST_TILES, plan_tiles

    with WebPicture(path, None) as picture:
        options = TileOptions(max_zoom=cure)
        assert plan_tiles(picture, "m", options, "", "").max_zoom == cure
        with pytest.raises(ExportError, match="more than"):
            plan_tiles(picture, "m", TileOptions(max_zoom=cure + 1), "", "")
    assert MOST_TILES == 10_000_000


def test_smallest_zoom_above_the_largest_is_refused(project):
    wave_raster(project.products / "mosaic.tif")
    with pytest.raises(ExportError, match="min_zoom 21 is larger than max_zoom 20"):
        export(project, "mbtiles", min_zoom=21, max_zoom=20)


@pytest.mark.parametrize(
    ("crs", "corner", "step", "match"),
    [
        ("EPSG:32601", (100_000.0, 2e6), 2000.0, "180th meridian"),
        ("EPSG:5041", (0.0, 4e6), 50_000.0, "180th meridian or holds a pole"),
        ("EPSG:4326", (0.0, 89.9), 0.05, "beyond 85.05 deg"),
    ],
)
def test_where_web_mercator_ends_is_one_clear_line(project, crs, corner, step, match):
    pixels = np.full((1, 80, 80), 100, np.uint8)
    placed(pixels, None, project.products / "mosaic.tif", crs=crs, corner=corner, step=step)
    with pytest.raises(ExportError, match=match) as caught:
        export(project, "xyz_tiles")
    assert "\n" not in str(caught.value)


def test_beyond_85_degrees_is_cut_off_and_said(project):
    pixels = np.full((1, 80, 80), 100, np.uint8)
    path = project.products / "mosaic.tif"
    placed(pixels, None, path, crs="EPSG:4326", corner=(0.0, 88.0), step=0.1)
    result = run_export(project, "xyz_tiles")
    assert "85.05 deg" in result.warnings[0]
    told = json.loads((result.outputs["target"] / "metadata.json").read_text("utf-8"))
    assert told["bounds"][3] == pytest.approx(85.0511, abs=1e-4)
    assert min(y for _, _, y in folder_tiles(result.outputs["target"])) == 0


@pytest.mark.parametrize("name", ["xyz_tiles", "mbtiles", "pmtiles"])
def test_a_cancelled_export_leaves_nothing(project, name):
    wave_raster(project.products / "mosaic.tif")
    feedback = CollectingFeedback(stop_at=0.3)
    with pytest.raises(Cancelled):
        run_export(project, name, feedback, max_zoom=24)
    assert 0.3 <= feedback.fractions[-1] < 1.0
    assert [p.name for p in project.products.iterdir()] == ["mosaic.tif"]


FULL_DISK = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from web_tile_cases import run_export
from georef_gis.project import Project
project = Project.open(sys.argv[1])
project.database.count("photo")
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), int(sys.argv[3])))
try:
    run_export(project, sys.argv[2])
except Exception as error:
    print(type(error).__name__, error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
@pytest.mark.parametrize(
    ("name", "limit"), [("xyz_tiles", 2000), ("mbtiles", 60_000), ("pmtiles", 20_000)]
)
def test_a_full_disk_is_one_line_and_leaves_nothing(project, name, limit):
    """A limit of file sizes stands in for the full disk: writing fails half way."""
    wave_raster(project.products / "mosaic.tif")
    run = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(project.folder), name, str(limit)],
        capture_output=True, text=True, cwd=Path(__file__).parent,
    )  # fmt: skip
    (line,) = run.stdout.splitlines()
    assert line.startswith("ExportError"), run.stderr
    assert "cannot be written" in line
    assert "check free space" in line
    assert [p.name for p in project.products.iterdir()] == ["mosaic.tif"]


def test_progress_only_grows_and_ends_at_one(project):
    wave_raster(project.products / "mosaic.tif")
    feedback = CollectingFeedback()
    run_export(project, "xyz_tiles", feedback)
    assert feedback.fractions == sorted(feedback.fractions)
    assert feedback.fractions[-1] == 1.0
    assert len(feedback.fractions) > 4


def test_a_damaged_raster_is_one_line_and_leaves_nothing(project):
    path = wave_raster(project.products / "mosaic.tif")
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2 : -200] = bytes(len(raw) - 200 - len(raw) // 2)
    path.write_bytes(raw)
    with pytest.raises(ExportError, match=r"cannot be read .*check that the file is whole"):
        export(project, "mbtiles")
    assert [p.name for p in project.products.iterdir()] == ["mosaic.tif"]


def test_wave_is_longer_than_a_few_pixels():
    """The tolerances above rest on it."""
    assert 0.5 * (2 * np.pi / WAVE / 2) ** 2 * 80 < 0.2
