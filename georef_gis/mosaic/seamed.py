"""Mosaic along seamlines: one photo a cell, its colour corrected, a narrow feather at the seams."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.coarse import ProxySource
from georef_gis.mosaic.colour_field import Knots, Lattice, gain_at, value_range
from georef_gis.mosaic.low_blend import LowBlend, low_of
from georef_gis.mosaic.nadir import MosaicSource
from georef_gis.mosaic.proxies import PhotoColour
from georef_gis.mosaic.seam_mismatch import MismatchProbe, grey
from georef_gis.mosaic.tile_layer import Layer, Paint, TileGround
from georef_gis.rasters.warp import Image, Key, Mask, blocks

Values = NDArray[np.float32]
# reads a photo, once it is sure to be needed
Painter = Callable[[], Paint | None]
# photos whose low frequencies are kept
KEPT = 24


class Seams(Protocol):
    """Which photo has which ground; labels count photos."""

    def labels_in(self, window: Window) -> Sequence[int]:
        """Labels that have some weight in a window of the fine grid."""
        ...

    def weights(self, window: Window) -> Mapping[int, Values | None]:
        """Weight of each label at each pixel, summing to 1 where one has the ground; None = 1."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourField:
    """All that is done to the photos' grey values.

    Parameters
    ----------
    colour
        Gain and offset of each photo.
    blend
        Low frequencies of the whole; None = not blended.
    proxies
        The photos on the coarse grid, with `colour` applied.
    factor
        Fine pixels along a coarse one.
    """

    colour: PhotoColour
    blend: LowBlend | None
    proxies: ProxySource
    factor: int


@dataclass(frozen=True, slots=True, eq=False)
class SeamSketch:
    """A tile and the photos that have ground in it, by their labels."""

    task: TileTask
    labels: tuple[int, ...]
    keys: tuple[Key, ...]


