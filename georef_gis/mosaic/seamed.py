"""Mosaic along seamlines: one photo a cell, its colour corrected, a narrow feather at the seams."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground
from georef_gis.model.plan import TileTask
from georef_gis.mosaic.byte_cache import ByteCache
from georef_gis.mosaic.canvas import Canvas, shows_any
from georef_gis.mosaic.coarse import ProxySource
from georef_gis.mosaic.colour_field import Lattice, PhotoTint, Tint, gain_over
from georef_gis.mosaic.low_blend import LowBlend
from georef_gis.mosaic.nadir import MosaicSource
from georef_gis.mosaic.proxies import PhotoColour
from georef_gis.mosaic.tile_layer import Layer, TileGround, box_of
from georef_gis.rasters.warp import Image, Key, Mask

Values = NDArray[np.float32]
# bytes; what the colours of photos may take
TINT_BYTES = 64_000_000


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
    ) -> None:
        self._sources = tuple(sources)
        self._label = {source.photo.id: k for k, source in enumerate(self._sources)}
        self._ground, self._grid = ground, grid
        self._seams, self._field = seams, field
        self._read, self._broken = read, broken
        self._lost: set[int] = set()
        self._tints = ByteCache(self._tint, budget=TINT_BYTES)

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
        ground = TileGround(self._ground, self._grid, window)
        canvas = Canvas(window)
        for label, weight in sorted(weights.items()):
            self._add(canvas, ground, label, weight)
        self._fill(canvas, sketch.task, ground, set(weights))
        return canvas.result()

    def _add(
        self,
        canvas: Canvas,
        ground: TileGround,
        label: int,
        weight: Values | None,
        *,
        at_hand: bool = True,
    ) -> None:
        """Add a photo to a tile where it has weight, and shows the ground.

        One that is not `at_hand` is read only if it shows some of that.
        """
        box = None if weight is None else box_of(weight)
        if weight is not None and box is None:
            return
        layer = Layer.of(self._sources[label], ground, box)
        if layer is None:
            return
        if weight is not None and not at_hand:
            if not shows_any(canvas.window, layer.at, weight, layer.relief):
                return
        image = self._image(label)
        if image is not None:
            tint = self._tint_over(canvas.window, label, image.shape[2])
            canvas.add(image, layer.at, tint, weight=weight, relief=layer.relief)

    def _fill(self, canvas: Canvas, task: TileTask, ground: TileGround, done: set[int]) -> None:
        """Ground that no cell covers, or whose photo ends before its cell, from the nearest."""
        if canvas.whole:
            return
        others = [self._label[i] for i in task.photo_ids if i in self._label]
        others = [k for k in others if k not in done and k not in self._lost]
        w = task.window
        middle = np.array([[w.col + w.width / 2, w.row + w.height / 2]])
        p = self._ground.enu_at(self._grid, middle)[0]

        def away(label: int) -> float:
            source = self._sources[label]
            d = float(np.hypot(*(p - source.photo.pose.origin_enu)[:2]))
            return d + 10.0 * source.reach * source.doubtful

        holes = ground.holes(canvas.weight == 0.0)
        # a cell's own photos first: they are at hand
        for label in [*sorted(done), *sorted(others, key=away)]:
            if canvas.whole:
                return
            box = None if label in self._lost else holes.box(self._sources[label])
            if box is None:
                continue
            self._add(canvas, ground, label, canvas.holes(box), at_hand=label in done)

    def _key(self, label: int) -> Key:
        source = self._sources[label]
        return source.photo.photo.path, source.reduce

    def _image(self, label: int) -> Image | None:
        """Pixels of a photo; None where it cannot be read."""
        try:
            return self._read(*self._key(label))
        except InputError as error:
            self._lost.add(label)
            self._broken.append(str(error))
            return None

    def _tint_over(self, window: Window, label: int, bands: int) -> Tint:
        """What is done to a photo's grey values over a window."""
        field = self._field
        if field is None:
            return Tint.none(Lattice.around(window, 1), bands)
        return self._tints(label).over(Lattice.around(window, field.factor), field.blend)

    def _tint(self, label: int) -> PhotoTint:
        """What is done to a photo's grey values."""
        field = self._field
        if field is None:
            raise ValueError("colours stay as they are")
        coarse, factor = field.proxies.windows[label], field.factor
        window = Window(
            col=coarse.col * factor, row=coarse.row * factor,
            width=coarse.width * factor, height=coarse.height * factor,
        )  # fmt: skip
        lattice = Lattice.around(window, factor)
        photo = self._sources[label].photo
        gain = gain_over(photo, field.colour, label, lattice, self._ground, self._grid)
        offset = field.colour.offset(label).astype(np.float32)
        base = own = None
        if field.blend is not None:
            base, own = field.blend.own.of(label)
        return PhotoTint(
            half=lattice.half, gain=gain, offset=offset, base=base, base_half=own,
            knee=field.colour.knee,
        )  # fmt: skip
