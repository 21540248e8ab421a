"""The same ground seen by two photos: means of coarse pixels over common blocks."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Window
from georef_gis.mosaic.block_means import (
    Blocks,
    Floats,
    Indices,
    Place,
    Samples,
    block_means,
    evenly,
)
from georef_gis.mosaic.coarse import Mask, ProxySource

# directions in which partners are looked for: the best overlap alone would be along the strip
SECTORS = 8
# photos whose candidates are looked at together: bounds the memory where all photos overlap
BATCH = 256
LEAST_SAMPLES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class OverlapSettings:
    """What to compare, and how much of it.

    Parameters
    ----------
    block
        px of the coarse grid; side of a block. Large enough that 1 px of misregistration hardly
        matters, small enough that vignetting does not change within it.
    partners
        Photos that each is compared with.
    blocks_per_pair, blocks_in_all
        Blocks at most.
    samples_per_photo, samples_in_all
        Pixels at most, but for `LEAST_SAMPLES` of a photo.
    value_range
        Grey values at which the data are clipped; None for data without an end.
    clip_margin
        Part of the range at its ends that counts as clipped: a coarse pixel is a mean, so it is
        below the end although some of its fine pixels are clipped.
    texture
        Deviation within a block, relative to the typical grey value, at which it counts half.
    kept
        Photos whose block means are held in memory at a time.
    """

    block: int = 8
    partners: int = 10
    blocks_per_pair: int = 150
    blocks_in_all: int = 500_000
    samples_per_photo: int = 150
    samples_in_all: int = 200_000
    value_range: tuple[float, float] | None = None
    clip_margin: float = 0.02
    texture: float = 0.05
    kept: int = 400

    @property
    def ends(self) -> tuple[float, float] | None:
        """Grey values beyond which a pixel counts as clipped."""
        if self.value_range is None:
            return None
        low, high = self.value_range
        margin = self.clip_margin * (high - low)
        return low + margin, high - margin


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Overlaps:
    """Blocks of ground that two photos show, sorted by pair.

    Parameters
    ----------
    a, b : shape (k,)
        Indices of the photos, a < b.
    value_a, value_b : shape (k, bands)
        Mean grey values.
    xy_a, xy_b : shape (k, 2)
        Place in the photo, from the principal point, in half diagonals.
    view_a, view_b : shape (k, 2)
        Horizontal part (east, north) of the unit vector from the ground to the camera.
    weight : shape (k, bands)
        1, less where the texture is strong, 0 where a photo is clipped in that band.
    """

    a: Indices
    b: Indices
    value_a: Floats
    value_b: Floats
    xy_a: Floats
    xy_b: Floats
    view_a: Floats
    view_b: Floats
    weight: Floats

    def __len__(self) -> int:
        """Return the number of blocks."""
        return int(self.a.size)

    @property
    def bands(self) -> int:
        """Number of bands."""
        return int(self.value_a.shape[1])

    @property
    def known_bands(self) -> Mask:
        """Which bands are not clipped everywhere; (bands,)."""
        return np.asarray((self.weight > 0.0).any(axis=0))


class _BlockCache:
    """Block means of photos, those used last kept; they take a sixtieth of the photos' memory."""

    def __init__(self, source: ProxySource, place: Place, settings: OverlapSettings) -> None:
        self._source, self._place, self._settings = source, place, settings
        self._kept: OrderedDict[int, Blocks] = OrderedDict()
        self.samples: dict[int, Samples] = {}

    def get(self, index: int) -> Blocks:
        found = self._kept.pop(index, None)
        if found is None:
            found = self._made(index)
            self.samples[index] = found.samples
        self._kept[index] = found
        while len(self._kept) > max(2, self._settings.kept):
            self._kept.popitem(last=False)
        return found

    def _made(self, index: int) -> Blocks:
        settings = self._settings
        share = settings.samples_in_all // len(self._source.ids)
        return block_means(
            index, self._source.load(index), self._place, size=settings.block, ends=settings.ends,
            samples=max(LEAST_SAMPLES, min(settings.samples_per_photo, share)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gathered:
    """What photos of a mosaic show: ground in common, and pixels of each that has a partner."""

    overlaps: Overlaps
    samples: Samples


def gather_overlaps(source: ProxySource, place: Place, *, settings: OverlapSettings) -> Gathered:
    """Compare all photos of a flight with those that overlap them; each is loaded about once.

    Parameters
    ----------
    place
        `place(photo, cols, rows) -> (xy, view)`, all of shape (k,) or (k, 2). The positions are on
        the coarse grid, (0, 0) = outer corner; `xy` is the place in the photo from the principal
        point in half diagonals, `view` the horizontal part of the unit vector to the camera, enu.
    """
    pairs = choose_pairs(source.windows, settings.partners)
    limit = settings.blocks_per_pair
    if len(pairs):
        limit = max(1, min(limit, settings.blocks_in_all // len(pairs)))
    cache = _BlockCache(source, place, settings)
    found: dict[tuple[int, int], tuple[NDArray[Any], ...]] = {}
    for i, j in _in_reading_order(source.windows, pairs):
        common = _compare(cache.get(i), cache.get(j), limit)
        if common is not None:
            count = common[0].shape[0]
            found[i, j] = (np.full(count, i), np.full(count, j), *common)
    if found:
        overlaps = _joined([found.pop(pair) for pair in sorted(found)], settings)
    else:
        overlaps = _nothing(source.load(0).data.shape[2] if len(source.ids) else 1)
    parts = [cache.samples[index] for index in sorted(cache.samples)]
    return Gathered(overlaps=overlaps, samples=Samples.joined(parts, overlaps.bands))


def _joined(parts: list[tuple[NDArray[Any], ...]], settings: OverlapSettings) -> Overlaps:
    """Overlaps from the pieces of all pairs."""
    columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    a, b, va, vb, xa, xb, na, nb, spread, good = columns
    typical = max(float(np.median(np.abs(va))), 1e-30)
    relative = spread / np.float32(settings.texture * typical)
    smooth = (1.0 / (1.0 + relative**2)).astype(np.float32)
    return Overlaps(
        a=a, b=b, value_a=va, value_b=vb, xy_a=xa, xy_b=xb, view_a=na, view_b=nb,
        weight=good * smooth[:, None],
    )  # fmt: skip


def _nothing(bands: int) -> Overlaps:
    none, two = np.zeros(0, np.int64), np.zeros((0, 2), np.float32)
    values = np.zeros((0, bands), np.float32)
    return Overlaps(
        a=none, b=none, value_a=values, value_b=values, xy_a=two, xy_b=two, view_a=two,
        view_b=two, weight=values,
    )  # fmt: skip


def choose_pairs(windows: Sequence[Window], partners: int) -> Indices:
    """Pairs (i, j), i < j, of photos to compare, sorted; shape (pairs, 2).

    For each photo the partners of largest overlap, in turn from every direction: along a strip
    with much overlap alone the strips would not be tied to each other.
    """
    from shapely import STRtree, box

    if len(windows) < 2:
        return np.zeros((0, 2), np.int64)
    ends = _ends(windows)
    boxes = box(*ends.T)
    tree = STRtree(boxes)
    chosen: list[Indices] = []
    for first in range(0, len(windows), BATCH):
        own, other = tree.query(boxes[first : first + BATCH], predicate="intersects")
        own = own + first
        low = np.maximum(ends[own, :2], ends[other, :2])
        area = np.prod(np.minimum(ends[own, 2:], ends[other, 2:]) - low, axis=1)
        meets = (own != other) & (area > 0)
        own, other, area = own[meets], other[meets], area[meets]
        keep = _best_of_each(own, other, area, ends, partners)
        chosen.append(np.sort(np.stack([own[keep], other[keep]], axis=1), axis=1))
    return np.unique(np.concatenate(chosen), axis=0).astype(np.int64)


def _ends(windows: Sequence[Window]) -> Array:
    """Left, top, right, bottom; shape (n, 4)."""
    return np.array(
        [(w.col, w.row, w.col + w.width, w.row + w.height) for w in windows], dtype=np.float64
    )


def _best_of_each(own: Indices, other: Indices, area: Array, ends: Array, count: int) -> Indices:
    """Places in the list of candidates of the `count` partners to take for each photo."""
    centre = (ends[:, :2] + ends[:, 2:]) / 2
    away = centre[other] - centre[own]
    turn = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi)
    sector = np.round(turn * SECTORS).astype(np.int64) % SECTORS
    order = np.lexsort((other, -area, sector, own))
    rank = _rank_in_run(own[order] * SECTORS + sector[order])
    again = np.lexsort((other[order], -area[order], rank, own[order]))
    order = order[again]
    return np.asarray(order[_rank_in_run(own[order]) < count])


def _rank_in_run(keys: NDArray[np.integer]) -> Indices:
    """Number of each item within its run of equal keys; shape (n,)."""
    places = np.arange(keys.size)
    starts = np.concatenate([[True], keys[1:] != keys[:-1]]) if keys.size else np.zeros(0, bool)
    return np.asarray(places - np.maximum.accumulate(np.where(starts, places, 0)))


def _in_reading_order(windows: Sequence[Window], pairs: Indices) -> Iterator[tuple[int, int]]:
    """Pairs in an order along a curve through the site, so that what is kept is needed soon."""
    if not len(pairs):
        return
    ends = _ends(windows)
    centre = (ends[:, :2] + ends[:, 2:]) / 2
    place = np.empty(len(windows), np.int64)
    place[np.argsort(_morton(centre), kind="stable")] = np.arange(len(windows))
    later = np.sort(place[pairs], axis=1)
    for i, j in pairs[np.lexsort((later[:, 0], later[:, 1]))]:
        yield int(i), int(j)


def _morton(p: Array) -> Indices:
    """Number along the Z curve of points (n, 2)."""
    span = max(float(np.ptp(p, axis=0).max()), 1.0)
    cell = ((p - p.min(axis=0)) / span * 1023).astype(np.int64)
    code = np.zeros(len(p), np.int64)
    for bit in range(10):
        for axis in (0, 1):
            code |= ((cell[:, axis] >> bit) & 1) << (2 * bit + axis)
    return code


def _compare(a: Blocks, b: Blocks, limit: int) -> tuple[NDArray[Any], ...] | None:
    """Values, places and views of both, larger spread, good bands, of blocks that both show."""
    top, left = max(a.row, b.row), max(a.col, b.col)
    rows = min(a.row + a.good.shape[0], b.row + b.good.shape[0]) - top
    cols = min(a.col + a.good.shape[1], b.col + b.good.shape[1]) - left
    if rows <= 0 or cols <= 0:
        return None
    in_a, in_b = a.part(top, left, (rows, cols)), b.part(top, left, (rows, cols))
    good = a.good[in_a] & b.good[in_b]
    r, c = np.nonzero(good.any(axis=2))
    if not r.size:
        return None
    which = evenly(top + r, left + c, limit)
    r, c = r[which], c[which]
    return (
        a.mean[in_a][r, c], b.mean[in_b][r, c],
        a.xy[in_a][r, c], b.xy[in_b][r, c],
        a.view[in_a][r, c], b.view[in_b][r, c],
        np.maximum(a.spread[in_a][r, c], b.spread[in_b][r, c]), good[r, c],
    )  # fmt: skip
