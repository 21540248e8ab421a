"""Shifts of photos at seams: found to a third of a pixel, or not told."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import mosaic_cases as cases
import numpy as np
import pytest
from numpy.typing import NDArray
from test_tin_mosaic import dem

from georef_gis.model.grid import Window
from georef_gis.model.mesh import Ground
from georef_gis.model.terrain import DemTerrain, Terrain
from georef_gis.mosaic.nadir import mosaic_source
from georef_gis.mosaic.seam_mismatch import MOST, SIDE, MismatchProbe, Squares, grey, shift_between
from georef_gis.mosaic.seam_steps import SeamPlaces
from georef_gis.rasters.warp import warp_window

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

    assert probe.measure(Window(col=0, row=0, width=700, height=512), paint) == ()
    assert asked == []
    # places 3 and 4 lie at columns 51 and 61 of 16 px
    shifts = probe.measure(Window(col=700, row=512, width=600, height=512), paint)
    assert [k for k, _ in shifts] == [3, 4]
    found = probe.result(dict(shifts))
    assert (found.places, found.accepted) == (5, 2)
    assert found.median == pytest.approx(0.1, abs=0.01)
    assert found.rmse == pytest.approx(0.1, abs=0.01)


def test_a_photo_that_does_not_show_the_square_tells_nothing() -> None:
    probe = MismatchProbe(places(3), factor=16, gsd=0.05)
    everywhere = Window(col=0, row=0, width=9000, height=9000)
    shifts = probe.measure(everywhere, lambda label, window: None)
    assert shifts == ((0, None), (1, None), (2, None))
    assert probe.result(dict(shifts)).as_json() == {
        "places": 3, "accepted": 0, "median_m": None, "p90_m": None, "rmse_m": None,
    }  # fmt: skip


def test_what_places_tell_does_not_depend_on_tiles_or_their_order() -> None:
    probe = MismatchProbe(places(40), factor=16, gsd=0.05)

    def paint(label: int, window: Window) -> Values | None:
        return ground((1.0 + window.col % 3) * label, 0.0, seed=window.col)

    def measured(side: int, step: int) -> dict[int, float | None]:
        cols = range(0, 8192, side)[::step]
        windows = [Window(col=col, row=row, width=side, height=side) for row in (0, 512)
                   for col in cols]  # fmt: skip
        return dict(shift for window in windows for shift in probe.measure(window, paint))

    first, other = measured(512, 1), measured(256, -1)
    assert len(first) == 40
    assert list(first) != list(other)
    assert probe.result(first) == probe.result(other)
    # by way of a journal
    assert probe.result(dict(json.loads(json.dumps(list(first.items()))))) == probe.result(first)


def test_places_are_few_and_spread() -> None:
    probe = MismatchProbe(places(50 * MOST), factor=1, gsd=1.0)
    assert probe.result({}).places == MOST


def test_grey_is_the_mean_of_the_bands_in_255ths() -> None:
    values = np.array([[[65535, 0]]], dtype=np.uint16)
    assert grey(values, 65535.0)[0, 0] == pytest.approx(127.5)


def rough() -> Terrain:
    """Ground with hummocks of 0.5 m, some 4 m apart."""
    smooth = dem()
    assert isinstance(smooth, DemTerrain)
    hummocks = np.random.default_rng(4).normal(0.0, 4.0, smooth.heights.shape)
    return replace(smooth, heights=smooth.heights + cv2.GaussianBlur(hummocks, (0, 0), 3.0))


@pytest.mark.parametrize("terrain", [cases.TERRAIN, rough()], ids=["flat", "DEM"])
@pytest.mark.parametrize("reduce", [1, 2])
def test_squares_are_those_of_the_warp(terrain: Terrain, reduce: int) -> None:
    """To a twentieth of what a shift by a pixel makes: the mesh has a node at every other."""
    photo = cases.photo_at(0.0, 0.0, "a")
    scene = cases.Scene([photo], {"a": noise()})
    earth = Ground.of(scene.frame, scene.grid, terrain, (190.0, 210.0))
    ring = scene.prints["a"].ring_map
    source = mosaic_source(photo, earth, scene.grid, ring, reduce=reduce, reach=72.1)
    squares = Squares([source], earth, scene.grid, scene.read)
    # 35 m off the nadir: a pixel moves by 2 for each metre of height
    window = Window(col=420, row=120, width=SIDE, height=SIDE)
    found = squares.of(0, window)
    image = scene.read(photo.photo.path, reduce)
    warped = warp_window(photo, image, earth, scene.grid, window, step=1, reduce=reduce)
    assert found is not None
    assert warped is not None
    want = warped[0].astype(float).mean(axis=2)
    moved = np.abs(np.diff(want)).mean()
    # of 255: noise
    assert moved > 5.0
    assert np.abs(found - want).mean() < 0.05 * moved


def test_squares_that_leave_the_photo_are_none_and_nothing_is_read() -> None:
    photo = cases.photo_at(0.0, 0.0, "a")
    scene = cases.Scene([photo], {"a": noise()})
    earth = Ground.of(scene.frame, scene.grid, cases.TERRAIN, (200.0, 200.0))
    ring = scene.prints["a"].ring_map
    source = mosaic_source(photo, earth, scene.grid, ring, reduce=1, reach=72.1)
    squares = Squares([source], earth, scene.grid, scene.read)
    for col, row in ((-30, 100), (300, -64), (scene.grid.width - 60, 100), (10**6, 0)):
        assert squares.of(0, Window(col=col, row=row, width=SIDE, height=SIDE)) is None
    assert scene.reads == []


def noise() -> NDArray[np.uint8]:
    return np.random.default_rng(3).integers(60, 190, (400, 600, 3), np.uint8)
