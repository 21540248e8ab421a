"""Parts of the comparison: confidence, regions, outlines, notes of large grids."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from change_cases import CRS, LEFT, TOP, Image, Look, render
from rasterio.warp import transform_bounds

from georef_gis.errors import ExportError
from georef_gis.measure.change import cell_map
from georef_gis.measure.change.candidates import join
from georef_gis.measure.change.cell_map import average_map, work_folder
from georef_gis.measure.change.confidence import MOST, fit_mixture
from georef_gis.measure.change.extent import cells_of
from georef_gis.measure.change.layer import write_geopackage
from georef_gis.measure.change.outline import outline
from georef_gis.measure.change.pair import common_cells, open_pair
from georef_gis.measure.change.shown import Shown
from georef_gis.measure.change.unrest import Unrest
from georef_gis.rasters.resampled import MapHeader, open_bands_on

THRESHOLD = 4.0


def _header(width: int, height: int) -> MapHeader:
    return MapHeader(
        name="grid", width=width, height=height, transform=(1.0, 0.0, 0.0, 0.0, -1.0, 0.0),
        crs_wkt="", epsg=None, dtype="uint8", bands=("",), scales=((1.0, 0.0),),
    )  # fmt: skip


@pytest.mark.parametrize(("null", "changed"), [(300, 20), (100, 10), (60, 40)])
def test_confidence_is_the_part_that_is_real(null: int, changed: int) -> None:
    said, real = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        scores = THRESHOLD + np.concatenate(
            [rng.exponential(1.0, null), rng.exponential(12.0, changed)]
        )
        said.append(fit_mixture(scores, THRESHOLD).confidence(scores))
        real.append(np.arange(null + changed) >= null)
    confidence, truth = np.concatenate(said), np.concatenate(real)
    for low, high in ((0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        some = (confidence >= low) & (confidence < high)
        # a hundred regions in each part: the deviation of their share is 5 %; priors make the
        # middle say too little where there are few regions
        assert -0.1 < truth[some].mean() - confidence[some].mean() < 0.2


def test_site_without_changes_has_none() -> None:
    false = 0
    for seed in range(50):
        scores = THRESHOLD + np.random.default_rng(seed).exponential(1.0, 100)
        false += int((fit_mixture(scores, THRESHOLD).confidence(scores) >= 0.5).sum())
    # of 5000 regions
    assert false <= 10


def test_restless_site_raises_what_a_change_must_score() -> None:
    calm = THRESHOLD + np.random.default_rng(0).exponential(1.0, 200)
    restless = THRESHOLD + np.random.default_rng(0).exponential(3.0, 200)
    one = np.array([THRESHOLD + 10.0])
    assert fit_mixture(calm, THRESHOLD).confidence(one)[0] > 0.5
    assert fit_mixture(restless, THRESHOLD).confidence(one)[0] < 0.2


def test_no_region_is_ever_certain_and_none_is_no_trouble() -> None:
    mixture = fit_mixture(np.zeros(0), THRESHOLD)
    assert mixture.confidence(np.array([1e6]))[0] == MOST
    assert len(mixture.confidence(np.zeros(0))) == 0


def test_cells_that_touch_or_nearly_touch_are_a_region() -> None:
    rows = np.array([0, 0, 1, 5, 5, 9])
    cols = np.array([0, 1, 3, 0, 9, 9])
    regions = join(rows, cols, np.arange(6, dtype=np.float32), 10)
    found = sorted(sorted(zip(r.rows.tolist(), r.cols.tolist(), strict=True)) for r in regions)
    assert found == [[(0, 0), (0, 1), (1, 3)], [(5, 0)], [(5, 9)], [(9, 9)]]


def test_end_of_a_row_does_not_touch_the_start_of_the_next() -> None:
    regions = join(np.array([0, 1]), np.array([9, 0]), np.ones(2, np.float32), 10)
    assert len(regions) == 2


def test_outline_has_the_area_of_a_soft_disc() -> None:
    y, x = np.mgrid[:80, :80].astype(np.float32)
    for radius in (2.5, 5.0, 12.0):
        disc = 1.0 / (1.0 + np.exp(np.minimum((np.hypot(x - 40.3, y - 39.8) - radius) / 0.6, 50.0)))
        field = (10.0 * disc + 1.0).astype(np.float32)
        found = outline(field, disc > 0.7, (100, 200))
        assert found is not None
        area = np.pi * radius**2
        # cells^2; a tenth of a cell along the rim, and what the rim itself says
        assert abs(found.area - area) < 0.1 * 2 * np.pi * radius + 0.5 * found.sigma
        centre = found.shape.centroid
        # the middle of a cell is half a cell from its corner
        np.testing.assert_allclose((centre.x, centre.y), (140.8, 240.3), atol=0.15)


def test_outline_has_holes() -> None:
    y, x = np.mgrid[:80, :80].astype(np.float32)
    r = np.hypot(x - 40, y - 40)
    ring = (np.clip(20.5 - r, 0, 1) * np.clip(r - 9.5, 0, 1)).astype(np.float32)
    found = outline(ring, ring > 0.7, (0, 0))
    assert found is not None
    # cells^2
    np.testing.assert_allclose(found.area, np.pi * (20**2 - 10**2), rtol=0.03)


def test_flat_field_has_no_outline() -> None:
    cells = np.zeros((40, 40), np.bool_)
    cells[10:20, 10:20] = True
    assert outline(np.ones((40, 40), np.float32), cells, (0, 0)) is None


def test_cells_shown_are_kept_as_noted() -> None:
    rng = np.random.default_rng(0)
    truth = rng.random((50, 37)) < 0.5
    shown = Shown.over(_header(37, 50))
    for col in (0, 16, 32):
        width = min(16, 37 - col)
        shown.note((col, 0, width, 50), truth[:, col : col + width])
    np.testing.assert_array_equal(shown.read((8, 5, 21, 30)), truth[5:35, 8:29])


def test_unrest_is_of_the_surroundings_not_of_the_place_itself() -> None:
    scores = np.abs(np.random.default_rng(0).normal(0, 1, (640, 1280))).astype(np.float32)
    scores[:, 640:] *= 5.0
    scores[300:330, 300:330] = 50.0
    unrest = Unrest.over(_header(1280, 640))
    unrest.note(scores, (0, 0, 1280, 640))
    here = np.array([310]), np.array([310])
    there = np.array([310]), np.array([1000])
    assert unrest.about(*here) < 1.3
    assert unrest.about(*there) > 4.0


def test_map_is_kept_on_cells_as_it_is_read_there(site: Image, tmp_path: Path) -> None:
    path = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    header = common_cells(path, path, 0.1).header
    moved = (1.0, 0.0, 3.4, 0.0, 1.0, -2.3)
    area = (-7, -7, header.width + 14, header.height + 14)
    kept = average_map(path, header, tmp_path / "kept", area=area, placed=moved)
    window = (40, 50, 60, 30)
    with open_bands_on(path, header, moved=moved) as bands:
        samples, valid = bands.read(window, [1, 2, 3])
    read, shown = kept.read(window)
    # grey values; blocks are warped apart from each other
    np.testing.assert_allclose(read.astype(float), samples, atol=1.0)
    np.testing.assert_array_equal(shown, valid.all(axis=2))
    beyond = kept.read((-50, 0, 40, 10))
    assert not beyond[1].any()


def test_work_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    missing = tmp_path / "none"
    with pytest.raises(ExportError, match="permission"), work_folder(missing):
        pass


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:26917", "EPSG:32616"])
def test_room_for_a_shift_ends_with_the_map(site: Image, tmp_path: Path, crs: str) -> None:
    later = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    header = common_cells(later, later, 0.1).header
    left, _, right, top = transform_bounds(CRS, crs, LEFT, TOP - 26.0, LEFT + 26.0, TOP)
    earlier = tmp_path / "other.tif"
    with rasterio.open(
        earlier, "w", driver="GTiff", width=100, height=200, count=1, dtype="uint8", crs=crs,
        transform=rasterio.Affine((right - left) / 100, 0, left, 0, -0.2, top),
    ) as file:  # fmt: skip
        file.write(np.full((1, 200, 100), 9, np.uint8))
    col, row, width, height = cells_of(earlier, header, margin=100)
    # cells of 0.1 m: maps of another zone lie turned by 0.07 on each other
    turned = 30 if crs == "EPSG:32616" else 0
    assert -10 - turned <= col < 0
    assert -10 - turned <= row < 0
    assert width <= header.width + 20 + 3 * turned
    # the map ends 14 m beyond the grid
    assert row + height == header.height + 100


def test_grid_cut_to_the_map_shows_the_same(site: Image, tmp_path: Path) -> None:
    later = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    earlier = render(tmp_path / "two.tif", site, Look(origin=(3.0, 2.0)), np.random.default_rng(1))
    cells = common_cells(later, earlier, 0.1)
    window, inside = (-40, -30, 400, 350), (10, 10, 150, 200)
    wider = (-110, -110, cells.header.width + 220, cells.header.height + 220)
    with open_pair(later, earlier, cells, most=10.0) as pair:
        assert pair.earlier.shape[0] < cells.header.height + 40 < wider[3] - 100
        shown, values = pair.earlier.read(window)[1], pair.earlier.read(inside)[0]
    wide = average_map(earlier, cells.header, tmp_path / "wide", area=wider)
    np.testing.assert_array_equal(shown, wide.read(window)[1])
    grid = average_map(earlier, cells.header, tmp_path / "grid")
    # grey values; blocks are warped apart from each other
    np.testing.assert_allclose(values.astype(float), grid.read(inside)[0], atol=1.0)


def test_files_that_a_killed_comparison_left_are_removed(tmp_path: Path) -> None:
    names = ("dead", "starting", "unlocked", "unlocked_old")
    dead, starting, unlocked, unlocked_old = (tmp_path / f"change_{name}" for name in names)
    for folder in (dead, starting, unlocked, unlocked_old):
        folder.mkdir()
        (folder / "later.samples").write_bytes(b"x")
    for folder in (dead, starting):
        (folder / cell_map._LOCK).touch()
    with work_folder(tmp_path) as living:
        hour, days = (time.time() - past for past in (3600.0, 200_000.0))
        for folder, at in ((dead, hour), (unlocked, hour), (unlocked_old, days), (living, days)):
            os.utime(folder, (at, at))
        with work_folder(tmp_path):
            left = [folder for folder in (dead, unlocked_old) if folder.exists()]
            assert left == []
            assert all(folder.is_dir() for folder in (starting, unlocked, living))
    assert not living.exists()


def test_layer_that_cannot_be_written_leaves_the_old_one_its_journal(tmp_path: Path) -> None:
    target, journal = tmp_path / "old.gpkg", tmp_path / "old.gpkg-wal"
    # a folder, which no file takes the place of
    target.mkdir()
    journal.write_bytes(b"what a GIS did last")
    with pytest.raises(ExportError, match="cannot be written"):
        write_geopackage(target, [], "")
    assert journal.read_bytes() == b"what a GIS did last"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old.gpkg", "old.gpkg-wal"]


def test_full_disk_is_one_line(
    site: Image, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    header = common_cells(path, path, 0.1).header

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cell_map, "_strip", full)
    with pytest.raises(ExportError, match=r"\d MB or more.*No space.*--cell.*--max-shift"):
        average_map(path, header, tmp_path / "kept")