class SeamMosaic:
    """Renders tiles of a mosaic along seams; a pixel depends on its place alone, not on its tile.

    Parameters
    ----------
    sources
        The photos, in the order that labels count.
    field
        What is done to grey values; None leaves them as they are.
    read
        `read(path, reduce) -> image` (rows, cols, bands), as a rule from a cache.
    broken
        Takes the errors of photos that could not be read: others fill their cells.
    probe
        Measures how photos meet at the seams, while they are at hand.
    """

    def __init__(
        self,
        sources: Sequence[MosaicSource],
        ground: Ground,
        grid: Grid,
        *,
        seams: Seams,
        field: ColourField | None,
        read: Callable[[Path, int], Image],
        broken: list[str],
        probe: MismatchProbe | None = None,
    ) -> None:
        self._probe = probe
        self._sources = tuple(sources)
        self._label = {source.photo.id: k for k, source in enumerate(self._sources)}
        self._ground, self._grid = ground, grid
        self._seams, self._field = seams, field
        self._read, self._broken = read, broken
        self._lost: set[int] = set()
        self._bases: OrderedDict[int, tuple[Values, Window]] = OrderedDict()
        self._lock = threading.Lock()

    def tile(self, task: TileTask) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of one tile; None where no photo shows it."""
        return self.render(self.sketch(task))

    def sketch(self, task: TileTask) -> SeamSketch:
        """Photos that a tile needs. Cheap, reads none."""
        labels = tuple(k for k in self._seams.labels_in(task.window) if k not in self._lost)
        return SeamSketch(task, labels, tuple(self._key(k) for k in labels))

    def render(self, sketch: SeamSketch) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of a sketched tile; None where no photo shows it."""
        window = sketch.task.window
        weights = {k: w for k, w in self._seams.weights(window).items() if k not in self._lost}
        ground = self._tile_ground(window)
        tile = _Tile(window)
        for label, weight in sorted(weights.items()):
            layer = Layer.of(self._sources[label], ground)
            if layer is not None:
                tile.take(layer, weight, partial(self._paint, label, layer, ground))
        if not tile.whole:
            self._fill(tile, sketch.task, ground, set(weights))
        if self._probe is not None and len(weights) > 1:
            self._probe.measure(window, self._square)
        return tile.result()

    def _square(self, label: int, window: Window) -> Values | None:
        """Grey values of a photo over a square; None where it does not show all of it."""
        tile = TileGround(self._ground, self._grid, window, Lattice.around(window, 16), knots=None)
        source = self._sources[label]
        layer = None if label in self._lost else Layer.of(source, tile)
        if layer is None:
            return None
        whole = (slice(0, window.height), slice(0, window.width))
        mesh = (slice(None), slice(None))
        uv = layer.uv(whole, mesh, (window.height, window.width))
        if layer.inside(uv, mesh) is not None:
            return None
        paint = self._paint(label, layer, tile)
        if paint is None:
            return None
        image = paint.image
        out = np.empty((window.height, window.width, image.shape[2]), image.dtype)
        paint.values(uv, whole, out)
        # sensors fill 10 to 14 of 16 bits
        whole_range = image.dtype == np.uint8
        scale = 255.0 if whole_range else float(np.max(np.abs(out), initial=1e-6))
        return grey(out, scale)

    def _tile_ground(self, window: Window) -> TileGround:
        field = self._field
        lattice = Lattice.around(window, field.factor if field is not None else 16)
        knots = None if field is None else Knots.under(lattice, self._ground, self._grid)
        return TileGround(self._ground, self._grid, window, lattice, knots)

    def _fill(self, tile: _Tile, task: TileTask, ground: TileGround, done: set[int]) -> None:
        """Ground that no cell covers, or whose photo ends before its cell, from the nearest."""
        others = [self._label[i] for i in task.photo_ids if i in self._label]
        others = [k for k in others if k not in done and k not in self._lost]
        w = task.window
        middle = np.array([[w.col + w.width / 2, w.row + w.height / 2]])
        p = self._ground.enu_at(self._grid, middle)[0]

        def away(label: int) -> float:
            source = self._sources[label]
            d = float(np.hypot(*(p - source.photo.pose.origin_enu)[:2]))
            return d + 10.0 * source.reach * source.doubtful

        # a cell's own photos first: they are at hand
        for label in [*sorted(done), *sorted(others, key=away)]:
            if tile.whole:
                return
            if label not in self._lost:
                layer = Layer.of(self._sources[label], ground)
                if layer is not None:
                    tile.fill(layer, partial(self._paint, label, layer, ground))

    def _key(self, label: int) -> Key:
        source = self._sources[label]
        return source.photo.photo.path, source.reduce

    def _paint(self, label: int, layer: Layer, ground: TileGround) -> Paint | None:
        """Pixels of a layer with their colours; None where the photo cannot be read."""
        try:
            image = self._read(*self._key(label))
        except InputError as error:
            self._lost.add(label)
            self._broken.append(str(error))
            return None
        field, lattice = self._field, ground.lattice
        if field is None or ground.knots is None or layer.knots_uv is None:
            return Paint(layer, image, lattice, None, None)
        photo = self._sources[label].photo
        gain = gain_at(photo, field.colour, label, ground.knots, layer.knots_uv)
        add = np.broadcast_to(field.colour.offset(label).astype(np.float32), gain.shape)
        if field.blend is not None:
            base, own = self._base(label, field)
            add = add + field.blend.correction(lattice.half, base, own)
        return Paint(layer, image, lattice, gain, np.ascontiguousarray(add, dtype=np.float32))

    def _base(self, label: int, field: ColourField) -> tuple[Values, Window]:
        """Low frequencies of a photo; kept for the next tiles."""
        with self._lock:
            found = self._bases.get(label)
            if found is not None:
                self._bases.move_to_end(label)
                return found
        proxy = field.proxies.load(label)
        found = low_of(proxy.data, proxy.valid, proxy.window)
        with self._lock:
            self._bases[label] = found
            while len(self._bases) > KEPT:
                self._bases.popitem(last=False)
        return found


