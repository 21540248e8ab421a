"""A photo over a tile of a mosaic: where its pixels lie and what their grey values become."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto
from georef_gis.mosaic.canvas import Positions
from georef_gis.mosaic.nadir import MosaicSource
from georef_gis.rasters.warp import Mask, ground_mesh, largest_move

Values = NDArray[np.float32]
# px of the tile: side of the blocks that are looked at for what is missing
BLOCK = 64
HALF_METRE = np.array([0.0, 0.0, 0.5])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Ground under a tile at the nodes of a mesh that belongs to the grid.

    Parameters
    ----------
    first
        Row and column of the first node, counted in cells from the grid's corner.
    p_enu : shape (rows, cols, 3), m
    delta : shape (rows, cols) of the tile, m
        Height of the ground above the mesh; None over flat ground.
    """

    first: tuple[int, int]
    p_enu: Array
    delta: Values | None


@dataclass(frozen=True, slots=True, eq=False)
class TileGround:
    """The ground under a tile, for all photos that show it: found once for each mesh step."""

    ground: Ground
    grid: Grid
    window: Window
    _meshes: dict[int, Mesh] = field(default_factory=dict)

    def mesh(self, step: int) -> Mesh:
        """Mesh of cells of `step` px."""
        found = self._meshes.get(step)
        if found is None:
            found = self._meshes[step] = self._made(step)
        return found

    def holes(self, mask: Mask) -> Holes:
        """Blocks in which a mask of the tile holds."""
        rows, cols = (np.arange(0, n, BLOCK) for n in mask.shape)
        some = np.logical_or.reduceat(np.logical_or.reduceat(mask, rows, axis=0), cols, axis=1)
        i, j = np.nonzero(some)
        corners = np.stack([rows[i], cols[j]], axis=-1)
        place = corners[:, ::-1] + [self.window.col, self.window.row] + 0.5 * BLOCK
        return Holes(corners, self.ground.enu_at(self.grid, place))

    def _made(self, step: int) -> Mesh:
        w = self.window
        # cells of the grid, not of the tile: a pixel is the same whatever tile it lies in
        row, col = w.row // step, w.col // step
        whole = Window(
            row=row * step, col=col * step,
            height=w.row + w.height - row * step, width=w.col + w.width - col * step,
        )  # fmt: skip
        mesh = ground_mesh(self.ground, self.grid, whole, step)
        delta = mesh.delta
        if delta is not None:
            delta = np.ascontiguousarray(delta[w.row - whole.row :, w.col - whole.col :])
        return Mesh((row - 1, col - 1), mesh.p_enu, delta)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A photo over part of a tile.

    Parameters
    ----------
    relief : shape (rows, cols) of the tile, m
        Height above the mesh; None over ground that the mesh follows.
    """

    source: MosaicSource
    at: Positions
    relief: Values | None

    @classmethod
    def of(
        cls, source: MosaicSource, tile: TileGround, box: tuple[slice, slice] | None = None
    ) -> Layer | None:
        """Layer of a photo; None where it does not reach the box (rows, cols), px of the tile."""
        mesh = tile.mesh(source.step)
        nodes, first = mesh.p_enu, mesh.first
        if box is not None:
            rows = _cells(box[0], tile.window.row, source.step, first[0])
            cols = _cells(box[1], tile.window.col, source.step, first[1])
            nodes, first = nodes[rows, cols], (first[0] + rows.start, first[1] + cols.start)
        parts = [nodes.reshape(-1, 3)]
        if mesh.delta is not None:
            parts += [parts[0] + HALF_METRE, parts[0] - HALF_METRE]
        # one call: on so few points its overhead is what it costs
        uv = source.photo.project(np.concatenate(parts))
        shape, n = nodes.shape[:2], len(parts[0])
        here = np.ascontiguousarray(uv[:n].reshape(*shape, 2))
        moves = None
        if mesh.delta is not None:
            moves = (uv[n : 2 * n] - uv[2 * n : 3 * n]).reshape(*shape, 2)
        delta = mesh.delta if box is None or mesh.delta is None else mesh.delta[box]
        if not _meets(here, source.photo, largest_move(delta, moves)):
            return None
        camera = source.photo.camera
        at = Positions(
            nodes=here, moves=moves, first=first, step=source.step,
            size=(camera.width, camera.height), reduce=source.reduce,
        )  # fmt: skip
        return cls(source, at, mesh.delta)


@dataclass(frozen=True, slots=True, eq=False)
class Holes:
    """Blocks of a tile in which something is missing.

    Parameters
    ----------
    corners : shape (k, 2), px
        Row and column of their upper left corners.
    p_enu : shape (k, 3), m
        Ground at their middles.
    """

    corners: NDArray[np.intp]
    p_enu: Array

    def box(self, source: MosaicSource) -> tuple[slice, slice] | None:
        """Rows and columns around the blocks of which a photo may show something."""
        camera = source.photo.camera
        # a block's half diagonal; photos are as fine as the grid, or up to twice when reduced
        far = 1.5 * BLOCK * source.reduce
        u, v = source.photo.project(self.p_enu).T
        near = (u >= -far) & (v >= -far) & (u <= camera.width + far) & (v <= camera.height + far)
        if not near.any():
            return None
        low, high = self.corners[near].min(axis=0), self.corners[near].max(axis=0) + BLOCK
        return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))


def box_of(weight: Values) -> tuple[slice, slice] | None:
    """Rows and columns in which a weight is anything but 0; None if nowhere."""
    rows = np.flatnonzero(weight.any(axis=1))
    if not rows.size:
        return None
    cols = np.flatnonzero(weight.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def _cells(pixels: slice, corner: int, step: int, first: int) -> slice:
    """Nodes around pixels of a tile that begins at `corner` px, counted from the first node."""
    start: Any = pixels.start
    stop: Any = pixels.stop
    low = int(np.floor((corner + start + 0.5) / step - 0.5)) - first
    high = int(np.floor((corner + stop - 0.5) / step - 0.5)) - first
    return slice(low, high + 2)


def _meets(uv: Array, photo: OrientedPhoto, slack: float) -> bool:
    """Whether nodes lie in a photo, or on more than one side of it; NaN lies nowhere."""
    u, v = uv[..., 0], uv[..., 1]
    far = 0.5 + slack
    width, height = photo.camera.width - 1 + far, photo.camera.height - 1 + far
    # NaN compares as false, so it is on no side
    return bool(
        np.any(u >= -far) and np.any(v >= -far) and np.any(u <= width) and np.any(v <= height)
    )
