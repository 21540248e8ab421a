"""The mosaic as a KML superoverlay: a pyramid of small pictures, each with its region."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

from exports.kml import elements as k
from exports.kml.picture import LatLonGrid, MosaicPicture, encode, has_content
from exports.tiles.quad_tiles import mean_of_children, quarter
from exports.tiles.raster_colour import Pixels

TILE = 256
# Levels below that of a block: a block of 1024 px is warped at once.
BLOCK_LEVELS = 2
# The deepest levels, where nearly all the bytes are: their rims are written small.
SMALL_LEVELS = 3
# px on the screen
SMALLEST, LARGEST = 128, 2048
# Bytes of a pyramid per bytes of the one that ends a level earlier.
GROWTH = 3.7
# Levels built to see how large a pyramid becomes.
PROBE_DEPTH = 3
# px of the mosaic that pictures side by side share: where they only touch, viewers leave a line
# between them, as on the screen a pixel of it is in neither
SHARED = 2
# px; up to this side one picture will do
SINGLE_SIDE = 2048
# Folders of the one pyramid, or of the two on both sides of the 180th meridian
FOLDERS = ("mosaic", "mosaic_east")


class Sink(Protocol):
    """Where the files of a KMZ go."""

    def add(self, path: str, data: bytes) -> None:
        """Take one file."""


class Scale:
    """Sink that only weighs."""

    def __init__(self) -> None:
        self.size = 0

    def add(self, path: str, data: bytes) -> None:
        """Weigh one file, with what a ZIP adds to it."""
        self.size += (len(data) if not path.endswith(".kml") else len(data) // 3) + 2 * len(path)
        self.size += 98


def levels(grid: LatLonGrid) -> int:
    """Number of the deepest level, whose pixels are as large as the mosaic's; 0 is one tile."""
    return max(0, math.ceil(math.log2(max(grid.width, grid.height) / TILE)))


@dataclass(kw_only=True)
class Pyramid:
    """Writes a superoverlay, depth first: in memory are one block and four tiles per level.

    Parameters
    ----------
    base
        Pixels as large as the mosaic's: all of `picture.grid`, or the part to be shown.
    depth
        Deepest level written; `levels(base)` shows all that the mosaic has.
    folder
        Of its files in the KMZ.
    tick
        Called with the fraction that is done; may raise to stop.
    """

    picture: MosaicPicture
    base: LatLonGrid
    sink: Sink
    depth: int
    quality: int
    tick: Callable[[float], None]
    folder: str = FOLDERS[0]
    tiles: int = 0

    def write(self) -> bool:
        """Write all tiles; False if the mosaic is empty."""
        return self._build(0, 0, 0, None) is not None

    @cached_property
    def grid(self) -> LatLonGrid:
        """Pixels of the deepest level; whole pixels of the root, so that all levels agree."""
        grid = self.base.coarser(2 ** (levels(self.base) - self.depth))
        step = 2**self.depth
        width, height = (math.ceil(side / step) * step for side in (grid.width, grid.height))
        return replace(grid, width=width, height=height)

    def bounds(self, z: int, x: int, y: int) -> dict[str, float]:
        """Sides of a tile, deg."""
        return _within(self.grid.bounds(*self._pixels(z, x, y)))

    def _pixels(self, z: int, x: int, y: int) -> tuple[int, int, int, int]:
        """First column and row of a tile, its columns and rows, in the deepest level's pixels.

        Tiles end where the mosaic ends: a viewer then knows its extent.
        """
        span = TILE * 2 ** (self.depth - z)
        col, row = x * span, y * span
        return col, row, min(span, self.grid.width - col), min(span, self.grid.height - row)

    def _build(self, z: int, x: int, y: int, block: Pixels | None) -> Pixels | None:
        """Write a tile and all below it; gives its premultiplied pixels, None if empty."""
        pixels = self._pixels(z, x, y)
        if min(pixels[2:]) <= 0:
            return None
        if z == max(0, self.depth - BLOCK_LEVELS):
            self.tick(self._fraction(x, y))
            block = self.picture.block(self.grid, *pixels)
        if z >= self.depth - BLOCK_LEVELS and (block is None or not has_content(block)):
            return None
        children: list[tuple[int, int]] = []
        tile = block if z == self.depth else self._compose(z, x, y, block, children)
        if tile is not None:
            self._put(z, x, y, tile, children)
        return tile

    def _compose(
        self, z: int, x: int, y: int, block: Pixels | None, children: list[tuple[int, int]]
    ) -> Pixels | None:
        """Tile from its four children, which are written first."""
        width, height = (side >> (self.depth - z) for side in self._pixels(z, x, y)[2:])
        half = TILE * 2 ** (self.depth - z - 1)
        tiles: dict[tuple[int, int], Pixels] = {}
        for j in (0, 1):
            for i in (0, 1):
                part = None if block is None else quarter(block, i, j, half)
                child = self._build(z + 1, 2 * x + i, 2 * y + j, part)
                if child is not None:
                    tiles[i, j] = child
                    children.append((2 * x + i, 2 * y + j))
        return mean_of_children(tiles, TILE, (width, height)) if tiles else None

    def _put(self, z: int, x: int, y: int, tile: Pixels, children: list[tuple[int, int]]) -> None:
        small = self.depth - z < SMALL_LEVELS
        suffix, data = encode(tile, self.quality, small=small)
        self.sink.add(f"{self.folder}/{z}/{x}/{y}.{suffix}", data)
        links = [
            k.network_link(
                f"{z + 1}/{i}/{j}",
                f"../../{z + 1}/{i}/{j}.kml",
                k.region(self.bounds(z + 1, i, j), smallest=SMALLEST, largest=-1),
            )
            for i, j in children
        ]
        here = self.bounds(z, x, y)
        where = k.region(here, smallest=SMALLEST if z else 1, largest=LARGEST if children else -1)
        # The region is the document's, where GDAL's reader looks for it too.
        overlay = k.ground_overlay(f"{z}/{x}/{y}", here, f"{y}.{suffix}", z)
        self.sink.add(
            f"{self.folder}/{z}/{x}/{y}.kml",
            k.document(where, *links, overlay, name=f"{z}/{x}/{y}"),
        )
        self.tiles += 1

    def _fraction(self, x: int, y: int) -> float:
        """Part of the blocks before this one in the order of the quadtree."""
        across = max(1, 2 ** max(0, self.depth - BLOCK_LEVELS))
        rank = sum(
            (((x >> bit) & 1) | (((y >> bit) & 1) << 1)) << (2 * bit)
            for bit in range(max(1, self.depth))
        )
        return float(rank / across**2)