class _Tile:
    """A tile in the making, block by block: most blocks show one photo alone."""

    def __init__(self, window: Window) -> None:
        self.window = window
        shape = (window.height, window.width)
        self._sum: Values = np.zeros((0, 0, 0), np.float32)
        self._weight = np.zeros(shape, np.float32)
        self._out: Image | None = None
        self._plain = np.zeros(shape, np.bool_)
        # blocks that more than one photo, or part of one, makes up
        self._mixed: dict[tuple[int, int], tuple[slice, slice]] = {}

    @property
    def whole(self) -> bool:
        """Whether every pixel has a value."""
        return bool(np.all(self._plain | (self._weight > 0.0)))

    def take(self, layer: Layer, weight: Values | None, paint: Painter) -> None:
        """Add a photo where its cell gives it weight, and it shows the ground."""
        ready: Paint | None = None
        for pixels, nodes in blocks(self.window, layer.source.step):
            part = None if weight is None else weight[pixels]
            if (part is not None and not part.any()) or layer.outside(nodes):
                continue
            size = self._weight[pixels].shape
            uv = layer.uv(pixels, nodes, size)
            inside = layer.inside(uv, nodes)
            if inside is not None and not inside.any():
                continue
            ready = ready or paint()
            if ready is None:
                return
            if inside is None and (part is None or part.min() >= 1.0):
                ready.values(uv, pixels, self._ready(ready)[pixels])
                self._plain[pixels] = True
                continue
            own = np.ones(size, np.float32) if part is None else part
            if inside is not None:
                own = np.where(inside, own, np.float32(0.0))
            self._add(ready, uv, pixels, own)

    def fill(self, layer: Layer, paint: Painter) -> None:
        """Add a photo where nothing is yet; it is read only if it shows some of that."""
        ready: Paint | None = None
        for pixels, nodes in blocks(self.window, layer.source.step):
            own = ~(self._plain[pixels] | (self._weight[pixels] > 0.0))
            if not own.any() or layer.outside(nodes):
                continue
            uv = layer.uv(pixels, nodes, own.shape)
            inside = layer.inside(uv, nodes)
            own = own if inside is None else own & inside
            if not own.any():
                continue
            ready = ready or paint()
            if ready is None:
                return
            self._add(ready, uv, pixels, own.astype(np.float32))

    def _ready(self, paint: Paint) -> Image:
        if self._out is None:
            shape = (self.window.height, self.window.width, paint.image.shape[2])
            self._out = np.zeros(shape, dtype=paint.image.dtype)
        return self._out

    def _add(self, paint: Paint, uv: Values, pixels: tuple[slice, slice], weight: Values) -> None:
        out = self._ready(paint)
        if not self._sum.size:
            self._sum = np.zeros(out.shape, np.float32)
        value = np.empty(out[pixels].shape, np.float32)
        paint.values(uv, pixels, value)
        if paint.image.dtype.kind == "f":
            known = np.isfinite(value).all(axis=2)
            weight = np.where(known, weight, np.float32(0.0))
            value[~known] = 0.0
        self._sum[pixels] += value * weight[..., None]
        self._weight[pixels] += weight
        self._mixed[pixels[0].start, pixels[1].start] = pixels

    def _settle(self, pixels: tuple[slice, slice], out: Image) -> None:
        """Weighted means of a block into the tile."""
        weight = self._weight[pixels]
        mean = self._sum[pixels] / np.maximum(weight, np.float32(1e-12))[..., None]
        low, high = value_range(out.dtype)
        if np.isfinite(high):
            mean = np.floor(np.clip(mean + np.float32(0.5), low, high))
        keep = (weight > 0.0) & ~self._plain[pixels]
        np.copyto(out[pixels], mean, where=keep[..., None], casting="unsafe")

    def result(self) -> tuple[Image, Mask | None] | None:
        """Pixels and mask; None where there is nothing."""
        out = self._out
        if out is None:
            return None
        for pixels in self._mixed.values():
            self._settle(pixels, out)
        mask = self._plain | (self._weight > 0.0)
        if not mask.any():
            return None
        return (out, None) if mask.all() else (out, mask)
