"""Orthos against a projection of every single pixel, and against painted targets."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rectify_cases import BENT, ORIGIN, PLAIN, camera_at, map_frame
from rio_cogeo.cogeo import cog_validate

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.camera import Camera
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, FlatTerrain, Terrain
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.reading import read_image
from georef_gis.rectify.footprints import footprint
from georef_gis.rectify.grids import plan_grid
from georef_gis.rectify.orthos import OrthoTarget, write_ortho
from georef_gis.simulate import FlightSettings, SimulatedFlight, project_truth, simulate_flight
from georef_gis.simulate import ellipsoid as own_ellipsoid

SAMPLE = Path(__file__).parents[2] / "sample_project"
# grey values per px of the photos whose values are their pixels
CODE = 40.0
# px; what an ortho may be off, and what one step of CODE and OpenCV's 1/32 px can hide
EXACT, ROUNDING = 0.1, 0.5 / CODE + 1 / 64


def code_image(camera: Camera) -> Array:
    """16-bit photo of two bands whose values are CODE times its own u and v."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([u, v], axis=-1) * CODE


def hilly(frame: MapFrame) -> DemTerrain:
    """Relief of 12 m in cells of 2 m, as rough as a DEM can be for bilinear heights."""
    left, top = frame.map_from_enu([-200.0, 200.0, 0.0])[:2]
    e, n = np.meshgrid(np.arange(200) * 2.0, np.arange(200) * -2.0)
    noise = np.random.default_rng(7).normal(size=(200, 200))
    heights = 280.0 + 6.0 * np.sin(e / 17.0) * np.cos(n / 23.0) + 0.3 * noise
    return DemTerrain(frame=frame, heights=heights, left=float(left), top=float(top),
                      cell=(2.0, 2.0), step=1.0)  # fmt: skip


def ortho_uv(
    photo: OrientedPhoto, terrain: Terrain, frame: MapFrame, path: Path, *, gsd: float
) -> tuple[Array, Array, Array]:
    """Map places of the pixels of an ortho, the photo pixels they were taken from, its mask."""
    one = footprint(photo, terrain, frame)
    grid = plan_grid([one], frame, gsd=gsd)
    heights = (260.0, 300.0)
    ground = Ground.of(frame, grid, terrain, heights)
    profile = RasterProfile(
        width=grid.width, height=grid.height, transform=grid.transform, crs_wkt=grid.crs_wkt,
        epsg=frame.horizontal.to_epsg(), bands=2, dtype="uint16", compression="deflate",
        band_descriptions=("u", "v"),
    )  # fmt: skip
    image = code_image(photo.camera).astype(np.uint16)
    target = OrthoTarget(path=path, profile=profile, grid=grid, gsd=gsd)
    write_ortho(photo, image, one, ground, target)
    with rasterio.open(path) as dataset:
        uv = np.moveaxis(dataset.read(), 0, -1) / CODE
        mask = dataset.dataset_mask() > 0
        rows, cols = np.mgrid[: dataset.height, : dataset.width]
        t = dataset.transform
        x, y = t.c + t.a * (cols + 0.5), t.f + t.e * (rows + 0.5)
    return np.stack([x, y], axis=-1), uv, mask


CASES = {
    "nadir, flat": (PLAIN, 0.0, 0.0, "EPSG:32617", False),
    "turned and tilted, distorted": (BENT, 133.0, 25.0, "EPSG:32617", False),
    "feet": (BENT, 30.0, 10.0, "EPSG:6601", False),
    "hills": (BENT, 250.0, 15.0, "EPSG:32617", True),
    "hills in feet": (BENT, 10.0, 5.0, "EPSG:6601", True),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_ortho_is_exact_against_every_pixel(
    case: tuple[Camera, float, float, str, bool], tmp_path: Path
) -> None:
    camera, heading, tilt, crs, relief = case
    frame = map_frame(crs)
    terrain: Terrain = FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0)
    if relief:
        terrain = hilly(map_frame())
    photo = camera_at(5.0, -3.0, heading_deg=heading, tilt_deg=tilt, camera=camera)
    xy, uv, mask = ortho_uv(photo, terrain, frame, tmp_path / "o.tif", gsd=0.2)
    h = terrain.height_on_map(frame, xy)
    true = photo.project(frame.enu_from_map(np.concatenate([xy, h[..., None]], axis=-1)))
    inner = mask & np.all((true > 0.5) & (true < np.array([598.5, 398.5])), axis=-1)
    assert inner.sum() > 100_000
    assert np.abs(uv - true)[inner].max() < EXACT + ROUNDING
    # What the photo shows is there, what it does not show is not.
    assert mask[photo.contains(true) & (np.abs(true - 0.0).min(axis=-1) > 0.1)].mean() > 0.999
    assert not mask[np.any((true < -1.0) | (true > np.array([600.0, 400.0])), axis=-1)].any()


@pytest.fixture(scope="module")
def flight() -> SimulatedFlight:
    return simulate_flight(FlightSettings(), seed=5)


def true_photo(
    R_ecef_from_cam: Array, p_ecef: Array, camera: Camera, name: str, path: Path
) -> OrientedPhoto:
    pose = Pose(
        origin_enu=ORIGIN.enu_from_ecef(p_ecef),
        R_enu_from_cam=ORIGIN.R_ecef_from_enu.T @ R_ecef_from_cam,
        covariance=np.eye(6) * 1e-6,
    )
    photo = Photo(id=name, path=path, width=camera.width, height=camera.height)
    return OrientedPhoto(photo=photo, camera=camera, pose=pose)


