"""Parts of a raster of labels: specks, and what touches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from seam_cases import ALL, SIZE, meadow, photo

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import SparseRaster
from georef_gis.mosaic.label_regions import dissolve_specks, touching

Labels = NDArray[np.int32]


def labels_of(values: Labels) -> SparseRaster:
    """Raster with these labels."""
    raster = SparseRaster(width=SIZE[0], height=SIZE[1], dtype=np.int32, fill=-1)
    raster.write(Window(col=0, row=0, width=values.shape[1], height=values.shape[0]), values)
    return raster


def test_specks_go_to_the_neighbour_that_shows_them() -> None:
    ground = meadow()
    photos = [photo(ground, ALL), photo(ground, ALL)]
    photos[1].valid[40:50, 40:50] = False
    values = np.ones((SIZE[1], SIZE[0]), np.int32)
    values[:, :20] = 0
    values[10:15, 30:35] = 0
    # the other photo has a hole there
    values[42:46, 42:46] = 0
    # not small
    values[100:110, 100:110] = 0
    raster = labels_of(values)
    dissolve_specks(raster, 0, ALL, photos.__getitem__, 60)
    final = raster.read(ALL)
    assert (final[10:15, 30:35] == 1).all()
    assert (final[42:46, 42:46] == 0).all()
    assert (final[100:110, 100:110] == 0).all()
    assert (final[:, :20] == 0).all()


def test_the_only_part_of_a_photo_stays_however_small() -> None:
    photos = [photo(meadow(), ALL)] * 2
    values = np.ones((SIZE[1], SIZE[0]), np.int32)
    values[5:8, 5:8] = 0
    raster = labels_of(values)
    dissolve_specks(raster, 0, ALL, photos.__getitem__, 60)
    assert (raster.read(ALL) == 0).sum() == 9


def test_photos_touch_across_the_blocks_of_a_raster() -> None:
    values = np.full((SIZE[1], SIZE[0]), -1, np.int32)
    values[:, :256], values[:, 256:300], values[:, 301:] = 2, 0, 1
    border = Window(col=255, row=0, width=2, height=SIZE[1])
    assert touching(labels_of(values)) == {(0, 2): border}


def test_the_window_of_a_pair_has_both_sides_of_all_they_share() -> None:
    values = np.zeros((SIZE[1], SIZE[0]), np.int32)
    values[100:120, 200:230] = 3
    # at a corner of the other, and apart from it
    values[120:125, 230:240], values[130:140, 300:330] = 5, 5
    # across four blocks
    assert touching(labels_of(values)) == {
        (0, 3): Window(col=199, row=99, width=32, height=22),
        (0, 5): Window(col=229, row=119, width=102, height=22),
    }
