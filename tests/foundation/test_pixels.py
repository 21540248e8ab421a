"""Pixel conventions: whose zero lies where."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.model import pixels

UV = st.tuples(st.floats(-10, 5000), st.floats(-10, 5000)).map(np.array)


def test_colmap_and_metashape_put_a_half_at_the_first_pixels_centre() -> None:
    assert np.array_equal(pixels.uv_from_corner([0.5, 0.5]), [0.0, 0.0])
    assert np.array_equal(pixels.corner_from_uv([0.0, 0.0]), [0.5, 0.5])


def test_opensfm_counts_from_the_middle_in_widths() -> None:
    middle = pixels.uv_from_opensfm([0.0, 0.0], width=4000, height=3000)
    assert middle == pytest.approx([1999.5, 1499.5], abs=1e-12)
    right = pixels.uv_from_opensfm([0.5, 0.0], width=4000, height=3000)
    assert right == pytest.approx([3999.5, 1499.5], abs=1e-12)  # outer edge of the last pixel
    tall = pixels.uv_from_opensfm([0.0, 0.5], width=3000, height=4000)
    assert tall == pytest.approx([1499.5, 3999.5], abs=1e-12)


@given(UV)
def test_each_converter_has_its_inverse(uv: np.ndarray) -> None:
    assert pixels.uv_from_corner(pixels.corner_from_uv(uv)) == pytest.approx(uv, abs=1e-9)
    size = {"width": 4000, "height": 3000}
    there = pixels.opensfm_from_uv(uv, **size)
    assert pixels.uv_from_opensfm(there, **size) == pytest.approx(uv, abs=1e-9)
    assert pixels.uv_after_resize(pixels.uv_after_resize(uv, 0.25), 4.0) == pytest.approx(
        uv, abs=1e-9
    )


@pytest.mark.parametrize("scale", [0.5, 0.25])
def test_resizing_moves_a_spot_as_opencv_moves_it(scale: float) -> None:
    """Centre of gravity of a spot before and after an area resize."""
    v, u = np.mgrid[0:96, 0:128]
    spot = np.exp(-((u - 70.3) ** 2 + (v - 40.8) ** 2) / 60.0)
    small = cv2.resize(spot, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    sv, su = np.mgrid[0 : small.shape[0], 0 : small.shape[1]]
    centre = np.array([(small * su).sum(), (small * sv).sum()]) / small.sum()
    assert centre == pytest.approx(pixels.uv_after_resize([70.3, 40.8], scale), abs=0.005)  # px


def test_the_first_index_is_the_row_and_its_pixels_centre_is_whole() -> None:
    """Decoded arrays are [v, u]: a lit pixel at row 3, column 5 is uv (5, 3)."""
    image = np.zeros((8, 12), np.uint8)
    image[3, 5] = 255
    decoded = cv2.imdecode(
        cv2.imencode(".png", image)[1], cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    )
    moments = cv2.moments(decoded)
    uv = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    assert uv == pytest.approx([5.0, 3.0], abs=1e-12)


def test_unequal_scales_per_axis() -> None:
    assert pixels.uv_after_resize([9.5, 9.5], [0.5, 0.1]) == pytest.approx([4.5, 0.5])
