"""What one photo shows of the ground: field of view and size of a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

from georef_gis.errors import GeometryError
from georef_gis.model.camera import Camera


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
