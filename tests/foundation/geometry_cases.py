"""Photos, frames and grounds that several tests of the geometry look at."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, R_enu_from_ned, R_ned_from_body
from georef_gis.geodesy import MapFrame, Origin, metres_per_unit, parse_crs
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, dem_terrain

SITE = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
UTM, FEET = "EPSG:32617", "EPSG:6601"
CAMERA = Camera(
    id="rebel",
    width=1296,
    height=864,
    fx=1043.4,
    fy=1043.4,
    cx=657.1,
    cy=424.3,
    k1=-0.162,
    k2=0.108,
    k3=-0.021,
    p1=0.0006,
    p2=-0.0004,
)


def frame(code: str = UTM, origin: Origin = SITE) -> MapFrame:
    return MapFrame(origin, parse_crs(code))


def oriented(
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
    origin_enu: tuple[float, float, float] = (0.0, 0.0, 60.0),
    camera: Camera = CAMERA,
    covariance: np.ndarray | None = None,
    **motion: np.ndarray,
) -> OrientedPhoto:
    """A photo of a camera that looks down when the angles are zero."""
    R = R_enu_from_ned(0, 0, 0, 0) @ R_ned_from_body(*np.radians(rpy_deg)) @ R_BODY_FROM_CAM_NADIR
    pose = Pose(
        origin_enu=np.array(origin_enu),
        R_enu_from_cam=R,
        covariance=np.zeros((6, 6)) if covariance is None else covariance,
        **motion,
    )
    photo = Photo(id="P", path=Path("P.JPG"), width=camera.width, height=camera.height)
    return OrientedPhoto(photo=photo, camera=camera, pose=pose)


def rolling(readout_s: float) -> Camera:
    return replace(CAMERA, readout_s=readout_s)


def kinked_heights(e: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Ellipsoidal height, m, over metres east and north: ridges, slopes of 30 % and 2 m banks."""
    return 277.6 + 0.3 * np.abs(((e + 500) % 24) - 12) + 0.1 * n + 2.0 * ((n + 507) % 40 > 20)


def kinked_dem(code: str = UTM, cell_m: float = 1.0, half: int = 120) -> DemTerrain:
    """DEM of 1 m cells around the site's origin, in the units of a CRS."""
    f = frame(code)
    unit = metres_per_unit(f.horizontal)
    cell = cell_m / unit
    centre = f.map_from_enu(np.zeros(3))[:2]
    left, top = centre[0] - half * cell, centre[1] + half * cell
    k = (np.arange(2 * half) + 0.5) * cell_m - half * cell_m
    e, n = np.meshgrid(k, -k)
    return dem_terrain(
        f, kinked_heights(e, n), left=left, top=top, cell=(cell, cell), metres_per_unit=unit
    )
