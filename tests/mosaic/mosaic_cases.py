"""Small flights over flat ground for mosaics, in memory and as files of a project."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, map_crs
from georef_gis.model.camera import Camera
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.plan import Plan, plan_tiles
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.mosaic.nadir import NadirMosaic, mosaic_source
from georef_gis.rasters.warp import reduction_for
from georef_gis.rectify.footprints import footprint
from georef_gis.rectify.grids import plan_grid

ORIGIN = Origin(lat=math.radians(40.0), lon=math.radians(-83.0), height_ellipsoidal=200.0)
TERRAIN = FlatTerrain(origin=ORIGIN, height_ellipsoidal=200.0)
CAMERA = Camera(id="c", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)
# m; the photos show 120 x 80 m in pixels of 0.2 m
HEIGHT = 100.0

Image = NDArray[Any]


def frame(crs: str = "EPSG:32617") -> MapFrame:
    return MapFrame(ORIGIN, map_crs(crs))


def photo_at(east: float, north: float, name: str, *, turn_deg: float = 0.0) -> OrientedPhoto:
    a = math.radians(turn_deg)
    turn = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1.0]])
    pose = Pose(
        origin_enu=np.array([east, north, HEIGHT]),
        R_enu_from_cam=turn @ np.diag([1.0, -1.0, -1.0]),
        covariance=np.eye(6) * 1e-4,
    )
    photo = Photo(id=name, path=Path(f"{name}.jpg"), width=600, height=400)
    return OrientedPhoto(photo=photo, camera=CAMERA, pose=pose)


def flat_image(*levels: int, dtype: str = "uint8") -> Image:
    """Photo of one colour."""
    return np.tile(np.array(levels, dtype=dtype), (400, 600, 1))


@dataclass
class Scene:
    """Photos and what is needed to render them."""

    photos: Sequence[OrientedPhoto]
    images: Mapping[str, Image]
    gsd: float = 0.2

    def __post_init__(self) -> None:
        self.frame = frame()
        self.prints = {p.id: footprint(p, TERRAIN, self.frame) for p in self.photos}
        self.grid: Grid = plan_grid(list(self.prints.values()), self.frame, gsd=self.gsd)
        self.plan: Plan = plan_tiles(self.grid, {k: f.ring_map for k, f in self.prints.items()})
        self.broken: list[str] = []
        self.reads: list[str] = []

    def read(self, path: Path, reduce: int) -> Image:
        """Pixels of a photo; one without an image is an unreadable file."""
        self.reads.append(path.stem)
        if path.stem not in self.images:
            raise InputError("is not an image or is damaged; leave it out", source=path.name)
        return np.ascontiguousarray(self.images[path.stem][::reduce, ::reduce])

    def mosaic(self) -> NadirMosaic:
        ground = Ground.of(self.frame, self.grid, TERRAIN, (200.0, 200.0))
        sources = {
            p.id: mosaic_source(
                p, ground, self.grid, self.prints[p.id].ring_map,
                reduce=reduction_for(self.gsd, self.prints[p.id].gsd), reach=72.1,
            )
            for p in self.photos
        }  # fmt: skip
        return NadirMosaic(
            sources, ground, self.grid, gsd=self.gsd, read=self.read, broken=self.broken
        )

    def render(self, order: Sequence[int] | None = None) -> tuple[Image, NDArray[np.bool_]]:
        """The whole mosaic and its mask, its tiles rendered in the given order."""
        some = next(iter(self.images.values()))
        out = np.zeros((self.grid.height, self.grid.width, some.shape[2]), some.dtype)
        mask = np.zeros(out.shape[:2], bool)
        mosaic = self.mosaic()
        for i in order if order is not None else range(len(self.plan.tiles)):
            task = self.plan.tiles[i]
            w = task.window
            tile = mosaic.tile(task)
            if tile is None:
                continue
            here = (slice(w.row, w.row + w.height), slice(w.col, w.col + w.width))
            out[here] = tile[0]
            mask[here] = True if tile[1] is None else tile[1]
        return out, mask

    def places(self) -> Array:
        """East and north, m, of every pixel's centre; shape (rows, cols, 2)."""
        cols, rows = np.meshgrid(np.arange(self.grid.width), np.arange(self.grid.height))
        p = self.grid.map_from_grid(np.stack([cols, rows], axis=-1) + 0.5)
        h = np.full((*p.shape[:2], 1), 200.0)
        return self.frame.enu_from_map(np.concatenate([p, h], axis=-1))[..., :2]
