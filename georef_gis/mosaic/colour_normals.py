"""Equations of the colour solution: differences over common blocks, linear in all unknowns.

Of a block seen by photos a and b with grey values v, relative to the typical one::

    r = m (log v_a + l_a - log v_b - l_b) + o_a - o_b,   l = gain + vignetting + trend

where m is the corrected grey value, kept from the iteration before. That is the corrected
difference to first order, but it cannot be made small by making both photos dark.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.coarse import Mask
from georef_gis.mosaic.colour_basis import RADIAL_POWERS, TREND_TERMS, radial_basis, trend_basis
from georef_gis.mosaic.compiled import compiled
from georef_gis.mosaic.hot_spot import Spot, find_spot
from georef_gis.mosaic.overlaps import Floats, Indices, Overlaps

# relative to the typical grey value; darker ones have no logarithm worth its noise
DARKEST = 0.005
# relative to the typical grey value, which is about the top of the range
BRIGHTEST = 2.0
# blocks worked on together: their shapes stay in the processor's cache
CHUNK = 20_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Where the unknowns of one band are: gains, offsets, vignettings, trends.

    Parameters
    ----------
    camera, flight : shape (n,)
        Number of each photo's camera and flight.
    """

    camera: Indices
    flight: Indices
    cameras: int
    flights: int

    @property
    def photos(self) -> int:
        """Number of photos."""
        return int(self.camera.size)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        shared = self.cameras * len(RADIAL_POWERS) + self.flights * TREND_TERMS
        return 2 * self.photos + shared

    def vignetting(self, camera: int) -> slice:
        """Unknowns of a camera."""
        first = 2 * self.photos + camera * len(RADIAL_POWERS)
        return slice(first, first + len(RADIAL_POWERS))

    def trend(self, flight: int) -> slice:
        """Unknowns of a flight."""
        first = 2 * self.photos + self.cameras * len(RADIAL_POWERS) + flight * TREND_TERMS
        return slice(first, first + TREND_TERMS)


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    """Blocks of whole pairs whose cameras and flights are the same."""

    blocks: slice
    pairs: slice
    # unknowns that photos share, and their shapes at both ends, (blocks, columns)
    columns: Indices
    shapes_a: Floats
    shapes_b: Floats


