"""Colour as a field: a pixel's correction depends on its place alone."""

from __future__ import annotations

import mosaic_cases as cases
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from georef_gis.model.grid import Window
from georef_gis.model.mesh import Ground
from georef_gis.mosaic.colour_field import Knots, Lattice, coloured, gain_at
from georef_gis.mosaic.proxies import place_in_photo

Array = NDArray[np.float64]
FACTOR = 16


def field_on(lattice: Lattice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Gain and shift of two bands that depend on the place in the half grid."""
    half = lattice.half
    y, x = np.mgrid[half.row : half.row + half.height, half.col : half.col + half.width]
    gain = np.stack([1.0 + 0.1 * np.sin(x / 3.0), 0.9 + 0.05 * np.cos(y / 2.0)], axis=-1)
    add = np.stack([5.0 * np.cos(x / 4.0 + y), -3.0 + 0.0 * x], axis=-1)
    return gain.astype(np.float32), add.astype(np.float32)


def corrected(image: NDArray[np.uint8], window: Window) -> NDArray[np.float32]:
    lattice = Lattice.around(window, FACTOR)
    gain, add = field_on(lattice)
    out = np.empty(image.shape, np.float32)
    coloured(image, gain, add, lattice, (0, 0), out)
    return out


def picture(rows: int, cols: int) -> NDArray[np.uint8]:
    return np.random.default_rng(3).integers(0, 256, (rows, cols, 2), dtype=np.uint8)


def test_a_lattice_covers_its_window() -> None:
    for col, width in ((0, 1), (0, 512), (512, 512), (37, 100), (15, 1), (16, 1)):
        lattice = Lattice.around(Window(col=col, row=0, width=width, height=1), FACTOR)
        assert 0.0 <= lattice.x0 < 1.0
        last = lattice.x0 + (width - 1) / lattice.spacing
        assert last <= lattice.half.width - 1
        # coarse pixel 0 has its centre at fine pixel 8: the centre of fine pixel 7 lies half a
        # pixel before it
        place = (lattice.half.col + lattice.x0) * lattice.spacing + 0.5 * FACTOR
        assert place == pytest.approx(col + 0.5)


def test_the_field_is_bilinear_between_its_samples() -> None:
    window = Window(col=512, row=1024, width=130, height=90)
    image = picture(90, 130)
    lattice = Lattice.around(window, FACTOR)
    gain, add = field_on(lattice)
    y, x = np.mgrid[:90, :130] / lattice.spacing
    at = [y + lattice.y0, x + lattice.x0]
    want = np.stack([
        image[..., b] * map_coordinates(gain[..., b], at, order=1)
        + map_coordinates(add[..., b], at, order=1)
        for b in range(2)
    ], axis=-1)  # fmt: skip
    # float32 of values up to 300
    np.testing.assert_allclose(corrected(image, window), want, atol=2e-3)


def test_any_tiling_gives_the_same_values() -> None:
    image = picture(128, 256)
    whole = corrected(image, Window(col=256, row=384, width=256, height=128))
    for col, row, width, height in ((0, 0, 64, 128), (64, 32, 192, 96), (33, 7, 51, 100)):
        part = image[row : row + height, col : col + width]
        here = Window(col=256 + col, row=384 + row, width=width, height=height)
        want = whole[row : row + height, col : col + width]
        np.testing.assert_allclose(corrected(part, here), want, atol=1e-3)


def test_a_block_of_a_window_is_the_window_s() -> None:
    window = Window(col=256, row=384, width=256, height=128)
    image, lattice = picture(128, 256), Lattice.around(window, FACTOR)
    gain, add = field_on(lattice)
    out = np.empty((64, 128, 2), np.float32)
    coloured(image[64:, 128:], gain, add, lattice, (64, 128), out)
    np.testing.assert_allclose(out, corrected(image, window)[64:, 128:], atol=1e-3)


@pytest.mark.parametrize(("dtype", "top"), [("uint8", 255), ("uint16", 65535)])
def test_integers_are_rounded_and_cut(dtype: str, top: int) -> None:
    window = Window(col=0, row=0, width=4, height=1)
    lattice = Lattice.around(window, FACTOR)
    shape = (lattice.half.height, lattice.half.width, 1)
    image = np.array([[[0], [10], [100], [top]]], dtype=dtype)
    out = np.empty_like(image)
    gain, add = np.full(shape, 1.05, np.float32), np.full(shape, -1.0, np.float32)
    coloured(image, gain, add, lattice, (0, 0), out)
    # -1 -> 0; 9.5 -> 10 (rounding of a half may go either way); 104; above the top
    assert out.ravel().tolist() in ([0, 9, 104, top], [0, 10, 104, top])


def test_negative_integers_round_to_the_nearest() -> None:
    window = Window(col=0, row=0, width=3, height=1)
    lattice = Lattice.around(window, FACTOR)
    shape = (lattice.half.height, lattice.half.width, 1)
    image = np.array([[[-10], [-5], [7]]], dtype=np.int16)
    out = np.empty_like(image)
    coloured(image, np.ones(shape, np.float32), np.zeros(shape, np.float32), lattice, (0, 0), out)
    assert out.ravel().tolist() == [-10, -5, 7]


class Vignette:
    """Darker towards the corners, bluer towards the sun in the east."""

    def factor(self, photo: int, xy: Array, view: Array) -> Array:
        r2 = np.sum(xy**2, axis=-1)
        return np.stack([1.0 + 0.3 * r2, 1.0 + 0.3 * r2 + 0.1 * view[..., 0]], axis=-1)

    def offset(self, photo: int) -> Array:
        return np.zeros(2)


def test_the_gain_at_a_pixel_is_that_of_its_ray() -> None:
    photo = cases.photo_at(0.0, 0.0, "a")
    scene = cases.Scene([photo], {})
    heights = (200.0, 200.0)
    ground = Ground.of(scene.frame, scene.grid, cases.TERRAIN, heights)
    window = Window(col=128, row=64, width=256, height=256)
    lattice = Lattice.around(window, FACTOR)
    knots = Knots.under(lattice, ground, scene.grid)
    gain = gain_at(photo, Vignette(), 0, knots, photo.project(knots.p_enu))
    y, x = np.mgrid[:256:17, :256:17]
    at = [y / lattice.spacing + lattice.y0, x / lattice.spacing + lattice.x0]
    colrow = np.stack([x + 128.5, y + 64.5], axis=-1).astype(np.float64)
    true = Vignette().factor(0, *place_in_photo(photo, ground.enu_at(scene.grid, colrow)))
    for b in range(2):
        found = map_coordinates(gain[..., b], at, order=1)
        # of a parabola of 0.3 a half diagonal of 360 px, bilinear over 32 px: 0.0012
        np.testing.assert_allclose(found, true[..., b], atol=1.5e-3)
