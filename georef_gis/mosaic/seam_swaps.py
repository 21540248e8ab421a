"""Swaps of two photos: what shows either of them is decided anew by a minimum cut."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Window
from georef_gis.mosaic.coarse import Mask, SparseRaster, common, part_of
from georef_gis.mosaic.min_cut import STEPS, min_cut
from georef_gis.mosaic.seam_costs import Costs
from georef_gis.mosaic.seam_scales import Scale
from georef_gis.mosaic.windows import box_of, grown

Labels = NDArray[np.int32]
Pair = tuple[int, int]
# photos that touch, and in which window
Border = tuple[Pair, Window]
# rows and columns; shape (2, n)
Pixels = NDArray[np.intp]

CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
# rows and columns of the four neighbours of a pixel; shape (2, 4, 1)
AROUND = np.array([(s * dr, s * dc) for dr, dc in STEPS for s in (1, -1)]).T[..., None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Prices:
    """What is paid beside the differences of photos.

    Parameters
    ----------
    per_m
        For a pixel, per m that it is from the nadir.
    length
        For a side of a pixel.
    """

    per_m: float
    length: int

    def edge(self, at_p: Costs, at_q: Costs) -> Costs:
        """Cost of a seam between neighbouring pixels with these costs."""
        return (at_p + at_q) // 2 + self.length

    def distance(self, distance: NDArray[np.float32]) -> Costs:
        """Cost of pixels so far from the nadir, m."""
        cost: Costs = np.rint(distance * np.float32(self.per_m)).astype(np.int32)
        return cost


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Field:
    """Pixels to be decided between photos a and b; arrays over `window`.

    `labels` reach a pixel farther on all sides; `gain` is what b costs more for its distance.
    """

    a: int
    b: int
    window: Window
    free: Mask
    gain: Costs
    labels: Labels
    cost: Costs


class Swaps:
    """Labels while pairs of photos are decided.

    Parameters
    ----------
    labels
        Of photos that may be shown there; they change.
    band
        px from a seam to which it may move in one go; None: anywhere.
    """

    def __init__(
        self, scale: Scale, labels: SparseRaster, prices: Prices, band: int | None = None
    ) -> None:
        self._scale, self._labels, self._prices, self._band = scale, labels, prices, band

    def prepare(self, border: Border) -> Border:
        """Have ready what it takes to decide a pair; any thread may ask, whatever the labels."""
        for index in border[0]:
            self._scale.load(index)
        self._scale.between(*border[0])
        return border

    def decide(self, border: Border) -> tuple[Window, Labels, Mask] | None:
        """Decide anew what shows either of two photos.

        Returns
        -------
        The pixels that were free and what they show now; None if there were none.
        """
        field = self._field(*border)
        if field is None:
            return None
        source, _ = min_cut(self._edges(field), self._terminals(field))
        new = np.where(source, np.int32(field.a), np.int32(field.b))
        self._labels.write(field.window, new, field.free)
        return field.window, new, field.free

    def _field(self, pair: Pair, border: Window) -> _Field | None:
        """What is to be decided between two photos; None if nothing."""
        (a, b), scale = pair, self._scale
        window = common(scale.window(a), scale.window(b))
        if window is not None and self._band is not None:
            window = common(window, grown(border, self._band))
        if window is None:
            return None
        labels = self._labels.read(grown(window))
        free = self._own(a, b, labels)
        box = box_of(free, window)
        if box is None:
            return None
        free = free[part_of(window, box)]
        photos = scale.shown(a, box), scale.shown(b, box)
        free = free & photos[0].allowed & photos[1].allowed
        if not free.any():
            return None
        cost = scale.between(a, b)
        costs = [self._prices.distance(np.where(free, p.distance, np.float32(0))) for p in photos]
        return _Field(
            a=a, b=b, window=box, free=free, gain=costs[1] - costs[0],
            labels=labels[part_of(grown(window), grown(box))],
            cost=cost.cost[part_of(cost.window, box)].astype(np.int32),
        )  # fmt: skip

    def _own(self, a: int, b: int, labels: Labels) -> Mask:
        """Pixels that show either of two photos and are near enough to a seam between them."""
        shown = [labels == k for k in (a, b)]
        own: Mask = (shown[0] | shown[1])[1:-1, 1:-1]
        if self._band is None:
            return own
        square = np.ones((2 * self._band + 1,) * 2, np.uint8)
        near = [cv2.dilate(mask.view(np.uint8), square)[1:-1, 1:-1] for mask in shown]
        return own & near[0].view(np.bool_) & near[1].view(np.bool_)

    def _edges(self, field: _Field) -> Costs:
        """Costs of parting free pixels from their free neighbours."""
        rows, cols = field.free.shape
        edges = np.zeros((len(STEPS), rows, cols), np.int32)
        for k, (dr, dc) in enumerate(STEPS):
            p, q = (slice(rows - dr), slice(cols - dc)), (slice(dr, rows), slice(dc, cols))
            cost = self._prices.edge(field.cost[p], field.cost[q])
            edges[k][p] = cost * (field.free[p] & field.free[q])
        return edges

    def _terminals(self, field: _Field) -> Costs:
        """What the second photo costs more than the first: distance, and neighbours that stay."""
        inner = cv2.erode(field.free.view(np.uint8), CROSS, borderValue=0)
        rim = np.stack(np.nonzero(field.free & (inner == 0)))[:, None]
        q: Pixels = rim + AROUND
        # both reach a pixel farther than the field
        free = np.zeros(field.labels.shape, np.bool_)
        free[1:-1, 1:-1] = field.free
        label = field.labels[q[0] + 1, q[1] + 1]
        stays = (label >= 0) & ~free[q[0] + 1, q[1] + 1]
        p = np.broadcast_to(rim, q.shape)[:, stays]
        q, label = q[:, stays], label[stays]
        more = np.zeros(label.shape, np.int32)
        for other in np.unique(label).tolist():
            here = label == other
            for own, sign in ((field.b, 1), (field.a, -1)):
                if own != other:
                    more[here] += sign * self._beside(field, own, other, p[:, here], q[:, here])
        terminals = field.gain.copy()
        np.add.at(terminals, (p[0], p[1]), more)
        return terminals

    def _beside(self, field: _Field, own: int, other: int, p: Pixels, q: Pixels) -> Costs:
        """Cost of showing a photo at pixels p whose neighbours q show another."""
        cost = self._scale.between(own, other)
        row, col = field.window.row, field.window.col
        return self._prices.edge(cost.at(p[0] + row, p[1] + col), cost.at(q[0] + row, q[1] + col))
