"""Footprints: the ground that each photo shows, its GSD and how far to trust its place."""

from __future__ import annotations

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.model.ground_point import ground_point_covariance, locate
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain

# a photo counts as far as this many heights from its nadir; beyond, a pixel covers an acre
REACH_IN_HEIGHTS = 4.0
POINTS_PER_SIDE = 8


def footprint(photo: OrientedPhoto, terrain: Terrain, frame: MapFrame) -> Footprint:
    """Ground that a photo shows, as a ring on the map.

    A border that looks past the horizon or further than `REACH_IN_HEIGHTS` heights away is drawn
    in towards the middle until it meets the ground; `clipped` says so.

    Raises
    ------
    GeometryError
        If not even the middle of the photo meets the ground.
    """
    pose = photo.pose
    agl = float(pose.origin_enu[2] - terrain.z_at(pose.origin_enu[:2]))
    if not np.isfinite(agl):
        raise GeometryError(f"photo {photo.id}: no ground height below it; is the DEM too small?")
    border = photo.camera.border_uv(POINTS_PER_SIDE)
    anchor = _lowest_pixel(photo)
    ring, clipped = _ring_on_ground(photo, terrain, border, anchor, REACH_IN_HEIGHTS * agl)
    if not np.all(np.isfinite(ring)):
        raise GeometryError(f"photo {photo.id}: it does not look at the ground within reach")
    ring_map = frame.map_from_enu(ring)[:, :2]
    signed = _signed_area(ring[:, :2])
    if signed < 0:
        ring, ring_map = ring[::-1], ring_map[::-1]
    gsd = ground_sample_distances(photo, terrain, ring)
    middle = locate(photo, anchor, terrain)
    covariance = ground_point_covariance(photo, middle, terrain, sigma_uv=0.0)
    nadir = np.append(pose.origin_enu[:2], pose.origin_enu[2] - agl)
    return Footprint(
        photo_id=photo.id,
        ring_map=np.vstack([ring_map, ring_map[:1]]),
        ring_enu=np.vstack([ring, ring[:1]]),
        gsd=float(np.median(gsd)),
        gsd_min=float(gsd.min()),
        gsd_max=float(gsd.max()),
        area_m2=abs(signed),
        height_above_ground=agl,
        tilt=pose.tilt,
        nadir_map=frame.map_from_enu(nadir)[:2],
        sigma_horizontal=float(np.sqrt((covariance[0, 0] + covariance[1, 1]) / 2)),
        clipped=clipped,
    )


def _signed_area(ring: Array) -> float:
    x, y = ring[:, 0], ring[:, 1]
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _lowest_pixel(photo: OrientedPhoto) -> Array:
    """Pixel that looks most steeply down: the middle, or nearer to the nadir if that is oblique."""
    w, h = photo.camera.width, photo.camera.height
    u, v = np.meshgrid(np.linspace(0, w - 1, 9), np.linspace(0, h - 1, 9))
    grid = np.stack([u.ravel(), v.ravel()], axis=-1)
    middle = grid[40]
    if photo.pose.tilt < np.radians(30):
        return np.asarray(middle)
    down = photo.ray(grid)[:, 2]
    return np.asarray(grid[int(np.nanargmin(down))])


def _ring_on_ground(
    photo: OrientedPhoto, terrain: Terrain, border: Array, anchor: Array, reach: float
) -> tuple[Array, bool]:
    def points(uv: Array) -> Array:
        p = locate(photo, uv, terrain)
        far = np.hypot(*(p - photo.pose.origin_enu)[..., :2].T) > reach
        return np.where(far[..., None], np.nan, p)

    ring = points(border)
    missing = ~np.all(np.isfinite(ring), axis=-1)
    if not np.any(missing):
        return ring, False
    inside, outside = np.zeros(border.shape[0]), np.ones(border.shape[0])
    for _ in range(20):
        t = (inside + outside) / 2
        hit = np.all(np.isfinite(points(anchor + t[:, None] * (border - anchor))), axis=-1)
        inside, outside = np.where(hit, t, inside), np.where(hit, outside, t)
    drawn_in = points(anchor + inside[:, None] * (border - anchor))
    return np.where(missing[:, None], drawn_in, ring), True


def ground_sample_distances(photo: OrientedPhoto, terrain: Terrain, ring_enu: Array) -> Array:
    """GSD, m, at a 5 x 5 grid of pixels that see the ground: root of a pixel's ground area."""
    w, h = photo.camera.width, photo.camera.height
    u, v = np.meshgrid(np.linspace(1, w - 2, 5), np.linspace(1, h - 2, 5))
    uv = np.stack([u.ravel(), v.ravel()], axis=-1)
    p = locate(photo, uv, terrain)
    right = locate(photo, uv + np.array([1.0, 0.0]), terrain) - p
    down = locate(photo, uv + np.array([0.0, 1.0]), terrain) - p
    area = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    reach = np.hypot(*(ring_enu[:, :2] - photo.pose.origin_enu[:2]).T).max()
    near = np.isfinite(area) & (np.hypot(*(p[:, :2] - photo.pose.origin_enu[:2]).T) <= reach * 1.01)
    if not np.any(near):
        raise GeometryError(f"photo {photo.id}: no GSD, none of its pixels sees the ground")
    return np.asarray(np.sqrt(area[near]))
