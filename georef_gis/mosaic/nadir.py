"""Mosaic of the photos nearest to their nadir, feathered where they meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions, parallax
from georef_gis.model.mesh_step import choose_step
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.plan import TileTask
from georef_gis.rasters.warp import (
    Image,
    Key,
    Mask,
    all_inside,
    blank,
    blocks,
    copy_where,
    ground_mesh,
    inside_image,
    largest_move,
    positions,
    sample,
    upsample,
)

# px of the mosaic; over this width one photo gives way to the next
FEATHER = 64.0
# part of a photo's reach that the width never exceeds: at a coarse GSD it would cross the photo
WIDEST_FEATHER = 0.2
# part of a photo's shorter side within which it gives way before its rim is reached
RIM = 0.1
# px of a photo; within this of its rim its weight goes to nothing pixel by pixel
SOFT_RIM = 16.0
# by how much of its reach a photo's distance has grown at its rim: more than any lead, but little
# more, as the change to the next photo is the steeper
RIM_PENALTY = 1.2
# the same for a photo that is doubtful: more than the distances within any photo
DOUBT_PENALTY = 3.0
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
    # it gives way to any that is not
    doubtful: bool = False


def mosaic_source(
    photo: OrientedPhoto, ground: Ground, grid: Grid, ring_map: Array, *, reduce: int, reach: float
) -> MosaicSource:
    """Source with the mesh step that its own part of the grid needs."""
    p = grid.grid_from_map(ring_map)
    low = np.clip(np.floor(p.min(axis=0)), 0, [grid.width - 1, grid.height - 1]).astype(int)
    high = np.clip(np.ceil(p.max(axis=0)), low + 1, [grid.width, grid.height]).astype(int)
    col, row = int(low[0]), int(low[1])
    window = Window(col=col, row=row, width=int(high[0]) - col, height=int(high[1]) - row)
    # The weights live on the same nodes: these must not step over a rim.
    spread = 2.0 * float(np.hypot(*(p[:-1] - p[:-1].mean(axis=0)).T).max())
    camera = photo.camera
    rim = RIM * min(camera.width, camera.height) / np.hypot(camera.width, camera.height) * spread
    step = choose_step(photo, ground, grid, window)
    while step > max(rim, 1.0):
        step //= 2
    return MosaicSource(photo=photo, step=step, reduce=reduce, reach=reach)


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """A photo over a tile: pixel and weight at the nodes of the mesh, and where it is near."""

    source: MosaicSource
    uv: Array
    weight: Array
    near: Mask
    # px per m of height at the nodes; None over flat ground
    moves: Array | None

    @property
    def key(self) -> Key:
        """Photo to read."""
        return self.source.photo.photo.path, self.source.reduce


@dataclass(frozen=True, slots=True, eq=False)
class TileSketch:
    """What is left to do for a tile once its geometry is known."""

    task: TileTask
    step: int
    layers: tuple[_Layer, ...]

    @property
    def keys(self) -> tuple[Key, ...]:
        """Photos to read for sure; others only fill what these leave open."""
        return tuple(layer.key for layer in self.layers if layer.weight.any())


class _Unreadable(Exception):
    """A photo that cannot be read."""

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self.path = path


class NadirMosaic:
    """Renders tiles of a mosaic; every tile on its own, the same whoever renders it.

    The photo whose nadir is nearest wins. Its lead over the next is turned into a weight over
    `FEATHER` pixels, and near its own rim a photo's distance grows, so that it gives way before it
    ends: there is no step at a rim as long as another photo shows the place.

    Parameters
    ----------
    read
        `read(path, reduce) -> image` (rows, cols, bands), as a rule from a cache.
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
        read: Callable[[Path, int], Image],
        broken: list[str],
    ) -> None:
        self._sources = dict(sources)
        self._broken = broken
        self._ground = ground
        self._grid = grid
        narrowest = min((source.reach for source in sources.values()), default=np.inf)
        self._band = min(FEATHER * gsd, WIDEST_FEATHER * narrowest)
        self._read = read
        self._lost: set[Path] = set()

    def tile(self, task: TileTask) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of one tile; None where no photo shows it."""
        return self.render(self.sketch(task))

    def sketch(self, task: TileTask) -> TileSketch:
        """Geometry of a tile: which photos count where. Cheap, reads no photo."""
        return self._sketch(task, frozenset())

    def _sketch(self, task: TileTask, without: frozenset[Path]) -> TileSketch:
        found = (self._sources.get(i) for i in task.photo_ids)
        sources = [s for s in found if s is not None and s.photo.photo.path not in without]
        if not sources:
            return TileSketch(task, 1, ())
        step = min(s.step for s in sources)
        p_enu = self._ground.enu_at(self._grid, node_positions(task.window, step))
        meshes = [s.photo.project(p_enu) for s in sources]
        costs = [self._cost(s, p_enu, uv, step) for s, uv in zip(sources, meshes, strict=True)]
        weights = self._weights(np.stack(costs))
        parts = zip(sources, meshes, weights, np.isfinite(costs), strict=True)
        relief = self._ground.has_relief
        layers = tuple(
            _Layer(s, uv, w, near, parallax(s.photo, p_enu) if relief else None)
            for s, uv, w, near in parts
            if near.any()
        )
        return TileSketch(task, step, layers)

    def render(self, sketch: TileSketch) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of a sketched tile; None where no photo shows it."""
        without: frozenset[Path] = frozenset()
        while sketch.layers:
            try:
                return self._render(sketch)
            except _Unreadable as error:
                # Left out here only: what other tiles found must not change this one's mesh.
                without |= {error.path}
                sketch = self._sketch(sketch.task, without)
        return None

    def _render(self, sketch: TileSketch) -> tuple[Image, Mask | None] | None:
        """Render block by block: most blocks show one photo alone and need no blending."""
        window, step = sketch.task.window, sketch.step
        shape = (window.height, window.width)
        delta = ground_mesh(self._ground, self._grid, window, step).delta
        maps = [positions(a.uv, step, shape, delta, a.moves) for a in sketch.layers]
        slack = [largest_move(delta, layer.moves) for layer in sketch.layers]
        first = self._image(*sketch.keys[0])
        out = np.zeros((*shape, first.shape[2]), dtype=first.dtype)
        mask = np.zeros(shape, dtype=np.bool_)
        for pixels, nodes in blocks(window, step):
            views = [
                _View(a, uv[pixels], nodes, step, far)
                for a, uv, far in zip(sketch.layers, maps, slack, strict=True)
            ]
            _blend(_parts(views, self._image), out[pixels], mask[pixels])
        if not mask.any():
            return None
        return (out, None) if mask.all() else (out, mask)

    def _image(self, path: Path, reduce: int) -> Image:
        """Pixels of a photo; one that could not be read is not tried again."""
        if path in self._lost:
            raise _Unreadable(path)
        try:
            return self._read(path, reduce)
        except InputError as error:
            self._lost.add(path)
            self._broken.append(str(error))
            raise _Unreadable(path) from error

    def _cost(self, source: MosaicSource, p_enu: Array, uv: Array, step: int) -> Array:
        """Distance from the nadir, m, growing towards the rim; inf beyond it."""
        pose, camera = source.photo.pose, source.photo.camera
        d = np.hypot(p_enu[..., 0] - pose.origin_enu[0], p_enu[..., 1] - pose.origin_enu[1])
        edge = edge_distance(uv, camera.width, camera.height)
        rim = RIM * min(camera.width, camera.height)
        # Nodes a cell outside still count: a corner of the photo may lie between nodes.
        margin = -3.0 * step * source.reduce - rim
        penalty = RIM_PENALTY * source.reach * np.clip(1.0 - edge / rim, 0.0, None)
        if source.doubtful:
            penalty = penalty + DOUBT_PENALTY * source.reach
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(edge > margin, d + penalty, np.inf))

    def _weights(self, costs: Array) -> Array:
        """Weights per source and node, not normalised; shape as `costs`."""
        best = np.min(costs, axis=0)
        with np.errstate(invalid="ignore"):
            lead = np.where(np.isfinite(costs), costs - best, np.inf)
        return np.asarray(np.clip(1.0 - lead / self._band, 0.0, 1.0))


