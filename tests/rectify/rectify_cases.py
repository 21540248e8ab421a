"""Cameras over simple ground whose footprints can be worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, map_crs
from georef_gis.model.camera import Camera
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=280.0)
GROUND = FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0, sigma=0.5)
PLAIN = Camera(id="plain", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)
BENT = Camera(
    id="bent", width=600, height=400, fx=500.0, fy=501.0, cx=310.0, cy=190.0,
    k1=-0.16, k2=0.1, k3=-0.02, p1=6e-4, p2=-4e-4,
)  # fmt: skip


def map_frame(crs: str = "EPSG:32617") -> MapFrame:
    return MapFrame(ORIGIN, map_crs(crs))


def camera_at(
    east: float = 0.0,
    north: float = 0.0,
    *,
    height: float = 100.0,
    heading_deg: float = 0.0,
    tilt_deg: float = 0.0,
    camera: Camera = PLAIN,
    name: str = "P1",
    path: Path | None = None,
) -> OrientedPhoto:
    """Photo whose top points to a heading, tilted so that its top looks farther."""
    nadir_north = np.diag([1.0, -1.0, -1.0])
    turn = Rotation.from_euler("ZX", [-heading_deg, tilt_deg], degrees=True).as_matrix()
    pose = Pose(
        origin_enu=np.array([east, north, height]),
        R_enu_from_cam=turn @ nadir_north,
        covariance=np.diag([1.0, 1.0, 4.0, 3e-4, 3e-4, 3e-3]),
    )
    photo = Photo(
        id=name, path=path or Path(f"{name}.jpg"), width=camera.width, height=camera.height
    )
    return OrientedPhoto(photo=photo, camera=camera, pose=pose)


def square(frame: MapFrame, east: float, north: float, side: float, name: str = "F") -> Footprint:
    """Footprint that is a square of enu, m, from its lower left corner."""
    ring = np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0], [0, 0, 0]], float)
    ring += [east, north, 0.0]
    return Footprint(
        photo_id=name, ring_map=frame.map_from_enu(ring)[:, :2], ring_enu=ring,
        gsd=side / 500, gsd_min=side / 510, gsd_max=side / 490, area_m2=side**2,
        height_above_ground=100.0, tilt=0.0, nadir_map=np.zeros(2), sigma_horizontal=1.0,
    )  # fmt: skip


def on_plane(photo: OrientedPhoto, uv: Array) -> Array:
    """Where an ideal lens's rays meet the plane up = 0: own lines, no distortion; (n, 2) m."""
    c = photo.camera
    d_cam = np.c_[(uv[:, 0] - c.cx) / c.fx, (uv[:, 1] - c.cy) / c.fy, np.ones(len(uv))]
    d = d_cam @ photo.pose.R_enu_from_cam.T
    t = -photo.pose.origin_enu[2] / d[:, 2]
    return np.asarray(photo.pose.origin_enu[:2] + t[:, None] * d[:, :2])
