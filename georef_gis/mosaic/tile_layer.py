"""A photo over a tile of a mosaic: where its pixels lie and what their grey values become."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.model.photo import OrientedPhoto
from georef_gis.mosaic.colour_field import Knots, Lattice, coloured
from georef_gis.mosaic.nadir import MosaicSource
from georef_gis.rasters.warp import (
    Image,
    Mask,
    all_inside,
    inside_image,
    largest_move,
    relief,
    sample,
    upsample,
)

Values = NDArray[np.float32]
HALF_METRE = np.array([0.0, 0.0, 0.5])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Ground under a tile at the nodes of a mesh, and what relief the mesh leaves out."""

    p_enu: Array
    delta: Values | None


@dataclass(slots=True, eq=False)
class TileGround:
    """The ground under a tile, for all photos that show it: found once for each mesh step."""

    ground: Ground
    grid: Grid
    window: Window
    lattice: Lattice
    knots: Knots | None
    _meshes: dict[int, Mesh] = field(default_factory=dict)

    def mesh(self, step: int) -> Mesh:
        """Mesh of cells of `step` px."""
        found = self._meshes.get(step)
        if found is None:
            p_enu = self.ground.enu_at(self.grid, node_positions(self.window, step))
            found = Mesh(p_enu, relief(self.ground, self.grid, self.window, step))
            self._meshes[step] = found
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A photo over a tile.

    Parameters
    ----------
    nodes, moves
        Pixels of the mesh's nodes, and how far they move per metre of height, px/m; None over
        ground that the mesh follows.
    knots_uv
        Pixels of the knots at which its colour is computed; None where colours stay.
    """

    source: MosaicSource
    mesh: Mesh
    nodes: Array
    moves: Array | None
    slack: float
    knots_uv: Array | None

    @classmethod
    def of(cls, source: MosaicSource, tile: TileGround) -> Layer | None:
        """Layer of a photo; None where it does not reach the tile."""
        mesh = tile.mesh(source.step)
        parts = [mesh.p_enu.reshape(-1, 3)]
        if mesh.delta is not None:
            parts += [parts[0] + HALF_METRE, parts[0] - HALF_METRE]
        if tile.knots is not None:
            parts.append(tile.knots.p_enu.reshape(-1, 3))
        # one call: on so few points its overhead is what it costs
        uv = source.photo.project(np.concatenate(parts))
        shape, n = mesh.p_enu.shape[:2], len(parts[0])
        nodes = uv[:n].reshape(*shape, 2)
        moves = None
        if mesh.delta is not None:
            moves = (uv[n : 2 * n] - uv[2 * n : 3 * n]).reshape(*shape, 2)
        slack = largest_move(mesh.delta, moves)
        if not _meets(nodes, source.photo, slack):
            return None
        knots_uv = None
        if tile.knots is not None:
            knots_uv = uv[-tile.knots.count :].reshape(*tile.knots.p_enu.shape[:2], 2)
        return cls(source, mesh, nodes, moves, slack, knots_uv)

    def uv(self, pixels: tuple[slice, slice], nodes: tuple[slice, slice], size: Any) -> Values:
        """Pixel positions in the photo of a block of (rows, cols) `size`; (rows, cols, 2)."""
        step = self.source.step
        uv = upsample(self.nodes[nodes], step, size)
        if self.moves is None or self.mesh.delta is None:
            return uv
        delta = self.mesh.delta[pixels]
        return np.asarray(uv + upsample(self.moves[nodes], step, size) * delta[..., None])

    def inside(self, uv: Values, nodes: tuple[slice, slice]) -> Mask | None:
        """Where the photo shows a block; None = everywhere."""
        camera = self.source.photo.camera
        if all_inside(self.nodes[nodes], camera.width, camera.height, self.slack):
            return None
        return inside_image(uv, camera.width, camera.height)

    def outside(self, nodes: tuple[slice, slice]) -> bool:
        """Whether the photo shows nothing of a block."""
        return not _meets(self.nodes[nodes], self.source.photo, self.slack)


def _meets(uv: Array, photo: OrientedPhoto, slack: float) -> bool:
    """Whether nodes lie in a photo, or on more than one side of it; NaN lies nowhere."""
    u, v = uv[..., 0], uv[..., 1]
    far = 0.5 + slack
    width, height = photo.camera.width - 1 + far, photo.camera.height - 1 + far
    # NaN compares as false, so it is on no side
    return bool(
        np.any(u >= -far) and np.any(v >= -far) and np.any(u <= width) and np.any(v <= height)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """A layer's pixels, and how their grey values change over the tile."""

    layer: Layer
    image: Image
    lattice: Lattice
    gain: Values | None
    add: Values | None

    def values(self, uv: Values, pixels: tuple[slice, slice], out: Image) -> None:
        """Corrected grey values of a block into `out`."""
        data = sample(self.image, uv, reduce=self.layer.source.reduce)
        if self.gain is None or self.add is None:
            out[...] = data
            return
        at = pixels[0].start, pixels[1].start
        coloured(data, self.gain, self.add, self.lattice, at, out)
