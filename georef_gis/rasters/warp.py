"""Photos as sources of pixels: decoded once, kept within a memory budget, resampled by a mesh."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions, parallax
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import DemTerrain
from georef_gis.rasters.reading import read_image

Image = NDArray[np.integer[Any] | np.floating[Any]]
Mask = NDArray[np.bool_]
# file and by how much it is reduced
Key = tuple[Path, int]

# bytes; what decoded photos may take together
CACHE_BYTES = 245_000_000
# px; windows are warped in blocks of this side, a multiple of every mesh step
BLOCK = 128
# glibc's number of the option that limits its heaps
M_ARENA_MAX = -8
# Decoders reduce by these; a photo is reduced when the grid is at least this much coarser.
REDUCTIONS = (8, 4, 2)


@functools.cache
def _share_one_heap() -> None:
    """Have glibc keep one heap for all threads.

    It would give each thread its own, which holds on to the room of the photos decoded there:
    80 MB more on a flight of 9 MP photos, and no faster. Elsewhere nothing is done.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


class ImageCache:
    """Decoded photos within a memory budget; safe for threads, each photo decoded by one of them.

    Who knows what comes announces it: then the photo whose next use is farthest off is dropped
    (Belady 1966), which decodes each photo about once. What nobody announced goes first.

    Parameters
    ----------
    budget
        Bytes to keep; one image is kept whatever its size.
    read
        `read(path, reduce) -> (rows, cols, bands)`.
    """

    def __init__(
        self,
        *,
        budget: int = CACHE_BYTES,
        read: Callable[[Path, int], Image] | None = None,
    ) -> None:
        _share_one_heap()
        self._budget = budget
        self._read = read or (lambda path, reduce: read_image(path, reduce=reduce))
        self._images: dict[Key, Image] = {}
        self._uses: dict[Key, deque[int]] = {}
        self._lock = threading.Lock()
        self._reading: dict[Key, threading.Lock] = {}
        self._decoding = 0
        self.decodes = 0

    def capacity(self, image_bytes: int) -> int:
        """Photos of one size that the budget holds."""
        return max(1, self._budget // max(1, image_bytes))

    def announce(self, use: int, keys: Iterable[Key]) -> None:
        """Say that a job with the number `use`, larger than those before, will need photos."""
        with self._lock:
            for key in keys:
                self._uses.setdefault(key, deque()).append(use)

    def finished(self, use: int, keys: Iterable[Key]) -> None:
        """Say that a job is done with its photos."""
        with self._lock:
            for key in keys:
                uses = self._uses.get(key)
                if uses and use in uses:
                    uses.remove(use)

    def get(self, path: Path, reduce: int = 1) -> Image:
        """Pixels of a photo as stored, reduced by 1, 2, 4 or 8."""
        key = (path, reduce)
        with self._lock:
            if key in self._images:
                return self._images[key]
            own = self._reading.setdefault(key, threading.Lock())
        with own:
            with self._lock:
                if key in self._images:
                    return self._images[key]
                # Before the new ones are there: all together would exceed the budget.
                self._decoding += 1
                self._make_room(self._largest() * self._decoding)
            try:
                image = self._read(path, reduce)
            finally:
                with self._lock:
                    self._decoding -= 1
            with self._lock:
                self.decodes += 1
                self._images[key] = image
                self._reading.pop(key, None)
        return image

    def _largest(self) -> int:
        return max((image.nbytes for image in self._images.values()), default=0)

    def _make_room(self, size: int) -> None:
        total = sum(image.nbytes for image in self._images.values())
        while self._images and total + size > self._budget:
            key = max(self._images, key=self._next_use)
            total -= self._images.pop(key).nbytes

    def _next_use(self, key: Key) -> float:
        uses = self._uses.get(key)
        return uses[0] if uses else math.inf


@contextlib.contextmanager
def one_thread_each() -> Iterator[None]:
    """Keep OpenCV from splitting single calls over threads of its own."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def reduction_for(gsd: float, gsd_photo: float) -> int:
    """By how much a photo may be reduced before it is resampled to a grid of `gsd`, m."""
    return next((r for r in REDUCTIONS if gsd >= gsd_photo * r), 1)


def upsample(mesh: Array, step: int, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Bilinear values at every pixel of a window from its mesh (see `node_positions`).

    Parameters
    ----------
    mesh : shape (rows, cols) or (rows, cols, 2)
        One node per cell of `step` pixels and a ring around.
    shape
        Rows and columns of the window.
    """
    small = np.ascontiguousarray(mesh, dtype=np.float32)
    size = (small.shape[1] * step, small.shape[0] * step)
    large = small if step == 1 else cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[step : step + shape[0], step : step + shape[1]], dtype=np.float32)


