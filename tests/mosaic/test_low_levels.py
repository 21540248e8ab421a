"""Levels of a photo's pyramid: the short ways give what the whole aligned window would."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic import low_levels
from georef_gis.mosaic.low_levels import aligned, first_level, levels_of

Values = NDArray[np.float32]


def photo(rows: int, cols: int) -> tuple[Values, NDArray[np.bool_]]:
    rng = np.random.default_rng(2)
    data = rng.uniform(50, 200, (rows, cols, 3)).astype(np.float32)
    # a turned photo leaves corners
    r, c = np.mgrid[:rows, :cols]
    return data, np.asarray((r + c > 60) & (r + c < rows + cols - 90))


@pytest.mark.parametrize("col", [64, 65, 94, 95, -3])
@pytest.mark.parametrize("size", [(150, 201), (151, 200)])
def test_the_first_level_is_that_of_the_whole_window(col: int, size: tuple[int, int]) -> None:
    data, valid = photo(*size)
    window = Window(col=col, row=col + 31, width=size[1], height=size[0])
    values, share, at = first_level(data, valid, window)
    whole = aligned(window)
    assert (2 * at.col, 2 * at.row, 2 * at.width, 2 * at.height) == (
        whole.col, whole.row, whole.width, whole.height,
    )  # fmt: skip
    top, left = window.row - whole.row, window.col - whole.col
    about = ((top, whole.height - top - size[0]), (left, whole.width - left - size[1]))
    expected = cv2.pyrDown(np.pad(valid.astype(np.float32), about))
    np.testing.assert_allclose(share, expected, atol=1e-6)
    total = cv2.pyrDown(np.pad(np.where(valid[..., None], data, np.float32(0)), (*about, (0, 0))))
    known = expected > 1e-3
    np.testing.assert_allclose(values[known], total[known] / expected[known][:, None], rtol=1e-4)
    # and it goes on beyond, within what there was
    assert values[~known].max() <= values[known].max() + 1e-3
    assert (values[~known] > 0).mean() > 0.5


def test_a_small_cell_has_the_levels_of_the_whole_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    data, valid = photo(300, 400)
    window = Window(col=33, row=70, width=400, height=300)
    whole = aligned(window)
    cell = np.zeros((whole.height, whole.width), np.bool_)
    cell[190:230, 200:260] = True
    first = first_level(data, valid, window)
    short = levels_of(*first, cell)
    monkeypatch.setattr(low_levels, "REACH", 10_000)
    full = levels_of(*first, cell)
    assert len(short) == len(full) == low_levels.LEVELS
    for part, level in zip(short, full, strict=True):
        assert part.weight.size < level.weight.size
        top, left = part.window.row - level.window.row, part.window.col - level.window.col
        inside = (slice(top, top + part.window.height), slice(left, left + part.window.width))
        # float32, summed in another order
        np.testing.assert_allclose(part.weight, level.weight[inside], rtol=1e-5)
        np.testing.assert_allclose(part.band, level.band[inside], atol=1e-3)
        assert level.weight.sum() == pytest.approx(part.weight.sum(), rel=1e-6)
