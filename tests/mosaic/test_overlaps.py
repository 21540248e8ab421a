"""What two photos show of the same ground: which pairs, which blocks, which values."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.coarse import Proxy
from georef_gis.mosaic.overlaps import (
    Gathered,
    Overlaps,
    OverlapSettings,
    choose_pairs,
    gather_overlaps,
)

SETTINGS = OverlapSettings(value_range=(0.0, 255.0))


def ground(cols: NDArray[np.generic], rows: NDArray[np.generic]) -> NDArray[np.float32]:
    """Two smooth bands over the whole site."""
    one = 100.0 + 40.0 * np.sin(cols / 60.0) * np.cos(rows / 50.0)
    return np.stack([one, 0.5 * one + 0.1 * cols], axis=-1).astype(np.float32)


@dataclass
class Site:
    """Photos of the same ground through gains of their own; counts how often each is loaded."""

    windows: list[Window]
    gain: list[float]
    loads: Counter[int] = field(default_factory=Counter)
    patches: dict[int, tuple[slice, slice, object]] = field(default_factory=dict)
    holes: dict[int, tuple[slice, slice]] = field(default_factory=dict)

    @property
    def ids(self) -> list[str]:
        return [f"p{i}" for i in range(len(self.windows))]

    def load(self, index: int) -> Proxy:
        self.loads[index] += 1
        w = self.windows[index]
        cols, rows = np.meshgrid(w.col + np.arange(w.width), w.row + np.arange(w.height))
        data = ground(cols, rows) * np.float32(self.gain[index])
        valid = np.ones(data.shape[:2], np.bool_)
        if index in self.patches:
            r, c, value = self.patches[index]
            data[r, c] = value
        if index in self.holes:
            valid[self.holes[index]] = False
        return Proxy(
            photo_id=f"p{index}", window=w, data=data, valid=valid,
            distance=np.zeros(data.shape[:2], np.float32),
        )  # fmt: skip

    def place(
        self, index: int, cols: NDArray[np.float64], rows: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        w = self.windows[index]
        xy = np.stack([cols - w.col - w.width / 2, rows - w.row - w.height / 2], axis=-1) / 250.0
        return xy, -xy / 2.0

    def gather(self, settings: OverlapSettings = SETTINGS) -> Overlaps:
        return self.all(settings).overlaps

    def all(self, settings: OverlapSettings = SETTINGS) -> Gathered:
        return gather_overlaps(self, self.place, settings=settings)


def two(**kwargs: object) -> Site:
    """Photos of 200 x 160 that share columns 83 to 200, which no block fits exactly."""
    windows = [
        Window(col=0, row=-3, width=200, height=160),
        Window(col=83, row=5, width=200, height=160),
    ]
    return Site(windows, [1.0, 1.25], **kwargs)  # type: ignore[arg-type]


def lattice(rows: int, cols: int) -> list[Window]:
    return [
        Window(col=60 * c, row=70 * r, width=200, height=160)
        for r in range(rows)
        for c in range(cols)
    ]


def test_both_photos_are_averaged_over_the_same_ground() -> None:
    site = two()
    found = site.gather()
    # columns 88 to 200 and rows 8 to 152 in blocks of 8
    assert len(found) == 150 <= 14 * 18
    assert set(found.a) == {0}
    assert set(found.b) == {1}
    np.testing.assert_allclose(found.value_b, 1.25 * found.value_a, rtol=1e-5)
    # the same place on the ground from either photo
    centre = np.array([[100.0, 77.0], [183.0, 85.0]])
    np.testing.assert_allclose(
        found.xy_a * 250 + centre[0], found.xy_b * 250 + centre[1], atol=1e-3
    )
    np.testing.assert_allclose(found.view_a, -found.xy_a / 2)
    cols, rows = (found.xy_a * 250 + centre[0]).T
    # centres of whole blocks
    assert set(np.round(cols % 8, 3)) == set(np.round(rows % 8, 3)) == {4.0}
    inner = np.arange(8) - 4.0
    for col, row, value in zip(cols, rows, found.value_a, strict=True):
        want = ground(*np.meshgrid(col + inner, row + inner)).mean(axis=(0, 1))
        np.testing.assert_allclose(value, want, rtol=1e-5)


def test_chosen_blocks_are_spread_over_the_overlap() -> None:
    found = two().gather(replace(SETTINGS, blocks_per_pair=30))
    assert len(found) == 30
    # in each quarter of the overlap about a quarter of them
    low, high = found.xy_a.min(axis=0), found.xy_a.max(axis=0)
    quarter = (found.xy_a > (low + high) / 2) @ [1, 2]
    assert np.bincount(quarter, minlength=4).min() >= 5


def test_what_a_photo_does_not_show_is_left_out() -> None:
    hole = (slice(0, 100), slice(0, 200))
    found = two(holes={0: hole}).gather()
    rows = found.xy_a[:, 1] * 250 + 77.0
    assert len(found) > 50
    # the hole ends at row 97; the first whole block below begins at 104
    assert rows.min() == pytest.approx(108.0, abs=1e-3)


@pytest.mark.parametrize("value", [254.0, 0.5, np.nan])
def test_blocks_with_a_clipped_pixel_are_left_out(value: float) -> None:
    patch = (slice(80, 81), slice(0, 200), value)
    rows = two(patches={0: patch}).gather().xy_a[:, 1] * 250 + 77.0
    # row 80 of the photo is row 77 of the grid, in the block of rows 72 to 80
    assert len(rows) == 150
    assert 76.0 not in np.round(rows, 3)
    assert 68.0 in np.round(rows, 3)


def test_a_clipped_band_leaves_the_others() -> None:
    patch = (slice(80, 81), slice(0, 200), [254.0, 100.0])
    found = two(patches={0: patch}).gather(replace(SETTINGS, blocks_per_pair=1000))
    rows = np.round(found.xy_a[:, 1] * 250 + 77.0, 3)
    here = rows == 76.0
    assert here.any()
    assert (found.weight[here, 0] == 0.0).all()
    assert (found.weight[here, 1] > 0.0).all()
    assert (found.weight[~here] > 0.0).all()
    assert found.known_bands.all()


def test_a_band_that_is_white_everywhere_hides_no_block() -> None:
    whole = (slice(0, 160), slice(0, 200), [[255.0, 90.0]])
    found = two(patches={0: whole, 1: whole}).gather()
    assert len(found) == 150
    np.testing.assert_array_equal(found.known_bands, [False, True])


def test_data_without_an_end_are_never_clipped() -> None:
    patch = (slice(80, 81), slice(0, 200), 254.0)
    settings = replace(SETTINGS, value_range=None, blocks_per_pair=1000)
    rows = two(patches={0: patch}).gather(settings).xy_a[:, 1] * 250 + 77.0
    assert 76.0 in np.round(rows, 3)


def test_strong_texture_counts_less() -> None:
    patch = (slice(80, 84), slice(0, 200), 200.0)
    found = two(patches={0: patch}).gather(replace(SETTINGS, blocks_per_pair=1000))
    # the patch covers rows 77 to 81 of the grid, in the blocks from 72 and from 80
    rough = np.abs(found.xy_a[:, 1] * 250 + 77.0 - 80.0) < 5.0
    assert found.weight[rough].max() < 0.1
    assert found.weight[~rough].min() > 0.5


def test_pairs_across_the_strips_are_compared_as_well() -> None:
    windows = [Window(col=10 * c, row=120 * r, width=200, height=160)
               for r in range(2) for c in range(40)]  # fmt: skip
    pairs = choose_pairs(windows, 6)
    across = (pairs[:, 0] < 40) & (pairs[:, 1] >= 40)
    # of 95 % overlap along and 25 % across, each photo has a partner in the other strip
    assert len(np.unique(pairs[across])) == 80
    assert (pairs[:, 0] < pairs[:, 1]).all()


def test_the_number_of_pairs_grows_with_the_photos_only() -> None:
    counts = [len(choose_pairs(lattice(n, n), 6)) / n**2 for n in (8, 16)]
    assert max(counts) <= 6.0
    assert counts[1] == pytest.approx(counts[0], rel=0.25)


def test_each_photo_is_loaded_once() -> None:
    windows = lattice(12, 12)
    site = Site(windows, [1.0] * len(windows))
    site.gather()
    assert set(site.loads.values()) == {1}


def test_with_little_memory_each_photo_is_loaded_about_once() -> None:
    windows = lattice(12, 12)
    site = Site(windows, [1.0] * len(windows))
    found = site.gather(replace(SETTINGS, kept=40, blocks_per_pair=5))
    assert site.loads.total() <= 1.6 * len(windows)
    everything = Site(windows, [1.0] * len(windows)).gather(replace(SETTINGS, blocks_per_pair=5))
    np.testing.assert_array_equal(found.value_b, everything.value_b)


def test_the_number_of_blocks_has_a_bound() -> None:
    windows = lattice(6, 6)
    site = Site(windows, [1.0] * len(windows))
    assert 500 < len(site.gather(replace(SETTINGS, blocks_in_all=1000))) <= 1000


@pytest.mark.parametrize("count", [0, 1, 2])
def test_photos_that_do_not_meet_give_nothing(count: int) -> None:
    windows = [Window(col=500 * i, row=0, width=200, height=160) for i in range(count)]
    found = Site(windows, [1.0] * count).gather()
    assert len(found) == 0
    assert found.bands == (2 if count else 1)


def test_a_photo_smaller_than_a_block_gives_nothing() -> None:
    windows = [Window(col=1, row=1, width=6, height=6), Window(col=0, row=0, width=80, height=80)]
    assert len(Site(windows, [1.0, 1.0]).gather()) == 0


def test_pixels_are_kept_clipped_or_not_and_with_their_place() -> None:
    patch = (slice(0, 80), slice(0, 200), 255.0)
    samples = two(patches={0: patch}).all().samples
    assert np.bincount(samples.photo).tolist() == [150, 150]
    assert 0.3 < (samples.value[samples.photo == 0] == 255.0).all(axis=1).mean() < 0.7
    # in the photo's own window, at the centres of pixels' blocks
    of_b = samples.place[samples.photo == 1]
    assert of_b[:, 0].min() > 83
    assert of_b[:, 0].max() < 283
    want = ground(*(of_b.T - 0.5 + 0.5)) * 1.25
    np.testing.assert_allclose(samples.value[samples.photo == 1], want, rtol=0.02)


def test_many_photos_keep_few_pixels_each() -> None:
    windows = lattice(6, 6)
    site = Site(windows, [1.0] * len(windows))
    samples = site.all(replace(SETTINGS, samples_in_all=36 * 30)).samples
    assert set(np.bincount(samples.photo)) == {30}


def test_the_nearest_nadir_shows_the_ground() -> None:
    flat = np.zeros((4, 2), np.float32)
    samples = Samples(
        photo=np.array([0, 0, 2, 2]), value=flat, xy=flat, view=flat,
        place=np.array([[1, 0], [7, 0], [7, 0], [3, 0]], np.float32),
        nadir=np.array([[0, 0], [0, 0], [10, 0], [10, 0]], np.float32),
    )  # fmt: skip
    np.testing.assert_array_equal(samples.nearest(), [True, False, True, False])
    assert Samples.joined([], 3).nearest().shape == (0,)
