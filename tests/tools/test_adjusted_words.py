"""Words of an adjustment about photos that it could not connect, and values that do not fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from georef_gis.orient.adjustment.contradictions import Doubted
from processing_algorithms.orient.adjusted_rows import MOST_DOUBTED, _doubted_lines, _lone_lines


def adjusted(count: list[int], doubted: int = 0) -> Any:
    """An adjustment of photos with so many tie points, and values that were weighed down."""
    n = max(len(count), doubted)
    return SimpleNamespace(
        block=SimpleNamespace(photo_ids=tuple(f"P{i}" for i in range(n))),
        rms_by_photo=lambda: (np.zeros(len(count)), np.array(count)),
        doubted=tuple(Doubted(photo=i, component=2, sigmas=9.0) for i in range(doubted)),
    )


@pytest.mark.parametrize(
    ("count", "told"),
    [([9, 0, 9], "1 photo is not connected and keeps its direct pose: P1"),
     ([0, 0, 9], "2 photos are not connected and keep their direct pose: P0, P1")],
)  # fmt: skip
def test_one_photo_is_not_and_two_are_not_connected(count: list[int], told: str) -> None:
    assert _lone_lines(adjusted(count)) == [told]


def test_values_that_are_not_told_one_by_one_say_where_all_are() -> None:
    assert len(_doubted_lines(adjusted([], MOST_DOUBTED))) == MOST_DOUBTED
    one, many = (_doubted_lines(adjusted([], MOST_DOUBTED + k))[-1] for k in (1, 38))
    assert one.startswith("... and 1 more value was weighed down")
    assert many.startswith("... and 38 more values were weighed down")
    assert many.endswith("all are in adjustment/report.json, weighed_down")
