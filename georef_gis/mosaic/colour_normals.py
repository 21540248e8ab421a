"""Equations of the colour solution: differences over common blocks, linear in all unknowns.

Of a block seen by photos a and b with grey values v, relative to the typical one::

    r = m (y(v_a) + l_a - y(v_b) - l_b) + o_a - o_b,   l = gain + vignetting + trend

where y is the logarithm of v, or of v / (1 - knee v): see `tone.py`. m is how fast a corrected
grey value grows with its y, kept from the iteration before. That is the corrected difference to
first order, but it cannot be made small by making both photos dark.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Floats, Indices
from georef_gis.mosaic.colour_basis import RADIAL_POWERS, TREND_TERMS, radial_basis, trend_basis
from georef_gis.mosaic.compiled import compiled
from georef_gis.mosaic.hot_spot import MOST, Spot, find_spot
from georef_gis.mosaic.overlaps import Overlaps
from georef_gis.mosaic.symmetric import SparseSymmetric
from georef_gis.mosaic.tone import grown, tone_of

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

    @classmethod
    def of(cls, camera_of: Sequence[str], flight_of: Sequence[str]) -> Layout:
        """Layout from the names of each photo's camera and flight, numbered in their order."""
        cameras, camera = np.unique(np.array(camera_of, dtype=np.str_), return_inverse=True)
        flights, flight = np.unique(np.array(flight_of, dtype=np.str_), return_inverse=True)
        return cls(camera=camera, flight=flight, cameras=cameras.size, flights=flights.size)

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
    """Blocks of whole pairs of one kind, as slices, and shapes at both ends, (blocks, columns)."""

    blocks: slice
    pairs: slice
    shapes_a: Floats
    shapes_b: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Kind:
    """Pairs whose cameras and flights are the same.

    `columns` are the unknowns that they share, `photos` those that take part, `incidence` (photos,
    pairs) has +1 and -1 where a photo is the first or the second of a pair.
    """

    pairs: slice
    columns: Indices
    photos: Indices
    incidence: Any
    chunks: tuple[_Chunk, ...]


