"""Colour as a field: a pixel's correction depends on its place alone."""

from __future__ import annotations

import mosaic_cases as cases
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from georef_gis.model.grid import Window
from georef_gis.model.mesh import Ground
from georef_gis.mosaic.colour_field import Lattice, PhotoTint, gain_over
from georef_gis.mosaic.proxies import place_in_photo

Array = NDArray[np.float64]
FACTOR = 16


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


class Vignette:
    """Darker towards the corners, bluer towards the sun in the east."""

    knee = 0.0

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
    gain = gain_over(photo, Vignette(), 0, lattice, ground, scene.grid)
    y, x = np.mgrid[:256:17, :256:17]
    at = [y / lattice.spacing + lattice.y0, x / lattice.spacing + lattice.x0]
    colrow = np.stack([x + 128.5, y + 64.5], axis=-1).astype(np.float64)
    true = Vignette().factor(0, *place_in_photo(photo, ground.enu_at(scene.grid, colrow)))
    for b in range(2):
        found = map_coordinates(gain[..., b], at, order=1)
        # of a parabola of 0.3 a half diagonal of 360 px, bilinear over 64 px: 0.0024 along each
        # axis
        np.testing.assert_allclose(found, true[..., b], atol=5e-3)


def test_a_photo_s_tint_is_cut_out_and_goes_on_beyond_its_rim() -> None:
    half = Window(col=10, row=20, width=6, height=4)
    y, x = np.mgrid[20:24, 10:16]
    gain = np.stack([x, y], axis=-1).astype(np.float32)
    tint = PhotoTint(half=half, gain=gain, offset=np.array([1.0, -2.0], np.float32))
    # samples 14 to 18 and 19 to 21, of which some lie beyond the photo
    lattice = Lattice.around(Window(col=15 * 32, row=20 * 32, width=65, height=33), FACTOR)
    part = tint.over(lattice, None)
    want = np.clip(lattice.half.col + np.arange(lattice.half.width), 10, 15)
    np.testing.assert_array_equal(part.gain[0, :, 0], want)
    want = np.clip(lattice.half.row + np.arange(lattice.half.height), 20, 23)
    np.testing.assert_array_equal(part.gain[:, 0, 1], want)
    assert np.unique(part.add[..., 0]).tolist() == [1.0]
    assert np.unique(part.add[..., 1]).tolist() == [-2.0]
