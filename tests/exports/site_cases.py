"""A site of three photos whose numbers can be worked out by hand."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.transform import Affine

from exports.site.site import SiteLayers, SitePhoto
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.model.camera import Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose

NASTY = 'a & <b>"ü]]>$.jpg'
# 83 W lies 2 deg west of the central meridian of UTM 17: the convergence is not zero.
ORIGIN = Origin(lat=math.radians(40.0), lon=math.radians(-83.0), height_ellipsoidal=200.0)
# Image right = east, image down = south, view down.
R_NADIR_NORTH = np.diag([1.0, -1.0, -1.0])
# m; covariance of the pose: 1, 2, 3 m with correlation 0.5, and 1 deg, 1 deg, 2 deg
COVARIANCE = np.zeros((6, 6))
COVARIANCE[:3, :3] = [[1.0, 1.0, 0.0], [1.0, 4.0, 0.0], [0.0, 0.0, 9.0]]
COVARIANCE[3:, 3:] = np.diag(np.radians([1.0, 1.0, 2.0]) ** 2)
DOT_SPACING = 60


def make_frame(crs: str) -> MapFrame:
    return MapFrame(ORIGIN, parse_crs(crs))


def make_site(folder: Path, *, crs: str = "EPSG:32617", mosaic: Path | None = None) -> SiteLayers:
    """Three nadir photos 20 m apart towards east at 100 m above the origin, 2 s apart."""
    frame = make_frame(crs)
    names = ("p1.jpg", NASTY, "missing.jpg")
    photos, footprints = [], []
    for i, name in enumerate(names):
        x = 20.0 * i
        photo = Photo(
            id=name, path=folder / name, width=640, height=480, camera_id="cam",
            camera_clock=datetime(2026, 5, 1, 8, 0, 2 * i), time_gps=2.0 * i,
            doubts=("heading <differs> & more",) if i == 1 else (),
        )  # fmt: skip
        pose = Pose(
            origin_enu=np.array([x, 0.0, 100.0]), R_enu_from_cam=R_NADIR_NORTH,
            covariance=COVARIANCE,
        )  # fmt: skip
        ring = np.array([[x - 16, -12, 0], [x + 16, -12, 0], [x + 16, 12, 0], [x - 16, 12, 0]])
        footprints.append(
            Footprint(
                photo_id=name,
                ring_map=frame.map_from_enu(ring)[:, :2],
                ring_enu=ring,
                gsd=0.05,
                gsd_min=0.049,
                gsd_max=0.052,
                area_m2=768.0,
                height_above_ground=100.0,
                tilt=0.0,
                nadir_map=frame.map_from_enu([x, 0, 0])[:2],
                sigma_horizontal=2.5,
            )
        )
        photos.append(SitePhoto(photo=photo, pose=pose, height_above_ground=100.0))
    camera = Camera(id="cam", width=640, height=480, fx=2000.0, fy=2000.0, cx=319.5, cy=239.5)
    # 2026-05-01 12:00:00 UTC on the GPS scale: days since 1980-01-06 and 18 leap seconds
    epoch = (datetime(2026, 5, 1, 12) - datetime(1980, 1, 6)).total_seconds() + 18.0
    return SiteLayers(
        name="Site & <road>", frame=frame, photos=tuple(photos), footprints=tuple(footprints),
        cameras=(camera,), mosaic=mosaic, epoch_gps=epoch, facts={"gsd_m": "0.05"},
    )  # fmt: skip


def write_photos(folder: Path) -> None:
    """Two of the three photos; the third is not there."""
    rng = np.random.default_rng(7)
    image = cv2.resize(rng.integers(0, 255, (12, 16, 3), np.uint8), (640, 480))
    data = cv2.imencode(".jpg", image)[1]
    for name in ("p1.jpg", NASTY):
        data.tofile(folder / name)


def dot_places(width: int, height: int) -> np.ndarray:
    """Centres of the dots of the test mosaic, col and row from the outer corner."""
    cols = np.arange(DOT_SPACING, width - 30, DOT_SPACING)
    rows = np.arange(DOT_SPACING, height - 30, DOT_SPACING)
    return np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2).astype(float)


def write_mosaic(
    path: Path, frame: MapFrame, *, width: int, height: int, pixel_m: float = 0.05
) -> Path:
    """Grey gradient with white dots in a diamond of valid pixels, as a COG with a mask."""
    from georef_gis.geodesy import metres_per_unit

    yy, xx = np.mgrid[0:height, 0:width]
    image = np.stack([40 + 100 * xx / width, 40 + 100 * yy / height, 0 * xx + 60]).astype(np.uint8)
    for col, row in dot_places(width, height):
        # A square of 6 px around a pixel corner: its centroid is the corner.
        image[:, int(row) - 3 : int(row) + 3, int(col) - 3 : int(col) + 3] = 255
    away = np.abs(xx / width - 0.5) + np.abs(yy / height - 0.5)
    mask = np.where(away < 0.45, 255, 0).astype(np.uint8)
    image[:, mask == 0] = 0
    left, top = frame.map_from_enu([-20.0, 20.0, 0.0])[:2]
    step = pixel_m / metres_per_unit(frame.horizontal)
    plain = path.with_suffix(".plain.tif")
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            plain, "w", driver="GTiff", width=width, height=height, count=3, dtype="uint8",
            crs=frame.horizontal.to_wkt(), transform=Affine(step, 0, left, 0, -step, top),
        ) as ds,
    ):  # fmt: skip
        ds.write(image)
        ds.write_mask(mask)
        ds.update_tags(TITLE="Mosaic & more")
    rasterio.shutil.copy(plain, path, driver="COG", compress="deflate", blocksize=256)
    plain.unlink()
    return path
