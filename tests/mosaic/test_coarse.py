"""The coarse scale of a mosaic: aligned grid, sparse rasters, nearest photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import (
    BLOCK,
    Proxy,
    SparseRaster,
    coarse_factor,
    coarse_grid,
    common,
    nearest_labels,
    part_of,
)

GRID = Grid(crs_wkt="", left=100.0, top=900.0, pixel=0.5, width=1001, height=600)


@pytest.mark.parametrize(("px", "factor"), [(300, 1), (648, 2), (4000, 8), (8000, 16), (1e6, 64)])
def test_photos_are_some_400_coarse_pixels_long(px: float, factor: int) -> None:
    assert coarse_factor(px) == factor


def test_the_coarse_grid_shares_the_corner_and_covers_all() -> None:
    coarse = coarse_grid(GRID, 8)
    assert (coarse.left, coarse.top, coarse.pixel) == (100.0, 900.0, 4.0)
    assert (coarse.width, coarse.height) == (126, 75)


window = st.builds(
    Window, col=st.integers(-40, 900), row=st.integers(-40, 700), width=st.integers(1, 400),
    height=st.integers(1, 400),
)  # fmt: skip


@given(window, window)
def test_a_sparse_raster_answers_as_a_dense_one(a: Window, b: Window) -> None:
    sparse = SparseRaster(width=870, height=640, dtype=np.float32, fill=-1.0)
    dense = np.full((2000, 2000), -1.0, np.float32)
    rng = np.random.default_rng(1)
    for w in (a, b):
        values = rng.normal(size=(w.height, w.width)).astype(np.float32)
        where = rng.random((w.height, w.width)) < 0.6
        sparse.write(w, values, where)
        part = dense[w.row + 500 : w.row + 500 + w.height, w.col + 500 : w.col + 500 + w.width]
        part[where] = values[where]
    dense[:500], dense[500 + 640 :] = -1.0, -1.0
    dense[:, :500], dense[:, 500 + 870 :] = -1.0, -1.0
    for w in (a, b):
        want = dense[w.row + 500 : w.row + 500 + w.height, w.col + 500 : w.col + 500 + w.width]
        np.testing.assert_array_equal(sparse.read(w), want)


def test_a_diagonal_corridor_costs_what_it_covers() -> None:
    n = 40 * BLOCK
    sparse = SparseRaster(width=n, height=n, dtype=np.uint8, fill=0)
    for k in range(40):
        here = Window(col=k * BLOCK, row=k * BLOCK, width=BLOCK, height=BLOCK)
        sparse.write(here, np.ones((BLOCK, BLOCK), np.uint8))
    assert len(list(sparse)) == 40


def test_windows_meet_in_their_common_part() -> None:
    a = Window(col=0, row=10, width=30, height=30)
    b = Window(col=20, row=0, width=30, height=15)
    both = common(a, b)
    assert both == Window(col=20, row=10, width=10, height=5)
    assert part_of(a, both) == (slice(0, 5), slice(20, 30))
    assert common(a, Window(col=30, row=10, width=5, height=5)) is None


@dataclass
class Discs:
    """Photos as squares about their nadirs."""

    nadirs: tuple[tuple[int, int], ...]
    side: int = 41

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(f"p{i}" for i in range(len(self.nadirs)))

    @property
    def windows(self) -> tuple[Window, ...]:
        h = self.side // 2
        return tuple(
            Window(col=c - h, row=r - h, width=self.side, height=self.side) for c, r in self.nadirs
        )

    def load(self, index: int) -> Proxy:
        rows, cols = np.mgrid[: self.side, : self.side] - self.side // 2
        distance = np.hypot(rows, cols).astype(np.float32)
        shape = (self.side, self.side)
        return Proxy(
            photo_id=self.ids[index], window=self.windows[index],
            data=np.zeros((*shape, 1), np.float32), valid=np.ones(shape, np.bool_),
            distance=distance,
        )  # fmt: skip


def test_the_nearest_nadir_has_the_ground() -> None:
    source = Discs(((50, 50), (70, 50)))
    labels = nearest_labels(source, coarse_grid(GRID, 4))
    row = labels.read(Window(col=20, row=50, width=80, height=1))[0]
    # squares of 41 about columns 50 and 70 meet half way
    assert row.tolist() == [-1] * 10 + [0] * 31 + [1] * 30 + [-1] * 9
