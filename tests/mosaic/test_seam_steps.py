"""Steps across seams, measured on photos whose levels are known."""

from __future__ import annotations

import numpy as np
import pytest
from test_low_blend import COARSE, HEIGHT, Photos, flat, halves

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import SparseRaster
from georef_gis.mosaic.low_blend import blend_low
from georef_gis.mosaic.seam_steps import EVERY, SIDE, measure_steps, seam_places

LEFT = Window(col=0, row=0, width=640, height=HEIGHT)
RIGHT = Window(col=260, row=0, width=640, height=HEIGHT)


def test_places_lie_on_the_seam_and_nowhere_else() -> None:
    places = seam_places(halves(450))
    # the border between columns 449 and 450, one place in EVERY
    assert set(places.col) == {449}
    assert len(places) == pytest.approx(HEIGHT / EVERY, abs=1)
    assert set(zip(places.a, places.b, strict=True)) == {(0, 1)}


def test_no_label_is_no_seam() -> None:
    labels = SparseRaster(width=900, height=HEIGHT, dtype=np.int32, fill=-1)
    labels.write(LEFT, np.zeros((HEIGHT, 640), np.int32))
    assert len(seam_places(labels)) == 0


def test_steps_are_the_differences_of_the_photos_and_blending_takes_them_off() -> None:
    photos = Photos([(LEFT, flat(100.0, 50.0)), (RIGHT, flat(110.0, 48.0))])
    labels = halves(450)
    found = measure_steps(photos, labels, blend_low(photos, labels, COARSE, 2), 2)
    np.testing.assert_allclose(found.between, np.broadcast_to([-10.0, 2.0], found.between.shape))
    assert np.abs(found.left).max() < 0.2
    told = found.as_json(255.0)
    assert told["between_photos"]["median"] == pytest.approx(6.0)
    assert told["in_the_result"]["p90"] < 0.2
    # a 16-bit photo is told in the same grey levels
    assert found.as_json(65535.0)["between_photos"]["median"] == pytest.approx(6.0 / 257.0)


def test_a_photo_that_ends_at_its_seam_is_counted_where_half_of_a_square_is_known() -> None:
    """Photo 1 begins 3 columns before the seam, photo 0 ends 6 columns behind it."""
    left = Window(col=0, row=0, width=456, height=HEIGHT)
    right = Window(col=447, row=0, width=453, height=HEIGHT)
    y, x = np.mgrid[:HEIGHT, :900].astype(np.float32)
    photos = Photos([(left, np.stack([x, y], axis=-1)), (right, np.stack([x + 5.0, y], axis=-1))])
    found = measure_steps(photos, halves(450), None, 2)
    np.testing.assert_array_equal(found.between, found.left)
    known = np.isfinite(found.between).all(axis=1)
    assert known.all()
    # columns 445 to 453; those before 447 are mirrored, which shifts their mean
    mirrored = np.mean([449, 448, 447, 448, 449, 450, 451, 452, 453])
    np.testing.assert_allclose(found.between[:, 0], 449.0 - mirrored - 5.0, atol=1e-3)
    inner = (found.places.row > SIDE) & (found.places.row < HEIGHT - SIDE)
    np.testing.assert_allclose(found.between[inner, 1], 0.0, atol=1e-3)


def test_a_photo_that_does_not_reach_its_seam_is_unknown_there() -> None:
    right = Window(col=460, row=0, width=440, height=HEIGHT)
    photos = Photos([(LEFT, flat(100.0)), (right, flat(110.0))])
    found = measure_steps(photos, halves(450), None, 1)
    assert np.isnan(found.between).all()
    assert found.as_json(255.0)["between_photos"]["median"] is None


def test_a_mosaic_of_one_photo_has_no_steps() -> None:
    labels = SparseRaster(width=900, height=HEIGHT, dtype=np.int32, fill=-1)
    labels.write(LEFT, np.zeros((HEIGHT, 640), np.int32))
    assert measure_steps(Photos([(LEFT, flat(1.0))]), labels, None, 1).between.shape == (0, 1)
