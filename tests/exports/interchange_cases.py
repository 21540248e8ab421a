"""Cameras, blocks and sites for the tests of interchange."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from exports.site.site import SiteLayers, SitePhoto
from georef_gis.geodesy import MapFrame, Origin, parse_crs
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Photo
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import GroundPoints, TiePoints

BASE = dict(width=640, height=480, fx=700.0, fy=700.0, cx=319.5, cy=239.5)
CAMERAS = {
    "ideal": Camera(id="ideal", **BASE),
    "two focal lengths": Camera(id="two", **(BASE | dict(fy=702.5, cx=325.25, cy=230.5))),
    "b1": Camera(id="b1", **BASE, b1=1.75),
    "one coefficient": Camera(id="k1", **BASE, k1=-0.12),
    "two coefficients": Camera(id="k2", **(BASE | dict(cx=310.0)), k1=-0.12, k2=0.03),
    "tangential": Camera(id="p", **(BASE | dict(cy=250.0)), k1=-0.1, k2=0.02, p1=1e-3, p2=-2e-3),
    "k3": Camera(
        id="k3", **(BASE | dict(fy=703.0)), k1=-0.1, k2=0.02, k3=-0.004, p1=1e-3, p2=-2e-3
    ),
    "tall": Camera(
        id="tall", width=480, height=641, fx=700.0, fy=700.0, cx=250.0, cy=310.0, k1=-0.1, k3=1e-3
    ),
    "fisheye": Camera(
        id="fish", **(BASE | dict(fx=300.0, fy=301.0, cx=321.0)), model="fisheye",
        k1=0.03, k2=-0.01, k3=2e-3, k4=-1e-4,
    ),
    "plain fisheye": Camera(
        id="fish2", **(BASE | dict(fx=300.0, fy=300.0)), model="fisheye", k1=0.03, k2=-0.01
    ),
}  # fmt: skip
# convergence of some degrees, feet, the southern hemisphere, the 180th meridian, north first
PLACES = {
    "Ohio in feet": (40.0, -83.0, "EPSG:6549"),
    "far from the middle": (47.0, 8.9, "EPSG:32633"),
    "New Zealand": (-41.3, 174.8, "EPSG:2193"),
    "Fiji across 180": (-17.5, 179.9995, "EPSG:32760"),
    "Chile": (-33.4, -70.6, "EPSG:32719"),
}


def points_before(camera: Camera, n: int = 60, seed: int = 1) -> np.ndarray:
    """Points in camera axes, m, that all lie in the picture; shape (n, 3)."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform([5, 5], [camera.width - 6, camera.height - 6], (n, 2))
    return camera.ray(uv) * rng.uniform(50.0, 150.0, (n, 1))


def make_block_site(
    place: str = "Ohio in feet", camera: Camera = CAMERAS["k3"], *, n: int = 6
) -> SiteLayers:
    """Photos about 100 m over a place, turned every way, up to 2 km from the origin."""
    lat, lon, crs = PLACES[place]
    origin = Origin(lat=math.radians(lat), lon=math.radians(lon), height_ellipsoidal=251.3)
    rng = np.random.default_rng(7)
    photos = []
    for i in range(n):
        R = Rotation.from_euler("ZYX", rng.uniform([-180, -25, -25], [180, 25, 25]), degrees=True)
        root = rng.normal(0.0, 1.0, (6, 6)) * ([0.3] * 3 + [0.002] * 3)
        pose = Pose(
            origin_enu=np.array([400.0 * i, -150.0 * i, 100.0 + i]) + rng.normal(0.0, 3.0, 3),
            R_enu_from_cam=R.as_matrix() @ np.diag([1.0, -1.0, -1.0]),
            covariance=root.T @ root,
            kind="adjusted",
            sigma_height_shared=0.5 if i == 1 else 0.0,
        )
        photo = Photo(
            id=f"flight/p{i}", path=Path(f"flight/IMG_{i}.JPG"), width=camera.width,
            height=camera.height, camera_id=camera.id, time_gps=2.0 * i,
        )  # fmt: skip
        photos.append(SitePhoto(photo=photo, pose=pose, height_above_ground=100.0))
    return SiteLayers(
        name="Site", frame=MapFrame(origin, parse_crs(crs)), photos=tuple(photos),
        cameras=(camera,), epoch_gps=1461672018.0,
    )  # fmt: skip


def with_blanks(site: SiteLayers) -> SiteLayers:
    """The site with a blank, a comma and a quote in the name of its first photo."""
    first = replace(site.photos[0].photo, path=Path('flight/a "b", c.JPG'))
    return replace(site, photos=(replace(site.photos[0], photo=first), *site.photos[1:]))


def tie_points(site: SiteLayers, n: int = 20) -> tuple[TiePoints, GroundPoints]:
    """Points below the first photos with their exact pixels; the last photo sees none."""
    camera = site.cameras[0]
    rng = np.random.default_rng(3)
    photo, point, uv, places = [], [], [], []
    posed = [one.pose for one in site.photos[:-1]]
    while len(places) < n:
        pose = posed[len(places) % len(posed)]
        p = pose.origin_enu + pose.enu_directions(
            camera.ray(rng.uniform([10, 10], [camera.width - 10, camera.height - 10]))
        ) * rng.uniform(80.0, 600.0)
        seen = [camera.project(one.cam_from_enu(p)) for one in posed]
        inside = [
            i for i, q in enumerate(seen)
            if np.all(np.isfinite(q)) and np.all(np.abs(q - 320) < 5000)
        ]  # fmt: skip
        if len(inside) < 2:
            continue
        photo += inside
        point += [len(places)] * len(inside)
        uv += [seen[i] for i in inside]
        places.append(p)
    ids = tuple(one.photo.id for one in site.photos)
    ties = TiePoints(
        photo_ids=ids, photo=np.array(photo, np.int32), point=np.array(point, np.int32),
        uv=np.array(uv), sigma=np.full(len(photo), 0.5),
    )  # fmt: skip
    rays = np.bincount(point).astype(np.int32)
    ground = GroundPoints(
        p_enu=np.array(places), covariance=np.tile(np.eye(3) * 0.01, (n, 1, 1)), rays=rays,
        residual_px=np.linspace(0.1, 0.9, n),
    )  # fmt: skip
    return ties, ground