class Equations:
    """Normal equations from overlaps.

    Parameters
    ----------
    reach
        Most oblique view, as the length of its horizontal part.
    scale
        Typical grey value: 1 in these equations.
    spots
        Where the hot spot is, for flights that have one.
    """

    def __init__(
        self,
        overlaps: Overlaps,
        layout: Layout,
        *,
        reach: float,
        scale: float,
        spots: Mapping[int, Spot],
    ) -> None:
        self._layout, self._reach, self._spots = layout, reach, spots
        kinds = _kinds(overlaps, layout)
        order = np.lexsort((overlaps.b, overlaps.a, kinds))
        # they are large: not copied where they are in order
        in_order = np.array_equal(order, np.arange(order.size))
        self._o = overlaps if in_order else _chosen(overlaps, order)
        kinds = kinds[order]
        a, b = self._o.a, self._o.b
        new = np.concatenate([[True], (a[1:] != a[:-1]) | (b[1:] != b[:-1])])
        self._starts = np.flatnonzero(new)
        self._pair_of = np.cumsum(new) - 1
        self._chunks = [
            _Chunk(blocks, pairs, *self._shapes(blocks))
            for blocks, pairs in _pieces(self._starts, len(self._o), kinds[self._starts])
        ]
        self._incidence = self._pairs_of_photos()
        dark = np.float32(DARKEST)
        self._value_a = np.log(np.maximum(self._o.value_a / np.float32(scale), dark))
        self._value_b = np.log(np.maximum(self._o.value_b / np.float32(scale), dark))

    def _pairs_of_photos(self) -> Any:
        """+1 and -1 where a photo is the first or the second of a pair; (photos, pairs)."""
        from scipy.sparse import csr_matrix

        pairs = np.arange(self._starts.size)
        ones = np.ones(pairs.size)
        return csr_matrix(
            (
                np.concatenate([ones, -ones]),
                (
                    np.concatenate([self._o.a[self._starts], self._o.b[self._starts]]),
                    np.concatenate([pairs, pairs]),
                ),
            ),
            shape=(self._layout.photos, pairs.size),
        )

    def weights(self, blocks_per_pair: float) -> Array:
        """Weight of each block before any look at its residual, no pair counting more; (k,).

        Blocks of a pair share what the equations do not know, so many are not worth their number.
        """
        own = self._o.weight.astype(np.float64)
        total = np.add.reduceat(own, self._starts)
        share = np.minimum(1.0, blocks_per_pair / np.maximum(total, 1e-12))
        return np.asarray(own * share[self._pair_of])

    def differences(self, x: Array) -> tuple[Array, Array]:
        """Residuals and corrected grey values for unknowns (size, bands); both (k, bands)."""
        n, o = self._layout.photos, self._o
        gain, offset = x[:n], x[n : 2 * n]
        log_a, log_b = self._value_a + gain[o.a], self._value_b + gain[o.b]
        for chunk in self._chunks:
            log_a[chunk.blocks] += chunk.shapes_a @ x[chunk.columns]
            log_b[chunk.blocks] += chunk.shapes_b @ x[chunk.columns]
        # bounded, or gains that stray would weigh themselves up
        middle = np.exp(np.clip(0.5 * (log_a + log_b), np.log(DARKEST), np.log(BRIGHTEST)))
        apart = np.subtract(log_a, log_b, out=log_a)
        return middle * apart + offset[o.a] - offset[o.b], middle

    def find_spots(self, x: Array, weights: Array) -> dict[int, Spot]:
        """Hot spots in what unknowns (size, bands) leave, of the flights that have one."""
        residual, middle = self.differences(x)
        apart, strength = (residual / middle).mean(axis=1), weights * (middle**2).mean(axis=1)
        flights = self._layout.flight[self._o.a], self._layout.flight[self._o.b]
        found = {}
        for flight in range(self._layout.flights):
            own = (flights[0] == flight) & (flights[1] == flight)
            spot = find_spot(_chosen(self._o, own), apart[own], strength[own], self._reach)
            if spot is not None:
                found[flight] = spot
        return found

    def normals(self, band: int, weights: Array, middle: Array) -> tuple[Any, Array]:
        """Matrix (size, size) and right side (size,) of a band.

        Parameters
        ----------
        weights : shape (k,)
            One over the variance.
        middle : shape (k,)
            Corrected grey value.
        """
        from scipy.sparse import csr_matrix, diags

        known = middle * (self._value_a[:, band] - self._value_b[:, band])
        size, n = self._layout.size, self._layout.photos
        shared, shared_right = np.zeros((size - 2 * n, size - 2 * n)), np.zeros(size - 2 * n)
        sums = np.zeros((self._starts.size, 5))
        edges: list[tuple[Indices, Array]] = []
        for chunk in self._chunks:
            edge, inner, own = self._summed(chunk, (weights, middle, known), sums)
            columns = chunk.columns - 2 * n
            shared[np.ix_(columns, columns)] += inner
            shared_right[columns] += own
            edges.append((columns, edge))
        gains, offsets = (_stacked([(c, e[i]) for c, e in edges], size - 2 * n) for i in (0, 1))
        k, kt = self._incidence, self._incidence.T
        gg, go, oo = (k @ diags(sums[:, i]) @ kt for i in range(3))
        matrix = _bordered([[gg, go, k @ gains], [go, oo, k @ offsets]], csr_matrix(shared))
        return matrix, -np.concatenate([k @ sums[:, 3], k @ sums[:, 4], shared_right])

    def _summed(
        self, chunk: _Chunk, terms: tuple[Array, Array, Array], sums: Array
    ) -> tuple[Array, Array, Array]:
        """Sums of a chunk: pairs by shared unknowns, shared ones, their right side."""
        b, count = chunk.blocks, chunk.columns.size
        pairs = chunk.pairs.stop - chunk.pairs.start
        edge, inner = np.zeros((2, pairs, count)), np.zeros((count, count))
        right = np.zeros(count)
        number = self._pair_of[b] - chunk.pairs.start
        weights, middle, known = (term[b] for term in terms)
        ends = (chunk.shapes_a, chunk.shapes_b)
        out = (sums[chunk.pairs], edge, inner, right)
        _accumulate(ends, number, weights, middle, known, out)
        return edge, np.asarray(inner + np.tril(inner, -1).T), right

    def _shapes(self, blocks: slice) -> tuple[Indices, Floats, Floats]:
        """Columns of the unknowns that photos share, and their shapes at both ends of blocks."""
        o, lay = self._o, self._layout
        ends = []
        for photos, xy, view in ((o.a, o.xy_a, o.view_a), (o.b, o.xy_b, o.view_b)):
            first = int(photos[blocks.start])
            camera, flight = int(lay.camera[first]), int(lay.flight[first])
            parts = (lay.vignetting(camera), lay.trend(flight))
            columns = np.concatenate([np.arange(p.start, p.stop) for p in parts])
            trend = trend_basis(view[blocks], self._reach, self._spots.get(flight))
            pieces = (radial_basis(xy[blocks]), trend)
            ends.append((columns, np.concatenate(pieces, axis=1)))
        columns = np.union1d(ends[0][0], ends[1][0])
        full = np.zeros((2, blocks.stop - blocks.start, columns.size), np.float32)
        for out, (own, shape) in zip(full, ends, strict=True):
            out[:, np.searchsorted(columns, own)] = shape
        return columns, full[0], full[1]


