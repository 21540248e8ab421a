"""The quadtree of tiles, depth first: in memory are one block and four tiles per zoom."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

from exports.tiles.quad_tiles import mean_of_children, quarter
from exports.tiles.web_mercator import WORLD, pixel_size, tile_corner

if TYPE_CHECKING:
    from exports.tiles.raster_colour import Pixels
    from exports.tiles.web_encoding import Encode
    from exports.tiles.web_picture import WebPicture
    from exports.tiles.web_plan import TileSet

# px; warped at once: of smaller blocks the rims would be read twice too often
BLOCK = 1024
# Pixels of the best overview per pixel of a tile above which bilinear sampling leaves some out.
COARSEST = 1.5


class TileSink(Protocol):
    """Where tiles go; rows count from the north (XYZ)."""

    def put(self, zoom: int, x: int, y: int, data: bytes) -> None:
        """Take one tile; each comes once, those of a zoom in no order."""


@dataclass(kw_only=True)
class TileWalk:
    """Makes the tiles of a picture and gives them to a sink.

    Only the deepest tiles are warped; each other one is the mean of its four children. Squares
    where the picture has nothing are passed over at the coarsest zoom that shows it.

    Parameters
    ----------
    tick
        Called with the fraction that is done; may raise to stop.
    count
        Tiles given so far.
    """

    picture: WebPicture
    tiles: TileSet
    sink: TileSink
    encode: Encode
    tick: Callable[[float], None]
    count: int = 0

    def write(self) -> None:
        """Make all tiles."""
        zoom = self.tiles.min_zoom
        west, south, east, north = self.picture.place.bounds
        side, last = math.ldexp(WORLD, -zoom), 2**zoom - 1
        left, right = (int((x + WORLD / 2) // side) for x in (west, east))
        top, bottom = (int((WORLD / 2 - y) // side) for y in (north, south))
        roots = [
            (x, y)
            for y in range(max(top, 0), min(bottom, last) + 1)
            for x in range(max(left, 0), min(right, last) + 1)
        ]
        for number, (x, y) in enumerate(roots):
            self._build(zoom, x, y, None, (number / len(roots), 1.0 / len(roots)))

    @cached_property
    def depth(self) -> int:
        """Zoom that is warped; deeper than the last one where no overview is fine enough for it."""
        zoom = self.tiles.max_zoom
        while self.picture.coarseness(pixel_size(zoom, self.tiles.tile_size)) > COARSEST:
            zoom += 1
        return zoom

    @cached_property
    def block_zoom(self) -> int:
        """Zoom whose tiles are as large as a block of the deepest one."""
        return max(self.tiles.min_zoom, self.depth - int(math.log2(BLOCK / self.tiles.tile_size)))

    def _build(
        self, zoom: int, x: int, y: int, block: Pixels | None, share: tuple[float, float]
    ) -> Pixels | None:
        """Make a tile and all below it; gives its premultiplied pixels, None if empty.

        Parameters
        ----------
        block
            The part of a warped block under the tile, if it lies in one.
        share
            Where in the whole work this tile begins, and its part of it.
        """
        if block is None:
            self.tick(share[0])
            if not self.picture.may_hold(*tile_corner(zoom, x, y), math.ldexp(WORLD, -zoom)):
                return None
            if zoom == self.block_zoom:
                block = self._warp(zoom, x, y)
        if zoom >= self.block_zoom and (block is None or not block[..., 3].any()):
            return None
        tile = block if zoom == self.depth else self._compose(zoom, x, y, block, share)
        if tile is not None and zoom <= self.tiles.max_zoom:
            self.sink.put(zoom, x, y, self.encode(tile))
            self.count += 1
        return tile

    def _warp(self, zoom: int, x: int, y: int) -> Pixels | None:
        size = self.tiles.tile_size
        pixel, side = pixel_size(self.depth, size), size << (self.depth - zoom)
        return self.picture.block(*tile_corner(zoom, x, y), pixel, side)

    def _compose(
        self, zoom: int, x: int, y: int, block: Pixels | None, share: tuple[float, float]
    ) -> Pixels | None:
        """Tile from its four children, which are made first."""
        size = self.tiles.tile_size
        start, part = share[0], share[1] / 4.0
        children: dict[tuple[int, int], Pixels] = {}
        for number, (j, i) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            piece = None if block is None else quarter(block, i, j, len(block) // 2)
            its = (start + number * part, part)
            child = self._build(zoom + 1, 2 * x + i, 2 * y + j, piece, its)
            if child is not None:
                children[i, j] = child
        return mean_of_children(children, size, (size, size)) if children else None
