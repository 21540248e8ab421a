"""Shifts of photos at seams: found to a third of a pixel, or not told."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.seam_mismatch import MOST, SIDE, MismatchProbe, grey, shift_between
from georef_gis.mosaic.seam_steps import SeamPlaces

Values = NDArray[np.float32]


def ground(dx: float, dy: float, *, seed: int = 0, size: int = SIDE) -> Values:
    """Grass, seen shifted."""
    rng = np.random.default_rng(seed)
    large = cv2.GaussianBlur(rng.normal(100.0, 60.0, (3 * size, 3 * size)).astype(np.float32),
                             (0, 0), 1.5)  # fmt: skip
    move = np.float32([[1, 0, dx], [0, 1, dy]])
    moved = cv2.warpAffine(large, move, (3 * size, 3 * size), flags=cv2.INTER_CUBIC)
    return np.ascontiguousarray(moved[size : 2 * size, size : 2 * size])


@pytest.mark.parametrize(("dx", "dy"), [(0.0, 0.0), (0.4, -1.3), (7.6, 3.2)])
def test_a_shift_is_found_though_brightness_differs(dx: float, dy: float) -> None:
    slope = np.linspace(0.0, 40.0, SIDE, dtype=np.float32)
    found = shift_between(ground(0.0, 0.0), 0.8 * ground(dx, dy) + slope)
    assert found is not None
    assert found == pytest.approx((dx, dy), abs=0.3)


def test_what_tells_nothing_is_not_told() -> None:
    assert shift_between(ground(0, 0), ground(0, 0, seed=9)) is None
    assert shift_between(np.full((SIDE, SIDE), 90, np.float32), ground(0, 0)) is None
    hole = ground(0, 0)
    hole[5, 5] = np.nan
    assert shift_between(hole, ground(0, 0)) is None


def places(n: int) -> SeamPlaces:
    k = np.arange(n)
    return SeamPlaces(a=np.zeros(n, np.int64), b=np.ones(n, np.int64), col=10 * k + 20,
                      row=np.full(n, 40))  # fmt: skip


def test_the_probe_measures_places_of_its_tile_and_scales_them() -> None:
    probe = MismatchProbe(places(5), factor=16, gsd=0.05)
    asked: list[Window] = []

    def paint(label: int, window: Window) -> Values | None:
        asked.append(window)
        return ground(2.0 * label, 0.0)

    probe.measure(Window(col=0, row=0, width=700, height=512), paint)
    assert asked == []
    # places 3 and 4 lie at columns 51 and 61 of 16 px
    probe.measure(Window(col=700, row=512, width=600, height=512), paint)
    found = probe.result()
    assert (found.places, found.accepted) == (5, 2)
    assert found.median == pytest.approx(0.1, abs=0.01)
    assert found.rmse == pytest.approx(0.1, abs=0.01)


def test_a_photo_that_does_not_show_the_square_tells_nothing() -> None:
    probe = MismatchProbe(places(3), factor=16, gsd=0.05)
    probe.measure(Window(col=0, row=0, width=9000, height=9000), lambda label, window: None)
    assert probe.result().as_json() == {
        "places": 3, "accepted": 0, "median_m": None, "p90_m": None, "rmse_m": None,
    }  # fmt: skip


def test_places_are_few_and_spread() -> None:
    probe = MismatchProbe(places(50 * MOST), factor=1, gsd=1.0)
    assert probe.result().places == MOST


def test_grey_is_the_mean_of_the_bands_in_255ths() -> None:
    values = np.array([[[65535, 0]]], dtype=np.uint16)
    assert grey(values, 65535.0)[0, 0] == pytest.approx(127.5)
