"""What the products are made of: footprints, orthos, the mosaic, and their attribute schemas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from georef_gis.frames import Array
from georef_gis.model.grid import Grid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Footprint:
    """Ground that a photo shows: a ring in the map CRS, and figures about it.

    `ring_map` (n, 2) CRS units, closed, counter-clockwise; `gsd` in m is the mean over the
    photo, `sigma_horizontal` in m the expected position error of its middle (one sigma, per axis).
    """

    photo_id: str
    ring_map: Array
    ring_enu: Array
    gsd: float
    gsd_min: float
    gsd_max: float
    area_m2: float
    height_above_ground: float
    tilt: float
    nadir_map: Array
    sigma_horizontal: float
    # whether part of the photo looks above the horizon or past the ground
    clipped: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Ortho:
    """One orthorectified photo on disk."""

    photo_id: str
    path: Path
    grid: Grid


@dataclass(frozen=True, slots=True, kw_only=True)
class Mosaic:
    """The mosaic on disk."""

    path: Path
    grid: Grid
    photo_ids: tuple[str, ...]
    covered_m2: float
    bands: tuple[str, ...] = ()
