"""One ortho per photo: warped tile by tile through a checked mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from georef_gis.errors import Cancelled
from georef_gis.model.grid import Grid, Window
from georef_gis.model.layers import Footprint, Ortho
from georef_gis.model.mesh import Ground
from georef_gis.model.mesh_step import choose_step
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.plan import plan_tiles
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.warp import Image, reduction_for, warp_window
from georef_gis.rasters.writer import TiledWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class OrthoTarget:
    """File to write, what kind of raster it is, its grid, and the grid's pixel, m."""

    path: Path
    profile: RasterProfile
    grid: Grid
    gsd: float


def write_ortho(
    photo: OrientedPhoto,
    image: Image,
    footprint: Footprint,
    ground: Ground,
    target: OrthoTarget,
    *,
    cancelled: Callable[[], bool] = lambda: False,
) -> Ortho:
    """Write the ortho of one photo as a COG; it appears whole or not at all.

    Parameters
    ----------
    image : shape (rows, cols, bands)
        The photo, decoded with `reduction_for(target.gsd, footprint.gsd)`.
    cancelled
        Asked before each tile.

    Raises
    ------
    Cancelled
        If `cancelled` says so; nothing is left behind.
    """
    grid = target.grid
    plan = plan_tiles(grid, {photo.id: footprint.ring_map}, tile_size=target.profile.tile_size)
    whole = Window(col=0, row=0, width=grid.width, height=grid.height)
    step = choose_step(photo, ground, grid, whole)
    reduce = reduction_for(target.gsd, footprint.gsd)
    with TiledWriter(target.path, target.profile) as writer:
        for task in plan.tiles:
            if cancelled():
                raise Cancelled("stopped by the user")
            tile = warp_window(photo, image, ground, grid, task.window, step=step, reduce=reduce)
            if tile is not None:
                writer.write_tile(task.row, task.col, tile[0], tile[1])
    return Ortho(photo_id=photo.id, path=target.path, grid=grid)