def edge_distance(uv: NDArray[np.floating[Any]], width: int, height: int) -> Array:
    """Distance, px, of pixels from the outer edge of an image, negative outside; (...)."""
    u, v = uv[..., 0], uv[..., 1]
    edge = np.minimum(np.minimum(u + 0.5, width - 0.5 - u), np.minimum(v + 0.5, height - 0.5 - v))
    return np.asarray(edge)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A layer on a block: pixel positions in the photo, and the nodes they come from."""

    layer: _Layer
    uv: NDArray[np.float32]
    nodes: tuple[slice, slice]
    step: int
    # px; how far relief may move what lies between the nodes
    slack: float

    def inside(self) -> Mask | None:
        """Where the photo shows the ground; None = everywhere."""
        camera = self.layer.source.photo.camera
        if all_inside(self.layer.uv[self.nodes], camera.width, camera.height, self.slack):
            return None
        inside = inside_image(self.uv, camera.width, camera.height)
        return None if inside.all() else inside


def _parts(views: list[_View], read: Callable[[Path, int], Image]) -> list[_Part]:
    """Photos that make up a block: those that count, then those that fill what is left open."""
    parts: list[_Part] = []
    counting = [v for v in views if v.layer.weight[v.nodes].any()]
    open_pixels: Mask | None = None
    for view in [*counting, *(v for v in views if v not in counting)]:
        if open_pixels is not None and not open_pixels.any():
            # Covered; one that counts may still share in it.
            if view not in counting:
                break
        elif view not in counting and not view.layer.near[view.nodes].any():
            continue
        inside = view.inside()
        if inside is not None and not inside.any():
            continue
        if view not in counting and open_pixels is not None:
            inside = open_pixels if inside is None else inside & open_pixels
            if not inside.any():
                continue
        image = read(*view.layer.key)
        data = sample(image, view.uv, reduce=view.layer.source.reduce)
        parts.append(_Part(data, inside, view))
        left = np.zeros(view.uv.shape[:2], np.bool_) if inside is None else ~inside
        open_pixels = left if open_pixels is None else open_pixels & left
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A photo over a block: pixels, and where it shows the ground (None = everywhere)."""

    data: Image
    inside: Mask | None
    view: _View

    def weight(self) -> NDArray[np.float32]:
        """Weight per pixel, a trace of it at least: where the others end, it is the only one."""
        layer, nodes = self.view.layer, self.view.nodes
        w = upsample(layer.weight[nodes], self.view.step, self.data.shape[:2])
        camera = layer.source.photo.camera
        soft = SOFT_RIM + self.view.slack
        if not np.all(edge_distance(layer.uv[nodes], camera.width, camera.height) > soft):
            edge = edge_distance(self.view.uv, camera.width, camera.height)
            w = w * np.clip(edge / np.float32(SOFT_RIM), 0.0, 1.0)
        w = np.maximum(w, TRACE)
        return w if self.inside is None else np.where(self.inside, w, np.float32(0.0))


def _blend(parts: list[_Part], out: Image, mask: Mask) -> None:
    """Weighted mean of the parts into a block of a tile."""
    if not parts:
        return
    if len(parts) == 1:
        inside = parts[0].inside
        if inside is None:
            out[...] = parts[0].data
            mask[...] = True
        else:
            copy_where(parts[0].data, inside, out, clear=True)
            mask[...] = inside
        return
    weights = [part.weight() for part in parts]
    norm = np.sum(weights, axis=0)
    valid = norm > 0
    norm[~valid] = 1.0
    mean = sum(
        cv2.multiply(part.data, cv2.merge([w / norm] * out.shape[2]), dtype=cv2.CV_32F).reshape(
            out.shape
        )
        for part, w in zip(parts, weights, strict=True)
    )
    # Positive values: adding a half and cutting rounds to the nearest.
    integer = np.issubdtype(out.dtype, np.integer)
    np.copyto(out, mean + np.float32(0.5) if integer else mean, casting="unsafe")
    if not valid.all():
        blank(out, valid)
    mask[...] = valid
