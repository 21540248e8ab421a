"""Simulated overlaps: photos of a known ground through known exposure, lens and light."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.overlaps import Overlaps

Array = NDArray[np.float64]
# horizontal reach of a photo over the flying height: half sides
HALF = (0.5, 0.4)
# px of the coarse grid in a flying height
PIXELS = 500.0


def views_and_places(offset: Array) -> tuple[Array, Array]:
    """Place in the photo and view of ground at `offset` (k, 2), heights, from the nadir."""
    xy = offset / math.hypot(*HALF)
    view = -offset / np.sqrt(1.0 + (offset**2).sum(axis=1, keepdims=True))
    return xy, view


@dataclass
class Flight:
    """Photos looking straight down, places in flying heights; truth per photo and shared."""

    nadirs: Array
    gain: Array
    offset: Array
    bands: int = 3
    vignetting: float = 0.0
    hot_spot: float = 0.0
    # height of a narrow cone at the view `sun`
    cone: float = 0.0
    sun: tuple[float, float] = (0.1, -0.22)
    noise: float = 0.0
    outliers: float = 0.0
    full: float = 255.0
    # whether the camera's response bends: white stays white
    bent: bool = False
    # logarithm of each photo's own light: tilt along x and y, and twice the curvature along x
    clouds: Array | None = None
    blocks: int = 60
    links: list[tuple[int, int]] | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(3))

    def light(self, xy: Array, view: Array) -> Array:
        """What lens and light do to the grey values; (k,)."""
        r2 = (xy**2).sum(axis=1)
        # towards the anti-solar point the ground is brighter
        toward = view @ np.array([0.8, 0.6])
        spot = np.exp(-((view - np.array([0.25, 0.2])) ** 2).sum(axis=1) / 0.35**2)
        centre = math.exp(-(0.25**2 + 0.2**2) / 0.35**2)
        shape = self.hot_spot * (spot - centre + 0.3 * toward)
        away = np.hypot(*(view - np.array(self.sun)).T)
        shape = shape + self.cone * np.exp(-away / 0.08)
        return np.exp(shape - self.vignetting * (0.6 * r2 + 0.4 * r2**2))

    def cloud(self, photo: int, xy: Array) -> Array:
        """Logarithm of a photo's own light; (k,)."""
        if self.clouds is None:
            return np.zeros(len(xy))
        shapes = np.stack([xy[:, 0], xy[:, 1], xy[:, 0] ** 2 - 0.2], axis=1)
        return np.asarray(shapes @ self.clouds[photo])

    def pairs(self) -> list[tuple[int, int]]:
        if self.links is not None:
            return self.links
        n = len(self.nadirs)
        away = np.abs(self.nadirs[:, None] - self.nadirs[None])
        meets = (away[..., 0] < 1.6 * HALF[0]) & (away[..., 1] < 1.6 * HALF[1])
        return [(i, j) for i in range(n) for j in range(i + 1, n) if meets[i, j]]

    def value(self, photo: int, ground: Array, places: Array) -> tuple[Array, Array, Array]:
        xy, view = views_and_places(places - self.nadirs[photo])
        light = self.light(xy, view) * np.exp(self.cloud(photo, xy))
        factor = light[:, None] / np.exp(self.gain[photo])
        seen = ground * factor
        if self.bent:
            seen = seen / (1.0 + (factor - 1.0) * ground / 255.0)
        seen = seen - self.offset[photo]
        seen = seen * np.exp(self.noise * self.rng.normal(size=seen.shape))
        return seen * self.full / 255.0, xy, view

    def overlaps(self) -> Overlaps:
        columns: list[list[NDArray[np.generic]]] = [[] for _ in range(8)]
        for i, j in self.pairs():
            a, b = self.nadirs[i], self.nadirs[j]
            low, high = np.maximum(a, b) - HALF, np.minimum(a, b) + HALF
            places = self.rng.uniform(low, high, size=(self.blocks, 2))
            ground = self.rng.uniform(30.0, 170.0, size=(self.blocks, self.bands))
            va, xa, na = self.value(i, ground, places)
            moved = self.rng.random(self.blocks) < self.outliers
            other = self.rng.uniform(30.0, 220.0, size=ground.shape)
            vb, xb, nb = self.value(j, np.where(moved[:, None], other, ground), places)
            k = (self.blocks,)
            for column, part in zip(
                columns, (np.full(k, i), np.full(k, j), va, vb, xa, xb, na, nb), strict=True
            ):
                column.append(part)
        a, b, *rest = (np.concatenate(column) for column in columns)
        va, vb, xa, xb, na, nb = (part.astype(np.float32) for part in rest)
        return Overlaps(
            a=a, b=b, value_a=va, value_b=vb, xy_a=xa, xy_b=xb, view_a=na, view_b=nb,
            weight=np.ones_like(va),
        )  # fmt: skip

    def samples(self, each: int = 60) -> Samples:
        """Pixels of all photos, over ground that is the same everywhere."""
        parts = []
        for photo, nadir in enumerate(self.nadirs):
            places = nadir + self.rng.uniform(-1.0, 1.0, (each, 2)) * HALF
            value, xy, view = self.value(photo, np.full((each, self.bands), 100.0), places)
            middle = np.broadcast_to(nadir, places.shape)
            columns = (value, xy, view, places * PIXELS, middle * PIXELS)
            value, xy, view, places, middle = (part.astype(np.float32) for part in columns)
            parts.append(
                Samples(
                    photo=np.full(each, photo), value=value, xy=xy, view=view, place=places,
                    nadir=middle,
                )
            )  # fmt: skip
        return Samples.joined(parts, self.bands)

    def block(self) -> tuple[Overlaps, int, list[str], list[str]]:
        """Arguments of `solve_colour`, of one camera and one flight."""
        n = len(self.nadirs)
        return self.overlaps(), n, ["cam"] * n, ["flight"] * n


def grid_flight(rows: int = 4, cols: int = 5, *, spread: float = 0.15, **kwargs: float) -> Flight:
    """Strips with 60 % overlap along and 50 % across, gains at random."""
    bands = int(kwargs.pop("bands", 3))
    rng = np.random.default_rng(11)
    c, r = np.meshgrid(np.arange(cols) * 0.8 * HALF[0], np.arange(rows) * HALF[1])
    nadirs = np.stack([c.ravel(), r.ravel()], axis=1).astype(float)
    gain = rng.normal(0.0, spread, (len(nadirs), bands))
    return Flight(
        nadirs=nadirs, gain=gain - gain.mean(axis=0), offset=np.zeros_like(gain), bands=bands,
        **kwargs,  # type: ignore[arg-type]
    )  # fmt: skip


def chain(n: int, *, spread: float = 0.1, **kwargs: float) -> Flight:
    """One strip, each photo overlapping the next two."""
    rng = np.random.default_rng(12)
    nadirs = np.stack([np.arange(n) * 0.4, np.zeros(n)], axis=1)
    gain = rng.normal(0.0, spread, (n, 3))
    links = [(i, j) for i in range(n) for j in (i + 1, i + 2) if j < n]
    return Flight(
        nadirs=nadirs, gain=gain - gain.mean(axis=0), offset=np.zeros_like(gain), links=links,
        **kwargs,  # type: ignore[arg-type]
    )  # fmt: skip
