"""Which ground products stand on: the adjusted one under adjusted poses, else the direct one."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS

from georef_gis.geodesy import MapFrame, Origin, map_crs
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, FlatTerrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import TinTerrain
from georef_gis.orient.dem_bias import DemBias
from georef_gis.orient.surface import fit_surface
from georef_gis.project import Project
from georef_gis.project.records import camera_row, photo_row, pose_row, save_frame
from georef_gis.project.surface_file import SURFACE, save_surface
from processing_algorithms.site import ground_facts, load_ground, load_site

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=280.0)
FRAME = MapFrame(ORIGIN, map_crs("EPSG:32617"))
FLAT = FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0, sigma=1.5)
CAMERA = Camera(id="c", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)


@functools.cache
def surface() -> TinTerrain:
    """Ground 4 m above the direct one; 2 m of sigma that photos and ground share."""
    xy = np.random.default_rng(1).uniform(-100, 100, (300, 2))
    points = GroundPoints(
        p_enu=np.column_stack([xy, 4.0 + 1.5 * np.sin(xy[:, 0] / 20.0)]),
        covariance=np.tile(np.diag([0.01, 0.01, 4.0]), (300, 1, 1)),
        rays=np.full(300, 3, np.int32),
        residual_px=np.full(300, 0.3),
    )
    terrain = fit_surface(points, ORIGIN, np.zeros((0, 2))).terrain
    assert isinstance(terrain, TinTerrain)
    return terrain


def project_at(folder: Path, adjusted: int, *, shared: float = 0.0) -> Project:
    """Three photos with poses from tags, some of them adjusted besides."""
    project = Project.create(folder)
    database = project.database
    photos = [
        Photo(id=f"P{i}", path=folder / f"P{i}.JPG", width=600, height=400, camera_id="c")
        for i in range(3)
    ]
    pose = Pose(
        origin_enu=np.array([0.0, 0.0, 90.0]), R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
        covariance=np.eye(6) * 1e-2,
    )  # fmt: skip
    own = replace(pose, kind="adjusted", sigma_height_shared=shared)

    def row(name: str, one: Pose):
        return pose_row(name, one, FRAME, height_above_ground=90.0, dialect="", doubts=[])

    with database.transaction():
        save_frame(database, FRAME)
        database.replace_rows("camera", [camera_row(CAMERA)])
        database.replace_rows(
            "photo", [photo_row(p, FRAME, status="ok", fingerprint="") for p in photos]
        )
        rows = [row(p.id, pose) for p in photos] + [row(p.id, own) for p in photos[:adjusted]]
        database.replace_rows("pose", rows)
        database.set_meta(ground=ground_facts(FLAT, "test", None))
    return project


def adjust(project: Project, terrain: TinTerrain) -> None:
    (project.folder / "adjustment").mkdir()
    save_surface(project.folder / "adjustment" / SURFACE, terrain)
    project.database.set_meta(ground_adjusted=ground_facts(terrain, "tie points", None))


def test_adjusted_poses_stand_on_the_adjusted_ground(tmp_path: Path) -> None:
    project = project_at(tmp_path, adjusted=2)
    terrain = surface()
    adjust(project, terrain)
    found = load_site(project).terrain
    assert isinstance(found, TinTerrain)
    assert found.z_at([7.0, 5.0]) == pytest.approx(terrain.z_at([7.0, 5.0]), abs=1e-4)
    assert found.sigma == pytest.approx(terrain.sigma)
    quick = load_site(project, quick=True).terrain
    assert isinstance(quick, FlatTerrain)
    assert quick == FLAT


@pytest.mark.parametrize("adjusted", [0, 1])
def test_mostly_direct_poses_stand_on_the_direct_ground(adjusted: int, tmp_path: Path) -> None:
    project = project_at(tmp_path, adjusted=adjusted)
    adjust(project, surface())
    assert isinstance(load_site(project).terrain, FlatTerrain)


def test_an_adjustment_without_a_ground_leaves_the_direct_one(tmp_path: Path) -> None:
    project = project_at(tmp_path, adjusted=3)
    assert isinstance(load_site(project).terrain, FlatTerrain)
    project.database.set_meta(ground_adjusted=None)
    assert isinstance(load_site(project).terrain, FlatTerrain)


def test_what_photos_hold_apart_is_not_counted_twice(tmp_path: Path) -> None:
    terrain = surface()
    sigmas = []
    for shared in (0.0, 2.0):
        project = project_at(tmp_path / str(shared), adjusted=3, shared=shared)
        adjust(project, terrain)
        sigmas.append(load_site(project).terrain.sigma)
    assert sigmas[0] == pytest.approx(2.0, abs=0.1)
    assert sigmas[1] < 0.5


def test_a_lost_surface_leaves_the_direct_ground(tmp_path: Path) -> None:
    project = project_at(tmp_path, adjusted=3)
    adjust(project, surface())
    (tmp_path / "adjustment" / SURFACE).unlink()
    assert isinstance(load_site(project).terrain, FlatTerrain)


def test_a_plane_is_kept_as_a_plane(tmp_path: Path) -> None:
    project = project_at(tmp_path, adjusted=3)
    points = GroundPoints(
        p_enu=np.array([[0.0, 0, 4.0], [50.0, 0, 5.0], [0, 50.0, 4.0]]),
        covariance=np.tile(np.eye(3) * 0.01, (3, 1, 1)),
        rays=np.full(3, 2, np.int32),
        residual_px=np.zeros(3),
    )
    terrain = fit_surface(points, ORIGIN, np.zeros((0, 2))).terrain
    assert isinstance(terrain, TinTerrain)
    adjust(project, terrain)
    assert project.database.meta("ground_adjusted")["kind"] == "plane"
    found = load_site(project).terrain
    assert isinstance(found, TinTerrain)
    assert found.kind == "plane"


def test_a_dem_is_read_again_and_its_bias_taken_off(tmp_path: Path) -> None:
    left, top = (float(v) for v in FRAME.map_from_enu([-900.0, 900.0, 0.0])[:2])
    tmp_path.joinpath("site").mkdir()
    path = tmp_path / "site" / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=90, height=90, count=1, dtype="float32",
        crs=CRS(32617).to_wkt(), transform=rasterio.Affine(20, 0, left, 0, -20, top),
    ) as target:  # fmt: skip
        target.write(np.full((90, 90), 281.3, np.float32), 1)
        target.set_band_unit(1, "m")
    project = project_at(tmp_path / "site", adjusted=3)
    text = '[ground]\ndem = "dem.tif"\ndem_height_kind = "ellipsoidal"\n'
    (tmp_path / "site" / "project.toml").write_text(text)
    project.close()
    project = Project.open(tmp_path / "site")
    direct = load_ground_of_dem(project, None)
    bias = DemBias(
        offset=1.3, sigma_offset=0.05, slope_east=0.0, slope_north=0.0, centre_east=0.0,
        centre_north=0.0, points=400, used=True, spread=0.2, sigma=0.21,
    )  # fmt: skip
    adjusted = load_ground_of_dem(project, bias)
    assert direct.z_at([0.0, 0.0]) == pytest.approx(1.3, abs=1e-3)
    assert adjusted.z_at([0.0, 0.0]) == pytest.approx(0.0, abs=1e-3)
    assert adjusted.sigma == 0.21


def load_ground_of_dem(project: Project, bias: DemBias | None) -> DemTerrain:
    dem = DemTerrain(
        frame=FRAME, heights=np.zeros((2, 2)), left=0.0, top=0.0, cell=(1.0, 1.0), step=0.5
    )
    facts = ground_facts(dem, "DEM", project.folder / "dem.tif", bias=bias)
    project.database.set_meta(ground_adjusted=facts)
    found = load_ground(project, FRAME, adjusted=True)
    assert isinstance(found, DemTerrain)
    return found