class Equations:
    """Normal equations from overlaps.

    Parameters
    ----------
    reach
        Most oblique view, as the length of its horizontal part.
    scale
        Typical grey value: 1 in these equations.
    knee
        One over the value that no gain changes, in these units; 0 = none.
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
        knee: float,
        spots: Mapping[int, Spot],
    ) -> None:
        self._layout, self._reach, self._spots, self._knee = layout, reach, spots, knee
        kinds = _kinds(overlaps, layout)
        order = np.lexsort((overlaps.b, overlaps.a, kinds))
        # they are large: not copied where they are in order
        in_order = np.array_equal(order, np.arange(order.size))
        self._o = o = overlaps if in_order else chosen(overlaps, order)
        new = np.concatenate([[True], (o.a[1:] != o.a[:-1]) | (o.b[1:] != o.b[:-1])])
        self._starts = np.flatnonzero(new)
        self._pair_of = np.cumsum(new) - 1
        self._pairs = np.stack([o.a[self._starts], o.b[self._starts]])
        self._kinds = tuple(self._all_kinds(kinds[order][self._starts]))
        self._matrix = self._pattern()
        self._value_a, self._value_b = (
            tone_of(value / np.float32(scale), DARKEST, knee) for value in (o.value_a, o.value_b)
        )

    @property
    def layout(self) -> Layout:
        """Where the unknowns are."""
        return self._layout

    @property
    def overlaps(self) -> Overlaps:
        """The blocks in the order that all results have."""
        return self._o

    def _all_kinds(self, kinds: Indices) -> Iterator[_Kind]:
        """Kinds of pairs, whose numbers are sorted."""
        o, ends = self._o, np.append(self._starts, len(self._o))
        first = np.flatnonzero(np.diff(kinds, prepend=-1))
        for start, stop in pairwise([*first.tolist(), kinds.size]):
            a, b = self._pairs[:, start:stop]
            one, two = int(a[0]), int(b[0])
            columns = np.union1d(self._columns(one), self._columns(two))
            chunks = []
            for part in _pieces(ends[start : stop + 1]):
                pairs = slice(start + part.start, start + part.stop)
                at = slice(int(ends[pairs.start]), int(ends[pairs.stop]))
                shapes_a = self._shapes(one, columns, o.xy_a[at], o.view_a[at])
                shapes_b = self._shapes(two, columns, o.xy_b[at], o.view_b[at])
                chunks.append(_Chunk(at, pairs, shapes_a, shapes_b))
            photos = np.union1d(a, b)
            incidence = _incidence(np.searchsorted(photos, (a, b)), photos.size)
            yield _Kind(slice(start, stop), columns, photos, incidence, tuple(chunks))

    def _pattern(self) -> SparseSymmetric:
        """Where `normals` has its entries."""
        n, (a, b) = self._layout.photos, self._pairs
        photo, every = np.arange(n), np.arange(self._layout.size)
        blocks = [
            (photo, photo), (photo, n + photo), (n + photo, n + photo),
            (a, b), (a, n + b), (b, n + a), (n + a, n + b), (every, every),
        ]  # fmt: skip
        for kind in self._kinds:
            rows, cols = (x.ravel() for x in np.meshgrid(kind.photos, kind.columns, indexing="ij"))
            low = np.tril_indices(kind.columns.size)
            blocks += [(rows, cols), (n + rows, cols)]
            blocks.append((kind.columns[low[0]], kind.columns[low[1]]))
        return SparseSymmetric(self._layout.size, blocks)

    def weights(self, blocks_per_pair: float) -> Array:
        """Weight of each block before any look at its residual, no pair counting more; (k, bands).

        Blocks of a pair share what the equations do not know, so many are not worth their number.
        """
        own = self._o.weight.astype(np.float64)
        total = np.add.reduceat(own, self._starts)
        share = np.minimum(1.0, blocks_per_pair / np.maximum(total, 1e-12))
        return np.asarray(own * share[self._pair_of])

    def differences(self, x: Array) -> tuple[Array, Array]:
        """Residuals for unknowns (size, bands), and how fast they grow with l; both (k, bands)."""
        n, o = self._layout.photos, self._o
        gain, offset = x[:n], x[n : 2 * n]
        tone_a, tone_b = self._value_a + gain[o.a], self._value_b + gain[o.b]
        for kind in self._kinds:
            for chunk in kind.chunks:
                tone_a[chunk.blocks] += chunk.shapes_a @ x[kind.columns]
                tone_b[chunk.blocks] += chunk.shapes_b @ x[kind.columns]
        # bounded, or gains that stray would weigh themselves up
        middle = np.clip(0.5 * (tone_a + tone_b), np.log(DARKEST), self._brightest)
        slope = grown(middle, self._knee)
        apart = np.subtract(tone_a, tone_b, out=tone_a)
        return slope * apart + offset[o.a] - offset[o.b], slope

    @property
    def _brightest(self) -> float:
        """Of the logarithms; odds have their end far above that of values."""
        return float(np.log(BRIGHTEST)) if self._knee == 0.0 else np.inf

    def find_spots(self, x: Array, weights: Array) -> dict[int, Spot]:
        """Hot spots in what unknowns (size, bands) leave, of the flights that have one."""
        residual, slope = self.differences(x)
        strength = weights * slope**2
        total = strength.sum(axis=1)
        apart = (strength * (residual / slope)).sum(axis=1) / np.maximum(total, 1e-30)
        flights = self._layout.flight[self._o.a], self._layout.flight[self._o.b]
        found = {}
        for flight in range(self._layout.flights):
            own = np.flatnonzero((flights[0] == flight) & (flights[1] == flight))
            own = own[:: -(-max(own.size, 1) // MOST)]
            spot = find_spot(chosen(self._o, own), apart[own], total[own], self._reach)
            if spot is not None:
                found[flight] = spot
        return found

    def normals(self, band: int, weights: Array, slope: Array, prior: Array) -> tuple[Any, Array]:
        """Matrix (size, size) and right side (size,) of a band.

        Parameters
        ----------
        weights : shape (k,)
            One over the variance.
        slope : shape (k,)
            See `differences`.
        prior : shape (size,)
            One over the variance of the unknowns.
        """
        known = slope * (self._value_a[:, band] - self._value_b[:, band])
        n, (a, b) = self._layout.photos, self._pairs
        sums, right = np.zeros((a.size, 5)), np.zeros(self._layout.size)
        border: list[Array] = []
        for kind in self._kinds:
            edge, inner, own = self._summed(kind, (weights, slope, known), sums)
            right[kind.columns] += own
            border += [edge[:, 0], edge[:, 1], inner[np.tril_indices(own.size)]]

        def of_photos(values: Array, sign: float) -> Array:
            first, second = (np.bincount(end, values, minlength=n) for end in (a, b))
            return np.asarray(first + sign * second)

        gg, go, oo, gain, offset = sums.T
        right[:n], right[n : 2 * n] = of_photos(gain, -1.0), of_photos(offset, -1.0)
        diagonal = [of_photos(values, 1.0) for values in (gg, go, oo)]
        return self._matrix.filled([*diagonal, -gg, -go, -go, -oo, prior, *border]), -right

    def _summed(
        self, kind: _Kind, terms: tuple[Array, Array, Array], sums: Array
    ) -> tuple[Array, Array, Array]:
        """Sums of a kind: photos by shared unknowns for gain and offset, shared, their right side.

        `terms` are weights, slopes and known differences; `sums` (pairs, 5) is filled.
        """
        first, count = kind.pairs.start, kind.columns.size
        edge = np.zeros((kind.pairs.stop - first, 2, count))
        inner, right = np.zeros((count, count)), np.zeros(count)
        for chunk in kind.chunks:
            rows = slice(chunk.pairs.start - first, chunk.pairs.stop - first)
            number = self._pair_of[chunk.blocks] - chunk.pairs.start
            weights, slope, known = (term[chunk.blocks] for term in terms)
            out = (sums[chunk.pairs], edge[rows], inner, right)
            _accumulate((chunk.shapes_a, chunk.shapes_b), number, weights, slope, known, out)
        both = kind.incidence @ edge.reshape(-1, 2 * count)
        return both.reshape(-1, 2, count), inner, right

    def _columns(self, photo: int) -> Indices:
        """Unknowns that a photo shares with others."""
        lay = self._layout
        own = lay.vignetting(int(lay.camera[photo])), lay.trend(int(lay.flight[photo]))
        return np.concatenate([np.arange(part.start, part.stop) for part in own])

    def _shapes(self, photo: int, columns: Indices, xy: Floats, view: Floats) -> Floats:
        """Shapes of shared unknowns at places of photos like one; (blocks, columns)."""
        spot = self._spots.get(int(self._layout.flight[photo]))
        shapes = (radial_basis(xy), trend_basis(view, self._reach, spot))
        out = np.zeros((len(xy), columns.size), np.float32)
        out[:, np.searchsorted(columns, self._columns(photo))] = np.concatenate(shapes, axis=1)
        return out


def _kinds(overlaps: Overlaps, layout: Layout) -> Indices:
    """Number of the combination of cameras and flights that a block belongs to; (k,)."""
    one = layout.camera * layout.flights + layout.flight
    return np.asarray(one[overlaps.a] * (layout.cameras * layout.flights) + one[overlaps.b])


def chosen(overlaps: Overlaps, which: Indices | slice) -> Overlaps:
    """Some of the overlaps, or all in another order."""
    return Overlaps(**{f.name: getattr(overlaps, f.name)[which] for f in fields(Overlaps)})


def _incidence(pairs: Indices, photos: int) -> Any:
    """+1 and -1 where a photo is the first or the second of a pair (2, pairs); (photos, pairs)."""
    from scipy.sparse import csr_matrix

    count = pairs.shape[1]
    signs = np.repeat([1.0, -1.0], count)
    number = np.tile(np.arange(count), 2)
    return csr_matrix((signs, (pairs.ravel(), number)), shape=(photos, count))


def _pieces(ends: Indices) -> Iterator[slice]:
    """Runs of pairs of about `CHUNK` blocks, from where pairs begin and the last one ends."""
    first = 0
    for pair in range(1, ends.size):
        if pair + 1 == ends.size or ends[pair] - ends[first] >= CHUNK:
            yield slice(first, pair)
            first = pair


@compiled
def _accumulate(
    ends: tuple[Floats, Floats],
    pair: Indices,
    weights: Array,
    slope: Array,
    known: Array,
    out: tuple[Array, Array, Array, Array],
) -> None:
    """Add up the normal equations: per pair, per pair and shape, lower triangle, right side.

    Array expressions would go through memory five times for each of these.
    """
    sums, edge, inner, right = out
    shapes = np.empty(right.size)
    for i in range(weights.size):
        w, m, p = weights[i], slope[i], pair[i]
        if w == 0.0:
            continue
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
            edge[p, 0, j] += w_mm * d
            edge[p, 1, j] += w_m * d
            right[j] += w_m * known[i] * d
            for k in range(j + 1):
                inner[j, k] += w_mm * d * shapes[k]