def inside_image(uv: NDArray[np.float32], width: int, height: int) -> Mask:
    """Which positions lie within an image's outer edge; shape (rows, cols, 2) -> (rows, cols)."""
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (uv[..., 0] >= -0.5) & (uv[..., 1] >= -0.5)
            & (uv[..., 0] <= width - 0.5) & (uv[..., 1] <= height - 0.5)
        )  # fmt: skip


def sample(image: Image, uv: NDArray[np.float32], *, reduce: int = 1) -> Image:
    """Bilinear samples of an image at full-resolution pixel positions; (rows, cols, bands).

    At the rim the outermost half pixel is repeated; what lies outside must be masked by the
    caller.
    """
    if reduce > 1:
        uv = (uv + np.float32(0.5)) / np.float32(reduce) - np.float32(0.5)
    image, offset = _crop_for_remap(image, uv)
    if offset is not None:
        uv = uv - offset
    # None, which OpenCV's type stubs do not allow, and not an empty array: that is taken for a map.
    no_second_map: Any = None
    out: Image = cv2.remap(
        image, uv, no_second_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return out if out.ndim == 3 else out[..., None]


def _crop_for_remap(
    image: Image, uv: NDArray[np.float32]
) -> tuple[Image, NDArray[np.float32] | None]:
    """Part of an image that OpenCV's 16-bit remap can address, and its offset."""
    limit = 32000
    if max(image.shape[:2]) < limit:
        return image, None
    low = np.floor(np.nanmin(uv.reshape(-1, 2), axis=0)).astype(int) - 2
    high = np.ceil(np.nanmax(uv.reshape(-1, 2), axis=0)).astype(int) + 3
    c0, r0 = (int(min(max(v, 0), s - 1)) for v, s in zip(low, image.shape[1::-1], strict=True))
    c1, r1 = (int(min(v, o + limit)) for v, o in zip(high, (c0, r0), strict=True))
    part = np.ascontiguousarray(image[r0 : max(r1, r0 + 1), c0 : max(c1, c0 + 1)])
    return part, np.array([c0, r0], dtype=np.float32)


def warp_window(
    photo: OrientedPhoto,
    image: Image,
    ground: Ground,
    grid: Grid,
    window: Window,
    *,
    step: int,
    reduce: int = 1,
) -> tuple[Image, Mask | None] | None:
    """A photo's pixels on a window of a grid.

    Returns
    -------
    data : shape (rows, cols, bands)
    mask : shape (rows, cols) or None
        Where the photo shows the ground; None = everywhere.
        The pair is None where the photo does not reach the window.
    """
    mesh = ground_mesh(ground, grid, window, step)
    p_enu, delta = mesh.p_enu, mesh.delta
    nodes = photo.project(p_enu)
    width, height = photo.camera.width, photo.camera.height
    moves = None if delta is None else parallax(photo, p_enu)
    slack = largest_move(delta, moves)
    if all_outside(nodes, width, height, slack):
        return None
    shape = (window.height, window.width)
    uv = positions(nodes, step, shape, delta, moves)
    if all_inside(nodes, width, height, slack):
        return sample(image, uv, reduce=reduce), None
    data = np.zeros((*shape, image.shape[2]), dtype=image.dtype)
    mask = np.zeros(shape, dtype=np.bool_)
    for pixels, cells in blocks(window, step):
        part = nodes[cells]
        if all_outside(part, width, height, slack):
            continue
        data[pixels] = sample(image, uv[pixels], reduce=reduce)
        if all_inside(part, width, height, slack):
            mask[pixels] = True
        else:
            mask[pixels] = inside = inside_image(uv[pixels], width, height)
            blank(data[pixels], inside)
    if mask.all():
        return data, None
    return (data, mask) if mask.any() else None


def blank(data: Image, keep: Mask) -> None:
    """Set the pixels (rows, cols, bands) that are not kept to zero."""
    copy_where(data.copy(), keep, data, clear=True)


def copy_where(source: Image, where: Mask, target: Image, *, clear: bool = False) -> None:
    """Copy pixels (rows, cols, bands) where a mask holds; OpenCV's takes a tenth of numpy's time.

    With `clear` the others become zero.
    """
    out = np.zeros_like(source) if clear else target.copy()
    mask = np.ascontiguousarray(where).view(np.uint8)
    target[...] = cv2.copyTo(source, mask, out).reshape(target.shape)


def blocks(window: Window, step: int) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Blocks of a window: their pixels, and the mesh nodes that these are interpolated from."""
    cells = BLOCK // step + 2
    for row in range(0, window.height, BLOCK):
        for col in range(0, window.width, BLOCK):
            i, j = row // step, col // step
            pixels = (slice(row, row + BLOCK), slice(col, col + BLOCK))
            yield pixels, (slice(i, i + cells), slice(j, j + cells))


def all_inside(uv: Array, width: int, height: int, slack: float = 0.0) -> bool:
    """Whether all nodes, and so all that is bilinear between them, lie in an image.

    `slack`, px, is how far relief may move what lies between the nodes.
    """
    u, v = uv[..., 0], uv[..., 1]
    # NaN compares as false: a node without a pixel is not inside.
    return bool(
        u.min() >= slack
        and v.min() >= slack
        and u.max() <= width - 1 - slack
        and v.max() <= height - 1 - slack
    )


def all_outside(uv: Array, width: int, height: int, slack: float = 0.0) -> bool:
    """Whether all nodes lie beyond one side of an image, and so all that is between them."""
    u, v = uv[..., 0], uv[..., 1]
    far = 0.5 + slack
    return bool(
        u.max() < -far or v.max() < -far or u.min() > width - 1 + far or v.min() > height - 1 + far
    )


@dataclass(frozen=True, slots=True, eq=False)
class GroundMesh:
    """Ground at the nodes of a mesh (see `node_positions`), and what relief the mesh leaves out.

    Parameters
    ----------
    p_enu : shape (node rows, node cols, 3), m
    delta : shape (rows, cols), m
        Height of the ground above the mesh at every pixel; NaN where the DEM has none; None if
        there is no relief.
    """

    p_enu: Array
    delta: NDArray[np.float32] | None


def ground_mesh(ground: Ground, grid: Grid, window: Window, step: int) -> GroundMesh:
    """Ground under a window by a mesh of cells of `step` px."""
    xy = grid.map_from_grid(node_positions(window, step))
    terrain = ground.terrain
    if not ground.has_relief or not isinstance(terrain, DemTerrain):
        return GroundMesh(_on_ground(ground, xy, ground.heights_at(xy)), None)
    at = ground.dem_position(xy)
    nodes = terrain.height_at(at)
    delta = _relief(terrain, at, nodes, step, (window.height, window.width))
    return GroundMesh(_on_ground(ground, xy, nodes), delta)


def _on_ground(ground: Ground, xy: Array, heights: Array) -> Array:
    return ground.local.enu_from_map(np.concatenate([xy, heights[..., None]], axis=-1))


def _relief(
    dem: DemTerrain, at: Array, nodes: Array, step: int, shape: tuple[int, int]
) -> NDArray[np.float32] | None:
    """Height of a DEM, m, above the mesh of its heights `nodes` at its cells `at`."""
    if not np.any(np.isfinite(nodes)):
        return None
    # Relative to a level nearby: float32 resolves 1e-5 m then.
    level = float(np.nanmean(nodes))
    rows, cols = dem.heights.shape
    low = np.clip(np.floor(at.reshape(-1, 2).min(axis=0)) - 1, 0, [cols - 1, rows - 1]).astype(int)
    high = np.clip(np.ceil(at.reshape(-1, 2).max(axis=0)) + 2, low + 1, [cols, rows]).astype(int)
    part = (dem.heights[low[1] : high[1], low[0] : high[0]] - level).astype(np.float32)
    place = upsample(at - low, step, shape)
    no_second_map: Any = None
    true = cv2.remap(part, place, no_second_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(true - upsample(nodes - level, step, shape), dtype=np.float32)


def positions(
    nodes: Array,
    step: int,
    shape: tuple[int, int],
    delta: NDArray[np.float32] | None = None,
    moves: Array | None = None,
) -> NDArray[np.float32]:
    """Pixel positions in a photo at every pixel of a window; (rows, cols, 2).

    Parameters
    ----------
    nodes, moves : shape (node rows, node cols, 2)
        Pixel at the nodes of the mesh, px, and how far it moves per metre of height, px/m.
    delta : shape (rows, cols)
        Height that the mesh leaves out, m (see `ground_mesh`).
    """
    uv = upsample(nodes, step, shape)
    if delta is None or moves is None:
        return uv
    return np.asarray(uv + upsample(moves, step, shape) * delta[..., None])


def largest_move(delta: NDArray[np.float32] | None, moves: Array | None) -> float:
    """How far relief may move a pixel, px."""
    if delta is None or moves is None:
        return 0.0
    if np.isnan(delta).any():
        # A hole of the DEM may lie between the nodes: every pixel is looked at.
        return math.inf
    height = float(np.nanmax(np.abs(delta), initial=0.0))
    return height * float(np.max(np.abs(moves), initial=0.0, where=np.isfinite(moves)))
