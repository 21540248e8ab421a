"""Photos on larger pixels: what may be shown of them where, and what seams cost there."""

from __future__ import annotations

import numpy as np
import pytest
from seam_cases import ALL, GRID, LEFT, MIDDLE, RIGHT, SIZE, Flight, meadow, painted, photo

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import Proxy, SparseRaster, common, nearest_labels, part_of
from georef_gis.mosaic.nearest import Nearest
from georef_gis.mosaic.seam_costs import PairCosts
from georef_gis.mosaic.seam_scales import FullScale, SmallScale, repeated, sampled
from georef_gis.mosaic.windows import finer

FACTOR = 3


def nearest_of(photos: list[Proxy]) -> Nearest:
    """The nearest of all photos, as the seams start from."""
    nearest = Nearest(GRID, lean=0.6, leeway=0.5)
    for index, one in enumerate(photos):
        nearest.add(index, one)
    return nearest


def scales_of(photos: list[Proxy]) -> tuple[FullScale, SmallScale]:
    """Photos as they are, and on larger pixels."""
    flight = Flight(photos)
    costs = PairCosts(flight)
    full = FullScale(costs, nearest_of(photos), flight.windows)
    return full, SmallScale(full, FACTOR)


def two(grey: float = 250.0) -> list[Proxy]:
    """Two photos, one of them with a car and a hole."""
    ground = meadow()
    left = photo(painted(ground, 100, MIDDLE - 8, 10, 18, grey), LEFT, noise=1)
    left.valid[31:32, 150:151] = False
    left.distance[31:32, 150:151] = np.inf
    return [left, photo(ground, RIGHT, noise=2)]


def test_the_nearest_are_those_of_the_mosaic_without_chosen_seams() -> None:
    photos = two()
    expected = nearest_labels(Flight(photos), GRID).read(ALL)
    np.testing.assert_array_equal(nearest_of(photos).labels.read(ALL), expected)


def test_a_photo_may_be_shown_where_it_may_be_all_over_a_larger_pixel() -> None:
    full, small = scales_of(two())
    for index in (0, 1):
        window = small.window(index)
        fine = finer(window, FACTOR)
        # no larger pixel reaches over the rim, and none that fits is left out
        assert common(fine, full.window(index)) == fine
        assert full.window(index).width - fine.width < 2 * FACTOR
        allowed = full.shown(index, fine).allowed
        blocks = allowed.reshape(window.height, FACTOR, window.width, FACTOR).all(axis=(1, 3))
        np.testing.assert_array_equal(small.shown(index, window).allowed, blocks)
        assert not blocks.all()
        assert blocks.any()


def test_costs_and_distances_are_means() -> None:
    full, small = scales_of(two())
    cost = small.between(1, 0)
    assert cost.window == common(small.window(0), small.window(1))
    part = part_of(full.between(0, 1).window, finer(cost.window, FACTOR))
    whole = full.between(0, 1).cost[part].astype(np.float64)
    shape = (cost.window.height, FACTOR, cost.window.width, FACTOR)
    # rounded
    assert np.abs(cost.cost - whole.reshape(shape).mean(axis=(1, 3))).max() <= 0.5 + 1e-9
    window = Window(col=50, row=10, width=7, height=5)
    distance = full.shown(0, finer(window, FACTOR)).distance.astype(np.float64)
    mean = distance.reshape(5, FACTOR, 7, FACTOR).mean(axis=(1, 3))
    # m; the last digit of 32 bits
    np.testing.assert_allclose(small.shown(0, window).distance, mean, rtol=3e-7)


def test_photos_apart_or_smaller_than_a_pixel_are_nowhere() -> None:
    ground = meadow()
    photos = [
        photo(ground, Window(col=4, row=4, width=2, height=40)),
        photo(ground, Window(col=100, row=100, width=50, height=50)),
    ]
    _, small = scales_of(photos)
    window = small.window(0)
    assert window.width == 0
    assert small.shown(0, window).allowed.size == 0
    assert small.between(0, 1).cost.size == 0


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_a_larger_pixel_has_the_label_in_its_middle(factor: int) -> None:
    values = np.random.default_rng(2).integers(-1, 9, (SIZE[1], SIZE[0])).astype(np.int32)
    raster = SparseRaster(width=SIZE[0], height=SIZE[1], dtype=np.int32, fill=-1)
    raster.write(ALL, values)
    small = sampled(raster, factor)
    found = small.read(Window(col=0, row=0, width=small.width, height=small.height))
    expected = values[factor // 2 :: factor, factor // 2 :: factor]
    np.testing.assert_array_equal(found[: expected.shape[0], : expected.shape[1]], expected)
    # the middle of the last may lie beyond the rim
    assert (found[expected.shape[0] :] == -1).all()
    assert found.shape == (-(-SIZE[1] // factor), -(-SIZE[0] // factor))


def test_repeated_values_cover_the_same_ground() -> None:
    values = np.arange(6).reshape(2, 3)
    large = repeated(values, 4)
    assert large.shape == (8, 12)
    np.testing.assert_array_equal(large[::4, ::4], values)
    np.testing.assert_array_equal(large[3::4, 3::4], values)
