"""A tile in the making: photos are sampled, coloured and weighed in one pass over its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Window
from georef_gis.mosaic.colour_field import Lattice, Tint, value_range
from georef_gis.mosaic.compiled import compiled
from georef_gis.rasters.warp import Image, Mask

Values = NDArray[np.float32]
NO_VALUES: Values = np.zeros((0, 0), np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Positions:
    """Where pixels of the grid lie in a photo, by a mesh whose nodes belong to the grid.

    Parameters
    ----------
    nodes : shape (rows, cols, 2), px
        Pixels of the photo at the centres of the grid's cells of `step` pixels.
    moves : shape (rows, cols, 2), px/m
        How far they move per metre of height; None over ground that the mesh follows.
    first
        Row and column of the first node, counted in cells from the grid's corner.
    step : px
    size
        Width and height of the photo, px.
    reduce
        By how much it was decoded smaller.
    """

    nodes: Array
    moves: Array | None
    first: tuple[int, int]
    step: int
    size: tuple[int, int]
    reduce: int


def shows_any(window: Window, at: Positions, weight: Values, relief: Values | None) -> bool:
    """Whether a photo shows any pixel of a window where a weight is not 0; needs no pixels."""
    probe = Canvas(window)
    nothing = np.zeros((1, 1, 1), np.uint8)
    tint = Tint.none(Lattice.around(window, 1), 1)
    probe.add(nothing, at, tint, weight=weight, relief=relief)
    return bool(probe.weight.any())


class Canvas:
    """Weighted sums of photos over a window.

    Attributes
    ----------
    weight : shape (rows, cols)
        Sum of the weights; 0 where nothing is.
    dtype
        Of the photos; None before the first.
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self.weight: Values = np.zeros((window.height, window.width), np.float32)
        self._sum: Values = np.zeros((0, 0, 0), np.float32)
        self.dtype: np.dtype[np.generic] | None = None

    @property
    def whole(self) -> bool:
        """Whether every pixel has a value."""
        return bool(np.all(self.weight))

    def holes(self, box: tuple[slice, slice] | None = None) -> Values:
        """1 where nothing is in a box (rows, cols), else 0; (rows, cols) of the window."""
        within = box or (slice(None), slice(None))
        out: Values = np.zeros(self.weight.shape, np.float32)
        out[within] = self.weight[within] == 0.0
        return out

    def add(
        self, image: Image, at: Positions, tint: Tint, *, weight: Values | None,
        relief: Values | None,
    ) -> None:  # fmt: skip
        """Add a photo where it shows the ground.

        Parameters
        ----------
        image : shape (rows, cols, bands)
            The decoded photo.
        weight : shape (rows, cols)
            At every pixel of the window; None = 1.
        relief : shape (rows, cols), m
            Height above the mesh, with `at.moves`; pixels where it is NaN are not shown.
        """
        shape = (*self.weight.shape, image.shape[2])
        if self._sum.shape != shape:
            self._sum = np.zeros(shape, np.float32)
            self.dtype = image.dtype
        moves = at.moves if at.moves is not None and relief is not None else None
        _add(
            image,
            (at.nodes, at.nodes[:0] if moves is None else moves),
            NO_VALUES if moves is None or relief is None else relief,
            _mesh_place(self.window, at),
            (float(at.size[0]), float(at.size[1]), 1.0 / at.reduce),
            NO_VALUES if weight is None else weight,
            (tint.gain, tint.add),
            (tint.lattice.y0, tint.lattice.x0, 1.0 / tint.lattice.spacing, tint.knee),
            self._sum, self.weight,
        )  # fmt: skip

    def means(self) -> Values:
        """Weighted means, 0 where nothing is; (rows, cols, bands)."""
        share = np.maximum(self.weight, np.float32(1e-12))[..., None]
        return np.asarray(self._sum / share, dtype=np.float32)

    def result(self) -> tuple[Image, Mask | None] | None:
        """Pixels in the photos' own type, and where there are any; None where there are none."""
        if self.dtype is None:
            return None
        out: Image = np.zeros(self._sum.shape, self.dtype)
        low, high = value_range(out.dtype)
        count = _settle(self._sum, self.weight, low, high, out)
        if not count:
            return None
        return (out, None) if count == self.weight.size else (out, self.weight > 0.0)


def _mesh_place(window: Window, at: Positions) -> tuple[float, float, float]:
    """Row and column of the window's first pixel among the nodes, and their spacing's inverse."""
    # exact for steps that are powers of two: the same for a pixel whatever its window
    row = (window.row + 0.5) / at.step - 0.5 - at.first[0]
    col = (window.col + 0.5) / at.step - 0.5 - at.first[1]
    return row, col, 1.0 / at.step