def _kinds(overlaps: Overlaps, layout: Layout) -> Indices:
    """Number of the combination of cameras and flights that a block belongs to; (k,)."""
    one = layout.camera * layout.flights + layout.flight
    return np.asarray(one[overlaps.a] * (layout.cameras * layout.flights) + one[overlaps.b])


def _chosen(overlaps: Overlaps, which: Indices | Mask) -> Overlaps:
    """Some of the overlaps, or all in another order."""
    return Overlaps(**{f.name: getattr(overlaps, f.name)[which] for f in fields(Overlaps)})


def _pieces(starts: Indices, count: int, kinds: Indices) -> Iterator[tuple[slice, slice]]:
    """Blocks and pairs of runs of pairs of one kind, about `CHUNK` blocks each."""
    ends = np.append(starts[1:], count)
    first = 0
    for pair in range(starts.size):
        last = pair + 1 == starts.size
        full = ends[pair] - starts[first] >= CHUNK
        if last or full or kinds[pair + 1] != kinds[pair]:
            yield slice(int(starts[first]), int(ends[pair])), slice(first, pair + 1)
            first = pair + 1


@compiled
def _accumulate(
    ends: tuple[Floats, Floats],
    pair: Indices,
    weights: Array,
    middle: Array,
    known: Array,
    out: tuple[Array, Array, Array, Array],
) -> None:
    """Add up the normal equations of blocks: per pair, per pair and shape, lower triangle, right.

    Array expressions would go through memory five times for each of these.
    """
    sums, edge, inner, right = out
    shapes = np.empty(right.size)
    for i in range(weights.size):
        w, m, p = weights[i], middle[i], pair[i]
        w_m = w * m
        w_mm = w_m * m
        sums[p, 0] += w_mm
        sums[p, 1] += w_m
        sums[p, 2] += w
        sums[p, 3] += w_m * known[i]
        sums[p, 4] += w * known[i]
        for j in range(right.size):
            d = np.float64(ends[0][i, j]) - np.float64(ends[1][i, j])
            shapes[j] = d
            edge[0, p, j] += w_mm * d
            edge[1, p, j] += w_m * d
            right[j] += w_m * known[i] * d
            for k in range(j + 1):
                inner[j, k] += w_mm * d * shapes[k]


def _stacked(parts: list[tuple[Indices, Array]], width: int) -> Any:
    """Sparse (pairs, width) from dense pieces over some of its columns."""
    from scipy.sparse import csr_matrix

    values = np.concatenate([part.ravel() for _, part in parts])
    columns = np.concatenate([np.tile(own, part.shape[0]) for own, part in parts])
    counts = np.concatenate([np.full(part.shape[0], part.shape[1]) for _, part in parts])
    pointers = np.concatenate([[0], np.cumsum(counts)])
    return csr_matrix((values, columns, pointers), shape=(counts.size, width))


def _bordered(rows: list[list[Any]], corner: NDArray[Any] | Any) -> Any:
    """Whole symmetric matrix from its upper rows of blocks and its last block."""
    from scipy.sparse import bmat

    (gg, go, gs), (_, oo, os) = rows
    return bmat([[gg, go, gs], [go, oo, os], [gs.T, os.T, corner]], format="csc")
