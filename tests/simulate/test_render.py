"""Photos show things where the truth puts them."""

import cv2
import numpy as np
import pytest

from georef_gis.simulate import site
from georef_gis.simulate.ground_paint import paint_ground
from georef_gis.simulate.render import render_photo


@pytest.fixture(scope="module")
def photos(flight):
    return {i: render_photo(flight, i) for i in (2, 6)}


def corner_near(grey, uv):
    """The saddle of a black and white target, px."""
    start = np.round(uv).astype(np.float32).reshape(1, 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-3)
    return cv2.cornerSubPix(grey, start, (4, 4), (-1, -1), stop).reshape(2)


@pytest.mark.slow
@pytest.mark.parametrize("index", [2, 6])
def test_targets_stand_where_the_truth_marks_them(flight, photos, index):
    grey = cv2.cvtColor(photos[index], cv2.COLOR_RGB2GRAY)
    marks = [m for m in flight.marks if m.photo == index]
    miss = np.array([corner_near(grey, m.uv_true) - m.uv_true for m in marks])
    assert len(miss) >= 3
    assert np.abs(miss).max() < 0.5  # px
    assert np.abs(miss.mean(axis=0)).max() < 0.25  # px: half a pixel would show


@pytest.mark.slow
def test_photo_has_the_size_and_spread_of_a_photo(flight, photos):
    for image in photos.values():
        assert image.shape == (864, 1296, 3)
        assert image.dtype == np.uint8
        assert 60 < image.mean() < 180
        assert image.std() > 20
        assert np.mean(image >= 254) < 0.02


@pytest.mark.slow
def test_photo_has_texture_to_match(photos):
    for image in photos.values():
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        found = cv2.SIFT_create(nfeatures=5000).detect(grey)
        cells = {(int(k.pt[0] // 108), int(k.pt[1] // 108)) for k in found}
        assert len(found) > 2000
        assert len(cells) > 90  # of 12 x 8


def test_ground_colours_are_those_of_the_work_zone():
    p = site.enu_from_road(np.array([[0.0, 30.0, 5.0]]), np.array([[-60.0, 3.6, -2.0]]))
    gsd = np.full((1, 3), 0.02, dtype=np.float32)
    grass, line, overlay = paint_ground(p[..., 0], p[..., 1], gsd)[0]
    assert grass[1] > grass[2]  # greener than blue
    assert line.min() > 170  # white edge line
    assert overlay.max() < 80  # fresh asphalt
