"""Mosaic of the photos nearest to their nadir, feathered where they meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, choose_step, node_positions
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.plan import TileTask
from georef_gis.rasters.warp import Image, Mask, inside_image, sample, upsample

# px of the mosaic; over this width one photo gives way to the next
FEATHER = 64.0
# part of a photo's shorter side within which it gives way before its rim is reached
RIM = 0.06
# weight of a photo where it is inside but would not count
TRACE = np.float32(1e-4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MosaicSource:
    """A photo of a mosaic; `reduce` is by how much it is decoded smaller."""

    photo: OrientedPhoto
    step: int
    reduce: int
    # m; half the longer diagonal of the ground it shows
    reach: float


def mosaic_source(
    photo: OrientedPhoto, ground: Ground, grid: Grid, ring_map: Array, *, reduce: int, reach: float
) -> MosaicSource:
    """Source with the mesh step that its own part of the grid needs."""
    p = grid.grid_from_map(ring_map)
    low = np.clip(np.floor(p.min(axis=0)), 0, [grid.width - 1, grid.height - 1]).astype(int)
    high = np.clip(np.ceil(p.max(axis=0)), low + 1, [grid.width, grid.height]).astype(int)
    col, row = int(low[0]), int(low[1])
    window = Window(col=col, row=row, width=int(high[0]) - col, height=int(high[1]) - row)
    step = choose_step(photo, ground, grid, window)
    return MosaicSource(photo=photo, step=step, reduce=reduce, reach=reach)


class NadirMosaic:
    """Renders tiles of a mosaic; every tile on its own, the same whoever renders it.

    The photo whose nadir is nearest wins. Its lead over the next is turned into a weight over
    `FEATHER` pixels, and near its own rim a photo's distance grows, so that it gives way before it
    ends: there is no step at a rim as long as another photo shows the place.

    Parameters
    ----------
    read
        `read(source) -> image` (rows, cols, bands), as a rule from a cache.
    broken
        Takes the errors of photos that could not be read: they leave their place to the others.
    """

    def __init__(
        self,
        sources: Mapping[str, MosaicSource],
        ground: Ground,
        grid: Grid,
        *,
        gsd: float,
        read: Callable[[MosaicSource], Image],
        broken: list[str],
    ) -> None:
        self._sources = dict(sources)
        self._broken = broken
        self._ground = ground
        self._grid = grid
        self._band = FEATHER * gsd
        self._read = read

    def tile(self, task: TileTask) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of one tile; None where no photo shows it."""
        while True:
            sources = [self._sources[i] for i in task.photo_ids if i in self._sources]
            if not sources:
                return None
            try:
                return _blend(self._layers(sources, task.window))
            except InputError as error:
                # Named once, then the tile is rendered from the photos that can be read.
                self._drop(sources, error)

    def _drop(self, sources: list[MosaicSource], error: InputError) -> None:
        self._broken.append(str(error))
        for source in sources:
            try:
                self._read(source)
            except InputError:
                self._sources.pop(source.photo.id, None)

    def _layers(self, sources: list[MosaicSource], window: Window) -> list[_Layer]:
        """Photos that count in a window, with their pixels and weights."""
        step = min(s.step for s in sources)
        p_enu = self._ground.enu_at(self._grid, node_positions(window, step))
        meshes = np.stack([s.photo.project(p_enu) for s in sources])
        costs = [self._cost(s, p_enu, uv, step) for s, uv in zip(sources, meshes, strict=True)]
        weights = self._weights(np.stack(costs))
        shape = (window.height, window.width)
        layers = []
        for source, mesh, weight in zip(sources, meshes, weights, strict=True):
            if not weight.any():
                continue
            uv = upsample(mesh, step, shape)
            camera = source.photo.camera
            inside = inside_image(uv, camera.width, camera.height)
            if inside.any():
                data = sample(self._read(source), uv, reduce=source.reduce)
                layers.append(_Layer(data, inside, upsample(weight, step, shape)))
        return layers

    def _cost(self, source: MosaicSource, p_enu: Array, uv: Array, step: int) -> Array:
        """Distance from the nadir, m, growing towards the rim; inf beyond it."""
        pose, camera = source.photo.pose, source.photo.camera
        d = np.hypot(p_enu[..., 0] - pose.origin_enu[0], p_enu[..., 1] - pose.origin_enu[1])
        w, h = camera.width, camera.height
        u, v = uv[..., 0], uv[..., 1]
        edge = np.minimum(np.minimum(u + 0.5, w - 0.5 - u), np.minimum(v + 0.5, h - 0.5 - v))
        rim = RIM * min(w, h)
        # Nodes a cell outside still count: a corner of the photo may lie between nodes.
        margin = -3.0 * step * source.reduce - rim
        penalty = 2.0 * source.reach * np.clip(1.0 - edge / rim, 0.0, None)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(edge > margin, d + penalty, np.inf))

    def _weights(self, costs: Array) -> Array:
        """Weights per source and node, not normalised; shape as `costs`."""
        best = np.min(costs, axis=0)
        with np.errstate(invalid="ignore"):
            lead = np.where(np.isfinite(costs), costs - best, np.inf)
        return np.asarray(np.clip(1.0 - lead / self._band, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class _Layer:
    """A photo on a window: pixels, where it shows the ground, weight of each pixel."""

    data: Image
    inside: Mask
    weight: NDArray[np.float32]


def _blend(layers: list[_Layer]) -> tuple[Image, Mask | None] | None:
    """Weighted mean of the layers, and where there is any; None without a layer."""
    if not layers:
        return None
    first = layers[0]
    if len(layers) == 1:
        return _masked(first.data, first.inside)
    total = np.zeros(first.data.shape, dtype=np.float32)
    norm = np.zeros(first.inside.shape, dtype=np.float32)
    for layer in layers:
        # A trace of weight everywhere inside: where the others end, it is the only one.
        w = np.where(layer.inside, np.maximum(layer.weight, TRACE), np.float32(0.0))
        total += layer.data * w[..., None]
        norm += w
    mean = total / np.where(norm > 0, norm, np.float32(1.0))[..., None]
    if np.issubdtype(first.data.dtype, np.integer):
        mean = np.rint(mean)
    return _masked(mean.astype(first.data.dtype), norm > 0)


def _masked(data: Image, mask: Mask) -> tuple[Image, Mask | None]:
    if mask.all():
        return data, None
    data[~mask] = 0
    return data, mask
