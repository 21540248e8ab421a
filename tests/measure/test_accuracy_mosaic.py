"""Reading marked points in a mosaic: two photos whose poses contradict each other."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.errors import CrsError
from georef_gis.frames import Array, exp_so3
from georef_gis.geodesy import MapFrame, Origin, map_crs, metres_per_unit
from georef_gis.measure.accuracy.mosaic import MarkedPhoto, MosaicReader
from georef_gis.model.camera import Camera
from georef_gis.model.grid import Grid
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.writer import TiledWriter

pytestmark = pytest.mark.slow

ORIGIN = Origin(lat=math.radians(40.0), lon=math.radians(-83.0), height_ellipsoidal=200.0)
TERRAIN = FlatTerrain(origin=ORIGIN, height_ellipsoidal=200.0)
CAMERA = Camera(id="c", width=800, height=600, fx=800.0, fy=800.0, cx=399.5, cy=299.5)
NADIR = np.diag([1.0, -1.0, -1.0])
# m of ground per pixel of the painted ground, of photos 40 m above it, and of the mosaic
PAINT, GSD = 0.02, 0.05
# m, one sigma per axis of the stated poses
SIGMA = 0.5
Image = NDArray[np.uint8]


@pytest.fixture(scope="module")
def ground() -> NDArray[np.float32]:
    """Grass of 52 x 52 m around the origin, 2 cm a pixel, north up."""
    rng = np.random.default_rng(7)
    side = 2600
    out = np.full((side, side), 120.0, np.float32)
    for size, contrast in ((2, 20), (5, 20), (25, 25)):
        grains = rng.normal(size=(side // size + 1,) * 2).astype(np.float32)
        out += contrast * cv2.resize(grains, (side, side), interpolation=cv2.INTER_CUBIC)
    return np.clip(out, 0, 255)


def true_photo(name: str, east: float, north: float, turn: float = 0.0) -> OrientedPhoto:
    R = exp_so3(np.array([0.0, 0.0, math.radians(turn)])) @ NADIR
    covariance = np.diag([SIGMA**2] * 2 + [0.04] + [1e-5] * 2 + [1e-4])
    pose = Pose(origin_enu=np.array([east, north, 40.0]), R_enu_from_cam=R, covariance=covariance)
    photo = Photo(id=name, path=Path(f"{name}.png"), width=800, height=600)
    return OrientedPhoto(photo=photo, camera=CAMERA, pose=pose)


def taken(photo: OrientedPhoto, ground: NDArray[np.float32], seed: int) -> Image:
    """What a photo shows of the painted ground, with noise; its pose is the true one."""
    u, v = np.meshgrid(np.arange(800.0), np.arange(600.0))
    p = TERRAIN.intersect(*photo.rays(np.stack([u, v], axis=-1)))
    middle = (np.array(ground.shape[::-1]) - 1) / 2
    at = np.stack([p[..., 0], -p[..., 1]], axis=-1) / PAINT + middle
    soft = cv2.GaussianBlur(ground, (0, 0), 0.5 * GSD / PAINT)
    seen = cv2.remap(soft, at.astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    noise = np.random.default_rng(seed).normal(0, 3, seen.shape)
    return np.repeat(np.clip(seen + noise, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def moved(photo: OrientedPhoto, dp: tuple[float, float], turn: float = 0.0) -> OrientedPhoto:
    """The photo as a pose in error states it."""
    pose = photo.pose
    R = exp_so3(np.array([0.0, 0.0, math.radians(turn)])) @ pose.R_enu_from_cam
    origin = pose.origin_enu + np.array([*dp, 0.0])
    return replace(photo, pose=replace(pose, origin_enu=origin, R_enu_from_cam=R))


class Scene:
    """A mosaic of photo A alone by its stated pose, 1.0 m east and 0.6 m south of the truth."""

    SHIFT = (1.0, -0.6)

    def __init__(self, folder: Path, ground: NDArray[np.float32], crs: str) -> None:
        from georef_gis.model.grid import Window
        from georef_gis.rasters.warp import warp_window

        self.frame = MapFrame(ORIGIN, map_crs(crs))
        unit = metres_per_unit(self.frame.horizontal)
        self.true = {"A": true_photo("A", 0.0, 0.0), "B": true_photo("B", 8.0, 3.0, turn=20.0)}
        self.images = {n: taken(p, ground, i) for i, (n, p) in enumerate(self.true.items())}
        self.stated = {"A": moved(self.true["A"], self.SHIFT),
                       "B": moved(self.true["B"], (-0.7, 0.4), turn=4.0)}  # fmt: skip
        e, n, _ = self.frame.map_from_enu(np.zeros(3))
        half = 14.0 / unit
        self.grid = Grid.over(
            (e - half, n - half, e + half, n + half), pixel=GSD / unit,
            crs_wkt=self.frame.horizontal.to_wkt(),
        )  # fmt: skip
        grid = self.grid
        warped = warp_window(
            self.stated["A"], self.images["A"], self.ground_of(grid), grid,
            Window(col=0, row=0, width=grid.width, height=grid.height), step=8,
        )  # fmt: skip
        assert warped is not None
        self.path = folder / "mosaic.tif"
        profile = RasterProfile(
            width=grid.width, height=grid.height, transform=grid.transform, crs_wkt=grid.crs_wkt,
            epsg=self.frame.horizontal.to_epsg(), compression="deflate", tile_size=1024,
        )  # fmt: skip
        with TiledWriter(self.path, profile, workers=1) as writer:
            writer.write_tile(0, 0, warped[0], warped[1])

    def ground_of(self, grid: Grid) -> Ground:
        return Ground.of(self.frame, grid, TERRAIN, (200.0, 200.0))

    def reader(self) -> MosaicReader:
        return MosaicReader(
            self.path, self.frame, self.ground_of, read=lambda path, _: self.images[path.stem]
        )

    def mark(self, name: str, p_enu: Array) -> MarkedPhoto:
        """The exact mark of a point in a photo, which is stated in error."""
        return MarkedPhoto(photo=self.stated[name], uv=self.true[name].project(p_enu), sigma_px=0.2)

    def expected(self, p_enu: Array) -> Array:
        """Where the mosaic shows a point, (east, north) map: beside its true place."""
        from georef_gis.model.ground_point import locate

        seen = locate(self.stated["A"], self.true["A"].project(p_enu), TERRAIN)
        return self.frame.map_from_enu(seen)[:2]


@pytest.fixture(scope="module", params=["EPSG:32617", "EPSG:3735"], ids=["metres", "US feet"])
def scene(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory,
    ground: NDArray[np.float32],
) -> Scene:  # fmt: skip
    return Scene(tmp_path_factory.mktemp("mosaic"), ground, request.param)


def points() -> Array:
    rng = np.random.default_rng(5)
    xy = rng.uniform([-2.0, -7.0], [9.0, 7.0], (12, 2))
    z = TERRAIN.z_at(xy)
    return np.column_stack([xy, z])


def test_place_is_the_mosaics_and_not_that_of_the_marked_photo(scene: Scene) -> None:
    reader, unit = scene.reader(), metres_per_unit(scene.frame.horizontal)
    ratios = []
    for p in points():
        place = reader.place([scene.mark("B", p)])
        assert place.readings, place.refused
        off = (place.xy_map - scene.expected(p)) * unit
        # m: a quarter of a pixel; the two photos contradict each other by 2 m
        np.testing.assert_allclose(off, 0.0, atol=0.25 * GSD)
        assert np.linalg.norm(place.readings[0].shift) > 1.0
        ratios.extend(off / place.sigma)
    # The marks are exact here, while sigma counts 0.2 px of them.
    assert np.sqrt(np.mean(np.square(ratios))) < 1.4


def test_residual_of_the_mosaic_is_the_error_of_the_photo_it_shows(scene: Scene) -> None:
    reader, unit = scene.reader(), metres_per_unit(scene.frame.horizontal)
    for p in points()[:4]:
        place = reader.place([scene.mark("A", p), scene.mark("B", p)])
        surveyed = scene.frame.map_from_enu(p)[:2]
        assert len(place.readings) == 2
        turn = scene.frame.convergence_at(p)
        c, s = math.cos(turn), math.sin(turn)
        # m: map axes are turned against enu by the convergence
        shift = np.array([[c, -s], [s, c]]) @ scene.SHIFT
        np.testing.assert_allclose((place.xy_map - surveyed) * unit, shift, atol=0.02)


def test_a_point_off_the_mosaic_is_told(scene: Scene) -> None:
    far = np.array([17.0, 3.0, 0.0])
    place = scene.reader().place([scene.mark("B", far)])
    assert np.all(np.isnan(place.xy_map))
    assert place.refused == {"B": "lies off the mosaic"}


def test_a_mosaic_of_another_crs_is_refused(scene: Scene) -> None:
    other = MapFrame(ORIGIN, map_crs("EPSG:32616"))
    with pytest.raises(CrsError, match=r"mosaic\.tif"):
        MosaicReader(scene.path, other, scene.ground_of, read=lambda path, _: scene.images["A"])
