"""What one photo tells: field of view, and places, distances and azimuths of its pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.ground_point import ground_point_jacobians, locate
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import Terrain


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOfView:
    """What a camera that looks straight down sees; m, rad, m per pixel."""

    width: float
    height: float
    angle_width: float
    angle_height: float
    gsd: float


def field_of_view(
    height_above_ground: float, sensor: tuple[float, float], focal: float, *, pixels: int
) -> FieldOfView:
    """Field and angle of view of an ideal lens over flat ground.

    Parameters
    ----------
    height_above_ground
        m.
    sensor, focal
        (width, height) of the sensor and the focal length in one unit, mm or px.
    pixels
        Columns of the image.

    Notes
    -----
    Equations (4) to (8) of Gu (2009), "Evaluation of Remote Sensing Aerial Systems in Existing
    Transportation Practices".
    """
    if height_above_ground <= 0 or focal <= 0 or min(sensor) <= 0:
        raise GeometryError("height, focal length and sensor size must be positive")
    width = height_above_ground * sensor[0] / focal
    return FieldOfView(
        width=width,
        height=height_above_ground * sensor[1] / focal,
        angle_width=2.0 * math.atan(sensor[0] / (2.0 * focal)),
        angle_height=2.0 * math.atan(sensor[1] / (2.0 * focal)),
        gsd=width / pixels,
    )


def camera_field_of_view(camera: Camera, height_above_ground: float) -> FieldOfView:
    """Field of view of a camera without its distortion, looking straight down."""
    aspect = camera.fx / camera.fy
    return field_of_view(
        height_above_ground,
        (camera.width, camera.height * aspect),
        camera.fx,
        pixels=camera.width,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotoPoints:
    """Ground points of pixels of one photo with their joint covariance.

    `p_enu` (n, 3) m; `covariance` (3 n, 3 n) m^2 in enu: points of one photo share the errors of
    its pose, its camera and the ground, so that distances are better than places.
    """

    uv: Array
    p_enu: Array
    covariance: Array

    def covariance_of(self, i: int) -> Array:
        """Covariance of one point; shape (3, 3), m^2."""
        return self.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """From one point to the next; m, azimuth clockwise from true north, rad, one sigma each."""

    distance: float
    sigma_distance: float
    azimuth: float
    sigma_azimuth: float
    height_difference: float


def measure_pixels(
    photo: OrientedPhoto, uv: ArrayLike, terrain: Terrain, *, sigma_uv: float = 1.0
) -> PhotoPoints:
    """Ground points that pixels show, with their joint covariance.

    Parameters
    ----------
    uv : shape (n, 2), px
    sigma_uv
        One sigma of a click, px.

    Raises
    ------
    GeometryError
        If a pixel lies outside the photo or does not see the ground.
    """
    pixels = np.atleast_2d(np.asarray(uv, dtype=np.float64))
    for u, v in pixels[~photo.contains(pixels)]:
        raise GeometryError(
            f"photo {photo.id}: pixel ({u:.1f}, {v:.1f}) lies outside "
            f"{photo.camera.width} x {photo.camera.height} px"
        )
    p_enu = locate(photo, pixels, terrain)
    for (u, v), p in zip(pixels, p_enu, strict=True):
        if not np.all(np.isfinite(p)):
            raise GeometryError(
                f"photo {photo.id}: pixel ({u:.1f}, {v:.1f}) does not look at the ground"
            )
    shared, own = [], []
    for pixel, p in zip(pixels, p_enu, strict=True):
        J_pose, J_height, J_uv = ground_point_jacobians(photo, p, terrain)
        from_centre = (pixel - [photo.camera.cx, photo.camera.cy]) / photo.camera.fx
        # Columns: pose (6), ground height (1), focal length (1), principal point (2).
        shared.append(np.column_stack([J_pose, J_height, J_uv @ from_centre, J_uv]))
        own.append(J_uv @ J_uv.T * sigma_uv**2)
    J = np.vstack(shared)
    sigma = np.zeros((10, 10))
    sigma[:6, :6] = photo.pose.covariance
    sigma[6, 6] = terrain.sigma**2
    sigma[7, 7] = photo.camera.sigma_f**2
    sigma[8:, 8:] = np.eye(2) * photo.camera.sigma_c**2
    covariance = J @ sigma @ J.T
    for i, block in enumerate(own):
        covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += block
    return PhotoPoints(uv=pixels, p_enu=p_enu, covariance=covariance)


def lines_between(points: PhotoPoints) -> Sequence[Line]:
    """Horizontal distance and azimuth from each point to the next, with their sigmas."""
    return [_line(points, i, j) for i, j in pairwise(range(len(points.p_enu)))]


def _line(points: PhotoPoints, i: int, j: int) -> Line:
    d = points.p_enu[j] - points.p_enu[i]
    distance = float(np.hypot(d[0], d[1]))
    if distance == 0.0:
        raise GeometryError("two pixels show one place: there is no azimuth between them")
    rows = np.zeros((2, points.covariance.shape[0]))
    along = d[:2] / distance
    across = np.array([d[1], -d[0]]) / distance**2
    for row, gradient in zip(rows, (along, across), strict=True):
        row[3 * j : 3 * j + 2] = gradient
        row[3 * i : 3 * i + 2] = -gradient
    c = rows @ points.covariance @ rows.T
    return Line(
        distance=distance,
        sigma_distance=float(np.sqrt(c[0, 0])),
        azimuth=math.atan2(d[0], d[1]) % (2 * math.pi),
        sigma_azimuth=float(np.sqrt(c[1, 1])),
        height_difference=float(d[2]),
    )