def true_camera(content: dict[str, float]) -> Camera:
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    return Camera(
        id="truth", width=int(content["width"]), height=int(content["height"]),
        **{name: float(content[name]) for name in names},
    )  # fmt: skip


def true_ground() -> DemTerrain:
    """The simulator's own ground in cells of 0.5 m: the sample's DEM errs by more than a pixel."""
    from georef_gis.simulate import ground_height

    frame = map_frame("EPSG:32617")
    left, top = (float(c) for c in frame.map_from_enu([-130.0, 130.0, 0.0])[:2])
    x, y = np.meshgrid(left + 0.25 + np.arange(520) * 0.5, top - 0.25 - np.arange(520) * 0.5)
    lon, lat = Transformer.from_crs(32617, 4326, always_xy=True).transform(x, y)
    return DemTerrain(
        frame=frame, heights=ground_height(np.radians(lat), np.radians(lon)), left=left, top=top,
        cell=(0.5, 0.5), step=0.25,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 6])
def test_ortho_agrees_with_the_simulators_own_projection(
    flight: SimulatedFlight, index: int, tmp_path: Path
) -> None:
    camera = true_camera({n: getattr(flight.settings.camera, n) for n in (
        "width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")})  # fmt: skip
    photo = true_photo(
        flight.R_ecef_from_cam[index], flight.p_ecef[index], camera, "I", tmp_path / "I.JPG"
    )
    frame, terrain = map_frame("EPSG:6601"), true_ground()
    xy, uv, mask = ortho_uv(photo, terrain, frame, tmp_path / "o.tif", gsd=0.08)
    rows, cols = np.nonzero(mask)
    some = np.random.default_rng(7).integers(0, rows.size, 5000)
    p, got = xy[rows[some], cols[some]], uv[rows[some], cols[some]]
    # PROJ from the map, the simulator's lines from there on.
    lon, lat = Transformer.from_crs(6601, 6319, always_xy=True).transform(p[:, 0], p[:, 1])
    h = terrain.height_on_map(frame, p)
    ecef = own_ellipsoid.ecef_from_geodetic(np.radians(lat), np.radians(lon), h)
    true = project_truth(flight, index, ecef)
    inner = np.all((true > 0.5) & (true < np.array([1294.5, 862.5])), axis=-1)
    assert np.abs(got - true)[inner].max() < EXACT + ROUNDING


def read_rows(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def saddle_at(grey: Array) -> Array:
    """Centre (u, v) of a target of four quarters: the saddle of a fitted quadric, twice."""
    at = np.array([(grey.shape[1] - 1) / 2, (grey.shape[0] - 1) / 2])
    corner = cv2.cornerSubPix(
        np.ascontiguousarray(grey, dtype=np.float32), at.astype(np.float32).reshape(1, 1, 2),
        (4, 4), (-1, -1), (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3),
    )  # fmt: skip
    return np.asarray(corner[0, 0], dtype=np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["IMG_0003", "IMG_0007", "IMG_0011"])
def test_true_poses_put_the_painted_targets_in_their_place(name: str, tmp_path: Path) -> None:
    truth = SAMPLE / "truth"
    camera = true_camera(json.loads((truth / "camera.json").read_text()))
    (row,) = [r for r in read_rows(truth / "poses.csv") if r["photo"] == f"{name}.JPG"]
    R = np.array([[float(row[f"R_ecef_from_cam_{i}{j}"]) for j in range(3)] for i in range(3)])
    geo = [np.radians(float(row["lat_deg"])), np.radians(float(row["lon_deg"])),
           float(row["height_ellipsoidal_m"])]  # fmt: skip
    path = SAMPLE / "photos" / f"{name}.JPG"
    photo = true_photo(R, own_ellipsoid.ecef_from_geodetic(*geo), camera, name, path)
    frame, terrain = map_frame("EPSG:6601"), true_ground()
    one = footprint(photo, terrain, frame)
    grid = plan_grid([one], frame)
    ground = Ground.of(frame, grid, terrain, (260.0, 300.0))
    profile = RasterProfile(
        width=grid.width, height=grid.height, transform=grid.transform, crs_wkt=grid.crs_wkt,
        epsg=6601, bands=3, dtype="uint8", compression="deflate",
        band_descriptions=("red", "green", "blue"),
    )  # fmt: skip
    target = OrthoTarget(path=tmp_path / "o.tif", profile=profile, grid=grid, gsd=one.gsd)
    write_ortho(photo, read_image(path), one, ground, target)
    off = targets_off(target.path, truth, f"{name}.JPG")
    assert len(off) >= 2
    assert np.hypot(*off.T).max() < 0.5  # px of the ortho
    assert cog_validate(target.path)[0]


def targets_off(ortho: Path, truth: Path, photo: str) -> Array:
    """From the map coordinates of the targets to where they are seen, px; (n, 2)."""
    seen = {row["name"] for row in read_rows(truth / "marks.csv") if row["photo"] == photo}
    off = []
    with rasterio.open(ortho) as dataset:
        grey, t = dataset.read(2).astype(np.float64), dataset.transform
        for row in read_rows(truth / "control.csv"):
            if row["name"] not in seen:
                continue
            x, y = float(row["easting"]), float(row["northing"])
            col, line = (x - t.c) / t.a, (y - t.f) / t.e
            c, r = math.floor(col), math.floor(line)
            chip = grey[r - 8 : r + 9, c - 8 : c + 9]
            if chip.shape != (17, 17):
                continue
            u, v = saddle_at(chip)
            off.append((c - 8 + u + 0.5 - col, r - 8 + v + 0.5 - line))
    return np.array(off)
