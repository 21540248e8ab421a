"""Differences of photos where they overlap, before and after their colours are corrected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.colour import ColourModel
from georef_gis.mosaic.overlaps import Overlaps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """Sizes of differences between photos, grey values; NaN where a band is clipped everywhere.

    Parameters
    ----------
    median, p90 : shape (bands,)
        Over all blocks.
    pairs : shape (pairs, 2)
        Photos.
    pair_median : shape (pairs, bands)
        Over the blocks of a pair.
    """

    median: Array
    p90: Array
    pairs: NDArray[np.int64]
    pair_median: Array


def residual_steps(overlaps: Overlaps, model: ColourModel | None) -> Steps:
    """How far two photos differ, block by block, with their colours corrected if there is a model.

    Bands that are clipped in a block do not count there.
    """
    if model is None:
        size = np.abs(overlaps.value_a - overlaps.value_b, dtype=np.float64)
    else:
        size = np.abs(_corrected(overlaps, model, "a") - _corrected(overlaps, model, "b"))
    if not len(overlaps):
        none, empty = np.zeros(overlaps.bands), np.zeros((0, overlaps.bands))
        return Steps(median=none, p90=none, pairs=np.zeros((0, 2), np.int64), pair_median=empty)
    known = overlaps.weight > 0.0
    both = np.stack([overlaps.a, overlaps.b], axis=1)
    starts = np.flatnonzero(np.concatenate([[True], (both[1:] != both[:-1]).any(axis=1)]))
    parts = zip(np.split(size, starts[1:]), np.split(known, starts[1:]), strict=True)
    return Steps(
        median=_percentile(size, known, 50),
        p90=_percentile(size, known, 90),
        pairs=both[starts],
        pair_median=np.stack([_percentile(part, own, 50) for part, own in parts]),
    )


def _percentile(size: Array, known: NDArray[np.bool_], percent: float) -> Array:
    """Of each band, of what is known; (bands,)."""
    bands = (s[k] for s, k in zip(size.T, known.T, strict=True))
    return np.array([np.percentile(s, percent) if s.size else np.nan for s in bands])


def _corrected(overlaps: Overlaps, model: ColourModel, end: Literal["a", "b"]) -> Array:
    """Corrected grey values of one end of all blocks; (k, bands)."""
    photos: NDArray[np.int64] = getattr(overlaps, end)
    value, xy, view = (getattr(overlaps, f"{name}_{end}") for name in ("value", "xy", "view"))
    out = np.empty(value.shape)
    order = np.argsort(photos, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(photos[order])) + 1):
        if part.size:
            out[part] = model.corrected(int(photos[part[0]]), value[part], xy[part], view[part])
    return out
