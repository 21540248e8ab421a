"""What a seam between two photos costs where."""

from __future__ import annotations

import numpy as np
from seam_cases import LEFT, MIDDLE, RIGHT, SIZE, meadow, painted, photo

from georef_gis.model.grid import Window
from georef_gis.mosaic.seam_costs import ONE, pair_cost


def test_photos_that_agree_cost_nothing_and_those_apart_have_no_cost() -> None:
    ground = meadow()
    cost = pair_cost(photo(ground, LEFT), photo(ground, RIGHT))
    assert cost.window == Window(col=130, row=10, width=140, height=200)
    assert not cost.cost.any()
    far = pair_cost(
        photo(ground, Window(col=0, row=0, width=20, height=20)),
        photo(ground, Window(col=20, row=0, width=20, height=20)),
    )
    assert far.at(np.array([3]), np.array([20])).tolist() == [ONE]


def test_a_seam_costs_most_on_a_car_and_little_on_noise() -> None:
    ground = meadow()
    with_car = painted(ground, 100, MIDDLE - 8, 10, 18, 250.0)
    cost = pair_cost(photo(with_car, LEFT, noise=1), photo(ground, RIGHT, noise=2))
    at = cost.cost[90:100, MIDDLE - 130 - 8 : MIDDLE - 130 + 10]
    # parts of `ONE`: a seam would go 5 px round to save one on the car
    assert at.min() > 0.9 * ONE
    assert np.median(cost.cost) < 0.2 * ONE


def test_a_rough_difference_costs_more_than_a_flat_one_as_large() -> None:
    ground = np.full((SIZE[1], SIZE[0], 3), 100.0, np.float32)
    other = ground + np.float32(10.0)
    # stripes of 2 px as much brighter and darker
    stripes = np.where(np.arange(MIDDLE, SIZE[0]) // 2 % 2 == 0, 10.0, -10.0)
    other[:, MIDDLE:] = ground[:, MIDDLE:] + stripes[:, None]
    cost = pair_cost(photo(ground, LEFT), photo(other, RIGHT)).cost
    flat, rough = cost[:, : MIDDLE - 130 - 6], cost[:, MIDDLE - 130 + 6 : 134]
    # the squares of differences 10 and slopes 10, against those of the differences alone
    assert rough.min() > 1.8 * flat.max() > 0
