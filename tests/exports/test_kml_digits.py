"""Longitudes and latitudes as text: the numbers that Python itself would write."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from exports.kml.digits import lonlat_texts

# deg; what could go wrong with signs, leading zeros and carries
AWKWARD = (0.0, 5e-9, -5e-9, 0.123, -0.001000001, 9.9999999996, -9.9999999996, 10.0, 99.05, -100.5,
           179.9999999999, -180.0, 0.999999999, 0.9999999994)  # fmt: skip


def test_every_vertex_is_written_as_by_format():
    rng = np.random.default_rng(5)
    # more vertices than are written at once, some features of many and some of one
    bounds = np.unique(np.concatenate([[0, 9000], rng.integers(0, 9000, 500)]))
    lonlat = rng.uniform(-1.0, 1.0, (9000, 2)) * [180.0, 90.0]
    lonlat[: len(AWKWARD), 0] = lonlat[-len(AWKWARD) :, 1] = AWKWARD
    texts = lonlat_texts(lonlat, bounds.tolist())
    assert len(texts) == len(bounds) - 1
    for text, a, b in zip(texts, bounds[:-1], bounds[1:], strict=True):
        assert text == " ".join(f"{x:.9f},{y:.9f}" for x, y in lonlat[a:b].tolist())


@pytest.mark.parametrize("bounds", [[0], [0, 0], [0, 0, 2, 2]])
def test_features_without_vertices_have_no_text(bounds):
    texts = lonlat_texts(np.full((bounds[-1], 2), 1.5), bounds)
    place = "1.500000000,1.500000000"
    assert texts == [["", f"{place} {place}"][b > a] for a, b in pairwise(bounds)]