@compiled
def _mix(a, b, part):  # type: ignore[no-untyped-def]
    """What lies between two values."""
    return a + part * (b - a)


@compiled
def _add(  # type: ignore[no-untyped-def]
    image, meshes, relief, mesh_place, size, weights, tints, tint_place, total, share
):
    """Add weight times coloured bilinear samples, and the weights."""
    nodes, moves = meshes
    gain, add = tints
    rows, cols, bands = total.shape
    high, wide = image.shape[0] - 1, image.shape[1] - 1
    right, bottom, scale = size[0] - 0.5, size[1] - 0.5, size[2]
    has_relief, has_weight = relief.size > 0, weights.size > 0
    n_nodes, n_knots = nodes.shape[1], gain.shape[1]
    last, one = n_nodes - 1.0, np.uint64(1)
    knee, single = np.float32(tint_place[3]), np.float32(1.0)
    # meshes and lattice along a row
    line = np.zeros((n_nodes, 4))
    g = np.zeros((n_knots, bands), np.float32)
    d = np.zeros((n_knots, bands), np.float32)
    value = np.zeros(bands, np.float32)
    for r in range(rows):
        if has_weight:
            empty = True
            for c in range(cols):
                if weights[r, c] > 0.0:
                    empty = False
                    break
            if empty:
                continue
        y = mesh_place[0] + r * mesh_place[2]
        i = int(np.floor(y))
        if i < 0 or i + 1 >= nodes.shape[0]:
            continue
        f = y - i
        for k in range(n_nodes):
            for b in range(2):
                line[k, b] = _mix(nodes[i, k, b], nodes[i + 1, k, b], f)
                if has_relief:
                    line[k, 2 + b] = _mix(moves[i, k, b], moves[i + 1, k, b], f)
        y = tint_place[0] + r * tint_place[2]
        i = min(max(int(y), 0), gain.shape[0] - 2)
        t = np.float32(y - i)
        for k in range(n_knots):
            for b in range(bands):
                g[k, b] = _mix(gain[i, k, b], gain[i + 1, k, b], t)
                d[k, b] = _mix(add[i, k, b], add[i + 1, k, b], t)
        for c in range(cols):
            w = np.float32(1.0)
            if has_weight:
                w = weights[r, c]
                if not w > 0.0:
                    continue
            x = mesh_place[1] + c * mesh_place[2]
            if not (x >= 0.0 and x < last):
                continue
            # unsigned: an index that cannot be negative costs no test
            j = np.uint64(x)
            f = x - j
            u = _mix(line[j, 0], line[j + one, 0], f)
            v = _mix(line[j, 1], line[j + one, 1], f)
            if has_relief:
                h = relief[r, c]
                u += h * _mix(line[j, 2], line[j + one, 2], f)
                v += h * _mix(line[j, 3], line[j + one, 3], f)
            # NaN compares as false
            if not (u >= -0.5 and v >= -0.5 and u <= right and v <= bottom):
                continue
            u = min(max((u + 0.5) * scale - 0.5, 0.0), float(wide))
            v = min(max((v + 0.5) * scale - 0.5, 0.0), float(high))
            c0, r0 = np.uint64(u), np.uint64(v)
            c1, r1 = min(c0 + one, np.uint64(wide)), min(r0 + one, np.uint64(high))
            s, t = np.float32(u - c0), np.float32(v - r0)
            x = tint_place[1] + c * tint_place[2]
            j = np.uint64(min(max(int(x), 0), n_knots - 2))
            e = np.float32(x - j)
            known = True
            for b in range(bands):
                q = _mix(np.float32(image[r0, c0, b]), np.float32(image[r0, c1, b]), s)
                low = _mix(np.float32(image[r1, c0, b]), np.float32(image[r1, c1, b]), s)
                q = _mix(q, low, t)
                gained = _mix(g[j, b], g[j + one, b], e)
                if knee > 0.0:
                    # as `tone.toned` does
                    gained /= single + (gained - single) * knee * q
                value[b] = q * gained + _mix(d[j, b], d[j + one, b], e)
                known = known and np.isfinite(value[b])
            if known:
                for b in range(bands):
                    total[r, c, b] += w * value[b]
                share[r, c] += w


@compiled
def _settle(total, share, low, high, out):  # type: ignore[no-untyped-def]
    """Means into `out`, rounded and cut to its range if that is finite; how many there are."""
    rows, cols, bands = total.shape
    integer = high < np.inf
    count = 0
    for r in range(rows):
        for c in range(cols):
            w = share[r, c]
            if not w > 0.0:
                continue
            count += 1
            for b in range(bands):
                value = total[r, c, b] / w
                if integer:
                    value = np.floor(min(max(value + np.float32(0.5), low), high))
                out[r, c, b] = value
    return count