def depth_within(
    picture: MosaicPicture,
    base: LatLonGrid,
    deepest: int,
    quality: int,
    budget: float,
    tick: Callable[[float], None],
) -> int:
    """Deepest level whose pyramid is likely to weigh at most `budget` bytes; -1 if none is."""
    scale = Scale()
    probe = min(deepest, PROBE_DEPTH)
    Pyramid(picture=picture, base=base, sink=scale, depth=probe, quality=quality, tick=tick).write()
    depth, size = probe, float(scale.size)
    while size > budget and depth >= 0:
        depth, size = depth - 1, size / GROWTH
    while depth < deepest and size * GROWTH <= budget:
        depth, size = depth + 1, size * GROWTH
    return depth


def pyramid_folder(pyramids: Sequence[Pyramid]) -> k.Element:
    """Folder of the site's document that leads to the pyramids."""
    links = [
        k.network_link(
            "Mosaic",
            f"{one.folder}/0/0/0.kml",
            k.region(one.bounds(0, 0, 0), smallest=1, largest=-1),
        )
        for one in pyramids
    ]
    return k.element(
        "Folder",
        k.element("name", text="Mosaic"),
        k.element(
            "Style", k.element("ListStyle", k.element("listItemType", text="checkHideChildren"))
        ),
        *links,
    )


def single_overlay(
    picture: MosaicPicture, sink: Sink, *, side: int, quality: int
) -> k.Element | None:
    """Mosaic as one picture of at most `side` px; None if it is empty."""
    return sheets(picture, sink, side=side, sheet=side, quality=quality, small=False)


def sheets(
    picture: MosaicPicture, sink: Sink, *, side: int, sheet: int, quality: int, small: bool
) -> k.Element | None:
    """Mosaic of at most `side` px as pictures side by side, without links; None if it is empty.

    Parameters
    ----------
    sheet : px
        Largest side of one picture, without the `SHARED` pixels of its neighbours.
    small
        Hard rims, a third of the bytes.
    """
    factor = max(1, math.ceil(max(picture.grid.width, picture.grid.height) / side))
    parts = picture.grid.parted()
    if len(parts) > 1:
        # Only such pixels end at the 180th meridian.
        factor = 2 ** math.ceil(math.log2(factor))
    overlays: list[k.Element] = []
    for base in parts:
        grid = base.coarser(factor)
        for row in range(0, grid.height, sheet):
            for col in range(0, grid.width, sheet):
                size = (
                    min(sheet + SHARED, grid.width - col), min(sheet + SHARED, grid.height - row)
                )  # fmt: skip
                block = picture.block(grid, col, row, *size)
                if block is None:
                    continue
                number = f"_{len(overlays)}" if overlays else ""
                suffix, data = encode(block, quality, small=small)
                sink.add(f"mosaic{number}.{suffix}", data)
                bounds = _within(grid.bounds(col, row, *size))
                overlays.append(
                    k.ground_overlay(f"Mosaic{number}", bounds, f"mosaic{number}.{suffix}", 0)
                )
    return k.folder("Mosaic", overlays) if overlays else None


def _within(bounds: dict[str, float]) -> dict[str, float]:
    """Sides without the last digit of a sum that should be 180."""
    return bounds | {"east": min(bounds["east"], 180.0)}
