"""What a tile is made of: bilinear samples through a mesh, coloured and weighed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from georef_gis.model.grid import Window
from georef_gis.mosaic.canvas import Canvas, Positions
from georef_gis.mosaic.colour_field import Lattice, Tint
from georef_gis.mosaic.tone import toned

Array = NDArray[np.float64]
FACTOR, STEP = 16, 32
SIZE = (700, 500)
WINDOW = Window(col=128, row=64, width=256, height=192)
# u, v = a + b col + c row + d col row: bilinear, as a mesh is
PLACE = ((20.0, 1.05, 0.1, 2e-4), (-15.0, -0.08, 1.1, -1e-4))


def place_at(col: Array, row: Array) -> Array:
    """Pixel of the photo at centres of pixels of the grid."""
    x, y = col - WINDOW.col, row - WINDOW.row
    return np.stack([a + b * x + c * y + d * x * y for a, b, c, d in PLACE], axis=-1)


def positions(window: Window = WINDOW, step: int = STEP, reduce: int = 1) -> Positions:
    first = window.row // step - 1, window.col // step - 1
    rows = -(-(window.row + window.height) // step) + 1 - first[0]
    cols = -(-(window.col + window.width) // step) + 1 - first[1]
    row = (first[0] + np.arange(rows) + 0.5) * step - 0.5
    col = (first[1] + np.arange(cols) + 0.5) * step - 0.5
    nodes = place_at(*np.meshgrid(col, row))
    return Positions(
        nodes=nodes, moves=None, first=first, step=step, size=SIZE, reduce=reduce
    )  # fmt: skip


def true_places(window: Window = WINDOW) -> tuple[Array, Array]:
    row, col = np.mgrid[
        window.row : window.row + window.height, window.col : window.col + window.width
    ]
    uv = place_at(col.astype(float), row.astype(float))
    u, v = uv[..., 0], uv[..., 1]
    inside = (u >= -0.5) & (v >= -0.5) & (u <= SIZE[0] - 0.5) & (v <= SIZE[1] - 0.5)
    return uv, inside


def picture(dtype: str = "uint8", bands: int = 3) -> NDArray[np.uint8]:
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (SIZE[1], SIZE[0], bands), dtype=np.uint8)
    return cv2.GaussianBlur(image, (0, 0), 2.0).reshape(image.shape).astype(dtype)


def plain(window: Window = WINDOW, bands: int = 3) -> Tint:
    return Tint.none(Lattice.around(window, FACTOR), bands)


def waves(lattice: Lattice) -> Tint:
    """Gain and shift that depend on the place in the half grid alone."""
    half = lattice.half
    y, x = np.mgrid[half.row : half.row + half.height, half.col : half.col + half.width]
    gain = np.stack([1.0 + 0.1 * np.sin(x / 3.0), 0.9 + 0.05 * np.cos(y / 2.0)], axis=-1)
    add = np.stack([5.0 * np.cos(x / 4.0 + y), -3.0 + 0.0 * x], axis=-1)
    return Tint(lattice=lattice, gain=gain.astype(np.float32), add=add.astype(np.float32))


def test_samples_are_bilinear_and_end_at_the_photo_s_rim() -> None:
    image, canvas = picture(), Canvas(WINDOW)
    canvas.add(image, positions(), plain(), weight=None, relief=None)
    uv, inside = true_places()
    assert 0.7 < inside.mean() < 0.99
    np.testing.assert_array_equal(canvas.weight > 0.0, inside)
    at = [uv[..., 1], uv[..., 0]]
    want = np.stack(
        [map_coordinates(image[..., b].astype(float), at, order=1, mode="nearest")
         for b in range(3)], axis=-1,
    )  # fmt: skip
    # float32 of values up to 255
    np.testing.assert_allclose(canvas.means()[inside], want[inside], atol=2e-3)


def test_a_photo_decoded_smaller_is_sampled_where_its_pixels_lie() -> None:
    wave = np.sin(np.arange(SIZE[0]) / 40.0)[None, :] * np.cos(np.arange(SIZE[1]) / 30.0)[:, None]
    whole = (100.0 + 90.0 * wave)[..., None].astype(np.float32)
    half = whole.reshape(SIZE[1] // 2, 2, SIZE[0] // 2, 2, 1).mean(axis=(1, 3))
    a, b = Canvas(WINDOW), Canvas(WINDOW)
    a.add(whole, positions(), plain(bands=1), weight=None, relief=None)
    b.add(half, positions(reduce=2), plain(bands=1), weight=None, relief=None)
    uv, inside = true_places()
    # its rim repeats half a pixel less
    inside &= (uv.min(axis=-1) > 1.0) & (uv[..., 0] < SIZE[0] - 2) & (uv[..., 1] < SIZE[1] - 2)
    # what a mean over two pixels and the chord over two take off a wave of 90 / 30^2 a px^2
    np.testing.assert_allclose(a.means()[inside], b.means()[inside], atol=0.15)


def test_the_field_of_colour_is_bilinear_between_its_samples() -> None:
    image, canvas = np.full((SIZE[1], SIZE[0], 2), 100, np.uint8), Canvas(WINDOW)
    lattice = Lattice.around(WINDOW, FACTOR)
    tint = waves(lattice)
    canvas.add(image, positions(), tint, weight=None, relief=None)
    y, x = np.mgrid[: WINDOW.height, : WINDOW.width] / lattice.spacing
    at = [y + lattice.y0, x + lattice.x0]
    want = np.stack(
        [100.0 * map_coordinates(tint.gain[..., b], at, order=1)
         + map_coordinates(tint.add[..., b], at, order=1) for b in range(2)], axis=-1,
    )  # fmt: skip
    inside = true_places()[1]
    # float32 of values up to 120
    np.testing.assert_allclose(canvas.means()[inside], want[inside], atol=1e-3)


def test_gains_with_a_knee_spare_white() -> None:
    canvas = Canvas(WINDOW)
    ramp = np.arange(SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE[1], SIZE[0], 1)
    image = (ramp * (255.0 / ramp.max())).astype(np.float32)
    flat = plain(bands=1)
    tint = replace(flat, gain=flat.gain * np.float32(1.6), knee=1.0 / 255.0)
    canvas.add(image, positions(), tint, weight=None, relief=None)
    uv, inside = true_places()
    was = map_coordinates(image[..., 0], [uv[..., 1], uv[..., 0]], order=1, mode="nearest")
    want = toned(was, np.full_like(was, 1.6), 1.0 / 255.0)
    np.testing.assert_allclose(canvas.means()[inside, 0], want[inside], atol=2e-3)
    assert canvas.means().max() <= 255.0


def test_any_tiling_gives_the_same_bytes() -> None:
    image = picture(bands=2)

    def tile(window: Window) -> NDArray[np.uint8]:
        canvas = Canvas(window)
        tint = waves(Lattice.around(window, FACTOR))
        canvas.add(image, positions(window), tint, weight=None, relief=None)
        found = canvas.result()
        assert found is not None
        return np.where(canvas.weight[..., None] > 0.0, found[0], 0)

    whole = tile(WINDOW)
    for col, row, width, height in ((0, 0, 64, 128), (64, 32, 192, 96), (33, 7, 51, 100)):
        part = Window(col=WINDOW.col + col, row=WINDOW.row + row, width=width, height=height)
        want = whole[row : row + height, col : col + width]
        if col % 32 or row % 32:
            # the lattice begins elsewhere: the same to rounding
            apart = np.abs(tile(part).astype(int) - want)
            assert apart.max() <= 1
            assert (apart > 0).mean() < 1e-3
        else:
            np.testing.assert_array_equal(tile(part), want)


def test_relief_moves_pixels_by_the_height_above_the_mesh() -> None:
    image, canvas = picture(bands=1), Canvas(WINDOW)
    at = positions()
    moves = np.broadcast_to([3.0, -2.0], at.nodes.shape).copy()
    high = Positions(
        nodes=at.nodes, moves=moves, first=at.first, step=STEP, size=SIZE, reduce=1
    )  # fmt: skip
    y, x = np.mgrid[: WINDOW.height, : WINDOW.width]
    relief = (np.sin(x / 9.0) * np.cos(y / 7.0)).astype(np.float32)
    relief[:10, :10] = np.nan
    canvas.add(image, high, plain(bands=1), weight=None, relief=relief)
    uv, _ = true_places()
    uv = uv + relief[..., None] * [3.0, -2.0]
    u, v = uv[..., 0], uv[..., 1]
    inside = (u >= -0.5) & (v >= -0.5) & (u <= SIZE[0] - 0.5) & (v <= SIZE[1] - 0.5)
    want = map_coordinates(image[..., 0].astype(float), [v, u], order=1, mode="nearest")
    np.testing.assert_array_equal(canvas.weight > 0.0, inside)
    np.testing.assert_allclose(canvas.means()[inside, 0], want[inside], atol=5e-3)


def test_photos_are_mixed_by_their_weights() -> None:
    dark, light = (np.full((SIZE[1], SIZE[0], 1), v, np.uint8) for v in (10, 110))
    weight = np.linspace(0.0, 1.0, WINDOW.width, dtype=np.float32)
    weight = np.ascontiguousarray(np.broadcast_to(weight, (WINDOW.height, WINDOW.width)))
    canvas = Canvas(WINDOW)
    canvas.add(dark, positions(), plain(bands=1), weight=weight, relief=None)
    canvas.add(light, positions(), plain(bands=1), weight=1.0 - weight, relief=None)
    inside = true_places()[1]
    np.testing.assert_allclose(canvas.means()[inside, 0], (110.0 - 100.0 * weight)[inside], 1e-5)
    found = canvas.result()
    assert found is not None
    data, mask = found
    assert mask is not None
    np.testing.assert_array_equal(mask, inside)
    assert not data[~inside].any()
    np.testing.assert_array_equal(canvas.holes() > 0.0, ~inside)


@pytest.mark.parametrize(("dtype", "top"), [("uint8", 255), ("uint16", 65535)])
def test_integers_are_rounded_and_cut_to_their_range(dtype: str, top: int) -> None:
    window = Window(col=128, row=64, width=32, height=32)
    lattice = Lattice.around(window, FACTOR)
    shape = (lattice.half.height, lattice.half.width, 1)
    tint = Tint(
        lattice=lattice, gain=np.full(shape, 1.05, np.float32), add=np.full(shape, -1, np.float32)
    )
    for value, want in ((0, [0]), (10, [9, 10]), (100, [104]), (top, [top])):
        canvas = Canvas(window)
        image = np.full((SIZE[1], SIZE[0], 1), value, dtype)
        canvas.add(image, positions(window), tint, weight=None, relief=None)
        found = canvas.result()
        assert found is not None
        assert found[0].dtype == dtype
        assert set(np.unique(found[0][canvas.weight > 0.0]).tolist()) <= set(want)


def test_negative_integers_round_to_the_nearest() -> None:
    image = np.full((SIZE[1], SIZE[0], 1), -7, np.int16)
    canvas = Canvas(WINDOW)
    canvas.add(image, positions(), plain(bands=1), weight=None, relief=None)
    found = canvas.result()
    assert found is not None
    assert np.unique(found[0][canvas.weight > 0.0]).tolist() == [-7]


def test_floats_without_a_value_leave_holes_and_keep_what_is_there() -> None:
    image = picture("float32", bands=1)
    image[100:130, 100:160] = np.nan
    canvas = Canvas(WINDOW)
    canvas.add(image, positions(), plain(bands=1), weight=None, relief=None)
    uv, inside = true_places()
    near = (uv[..., 0] > 98.9) & (uv[..., 0] < 160.1) & (uv[..., 1] > 98.9) & (uv[..., 1] < 130.1)
    deep = (uv[..., 0] > 100.1) & (uv[..., 0] < 158.9) & (uv[..., 1] > 100.1) & (uv[..., 1] < 128.9)
    assert deep.sum() > 100
    assert not canvas.weight[deep].any()
    assert canvas.weight[inside & ~near].all()
    assert np.isfinite(canvas.means()).all()
    # others fill it
    canvas.add(picture("float32", bands=1), positions(), plain(bands=1), weight=canvas.holes(),
               relief=None)  # fmt: skip
    assert canvas.weight[inside].all()
